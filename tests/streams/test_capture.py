"""The parts of a capture: frames, marks, the file that survives, gaps, the state, the calibration so far."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.errors import InputError
from carm_kin.streams import capture_file, estimate
from carm_kin.streams.capture_file import CaptureFile
from carm_kin.streams.client import Address
from carm_kin.streams.frames import NO_REFERENCE, Frame, Frames
from carm_kin.streams.live import MOST_THINNED, Gaps, Live, Pose, Thinned
from carm_kin.streams.marks import Marks
from carm_kin.streams.operator import HELP, Operator
from carm_kin.streams.tracking import Observation
from helpers.simulated import machine


def pose(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-1, 1, 3)
    return T


def seen(tool: str, stamp_s: float | None, T: np.ndarray | None, fault: str = "") -> Observation:
    return Observation(tool, stamp_s, 0, T, fault)


def good(frames: list[Frame]) -> list[tuple[float, bool]]:
    return [(frame.time_s, frame.T is not None) for frame in frames]


# Frames


def test_without_a_reference_every_pose_of_the_tool_is_a_frame():
    frames = Frames("A")
    assert frames.add(seen("B", 1.0, pose()), 9.0) == []
    (one,) = frames.add(seen("A", 1.0, pose(1)), 9.0)
    assert (one.time_s, one.received_s, one.fault) == (1.0, 9.0, "")
    np.testing.assert_array_equal(one.T, pose(1))
    (other,) = frames.add(seen("A", None, None, "invalid"), 9.5)
    assert (other.time_s, other.T, other.fault) == (9.5, None, "invalid")


@pytest.mark.parametrize("first", ["tool", "reference"])
def test_the_reference_of_the_same_moment_cancels_the_tracker(first):
    T_tracker_reference, T_reference_tool = pose(1), pose(2)
    pair = [seen("A", 5.0, T_tracker_reference @ T_reference_tool), seen("R", 5.0, T_tracker_reference)]
    frames = Frames("A", "R")
    before = [seen("A", 4.9, pose(3)), seen("R", 4.9, pose(4))]
    done = [f for o in [*before, *(pair if first == "tool" else reversed(pair))] for f in frames.add(o, 9.0)]
    assert good(done) == [(4.9, True), (5.0, True)]
    np.testing.assert_allclose(done[1].T, T_reference_tool, atol=1e-14)
    assert frames.rest() == []


def test_a_reference_of_another_moment_is_not_taken():
    frames = Frames("A", "R")
    assert frames.add(seen("R", 1.0, pose(1)), 0.0) == []
    assert frames.add(seen("A", 1.1, pose(2)), 0.0) == []
    (lost,) = frames.add(seen("A", 1.2, pose(2)), 0.0)
    assert (lost.time_s, lost.T, lost.fault) == (1.1, None, NO_REFERENCE)
    (late,) = frames.add(seen("R", 1.3, pose(1)), 0.0)
    assert (late.time_s, late.T) == (1.2, None)
    assert frames.add(seen("A", 1.4, pose(2)), 0.0) == []
    assert good(frames.rest()) == [(1.4, False)]


def test_a_reference_that_is_not_seen_gives_no_pose():
    frames = Frames("A", "R")
    frames.add(seen("R", 1.0, None, "MISSING"), 0.0)
    (one,) = frames.add(seen("A", 1.0, pose()), 0.0)
    assert (one.T, one.fault) == (None, "no reference (MISSING)")


def test_names_that_the_header_cut_are_known():
    frames = Frames("StylusTipToReferenceTransform")
    assert frames.of_tool(seen("StylusTipToReference", 1.0, pose()))
    assert frames.of_tool(seen("StylusTipToReferenceTransform", 1.0, pose()))
    assert not frames.of_tool(seen("StylusTipToRef", 1.0, pose()))
    assert not Frames("Stylus").of_tool(seen("StylusTip", 1.0, pose()))


# Marks


def test_marks_of_an_operator():
    marks = Marks()
    assert marks.cells == ("", "", "1", "", "")
    marks = marks.next_moving()
    assert marks.cells == ("", "", "1", "", "")
    marks = marks.new_sweep()
    assert marks.cells == ("1", "orbital", "1", "", "")
    marks = marks.labelled("-30")
    assert marks.cells == ("1", "orbital", "1", "-30", "")
    assert marks.labelled("-20.5").cells == ("2", "orbital", "1", "-20.5", "")
    marks = marks.next_moving()
    assert marks.cells == ("2", "angular", "1", "", "")
    assert marks.labelled(" 12 ").cells == ("2", "angular", "1", "", "12")
    assert marks.new_placement().cells == ("", "", "2", "", "")
    assert marks.end_sweep().labelled("5").cells == ("3", "angular", "1", "", "5")


@pytest.mark.parametrize("degrees", ["", "abc", "nan", "inf", "361", "1,5"])
def test_labels_that_are_no_angles(degrees):
    with pytest.raises(InputError, match="no angle in degrees"):
        Marks(moving="orbital").labelled(degrees)


def test_a_label_needs_to_know_which_joint_moves():
    with pytest.raises(InputError, match="which joint moves"):
        Marks().labelled("5")


@pytest.mark.parametrize(
    "names", [("", "b"), ("a,", "b"), ("a b", "c"), ('a"', "b"), ("a\n", "b"), ("#a", "b"), ("a", "a")]
)
def test_names_of_joints_that_are_no_columns(names):
    with pytest.raises(InputError):
        Marks(*names)


def test_the_first_sweep_by_option():
    assert Marks().begun(None, None) == Marks()
    assert Marks().begun("orbital", -30.0).cells == ("1", "orbital", "1", "-30", "")
    assert Marks("swivel", "slide").begun("swivel", None).cells == ("1", "swivel", "1", "", "")
    with pytest.raises(InputError, match="neither 'angular' nor 'orbital'"):
        Marks().begun("swivel", None)


def test_keys():
    operator = Operator(live := Live(Marks()))
    operator.press("l")
    assert operator.entry is None
    assert "which joint moves" in live.snapshot().events[-1]
    operator.press("ms")
    operator.press("l-3x\x7f0\n")
    assert live.marks.cells == ("1", "orbital", "1", "-30", "")
    operator.press("l12\x1b")
    assert live.marks.cells == ("1", "orbital", "1", "-30", "")
    operator.press("lq")
    assert (operator.entry, operator.stopped) == ("q", False)
    assert operator.prompt != HELP
    operator.press("\r")
    assert "'q' is no angle" in live.snapshot().events[-1]
    operator.press("Pq")
    assert (live.marks.placement, live.marks.within, operator.stopped, operator.prompt) == (2, False, True, HELP)


# The file


def frame(k: int, T: np.ndarray | None = None, fault: str = "") -> Frame:
    return Frame(1000.0 + k, 2000.0 + k, T, fault)


def test_the_file_is_a_native_recording_at_every_moment(tmp_path):
    path, marks = tmp_path / "rec.csv", Marks().begun("orbital", -30.0)
    with CaptureFile.create(path, marks) as file:
        for k in range(5):
            file.append([frame(2 * k, pose(k)), frame(2 * k + 1, None, "out, of\nview")], marks)
            found = carm_kin.read_recording(path)
            assert (len(found), found.missing) == (k + 1, k + 1)
    np.testing.assert_allclose(found.p_world_sensor, [pose(k)[:3, 3] for k in range(5)], atol=1e-9)
    np.testing.assert_allclose(found.R_world_sensor, [pose(k)[:3, :3] for k in range(5)], atol=4e-9)
    np.testing.assert_allclose(found.time_s, 1000 + 2 * np.arange(5))
    assert list(found.metadata["received_s"]) == [f"{2000 + 2 * k}.000000" for k in range(5)]
    (sweep,) = found.sweeps
    assert (sweep.label, sweep.moving, sweep.placement) == ("1", "orbital", "1")
    assert sweep.held == {"angular": pytest.approx(np.radians(-30))}


def test_the_lines_are_on_the_disk_when_append_returns(tmp_path, monkeypatch):
    path, sizes = tmp_path / "rec.csv", []
    monkeypatch.setattr(capture_file, "_to_disk", lambda descriptor: sizes.append(os.fstat(descriptor).st_size))
    with CaptureFile.create(path, Marks()) as file:
        assert sizes == [path.stat().st_size]
        file.append([frame(0, pose())], Marks())
        assert sizes[1:] == [path.stat().st_size]
        assert sizes[1] > sizes[0]


def test_a_capture_writes_over_nothing(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("precious")
    with pytest.raises(InputError, match=r"the file exists; give another name, or --append"):
        CaptureFile.create(path, Marks())
    with pytest.raises(InputError, match="was not written by a capture"):
        CaptureFile.resume(path, Marks())
    with pytest.raises(InputError, match="cannot be written"):
        CaptureFile.create(tmp_path / "none" / "rec.csv", Marks())
    assert path.read_text() == "precious"


@pytest.mark.parametrize("make", [CaptureFile.create, CaptureFile.resume])
def test_a_file_without_frames_leaves_nothing(tmp_path, make):
    with make(tmp_path / "rec.csv", Marks()):
        pass
    assert list(tmp_path.iterdir()) == []


def written(path: Path) -> bytes:
    marks = Marks().begun("orbital", None)
    with CaptureFile.create(path, marks) as file:
        file.append([frame(k, pose(k)) for k in range(3)], marks)
        file.append([frame(3, pose(3))], marks.new_sweep().new_placement())
    return path.read_bytes()


@given(st.integers(0, 10**6))
def test_a_file_cut_anywhere_is_gone_on_with(tmp_path_factory, cut):
    path = tmp_path_factory.mktemp("cut") / "rec.csv"
    whole = written(path)
    whole = whole[: cut % (len(whole) + 1)]
    path.write_bytes(whole)
    with CaptureFile.resume(path, Marks()) as file:
        file.append([frame(9, pose(9))], file.marks.begun("orbital", None))
    found = carm_kin.read_recording(path)
    kept = max(whole.count(b"\n") - 1, 0)
    assert len(found) == kept + 1
    assert list(found.time_s) == [1000 + k for k in range(kept)] + [1009]
    expected = {0: ["1"], 1: ["1", "2"], 2: ["1", "1", "2"], 3: ["1", "1", "1", "2"], 4: ["1", "1", "1", "", "2"]}
    assert list(found.sweep) == (expected[kept] if kept else ["1"])
    assert found.placement[-1] == ("2" if kept == 4 else "1")


def test_a_file_of_other_joints_is_not_gone_on_with(tmp_path):
    written(tmp_path / "rec.csv")
    with pytest.raises(InputError, match="was not written by a capture of these joints"):
        CaptureFile.resume(tmp_path / "rec.csv", Marks("swivel", "slide"))


def test_a_full_disk_is_said():
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("the system has no /dev/full")
    with (
        full.open("wb", buffering=0) as device,
        pytest.raises(InputError, match="/dev/full: cannot be written: No space"),
    ):
        CaptureFile(full, device, Marks(), 0).append([frame(0, pose())], Marks())


# What is counted


def test_gaps_in_numbers_are_counted_exactly():
    gaps = Gaps()
    for number in [*range(3, 63, 3), 69, *range(72, 100, 3)]:
        gaps.add(number)
    assert gaps.missing == 2


@given(st.lists(st.integers(0, 5), min_size=1, max_size=30), st.integers(0, 2**32 - 1))
def test_gaps_in_stamps_are_counted_through_jitter(lost, seed):
    """Stamps of 10 ms off by 0.2 ms: 6 steps over the usual one are 59.6/10.4 = 5.7 to 60.4/9.6 = 6.3."""
    index = np.cumsum([*[1] * 20, *(n + 1 for m in lost for n in (m, 0, 0))])
    gaps = Gaps()
    for stamp in 1e9 + 0.01 * index + np.random.default_rng(seed).uniform(-2e-4, 2e-4, len(index)):
        gaps.add(stamp)
    assert gaps.missing == sum(lost)


def test_repeated_stamps_and_restarts_are_no_gaps():
    gaps = Gaps()
    for stamp in np.repeat(np.arange(30.0), 3):
        gaps.add(stamp)
    gaps.restart()
    gaps.add(500.0)
    gaps.add(501.0)
    gaps.add(2.0)
    gaps.add(3.0)
    assert gaps.missing == 0


@given(st.integers(0, 20 * MOST_THINNED))
def test_thinned_items_are_evenly_spread_and_few(n):
    thinned = Thinned()
    for k in range(n):
        thinned.add(k)
    assert thinned.count == n
    assert min(n, MOST_THINNED // 2) <= len(thinned.items) <= MOST_THINNED
    assert thinned.items == list(range(0, n, thinned.items[1] if len(thinned.items) > 1 else 1))[: len(thinned.items)]
    assert not n or n - thinned.items[-1] <= (thinned.items[1] if len(thinned.items) > 1 else 1)


def test_the_state_counts_what_is_stored():
    live, marks = Live(Marks()), Marks().begun("orbital", None)
    turned = pose()
    turned[:3, :3] = turned[:3, :3] @ Rotation.from_rotvec([0, 0.7, 0]).as_matrix()
    live.add([frame(0, pose()), frame(1, None, "MISSING"), frame(2, pose()), frame(3, turned)], marks)
    now = live.snapshot()
    assert (now.frames, now.poses, now.repeated, now.faults) == (4, 3, 1, {"MISSING": 1})
    assert (now.visible, now.sweep_poses, now.stalled) == (0.75, 3, False)
    assert now.turned_rad == pytest.approx(0.7)
    poses, of = live.some()
    assert (len(poses), of) == (2, 2)
    live.add([frame(4, pose(1))], marks.new_sweep())
    assert live.snapshot().sweep_poses == 1


def test_names_and_reasons_of_a_hostile_server_stay_few():
    live = Live(Marks())
    for k in range(1000):
        live.saw(seen(f"tool {k}", None, None), captured=False)
        live.add([frame(k, None, f"reason {k}")], live.marks)
    now = live.snapshot()
    assert len(now.tools) <= 40
    assert len(now.faults) <= 21
    assert now.faults.total() == 1000


# The calibration so far


def captured(n: int, sigma_m: float, sigma_rad: float, seed: int = 0) -> tuple[list[Pose], np.ndarray]:
    """Poses of a C-arm on three orbital sweeps and an angular one, marked, and its offset."""
    truth, rng = machine(seed), np.random.default_rng(seed)
    poses, marks = [], Marks()
    for moving, held in (("orbital", -40.0), ("orbital", 0.0), ("orbital", 40.0), ("angular", 20.0)):
        path = np.radians(np.linspace(-60, 60, n // 4))
        still = np.full(n // 4, np.radians(held))
        angles = np.stack([path, still] if moving == "angular" else [still, path], axis=1)
        marks = Marks(sweep=marks.sweep, moving=moving).new_sweep().labelled(f"{held}")
        p, R = truth.poses(angles)
        p = p + sigma_m * rng.normal(size=p.shape)
        R = R @ Rotation.from_rotvec(sigma_rad * rng.normal(size=p.shape)).as_matrix()
        for k in range(len(p)):
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = R[k], p[k]
            poses.append(Pose(T, marks))
    return poses, truth.offset


def test_the_calibration_so_far_is_right_and_knows_how_well():
    """Of 200 poses with noise: the offset is off by less than 5 of its standard deviations in every direction."""
    poses, offset = captured(200, 5e-4, 1e-3)
    now = estimate.current(poses, 200)
    assert now.refusal == ""
    assert np.linalg.norm(now.offset_m - offset) < 5 * now.worst_sigma_m
    assert 0 < now.worst_sigma_m < 2e-3
    assert now.worst_sigma_m >= now.sigma_m.max() > 0


def test_the_swept_arcs_are_those_of_the_joints():
    poses, _ = captured(200, 1e-5, 1e-5)
    (a0, a1), (b0, b1) = estimate.current(poses, 200).swept_rad
    np.testing.assert_allclose(np.degrees([a0, a1, b0, b1]), [-60, 60, -60, 60], atol=0.1)


def test_sigma_is_that_of_all_poses_not_of_the_thinned_ones():
    """1200 poses of which a third is looked at: sigma is that of all to a quarter (noise is estimated from 400). What
    chance shows of systematic effects does not shrink."""
    poses, _ = captured(1200, 5e-4, 1e-3)
    whole, part = estimate.current(poses, 1200), estimate.current(poses[::3], 1200)
    assert part.worst_sigma_m == pytest.approx(whole.worst_sigma_m, rel=0.25)
    few = estimate.current(poses[::3], 400)
    assert 1.1 * part.worst_sigma_m < few.worst_sigma_m <= 3**0.5 * part.worst_sigma_m


def test_what_is_missing_is_said_in_words():
    poses, _ = captured(200, 5e-4, 1e-3)
    now = estimate.current(poses[:50], 50)
    assert (now.offset_m, now.worst_sigma_m, now.swept_rad) == (None, None, None)
    assert "no angular motion" in now.refusal
    assert "too few" in estimate.current(poses[:2], 2).refusal


def test_a_placement_that_has_just_begun_does_not_spoil_the_others():
    poses, _ = captured(200, 5e-4, 1e-3)
    fresh = Pose(pose(), poses[-1].marks.new_placement())
    now = estimate.current([*poses, fresh], 201)
    assert (now.refusal, now.poses) == ("", 200)


@pytest.mark.parametrize(
    "angles, expected",
    [
        ([10, 20, 30], (10, 30)),
        ([170, -170, 175], (170, 190)),
        ([-100, 100, 180], (100, 260)),
        ([5], (5, 5)),
        ([350, 365, 0], (-10, 5)),
    ],
)
def test_arcs_go_round_the_circle(angles, expected):
    np.testing.assert_allclose(np.degrees(estimate.arc(np.radians(angles))), expected, atol=1e-9)


# Addresses


@pytest.mark.parametrize(
    "text, expected",
    {
        "tracker": ("tracker", 18944),
        "tracker:1234": ("tracker", 1234),
        "10.0.0.1:65535": ("10.0.0.1", 65535),
        "[::1]": ("::1", 18944),
        "[::1]:99": ("::1", 99),
    }.items(),
)
def test_addresses(text, expected):
    address = Address.parse(text, 18944)
    assert (address.host, address.port) == expected
    assert Address.parse(str(address), 1) == address


@pytest.mark.parametrize("text", ["", ":", ":99", "a:0", "a:65536", "a:x", "a:-1", "::1", "a:", "a:٣"])
def test_what_is_no_address(text):
    with pytest.raises(InputError, match="server"):
        Address.parse(text, 18944)
