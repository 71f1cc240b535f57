"""What the calibration of a whole chain adds to a result: m and rad in Python, mm and degrees in the file."""

from dataclasses import dataclass

from solvers.se3 import Array


@dataclass(frozen=True, eq=False)
class JointChange:
    """How a joint's origin differs from the URDF's, in the frame of the nominal joint."""

    joint: str
    estimated: tuple[str, ...]
    """Which of ``x y z rx ry rz zero gain`` were estimated; the others are nominal."""
    shift_m: Array
    """(3,) of the joint's frame."""
    shift_sigma_m: Array
    """(3,) one sigma, 0 where it was not estimated."""
    turn_rad: Array
    """(3,) rotation vector."""
    turn_sigma_rad: Array
    """(3,)."""
    zero_rad: float | None
    """What is added to the joint's value; None for a sliding joint."""
    zero_m: float | None
    """The same of a sliding joint."""
    zero_sigma_rad: float | None
    zero_sigma_m: float | None
    gain: float
    """Relative error of the joint's scale."""
    gain_sigma: float


@dataclass(frozen=True, eq=False)
class SensorGeometry:
    """The two-axis geometry of one sensor's chain, calibrated, all other joints at zero."""

    link: str
    offset_sensor_pivot_m: Array
    """(3,)."""
    offset_sigma_m: Array
    """(3,) one sigma."""
    major_radius_m: float
    axis_non_orthogonality_rad: float
    T_sensor_carm: Array
    """(4, 4)."""
    T_link_sensor: Array
    """(4, 4): the tracked sensor in the frame of the URDF's sensor link as it was nominally."""


@dataclass(frozen=True, eq=False)
class BasePlacement:
    """Where the URDF's base stands in the world."""

    label: str
    T_world_base: Array
    """(4, 4)."""


@dataclass(frozen=True, eq=False)
class Origin:
    """An ``<origin>`` of the URDF with its calibrated number."""

    joint: str
    """Its name in the URDF, fixed joints included."""
    T_parent_joint: Array
    """(4, 4)."""


@dataclass(frozen=True)
class PoseError:
    """Root mean squares over the used poses."""

    translation_rms_m: float
    """Length of the position residual."""
    rotation_rms_rad: float
    """Rotation angle of the orientation residual."""


@dataclass(frozen=True, eq=False)
class ChainCalibration:
    """A machine calibrated as a chain of joints."""

    urdf: str
    """Name of the file."""
    base_link: str
    bases: tuple[BasePlacement, ...]
    sensors: tuple[SensorGeometry, ...]
    joints: tuple[JointChange, ...]
    """Those of which something was set free and estimated."""
    origins: tuple[Origin, ...]
    """Those that changed, as `carm_kin.machine.urdf.patch_origins` takes them; zero offsets are in them, gains not."""
    not_identifiable: tuple[str, ...]
    """What was set free and stays at its nominal value, and why, in words."""
    nominal: PoseError
    """What the URDF's own numbers leave, base and mount fitted."""
    calibrated: PoseError
    reading_sigma_rad: float | None
    """Noise of the readings of angles; None where there are none, or they count as exact."""
    reading_sigma_m: float | None
    """The same of lengths."""
