"""Held-out check of a chain's calibration: every part of the recordings predicted by the fit to the other parts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from carm_kin.calibration.chain.model import ChainModel
from carm_kin.calibration.chain.told import left_at_rest
from carm_kin.calibration.cross_validate import fold_of_poses, nothing_left
from carm_kin.recording.recording import Recording
from carm_kin.results.held_out import CrossValidation, Errors, HeldOut, overall_of, row_of
from carm_kin.steps import step
from solvers.chain.chain import ChainEstimate, Free, Options, residuals, solve_chain
from solvers.chain.problem import ORIENTATIONS, POSITIONS, ChainProblem
from solvers.chain.start import fit_values
from solvers.estimate import Note

STEPS = 6
"""Gauss-Newton steps for the unknown joint values of the held-out poses."""


@step("predict the held-out parts")
def cross_validate_chain(
    recordings: Sequence[Recording],
    problem: ChainProblem,
    model: ChainModel,
    whole: ChainEstimate,
    folds: int,
    free: Free,
    options: Options,
) -> CrossValidation:
    """Predict every fold with the machine, bases and mounts of the fit to the others.

    ``problem`` holds the poses of the ``recordings``, as `carm_kin.calibration.chain.problem.gather` makes it, and
    ``whole`` is the fit to all of them; poses that it rejects are not scored. The folds are those of
    `carm_kin.calibration.cross_validate.fold_of_poses` in each recording. Unknown joint values
    of the held-out poses are fitted to these poses. Raises InputError as that does.
    """
    number = np.concatenate([fold_of_poses(recording, folds) for recording in recordings])
    sweeps = np.concatenate([_sweeps(recording) for recording in recordings])
    rows: list[HeldOut] = []
    sums: list[Errors] = []
    for fold in range(folds):
        held = number == fold
        scored = held & whole.used
        labels = tuple(dict.fromkeys(str(label) for label in sweeps[held] if label))
        found = nothing_left(scored) or _fit_to(problem, ~held, model, whole, free, options)
        if isinstance(found, Note):
            rows.append(row_of(f"fold {fold + 1}", labels, scored.sum(), None, found))
            continue
        sums.append(_predicted(problem.select(np.flatnonzero(scored)), found, whole.values[scored]))
        rows.append(row_of(f"fold {fold + 1}", labels, scored.sum(), sums[-1], None))
    return CrossValidation(folds, overall_of(rows, sums), tuple(rows))


def _sweeps(recording: Recording) -> np.ndarray:
    return np.full(len(recording), "") if recording.sweep is None else recording.sweep


def _fit_to(
    problem: ChainProblem, rest: np.ndarray, model: ChainModel, whole: ChainEstimate, free: Free, options: Options
) -> ChainEstimate | Note:
    """The fit to the ``rest`` (N,) of the poses, or why they do not suffice. It starts from the URDF's numbers, where
    the fit to all found base and mounts, so that unknown zeros stay where they are."""
    machine = whole.machine
    start = replace(model.machine, T_world_base=machine.T_world_base, T_last_sensor=machine.T_last_sensor)
    part = problem.select(np.flatnonzero(rest))
    moving = free.only(~left_at_rest(whole, free))
    try:
        found = solve_chain(part, start, whole.values[rest], moving, options, whole.used[rest])
    except np.linalg.LinAlgError:
        return Note("unobservable", "the other poses determine no machine: the equations are singular")
    shared = slice(0, whole.layout.constant(0))
    fewer = int(whole.active[shared].sum() - found.active[shared].sum())
    if fewer > 0:
        return Note("unobservable", f"the other poses determine {fewer} unknowns fewer than all poses do")
    return found if found.converged else Note("not_converged", "the fit to the other poses does not converge")


def _predicted(problem: ChainProblem, estimate: ChainEstimate, values: np.ndarray) -> Errors:
    """Errors of the poses, their unknown joint values fitted to them from ``values`` (N, J)."""
    values, at = fit_values(problem, estimate.machine, values, estimate.sigma, STEPS)
    left = residuals(estimate.machine, values, problem)
    poses = slice(POSITIONS, ORIENTATIONS + 1)
    return Errors(
        len(problem),
        float((left[:, :3] ** 2).sum()),
        float((left[:, 3:] ** 2).sum()),
        float(at.squares[poses].sum()),
        float(at.counts[poses].sum()) - problem.constants,
    )
