"""From a solver's estimate and its assessment to the result that a user gets."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from carm_kin.calibration.problem import to_problem
from carm_kin.recording.ingest_checks import contradicted
from carm_kin.recording.recording import Recording
from carm_kin.results.deformation import Deformation, DeformationNode
from carm_kin.results.parts import (
    NoiseAxes,
    NoiseLevel,
    Observability,
    Outliers,
    Placement,
    PlacementSigma,
    Provenance,
    Rejection,
    Residuals,
    Sigma,
    SigmaPart,
    SystematicEffect,
    ToldDirection,
    ToldOffset,
)
from carm_kin.results.result import CalibrationResult
from carm_kin.results.shown import FIXED_SIGMA
from solvers.estimate import Correlation, Covariance, Deformed, EffectFound, Estimate, Note, Told
from solvers.estimate import SigmaPart as EstimatedPart
from solvers.problem import NoiseShape, Problem
from solvers.se3 import Array
from solvers.verdict.assess import Assessment


def result_of(
    recording: Recording,
    problem: Problem,
    estimate: Estimate,
    assessment: Assessment,
    options: Mapping[str, Any],
    provenance: Provenance,
) -> CalibrationResult:
    """The result of an estimate of ``problem``, which holds the poses of ``recording``, and of its assessment."""
    ok = assessment.refusal is None
    used = np.ones(len(recording), dtype=bool) if estimate.used is None else estimate.used
    torus, values = estimate.torus, assessment.singular_values
    parts = assessment.left_out if assessment.left_out and assessment.left_out.disagree else None
    covariance = parts.widened(estimate.covariance) if parts and estimate.covariance else estimate.covariance
    told = told_offset(estimate.told) if ok and estimate.told and not estimate.told.complete else None
    return CalibrationResult(
        status="refused" if not ok else "partial" if told else "doubtful" if parts else "ok",
        solver=estimate.solver,
        options=options,
        offset_sensor_pivot_m=estimate.offset if ok else None,
        major_radius_m=abs(estimate.major_radius) if ok and estimate.major_radius is not None else None,
        major_radius_signed_m=torus.major_radius if ok and torus else None,
        minor_radius_m=estimate.minor_radius if ok else None,
        axis_non_orthogonality_rad=torus.non_orthogonality + 0.0 if ok and torus else None,
        orbital_axis_sensor=torus.orbital_axis if ok and torus else None,
        placements=_placements(recording, estimate) if ok and told is None else (),
        T_sensor_carm=torus.T_sensor_carm if ok and torus else None,
        orbital_referenced=torus.orbital_referenced if torus else False,
        sigma=sigma_of(covariance, len(estimate.center)) if ok else Sigma(),
        covariance=covariance if ok else None,
        noise=noise_level(
            (assessment.sigma_t, assessment.sigma_r),
            None in (problem.sigma_t, problem.sigma_r),
            assessment.correlation,
            int(used.sum()),
            estimate.shape,
        ),
        residuals=_residuals("overall", assessment, slice(None), assessment.chi2_per_dof),
        residuals_per_sweep=_residuals_per_sweep(recording, assessment),
        poses=len(recording),
        used=int(used.sum()),
        outliers=_outliers(recording, used),
        observability=Observability(
            values, float(values[0] / max(values[-1], 1e-300)) if values.size else None, assessment.unobservable
        ),
        warnings=(
            *recording.warnings,
            *estimate.notes,
            *assessment.notes,
            *((parts.note,) if parts else ()),
            *contradicted(recording.intakes, assessment.notes),
            *_notes(estimate, ok and told is None),
        ),
        refusal=assessment.refusal,
        provenance=provenance,
        sigma_parts=sigma_parts_of(estimate.sigma_parts) if ok else (),
        effects=effects_found(estimate.effects) if ok else (),
        deformation=_deformation(estimate.deformed) if ok and estimate.deformed else None,
        angles_rad=assessment.angles if estimate.deformed is None else estimate.angles,
        told=told,
    )


def told_offset(told: Told) -> ToldOffset:
    """What is told of an offset, as a result states it."""
    rows = zip(told.directions, told.offset, told.sigma, strict=True)
    return ToldOffset(
        tuple(ToldDirection(d, float(x), float(s)) for d, x, s in rows),
        tuple(told.untold),
        tuple(float(s) for s in told.untold_sigma),
        told.offset @ told.directions,
    )


def noise_level(
    sigma: tuple[float, float | None],
    estimated: bool,
    correlation: Correlation | None,
    used: int,
    shape: NoiseShape | None = None,
) -> NoiseLevel:
    """Both noises, m and rad, with their ``correlation`` over the ``used`` poses, and their ``shape``."""
    if correlation is None:
        return NoiseLevel(*sigma, estimated)
    rotation = None if sigma[1] is None else correlation.rotation
    axes = None if shape is None or sigma[1] is None else _noise_axes((sigma[0], sigma[1]), shape)
    return NoiseLevel(*sigma, estimated, correlation.position, rotation, used / correlation.longest, axes)


def _noise_axes(sigma: tuple[float, float], shape: NoiseShape) -> NoiseAxes:
    (shift, along), (turn, about) = np.linalg.eigh(shape.position), np.linalg.eigh(shape.rotation)
    return NoiseAxes(sigma[0] * np.sqrt(shift), tuple(along.T), sigma[1] * np.sqrt(turn), tuple(about.T))


def _outliers(recording: Recording, used: np.ndarray) -> Outliers:
    numbers = tuple(int(i) for i in recording.pose_number[~used])
    reasons = (Rejection("does not agree with the other poses", len(numbers), numbers),) if numbers else ()
    return Outliers(len(numbers), numbers, reasons)


def refused_result(
    recording: Recording, solver: str, options: Mapping[str, Any], refusal: Note, provenance: Provenance
) -> CalibrationResult:
    """A refusal before there is an estimate."""
    nothing = Estimate(solver, center=np.zeros((len(recording.placements), 3)))
    blank = Assessment(None, np.zeros((1, 3)), None, 0.0, None, 1.0, None, np.zeros(0), (refusal.message,), (), refusal)
    return result_of(recording, to_problem(recording), nothing, blank, options, provenance)


def _placements(recording: Recording, estimate: Estimate) -> tuple[Placement, ...]:
    torus, axis = estimate.torus, estimate.angular_axis
    return tuple(
        Placement(
            label,
            estimate.center[k],
            None if axis is None else axis[k],
            torus.T_world_torus[k] if torus else None,
            bool(torus.referenced[k]) if torus else False,
        )
        for k, label in enumerate(recording.placements)
    )


def sigma_of(covariance: Covariance | None, placements: int) -> Sigma:
    """One-sigma values under the names of the result; None of what was held fixed."""
    if covariance is None:
        return Sigma()

    def vector(name: str) -> Array | None:
        names = [f"{name}_{axis}" for axis in "xyz"]
        return covariance.sigma(*names) if names[0] in covariance.names else None

    def scalar(name: str) -> float | None:
        sigma = float(covariance.sigma(name)[0]) if name in covariance.names else 0.0
        return sigma if sigma >= FIXED_SIGMA else None

    return Sigma(
        vector("offset_sensor_pivot"),
        scalar("major_radius"),
        scalar("minor_radius"),
        scalar("axis_non_orthogonality"),
        vector("orbital_axis_sensor"),
        tuple(
            PlacementSigma(vector(f"torus_center_world[{p}]"), vector(f"angular_axis_world[{p}]"))
            for p in range(placements)
        ),
    )


def sigma_parts_of(given: tuple[EstimatedPart, ...]) -> tuple[SigmaPart, ...]:
    """The parts of the covariance as one-sigma values."""
    offset, parts = [f"offset_sensor_pivot_{axis}" for axis in "xyz"], []
    for part in given:
        known = part.covariance
        radius = float(known.sigma("major_radius")[0]) if "major_radius" in known.names else 0.0
        parts.append(SigmaPart(part.name, known.sigma(*offset), radius))
    return tuple(parts)


def effects_found(given: tuple[EffectFound, ...]) -> tuple[SystematicEffect, ...]:
    """The effects as a result has them."""
    return tuple(SystematicEffect(e.name, e.position_m, e.rotation_rad) for e in given)


def _deformation(found: Deformed) -> Deformation:
    sigma = np.sqrt(np.maximum(np.einsum("mii->mi", found.covariance), 0.0))
    rows = zip(found.angles, found.shift, found.turn, sigma, strict=True)
    nodes = (DeformationNode(float(a), float(b), shift, turn, s) for (a, b), shift, turn, s in rows)
    alpha, beta = zip(found.low.tolist(), found.high.tolist(), strict=True)
    return Deformation(alpha, beta, tuple(nodes))


def _residuals(label: str, assessment: Assessment, poses: Any, chi2_per_dof: float | None) -> Residuals:
    position, rotation = assessment.position_residual[poses], assessment.rotation_residual
    return Residuals(
        label,
        _rms(position),
        None if rotation is None else _rms(rotation[poses]),
        chi2_per_dof,
        int(np.isfinite(position[:, 0]).sum()),
    )


def _residuals_per_sweep(recording: Recording, assessment: Assessment) -> tuple[Residuals, ...]:
    rows = []
    for sweep in recording.sweeps if len(assessment.position_residual) == len(recording) else ():
        poses = sweep.poses[np.isfinite(assessment.position_residual[sweep.poses, 0])]
        if not poses.size:
            continue
        square = (assessment.position_residual[poses] ** 2).sum() / max(assessment.sigma_t, 1e-12) ** 2
        dof = assessment.position_residual.shape[1] * len(poses)
        if assessment.rotation_residual is not None and assessment.sigma_r:
            square += (assessment.rotation_residual[poses] ** 2).sum() / assessment.sigma_r**2
            dof += 2 * len(poses)
        rows.append(_residuals(sweep.label, assessment, poses, float(square / max(dof, 1))))
    return tuple(rows)


def _rms(vectors: Array) -> float:
    """Root mean square length over the used poses, whose rows are finite; 0 where there are none."""
    used = vectors[np.isfinite(vectors[:, 0])]
    return float(np.sqrt((used**2).sum() / max(len(used), 1)))


def _notes(estimate: Estimate, ok: bool) -> list[Note]:
    notes = []
    if not estimate.converged:
        notes.append(Note("not_converged", f"the solver stopped after {estimate.iterations} steps without converging"))
    if ok and estimate.covariance is None:
        notes.append(
            Note("no_covariance", f"'{estimate.solver}' gives no uncertainty here; the solver 'kinematic' does")
        )
    torus = estimate.torus
    if ok and torus:
        notes += conventions(bool(torus.referenced.all()), torus.orbital_referenced)
    return notes


def conventions(referenced: bool, orbital_referenced: bool) -> list[Note]:
    """What there is to say of zeros that no label tells."""
    notes = [] if referenced else [_convention("angular", "alpha")]
    return notes if orbital_referenced else [*notes, _convention("orbital", "beta")]


def _convention(joint: str, angle: str) -> Note:
    return Note(
        f"{joint}_zero_convention",
        f"no label tells where {angle} is zero and which way it counts: it is taken as zero at the first pose",
    )
