"""The calibration of a URDF's whole chain: which numbers are free, the fit, the URDF with the numbers found."""
