"""carm-kin: radiation-free calibration of C-arms and the sensors attached to them."""

__version__ = "0.1.0"
