"""Sessions: sweeps in files and in parts of files, labelled; what is wrong is named with its key and line."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.errors import InputError
from carm_kin.recording.formats import read_recording, write_recording
from carm_kin.recording.recording import Recording
from carm_kin.simulation.simulate import simulate
from helpers import trackers
from helpers.command import fails, run
from helpers.trackers import TIME, N, P, assert_poses, written

HEAD = 'tracker = "plus"\ntool = "Marker"\n'
TWO = """
[[sweep]]
file = "a.igs.mha"
moving = "orbital"
held_deg = { angular = -30 }

[[sweep]]
file = "b.igs.mha"
label = "swivel"
moving = "angular"
placement = "B"
held_deg = { orbital = 10.5 }
held_mm = { lift = 200 }
"""


def session(folder, text, files=("a.igs.mha", "b.igs.mha")):
    for name in files:
        written(replace(trackers.plus(), file=name), folder)
    (folder / "session.toml").write_text(text)
    return folder / "session.toml"


def test_sweeps_in_files_of_their_own(tmp_path):
    recording = read_recording(session(tmp_path, HEAD + TWO))
    assert_poses(recording.select(slice(0, N)))
    assert_poses(recording.select(slice(N, 2 * N)))
    assert recording.sweep.tolist() == ["1"] * N + ["swivel"] * N
    assert recording.moving.tolist() == ["orbital"] * N + ["angular"] * N
    assert recording.placements == ("", "B")
    first, second = recording.sweeps
    assert (first.held, second.held) == ({"angular": np.radians(-30)}, {"orbital": np.radians(10.5), "lift": 0.2})
    assert recording.prismatic == {"lift"}
    assert recording.metadata["file"].tolist() == ["a.igs.mha"] * N + ["b.igs.mha"] * N
    (intake,) = recording.intakes
    assert (intake.frames, intake.kept, intake.tool) == (2 * N, 2 * N, "Marker")
    assert recording.time_s is None


def test_a_folder_with_a_session_is_the_session(tmp_path):
    session(tmp_path, HEAD + TWO)
    assert len(read_recording(tmp_path)) == 2 * N


def test_parts_of_one_file_by_time_and_what_lies_between_is_counted(tmp_path):
    text = """
tool = "Marker"
[defaults]
file = "a.igs.mha"
placement = "A"
held_deg = { angular = 5, orbital = 7 }
[[sweep]]
to_s = 0.105
moving = "orbital"
[[sweep]]
from_s = 0.195
to_s = 0.3
moving = "angular"
held_deg = { orbital = 9 }
"""
    recording = read_recording(session(tmp_path, text))
    frames = [*range(6), *range(10, 16)]
    assert_poses(recording, frames)
    assert np.array_equal(recording.time_s, TIME[frames])
    assert recording.placements == ("A",)
    assert [sweep.held for sweep in recording.sweeps] == [{"angular": np.radians(5)}, {"orbital": np.radians(9)}]
    (intake,) = recording.intakes
    assert intake.in_words() == f"{N - 12} outside of the session's sweeps"
    assert (intake.frames, intake.kept, recording.missing) == (N, 12, N - 12)


def test_a_folder_of_single_poses_is_a_sweep(tmp_path):
    header, *rows = trackers.ndi().content.decode().rstrip().split("\n")
    (tmp_path / "poses").mkdir()
    for i, row in enumerate(rows):
        (tmp_path / "poses" / f"{i}.csv").write_text(f"{header}\n{row}\n")
    (tmp_path / "s.toml").write_text('[[sweep]]\nfile = "poses"\n')
    assert_poses(read_recording(tmp_path / "s.toml"))


BROKEN = {
    "no TOML": ("[[sweep]\n", r"session\.toml: no valid TOML: .*line 1"),
    "no sweep": (HEAD, r"no \[\[sweep\]\] table"),
    "unknown key": (HEAD + "tol = 1\n" + TWO, r"line 3: 'tol' is unknown; it may be tracker, tool,"),
    "unknown key of a sweep": (
        HEAD + TWO + "heldd = 1\n",
        r"line 16: sweep 2: 'heldd' is unknown; it may be file, from_s",
    ),
    "unknown key of the defaults": ("[defaults]\nlable = 'a'\n" + TWO, r"line 2: defaults: 'lable' is unknown"),
    "wrong type": (HEAD + TWO.replace('"angular"', "3"), r"line 12: sweep 2: 'moving' must be a text, not 3"),
    "no number": (HEAD + TWO.replace("-30", "'x'"), r"line 7: sweep 1: 'held_deg'.angular must be a finite number"),
    "nan": (HEAD + TWO.replace("-30", "nan"), r"line 7: .*finite"),
    "bad unit": ("unit = 'inch'\n" + TWO, r"line 1: unit 'inch' is unknown; it is one of mm, cm, m"),
    "no file": (HEAD + TWO.replace("b.igs", "c.igs"), r"line 9: sweep 2: no file 'c\.igs\.mha'"),
    "file missing": (HEAD + "[[sweep]]\nmoving = 'orbital'\n", r"line 3: sweep 1: 'file' is missing"),
    "file outside": (HEAD + TWO.replace("b.igs.mha", "../b.igs.mha"), r"line 9: sweep 2: file '\.\./.* outside"),
    "absolute": (HEAD + TWO.replace("b.igs.mha", "/etc/passwd"), r"line 9: .*outside"),
    "itself": (TWO.replace("b.igs.mha", "session.toml"), r"line 7: sweep 2: .*is a session, which cannot"),
    "its folder": (TWO.replace("b.igs.mha", "."), r"line 7: sweep 2: .*is a session, which cannot"),
    "same label": (HEAD + TWO.replace("swivel", "1"), r"line 9: sweep 2: label '1' is that of sweep 1 too"),
    "moves and is held": (
        HEAD + TWO.replace("orbital = 10.5", "angular = 1"),
        r"line 9: .*'angular' moves and cannot be",
    ),
    "no time": (HEAD + TWO + "from_s = 3\nto_s = 2\n", r"line 9: sweep 2: to_s must be above from_s, not 2 and 3"),
    "empty range": (HEAD + TWO + "from_s = 30\n", r"line 9: sweep 2: no pose .* lasts 0.58 s"),
    "twice": (HEAD + TWO.replace("b.igs", "a.igs"), r"line 9: sweep 2: takes poses of 'a\.igs\.mha' that another"),
    "twice by another name": (HEAD + TWO.replace("b.igs", "./a.igs"), r"line 9: sweep 2: takes poses of '\./a\.igs"),
    "wrong tool": (HEAD.replace("Marker", "Probe") + TWO, r"line 4: sweep 1: .*a\.igs\.mha: --tool: no tool 'Probe'"),
    "wrong format": (HEAD.replace("plus", "ndi") + TWO, r"line 4: sweep 1: .*a\.igs\.mha.*Port"),
    "no format": (HEAD.replace("plus", "plsu") + TWO, r"line 4: sweep 1: .*no format 'plsu'"),
    "defaults is no table": ("defaults = 3\n" + TWO, r"line 1: 'defaults' must be a table"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_what_is_wrong_is_named_with_its_line(case, tmp_path, capsys):
    text, words = BROKEN[case]
    path = session(tmp_path, text)
    with pytest.raises(InputError, match=words):
        read_recording(path)
    assert str(path) in fails(capsys, "calibrate", path)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path):
    (tmp_path / "in").mkdir()
    written(replace(trackers.plus(), file="b.igs.mha"), tmp_path)
    (tmp_path / "in" / "b.igs.mha").symlink_to(tmp_path / "b.igs.mha")
    with pytest.raises(InputError, match="outside"):
        read_recording(session(tmp_path / "in", HEAD + TWO, ["a.igs.mha"]))


def test_a_file_with_labels_of_its_own_is_refused(tmp_path):
    write_recording(Recording(P, sweep=["a"] * N), tmp_path / "rec.csv")
    (tmp_path / "s.toml").write_text('[[sweep]]\nfile = "rec.csv"\n')
    with pytest.raises(InputError, match=r"line 1: sweep 1: file 'rec\.csv' has a column sweep"):
        read_recording(tmp_path / "s.toml")


def test_readings_of_a_native_file_are_kept(tmp_path):
    write_recording(Recording(P, joints={"orbital": np.radians(np.arange(N))}), tmp_path / "rec.csv")
    (tmp_path / "s.toml").write_text('[[sweep]]\nfile = "rec.csv"\nmoving = "orbital"\nheld_deg = { angular = 1 }\n')
    recording = read_recording(tmp_path / "s.toml")
    assert np.allclose(recording.joints["orbital"], np.radians(np.arange(N)))
    assert np.allclose(recording.joints["angular"], np.radians(1))


def test_a_joint_that_is_almost_another_is_warned_of(tmp_path):
    recording = read_recording(session(tmp_path, HEAD + TWO.replace("angular = -30", "angualr = -30")))
    assert [note.code for note in recording.notes if "angualr" in note.message] == ["misspelt_joint"]


def test_the_digest_is_that_of_the_session_and_of_its_files(tmp_path):
    path = session(tmp_path, HEAD + TWO)
    before = read_recording(path).source
    (tmp_path / "b.igs.mha").write_bytes((tmp_path / "b.igs.mha").read_bytes().replace(b"100.58", b"100.59"))
    assert read_recording(path).source.sha256 != before.sha256
    assert before.path == str(path)


def test_notes_of_the_files_name_them(tmp_path):
    recording = read_recording(session(tmp_path, HEAD + 'unit = "m"\n' + TWO))
    assert {note.code for note in recording.notes} == {"contradicts_file", "implausible_unit"}
    assert all(note.message.startswith(("a.igs.mha: ", "b.igs.mha: ")) for note in recording.notes)


def test_a_simulated_recording_calibrates_alike_through_a_session(tmp_path, capsys):
    given, truth = simulate("mobile_nonisocentric", "minimal", sigma_t_m=5e-4, sigma_r_rad=1e-3, seed=3)
    lines = ["[defaults]", 'placement = "A"']
    for k, sweep in enumerate(given.sweeps):
        part = Recording(given.p_world_sensor[sweep.poses], given.R_world_sensor[sweep.poses])
        write_recording(part, tmp_path / f"{k}.igs.mha")
        axes = {joint: float(np.degrees(q)) for joint, q in sweep.held.items() if joint in ("angular", "orbital")}
        held = ", ".join(f"{joint} = {angle!r}" for joint, angle in axes.items())
        lines += ["[[sweep]]", f'file = "{k}.igs.mha"', f'moving = "{sweep.moving}"', f"held_deg = {{ {held} }}"]
    (tmp_path / "session.toml").write_text("\n".join(lines))
    one, two = carm_kin.calibrate(given), carm_kin.calibrate(read_recording(tmp_path))
    assert np.allclose(one.offset_sensor_pivot_m, two.offset_sensor_pivot_m, rtol=0, atol=1e-9)
    assert np.linalg.norm(two.offset_sensor_pivot_m - truth.offset_sensor_pivot_m) < 1e-3
    assert run(capsys, "calibrate", tmp_path).status == 0
    assert run(capsys, "convert", tmp_path, "-o", tmp_path / "all.csv").status == 0
    again = read_recording(tmp_path / "all.csv")
    assert [sweep.held for sweep in again.sweeps] == [sweep.held for sweep in read_recording(tmp_path).sweeps]


def test_init_writes_a_session_that_can_be_read(tmp_path, capsys):
    for name in ("orbital_2.igs.mha", "orbital_10.igs.mha", "angular_1.igs.mha"):
        written(replace(trackers.plus(), file=name), tmp_path)
    (tmp_path / "notes.txt").write_text("nothing")
    ended = run(capsys, "session", "init", tmp_path)
    assert ended.status == 0
    assert ended.err == f"written: {tmp_path / 'session.toml'} (3 sweeps; fill in their labels)\n"
    text = (tmp_path / "session.toml").read_text()
    assert 'tracker = "plus"\ntool = "Marker"\n' in text
    recording = read_recording(tmp_path)
    assert [sweep.label for sweep in recording.sweeps] == ["angular_1", "orbital_2", "orbital_10"]
    assert [sweep.moving for sweep in recording.sweeps] == ["angular", "orbital", "orbital"]
    assert "is there already" in fails(capsys, "session", "init", tmp_path)


def test_init_asks_for_what_the_files_do_not_tell(tmp_path, capsys):
    written(trackers.custom(), tmp_path)
    assert run(capsys, "session", "init", tmp_path).status == 0
    text = (tmp_path / "session.toml").read_text()
    assert '# unit = "mm"  # mm, cm or m' in text
    assert "quaternion" not in text
    assert "--unit" in fails(capsys, "calibrate", tmp_path)
    (tmp_path / "session.toml").write_text(text.replace("# unit", "unit").replace("# moving", "moving"))
    assert_poses(read_recording(tmp_path))


@pytest.mark.parametrize("folder, words", [("none", "no such folder"), (".", "no file in a known format")])
def test_init_of_a_folder_without_recordings(folder, words, tmp_path, capsys):
    assert words in fails(capsys, "session", "init", tmp_path / folder)
