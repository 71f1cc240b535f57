"""Machines with random joints for the tests of the chain solver, and their poses by SciPy. Metres and radians."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from helpers.simulated import frame, rigid
from solvers.chain.chain import Free
from solvers.chain.machine import Machine
from solvers.chain.problem import ANGLES, LENGTHS, ORIENTATIONS, POSITIONS, ChainProblem, Layout

H = 1e-6
SIGMA_T, SIGMA_R, SIGMA_Q, SIGMA_L = 0.5e-3, 1e-3, 2e-3, 1e-3
SIGMA = np.array([SIGMA_T, SIGMA_R, SIGMA_Q, SIGMA_L])


def hand_made(
    kinds: str = "rrp", bases: int = 1, paths: tuple[tuple[int, ...], ...] | None = None, seed: int = 0
) -> Machine:
    """Joints that turn (r) or slide (p) about random axes, each sensor at the end of its path of joints."""
    rng = np.random.default_rng([seed, 31])
    J = len(kinds)
    paths = (tuple(range(J)),) if paths is None else paths
    axes = rng.normal(size=(J, 3))
    return Machine(
        T_world_base=np.stack([frame(rng, 1.0) for _ in range(bases)]),
        placements=np.stack([frame(rng, 0.4) for _ in range(J)]),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        prismatic=np.array([kind == "p" for kind in kinds]),
        paths=tuple(np.array(path, dtype=int) for path in paths),
        T_last_sensor=np.stack([frame(rng, 0.4) for _ in paths]),
        offsets=np.zeros(J),
        gains=np.zeros(J),
    )


def pose(machine: Machine, values: np.ndarray, base: int = 0, sensor: int = 0) -> np.ndarray:
    """T_world_sensor (4, 4) at the joint values (J,), product by product."""
    T = machine.T_world_base[base]
    for j in machine.paths[sensor]:
        motion, q = np.eye(4), machine.offsets[j] + (1 + machine.gains[j]) * values[j]
        if machine.prismatic[j]:
            motion[:3, 3] = q * machine.axes[j]
        else:
            motion[:3, :3] = Rotation.from_rotvec(q * machine.axes[j]).as_matrix()
        T = T @ machine.placements[j] @ motion
    return T @ machine.T_last_sensor[sensor]


def changed(machine: Machine, kind: str, index: int, step: np.ndarray | float) -> Machine:
    """With one transform moved by a right perturbation [v, w] (6,), or one offset or gain by a number."""
    array = np.array(getattr(machine, kind))
    array[index] = array[index] + step if kind in ("offsets", "gains") else array[index] @ rigid(np.asarray(step))
    return replace(machine, **{kind: array})


def twist(T: np.ndarray, ahead: np.ndarray, behind: np.ndarray, h: float) -> np.ndarray:
    """(6,) of the sensor in its own frame, from two poses 2 h apart about T."""
    turn = Rotation.from_matrix(behind[:3, :3].T @ ahead[:3, :3]).as_rotvec()
    return np.concatenate([T[:3, :3].T @ (ahead[:3, 3] - behind[:3, 3]), turn]) / (2 * h)


def drawn(machine: Machine, n: int, seed: int = 0) -> np.ndarray:
    """Joint values (n, J)."""
    return np.random.default_rng([seed, 32]).uniform(-1.2, 1.2, (n, len(machine.axes)))


def observed(
    machine: Machine,
    values: np.ndarray,
    sigma: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
    base: np.ndarray | None = None,
    sensor: np.ndarray | None = None,
) -> ChainProblem:
    """Poses with noise (m, rad) at known exact values (N, J)."""
    rng, n = np.random.default_rng([seed, 33]), len(values)
    base, sensor = (np.zeros(n, dtype=int) if x is None else x for x in (base, sensor))
    T = np.stack([pose(machine, *row) for row in zip(values, base, sensor, strict=True)])
    T[:, :3, 3] += sigma[0] * rng.normal(size=(n, 3))
    T[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(sigma[1] * rng.normal(size=(n, 3))).as_matrix()
    return ChainProblem(T, base, sensor, np.zeros(values.shape, dtype=int), values.copy(), machine.prismatic)


def with_readings(given: ChainProblem, joints: list[int], sigma: float, seed: int = 0) -> ChainProblem:
    """The values of the joints are readings with noise."""
    rng = np.random.default_rng([seed, 34])
    held, label = given.held.copy(), given.label.copy()
    held[:, joints] = -1
    label[:, joints] += sigma * rng.normal(size=(len(label), len(joints)))
    return replace(given, held=held, label=label)


def without(given: ChainProblem, joint: int, sweep: np.ndarray | None = None) -> ChainProblem:
    """The values of a joint are unknown: constant in each ``sweep`` (N,), or at every pose where there is none."""
    held, label = given.held.copy(), given.label.copy()
    held[:, joint] = -1 if sweep is None else sweep
    label[:, joint] = np.nan
    return replace(given, held=held, label=label)


def free(machine: Machine, placements=(), offsets=(), gains=()) -> Free:
    J = len(machine.axes)
    return Free(*(np.isin(np.arange(J), joints) for joints in (placements, offsets, gains)))


def everything(machine: Machine) -> Free:
    return free(machine, range(len(machine.axes)))


def disturbed(machine: Machine, seed: int, shift=3e-3, turn=8e-3) -> Machine:
    """Every base, placement and mount moved in a random direction."""
    rng = np.random.default_rng([seed, 41])
    for kind in ("T_world_base", "placements", "T_last_sensor"):
        for index in range(len(getattr(machine, kind))):
            v, w = rng.normal(size=(2, 3))
            step = np.concatenate([v / np.linalg.norm(v) * shift, w / np.linalg.norm(w) * turn])
            machine = changed(machine, kind, index, step)
    return machine


def predicts(found, truth: Machine, tolerance: float, seed: int = 99) -> None:
    """Poses at joint values that were not fitted."""
    for s in range(len(truth.paths)):
        for p in range(len(truth.T_world_base)):
            for v in drawn(truth, 5, seed):
                off = np.linalg.inv(pose(truth, v, p, s)) @ pose(found.machine, v, p, s)
                np.testing.assert_allclose(off, np.eye(4), atol=tolerance)


def dense(machine: Machine, problem: ChainProblem, values: np.ndarray, sigma: np.ndarray):
    """Weighted rows by all global unknowns (M, D) and by every single value (M, V), the residuals (M,), the kind of
    each row, and where the values stand."""
    layout, rows, own_rows, left, kinds = Layout.of(problem, machine), [], [], [], []
    where = [(n, j) for n in range(len(problem)) for j in machine.paths[problem.sensor[n]] if problem.free[n, j]]
    for n, v in enumerate(values):
        p, s = problem.placement[n], problem.sensor[n]
        T, J, A = pose(machine, v, p, s), np.zeros((6, layout.size)), np.zeros((6, len(where)))

        def columns(kind, index, steps, v=v, p=p, s=s, T=T):
            pairs = [[pose(changed(machine, kind, index, q * H * x), v, p, s) for q in (1, -1)] for x in steps]
            return np.stack([twist(T, *pair, H) for pair in pairs], axis=1)

        J[:, layout.base(p)] = columns("T_world_base", p, np.eye(6))
        J[:, layout.mount(s)] = columns("T_last_sensor", s, np.eye(6))
        for j in machine.paths[s]:
            J[:, layout.placement(j)] = columns("placements", j, np.eye(6))
            J[:, layout.offset(j)] = columns("offsets", j, [1.0])[:, 0]
            J[:, layout.gain(j)] = columns("gains", j, [1.0])[:, 0]
            by_value = J[:, layout.offset(j)] * (1 + machine.gains[j])
            if problem.constant[n, j] >= 0:
                J[:, layout.constant(problem.constant[n, j])] = by_value
            if problem.free[n, j]:
                A[:, where.index((n, j))] = by_value
        observed_T = problem.T_world_sensor[n]
        turn = Rotation.from_matrix(T[:3, :3].T @ observed_T[:3, :3]).as_rotvec()
        weight = np.repeat(1 / sigma[:2], 3)
        rows.append(J * weight[:, None])
        own_rows.append(A * weight[:, None])
        left.append(-np.concatenate([T[:3, :3].T @ (observed_T[:3, 3] - T[:3, 3]), turn]) * weight)
        kinds += [POSITIONS] * 3 + [ORIENTATIONS] * 3
        for j in machine.paths[s]:
            if problem.read[n, j]:
                kind = LENGTHS if problem.prismatic[j] else ANGLES
                rows.append(np.zeros((1, layout.size)))
                own_rows.append(np.eye(len(where))[[where.index((n, j))]] / sigma[kind])
                left.append(np.array([(v[j] - problem.label[n, j]) / sigma[kind]]))
                kinds.append(kind)
    return np.concatenate(rows), np.concatenate(own_rows), np.concatenate(left), np.array(kinds), where
