"""What a user states of a tracker's file where the file itself is silent."""

from dataclasses import dataclass

from carm_kin.errors import InputError

UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Units of length, in metres."""
QUATERNIONS = ("wxyz", "xyzw")
EULER_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
"""``ZYX`` is R = Rz Ry Rx: the order of the factors, each turn about an axis of the frame turned so far."""


@dataclass(frozen=True)
class Declarations:
    """The options of a reader. None: not stated. Raises InputError that names the option."""

    tool: str | None = None
    """The tool that is fixed to the C, by its name in the file or a part of it that no other name has."""
    reference: str | None = None
    """The tool in whose frame the poses are wanted; None: the tracker's own frame."""
    invert: bool = False
    """The file gives the reference in the tool's frame, as where the tracker rides on the C."""
    unit: str | None = None
    """Of positions: one of `UNITS_M`."""
    quaternion: str | None = None
    """Order of the parts of a quaternion: one of `QUATERNIONS`."""
    euler: str | None = None
    """Order of Euler angles: one of `EULER_ORDERS`."""
    left_handed: bool | None = None
    """Whether the file's frames are left-handed; z is then negated."""

    def __post_init__(self) -> None:
        if self.euler is not None:
            object.__setattr__(self, "euler", self.euler.upper())
        valid = {"unit": tuple(UNITS_M), "quaternion": QUATERNIONS, "euler": EULER_ORDERS}
        for name, known in valid.items():
            value = getattr(self, name)
            if value is not None and value not in known:
                raise InputError(f"--{name} '{value}' is unknown; it is one of {', '.join(known)}")

    def stated(self) -> tuple[str, ...]:
        """The options as they would be typed."""
        words = [f"--{name} {getattr(self, name)}" for name in ("tool", "reference") if getattr(self, name)]
        words += ["--invert"] if self.invert else []
        words += [f"--{name} {getattr(self, name)}" for name in ("unit", "quaternion", "euler") if getattr(self, name)]
        if self.left_handed is not None:
            words.append("--left-handed" if self.left_handed else "--right-handed")
        return tuple(words)
