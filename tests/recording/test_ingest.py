"""What becomes of the frames of a file, whatever its format: dropped with a reason, converted, composed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.errors import InputError
from carm_kin.recording.declarations import EULER_ORDERS, Declarations
from carm_kin.recording.ingest import ingest
from carm_kin.recording.intake import Dropped, Intake, summed
from carm_kin.recording.raw import Raw, Track, joined
from carm_kin.recording.recording import Recording, Source
from carm_kin.simulation.simulate import simulate
from helpers.trackers import MATRIX, MM, ROTATION, TIME, WXYZ, XYZW, N, P

HERE = Source("rec.x", "00")
FREE = Declarations()
CART = Rotation.from_euler("XYZ", np.column_stack([0.1 * TIME, 0.2 * np.sin(TIME), -0.05 * TIME]))
"""Another body, which moves as well."""
P_CART = np.column_stack([np.sin(TIME), np.cos(TIME), 0.1 * TIME])


def raw(position=MM, rotation=WXYZ, status=None, **facts) -> Raw:
    return Raw({"marker": Track(position, rotation, status)}, HERE, **{"unit": "mm", "quaternion": "wxyz"} | facts)


def dropped(recording: Recording) -> dict[str, int]:
    return {drop.reason: drop.count for drop in recording.intakes[0].dropped}


def same_poses(recording: Recording, p, rotation: Rotation) -> bool:
    off = (rotation.inv() * Rotation.from_matrix(recording.R_world_sensor)).magnitude()
    return np.allclose(recording.p_world_sensor, p, rtol=0, atol=1e-9) and off.max() < 1e-9


def test_every_reason_is_counted_and_the_frames_keep_their_numbers():
    p, q, status = MM.copy(), WXYZ.copy(), np.full(N, "OK", object)
    status[1] = "INVALID"
    status[2] = "PARTIALLY OUT OF VOLUME"
    p[3, 1] = np.nan
    p[4], q[4] = 0, 0
    q[5] *= 1.01
    p[6], q[6] = 0, (1, 0, 0, 0)
    p[7], q[7] = -3.697314e28, -3.697314e28
    p[9], q[9] = p[8], q[8]
    p[10], q[10] = p[8], q[8]
    q[11] = 0
    recording = ingest(raw(p, q, status, cut_off=2), FREE, "x")
    assert dropped(recording) == {
        "without numbers": 2,
        "not a rotation": 2,
        "identical to the frame before": 2,
        "INVALID": 1,
        "PARTIALLY OUT OF VOLUME": 1,
        "all zero": 1,
        "identity placeholder": 1,
        "cut off": 2,
    }
    kept = [0, 8, *range(12, N)]
    assert recording.pose_number.tolist() == kept
    assert recording.missing == N + 2 - len(kept)
    assert same_poses(recording, P[kept], ROTATION[kept])


def test_a_frame_that_repeats_one_before_a_gap_is_dropped_too():
    """A tracker that freezes while it says MISSING now and then has still nothing new to say."""
    p, q, status = MM.copy(), WXYZ.copy(), np.full(N, "", object)
    p[3:6], q[3:6], status[4] = p[3], q[3], "MISSING"
    recording = ingest(raw(p, q, status), FREE, "x")
    assert dropped(recording) == {"MISSING": 1, "identical to the frame before": 1}


@pytest.mark.parametrize("status", ["", "INVALID"])
def test_where_no_frame_is_left_the_reasons_are_told(status):
    words = np.full(N, status or "OK", object)
    with pytest.raises(InputError, match=rf"rec\.x: no pose of 'marker' is left of {N} frames: {N} "):
        ingest(raw(MM * 0, WXYZ * 0, words), FREE, "x")


@pytest.mark.parametrize("unit, scale", [("mm", 1e3), ("cm", 1e2), ("m", 1.0)])
def test_units(unit, scale):
    for file, declared in ((unit, None), (None, unit)):
        recording = ingest(raw(P * scale, unit=file), Declarations(unit=declared), "x")
        assert same_poses(recording, P, ROTATION)


@pytest.mark.parametrize("order, values", [("wxyz", WXYZ), ("xyzw", XYZW)])
def test_orders_of_quaternions(order, values):
    for file, declared in ((order, None), (None, order)):
        recording = ingest(raw(rotation=values, quaternion=file), Declarations(quaternion=declared), "x")
        assert same_poses(recording, P, ROTATION)


@pytest.mark.parametrize("order", EULER_ORDERS)
def test_orders_of_euler_angles(order):
    """Against SciPy's intrinsic angles, whose axes turn along."""
    angles = ROTATION.as_euler(order, degrees=True)
    xyz = np.column_stack([angles[:, order.index(axis)] for axis in "XYZ"])
    for file, declared in ((order, None), (None, order.lower())):
        recording = ingest(raw(rotation=xyz, euler=file), Declarations(euler=declared), "x")
        assert same_poses(recording, P, ROTATION)


def test_zyx_is_the_product_of_rz_ry_and_rx():
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    Rz, Rx = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    recording = ingest(raw(MM[:1], np.array([[30.0, 0, 30]]), euler="ZYX"), FREE, "x")
    assert np.allclose(recording.R_world_sensor[0], Rz @ Rx, rtol=0, atol=1e-15)


def test_matrices_that_were_rounded_are_projected_and_counted():
    rounded = np.round(MATRIX[:, :3, :3], 4)
    rounded[5] = MATRIX[5, :3, :3]
    rounded[6] *= 1.01
    rounded[7] = rounded[7] @ np.diag([1, 1, -1])
    recording = ingest(raw(rotation=rounded), FREE, "x")
    assert dropped(recording) == {"not a rotation": 2}
    assert recording.intakes[0].projected == N - 3
    R = recording.R_world_sensor
    assert np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max() < 1e-14
    kept = recording.pose_number
    assert (ROTATION[kept].inv() * Rotation.from_matrix(R)).magnitude().max() < 1e-4


def test_a_left_handed_frame_is_mirrored():
    """The same motion written in a frame whose z points the other way: a quaternion's x and y change their sign."""
    quat = WXYZ * [1, -1, -1, 1]
    mirrored = raw(MM * [1, 1, -1], quat, left_handed=None)
    assert same_poses(ingest(mirrored, Declarations(left_handed=True), "x"), P, ROTATION)
    with pytest.raises(InputError, match="--left-handed or --right-handed"):
        ingest(mirrored, FREE, "x")


def test_inverted_poses():
    inverse = np.linalg.inv(MATRIX)
    recording = ingest(raw(inverse[:, :3, 3] * 1e3, inverse[:, :3, :3]), Declarations(invert=True), "x")
    assert same_poses(recording, P, ROTATION)


def with_cart(status=None) -> Raw:
    """The marker and a cart that moves, both seen by a tracker: T_tracker_marker = T_tracker_cart T_cart_marker."""
    seen = CART * ROTATION
    tracks = {
        "cart": Track(P_CART * 1e3, np.roll(CART.as_quat(), 1, axis=1), status, "Tracker"),
        "marker": Track((P_CART + CART.apply(P)) * 1e3, np.roll(seen.as_quat(), 1, axis=1), None, "Tracker"),
    }
    return Raw(tracks, HERE, "mm", "wxyz", time_s=TIME)


def test_the_reference_is_composed():
    recording = ingest(with_cart(), Declarations(reference="cart"), "x")
    assert same_poses(recording, P, ROTATION)
    assert (recording.intakes[0].tool, recording.intakes[0].reference) == ("marker", "cart")


def test_a_frame_without_its_reference_is_dropped():
    status = np.full(N, "OK", object)
    status[[2, 3]] = "MISSING"
    recording = ingest(with_cart(status), Declarations(reference="cart"), "x")
    assert dropped(recording) == {"reference MISSING": 2}
    assert len(ingest(with_cart(status), Declarations(tool="marker"), "x")) == N


def test_a_frozen_tool_does_not_move_with_its_reference():
    found = with_cart()
    frozen = found.tracks["marker"].position.copy(), found.tracks["marker"].rotation.copy()
    for values in frozen:
        values[10:20] = values[10]
    tracks = {**found.tracks, "marker": Track(*frozen, None, "Tracker")}
    recording = ingest(Raw(tracks, HERE, "mm", "wxyz"), Declarations(reference="cart"), "x")
    assert dropped(recording) == {"identical to the frame before": 9}


def test_poses_that_are_given_in_the_reference_are_taken_as_they_are():
    given = Raw({"marker": Track(MM, WXYZ, None, "Reference")}, HERE, "mm", "wxyz")
    assert same_poses(ingest(given, Declarations(reference="Reference"), "x"), P, ROTATION)


@pytest.mark.parametrize(
    "facts, option",
    [
        ({"unit": None}, "--unit mm, cm or m"),
        ({"quaternion": None}, "--quaternion wxyz or xyzw"),
        ({"rotation": np.zeros((N, 3)), "euler": None}, "--euler: XYZ"),
    ],
)
def test_where_the_file_is_silent_the_refusal_names_the_option(facts, option):
    with pytest.raises(InputError, match=rf"^rec\.x: .*{option}"):
        ingest(raw(**facts), FREE, "x")


def test_tools_are_chosen_by_name_or_a_part_of_it():
    track = Track(MM, WXYZ)
    file = Raw({"Port 1: NDI 8700339": track, "Port 2: NDI 8700449": track}, HERE, "mm", "wxyz")
    assert ingest(file, Declarations(tool="8700449"), "x").intakes[0].tool == "Port 2: NDI 8700449"
    assert ingest(file, Declarations(reference="port 2"), "x").intakes[0].tool == "Port 1: NDI 8700339"
    for declared, words in (
        (FREE, r"2 tools; say with --tool .*Port 1: NDI 8700339 \(30 frames\); Port 2"),
        (Declarations(tool="NDI"), "--tool 'NDI' fits several tools: Port 1: NDI 8700339, Port 2"),
        (Declarations(tool="Port 3: NDI 8700449"), "--tool: no tool 'Port 3: .* did you mean 'Port 2"),
        (Declarations(tool="port 1", reference="8700339"), "both name 'Port 1"),
        (Declarations(tool="port 1", reference="nobody"), "--reference: no tool 'nobody'"),
    ):
        with pytest.raises(InputError, match=words):
            ingest(file, declared, "x")


def test_a_name_that_is_a_part_of_another_is_still_found():
    file = Raw({"Stylus": Track(MM, WXYZ), "StylusTip": Track(MM, WXYZ)}, HERE, "mm", "wxyz")
    assert ingest(file, Declarations(tool="Stylus"), "x").intakes[0].tool == "Stylus"


def test_a_unit_that_no_c_arm_has_is_warned_of_with_the_one_that_fits():
    for position, unit, better in ((P, "mm", "--unit m "), (MM, "m", "--unit mm "), (P * 100, "m", "--unit cm ")):
        notes = {note.code: note.message for note in ingest(raw(position, unit=unit), FREE, "x").warnings}
        assert better in notes["implausible_unit"], (unit, notes)
    assert not ingest(raw(), FREE, "x").warnings


def test_a_declaration_against_the_file_is_followed_and_warned_of():
    recording = ingest(raw(P), Declarations(unit="m"), "x")
    assert same_poses(recording, P, ROTATION)
    (note,) = recording.warnings
    assert (note.code, "--unit m" in note.message, "mm" in note.message) == ("contradicts_file", True, True)


def test_gaps_in_time_are_noted():
    time = TIME.copy()
    time[12:] += 5
    (note,) = ingest(raw(time_s=time), FREE, "x").warnings
    assert note.code == "time_gaps"
    assert "5.02 s after pose 11" in note.message


def test_a_frame_without_a_time_is_dropped_where_others_have_one():
    time = TIME.copy()
    time[3] = np.nan
    assert dropped(ingest(raw(time_s=time), FREE, "x")) == {"without a time": 1}


def test_a_tool_that_one_file_of_a_folder_lacks_is_counted():
    one, two = raw(MM[:10], WXYZ[:10]), raw(MM[10:], WXYZ[10:])
    two = Raw({"pointer": two.tracks["marker"], **two.tracks}, HERE, "mm", "wxyz")
    whole = joined([one, two], HERE)
    recording = ingest(whole, Declarations(tool="marker"), "x")
    assert same_poses(recording, P, ROTATION)
    assert dropped(ingest(whole, Declarations(tool="pointer"), "x")) == {"not in the file": 10}


def test_files_of_a_folder_that_contradict_each_other_are_refused():
    other = Raw({"marker": Track(MM, WXYZ)}, Source("other.x", ""), "m", "wxyz")
    with pytest.raises(InputError, match=r"other\.x: differs from rec\.x in its unit: mm and m"):
        joined([raw(), other], HERE)


def test_counts_of_files_that_were_read_alike_are_added_up():
    one = Intake("x", "marker", "", (), 10, 8, (Dropped("INVALID", 2), Dropped("all zero", 0)))
    two = Intake("x", "marker", "", (), 5, 3, (Dropped("INVALID", 1), Dropped("cut off", 1)), projected=3)
    other = Intake("x", "pointer", "", (), 1, 1)
    assert summed([one, other, two]) == (
        Intake("x", "marker", "", (), 15, 11, (Dropped("INVALID", 3), Dropped("cut off", 1)), projected=3),
        other,
    )


def test_a_native_file_takes_only_what_it_may_lack(tmp_path):
    recording = Recording(P, ROTATION.as_matrix())
    carm_kin.write_recording(recording, tmp_path / "rec.csv")
    inverse = np.linalg.inv(MATRIX)
    again = carm_kin.read_recording(tmp_path / "rec.csv", declared=Declarations(invert=True))
    assert same_poses(again, inverse[:, :3, 3], ROTATION.inv())
    mirrored = carm_kin.read_recording(tmp_path / "rec.csv", declared=Declarations(left_handed=True))
    assert np.allclose(mirrored.p_world_sensor, P * [1, 1, -1])
    for option in ("tool", "reference", "unit", "quaternion", "euler"):
        value = {"unit": "m", "quaternion": "wxyz", "euler": "XYZ"}.get(option, "a")
        with pytest.raises(InputError, match=rf"rec\.csv: --{option}: "):
            carm_kin.read_recording(tmp_path / "rec.csv", declared=Declarations(**{option: value}))


CONTRADICTIONS = {
    "inverted in the file": (np.linalg.inv, {}, "inverted_poses", "read it with --invert"),
    "inverted by the user": (lambda T: T, {"invert": True}, "inverted_poses", "read it without --invert"),
    "order": (lambda T: T, {"quaternion": "xyzw"}, "quaternion_order", "--quaternion wxyz"),
}


@pytest.mark.parametrize("case", CONTRADICTIONS)
def test_poses_that_contradict_a_declaration_name_the_option(case):
    change, declared, cause, words = CONTRADICTIONS[case]
    poses, _ = simulate("mobile_nonisocentric", "minimal", sigma_t_m=5e-4, sigma_r_rad=1e-3, seed=1)
    T = np.tile(np.eye(4), (len(poses), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = poses.R_world_sensor, poses.p_world_sensor
    T = change(T)
    quat_wxyz = np.roll(Rotation.from_matrix(T[:, :3, :3]).as_quat(), 1, axis=1)
    file = Raw({"marker": Track(T[:, :3, 3], quat_wxyz)}, HERE, "m", "wxyz")
    recording = ingest(file, Declarations(**declared), "x")
    labelled = Recording(
        recording.p_world_sensor,
        recording.R_world_sensor,
        sweep=poses.sweep[recording.pose_number],
        moving=poses.moving[recording.pose_number],
        joints={joint: values[recording.pose_number] for joint, values in poses.joints.items()},
        intakes=recording.intakes,
    )
    notes = {note.code: note.message for note in carm_kin.calibrate(labelled).warnings}
    assert cause in notes
    assert words in notes["contradicts_declaration"]


def test_the_result_tells_what_was_dropped(tmp_path):
    poses, _ = simulate("mobile_nonisocentric", "minimal", sigma_t_m=5e-4, sigma_r_rad=1e-3, seed=1)
    status = np.full(len(poses), "OK", object)
    status[::10] = "INVALID"
    given = Raw({"marker": Track(poses.p_world_sensor, poses.R_world_sensor, status)}, HERE, "m")
    result = carm_kin.calibrate(ingest(given, FREE, "x"))
    (intake,) = result.provenance.intakes
    assert (intake.frames, intake.dropped) == (len(poses), (Dropped("INVALID", -(-len(poses) // 10)),))
    result.to_json(tmp_path / "result.json")
    assert carm_kin.CalibrationResult.from_json(tmp_path / "result.json").provenance.intakes == (intake,)
