"""Held-out check of a chain's calibration: every part of the recordings predicted by the fit to the other parts."""

from collections.abc import Sequence

import numpy as np

from carm_kin.calibrate_chain import FreeJoints, fit, free_of
from carm_kin.chain_model import ChainModel
from carm_kin.cross_validate import fold_of_poses
from carm_kin.errors import RefusedError
from carm_kin.held_out import CrossValidation, Errors, HeldOut, overall_of, row_of
from carm_kin.recording import Recording
from solvers.chain import ChainEstimate, Options, residuals
from solvers.chain_problem import ORIENTATIONS, POSITIONS, ChainProblem
from solvers.chain_values import fit_values
from solvers.estimate import Note

STEPS = 6
"""Gauss-Newton steps for the unknown joint values of the held-out poses."""


def cross_validate_chain(
    recordings: Sequence[Recording],
    problem: ChainProblem,
    model: ChainModel,
    folds: int,
    free: FreeJoints = FreeJoints(),
    options: Options = Options(),
) -> CrossValidation:
    """Predict every fold with the machine, bases and mounts of the fit to the others.

    ``problem`` holds the poses of the ``recordings``, as `carm_kin.chain_problem.gather` makes it. The folds are those
    of `carm_kin.cross_validate.fold_of_poses` in each recording. Unknown joint values of the held-out poses are fitted
    to these poses. Raises InputError as that does, RefusedError where all poses together are refused.
    """
    number = np.concatenate([fold_of_poses(recording, folds) for recording in recordings])
    sweeps = np.concatenate([_sweeps(recording) for recording in recordings])
    unknown = free_of(model, free)
    whole = fit(problem, model, unknown, options)
    if isinstance(whole, Note):
        raise RefusedError(whole.code, whole.message)
    rows: list[HeldOut] = []
    sums: list[Errors] = []
    for fold in range(folds):
        held = number == fold
        scored = np.flatnonzero(held & whole[1].used)
        labels = tuple(dict.fromkeys(str(label) for label in sweeps[held] if label))
        found = fit(problem.select(np.flatnonzero(~held)), model, unknown, options)
        refusal = found if isinstance(found, Note) else None
        if not isinstance(found, Note):
            sums.append(_predicted(problem.select(scored), found[1], whole[1].values[scored]))
        rows.append(row_of(f"fold {fold + 1}", labels, len(scored), None if refusal else sums[-1], refusal))
    return CrossValidation(folds, overall_of(rows, sums), tuple(rows))


def _sweeps(recording: Recording) -> np.ndarray:
    return np.full(len(recording), "") if recording.sweep is None else recording.sweep


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
