"""The gauge of a deformation (docs/estimation.md, "Systematic effects"): how many coefficients no pose tells.

The chain is written out here once more, and every column is the derivative of its poses by a complex step: exact to
rounding, and without the closed forms by which the counts are derived.
"""

import numpy as np
import pytest

FULL_CIRCLE = (360.0, 360.0)
C_ARM = (115.0, 120.0)
"""Ranges of alpha and beta, degrees."""
POSES = 8
"""A side of the grid."""
STEP = 1e-30
"""Of the complex derivative: nothing cancels, however small it is."""
TOLD = 1e-6
"""Share of a unit displacement that angles and rigid numbers must leave to be told. They leave 0.02 or more of the told
ones, and rounding of the others."""
RIGID = 14
"""`T_world_torus`, R, epsilon, `T_sensor_carm`."""


def turn(axis: int, angle: complex) -> np.ndarray:
    T = np.eye(4, dtype=complex)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T[i, i] = T[j, j] = np.cos(angle)
    T[j, i], T[i, j] = np.sin(angle), -np.sin(angle)
    return T


def near_identity(twist: np.ndarray) -> np.ndarray:
    """exp of an infinitesimal [v, w]."""
    (x, y, z), (a, b, c) = twist[:3], twist[3:]
    return np.eye(4) + np.array([[0, -c, b, x], [c, 0, -a, y], [-b, a, 0, z], [0, 0, 0, 0]])


class Machine:
    """A C-arm somewhere, with a sensor anywhere on its C."""

    def __init__(self, major_radius: float, epsilon: float) -> None:
        self.major_radius, self.epsilon = major_radius, epsilon
        self.T_world_torus = turn(0, 0.4) @ turn(1, -0.7) @ turn(2, 1.1)
        self.T_world_torus[:3, 3] = 0.3, -0.2, 1.8
        self.T_carm_sensor = turn(2, 0.3) @ turn(0, -0.9)
        self.T_carm_sensor[:3, 3] = 0.25, 0.12, -0.55

    def pose(self, alpha: complex, beta: complex, rigid: np.ndarray, deformation: np.ndarray) -> np.ndarray:
        """`T_world_sensor` with the rigid numbers changed by `rigid` (14,), the C by the twist `deformation` (6,)."""
        slide = np.eye(4, dtype=complex)
        slide[2, 3] = self.major_radius + rigid[6]
        return (
            self.T_world_torus
            @ near_identity(rigid[:6])
            @ turn(0, alpha)
            @ slide
            @ turn(2, self.epsilon + rigid[7])
            @ turn(1, beta)
            @ near_identity(deformation)
            @ near_identity(-rigid[8:])
            @ self.T_carm_sensor
        )

    def derivative(self, alpha: float, beta: float) -> np.ndarray:
        """(6, 2 + 14 + 6) twist of the sensor by both angles, the rigid numbers and the deformation there."""
        columns = []
        for change in 1j * STEP * np.eye(2 + RIGID + 6):
            T = self.pose(alpha + change[0], beta + change[1], change[2:-6], change[-6:])
            twist = np.linalg.inv(np.real(T)) @ np.imag(T) / STEP
            columns.append([*twist[:3, 3], twist[2, 1], twist[0, 2], twist[1, 0]])
        return np.transpose(columns)


def waves(angle: np.ndarray, order: int) -> np.ndarray:
    """(n, 2 order + 1) 1, cos, sin, ... of one angle."""
    k = np.arange(1, order + 1) * angle[:, None]
    return np.hstack([np.ones((len(angle), 1)), np.cos(k), np.sin(k)])


def grid(range_deg: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Angles of all poses; a full circle does not hold its end twice."""
    axes = [np.radians(r) * ((np.arange(POSES) + 0.5) / POSES - 0.5) for r in range_deg]
    alpha, beta = np.meshgrid(*axes, indexing="ij")
    return alpha.ravel(), beta.ravel()


def columns(machine: Machine, range_deg: tuple[float, float], order: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the twists of all poses, (6N, .): Fourier coefficients, own angles, rigid numbers."""
    alpha, beta = grid(range_deg)
    each = np.array([machine.derivative(a, b) for a, b in zip(alpha, beta, strict=True)])
    tensor = np.einsum("ni,nj->nij", waves(alpha, order), waves(beta, order)).reshape(len(alpha), -1)
    deformation = np.einsum("nrc,nk->nrck", each[..., -6:], tensor).reshape(6 * len(alpha), -1)
    angles = np.zeros((len(alpha), 6, len(alpha), 2))
    angles[np.arange(len(alpha)), :, np.arange(len(alpha))] = each[..., :2]
    return deformation, angles.reshape(6 * len(alpha), -1), each[..., 2:-6].reshape(6 * len(alpha), -1)


def span(A: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the columns."""
    U, s, _ = np.linalg.svd(A / np.linalg.norm(A, axis=0), full_matrices=False)
    return U[:, s > 1e-10 * s[0]]


def hidden(A: np.ndarray, B: np.ndarray) -> int:
    """dim(span A ∩ span B) = rank A + rank B - rank [A B]: by the sines of the angles between the spans."""
    A, B = span(A), span(B)
    return int((np.linalg.svd(A - B @ (B.T @ A), compute_uv=False) < TOLD).sum())


@pytest.mark.parametrize(("order", "of", "count"), [(1, 54, 24), (2, 150, 52)])
@pytest.mark.parametrize("range_deg", [FULL_CIRCLE, C_ARM], ids=["circle", "c-arm"])
@pytest.mark.parametrize("machine", [Machine(0.3, 0.02), Machine(0.0, 0.0)], ids=["apart", "meeting"])
def test_so_many_coefficients_are_not_told(machine, range_deg, order, of, count):
    deformation, angles, rigid = columns(machine, range_deg, order)
    every = np.hstack([angles, rigid])
    n = 2 * order + 1
    assert count == 12 + n**2 + n * (n - 2)
    assert span(deformation).shape[1] == of
    assert hidden(deformation, every) == count
    assert hidden(deformation, angles) == count - 12
    assert hidden(deformation, rigid) == RIGID
    assert span(every).shape[1] == angles.shape[1] + RIGID - 2


def centred(deformation: np.ndarray, range_deg: tuple[float, float], order: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns (6N, 6, K) of the coefficients but for the constants, of functions (N, K) of mean zero over the grid."""
    tensor = np.einsum("ni,nj->nij", *(waves(angle, order) for angle in grid(range_deg))).reshape(POSES**2, -1)
    each, mean = deformation.reshape(len(deformation), 6, -1), tensor.mean(axis=0)[1:]
    return each[..., 1:] - each[..., :1] * mean, tensor[:, 1:] - mean


@pytest.mark.parametrize(("order", "count"), [(1, 18), (2, 46)])
@pytest.mark.parametrize("range_deg", [FULL_CIRCLE, C_ARM], ids=["circle", "c-arm"])
def test_a_mean_of_zero_takes_the_six_constants(range_deg, order, count):
    deformation, angles, rigid = columns(Machine(0.3, 0.02), range_deg, order)
    moved = centred(deformation, range_deg, order)[0].reshape(len(deformation), -1)
    assert hidden(moved, np.hstack([angles, rigid])) == count


def test_a_millimetre_of_sag_costs_a_third_of_it():
    """Rms error of the offset where the sensor shifts at order 1 by a peak of 1 mm in the mean: 0.53 mm of the rigid
    fit, 0.32 mm of the posterior mean, which no estimator beats. 1,900 poses, 0.2 mm and 0.08 degrees."""
    deformation, angles, rigid = columns(Machine(0.1, 0.01), C_ARM, 1)
    shifts, functions = centred(deformation, C_ARM, 1)
    some = np.random.default_rng(1).normal(size=(2000, functions.shape[1], 3))
    peak_m = np.linalg.norm(functions @ some, axis=2).max(axis=1).mean()
    weight = np.tile(np.repeat([1 / 2e-4, 1 / np.radians(0.08)], 3), POSES**2)[:, None] * np.sqrt(1900) / POSES
    own = span(angles * weight)
    no_zeros = np.delete(rigid, [3, 12], axis=1)
    F = np.hstack([no_zeros, shifts[:, :3].reshape(len(rigid), -1) * 1e-3 / peak_m]) * weight
    F -= own @ (own.T @ F)
    u, offset = no_zeros.shape[1], slice(7, 10)
    rigid_fit = (np.linalg.pinv(F[:, :u]) @ F[:, u:])[offset]
    prior = np.diag(np.arange(F.shape[1]) >= u)
    best = np.linalg.inv(F.T @ F + prior)[offset, offset]
    assert np.sqrt((rigid_fit**2).sum()) * 1e3 == pytest.approx(0.53, abs=0.03)
    assert np.sqrt(np.trace(best)) * 1e3 == pytest.approx(0.32, abs=0.03)
