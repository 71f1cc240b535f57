"""Recordings of a machine and its URDF -> the machine calibrated as a chain of joints."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin import result as r
from carm_kin.chain_assembly import SOLVER, Blank, result_of_chain
from carm_kin.chain_model import ChainModel, chain_model
from carm_kin.chain_problem import gather, sensor_links_of
from carm_kin.errors import InputError
from carm_kin.options import options_of
from carm_kin.provenance import provenance_of
from carm_kin.recording import Recording
from carm_kin.urdf import UrdfFile, listing, read_urdf
from solvers.chain import ChainEstimate, Free, Options, solve_chain
from solvers.chain_problem import ChainProblem
from solvers.chain_start import start_of
from solvers.estimate import Note
from solvers.limits import Limits

ALL, AXES, NONE = "all", "axes", "none"


@dataclass(frozen=True)
class FreeJoints:
    """What of the URDF's numbers is unknown: names of joints, or ``all``, ``axes`` (the two main ones), ``none``."""

    placements: tuple[str, ...] = (ALL,)
    zeros: tuple[str, ...] = (NONE,)
    gains: tuple[str, ...] = (NONE,)


NOTHING = FreeJoints((NONE,), (NONE,), (NONE,))


def calibrate_chain(
    recordings: Recording | Sequence[Recording],
    urdf: str | Path | UrdfFile,
    *,
    free: FreeJoints = FreeJoints(),
    sensor_link: str | None = None,
    angular: str | None = None,
    orbital: str | None = None,
    sigma_t_m: float | None = None,
    sigma_r_rad: float | None = None,
    sigma_reading_rad: float | None = None,
    sigma_reading_m: float | None = None,
    folds: int | None = None,
    limits: Limits = Limits(),
    command: str | None = None,
    **options: Any,
) -> r.CalibrationResult:
    """Calibrate the chain of a URDF (a path or a bundled name) from one or several recordings.

    The base in the world of every placement and the mount of every sensor are unknown; ``free`` says which numbers
    of the URDF are. A column ``sensor`` of a recording names the link that carries each pose's sensor, else
    ``sensor_link`` does. Noises (m, rad; of the tracker an axis, of the joint readings) are estimated unless given;
    0 takes the readings as exact. With ``folds`` the result holds the held-out check. ``options`` are those of
    `solvers.chain.Options`. The result's `chain` holds the joints; its other numbers are those of the first sensor's
    two axes. A refusal is a result, not an exception.

    Raises InputError for bad names, options and recordings without orientations.
    """
    parts = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not parts:
        raise InputError("no recording is given")
    file = urdf if isinstance(urdf, UrdfFile) else read_urdf(urdf)
    model = chain_model(file, sensor_links_of(parts, sensor_link), angular, orbital)
    chosen = options_of(Options, SOLVER, options)
    sigma = (sigma_t_m, sigma_r_rad, sigma_reading_rad, sigma_reading_m)
    _check_noise(sigma)
    gathered = gather(parts, model, sigma)
    blank = Blank(parts, asdict(chosen) | asdict(free), provenance_of(parts[0], command, None))
    if len(gathered.problem) < limits.min_poses:
        words = f"{len(gathered.problem)} poses; at least {limits.min_poses} are needed"
        return blank.refused(Note("too_few_poses", words), gathered.notes)
    found = fit(gathered.problem, model, free_of(model, free), chosen)
    if isinstance(found, Note):
        return blank.refused(found, gathered.notes)
    result = result_of_chain(model, gathered, *found, blank, limits)
    if folds is None or result.refusal:
        return result
    from carm_kin.cross_validate_chain import cross_validate_chain

    held_out = cross_validate_chain(parts, gathered.problem, model, folds, free, chosen)
    return replace(result, cross_validation=held_out)


def fit(
    problem: ChainProblem, model: ChainModel, free: Free, options: Options
) -> tuple[ChainEstimate, ChainEstimate] | Note:
    """The nominal machine with its base and mounts fitted, and the calibrated one; or why there is none."""
    start = start_of(problem, model.machine, [model.axes(s) for s in range(len(model.chains))])
    if isinstance(start, Note):
        return start
    moving = ~problem.still
    try:
        nominal = solve_chain(problem, start.machine, start.values, free_of(model, NOTHING), options, start.agrees)
        begin = nominal.machine if nominal.converged else start.machine
        values = np.where(problem.read, problem.label, start.values)
        return nominal, solve_chain(problem, begin, values, free.only(moving), options, start.agrees)
    except np.linalg.LinAlgError:
        return Note("unobservable", "the poses determine no machine: the equations are singular")


def free_of(model: ChainModel, free: FreeJoints) -> Free:
    """The masks of the joints. Raises InputError for a name that the chain does not have."""
    axes = {model.names[j] for s in range(len(model.chains)) for j in model.axes(s)}
    groups = {ALL: set(model.names), AXES: axes, NONE: set()}

    def mask(names: tuple[str, ...]) -> np.ndarray:
        for name in names:
            if name not in groups and name not in model.names:
                valid = listing((ALL, AXES, NONE, *model.names))
                raise InputError(f"no joint of the chain is named {name!r}; valid: {valid}", file=model.urdf.path)
        chosen = set().union(*(groups.get(name, {name}) for name in names))
        return np.array([name in chosen for name in model.names])

    return Free(mask(free.placements), mask(free.zeros), mask(free.gains))


def _check_noise(sigma: tuple[float | None, ...]) -> None:
    names = ("sigma_t_m", "sigma_r_rad", "sigma_reading_rad", "sigma_reading_m")
    for name, value in zip(names, sigma, strict=True):
        exact = name.startswith("sigma_reading") and value == 0
        if value is not None and not exact and not 0 < value < np.inf:
            raise InputError(f"{name} must be a finite number above 0, not {value}")
