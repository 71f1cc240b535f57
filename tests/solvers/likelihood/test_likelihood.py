"""The linearised likelihood and its Schur complements against finite differences and dense algebra."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.simulated import joined, machine, machine_of, problem, rigid, small, sweeps_deg, wandering
from solvers.likelihood import elimination
from solvers.likelihood.elimination import Reduced, columns_of, normal_equations
from solvers.likelihood.linearise import AngleModel, Linearisation, linearise, retract
from solvers.problem import Problem

SIGMA = (1e-3, 2e-3)


def residual_by_hand(torus, angles, data) -> np.ndarray:
    """(6, N) observed less predicted in the carm frame of the prediction."""
    p, R = machine_of(torus).poses(angles.T, data.placement)
    R_world_carm = R @ torus.T_sensor_carm[:3, :3]
    position = np.einsum("nji,nj->in", R_world_carm, data.p_world_sensor - p)
    turn = Rotation.from_matrix(np.swapaxes(R, 1, 2) @ data.R_world_sensor).as_rotvec()  # in the sensor frame
    return np.concatenate([position, (turn @ torus.T_sensor_carm[:3, :3]).T])


def moved_by_hand(torus, step):
    moved = machine_of(torus).moved(step)
    return replace(
        torus,
        T_world_torus=moved.T_world_torus,
        major_radius=moved.R,
        non_orthogonality=moved.epsilon,
        T_sensor_carm=moved.T_sensor_carm,
    )


CASES = [
    pytest.param(0.1, 0.0, 1, id="perpendicular"),
    pytest.param(0.1, 0.02, 1, id="skew"),
    pytest.param(-0.9, -0.3, 1, id="far and very skew"),
    pytest.param(0.0, 0.01, 1, id="R = 0"),
    pytest.param(0.1, 0.02, 3, id="three placements"),
]


def case(R, epsilon, placements, sigma_t=0.0, sigma_r=0.0):
    truth = machine(3, R, epsilon, placements)
    motion = joined(*(wandering(7, k, placement=k) for k in range(placements)))
    return truth.torus(), motion.angles.T, problem(truth, motion, sigma_t, sigma_r)


@pytest.mark.parametrize(("R", "epsilon", "placements"), CASES)
def test_residuals(R, epsilon, placements):
    torus, angles, data = case(R, epsilon, placements, 0.01, 0.1)
    line = linearise(torus, angles, data)
    np.testing.assert_allclose(line.residual, residual_by_hand(torus, angles, data), atol=1e-13)
    positions = linearise(torus, angles, replace(data, R_world_sensor=None))
    np.testing.assert_allclose(positions.residual, line.residual[:3], atol=1e-15)


@pytest.mark.parametrize(("R", "epsilon", "placements"), CASES)
def test_every_column_of_the_jacobian(R, epsilon, placements):
    # at zero residual, where the derivative of the residual is exactly that of the prediction
    torus, angles, data = case(R, epsilon, placements)
    line = linearise(torus, angles, data)
    h = 1e-6
    columns = columns_of(placements)
    for k in range(6 * placements + 8):
        step = h * np.eye(6 * placements + 8)[k]
        plus, minus = (residual_by_hand(moved_by_hand(torus, s * step), angles, data) for s in (1, -1))
        difference = (plus - minus) / (2 * h)
        for p in range(placements):
            here = data.placement == p
            local = np.flatnonzero(columns[p] == k)
            expected = line.by_local[:, local[0], here] if local.size else 0.0
            np.testing.assert_allclose(difference[:, here], expected, atol=1e-8, err_msg=f"unknown {k}, placement {p}")
    for joint in (0, 1):
        turn = h * np.eye(2)[joint][:, None]
        plus, minus = (residual_by_hand(torus, angles + s * turn, data) for s in (1, -1))
        np.testing.assert_allclose((plus - minus) / (2 * h), line.by_angle[:, joint], atol=1e-8)
    positions = linearise(torus, angles, replace(data, R_world_sensor=None))
    np.testing.assert_array_equal(positions.by_local, line.by_local[:3])
    np.testing.assert_array_equal(positions.by_angle, line.by_angle[:3])


def test_the_gradient_is_exact_away_from_zero_residual_too():
    # half the squared residuals do not depend on the frame in which they are written: J^T r is exact
    torus, angles, data = case(0.1, 0.02, 1, 0.01, 0.05)
    line = linearise(torus, angles, data)
    half = [
        lambda t, a, rows=rows: 0.5 * (residual_by_hand(t, a, data)[rows] ** 2).sum()
        for rows in (slice(3), slice(3, 6))
    ]
    h = 1e-6
    for cost, rows in zip(half, (slice(3), slice(3, 6)), strict=True):
        exact = np.einsum("rkn,rn->k", line.by_local[rows], line.residual[rows])
        found = [
            (cost(moved_by_hand(torus, h * e), angles) - cost(moved_by_hand(torus, -h * e), angles)) / (2 * h)
            for e in np.eye(14)
        ]
        np.testing.assert_allclose(exact, found, atol=1e-8)
        for joint in (0, 1):
            turn = h * np.eye(2)[joint][:, None]
            found = (cost(torus, angles + turn) - cost(torus, angles - turn)) / (2 * h)
            assert (line.by_angle[rows, joint] * line.residual[rows]).sum() == pytest.approx(found, abs=1e-8)


def test_retract_moves_the_frames_on_the_right():
    torus, _, _ = case(0.1, 0.02, 2)
    step = np.random.default_rng(0).normal(size=20)
    moved = retract(torus, step)
    np.testing.assert_allclose(moved.T_world_torus[1], torus.T_world_torus[1] @ rigid(step[6:12]), atol=1e-13)
    np.testing.assert_allclose(moved.T_world_torus[0], torus.T_world_torus[0] @ rigid(step[:6]), atol=1e-13)
    np.testing.assert_allclose(moved.T_sensor_carm, torus.T_sensor_carm @ rigid(step[14:]), atol=1e-13)
    assert moved.major_radius == torus.major_radius + step[12]
    assert moved.non_orthogonality == torus.non_orthogonality + step[13]


@dataclass(frozen=True, eq=False)
class Dense:
    """The linearised least-squares problem with every angle an unknown of its own."""

    J: np.ndarray
    """(6 N + readings, D + angles), weighted."""
    r: np.ndarray
    D: int
    """Unknowns of the machine."""
    place: np.ndarray
    """(2, N) column of each angle, -1 where it is known."""
    kind: np.ndarray
    """Of each row: 0 position, 1 rotation, 2 reading."""
    pose: np.ndarray
    """Of each row, and"""

    @property
    def own(self) -> np.ndarray:
        """the columns of the angles that belong to one pose alone."""
        columns = np.arange(self.D, self.J.shape[1])
        return self.J[:, columns[np.bincount(self.place[self.place >= 0], minlength=len(self.J[0]))[columns] == 1]]

    @property
    def normal(self) -> np.ndarray:
        return self.J.T @ self.J

    @property
    def schur(self) -> tuple[np.ndarray, np.ndarray]:
        N, g, D = self.normal, self.J.T @ self.r, self.D
        X = np.linalg.solve(N[D:, D:], N[D:, :D])
        return N[:D, :D] - N[:D, D:] @ X, g[:D] - X.T @ g[D:]


def dense(data: Problem, line: Linearisation, angles: np.ndarray, used: np.ndarray) -> Dense:
    """Written from what Problem says: a held joint without a label is one unknown a sweep, a joint that
    moves is one a pose; the label of a moving joint is a measurement of its angle. Poses that are not used
    are left out, and so are the angles that then nothing measures."""
    n, P = len(data), data.placements
    D = 6 * P + 8
    place, number, sweeps = np.full((2, n), -1), D, {}
    for i in np.flatnonzero(used):
        for joint in (0, 1):
            held, label = data.held[i, joint], data.label[i, joint]
            if held < 0:
                place[joint, i], number = number, number + 1
            elif np.isnan(label):
                if (joint, held) not in sweeps:
                    sweeps[joint, held], number = number, number + 1
                place[joint, i] = sweeps[joint, held]
    rows, r, kind, pose = [], [], [], []
    sigma = np.repeat(SIGMA, 3)[: len(line.residual)]
    for i in np.flatnonzero(used):
        k = data.placement[i]
        for row in range(len(line.residual)):
            w = 1 / sigma[row]
            J = np.zeros(number)
            J[6 * k : 6 * k + 6] = w * line.by_local[row, :6, i]
            J[6 * P : 6 * P + 8] = w * line.by_local[row, 6:, i]
            for joint in (0, 1):
                if place[joint, i] >= 0:
                    J[place[joint, i]] += w * line.by_angle[row, joint, i]
            rows.append(J)
            r.append(w * line.residual[row, i])
            kind.append(row // 3)
            pose.append(i)
        for joint in (0, 1):
            if data.held[i, joint] < 0 and np.isfinite(data.label[i, joint]):
                J = np.zeros(number)
                J[place[joint, i]] = 1 / data.sigma_reading
                rows.append(J)
                r.append((angles[joint, i] - data.label[i, joint]) / data.sigma_reading)
                kind.append(2)
                pose.append(i)
    return Dense(np.array(rows), np.array(r), D, place, np.array(kind), np.array(pose))


def with_readings(motion, every: int = 1):
    """Every so-manyth moving joint has a reading, half a degree off."""
    label = motion.label.copy()
    for joint in (0, 1):
        moving = np.flatnonzero(motion.held[:, joint] < 0)[::every]
        label[moving, joint] = motion.angles[moving, joint] + 0.01 * np.cos(np.arange(len(moving)))
    return replace(motion, label=label)


def some_labels(motion):
    """The labels of all but the first and the last sweep."""
    label = motion.label.copy()
    for number in (0, motion.held.max()):
        label[(motion.held == number).any(axis=1)] = np.nan
    return replace(motion, label=label)


TURN = np.arange(0, 360, 60)
SWEEPS = sweeps_deg((-50, 0, 80), TURN, (10, 70), TURN)
TWO = joined(SWEEPS, sweeps_deg((-20, 30), TURN, (40,), TURN, placement=1))
MOTIONS = {
    "free": wandering(15),
    "free with readings": with_readings(wandering(15)),
    "free with some readings": with_readings(wandering(15), 2),
    "labelled sweeps": SWEEPS,
    "sweeps without labels": SWEEPS.without_labels(),
    "some sweeps with labels": some_labels(SWEEPS),
    "sweeps with readings": with_readings(SWEEPS, 2),
    "sweeps without labels, with readings": with_readings(SWEEPS.without_labels(), 2),
    "two placements": TWO,
    "two placements without labels": TWO.without_labels(),
    "two placements, some labels, readings": with_readings(some_labels(TWO), 3),
    "sweeps and free motion": joined(SWEEPS.without_labels(), wandering(6)),
}


@pytest.fixture(params=[7, 1024], ids=["blocks of 7", "one block"])
def block(request, monkeypatch):
    """Sweeps and placements must also be right where they reach over the ends of a block of poses."""
    monkeypatch.setattr(elimination, "BLOCK", request.param)


@pytest.fixture(params=MOTIONS.values(), ids=MOTIONS.keys())
def eliminated(request, block) -> tuple[Dense, Reduced]:
    return both(request.param)


def both(motion, share_used: float = 1.0, positions_only: bool = False) -> tuple[Dense, Reduced]:
    """The dense problem and the eliminated one, some way off the truth, the poses in random order."""
    P = int(motion.placement.max()) + 1
    truth = machine(4, 0.1, 0.02, P)
    rng = np.random.default_rng(1)
    order = rng.permutation(len(motion))
    data = problem(truth, motion, 3e-3, 3e-3).select(order)
    if positions_only:
        data = replace(data, R_world_sensor=None)
    torus = moved_by_hand(truth.torus(), 0.002 * rng.normal(size=6 * P + 8))
    angles = motion.angles[order].T + 0.002 * rng.normal(size=(2, len(motion)))
    used = rng.random(len(motion)) < share_used
    sigma = SIGMA[:1] if positions_only else SIGMA
    reduced = normal_equations(torus, angles, data, AngleModel.of(data), sigma, None if used.all() else used)
    return dense(data, linearise(torus, angles, data), angles, used), reduced


def scaled_close(found, expected, scale, rtol=1e-8):
    np.testing.assert_allclose(found / scale, expected / scale, atol=rtol)


def check_normal_equations(full: Dense, reduced: Reduced):
    H, g = full.schur
    spread = np.sqrt(np.diagonal(full.normal)[: full.D])
    scaled_close(reduced.H, H, np.outer(spread, spread))
    scaled_close(reduced.g, g, spread * np.linalg.norm(full.r))


def test_normal_equations_against_the_dense_schur_complement(eliminated):
    full, reduced = eliminated
    check_normal_equations(full, reduced)


@pytest.mark.parametrize("name", MOTIONS)
def test_poses_that_are_not_used_have_no_say(name, block):
    full, reduced = both(MOTIONS[name], share_used=0.7)
    check_normal_equations(full, reduced)
    check_squares(full, full.r, (*reduced.squares, reduced.reading_cost))
    check_redundancy(full, reduced)
    check_angle_step(full, reduced)


def test_poses_that_are_not_used_have_their_angles_fitted():
    x = 1e-3 * np.random.default_rng(2).normal(size=14)
    motion = with_readings(wandering(15))
    steps = [both(motion, share_used=share)[1].angle_step(x) for share in (0.999999, 0.5)]
    np.testing.assert_allclose(steps[0], steps[1], atol=1e-12)


def test_positions_alone():
    full, reduced = both(SWEEPS, positions_only=True)
    check_normal_equations(full, reduced)


def test_the_position_share_of_the_information(eliminated):
    # the information is that of the residuals once the angles follow: split by rows of the dense problem
    full, reduced = eliminated
    N, D = full.normal, full.D
    follow = np.vstack([np.eye(D), -np.linalg.solve(N[D:, D:], N[D:, :D])])
    left = full.J[full.kind == 0] @ follow
    spread = np.sqrt(np.diagonal(N)[:D])
    scaled_close(reduced.position_information, left.T @ left, np.outer(spread, spread))


def test_the_step_of_the_angles_is_that_of_the_dense_problem(eliminated):
    check_angle_step(*eliminated)


def check_angle_step(full: Dense, reduced: Reduced):
    x = 1e-3 * np.random.default_rng(2).normal(size=full.D)
    N, g, D = full.normal, full.J.T @ full.r, full.D
    best = -np.linalg.solve(N[D:, D:], g[D:] + N[D:, :D] @ x)
    counted = full.place >= 0
    np.testing.assert_allclose(reduced.angle_step(x)[counted], best[full.place[counted] - D], atol=1e-9)


def test_labelled_held_angles_stay_where_they_are():
    full, reduced = both(SWEEPS)
    x = 1e-3 * np.random.default_rng(2).normal(size=full.D)
    assert (reduced.angle_step(x)[full.place < 0] == 0).all()


def test_redundancy_against_the_traces_of_the_dense_hat_matrix(eliminated):
    check_redundancy(*eliminated)


def check_redundancy(full: Dense, reduced: Reduced):
    A = full.J[:, full.D :]
    leverage = np.einsum("ij,ji->i", A, np.linalg.solve(A.T @ A, A.T))
    expected = [(1 - leverage[full.kind == kind]).sum() for kind in (0, 1)]
    np.testing.assert_allclose(reduced.redundancy, expected, rtol=1e-8)


def test_what_the_angles_exchange_between_the_kinds(eliminated):
    # Helmert's equations: of the expected squares of one kind, this many parts are variances of the other
    full, reduced = eliminated
    hat = full.own @ np.linalg.solve(full.own.T @ full.own, full.own.T)
    across = hat[np.ix_(full.kind == 0, full.kind == 1)]
    assert reduced.exchanged == pytest.approx((across**2).sum(), rel=1e-8)


def test_the_distance_of_a_pose_is_what_its_own_angles_leave(eliminated):
    full, reduced = eliminated
    left = full.r - full.own @ np.linalg.solve(full.own.T @ full.own, full.own.T @ full.r)
    observed = full.kind < 2
    expected = np.bincount(full.pose[observed], left[observed] ** 2)
    np.testing.assert_allclose(reduced.distance2, expected, rtol=1e-7)


def test_sums_of_squares(eliminated):
    full, reduced = eliminated
    check_squares(full, full.r, (*reduced.squares, reduced.reading_cost))
    assert reduced.cost == pytest.approx((full.r**2).sum(), rel=1e-10)
    other = (3 * SIGMA[0], 5 * SIGMA[1])
    parts = [(full.r[full.kind == k] ** 2).sum() for k in range(3)]
    assert reduced.cost_at(other) == pytest.approx(parts[0] / 9 + parts[1] / 25 + parts[2], rel=1e-10)


def check_squares(full: Dense, r: np.ndarray, found):
    expected = [(r[full.kind == k] ** 2).sum() * s**2 for k, s in enumerate((*SIGMA, 1.0))][: len(found)]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_squares_after_a_step_are_those_of_the_dense_problem(eliminated):
    full, reduced = eliminated
    x = 1e-3 * np.random.default_rng(2).normal(size=full.D)
    N, g, D = full.normal, full.J.T @ full.r, full.D
    both_steps = np.append(x, -np.linalg.solve(N[D:, D:], g[D:] + N[D:, :D] @ x))
    check_squares(full, full.r + full.J @ both_steps, reduced.squares_after(x))


def test_which_angles_are_unknown():
    n = 4
    held = np.array([[-1, -1], [0, -1], [1, -1], [-1, 2]])
    label = np.array([[np.nan, 0.4], [0.3, np.nan], [np.nan, np.nan], [0.2, np.nan]])
    data = Problem(
        np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.zeros(n, dtype=int), held, label, sigma_reading=0.1
    )
    model = AngleModel.of(data)
    assert model.free.tolist() == [[True, False, False, True], [True, True, True, False]]
    assert (model.sweep >= 0).tolist() == [False, False, True, True]
    assert model.sweep_joint[2:].tolist() == [0, 1]
    assert model.reading.tolist() == [[0, 0, 0, 0.2], [0.4, 0, 0, 0]]
    np.testing.assert_allclose(model.precision, [[0, 0, 0, 100], [100, 0, 0, 0]])


def test_where_both_joints_are_held_each_unknown_angle_is_counted_once():
    held = np.array([[0, 1]] * 4 + [[0, -1], [-1, 1]])
    label = np.array([[0.3, 0.4], [0.3, np.nan], [np.nan, 0.4], [np.nan, np.nan], [np.nan, np.nan], [np.nan, np.nan]])
    n = len(held)
    model = AngleModel.of(Problem(np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.zeros(n, dtype=int), held, label))
    by_sweep = np.array([(model.sweep >= 0) & (model.sweep_joint == joint) for joint in (0, 1)])
    assert not (by_sweep & model.free).any()
    np.testing.assert_array_equal(by_sweep | model.free, np.isnan(label.T))
    assert (model.precision == 0).all()


def test_the_start_of_the_angles():
    motion = some_labels(sweeps_deg((-50, 0, 170), TURN, (10, 70), TURN))
    truth = machine(4, 0.1, 0.02)
    data = problem(truth, motion, 0.0, 0.02)
    angles = AngleModel.of(data).start(truth.torus(), data)
    known = np.isfinite(motion.label.T)
    np.testing.assert_array_equal(angles[known], motion.label.T[known])
    for number in np.unique(motion.held[motion.held >= 0]):
        joint = 0 if number < 3 else 1
        here = motion.held[:, joint] == number
        assert np.ptp(angles[joint, here]) == 0
    error = np.angle(np.exp(1j * (angles - motion.angles.T)))
    assert np.abs(error).max() < 0.1  # 5 standard deviations of an orientation


def test_the_error_of_a_reading_is_wrapped():
    label = np.array([[0.1, np.nan], [np.radians(179), np.nan]])
    data = replace(problem(machine(1), wandering(2)), label=label)
    error = AngleModel.of(data).reading_error(np.array([[0.1 + 4 * np.pi + 0.01, np.radians(-179)], [1, 1]]))
    np.testing.assert_allclose(error, [[0.01, np.radians(2)], [0, 0]], atol=1e-12)


def test_the_roll_of_the_torus_and_of_the_mount_are_the_zeros_of_the_angles():
    # without labels the two zeros carry no information; everything else does
    full, reduced = both(small().free())
    null = np.zeros((14, 2))
    null[3, 0] = null[14 - 2, 1] = 1
    scale = np.sqrt(np.diagonal(full.normal)[: full.D])
    scaled_close(reduced.H @ null, np.zeros((14, 2)), scale[:, None] * scale[[3, 12]], 1e-9)
    values = np.linalg.eigvalsh(reduced.H / np.outer(scale, scale))
    assert (values > 1e-6).sum() == 12
