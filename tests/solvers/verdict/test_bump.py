"""A base that is moved in mid-recording by less than makes outliers is found and named, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.simulated import joined, machine, problem, sweeps_deg, wandering
from solvers import closed_form, kinematic
from solvers.likelihood.linearise import AngleModel, linearise, retract
from solvers.problem import Problem
from solvers.se3 import rot_x
from solvers.verdict.assess import Assessment, assess
from solvers.verdict.bump import FALSE_ALARM
from solvers.verdict.change import LEAST_POSES, most_likely, rows_of

SIGMA = 1e-3, float(np.radians(0.1))
MOTION = sweeps_deg((-60, -30, 0, 30, 60), range(-70, 71, 2), (-40, 0, 40), range(-60, 61, 2))
N = len(MOTION)
UP = np.array([0.6, 0.0, 0.8])


def sound(seed: int, motion=MOTION, **given) -> Problem:
    return problem(machine(seed, epsilon=0.005 * (seed % 3), **given), motion, *SIGMA, seed=seed)


def bumped(given: Problem, pose: int, mm: float, deg: float, seed: int = 0) -> Problem:
    """Everything from ``pose`` on shifted, and turned about the middle of the positions."""
    rng = np.random.default_rng([seed, 8])
    shift, axis = (x / np.linalg.norm(x) for x in rng.normal(size=(2, 3)))
    turn = Rotation.from_rotvec(np.radians(deg) * axis).as_matrix()
    middle = given.p_world_sensor.mean(axis=0)
    p, R, late = given.p_world_sensor.copy(), given.rotations.copy(), slice(pose, None)
    p[late] = (p[late] - middle) @ turn.T + middle + 1e-3 * mm * shift
    R[late] = turn @ R[late]
    return replace(given, p_world_sensor=p, R_world_sensor=R)


def shifted(given: Problem, shift: np.ndarray) -> Problem:
    return replace(given, p_world_sensor=given.p_world_sensor + shift)


def judged(given: Problem) -> Assessment:
    return assess(given, kinematic.solve(given))


def codes(verdict: Assessment) -> set[str]:
    return {note.code for note in verdict.notes} | ({verdict.refusal.code} if verdict.refusal else set())


def named(verdict: Assessment) -> list[int]:
    """The poses that the note names."""
    words = " ".join(note.message for note in verdict.notes if note.code == "base_moved").split(" pose ")[1:]
    return [int("".join(filter(str.isdigit, word[:6]))) for word in words]


@pytest.mark.parametrize("labels", [True, False])
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("mm, deg, within", [(2, 0.2, 10), (5, 1, 3), (20, 1, 3)])
def test_a_bump_is_found_and_named(mm, deg, within, share, labels):
    for seed in (1, 2):
        given = bumped(sound(seed), round(share * N), mm, deg, seed)
        verdict = judged(given if labels else given.without_labels())
        assert named(verdict)[0] == pytest.approx(share * N, abs=within)
        assert verdict.refusal is None or verdict.refusal.code == "misfit"


@pytest.mark.parametrize("seed", range(4))
def test_the_size_is_that_of_the_bump_and_the_result_is_refused(seed):
    given = bumped(sound(seed), N // 2, 5, 0, seed)
    verdict = judged(given)
    assert verdict.refusal is not None
    assert verdict.refusal.code == "misfit"
    message = verdict.refusal.message
    assert "base seems to have been moved" in message
    assert "give each part a 'placement' of its own" in message
    assert float(message.split("about ")[1].split(" mm")[0]) == pytest.approx(5, abs=0.6)
    divided = given.apart(np.arange(named(verdict)[0], N))
    assert codes(judged(divided)) == set()


def test_a_bump_that_does_no_harm_is_a_warning():
    motion = wandering(4000)
    verdict = judged(bumped(sound(1, motion), 2000, 0.6, 0))
    assert verdict.refusal is None
    assert [note.code for note in verdict.notes] == ["base_moved"]
    assert named(verdict)[0] == pytest.approx(2000, abs=50)


def test_within_one_of_two_placements():
    motion = joined(MOTION, replace(MOTION, placement=np.ones(N, dtype=int)))
    given = bumped(sound(3, motion, placements=2), N + N // 3, 4, 0.2)
    assert named(judged(given))[0] == pytest.approx(N + N // 3, abs=3)
    assert codes(judged(sound(3, motion, placements=2))) == set()


@pytest.mark.parametrize("labels", [True, False])
def test_a_sensor_that_slips_is_told_from_a_base_that_moves(labels):
    """The sensor turns in its own frame by 0.6 deg and shifts by 3 mm along its own axis."""
    for seed in range(4):
        given, late = sound(seed), np.arange(N) >= N // 2
        p = given.p_world_sensor + np.where(late[:, None], given.rotations @ np.array([0.0, 3e-3, 0.0]), 0.0)
        turn = Rotation.from_rotvec([0.0, 0.0, np.radians(0.6)]).as_matrix()
        R = np.where(late[:, None, None], given.rotations @ turn, given.rotations)
        slipped = replace(given, p_world_sensor=p, R_world_sensor=R)
        verdict = judged(slipped if labels else slipped.without_labels())
        assert verdict.refusal is not None
        assert verdict.refusal.code == "misfit"
        assert "the sensor seems to have been moved on the C" in verdict.refusal.message
        assert int(verdict.refusal.message.split("at pose ")[1].split(";")[0]) == pytest.approx(N // 2, abs=3)
        assert float(verdict.refusal.message.split("about ")[1].split(" mm")[0]) == pytest.approx(3, abs=1)


def test_in_the_middle_of_a_sweep_held_at_an_unknown_angle():
    given = bumped(replace(sound(1), label=np.full((N, 2), np.nan)), 250, 4, 0.2)
    assert named(judged(given))[0] == pytest.approx(250, abs=3)


def test_two_bumps_are_both_named():
    given = bumped(bumped(sound(4), 180, 5, 0.2), 360, 6, 0.2, seed=9)
    first, second = named(judged(given))
    assert first == pytest.approx(180, abs=3)
    assert second == pytest.approx(360, abs=3)


def test_many_bumps_do_not_fail():
    given = sound(2)
    for k in range(1, 8):
        given = bumped(given, 67 * k, 3, 0.2, seed=k)
    judged(given)


def test_found_from_the_answer_of_another_solver():
    given = bumped(sound(2), N // 2, 5, 0.2)
    verdict = assess(given, closed_form.solve(given, closed_form.Options(reject_outliers=False)))
    assert named(verdict)[0] == pytest.approx(N // 2, abs=3)


@pytest.mark.parametrize("motion", [MOTION, wandering(300), wandering(40, arc_deg=100)], ids=["sweeps", "free", "few"])
def test_no_false_alarm_on_sound_poses(motion, monkeypatch):
    scans = []
    monkeypatch.setattr(
        "solvers.verdict.bump.rows_of", lambda *given, **flex: scans.append(flex) or rows_of(*given, **flex)
    )
    for seed in range(6):
        given = sound(seed, motion)
        for each in (given, given.without_labels()):
            assert "base_moved" not in codes(judged(each))
    assert scans
    assert not any(scan["flex"] for scan in scans)


def test_exact_poses_have_no_bump():
    given = problem(machine(1), MOTION)
    assert "base_moved" not in codes(judged(given))


FLEX = {
    "harmonic": lambda a: np.cos(2 * a),
    "of high order": lambda a: np.cos(5 * a),
    "with a kink": np.abs,
    "that tips over": lambda a: np.sign(a - 0.3),
}


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("shape", FLEX)
def test_a_flex_is_no_bump(shape, joint):
    for seed in range(3):
        truth = machine(seed)
        support = truth.T_world_torus[0, :3, :3] @ rot_x(MOTION.angles[:, 0] * joint)
        bend = FLEX[shape](MOTION.angles[:, joint])
        given = shifted(problem(truth, MOTION, *SIGMA, seed=seed), 3e-3 * bend[:, None] * (support @ UP))
        turn = Rotation.from_rotvec(3e-3 * bend[:, None] * (support @ np.roll(UP, 1))).as_matrix()
        verdict = judged(replace(given, R_world_sensor=turn @ given.rotations))
        assert "base_moved" not in codes(verdict)


DRIFT = {
    "ramp": lambda t, _: t,
    "warming up": lambda t, _: 1 - np.exp(-4 * t),
    "correlated": lambda t, noise: np.convolve(noise, 0.9 ** np.arange(60))[: len(t)] / 3,
}


@pytest.mark.parametrize("shape", DRIFT)
def test_a_tracker_that_drifts_is_no_bump(shape):
    for seed in range(6):
        rng = np.random.default_rng(seed)
        course = DRIFT[shape](np.linspace(0, 1, N), rng.normal(size=N))
        verdict = judged(shifted(sound(seed), 3e-3 * course[:, None] * UP))
        assert "base_moved" not in codes(verdict)


@pytest.mark.parametrize("deg", [0.3, 1.0])
def test_wrong_labels_are_no_bump(deg):
    for seed in range(4):
        given = sound(seed)
        sweep = given.held.max(axis=1)
        error = np.radians(deg) * np.random.default_rng(seed).normal(size=sweep.max() + 1)
        verdict = judged(replace(given, label=given.label + error[sweep, None]))
        assert "base_moved" not in codes(verdict)


def test_a_bump_is_found_in_spite_of_flex_and_correlated_noise():
    rng = np.random.default_rng(0)
    slow = np.stack([np.convolve(x, 0.9 ** np.arange(60))[:N] for x in 3e-4 * rng.normal(size=(3, N))], axis=1)
    given = shifted(bumped(sound(3), N // 2, 5, 0.2), slow + 1e-3 * np.cos(2 * MOTION.angles[:, :1]) * UP)
    assert named(judged(given))[0] == pytest.approx(N // 2, abs=3)


def test_the_statistic_is_what_the_displacement_lowers_the_sum_of_squares_by():
    """Against one dense least-squares problem with every angle and the displacement among its unknowns."""
    motion = joined(*(sweeps_deg((-50, 0, 50), range(-60, 61, 20), (0, 40), range(-60, 61, 20), p) for p in (0, 1)))
    given = bumped(sound(2, motion, placements=2), 50, 4, 0.3)
    estimate = kinematic.solve(given)
    assert estimate.torus is not None
    assert estimate.angles is not None
    torus, angles = retract(estimate.torus, np.full(20, 1e-4)), estimate.angles.T
    line = linearise(torus, angles, given)
    found = most_likely(rows_of(line, angles, given, SIGMA, flex=False), given)
    n, weight = len(given), np.repeat(1 / np.array(SIGMA), 3)[:, None]
    local, r = line.by_local * weight[:, None], (line.residual * weight).T.ravel()
    J = np.zeros((n, 6, 20 + 2 * n + 6))
    for i, p in enumerate(given.placement):
        J[i, :, 6 * p : 6 * p + 6], J[i, :, 12:20] = local[:, :6, i], local[:, 6:, i]
        J[i, :, 20 + 2 * i : 22 + 2 * i] = line.by_angle[:, :, i] * weight

    def left(cut: int | None) -> float:
        A = J.copy()
        if cut is not None:
            later = (np.arange(n) >= cut) & (given.placement == given.placement[cut])
            A[later, :, -6:] = np.moveaxis(local[:, :6, later], -1, 0)
        A = A.reshape(6 * n, -1)
        A /= np.maximum(np.linalg.norm(A, axis=0), 1e-12)
        return float(((r - A @ np.linalg.lstsq(A, r, rcond=1e-10)[0]) ** 2).sum())

    half = np.arange(LEAST_POSES, n // 2 - LEAST_POSES + 1)
    cuts = [*half, *(half + n // 2)]
    lowered = [left(None) - left(k) for k in cuts]
    assert found is not None
    assert found.pose == cuts[int(np.argmax(lowered))]
    assert found.statistic == pytest.approx(max(lowered), rel=1e-6)
    assert found.probability < FALSE_ALARM


def test_the_probability_is_a_bound():
    found = []
    for seed in range(60):
        given = sound(seed, wandering(60, seed=seed))
        estimate = kinematic.solve(given)
        assert estimate.torus is not None
        assert estimate.angles is not None
        line = linearise(estimate.torus, estimate.angles.T, given)
        found.append(most_likely(rows_of(line, estimate.angles.T, given, SIGMA, flex=False), given))
    assert sum(change.probability < 0.05 for change in found) <= 6
    assert 5 < np.median([change.statistic for change in found]) < 16


def test_poses_apart_have_a_placement_and_sweeps_of_their_own():
    given = sound(1)
    divided = given.apart(np.arange(100, N))
    assert divided.placements == 2
    assert set(divided.placement[100:]) == {1}
    model = AngleModel.of(replace(divided, label=np.full((N, 2), np.nan)))
    assert model.sweep[99] != model.sweep[100]
    assert len(model.sweep_placement) == len(np.unique(given.held.max(axis=1))) + 1
