"""What SciPy's own least squares makes of the same poses: the paper's energy, and the likelihood of `kinematic`."""

import numpy as np

from solvers.likelihood.linearise import LOCAL, AngleModel, linearise, retract
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.start.axes import axes_of
from solvers.torus import Torus


def eq6(problem: Problem) -> Array:
    """The paper's Eq. 6 over c, n, R, t by `scipy.optimize.least_squares(method="lm")`, residuals vectorised."""
    from scipy.optimize import least_squares

    p, R = problem.p_world_sensor, problem.rotations

    def residuals(x: Array) -> Array:
        arm = R @ x[7:10] + p - x[:3]
        n = x[3:6] / np.linalg.norm(x[3:6])
        return np.concatenate([np.linalg.norm(arm, axis=1) - x[6], arm @ n])

    start = np.concatenate([p.mean(axis=0), [0.0, 0.0, 1.0], [0.1], np.zeros(3)])
    return least_squares(residuals, start, method="lm").x


def sparse_likelihood(problem: Problem) -> Torus:
    """The likelihood of the chain with every angle an unknown, sparse Jacobian, from the closed form; the noise is
    given, since SciPy does not estimate it. One placement, each pose with one moving joint, labels for the held one."""
    from scipy.optimize import least_squares
    from scipy.sparse import csr_matrix

    n = len(problem)
    start = axes_of(problem, fix_non_orthogonality=False).torus(problem)
    model = AngleModel.of(problem)
    moving = model.free.argmax(axis=0)
    angles = model.start(start, problem)
    scale = np.repeat(1 / np.array([problem.sigma_t, problem.sigma_r], dtype=float), 3)[:, None]
    poses = np.arange(n)
    columns = np.concatenate([np.broadcast_to(np.arange(LOCAL), (n, LOCAL)), LOCAL + poses[:, None]], axis=1)
    index = np.repeat(columns, 6, axis=0).ravel()
    rows = np.arange(6 * n + 1) * (LOCAL + 1)

    def at(x: Array):
        moved = angles.copy()
        moved[moving, poses] += x[LOCAL:]
        return linearise(retract(start, x[:LOCAL]), moved, problem)

    def residuals(x: Array) -> Array:
        return (at(x).residual * scale).T.ravel()

    def jacobian(x: Array) -> csr_matrix:
        line = at(x)
        own = line.by_angle[:, moving, poses]
        J = np.concatenate([line.by_local, own[:, None]], axis=1) * scale[:, None]
        return csr_matrix((J.transpose(2, 0, 1).ravel(), index, rows), shape=(6 * n, LOCAL + n))

    start_at = np.zeros(LOCAL + n)
    found = least_squares(residuals, start_at, jacobian, method="trf", x_scale="jac", tr_solver="lsmr")  # pyright: ignore[reportArgumentType]
    return retract(start, found.x[:LOCAL])
