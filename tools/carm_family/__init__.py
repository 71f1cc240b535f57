"""The C-arm family: one parametric description of all machines in urdf/."""

from carm_family import mobile, room, special
from carm_family.parts import Machine

MACHINES: tuple[Machine, ...] = (
    *(machine.machine() for machine in mobile.MOBILES),
    mobile.mini_boom(),
    room.floor_angio(),
    room.ceiling_angio(),
    room.driven_gantry(),
    room.biplane(),
    room.ring_gantry(),
    special.robot_held(),
    special.orbital_first(),
)
