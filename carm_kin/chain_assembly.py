"""From the chain solver's estimate to the result that a user gets."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from carm_kin import chain_numbers as numbers
from carm_kin import result as r
from carm_kin.assembly import conventions, sigma_of
from carm_kin.chain_model import ChainModel
from carm_kin.chain_problem import Gathered
from carm_kin.chain_result import BasePlacement, ChainCalibration, Origin, PoseError
from carm_kin.recording import Recording
from carm_kin.urdf import listing
from solvers.chain import ChainEstimate
from solvers.chain_problem import ANGLES, LENGTHS
from solvers.estimate import Note
from solvers.limits import Limits, misfit, uncertain
from solvers.se3 import Array

SOLVER = "chain"
WEAK_T, WEAK_R = 5e-3, float(np.radians(0.5))
"""A joint's number that is estimated to no better than this (one sigma, m or rad) is warned of."""


@dataclass(frozen=True, eq=False)
class Blank:
    """What every result of these recordings has."""

    recordings: list[Recording]
    options: dict[str, Any]
    provenance: r.Provenance

    def refused(self, refusal: Note, notes: tuple[Note, ...]) -> r.CalibrationResult:
        """A result without numbers, before there is an estimate."""
        return replace(
            self.bare(notes), refusal=refusal, observability=r.Observability(np.zeros(0), None, (refusal.message,))
        )

    def bare(self, notes: tuple[Note, ...]) -> r.CalibrationResult:
        """What is there before any number."""
        poses = sum(len(recording) for recording in self.recordings)
        return r.CalibrationResult(
            status="refused",
            solver=SOLVER,
            options=self.options,
            offset_sensor_pivot_m=None,
            major_radius_m=None,
            major_radius_signed_m=None,
            minor_radius_m=None,
            axis_non_orthogonality_rad=None,
            orbital_axis_sensor=None,
            placements=(),
            T_sensor_carm=None,
            orbital_referenced=False,
            sigma=r.Sigma(),
            covariance=None,
            noise=r.NoiseLevel(0.0, 0.0, True),
            residuals=r.Residuals("overall", 0.0, 0.0, None, poses),
            residuals_per_sweep=(),
            poses=poses,
            used=poses,
            outliers=r.Outliers(0, ()),
            observability=r.Observability(np.zeros(0), None, ()),
            warnings=(*(w for recording in self.recordings for w in recording.warnings), *notes),
            refusal=None,
            provenance=self.provenance,
        )


def result_of_chain(
    model: ChainModel,
    gathered: Gathered,
    nominal: ChainEstimate,
    estimate: ChainEstimate,
    blank: Blank,
    limits: Limits,
) -> r.CalibrationResult:
    """The result of an estimate, refused where it cannot be trusted."""
    problem, labels = gathered.problem, gathered.placements
    at = numbers.stations(problem, estimate, len(labels))
    covariance = numbers.covariance(model, estimate, at)
    sigma_t, sigma_r = float(estimate.sigma[0]), float(estimate.sigma[1])
    refusal = _refusal(estimate, limits) or uncertain(covariance, limits)
    used = int(estimate.used.sum())
    offs = np.flatnonzero(~estimate.used)
    rejected = r.Outliers(len(offs), tuple(int(i) for i in offs))
    error = _error(estimate.residual, estimate.used)
    done = replace(
        blank.bare((*gathered.notes, *_notes(model, estimate, limits))),
        refusal=refusal,
        noise=r.NoiseLevel(sigma_t, sigma_r, None in problem.sigma[:2]),
        residuals=r.Residuals("overall", error.translation_rms_m, error.rotation_rms_rad, estimate.chi2_per_dof, used),
        used=used,
        outliers=rejected,
        observability=_observability(model, estimate, labels),
    )
    if refusal:
        return done
    layout, active = estimate.layout, estimate.active
    referenced = [bool(active[layout.base(p)].all()) for p in range(len(labels))]
    orbital_referenced = bool(active[layout.mount(0)].all())
    g, T = numbers.geometry(model, estimate.machine, 0), numbers.tori(model, estimate.machine, at)
    return replace(
        done,
        status="ok",
        offset_sensor_pivot_m=g.offset,
        major_radius_m=abs(g.major_radius),
        major_radius_signed_m=g.major_radius,
        minor_radius_m=g.minor_radius,
        axis_non_orthogonality_rad=g.non_orthogonality,
        orbital_axis_sensor=g.T_sensor_carm[:3, 1],
        placements=tuple(
            r.Placement(label, torus[:3, 3], torus[:3, 0], torus, known)
            for label, torus, known in zip(labels, T, referenced, strict=True)
        ),
        T_sensor_carm=g.T_sensor_carm,
        orbital_referenced=orbital_referenced,
        warnings=(*done.warnings, *conventions(all(referenced), orbital_referenced)),
        sigma=sigma_of(covariance, len(labels)),
        covariance=covariance,
        chain=_chain(model, gathered, nominal, estimate),
    )


def _refusal(estimate: ChainEstimate, limits: Limits) -> Note | None:
    sigma_t, sigma_r = float(estimate.sigma[0]), float(estimate.sigma[1])
    if sigma_t > limits.max_sigma_t_m or sigma_r > limits.max_sigma_r_rad:
        return misfit(sigma_t, sigma_r)
    if estimate.chi2_per_dof > limits.max_chi2_per_dof:
        words = f"residuals exceed the given noise: chi-square per degree of freedom {estimate.chi2_per_dof:.1f}"
        return Note("misfit", words)
    share = 1 - estimate.used.mean()
    if share > limits.max_rejected_share:
        return Note("too_many_outliers", f"{share:.0%} of the poses agree with no machine that explains the others")
    return None


def _notes(model: ChainModel, estimate: ChainEstimate, limits: Limits) -> list[Note]:
    notes = []
    if not estimate.converged:
        notes.append(Note("not_converged", f"the solver stopped after {estimate.iterations} steps without converging"))
    share = 1 - estimate.used.mean()
    if share > limits.silent_rejected_share:
        words = f"{share:.0%} of the poses do not agree with the others and were not used"
        notes.append(Note("many_rejected", words))
    weak = [
        change.joint
        for change in numbers.joint_changes(model, estimate)
        if change.shift_sigma_m.max() > WEAK_T or change.turn_sigma_rad.max() > WEAK_R
    ]
    if weak:
        words = f"the poses hardly determine the origin of {listing(weak)}: give a prior, or free fewer joints"
        notes.append(Note("weak_joints", words))
    if model.machine.gains.any() or estimate.machine.gains.any():
        words = "a URDF has no gain of a joint: the calibrated file leaves them out"
        notes.append(Note("gains_not_in_urdf", words))
    return notes


def _observability(model: ChainModel, estimate: ChainEstimate, labels: tuple[str, ...]) -> r.Observability:
    """Eigenvalues of the correlation matrix, inverted: of the information of the estimated unknowns."""
    C = estimate.covariance[np.ix_(estimate.active, estimate.active)]
    scale = np.sqrt(np.diagonal(C))
    values = np.sort(1 / np.linalg.eigvalsh(C / np.outer(scale, scale)))[::-1]
    return r.Observability(values, float(values[0] / values[-1]), numbers.not_identifiable(model, estimate, labels))


def _error(residual: Array, used: np.ndarray) -> PoseError:
    t, w = (float(np.sqrt((part[used] ** 2).sum(axis=1).mean())) for part in (residual[:, :3], residual[:, 3:]))
    return PoseError(t, w)


def _chain(model: ChainModel, gathered: Gathered, nominal: ChainEstimate, estimate: ChainEstimate) -> ChainCalibration:
    machine, labels = estimate.machine, gathered.placements
    touched = np.array([bool(_estimated(estimate, j)) for j in range(len(model.names))])
    origins = model.origins(machine, np.flatnonzero(touched))
    read = gathered.problem.read
    lengths = read & gathered.problem.prismatic
    return ChainCalibration(
        urdf=model.urdf.path.name,
        base_link=model.chains[0].base_link,
        bases=tuple(BasePlacement(label, T) for label, T in zip(labels, machine.T_world_base, strict=True)),
        sensors=tuple(numbers.sensor_geometry(model, estimate, s) for s in range(len(model.chains))),
        joints=numbers.joint_changes(model, estimate),
        origins=tuple(Origin(joint, T) for joint, T in origins.items()),
        not_identifiable=numbers.not_identifiable(model, estimate, labels),
        nominal=_error(nominal.residual, estimate.used),
        calibrated=_error(estimate.residual, estimate.used),
        reading_sigma_rad=float(estimate.sigma[ANGLES]) if (read & ~lengths).any() else None,
        reading_sigma_m=float(estimate.sigma[LENGTHS]) if lengths.any() else None,
    )


def _estimated(estimate: ChainEstimate, joint: int) -> bool:
    own = estimate.layout.placement(joint)
    return bool(estimate.active[own].any() or estimate.active[estimate.layout.offset(joint)])
