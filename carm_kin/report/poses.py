"""What is known of every pose of a recording under a result: angles, residuals, and the group it is drawn in."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from carm_kin.calibration.cross_validate import torus_of
from carm_kin.calibration.problem import to_problem
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.report.colours import RAMPS, SERIES, ramp
from carm_kin.results.result import CalibrationResult
from solvers.kinematic import fit_angles
from solvers.likelihood.linearise import AngleModel, linearise
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array, rot_y
from solvers.torus import Torus

MOST_SHOWN, MOST_SAMPLED = 2000, 500
"""More poses than this are not drawn one by one, in the view of space and in each panel of residuals."""
MOST_GROUPS = 8
"""With more groups of poses their base placements are not told apart."""
MOST_LETTERS = 40
"""Longer labels are cut."""


@dataclass(frozen=True)
class Joints:
    """The names of the two joints in the recording."""

    angular: str = "angular"
    orbital: str = "orbital"


@dataclass(frozen=True, eq=False)
class Fit:
    """The chain of a result, and what it leaves of the N poses. m and rad."""

    torus: Torus
    angles: Array
    """alpha, beta (N, 2); of poses that were not used, those that suit them best."""
    residual: Array
    """(N, 6) position, then rotation vector, along the angular axis, the orbital axis and the common perpendicular."""
    expected: Array
    """(N, 6) standard deviations that the noise would give it, the share that the fitted unknowns absorb left out."""


@dataclass(frozen=True, eq=False)
class Group:
    """Poses that are drawn alike."""

    name: str
    member: np.ndarray
    """(N,) mask."""
    symbol: str


@dataclass(frozen=True, eq=False)
class Poses:
    """The N poses of a recording as the figures need them."""

    recording: Recording
    used: np.ndarray
    """(N,) whether a pose had a say in the result."""
    colour: np.ndarray
    """(N,) #rrggbb, by sweep, or by placement where there are no sweeps."""
    groups: tuple[Group, ...]
    words: np.ndarray
    """(N,) what is said of each pose."""
    shown: np.ndarray
    """(N,) mask of those that are drawn in space."""
    sampled: np.ndarray
    """(N,) mask of those whose residuals are drawn, the largest among them."""
    fit: Fit | None
    why: str
    """Why there is no fit, in words; "" where there is one."""


def poses_of(result: CalibrationResult, recording: Recording, joints: Joints = Joints()) -> Poses:
    """Look at every pose of ``recording`` with the eyes of ``result``, which was made from it.

    Raises InputError where it was not.
    """
    _check_same(result, recording)
    used = ~np.isin(recording.pose_number, result.outliers.indices)
    fit, why = _fit(result, recording, joints, used)
    colour, groups = _groups(recording, joints)
    shown, sampled = (_some(used, fit, most) for most in (MOST_SHOWN, MOST_SAMPLED))
    return Poses(recording, used, colour, groups, _words(recording, fit), shown, sampled, fit, why)


def _check_same(result: CalibrationResult, recording: Recording) -> None:
    """Raise InputError where the numbers of poses or the digests of the files say that there are two recordings."""
    made, source = result.provenance, recording.source
    right = f"give the one that the result was made from{f', {made.input_name}' if made.input_name else ''}"
    if result.poses != len(recording):
        words = f"the result is of another recording: it was made from {result.poses} poses, this has {len(recording)}"
        raise InputError(f"{words}; {right}", file=source.path if source else None)
    if source and made.input_sha256 and made.input_sha256 != source.sha256:
        raise InputError(f"the result is of another recording: the files' SHA-256 differ; {right}", file=source.path)


def together(recordings: Sequence[Recording]) -> Recording:
    """One recording as it is. Of several all positions and orientations, each recording a placement of its own, the
    numbers of the poses counted on, frames without a pose included."""
    if len(recordings) == 1:
        return recordings[0]
    numbers, first = [], 0
    for recording in recordings:
        numbers.append(recording.pose_number + first)
        first += max(len(recording) + recording.missing, int(recording.pose_number.max(initial=-1)) + 1)
    rotations = [r.R_world_sensor for r in recordings if r.R_world_sensor is not None]
    labels = [f"recording {k + 1}" for k in range(len(recordings))]
    return Recording(
        np.concatenate([r.p_world_sensor for r in recordings]),
        np.concatenate(rotations) if len(rotations) == len(recordings) else None,
        placement=np.repeat(labels, [len(r) for r in recordings]),
        pose_number=np.concatenate(numbers),
    )


def _fit(result: CalibrationResult, recording: Recording, joints: Joints, used: np.ndarray) -> tuple[Fit | None, str]:
    if result.refusal:
        return None, "a refused result has no machine to compare the poses with"
    if recording.R_world_sensor is None:
        return None, "the recording has no orientations"
    if result.T_sensor_carm is None:
        return None, "the result holds no complete chain, and so no angles"
    try:
        torus = torus_of(result, recording.placements)
        problem = to_problem(recording, joints.angular, joints.orbital)
    except InputError as error:
        return None, str(error)
    label = np.full_like(problem.label, np.nan) if result.chain else _own_labels(problem, torus)
    noise = result.noise
    known = replace(problem, label=label, sigma_t=noise.translation_m, sigma_r=noise.rotation_rad)
    angles = np.empty((2, len(recording)))
    if used.any():
        angles[:, used] = fit_angles(known.select(used), torus)[0]
    if result.angles_rad is not None:
        angles[:, used] = result.angles_rad[used].T
    if not used.all():
        angles[:, ~used] = fit_angles(_held_as_used(known, angles, used).select(~used), torus)[0]
    return Fit(torus, angles.T, *_residuals(known, torus, angles, used)), ""


def _held_as_used(problem: Problem, angles: Array, used: np.ndarray) -> Problem:
    """The problem with the ``angles`` (2, N) of the ``used`` poses of a sweep as its exact labels, where it has any."""
    if problem.sigma_label is None:
        return problem
    label, sigma_label = problem.label.copy(), problem.sigma_label.copy()
    for joint in (0, 1):
        read = problem.label_read[:, joint]
        for sweep in np.unique(problem.held[read & used, joint]):
            own = read & (problem.held[:, joint] == sweep)
            label[own, joint] = angles[joint, own & used][0]
            sigma_label[own, joint] = 0.0
    return replace(problem, label=label, sigma_label=sigma_label)


def _own_labels(problem: Problem, torus: Torus) -> Array:
    """(N, 2) the labels, less those of an angle whose zero is not theirs."""
    label = problem.label.copy()
    label[~torus.referenced[problem.placement], ANGULAR] = np.nan
    if not torus.orbital_referenced:
        label[:, ORBITAL] = np.nan
    return label


def _residuals(problem: Problem, torus: Torus, angles: Array, used: np.ndarray) -> tuple[Array, Array]:
    """`Fit.residual` and `Fit.expected`.

    With A the derivative by the pose's own free angles and S the noise, the residual has the covariance
    S - A inv(A' inv(S) A + P) A', P the precision of the readings; what the machine absorbs is taken off evenly.
    """
    model, line = AngleModel.of(problem), linearise(torus, angles, problem)
    sigma = np.repeat([problem.sigma_t or 1.0, problem.sigma_r or 1.0], 3)
    A = line.by_angle.transpose(2, 0, 1) * model.free.T[:, None]
    G = np.einsum("nij,i,nik->njk", A, sigma**-2.0, A) + (model.precision.T + ~model.free.T)[:, :, None] * np.eye(2)
    covariance = np.diag(sigma**2) - A @ np.linalg.solve(G, A.transpose(0, 2, 1))
    turn = np.zeros((len(problem), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rot_y(angles[1])
    variance = np.einsum("nij,njk,nik->ni", turn, covariance, turn)
    redundancy = 6 * used.sum() - model.free[:, used].sum()
    left = 1 - _unknowns(torus, problem, model) / max(redundancy, 1)
    return np.einsum("nij,jn->ni", turn, line.residual), np.sqrt(np.maximum(variance * max(left, 0.0), 0.0))


def _unknowns(torus: Torus, problem: Problem, model: AngleModel) -> int:
    """How many numbers of the machine the poses determined."""
    fixed = (~torus.referenced).sum() + (not torus.orbital_referenced) + (torus.non_orthogonality == 0)
    return 6 * problem.placements + 8 - int(fixed) + len(model.sweep_placement)


def _groups(recording: Recording, joints: Joints) -> tuple[np.ndarray, tuple[Group, ...]]:
    """The colour of each pose, and its group: by the joint that moves, by placement, by having no sweep."""
    kind = _kinds(recording, joints)
    colour = np.array(SERIES, dtype=object)[recording.placement_number % len(SERIES)]
    for moving, ends in RAMPS.items():
        sweeps = [s.poses for s in recording.sweeps if kind[s.poses[0]] == moving]
        for poses, shade in zip(sweeps, ramp(ends, len(sweeps)), strict=True):
            colour[poses] = shade
    several = len(recording.placements) > 1
    place = recording.placement_number if several else np.zeros(len(recording), dtype=int)
    pairs = sorted({(str(k), int(p)) for k, p in zip(kind, place, strict=True)})
    if len(pairs) > MOST_GROUPS:
        several, place, pairs = False, np.zeros_like(place), sorted({(str(k), 0) for k in kind})
    symbols = ("circle", "square", "diamond")
    groups = tuple(
        Group(
            _KINDS[k] + (f", placement {short(recording.placements[p])}" if several else ""),
            (kind == k) & (place == p),
            symbols[p % len(symbols)],
        )
        for k, p in pairs
    )
    return colour, groups


_KINDS = {
    "angular": "poses of angular sweeps",
    "orbital": "poses of orbital sweeps",
    "": "poses of other sweeps",
    "-": "poses",
}


def _kinds(recording: Recording, joints: Joints) -> np.ndarray:
    """(N,) the main joint that moves, "" in a sweep of which it is not known, "-" without a sweep."""
    kind = np.where(recording.sweep_number >= 0, "", "-").astype(object)
    if recording.moving is not None:
        for name, joint in (("angular", joints.angular), ("orbital", joints.orbital)):
            kind[(recording.moving == joint) & (recording.sweep_number >= 0)] = name
    return kind


def _words(recording: Recording, fit: Fit | None) -> np.ndarray:
    """(N,) number, sweep, placement and angles of each pose."""
    words = [f"pose {number}" for number in recording.pose_number]
    labels = [short(sweep.label) for sweep in recording.sweeps]
    if labels:
        words = [
            f"{text}, sweep {labels[s]}" if s >= 0 else text
            for text, s in zip(words, recording.sweep_number, strict=True)
        ]
    if len(recording.placements) > 1:
        names = [short(name) for name in recording.placements]
        words = [f"{text}, placement {names[p]}" for text, p in zip(words, recording.placement_number, strict=True)]
    if fit is not None:
        degrees = np.degrees(np.angle(np.exp(1j * fit.angles)))
        words = [f"{text}; α {a:.1f}°, β {b:.1f}°" for text, (a, b) in zip(words, degrees, strict=True)]
    return np.array(words, dtype=object)


def _some(used: np.ndarray, fit: Fit | None, most: int) -> np.ndarray:
    """(N,) mask of evenly picked poses, and of those with the largest residuals."""
    some = np.zeros(len(used), dtype=bool)
    for part in (np.flatnonzero(used), np.flatnonzero(~used)):
        some[part[:: max(1, -(-len(part) // most))]] = True
    if fit is not None and not some.all():
        size = np.where(used, (fit.residual[:, :3] ** 2).sum(axis=1), 0.0)
        some[np.argsort(size)[-most // 10 :]] = True
    return some


def short(label: str, most: int = MOST_LETTERS) -> str:
    """A label on one line, of ``most`` letters: what is too long loses its middle."""
    text = "".join(c if c.isprintable() else " " for c in label)
    head = (most - 1) // 2
    return text if len(text) <= most else f"{text[:head]}…{text[head + 1 - most :]}"
