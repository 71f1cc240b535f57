"""Held-out poses of a pointer: how far its tip is from the point about which it turns."""

import numpy as np

from carm_kin.recording.recording import Recording
from carm_kin.results.held_out import Errors
from carm_kin.results.result import CalibrationResult
from solvers.estimate import Note
from solvers.pivot import whitened_square
from solvers.problem import Problem


def placement_gone(recording: Recording, rest: np.ndarray) -> Note | None:
    """A refusal where a placement has none of the poses ``rest`` (N,) from which a fold is fitted."""
    left = set(recording.placement_number[rest])
    gone = [f"'{label}'" for k, label in enumerate(recording.placements) if k not in left]
    return Note("too_few_poses", f"no pose of placement {', '.join(gone)} is left to fit") if gone else None


def point_refusal(recording: Recording, problem: Problem, fit: CalibrationResult, rest: np.ndarray) -> Note | None:
    """Why the fit to the ``rest`` (N,) cannot predict the other poses."""
    if refusal := placement_gone(recording, rest) or fit.refusal:
        return refusal
    if fit.offset_sensor_pivot_m is None:
        return Note("partial", f"not told: {'; '.join(fit.observability.unobservable)}")
    return None


def point_errors(recording: Recording, problem: Problem, fit: CalibrationResult, scored: np.ndarray) -> Errors:
    """Errors of R_i t + p_i = c at the ``scored`` poses (N,), with the noise of the fit along and across the lever."""
    found = {placement.label: placement.torus_center_world_m for placement in fit.placements}
    c, t = np.array([found[label] for label in recording.placements]), fit.offset_sensor_pivot_m
    assert t is not None
    part, noise = problem.select(scored), fit.noise
    error = part.rotations @ t + part.p_world_sensor - c[part.placement]
    along, turn = (noise.translation_m or 0.0) ** 2, (noise.rotation_rad or 0.0) ** 2
    chi2 = whitened_square(part, t, c, max(along, np.finfo(float).tiny), turn)
    return Errors(len(part), float((error**2).sum()), np.nan, chi2, 3.0 * len(part))
