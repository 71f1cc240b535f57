"""The parts of a calibration's result: metres and radians, one sigma where a number has one."""

from collections.abc import Mapping
from dataclasses import dataclass

from carm_kin.recording.intake import Intake
from solvers.se3 import Array


@dataclass(frozen=True, eq=False)
class Placement:
    """Where the C-arm's torus stands in the world, for one base placement."""

    label: str
    torus_center_world_m: Array
    """(3,)."""
    angular_axis_world: Array | None
    """(3,) unit; None where the locus has no axes."""
    T_world_torus: Array | None
    """(4, 4), m; None where the solver gives no complete chain."""
    referenced: bool
    """Whether alpha = 0 comes from labels; else it is a convention."""


@dataclass(frozen=True, eq=False)
class PlacementSigma:
    """One-sigma values of a placement."""

    torus_center_world_m: Array | None
    angular_axis_world: Array | None


@dataclass(frozen=True, eq=False)
class Sigma:
    """One-sigma values under the names of the result; None where the solver gives none, or the number was fixed."""

    offset_sensor_pivot_m: Array | None = None
    major_radius_m: float | None = None
    minor_radius_m: float | None = None
    axis_non_orthogonality_rad: float | None = None
    orbital_axis_sensor: Array | None = None
    placements: tuple[PlacementSigma, ...] = ()


@dataclass(frozen=True, eq=False)
class ToldDirection:
    """One component of the offset that the motion tells."""

    direction_sensor: Array
    """(3,) unit, in the sensor's frame."""
    offset_m: float
    """The offset along it."""
    sigma_m: float
    """Within 250 mm of the sensor along the untold direction, which may be off by its own sigma."""


@dataclass(frozen=True, eq=False)
class ToldOffset:
    """What is told of an offset that the motion tells in part.

    Where one direction is untold, the pivot lies on the line through `nearest_sensor_m` along it: that of a tool's
    shaft about which the tool was spun.
    """

    told: tuple[ToldDirection, ...]
    """Of orthogonal directions."""
    untold_directions_sensor: tuple[Array, ...]
    """(3,) each, unit, orthogonal to the told ones; no number along them is known."""
    untold_sigma_rad: tuple[float, ...]
    """By how much each of the untold directions may be off."""
    nearest_sensor_m: Array
    """(3,) the point of the line (or plane) of all possible pivots that is nearest the sensor's origin."""


@dataclass(frozen=True, eq=False)
class SigmaPart:
    """What one cause adds to the one-sigma values: the squares of the parts add up."""

    cause: str
    """``noise``, ``correlation`` (that the noise lasts), or a systematic effect."""
    offset_sensor_pivot_m: Array
    """(3,)."""
    major_radius_m: float
    """0 of a fixed point."""


@dataclass(frozen=True)
class TrackerScale:
    """By which all positions were multiplied, from a length that was known."""

    scale: float
    """True over tracked."""
    sigma: float
    known_length: str
    """As it was given."""


@dataclass(frozen=True)
class SystematicEffect:
    """An effect beside the noise, as it shows in the poses: root mean squares over them."""

    name: str
    """One of `solvers.effects.columns.EFFECTS`."""
    position_m: float
    """Displacement of the sensor."""
    rotation_rad: float
    """Its turn."""


@dataclass(frozen=True, eq=False)
class NoiseAxes:
    """The tracker's axes of least and most noise: one standard deviation along each."""

    translation_m: Array
    """(3,) least first, along"""
    translation_axes_world: tuple[Array, ...]
    """(3,) each, unit."""
    rotation_rad: Array
    """(3,) of turns about"""
    rotation_axes_world: tuple[Array, ...]
    """(3,) each, unit."""


@dataclass(frozen=True)
class NoiseLevel:
    """One standard deviation an axis, root mean square over the axes."""

    translation_m: float | None
    rotation_rad: float | None
    estimated: bool
    translation_correlation_poses: float | None = None
    """For how many poses the noise of the positions lasts: 1 where it is white, None where nothing was estimated."""
    rotation_correlation_poses: float | None = None
    effective_poses: float | None = None
    """The used poses over the longer of both: so many independent ones would tell as much."""
    axes: NoiseAxes | None = None
    """None where the noise is the same along all axes."""


@dataclass(frozen=True)
class Residuals:
    """What the model leaves of the used poses."""

    label: str
    """The sweep, or ``overall``."""
    translation_rms_m: float
    """Root mean square length of the position residual."""
    rotation_rms_rad: float | None
    """Root mean square rotation angle."""
    chi2_per_dof: float | None
    """None where the noise was not given and is therefore estimated from these residuals."""
    poses: int


@dataclass(frozen=True)
class Rejection:
    """Poses that were not used for one and the same reason, numbered as in the recording's file."""

    reason: str
    """In words, such as ``identical to the pose before``."""
    count: int
    indices: tuple[int, ...]


@dataclass(frozen=True)
class Outliers:
    """Poses that were not used, numbered as in the recording's file."""

    count: int
    indices: tuple[int, ...]
    reasons: tuple[Rejection, ...] = ()
    """Why, for as many of them as it is known; each pose stands under one reason at most."""


@dataclass(frozen=True, eq=False)
class Observability:
    """What the data determine."""

    singular_values: Array
    """Of the information matrix scaled to a unit diagonal, largest first."""
    condition: float | None
    unobservable: tuple[str, ...]
    """In words."""


@dataclass(frozen=True)
class Provenance:
    """Where a result comes from."""

    versions: Mapping[str, str]
    input_name: str | None
    input_sha256: str | None
    command: str | None
    seed: int | None
    date: str
    intakes: tuple[Intake, ...] = ()
    """How the input was read, and what was dropped."""
