"""Recordings of a machine and its URDF -> the machine calibrated as a chain of joints."""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from carm_kin.calibration.calibrate import check_noise, wrong_unit
from carm_kin.calibration.chain.assembly import SOLVER, Blank, Recorded, result_of_chain
from carm_kin.calibration.chain.checks import units_mixed
from carm_kin.calibration.chain.model import ChainModel, chain_model
from carm_kin.calibration.chain.problem import gather, sensor_links_of, sensor_numbers
from carm_kin.calibration.chain.told import at_rest, untold
from carm_kin.calibration.options import options_of
from carm_kin.calibration.settings import AUTO, effects_of
from carm_kin.errors import InputError, wrong_type
from carm_kin.machine.chain import chain_of
from carm_kin.machine.urdf import UrdfFile, as_urdf, listing
from carm_kin.recording.duplicates import NotMeasured
from carm_kin.recording.formats import RecordingLike, as_recordings
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult
from carm_kin.steps import step
from solvers.chain.chain import ChainEstimate, Free, Options, solve_chain
from solvers.chain.problem import ChainProblem
from solvers.chain.start import start_of
from solvers.effects.of_chain import chain_systematic
from solvers.estimate import Note
from solvers.verdict.limits import Limits

ALL, AXES, NONE = "all", "axes", "none"


@dataclass(frozen=True)
class FreeJoints:
    """What of the URDF's numbers is unknown: names of joints, or ``all``, ``axes`` (the two main ones), ``none``.

    Names may also stand in one text, comma between. Raises InputError for what holds no names.
    """

    placements: tuple[str, ...] = (ALL,)
    zeros: tuple[str, ...] = (NONE,)
    gains: tuple[str, ...] = (NONE,)

    def __post_init__(self) -> None:
        for name in ("placements", "zeros", "gains"):
            object.__setattr__(self, name, _names(getattr(self, name)))

    def in_words(self) -> dict[str, str]:
        """As the options of the command have it."""
        groups = {"free": self.placements, "zeros": self.zeros, "gains": self.gains}
        return {name: ",".join(joints) for name, joints in groups.items()}


def _names(given: object) -> tuple[str, ...]:
    """The names in a text, comma between, or in a sequence."""
    names = given.split(",") if isinstance(given, str) else given
    if not isinstance(names, (list, tuple)) or not all(isinstance(name, str) for name in names):
        raise wrong_type(given, "what is free (names of joints, 'all', 'axes' or 'none', or a FreeJoints)")
    return tuple(name.strip() for name in names)


NOTHING = FreeJoints((NONE,), (NONE,), (NONE,))


def calibrate_chain(
    recordings: RecordingLike | Sequence[RecordingLike],
    urdf: UrdfFile | str | os.PathLike,
    *,
    free: FreeJoints | str | Sequence[str] = FreeJoints(),
    sensor_link: str | None = None,
    angular: str | None = None,
    orbital: str | None = None,
    sigma_t_m: float | None = None,
    sigma_r_rad: float | None = None,
    sigma_reading_rad: float | None = None,
    sigma_reading_m: float | None = None,
    systematic: str | Sequence[str] = AUTO,
    folds: int | None = None,
    limits: Limits = Limits(),
    command: str | None = None,
    **options: Any,
) -> CalibrationResult:
    """Calibrate the chain of a URDF (a path or a bundled name) from one or several recordings
    or paths of them.

    The base in the world of every placement and the mount of every sensor are unknown; ``free`` says which numbers
    of the URDF are: a FreeJoints, or the joints whose origin is, such as ``"axes"`` or ``"angular, lift"``. A column
    ``sensor`` of a recording names the link that carries each pose's sensor, else ``sensor_link`` does. Noises (m,
    rad; of the tracker an axis, of the joint readings) are estimated unless given; 0 takes the readings as exact.
    ``systematic`` are the effects for which the ± allows, as in `carm_kin.calibrate`: the tracker's field, and drift.
    With ``folds`` the result holds the held-out check. ``options`` are those of `solvers.chain.Options`. The result's
    `chain` holds the joints; its other numbers are those of the first sensor's two axes. A refusal is a result, not an
    exception.

    Raises InputError for bad names, options and recordings without orientations.
    """
    parts, file = as_recordings(recordings), as_urdf(urdf)
    free = free if isinstance(free, FreeJoints) else FreeJoints(_names(free))
    model = _model(parts, file, sensor_link, angular, orbital)
    chosen, unknown = options_of(Options, SOLVER, options), free_of(model, free)
    sigma = (sigma_t_m, sigma_r_rad, sigma_reading_rad, sigma_reading_m)
    _check_noise(sigma)
    recorded = Recorded(parts, tuple(_not_measured(part, model) for part in parts))
    gathered = gather(recorded.kept, model, sigma)
    blank = Blank(recorded, asdict(chosen) | free.in_words(), command)
    if len(gathered.problem) < limits.min_poses:
        words = f"{len(gathered.problem)} poses; at least {limits.min_poses} are needed"
        return blank.refused(Note("too_few_poses", words), gathered.notes)
    T = gathered.problem.T_world_sensor
    wrong = wrong_unit(T[:, :3, 3], T[:, :3, :3]) or units_mixed(gathered.problem)
    estimate = wrong or fit(gathered.problem, model, unknown, chosen, limits)
    if isinstance(estimate, Note):
        return blank.refused(estimate, gathered.notes)
    with step("look for systematic effects"):
        found = chain_systematic(gathered.problem, estimate, effects_of(systematic))
    estimate = found.allowed(estimate) if found else estimate
    nominal = nominal_fit(gathered.problem, model, estimate)
    result = result_of_chain(model, gathered, unknown, nominal, estimate, blank, limits)
    if folds is None or result.refusal:
        return result
    from carm_kin.calibration.chain.cross_validate import cross_validate_chain

    held_out = cross_validate_chain(recorded.kept, gathered.problem, model, estimate, folds, unknown, chosen)
    return replace(result, cross_validation=held_out)


def _model(
    parts: Sequence[Recording], file: UrdfFile, sensor_link: str | None, angular: str | None, orbital: str | None
) -> ChainModel:
    """The machine with the sensors that the recordings name, or the one asked for."""
    links = sensor_links_of(parts, sensor_link)
    known = tuple(link or chain_of(file, None, angular, orbital).sensor_link for link in links)
    return chain_model(file, tuple(dict.fromkeys(known)), angular, orbital)


def _not_measured(recording: Recording, model: ChainModel) -> NotMeasured:
    """The poses of each sensor that are no measurements of their own."""
    sensor, R = sensor_numbers(recording, model.sensor_links), recording.R_world_sensor
    masks = {reason: np.zeros(len(recording), dtype=bool) for reason in NotMeasured.REASONS}
    for s in np.unique(sensor):
        here = sensor == s
        found = NotMeasured.of(recording.p_world_sensor[here], None if R is None else R[here])
        for reason, mask in found.reasons.items():
            masks[reason][here] = mask
    return NotMeasured(masks)


@step("solve by chain")
def fit(
    problem: ChainProblem, model: ChainModel, free: Free, options: Options, limits: Limits = Limits()
) -> ChainEstimate | Note:
    """The calibrated machine, or why there is none. Joints that hardly move in all poses keep their numbers: by the
    values that the fit starts with, and by those that it ends with."""
    if note := untold(problem):
        return note
    start = start_of(problem, model.machine, [model.axes(s) for s in range(len(model.chains))])
    if isinstance(start, Note):
        return start
    try:
        placed = solve_chain(problem, start.machine, start.values, free_of(model, NOTHING), options, start.agrees)
        begin = placed.machine if placed.converged else start.machine
        values = np.where(problem.read, problem.label, start.values)
        moving = free.only(~at_rest(problem, values, limits))
        found = solve_chain(problem, begin, values, moving, options, start.agrees)
        still = at_rest(problem, found.values, limits)
        if not (still & (moving.placements | moving.offsets | moving.gains)).any():
            return found
        return solve_chain(problem, begin, values, moving.only(~still), options, start.agrees)
    except np.linalg.LinAlgError:
        return Note("unobservable", "the poses determine no machine: the equations are singular")


@step("fit the nominal URDF")
def nominal_fit(problem: ChainProblem, model: ChainModel, estimate: ChainEstimate) -> ChainEstimate:
    """The URDF's own machine, base and mounts fitted to the same poses with the same noise as the ``estimate``."""
    machine = estimate.machine
    placed = replace(model.machine, T_world_base=machine.T_world_base, T_last_sensor=machine.T_last_sensor)
    sigma = tuple(0.0 if given == 0 else float(s) for given, s in zip(problem.sigma, estimate.sigma, strict=True))
    nothing, options = free_of(model, NOTHING), Options(reject_outliers=False)
    return solve_chain(replace(problem, sigma=sigma), placed, estimate.values, nothing, options, estimate.used)


def free_of(model: ChainModel, free: FreeJoints) -> Free:
    """The masks of the joints. Raises InputError for a name that the chain does not have."""
    axes = {model.names[j] for s in range(len(model.chains)) for j in model.axes(s)}

    def mask(names: tuple[str, ...], possible: tuple[str, ...]) -> np.ndarray:
        groups = {ALL: set(possible), AXES: axes & set(possible), NONE: set()}
        for name in names:
            if name not in groups and name not in possible:
                valid = listing((ALL, AXES, NONE, *possible))
                raise InputError(f"no joint of the chain is named {name!r}; valid: {valid}", file=model.urdf.path)
        chosen = set().union(*(groups.get(name, {name}) for name in names))
        return np.array([name in chosen for name in model.names])

    in_file = tuple(name for name, carried in zip(model.names, model.carried, strict=True) if carried)
    return Free(mask(free.placements, in_file), mask(free.zeros, in_file), mask(free.gains, model.names))


def _check_noise(sigma: tuple[float | None, ...]) -> None:
    names = ("sigma_t_m", "sigma_r_rad", "sigma_reading_rad", "sigma_reading_m")
    for name, value in zip(names, sigma, strict=True):
        exact = name.startswith("sigma_reading") and value == 0
        if not exact:
            check_noise(name, value)
