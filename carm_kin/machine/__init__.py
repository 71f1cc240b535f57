"""A machine as its URDF tells it: the file read and checked, the chain in it, its kinematics.

Nothing here knows a recording. Only `kinematics` imports pinocchio."""
