"""Each cause of a misfit is made on purpose and has to be named; sound poses have to be left alone."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.simulated import machine, paper, problem, sweeps_deg, wandering
from solvers import closed_form, kinematic
from solvers.estimate import Correlation
from solvers.problem import Problem
from solvers.se3 import quat_wxyz_from_rotation, rot_x, rotation_from_quat_wxyz
from solvers.verdict.assess import assess
from solvers.verdict.diagnose import CAUSES, causes_of
from solvers.verdict.limits import Limits
from solvers.verdict.residuals import neighbour_correlation, residual_notes

MOTION = sweeps_deg((-60, -30, 0, 30, 60), range(-70, 71, 2), (-40, 0, 40), range(-60, 61, 2))
SIGMA = 5e-4, 1e-3
ALL_POSES = closed_form.Options(reject_outliers=False)


def sound(seed: int = 3, motion=MOTION) -> Problem:
    return problem(machine(seed), motion, *SIGMA, seed=seed)


def rolled(given: Problem, by: int) -> Problem:
    """Quaternions written in one order and read in another."""
    quat = np.roll(quat_wxyz_from_rotation(given.R_world_sensor), by, axis=-1)
    return replace(given, R_world_sensor=rotation_from_quat_wxyz(quat))


def transposed(given: Problem) -> Problem:
    return replace(given, R_world_sensor=np.swapaxes(given.rotations, 1, 2))


def inverted(given: Problem) -> Problem:
    R = np.swapaxes(given.rotations, 1, 2)
    return replace(given, R_world_sensor=R, p_world_sensor=-np.einsum("nij,nj->ni", R, given.p_world_sensor))


def mirrored(given: Problem, axis: int) -> Problem:
    p = given.p_world_sensor.copy()
    p[:, axis] *= -1
    return replace(given, p_world_sensor=p)


def exchanged(given: Problem) -> Problem:
    return replace(given, held=given.held[:, ::-1], label=given.label[:, ::-1])


def in_sweep(given: Problem, sweep: int) -> np.ndarray:
    return given.held.max(axis=1) == sweep


def relabelled(given: Problem, sweep: int, by_deg: float) -> Problem:
    label = given.label.copy()
    label[in_sweep(given, sweep)] += np.radians(by_deg)
    return replace(given, label=label)


def wrong_moving(given: Problem, sweep: int) -> Problem:
    poses = in_sweep(given, sweep)[:, None]
    return replace(
        given,
        held=np.where(poses, given.held[:, ::-1], given.held),
        label=np.where(poses, given.label[:, ::-1], given.label),
    )


def read(given: Problem, reversed_sweeps: tuple[int, ...] = ()) -> Problem:
    """With readings of the moving joint, some of which run backwards."""
    label = np.where(np.isnan(given.label), MOTION.angles, given.label)
    for sweep in reversed_sweeps:
        poses = np.flatnonzero(in_sweep(given, sweep))
        label[poses] = label[poses[::-1]]
    return replace(given, label=label)


def pushed(given: Problem, share: float = 0.6) -> Problem:
    later = np.arange(len(given)) >= share * len(given)
    return replace(given, p_world_sensor=given.p_world_sensor + 0.05 * later[:, None])


MISTAKES = {
    "quaternions xyzw as wxyz": (
        lambda g: rolled(g, -1),
        "quaternion_order",
        "qx,qy,qz,qw and to have been read as qw",
    ),
    "quaternions wxyz as xyzw": (lambda g: rolled(g, 1), "quaternion_order", "qw,qx,qy,qz and to have been read as qx"),
    "transposed": (transposed, "transposed_rotation", "transpose"),
    "mirrored x": (lambda g: mirrored(g, 0), "left_handed_frame", "x negated"),
    "mirrored y": (lambda g: mirrored(g, 1), "left_handed_frame", "y negated"),
    "mirrored z": (lambda g: mirrored(g, 2), "left_handed_frame", "z negated"),
    "inverted": (inverted, "inverted_poses", "the world in the sensor"),
    "exchanged": (exchanged, "exchanged_joints", "angular and the orbital joint"),
    "label": (lambda g: relabelled(g, 1, 10), "wrong_label", "sweep 2 (poses 71 to 141) has the angular joint at -20"),
    "last label": (lambda g: relabelled(g, 7, 10), "wrong_label", "sweep 8 (poses 477 to 537)"),
    "moving": (lambda g: wrong_moving(g, 1), "wrong_label", "sweep 2 (poses 71 to 141) holds the orbital joint"),
    "reversed": (lambda g: read(g, (2,)), "reversed_sweep", "sweep 3 (poses 142 to 212)"),
    "base": (pushed, "base_moved", "pose 32"),
}


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_cause_is_named(mistake, seed):
    make, code, words = MISTAKES[mistake]
    given = make(sound(seed))
    verdict = assess(given, closed_form.solve(given, ALL_POSES))
    assert [note.code for note in verdict.notes] == [code]
    assert words in " ".join(note.message for note in verdict.notes)
    assert verdict.refusal is not None
    assert verdict.refusal.code == "misfit"
    assert words in verdict.refusal.message


@pytest.mark.parametrize("mistake", ["label", "moving", "reversed"])
def test_a_wrong_sweep_that_was_rejected_leaves_the_others_sound(mistake):
    make, code, words = MISTAKES[mistake]
    given = make(sound())
    verdict = assess(given, kinematic.solve(given))
    assert verdict.refusal is None
    assert {note.code for note in verdict.notes} == {"many_rejected", code}
    assert any(words in note.message for note in verdict.notes)


def test_two_wrong_sweeps_are_named_together():
    given = relabelled(relabelled(sound(), 0, 12), 3, -20)
    notes = causes_of(given, closed_form.solve(given, ALL_POSES))
    assert [note.code for note in notes] == ["wrong_label"]
    assert "sweep 1 " in notes[0].message
    assert "sweep 4 " in notes[0].message


def test_of_two_labels_that_contradict_each_other_both_are_named():
    motion = sweeps_deg((-60, 0, 60), range(-70, 71, 2), (0, 40), range(-60, 61, 2))
    given = relabelled(sound(3, motion), 4, 25)
    notes = causes_of(given, closed_form.solve(given, ALL_POSES))
    assert [note.code for note in notes] == ["wrong_label"] * 2
    assert "sweep 4 " in notes[0].message
    assert "sweep 5 " in notes[1].message


def test_without_rotation_noise_inverted_poses_look_like_exchanged_names():
    given = inverted(problem(machine(3), MOTION, 5e-4, 1e-6, seed=3))
    notes = causes_of(given, closed_form.solve(given, ALL_POSES))
    assert {note.code for note in notes} == {"inverted_poses", "exchanged_joints"}


@pytest.mark.parametrize(
    "change", [inverted, lambda g: replace(g, p_world_sensor=1.5 * g.p_world_sensor)], ids=["inverted", "scaled"]
)
def test_what_unlabelled_poses_cannot_tell_is_not_a_misfit(change):
    given = change(sound().without_labels())
    fit = kinematic.solve(given)
    assert fit.sigma_t is not None
    assert fit.sigma_t < 5e-3
    assert assess(given, fit).refusal is None


def test_a_frame_that_is_left_handed_throughout_gives_the_mirror_image():
    given = sound()
    S = np.diag([1.0, 1.0, -1.0])
    mirror = replace(given, p_world_sensor=given.p_world_sensor @ S, R_world_sensor=S @ given.rotations @ S)
    one, other = kinematic.solve(given), kinematic.solve(mirror)
    assert assess(mirror, other).refusal is None
    np.testing.assert_allclose(S @ other.offset, one.offset, atol=1e-6)
    assert other.major_radius == pytest.approx(-one.major_radius, abs=1e-6)


@pytest.mark.parametrize("outliers", [0.0, 0.4])
@pytest.mark.parametrize("readings", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_sound_poses_have_no_cause(seed, readings, outliers):
    given = read(sound(seed)) if readings else sound(seed)
    rng = np.random.default_rng(seed)
    bad = rng.random(len(given)) < outliers
    given = replace(given, p_world_sensor=given.p_world_sensor + bad[:, None] * rng.uniform(-0.5, 0.5, (len(given), 3)))
    estimate = kinematic.solve(given)
    assert causes_of(given, estimate) == ()
    assert {note.code for note in assess(given, estimate).notes} <= {"many_rejected"}


def test_random_poses_have_no_cause():
    rng = np.random.default_rng(0)
    given = replace(sound(), R_world_sensor=rotation_from_quat_wxyz(rng.normal(size=(len(MOTION), 4))))
    assert causes_of(given, closed_form.solve(given, ALL_POSES)) == ()


def test_nothing_is_tried_on_sound_poses(monkeypatch):
    given = sound()
    estimate = kinematic.solve(given)
    monkeypatch.setattr("solvers.verdict.assess.causes_of", lambda *_: pytest.fail("a cause was tried"))
    assert assess(given, estimate).refusal is None


def test_causes_are_tried_on_few_of_many_poses(monkeypatch):
    given = relabelled(problem(machine(1), paper(), *SIGMA), 3, 20)
    sizes = []
    fit = kinematic.solve
    estimate = fit(given)
    monkeypatch.setattr("solvers.verdict.diagnose.kinematic.solve", lambda p, *o: sizes.append(len(p)) or fit(p, *o))
    assert [note.code for note in causes_of(given, estimate)] == ["wrong_label"]
    assert max(sizes) < 1000
    assert len(CAUSES) == 5


def flexed(amplitude: float, joint: int, motion=MOTION, seed: int = 3) -> Problem:
    """The sensor is shifted by cos(2 angle) along a direction fixed in the world (alpha), or in the support (beta)."""
    given = problem(machine(seed), motion, *SIGMA, seed=seed)
    support = machine(seed).T_world_torus[0, :3, :3] @ rot_x(motion.angles[:, 0] * joint)
    shift = amplitude * np.cos(2 * motion.angles[:, [joint]]) * (support @ np.array([0.6, 0.0, 0.8]))
    return replace(given, p_world_sensor=given.p_world_sensor + shift)


@pytest.mark.parametrize("joint, code", [(0, "flex_alpha"), (1, "flex_beta")])
def test_flex_is_a_note_with_its_amplitude(joint, code):
    given = flexed(2e-3, joint, wandering(2000))
    verdict = assess(given, kinematic.solve(given))
    assert verdict.refusal is None
    note = next(note for note in verdict.notes if note.code == code)
    assert 0.5 < float(note.message.split("amplitude of ")[1].split(" mm")[0]) < 3.0


def test_noise_is_no_flex_and_not_correlated():
    for seed in range(15):
        given = sound(seed, wandering(300, seed=seed)) if seed % 2 else sound(seed)
        assert assess(given, kinematic.solve(given)).notes == ()


def test_noise_that_drifts_is_correlated():
    given = sound()
    rng = np.random.default_rng(1)
    drift = np.zeros((len(given), 3))
    for k in range(1, len(given)):
        drift[k] = 0.8 * drift[k - 1] + 5e-4 * rng.normal(size=3)
    slow = replace(given, p_world_sensor=given.p_world_sensor + drift)
    verdict = assess(slow, kinematic.solve(slow))
    assert verdict.refusal is None
    assert "correlated_residuals" in [note.code for note in verdict.notes]


def test_the_correlation_is_that_of_neighbours_in_a_sweep():
    given = Problem.of_poses(np.zeros((4000, 3)), np.tile(np.eye(3), (4000, 1, 1)))
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(6, 4001))
    assert neighbour_correlation(given, noise[:, 1:]) < 0.05
    assert neighbour_correlation(given, noise[:, 1:] + noise[:, :-1]) == pytest.approx(0.5, abs=0.04)
    alternating = replace(given, placement=np.arange(4000) % 2)
    assert neighbour_correlation(alternating, noise[:, 1:] + noise[:, :-1]) == 0
    assert residual_notes(rng.uniform(size=(2, 4000)), 1e-9 * noise[:, 1:], 8000, Correlation(), True) == ()


def test_limits_decide_what_is_accepted():
    given = transposed(sound())
    estimate = closed_form.solve(given, ALL_POSES)
    assert causes_of(given, estimate)
    assert causes_of(given, estimate, Limits(max_sigma_t_m=1e-5)) == ()


def test_a_moved_base_is_found_from_what_the_solver_rejected():
    given = pushed(sound())
    verdict = assess(given, kinematic.solve(given))
    assert [note.code for note in verdict.notes] == ["base_moved"]
    assert "pose 323" in verdict.notes[0].message


def test_a_flipped_marker_at_the_end_is_no_moved_base():
    motion = sweeps_deg(range(-90, 91, 30), range(0, 360, 6), range(0, 161, 20), range(0, 360, 6))
    late = np.arange(len(motion)) >= round(0.8 * len(motion))
    for seed in (0, 4, 9):
        given = problem(machine(seed), motion, 1e-3, float(np.radians(0.1)), seed=seed)
        flipped = given.rotations @ np.diag([1.0, -1.0, -1.0])
        given = replace(given, R_world_sensor=np.where(late[:, None, None], flipped, given.rotations))
        verdict = assess(given, kinematic.solve(given))
        assert [note.code for note in verdict.notes] == ["many_rejected"]
