"""The calibrated C-arm in use: from poses of the sensor to the rotation centre, the C-arm frame and its angles."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from carm_kin.calibration.cross_validate import torus_of
from carm_kin.errors import InputError
from carm_kin.recording.checks import floats, numeric, transforms
from carm_kin.results.deformation import Deformation
from carm_kin.results.result import CalibrationResult, ResultLike, as_result
from solvers.kinematic import SIGMA_FLOOR
from solvers.likelihood.covariance import reported_jacobian
from solvers.likelihood.linearise import LOCAL, linearise
from solvers.nearest import nearest, other
from solvers.problem import Problem
from solvers.se3 import Array, inverse, log_so3, skew
from solvers.torus import Torus

MACHINE = 8
"""How many of the unknowns of `solvers.likelihood.linearise` move the pivot: torus, R and epsilon, not the mount."""


@dataclass(frozen=True, eq=False)
class TorusPoses:
    """N poses on the torus, and how far from them the measured ones lie."""

    alpha_rad: Array
    """(N,)."""
    beta_rad: Array
    """(N,)."""
    T_world_sensor: Array
    """(N, 4, 4), m."""
    T_world_carm: Array
    """(N, 4, 4), m."""
    distance_m: Array
    """(N,) from the measured positions."""
    distance_rad: Array | None
    """(N,) angle from the measured orientations; None where there are none."""
    chi2: Array
    """(N,) distance_m^2 / sigma_t^2 + (2 sin(distance_rad / 2))^2 / sigma_r^2; for the nearest pose to a sound one 4 on
    average, 1 without orientations."""

    @property
    def pivot_world_m(self) -> Array:
        """(N, 3) the rotation centre on its circle."""
        return self.T_world_carm[:, :3, 3]


@dataclass(frozen=True, eq=False)
class Located:
    """Where N measured poses of the sensor put the C-arm."""

    T_world_carm: Array
    """(N, 4, 4), m: the C-arm frame by the measured pose alone. It holds wherever the base stands."""
    sigma_pivot_world_m: Array
    """(N, 3) one standard deviation of its origin, from the pose's noise and the calibration's covariance."""
    nearest: TorusPoses
    """The pose on the torus of the least chi-square: the refined pose. Its angles are those of the C-arm."""
    sigma_alpha_rad: Array
    """(N,) from the pose's noise."""
    sigma_beta_rad: Array
    """(N,) from the pose's noise."""
    sigma_nearest_pivot_world_m: Array
    """(N, 3) one standard deviation of ``nearest.pivot_world_m``, as above."""
    other: TorusPoses
    """The second solution of the position, which the orientation rules out."""
    extrapolated: np.ndarray
    """(N,) whether the angles lie outside those over which the deformation of the C was calibrated."""

    @property
    def pivot_world_m(self) -> Array:
        """(N, 3) the rotation centre by the measured pose alone."""
        return self.T_world_carm[:, :3, 3]


@dataclass(frozen=True, eq=False, init=False)
class RotationCentre:
    """A calibration, or the one in a file, in use.

    Raises InputError for a result that is refused or holds no complete chain, for a placement that it does not
    have or a missing one where it has several, and for a noise that is not above 0.
    """

    result: CalibrationResult
    placement: str | None = None
    """Label of the base placement; None where there is one."""
    sigma_t_m: float | None = None
    """Position noise an axis of the poses in use; None: that of the calibration."""
    sigma_r_rad: float | None = None
    """Orientation noise an axis."""

    def __init__(
        self,
        result: ResultLike,
        placement: str | None = None,
        sigma_t_m: float | None = None,
        sigma_r_rad: float | None = None,
    ) -> None:
        object.__setattr__(self, "result", as_result(result))
        object.__setattr__(self, "placement", placement)
        object.__setattr__(self, "sigma_t_m", sigma_t_m)
        object.__setattr__(self, "sigma_r_rad", sigma_r_rad)
        _ = self.torus, self.sigma

    @cached_property
    def torus(self) -> Torus:
        """The chain at the placement."""
        return chain_at(self.result, self.placement)

    @cached_property
    def sigma(self) -> tuple[float, float]:
        """The noise of a pose an axis, m and rad."""
        return noise_of(self.result, self.sigma_t_m, self.sigma_r_rad)

    def locate(self, T_world_sensor: ArrayLike) -> Located:
        """The C-arm at poses (N, 4, 4), m. Raises InputError where they are no rigid motions.

        The nearest pose minimises |p - p(alpha, beta)|^2 / sigma_t^2 + (2 sin(theta / 2))^2 / sigma_r^2 over all alpha
        and beta, theta being the angle between R and R(alpha, beta). Where the calibration found the C to bend, the
        sensor is first put where it would be on a rigid one.
        """
        T = self.unbent(transforms("T_world_sensor", T_world_sensor))
        problem = Problem.of_poses(T[:, :3, 3], T[:, :3, :3])
        angles = nearest(self.torus, problem, self.sigma)
        sigma_angles, sigma_pivot = self._sigma_of_nearest(problem, angles)
        return Located(
            T @ self.torus.T_sensor_carm,
            self._sigma_of_measured(problem.rotations, angles),
            self._poses(problem, angles),
            sigma_angles[:, 0],
            sigma_angles[:, 1],
            sigma_pivot,
            self._poses(problem, other(self.torus, problem, angles)),
            np.zeros(len(T), dtype=bool) if self.bent is None else self.bent.extrapolated(*angles),
        )

    @property
    def bent(self) -> Deformation | None:
        """How the C bends; None where it is rigid as far as the calibration shows."""
        return self.result.deformation

    def unbent(self, T_world_sensor: Array) -> Array:
        """(N, 4, 4) where the sensor would be at measured poses (N, 4, 4), m, did the C not bend."""
        if self.bent is None:
            return T_world_sensor
        problem = Problem.of_poses(T_world_sensor[:, :3, 3], T_world_sensor[:, :3, :3])
        angles = nearest(self.torus, problem, self.sigma)
        return self.bent.unbent(T_world_sensor, self.torus.T_sensor_carm, *angles)

    def locate_positions(self, p_world_sensor: ArrayLike) -> tuple[TorusPoses, TorusPoses]:
        """The nearest and the second solution of positions alone, (N, 3), m, by their distance from the torus.

        On an isocentric machine (R = 0) both lie at the position, and their order has no meaning. Raises InputError
        for positions that are none.
        """
        p = np.atleast_2d(floats("p_world_sensor", p_world_sensor))
        problem = Problem.of_poses(numeric("p_world_sensor", p, (len(p), 3)), None)
        angles = nearest(self.torus, problem, self.sigma)
        return self._poses(problem, angles), self._poses(problem, other(self.torus, problem, angles))

    def _poses(self, problem: Problem, angles: Array) -> TorusPoses:
        T = self.torus.poses(angles.T, problem.placement)
        distance = np.linalg.norm(T[:, :3, 3] - problem.p_world_sensor, axis=1)
        chi2, turn = (distance / self.sigma[0]) ** 2, None
        if problem.R_world_sensor is not None:
            turn = np.linalg.norm(log_so3(np.swapaxes(T[:, :3, :3], 1, 2) @ problem.R_world_sensor), axis=1)
            chi2 = chi2 + (2 * np.sin(turn / 2) / self.sigma[1]) ** 2
        return TorusPoses(angles[0], angles[1], T, T @ self.torus.T_sensor_carm, distance, turn, chi2)

    @cached_property
    def _covariance(self) -> Array:
        """(14, 14) of the unknowns of `solvers.likelihood.linearise`; 0 where the calibration gives none.

        The zeros of the angles, which the reported quantities do not tell, count as exact: no pivot depends on them.
        """
        J, names = reported_jacobian(self.torus)
        labels = [placement.label for placement in self.result.placements]
        k = 0 if self.placement is None else labels.index(self.placement)
        wanted = [name.replace("[0]", f"[{k}]") for name in names]
        known = self.result.covariance
        if known is None or not {*wanted} <= {*known.names}:
            return np.zeros((LOCAL, LOCAL))
        back = np.linalg.pinv(J)
        return back @ known.select([known.names.index(name) for name in wanted]).matrix @ back.T

    def _sigma_of_measured(self, R: Array, angles: Array) -> Array:
        """(N, 3) of R_i t + p_i, at angles (2, N)."""
        mount = self.torus.T_sensor_carm[:3, :3] @ self._covariance[MACHINE : MACHINE + 3, MACHINE : MACHINE + 3]
        C = mount @ self.torus.T_sensor_carm[:3, :3].T + self.sigma[1] ** 2 * _across(self.torus.offset)
        variance = np.einsum("nij,jk,nik->ni", R, C, R) + self.sigma[0] ** 2
        if self.bent is not None:
            here, mean = self.bent.sigma_m(*angles) ** 2, np.diagonal(mount @ self.torus.T_sensor_carm[:3, :3].T)
            variance = variance + np.einsum("nij,nj->ni", R**2, np.maximum(here - mean, 0.0))
        return np.sqrt(variance)

    def _sigma_of_nearest(self, problem: Problem, angles: Array) -> tuple[Array, Array]:
        """(N, 2) of alpha and beta, (N, 3) of the pivot, by what noise and unknowns do to the nearest angles."""
        line, q = linearise(self.torus, angles, problem), inverse(self.torus.T_sensor_carm)[:3, 3]
        A, J = np.moveaxis(line.by_angle, -1, 0), np.moveaxis(line.by_local, -1, 0)
        AW = np.swapaxes(A, 1, 2) / np.repeat(self.sigma, 3) ** 2
        G_inverse = np.linalg.inv(AW @ A)
        by_angle, by_own = (skew(-q) @ rows[:, 3:] - rows[:, :3] for rows in (A, J))
        by_own[:, :, MACHINE:] = 0
        by_own = by_own - by_angle @ G_inverse @ (AW @ J)
        C = by_own @ self._covariance @ np.swapaxes(by_own, 1, 2) + by_angle @ G_inverse @ np.swapaxes(by_angle, 1, 2)
        R = self.torus.T_world_torus[0, :3, :3] @ self.torus.T_torus_carm(angles.T)[:, :3, :3]
        variance = np.einsum("nij,njk,nik->ni", R, C, R)
        return np.sqrt(np.einsum("nii->ni", G_inverse)), np.sqrt(np.maximum(variance, 0.0))


def chain_at(result: CalibrationResult, placement: str | None) -> Torus:
    """The chain of a calibration at one base placement, which may be None where there is one.

    Raises InputError for a result that is refused or holds no complete chain, and for a placement that it lacks.
    """
    labels = [known.label for known in result.placements]
    named = ", ".join(f"'{label}'" for label in labels if label) or "one without a label"
    if placement is not None and labels and placement not in labels:
        raise InputError(f"no placement '{placement}'; the calibration has {named}")
    if placement is None and len(labels) > 1:
        raise InputError(f"name a placement; the calibration has {named}")
    return torus_of(result, (placement,) if placement is not None else tuple(labels))


def noise_of(
    result: CalibrationResult, sigma_t_m: float | None = None, sigma_r_rad: float | None = None
) -> tuple[float, float]:
    """The noise of a pose an axis, m and rad: as given, else that of the calibration.

    Raises InputError where that given is not above 0, or there is none.
    """
    noise = result.noise
    return (
        _noise("sigma_t_m", sigma_t_m, noise.translation_m),
        _noise("sigma_r_rad", sigma_r_rad, noise.rotation_rad),
    )


def _noise(name: str, given: float | None, calibrated: float | None) -> float:
    if given is None and calibrated is None:
        raise InputError(f"the calibration tells no noise: give {name}")
    if given is not None and not 0 < given < np.inf:
        raise InputError(f"{name} must be a finite number above 0, not {given}")
    return max(calibrated or 0.0, SIGMA_FLOOR) if given is None else given


def _across(t: Array) -> Array:
    """[t]x [t]x^T: what a unit rotation noise makes of the lever ``t`` (3,)."""
    return t @ t * np.eye(3) - np.outer(t, t)
