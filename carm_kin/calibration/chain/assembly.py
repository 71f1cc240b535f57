"""From the chain solver's estimate to the result that a user gets."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from carm_kin.calibration.assembly import conventions, effects_found, noise_level, sigma_of, sigma_parts_of
from carm_kin.calibration.chain import checks, numbers
from carm_kin.calibration.chain.model import ChainModel
from carm_kin.calibration.chain.problem import Gathered
from carm_kin.calibration.chain.told import left_at_rest
from carm_kin.recording.duplicates import NotMeasured
from carm_kin.recording.recording import Recording
from carm_kin.results.chain_result import BasePlacement, ChainCalibration, Origin, PoseError
from carm_kin.results.parts import (
    NoiseLevel,
    Observability,
    Outliers,
    Placement,
    Provenance,
    Rejection,
    Residuals,
    Sigma,
)
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult
from solvers.chain.chain import ChainEstimate, Free
from solvers.chain.problem import ANGLES, LENGTHS, ChainProblem
from solvers.estimate import Note
from solvers.se3 import Array
from solvers.verdict.limits import Limits

SOLVER = "chain"
HANDLED = "other_joint_moved"
"""A warning for the two-axis solvers alone."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """Recordings taken together, and which of their poses count."""

    recordings: tuple[Recording, ...]
    not_measured: tuple[NotMeasured, ...]
    """Of each recording: poses that are no measurements."""

    @property
    def kept(self) -> list[Recording]:
        """The recordings without the poses that are no measurements."""
        parts = zip(self.recordings, self.not_measured, strict=True)
        return [part.select(~out.any_of) if out.any_of.any() else part for part, out in parts]

    @property
    def numbers(self) -> Array:
        """Numbers of all poses, counted on through the recordings in their order, frames without a pose included."""
        found, first = [], 0
        for part in self.recordings:
            found.append(part.pose_number + first)
            first += max(len(part) + part.missing, int(part.pose_number.max(initial=-1)) + 1)
        return np.concatenate(found)

    @property
    def left_out(self) -> np.ndarray:
        """Mask of the poses among all that are no measurements."""
        return np.concatenate([out.any_of for out in self.not_measured])

    @property
    def warnings(self) -> tuple[Note, ...]:
        """Of the recordings, each once."""
        own = [w for part in self.recordings for w in part.warnings if w.code != HANDLED]
        return tuple(dict.fromkeys([*own, *(note for out in self.not_measured for note in out.notes())]))

    def outliers(self, used: np.ndarray) -> Outliers:
        """The poses that are no measurements, and those of the others that are not ``used``."""
        number, reasons = self.numbers, []
        sorts = {"does not agree with the other poses": number[~self.left_out][~used]}
        for reason in self.not_measured[0].reasons:
            sorts[reason] = number[np.concatenate([out.reasons[reason] for out in self.not_measured])]
        for reason, poses in sorts.items():
            if poses.size:
                reasons.append(Rejection(reason, len(poses), tuple(int(i) for i in poses)))
        everything = sorted(i for reason in reasons for i in reason.indices)
        return Outliers(len(everything), tuple(everything), tuple(reasons))


@dataclass(frozen=True, eq=False)
class Blank:
    """What every result of these recordings has."""

    recorded: Recorded
    options: dict[str, Any]
    command: str | None

    def refused(self, refusal: Note, notes: tuple[Note, ...]) -> CalibrationResult:
        """A result without numbers, before there is an estimate."""
        return replace(
            self.bare(notes), refusal=refusal, observability=Observability(np.zeros(0), None, (refusal.message,))
        )

    def bare(self, notes: tuple[Note, ...]) -> CalibrationResult:
        """What is there before any number."""
        poses, kept = len(self.recorded.left_out), int((~self.recorded.left_out).sum())
        return CalibrationResult(
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
            sigma=Sigma(),
            covariance=None,
            noise=NoiseLevel(0.0, 0.0, True),
            residuals=Residuals("overall", 0.0, 0.0, None, kept),
            residuals_per_sweep=(),
            poses=poses,
            used=kept,
            outliers=self.recorded.outliers(np.ones(kept, dtype=bool)),
            observability=Observability(np.zeros(0), None, ()),
            warnings=(*self.recorded.warnings, *notes),
            refusal=None,
            provenance=_provenance(self.recorded.recordings, self.command),
        )


def _provenance(recordings: Sequence[Recording], command: str | None) -> Provenance:
    """Names and digests of several files stand in one line, commas between."""
    every = [provenance_of(recording, command, None) for recording in recordings]
    names, digests = ([getattr(p, field) for p in every] for field in ("input_name", "input_sha256"))
    if None in names or None in digests:
        return every[0]
    return replace(every[0], input_name=", ".join(names), input_sha256=", ".join(digests))


def result_of_chain(
    model: ChainModel,
    gathered: Gathered,
    free: Free,
    nominal: ChainEstimate,
    estimate: ChainEstimate,
    blank: Blank,
    limits: Limits,
) -> CalibrationResult:
    """The result of an estimate, refused where it cannot be trusted; ``free`` is what was set free, and ``nominal`` the
    URDF's own machine, its base and mounts fitted with the noise of the estimate."""
    problem, labels = gathered.problem, gathered.placements
    at = numbers.stations(problem, estimate, len(labels))
    covariance, parts = numbers.covariance(model, estimate, at)
    left = checks.unfreed(model, problem, estimate, limits)
    refusal = checks.refusal(model, problem, estimate, covariance, left, limits)
    used = int(estimate.used.sum())
    error = _error(estimate.residual, estimate.used)
    still = left_at_rest(estimate, free)
    names = tuple(name for name, rests in zip(model.names, still, strict=True) if rests)
    open_ = numbers.not_identifiable(model, estimate, labels, names)
    done = replace(
        blank.bare((*gathered.notes, *checks.notes(model, problem, estimate, left, limits))),
        refusal=refusal,
        noise=noise_level(
            (float(estimate.sigma[0]), float(estimate.sigma[1])),
            None in problem.sigma[:2],
            estimate.correlation,
            used,
        ),
        residuals=Residuals("overall", error.translation_rms_m, error.rotation_rms_rad, estimate.chi2_per_dof, used),
        residuals_per_sweep=_per_sweep(blank.recorded, gathered, estimate),
        used=used,
        outliers=blank.recorded.outliers(estimate.used),
        observability=_observability(estimate, open_),
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
            Placement(label, torus[:3, 3], torus[:3, 0], torus, known)
            for label, torus, known in zip(labels, T, referenced, strict=True)
        ),
        T_sensor_carm=g.T_sensor_carm,
        orbital_referenced=orbital_referenced,
        warnings=(*done.warnings, *conventions(all(referenced), orbital_referenced)),
        sigma=sigma_of(covariance, len(labels)),
        covariance=covariance,
        sigma_parts=sigma_parts_of(parts),
        effects=effects_found(estimate.effects),
        angles_rad=_angles(model, problem, estimate, blank.recorded.left_out),
        chain=_chain(model, gathered, nominal, estimate, open_),
    )


def _angles(model: ChainModel, problem: ChainProblem, estimate: ChainEstimate, left_out: np.ndarray) -> Array:
    """(N, 2) alpha and beta of every pose of the recordings, NaN of those ``left_out``; offsets are in the
    placements."""
    pairs = np.array([model.axes(s) for s in range(len(model.chains))])[problem.sensor]
    found = np.full((len(left_out), 2), np.nan)
    turned = estimate.values * (1 + estimate.machine.gains)
    found[~left_out] = np.take_along_axis(turned, pairs, axis=1)
    return found


def _observability(estimate: ChainEstimate, open_: tuple[str, ...]) -> Observability:
    """Eigenvalues of the correlation matrix, inverted: of the information of the estimated unknowns."""
    C = estimate.covariance[np.ix_(estimate.active, estimate.active)]
    scale = np.sqrt(np.diagonal(C))
    values = np.sort(1 / np.linalg.eigvalsh(C / np.outer(scale, scale)))[::-1]
    return Observability(values, float(values[0] / values[-1]), open_)


def _error(residual: Array, used: np.ndarray) -> PoseError:
    t, w = (float(np.sqrt((part[used] ** 2).sum(axis=1).mean())) for part in (residual[:, :3], residual[:, 3:]))
    return PoseError(t, w)


def _per_sweep(recorded: Recorded, gathered: Gathered, estimate: ChainEstimate) -> tuple[Residuals, ...]:
    """Of the used poses of every labelled sweep; chi-square counts their readings, too."""
    problem, rows, first = gathered.problem, [], 0
    dof = 6 + problem.read.sum(axis=1) - problem.free.sum(axis=1)
    for k, part in enumerate(recorded.kept, 1):
        for sweep in part.sweeps:
            poses = first + sweep.poses
            poses = poses[estimate.used[poses]]
            if poses.size:
                label = sweep.label if len(recorded.recordings) == 1 else f"{k}: {sweep.label}"
                error = _error(estimate.residual[poses], np.ones(len(poses), dtype=bool))
                chi2 = float(estimate.distance2[poses].sum() / max(dof[poses].sum(), 1))
                rows.append(Residuals(label, error.translation_rms_m, error.rotation_rms_rad, chi2, len(poses)))
        first += len(part)
    return tuple(rows)


def _chain(
    model: ChainModel, gathered: Gathered, nominal: ChainEstimate, estimate: ChainEstimate, open_: tuple[str, ...]
) -> ChainCalibration:
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
        not_identifiable=open_,
        nominal=_error(nominal.residual, estimate.used),
        calibrated=_error(estimate.residual, estimate.used),
        reading_sigma_rad=float(estimate.sigma[ANGLES]) if (read & ~lengths).any() else None,
        reading_sigma_m=float(estimate.sigma[LENGTHS]) if lengths.any() else None,
    )


def _estimated(estimate: ChainEstimate, joint: int) -> bool:
    own = estimate.layout.placement(joint)
    return bool(estimate.active[own].any() or estimate.active[estimate.layout.offset(joint)])
