"""Recordings in memory: checks, sweeps, placements, warnings and the solvers' problem."""

import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from carm_kin.calibration.problem import to_problem
from carm_kin.errors import InputError
from carm_kin.recording.recording import PoseError, Recording
from solvers.se3 import exp_so3

RNG = np.random.default_rng(0)


def poses(n, **more):
    return Recording(RNG.normal(size=(n, 3)), exp_so3(RNG.normal(size=(n, 3))), **more)


def two_sweeps(**changes):
    """Poses 0, 1, 4 move orbitally at alpha = 10 deg, poses 2, 3 move angularly at beta = 20 deg, pose 5 is loose."""
    known = {
        "sweep": ["o", "o", "a", "a", "o", ""],
        "moving": ["orbital", "orbital", "angular", "angular", "orbital", ""],
        "placement": ["P", "P", "Q", "Q", "P", "Q"],
        "joints": {
            "angular": np.radians([10, np.nan, 1, 2, 10, 7]),
            "orbital": np.radians([0, 1, np.nan, 20, 3, np.nan]),
        },
    }
    return poses(6, **(known | changes))


def test_defaults_are_one_unlabelled_placement_and_no_sweeps():
    recording = poses(3)
    assert len(recording) == 3
    assert recording.placements == ("",)
    assert recording.sweeps == []
    assert recording.warnings == ()
    assert recording.pose_number.tolist() == [0, 1, 2]


def test_a_recording_is_frozen():
    with pytest.raises(FrozenInstanceError):
        poses(1).missing = 2


@pytest.mark.parametrize(
    "change, words",
    [
        ({"p_world_sensor": np.zeros((2, 2))}, ["p_world_sensor", "(2, 2)", "(2, 3)"]),
        ({"p_world_sensor": [[0, 0, 0], ["a", 0, 0]]}, ["p_world_sensor", "not an array of numbers"]),
        ({"p_world_sensor": [[0, 0, 0], [0, np.nan, 0]]}, ["pose 1", "p_world_sensor", "not finite"]),
        ({"R_world_sensor": np.eye(4)[None].repeat(2, 0)}, ["R_world_sensor", "(2, 4, 4)", "(2, 3, 3)"]),
        ({"R_world_sensor": np.array([1.0, 1.002])[:, None, None] * np.eye(3)}, ["pose 1", "not a rotation"]),
        ({"R_world_sensor": np.array([np.eye(3), np.diag([1, 1, -1])])}, ["pose 1", "reflection", "right-handed"]),
        ({"time_s": [0, np.inf]}, ["pose 1", "time_s", "not finite"]),
        ({"sweep": ["a"]}, ["sweep", "1 entries for 2 poses"]),
        ({"joints": {"lift": [0, -np.inf]}}, ["pose 1", "q_lift", "not finite"]),
        ({"prismatic": frozenset({"lift"})}, ["prismatic", "lift"]),
        ({"metadata": {"note": ["a", "b", "c"]}}, ["note", "3 entries for 2 poses"]),
        ({"pose_number": [0, 1, 2]}, ["pose_number", "(3,)", "(2,)"]),
        ({"missing": 1, "pose_number": [1, 0]}, ["pose_number", "increase"]),
        ({"missing": 1, "pose_number": [0, 3]}, ["pose_number", "below", "3"]),
    ],
)
def test_bad_arrays_are_refused(change, words):
    fields = {"p_world_sensor": np.zeros((2, 3)), "R_world_sensor": np.eye(3)[None].repeat(2, 0)}
    with pytest.raises(InputError) as error:
        Recording(**(fields | change))
    assert all(word in str(error.value) for word in words), str(error.value)


def test_rotations_within_the_tolerance_are_kept_as_they_are():
    R = 1.0004 * np.eye(3)[None]
    assert np.array_equal(Recording(np.zeros((1, 3)), R).R_world_sensor, R)


@pytest.mark.parametrize(
    "change, pose, column, words",
    [
        ({"moving": ["orbital", "angular", *"aaoo"]}, 1, "moving", ["sweep 'o'", "'angular'", "'orbital'"]),
        ({"moving": ["orbital", "orbital", "angular", "", "orbital", ""]}, 3, "moving", ["sweep 'a'", "''"]),
        ({"placement": ["P", "P", "Q", "P", "P", "Q"]}, 3, "placement", ["sweep 'a'", "'P'", "'Q'"]),
        ({"joints": {"angular": np.radians([10, np.nan, 1, 2, 10.06, 7])}}, 4, "q_angular", ["10.06", "deg"]),
        ({"joints": {"angular": np.radians([10, np.nan, 1, 2, 12, 7])}}, 4, "q_angular", ["12", "deg"]),
        ({"joints": {"lift": [0, 0.002, 0, 0, 0, 0]}, "prismatic": {"lift"}}, 1, "q_lift", ["'2'", "'0'", "mm"]),
    ],
)
def test_contradicting_labels_are_refused(change, pose, column, words):
    with pytest.raises(PoseError) as error:
        two_sweeps(**change)
    assert (error.value.pose, error.value.column) == (pose, column)
    assert all(word in str(error.value) for word in [*words, f"pose {pose}", column]), str(error.value)


@pytest.mark.parametrize(
    "change",
    [
        {"joints": {"angular": np.radians([10, 10 + 9e-7, 1, 2, 10, 7])}},
        {"joints": {"angular": np.radians([10, 11, 1, 2, 10, 7])}},
        {"joints": {"angular": np.radians([10, 10.04, 1, 2, 10, 7])}},
        {"joints": {"lift": [1, 1 + 9e-10, 0, 0, 1, 0]}, "prismatic": {"lift"}},
        {"joints": {"lift": [1, 1 + 4e-5, 0, 0, 1, 0]}, "prismatic": {"lift"}},
        {"moving": None, "joints": {"angular": np.arange(6.0)}},
        {"moving": [""] * 6, "joints": {"angular": np.arange(6.0)}},
    ],
)
def test_labels_that_do_not_contradict_are_taken(change):
    assert len(two_sweeps(**change)) == 6


def test_the_label_of_a_sweep_is_the_mean_of_what_a_display_shows():
    recording = two_sweeps(joints={"angular": np.radians([10, np.nan, 1, 2, 11, 7]), "orbital": np.full(6, np.nan)})
    assert np.degrees(recording.sweep_labels["angular"][0]) == pytest.approx(10.5)
    # rounding to whole degrees, and half a degree of wandering
    assert np.degrees(recording.sweep_label_sigma["angular"][0]) == pytest.approx(np.hypot(1 / np.sqrt(12), 0.5))
    problem = to_problem(recording)
    assert problem.label_read[[0, 1, 4], 0].all()
    assert problem.label_read.sum() == 3
    assert not to_problem(recording, sigma_label_rad=0.0).label_read.any()
    assert to_problem(recording, sigma_label_rad=0.01).sigma_label[0, 0] == 0.01


def test_a_pose_error_survives_a_process_pool():
    error = pickle.loads(pickle.dumps(PoseError("bad", 3, "moving")))
    assert (str(error), error.pose, error.column) == ("pose 3, column moving: bad", 3, "moving")


def test_sweeps_gather_their_poses_and_held_labels():
    first, second = two_sweeps().sweeps
    assert (first.label, first.moving, first.placement) == ("o", "orbital", "P")
    assert first.poses.tolist() == [0, 1, 4]
    assert first.held == {"angular": np.radians(10)}
    assert (second.label, second.moving, second.placement) == ("a", "angular", "Q")
    assert second.poses.tolist() == [2, 3]
    assert second.held == {"orbital": np.radians(20)}


def test_an_unknown_moving_joint_holds_nothing():
    assert [sweep.held for sweep in two_sweeps(moving=None).sweeps] == [{}, {}]


def test_placements_are_in_order_of_first_appearance():
    assert poses(4, placement=["b", "a", "b", ""]).placements == ("b", "a", "")


def test_text_loses_the_white_space_around_it():
    recording = poses(1, sweep=[" s1 "], placement=[2])
    assert (recording.sweep[0], recording.placement[0]) == ("s1", "2")


@pytest.mark.parametrize("index", [np.array([4, 2]), np.arange(6) % 2 == 0, slice(1, None, 2)])
def test_select_takes_every_array_along(index):
    whole = two_sweeps(
        time_s=np.arange(6.0), metadata={"note": list("abcdef")}, missing=2, pose_number=[0, 1, 2, 4, 5, 7]
    )
    part = whole.select(index)
    for name in ("p_world_sensor", "R_world_sensor", "time_s", "sweep", "moving", "placement", "pose_number"):
        assert np.array_equal(getattr(part, name), getattr(whole, name)[index])
    assert np.array_equal(part.joints["angular"], whole.joints["angular"][index], equal_nan=True)
    assert np.array_equal(part.metadata["note"], whole.metadata["note"][index])
    assert part.missing == 0


def test_select_of_nothing_is_empty():
    empty = two_sweeps().select(np.array([], dtype=int))
    assert len(empty) == 0
    assert empty.sweeps == []
    assert len(to_problem(empty)) == 0


def repeated(n):
    p, R = RNG.normal(size=(1, 3)).repeat(n, 0), np.eye(3)[None].repeat(n, 0)
    return p, R


@pytest.mark.parametrize(
    "recording, code, words",
    [
        (Recording(*repeated(3)), "duplicated_poses", ["2 of 3"]),
        (Recording(repeated(3)[0]), "duplicated_poses", ["2 of 3"]),
        (poses(3, sweep=["a", "b", "b"]), "sweep_of_one_pose", ["1 sweeps", "'a'"]),
        (poses(7, sweep=list("abcdefg")), "sweep_of_one_pose", ["7 sweeps", "'e' and 2 more"]),
        (poses(4, time_s=[0, 2, 2, 1]), "time_not_increasing", ["2 times", "pose 2"]),
        (poses(2, missing=3), "missing_frames", ["3 of 5"]),
        (poses(2, moving=["orbital", ""]), "moving_without_sweep", ["1 poses"]),
        (poses(2, metadata={"Sweep": ["a", "a"]}), "misspelt_column", ["'Sweep'", "'sweep'"]),
    ],
)
def test_warnings(recording, code, words):
    (note,) = recording.warnings
    assert note.code == code
    assert all(word in note.message for word in words), note.message


@pytest.mark.parametrize(
    "change, words",
    [
        ({"joints": {"lift": [1, 1, 2, 2, 1, 2]}, "placement": None}, "'lift' has 2000 mm at pose 2 and 1000 mm"),
        ({"joints": {"lift": [np.nan] * 4 + [3, 2]}, "placement": None, "moving": None}, "2000 mm at pose 5"),
        ({"joints": {"lift": np.zeros(6), "tilt": np.radians([1, 1, 2, 2, 1, 3])}}, "'tilt' has 3 deg at pose 5"),
    ],
)
def test_another_joint_that_moves_in_a_placement_is_a_warning(change, words):
    (note,) = two_sweeps(prismatic=frozenset({"lift"}), **change).warnings
    assert note.code == "other_joint_moved"
    assert words in note.message
    assert "'placement' of its own" in note.message


@pytest.mark.parametrize(
    "change",
    [
        {"joints": {"lift": [1, 1, 2, 2, 1, 2]}},
        {"joints": {"lift": [1, 1 + 9e-10, 2, 2, np.nan, np.nan]}},
        {"joints": {"lift": np.zeros(6), "swivel": [1, 1, 2, 2, 1, 3]}, "moving": ["o", "o", "", "", "o", ""]},
    ],
)
def test_what_stands_still_or_may_be_an_axis_is_no_warning(change):
    assert two_sweeps(prismatic=frozenset({"lift"}), **change).warnings == ()


def test_poses_that_share_only_the_position_are_no_duplicates():
    assert Recording(np.zeros((3, 3)), exp_so3(RNG.normal(size=(3, 3)))).warnings == ()


def test_problem_of_two_sweeps():
    problem = to_problem(two_sweeps())
    assert problem.placement.tolist() == [0, 0, 1, 1, 0, 1]
    assert problem.held[:, 0].tolist() == [0, 0, -1, -1, 0, -1]
    assert problem.held[:, 1].tolist() == [-1, -1, 1, 1, -1, -1]
    expected = np.radians([[10, 0], [10, 1], [1, 20], [2, 20], [10, 3], [7, np.nan]])
    assert np.array_equal(problem.label, expected, equal_nan=True)


def test_problem_with_other_names_of_the_joints():
    recording = two_sweeps(
        moving=["slide", "slide", "swivel", "swivel", "slide", ""], joints={"swivel": np.full(6, 0.5)}
    )
    problem = to_problem(recording, angular="swivel", orbital="slide")
    assert problem.held[:, 0].tolist() == [0, 0, -1, -1, 0, -1]
    assert problem.label[:, 0].tolist() == [0.5] * 6
    assert np.isnan(problem.label[:, 1]).all()


@pytest.mark.parametrize("change", [{"moving": None}, {"moving": [""] * 6}, {"sweep": None}, {"sweep": [""] * 6}])
def test_both_joints_are_free_without_a_sweep_or_a_moving_joint(change):
    assert np.all(to_problem(two_sweeps(**change)).held == -1)


def test_problem_of_positions_only():
    problem = to_problem(Recording(np.zeros((2, 3))))
    assert problem.R_world_sensor is None
    assert problem.placement.tolist() == [0, 0]
    assert np.isnan(problem.label).all()


@pytest.mark.parametrize(
    "change, words",
    [
        ({"sweep": None, "moving": ["", "lift", *[""] * 4]}, ["pose 1", "'lift'", "--urdf"]),
        (
            {"moving": [*["orbitl"] * 2, "", "", "orbitl", ""], "joints": {}},
            ["pose 0", "'orbitl'", "did you mean 'orbital'?"],
        ),
        ({"joints": {"angular": np.zeros(6)}, "prismatic": frozenset({"angular"})}, ["'angular'", "angles"]),
    ],
)
def test_problem_refuses_what_two_axes_cannot_do(change, words):
    with pytest.raises(InputError) as error:
        to_problem(two_sweeps(**change))
    assert all(word in str(error.value) for word in words), str(error.value)
