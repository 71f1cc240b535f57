"""The protocol `virtual`: a robot turns the C about axes that are no joints, by inverse kinematics."""

import numpy as np

from carm_kin.errors import InputError
from carm_kin.machine.chain import Chain, NominalGeometry, chain_of
from carm_kin.machine.kinematics import Model
from carm_kin.machine.urdf import UrdfFile
from carm_kin.simulation.protocols import Motion
from solvers.se3 import Array, inverse, log_se3, rot_x, rot_y, transform

PIVOT = "isocenter"
"""The link whose origin is the virtual pivot: x is the virtual angular axis at zero, y the virtual orbital one."""
ANGULAR_DEG, ORBITAL_DEG = 60, 45
"""How far the C turns about either axis, both ways."""
STRIDE_DEG = 5.0
"""How far a virtual angle goes between one solution of the inverse kinematics and the next."""
STEPS = 20
"""Most Newton steps of one solution."""
LONGEST_STEP = 0.2
"""Of a joint in one Newton step, rad or m."""
DAMPING = 1e-12
"""Of a Newton step, relative to the trace of the squared Jacobian: it keeps singular postures solvable."""
REACHED = 1e-10
"""A pose is reached when its tangent to the target, m and rad, is shorter."""


def virtual_motions(urdf: UrdfFile, chain: Chain) -> tuple[list[Motion], NominalGeometry]:
    """Five orbital and three angular sweeps about the virtual axes, with the labels of the held angles, and the truth.

    All joints at zero are the posture at which both angles are zero. Raises InputError where the URDF has no such
    link on the C, and where a joint cannot follow, with the angles.
    """
    T_base_pivot = _pivot(urdf, chain)
    T_pivot_sensor = inverse(T_base_pivot) @ chain.forward_kinematics(np.zeros(len(chain.names)))
    parts = _sweeps()
    angles = np.concatenate([angles for _, _, angles in parts])
    q = _followed(Model(urdf, chain), chain, angles, T_base_pivot, T_pivot_sensor)
    found, start = [], 0
    for label, moving, part in parts:
        held, column = ("orbital", 1) if moving == "angular" else ("angular", 0)
        rows = slice(start, start + len(part))
        found.append(Motion(q[rows], label, moving, {held: part[:, column]}))
        start += len(part)
    return found, NominalGeometry(("angular", "orbital"), T_base_pivot, 0.0, 0.0, inverse(T_pivot_sensor))


def _pivot(urdf: UrdfFile, chain: Chain) -> Array:
    """T_base_pivot (4, 4) with all joints at zero."""
    if PIVOT not in urdf.links:
        problem = f"protocol 'virtual' needs a link {PIVOT!r} on the C: its origin the virtual pivot, its x and y the"
        raise InputError(f"{problem} virtual angular and orbital axis at zero", file=urdf.path)
    names = tuple(joint.name for joint in urdf.joints_to(PIVOT) if joint.type != "fixed")
    if names != chain.names:
        problem = f"the link {PIVOT!r} is not fixed to the part that carries {chain.sensor_link!r}"
        raise InputError(problem, file=urdf.path)
    axes = chain.names[chain.angular], chain.names[chain.orbital]
    return chain_of(urdf, PIVOT, *axes).forward_kinematics(np.zeros(len(names)))


def _sweeps() -> list[tuple[str, str, Array]]:
    """Label, moving axis and the virtual angles (M, 2), rad, of every sweep."""
    alphas, betas = (np.arange(-most, most + 1.0) for most in (ANGULAR_DEG, ORBITAL_DEG))
    at_alphas, at_betas = np.linspace(alphas[0], alphas[-1], 5), np.linspace(betas[0], betas[-1], 5)[1:4]
    orbital = [("orbital", held, np.full_like(betas, held), betas) for held in at_alphas]
    angular = [("angular", held, alphas, np.full_like(alphas, held)) for held in at_betas]
    return [
        (f"{moving} {held:+.1f} deg", moving, np.radians(np.stack([alpha, beta], axis=1)))
        for moving, held, alpha, beta in (*orbital, *angular)
    ]


def _followed(model: Model, chain: Chain, angles: Array, T_base_pivot: Array, T_pivot_sensor: Array) -> Array:
    """Joint values (N, J) at the virtual ``angles`` (N, 2), all led there together from zero in small strides."""
    q = np.zeros((len(angles), len(chain.names)))
    strides = int(np.ceil(np.degrees(np.abs(angles).max()) / STRIDE_DEG))
    for share in np.arange(1, strides + 1) / strides:
        alpha, beta = (share * angles).T
        T = T_base_pivot @ transform(rot_x(alpha) @ rot_y(beta), np.zeros(3)) @ T_pivot_sensor
        q, reached = _solved(model, q, T)
        if not reached.all():
            raise _refusal(alpha, beta, ~reached, "is out of reach")
    for name, values, low, high in zip(chain.names, q.T, chain.lower, chain.upper, strict=True):
        beyond = (values < low - 1e-9) | (values > high + 1e-9)
        if beyond.any():
            raise _refusal(angles[:, 0], angles[:, 1], beyond, f"needs joint {name!r} beyond its limits")
    return q


def _refusal(alpha: Array, beta: Array, poses: np.ndarray, problem: str) -> InputError:
    first = int(np.argmax(poses))
    at = f"angular {np.degrees(alpha[first]):.1f} deg, orbital {np.degrees(beta[first]):.1f} deg"
    return InputError(f"protocol 'virtual': the posture at {at} {problem}; place the link {PIVOT!r} elsewhere")


def _solved(model: Model, q: Array, T: Array) -> tuple[Array, np.ndarray]:
    """Joint values (N, J) near ``q`` with the poses ``T`` (N, 4, 4), by damped Newton steps; which were reached."""
    reached = np.zeros(len(q), dtype=bool)
    for _ in range(STEPS):
        xi = log_se3(inverse(model.forward_kinematics(q)) @ T)
        reached = np.linalg.norm(xi, axis=1) < REACHED
        if reached.all():
            break
        J = model.jacobian(q)
        Jt = np.swapaxes(J, 1, 2)
        square = J @ Jt
        square += DAMPING * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        step = (Jt @ np.linalg.solve(square, xi[..., None]))[..., 0]
        longest = np.abs(step).max(axis=1, keepdims=True)
        q = q + step * (LONGEST_STEP / np.maximum(longest, LONGEST_STEP))
    return q, reached
