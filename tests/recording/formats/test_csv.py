"""The native CSV: what is read, what is refused and where, and that nothing is lost on the way through a file."""

import hashlib
import sys
import types
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from carm_kin.errors import InputError
from carm_kin.recording import formats
from carm_kin.recording.formats import _table, read_recording, write_recording
from carm_kin.recording.formats import csv as native
from carm_kin.recording.recording import Recording, Source
from helpers.places import DATA
from solvers.se3 import exp_so3, quat_wxyz_from_rotation

POSE = "1,2,3,1,0,0,0"
HEADER = "x_mm,y_mm,z_mm,qw,qx,qy,qz"


def file_of(tmp_path, text):
    path = tmp_path / "rec.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def table(header, *rows):
    return "\n".join([header, *rows, ""])


def test_every_column_is_read(tmp_path):
    header = "# made by hand\nsweep, note ,qz,qw,qx,qy,z_mm,x_mm,y_mm,time_s,placement,moving,q_angular_deg,q_lift_mm\n"
    rows = (
        's1,"a, ""b""",0.6,0.8,0,0,3,1,2,0.5,A,orbital,90,1.5\n\n  # between\n"s1", c ,0,1,0,0,6,4,5,1.5,A,orbital,,\n'
    )
    recording = read_recording(file_of(tmp_path, header + rows))
    assert np.array_equal(recording.p_world_sensor, [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006]])
    expected = [[[0.28, -0.96, 0], [0.96, 0.28, 0], [0, 0, 1]], np.eye(3)]
    assert np.allclose(recording.R_world_sensor, expected, rtol=0, atol=1e-15)
    assert recording.time_s.tolist() == [0.5, 1.5]
    assert recording.sweep.tolist() == ["s1", "s1"]
    assert recording.moving.tolist() == ["orbital", "orbital"]
    assert recording.placement.tolist() == ["A", "A"]
    assert np.array_equal(recording.joints["angular"], [np.pi / 2, np.nan], equal_nan=True)
    assert np.array_equal(recording.joints["lift"], [0.0015, np.nan], equal_nan=True)
    assert recording.prismatic == {"lift"}
    assert {name: cells.tolist() for name, cells in recording.metadata.items()} == {"note": ['a, "b"', "c"]}
    assert (recording.missing, recording.pose_number.tolist()) == (0, [0, 1])


def test_the_source_is_the_path_and_the_digest(tmp_path):
    path = file_of(tmp_path, table("x_m,y_m,z_m", "1,2,3"))
    assert read_recording(path).source == Source(str(path), hashlib.sha256(path.read_bytes()).hexdigest())


def test_positions_alone_are_enough(tmp_path):
    recording = read_recording(file_of(tmp_path, table("x_m,y_m,z_m", "1,2,3")))
    assert recording.R_world_sensor is None
    assert recording.p_world_sensor.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_line_ends_and_the_byte_order_mark_do_not_matter(tmp_path, end, mark):
    text = mark + table(HEADER, POSE, POSE).replace("\n", end)
    assert len(read_recording(file_of(tmp_path, text))) == 2


def test_frames_without_a_position_or_an_orientation_are_counted_and_left_out(tmp_path):
    rows = [POSE, ",,,1,0,0,0", POSE, "1,2,3, ,,,", ",,,,,,", POSE]
    recording = read_recording(file_of(tmp_path, table(HEADER, *rows)))
    assert (len(recording), recording.missing) == (3, 3)
    assert recording.pose_number.tolist() == [0, 2, 5]


def test_a_missing_frame_needs_no_time(tmp_path):
    recording = read_recording(file_of(tmp_path, table(HEADER + ",time_s", POSE + ",1", ",,,,,,,", POSE + ",3")))
    assert recording.time_s.tolist() == [1, 3]


def test_quaternions_near_the_unit_are_normalised(tmp_path):
    (R,) = read_recording(file_of(tmp_path, table(HEADER, "1,2,3,0.6005,0.8005,0,0"))).R_world_sensor
    assert np.allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-15)


def test_decreasing_time_and_duplicates_are_warnings(tmp_path):
    rows = [f"{POSE},{time}" for time in (3, 2)]
    recording = read_recording(file_of(tmp_path, table(HEADER + ",time_s", *rows)))
    assert [note.code for note in recording.warnings] == ["duplicated_poses", "time_not_increasing"]


BROKEN = {
    "empty file": ("", None, None, ["empty", "header"]),
    "comments only": ("# x_mm\n\n", None, None, ["empty", "header"]),
    "header only": (HEADER + "\n", 1, None, ["no poses"]),
    "missing column": (table("x_mm,y_mm,qw", "1,2,1"), 1, "z_mm", ["missing z_mm", "x_mm, y_mm, qw", "needed"]),
    "close spelling": (table("x_mm,y_mm,Z_mm", "1,2,3"), 1, "z_mm", ["'Z_mm'"]),
    "part of a quaternion": (table("x_m,y_m,z_m,qw,qx,qy", "1,2,3,1,0,0"), 1, "qz", ["missing qz"]),
    "both units": (table("x_mm,x_m,y_mm,z_mm", "1,1,1,1"), 1, "x_m", ["both", "keep one"]),
    "mixed units": (table("x_mm,y_m,z_mm", "1,1,1"), 1, "y_m", ["mixed", "mm"]),
    "repeated name": (table("x_mm,y_mm,z_mm,a,a", "1,1,1,,"), 1, "a", ["columns 4 and 5", "unique"]),
    "no header": (table(POSE, POSE), 1, None, ["header line", "numbers"]),
    "semicolons": (table("x_mm;y_mm;z_mm", "1,5;2,5;3,5"), 1, "x_mm", ["seems to use ';'", "'.'"]),
    "tabs": (table("x_mm\ty_mm\tz_mm", "1\t2\t3"), 1, "x_mm", ["seems to use a tab"]),
    "spaces": (table("x_mm y_mm z_mm", "1 2 3"), 1, "x_mm", ["seems to use a space"]),
    "decimal comma": (table("x_mm,y_mm,z_mm", "1,5,2,5,3,5"), 2, "4", ["6 cells", "has 3", "decimal mark"]),
    "quoted decimal comma": (table("x_mm,y_mm,z_mm", '1,"2,5",3'), 2, "y_mm", ["'2,5'", "use '.'"]),
    "short row": (table(HEADER, POSE, "1,2,3,1,0,0"), 3, "qz", ["6 cells", "has 7"]),
    "long row": (table("# c\n" + HEADER, POSE, POSE + ",0.5"), 4, "8", ["8 cells", "has 7"]),
    "word": (table(HEADER, POSE, "", "# c", "1,2,three,1,0,0,0"), 5, "z_mm", ["'three'", "not a number"]),
    "underscore": (table(HEADER, "1_0,2,3,1,0,0,0"), 2, "x_mm", ["'1_0'", "not a number"]),
    "wide digit": (table(HEADER, "1,2,\uff11,1,0,0,0"), 2, "z_mm", ["not a number"]),
    "DOS line ends": (table(HEADER, POSE, "1,2,x,1,0,0,0").replace("\n", "\r\n"), 3, "z_mm", ["'x'"]),
    "hexadecimal": (table(HEADER, "1,2,0x1,1,0,0,0"), 2, "z_mm", ["'0x1'", "not a number"]),
    "nan": (table(HEADER, POSE, "1,NaN,3,1,0,0,0"), 3, "y_mm", ["not finite", "empty"]),
    "infinity": (table(HEADER, "1,2,3,1,0,0,-inf"), 2, "qz", ["not finite"]),
    "overflow": (table(HEADER, "1,2,1e999,1,0,0,0"), 2, "z_mm", ["not finite"]),
    "part of a position": (table(HEADER, POSE, "1,,3,1,0,0,0"), 3, "y_mm", ["empty", "x_mm, y_mm, z_mm"]),
    "part of an orientation": (table(HEADER, "1,2,3,1,0,,"), 2, "qy", ["empty", "qw, qx, qy, qz"]),
    "no unit quaternion": (table(HEADER, POSE, ",,,,,,", "1,2,3,1,0.1,0,0"), 4, "qw", ["norm 1.00499", "unit"]),
    "zero quaternion": (table(HEADER, POSE, "0,0,0,0,0,0,0"), 3, "qw", ["zero", "empty"]),
    "every pose missing": (table(HEADER, ",,,,,,", ",,,1,0,0,0"), 2, "x_mm", ["all 2 poses"]),
    "time not given": (table(HEADER + ",time_s", ",,,,,,,", POSE + ","), 3, "time_s", ["empty"]),
    "joint without unit": (table(HEADER + ",q_lift", POSE + ",1"), 1, "q_lift", ["q_<joint>_deg"]),
    "joint with a strange unit": (table(HEADER + ",q_lift_cm", POSE + ",1"), 1, "q_lift_cm", ["unit", "q_<joint>_mm"]),
    "joint with more than a unit": (table(HEADER + ",q_a_degree", POSE + ",1"), 1, "q_a_degree", ["unit"]),
    "joint without a name": (table(HEADER + ",q__deg", POSE + ",1"), 1, "q__deg", ["q_<joint>_deg"]),
    "joint twice": (table(HEADER + ",q_a_deg,q_a_mm", POSE + ",1,1"), 1, "q_a_mm", ["'a'", "q_a_deg"]),
    "joint value": (table(HEADER + ",q_a_deg", POSE + ",", POSE + ",ten"), 3, "q_a_deg", ["'ten'", "not a number"]),
    "moving changes": (
        table(HEADER + ",sweep,moving", POSE + ",s,angular", ",,,,,,,s,angular", POSE + ",s,orbital"),
        4,
        "moving",
        ["sweep 's'", "'orbital'", "'angular'"],
    ),
    "placement changes": (
        table("placement,sweep," + HEADER, "A,s," + POSE, "B,s," + POSE),
        3,
        "placement",
        ["sweep 's'", "'A'", "'B'"],
    ),
    "label changes": (
        table(HEADER + ",sweep,moving,q_angular_deg", *(f"{POSE},s,orbital,{q}" for q in ("", 10, 10.06))),
        4,
        "q_angular_deg",
        ["sweep 's'", "'10.06'", "'10'", "deg"],
    ),
    "open quote": (table(HEADER + ",note", POSE + ',"a', POSE + ',b"'), 2, None, ["quoted cell"]),
    "text after a quote": (table(HEADER + ",note", POSE + ",a", POSE + ',"a"b'), 3, None, ["quoted cell"]),
    "not UTF-8": (table(HEADER + ",note", POSE + ",\u00e4").encode("latin-1"), 2, "8", ["0xe4", "UTF-8"]),
    "UTF-16": (table(HEADER, POSE).encode("utf-16"), 1, "1", ["UTF-8"]),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_is_refused_with_the_place_and_the_reason(tmp_path, case):
    text, line, column, words = BROKEN[case]
    path = file_of(tmp_path, text)
    with pytest.raises(InputError) as error:
        read_recording(path)
    message = str(error.value)
    place = [str(path), *([f"line {line}"] if line else []), *([f"column {column}"] if column else [])]
    assert message.startswith(", ".join(place) + ": "), message
    assert all(word in message for word in words), message
    assert "\n" not in message


@pytest.mark.parametrize(
    "row, place", [("1,2,3,1,0,x,0", "column qy: 'x' is not a number"), ("1,2,3", "column qw: the row has 3")]
)
def test_a_bad_row_far_below_is_found(tmp_path, row, place):
    n = 2 * native._CHUNK + 5
    rows = [POSE] * n
    rows[n - 2] = row
    with pytest.raises(InputError, match=f"line {n}, {place}"):
        read_recording(file_of(tmp_path, table(HEADER, *rows)))


def test_what_is_no_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: no such file"):
        read_recording(tmp_path / "none.csv")
    with pytest.raises(InputError, match="the folder holds no file"):
        read_recording(tmp_path, format="csv")


def test_a_file_that_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(native, "MAX_BYTES", 20)
    with pytest.raises(InputError, match="GB"):
        read_recording(file_of(tmp_path, table(HEADER, POSE)))


finite = st.floats(allow_nan=False, allow_infinity=False)
label = st.text(st.characters(exclude_characters="\n\r\0", exclude_categories=["Cs"]), max_size=8)
name = st.text("abcxyzÄβ_- ", min_size=1, max_size=6).filter(lambda text: text == text.strip())


def columns(n, value):
    return st.lists(value, min_size=n, max_size=n)


@st.composite
def recordings(draw):
    n = draw(st.integers(1, 6))
    missing = draw(st.integers(0, 3))
    number = sorted(draw(st.permutations(range(n + missing)))[:n])
    p = np.array(draw(columns(n, st.tuples(finite, finite, finite))))
    w = np.array(draw(columns(n, st.tuples(*[st.floats(-4, 4)] * 3))))
    values = columns(n, st.floats(allow_infinity=False))
    joints = draw(st.dictionaries(name, values, max_size=3))
    metadata = draw(st.dictionaries(name.map("m".__add__), columns(n, label), max_size=2))
    return Recording(
        p,
        draw(st.sampled_from([None, exp_so3(w)])),
        time_s=draw(st.none() | columns(n, finite)),
        sweep=draw(st.none() | columns(n, label)),
        moving=draw(st.none() | st.just(["orbital"] * n)) if not joints else None,
        placement=[draw(label)] * n if draw(st.booleans()) else None,
        joints=joints,
        prismatic=frozenset(joint for joint in joints if draw(st.booleans())),
        metadata=metadata,
        missing=missing,
        pose_number=np.array(number),
    )


def same(a, b):
    if a is None or b is None:
        return a is b
    return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype == float)


def assert_same(first, second):
    """Equal to the last bit, orientations to 4e-15: exp_so3 itself is orthonormal to 2e-15."""
    for field in ("p_world_sensor", "time_s", "sweep", "moving", "placement", "pose_number"):
        assert same(getattr(first, field), getattr(second, field)), field
    for field in ("joints", "metadata"):
        one, two = getattr(first, field), getattr(second, field)
        assert list(one) == list(two)
        assert all(same(one[key], two[key]) for key in one), field
    assert (first.prismatic, first.missing) == (second.prismatic, second.missing)
    assert (first.R_world_sensor is None) == (second.R_world_sensor is None)
    if first.R_world_sensor is not None:
        assert np.allclose(first.R_world_sensor, second.R_world_sensor, rtol=0, atol=4e-15)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(recordings())
def test_reading_gives_back_what_was_written(tmp_path, recording):
    path = tmp_path / "rec.csv"
    write_recording(recording, path)
    assert_same(recording, read_recording(path))


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(*[st.floats(-1e4, 1e4)] * 4), min_size=1, max_size=5))
def test_what_was_read_in_mm_and_deg_is_written_in_them(tmp_path, rows):
    text = table("x_mm,y_mm,z_mm,q_a_deg", *(",".join(map(repr, row)) for row in rows))
    recording = read_recording(file_of(tmp_path, text))
    write_recording(recording, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text().startswith("x_mm,y_mm,z_mm,q_a_deg\n")
    assert_same(recording, read_recording(tmp_path / "again.csv"))


def test_round_numbers_stay_round(tmp_path):
    tenths = [str(value / 10) for value in range(-3600, 3600)]
    text = table("x_mm,y_mm,z_mm,q_a_deg,q_b_mm", *(f"{value},{value},{value},{value},{value}" for value in tenths))
    recording = read_recording(file_of(tmp_path, text))
    assert recording.p_world_sensor[:, 0].tolist() == [float(value) / 1000 for value in tenths]
    write_recording(recording, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text() == text


def test_every_angle_that_was_read_can_be_written_in_degrees(tmp_path):
    angles = np.random.default_rng(0).uniform(-360, 360, 20_000).tolist()
    recording = read_recording(file_of(tmp_path, table("x_m,y_m,z_m,q_a_deg", *(f"0,0,0,{q!r}" for q in angles))))
    write_recording(recording, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text().startswith("x_mm,y_mm,z_mm,q_a_deg\n")
    assert_same(recording, read_recording(tmp_path / "again.csv"))


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 5), min_size=1, max_size=5))
def test_the_unit_of_the_columns_does_not_matter(tmp_path, rows):
    values = np.array(rows)
    si = [",".join(map(repr, row)) for row in values.tolist()]
    scaled = [",".join(map(repr, row)) for row in (values * [1e3, 1e3, 1e3, 180 / np.pi, 1e3]).tolist()]
    one = read_recording(file_of(tmp_path, table("x_m,y_m,z_m,q_a_rad,q_b_m", *si)))
    two = read_recording(file_of(tmp_path, table("x_mm,y_mm,z_mm,q_a_deg,q_b_mm", *scaled)))
    assert np.allclose(one.p_world_sensor, two.p_world_sensor, rtol=1e-15, atol=1e-300)
    assert all(np.allclose(one.joints[joint], two.joints[joint], rtol=1e-15, atol=1e-300) for joint in "ab")
    assert one.prismatic == two.prismatic == {"b"}


def test_a_selection_is_written_as_a_recording_of_its_own(tmp_path):
    p = np.arange(12.0).reshape(4, 3)
    write_recording(Recording(p, missing=1).select(np.array([3, 1])), tmp_path / "rec.csv")
    again = read_recording(tmp_path / "rec.csv")
    assert np.array_equal(again.p_world_sensor, p[[3, 1]])
    assert (again.missing, again.pose_number.tolist()) == (0, [0, 1])


@pytest.mark.parametrize(
    "fields, words",
    [
        ({"metadata": {"x_m": ["a"]}}, ["column x_m", "metadata"]),
        ({"metadata": {"q_a": ["a"]}}, ["column q_a", "metadata"]),
        ({"metadata": {" a": ["a"]}}, ["column  a", "white space"]),
        ({"joints": {"": [1.0]}}, ["column q__deg", "empty"]),
        ({"sweep": ["a\nb"]}, ["column sweep", "line break"]),
        ({"metadata": {"a": ["x" * 140_000]}}, ["column a", "characters"]),
        ({"sweep": ["\ud800"]}, ["cannot be written"]),
    ],
)
def test_what_could_not_be_read_back_is_not_written(tmp_path, fields, words):
    with pytest.raises(InputError) as error:
        write_recording(Recording(np.zeros((1, 3)), **fields), tmp_path / "rec.csv")
    assert all(word in str(error.value) for word in words), str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_nothing_to_write_and_nowhere_to_write_are_refused(tmp_path):
    with pytest.raises(InputError, match="no poses"):
        write_recording(Recording(np.zeros((0, 3))), tmp_path / "rec.csv")
    with pytest.raises(InputError, match="cannot be written"):
        write_recording(Recording(np.zeros((1, 3))), tmp_path / "none" / "rec.csv")


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = file_of(tmp_path, "old")
    with pytest.raises(InputError):
        write_recording(Recording(np.zeros((1, 3)), sweep=["\ud800"]), path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_new_format_is_one_new_module(tmp_path, monkeypatch):
    (tmp_path / "fake.py").write_text(
        "from carm_kin.recording.recording import Recording\nSUMMARY = 'fake'\nEXTENSIONS = ('.fake.csv', '.fk')\n"
        "def matches(path, head):\n    return head == b'fake'\n"
        "def read(path, declared):\n    return Recording([[1.0, 2.0, 3.0]])\n"
    )
    (tmp_path / "helper.py").write_text("")
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(tmp_path)])
    for module in ("fake", "helper"):
        monkeypatch.setitem(sys.modules, f"carm_kin.recording.formats.{module}", types.ModuleType(module))
        monkeypatch.delitem(sys.modules, f"carm_kin.recording.formats.{module}")
    assert {"csv", "fake"} <= formats.formats().keys()
    assert "helper" not in formats.formats()
    for name, content, format in (
        ("a.FK", "", None),
        ("a.fake.csv", "", None),
        ("a.b", "fake", None),
        ("c", "", "fake"),
    ):
        (tmp_path / name).write_text(content)
        assert read_recording(tmp_path / name, format).p_world_sensor.tolist() == [[1, 2, 3]]
    with pytest.raises(InputError, match="no format 'fake' here; choose from csv"):
        write_recording(Recording(np.zeros((1, 3))), tmp_path / "a.fk", format="fake")


def test_a_module_whose_name_begins_with_an_underscore_is_no_format(tmp_path, monkeypatch):
    (tmp_path / "_hidden.py").write_text("def read(path):\n    raise AssertionError\nraise AssertionError\n")
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(tmp_path)])
    assert not any(name.startswith("_") for name in formats.formats())


def test_tables_with_another_delimiter_have_the_same_places(tmp_path):
    spaces = _table.read_lines(tmp_path / "a.tum", b"# t x\n1  2 \n\n3\t4\n5 x\n", "a pose", " ")
    with pytest.raises(InputError, match=r"a\.tum, line 5, column x: 'x' is not a number"):
        _table.read_columns(spaces, ["t", "x"], ["t", "x"], 2)
    numbers, _ = _table.read_columns(spaces.split(2)[0], ["t", "x"], ["t", "x"], 1)
    assert (numbers["t"].tolist(), numbers["x"].tolist()) == ([1, 3], [2, 4])
    with pytest.raises(InputError, match=r"line 2, column 3: byte 0xe4"):
        _table.read_lines(tmp_path / "a.tum", b"1 2 3\n1  2 \xe4", "a pose", " ")
    tabs = _table.read_lines(tmp_path / "a.tsv", b'a\tb\n"1,\t2"\t3\n', "a pose", "\t")
    assert tabs.cells() == [["a", "b"], ["1,\t2", "3"]]
    with pytest.raises(InputError, match=r"line 1, column x_mm: .*seems to use ',' .* use a tab"):
        _table.check_present(replace(tabs, text=["x_mm,y_mm"]), ["x_mm,y_mm"], ["x_mm", "y_mm"], "")


def test_an_unknown_format_is_refused_with_the_valid_names(tmp_path):
    with pytest.raises(InputError, match=r"no format 'cvs' here; choose from .*csv"):
        read_recording(tmp_path / "rec.csv", format="cvs")
    (tmp_path / "rec.dat").write_text("nothing")
    with pytest.raises(InputError, match=r"rec\.dat: the extension does not tell the format; choose from csv"):
        read_recording(tmp_path / "rec.dat")


@pytest.mark.parametrize(
    "file, poses, placements, metadata",
    [
        ("real-carm/marker_two_placements.csv", 34, ("A", "B"), ["station", "tracker_error_mm"]),
        ("static-pivot/pointer_481.csv", 481, ("",), []),
    ],
)
def test_real_recordings_are_read_as_they_are(tmp_path, file, poses, placements, metadata):
    path = DATA / file
    if not path.exists():
        pytest.skip(f"the real recording {file} is not here")
    recording = read_recording(path)
    assert (len(recording), recording.missing, recording.placements) == (poses, 0, placements)
    assert list(recording.metadata) == metadata
    header = next(line for line in path.read_text().splitlines() if not line.startswith("#")).split(",")
    cells = np.genfromtxt(path, delimiter=",", skip_header=2, usecols=[header.index(n) for n in HEADER.split(",")])
    assert np.array_equal(recording.p_world_sensor, cells[:, :3] / 1000)
    quat_wxyz = quat_wxyz_from_rotation(recording.R_world_sensor)
    assert np.allclose(np.abs((quat_wxyz * cells[:, 3:]).sum(axis=1)), 1, rtol=0, atol=1e-9)
    write_recording(recording, tmp_path / "rec.csv")
    assert_same(recording, read_recording(tmp_path / "rec.csv"))
