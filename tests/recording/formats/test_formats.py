"""Every format: what is read from a sound file, and that a broken one gives a result or one clear line."""

import re

import numpy as np
import pytest

import carm_kin
from carm_kin.errors import InputError
from carm_kin.recording import ingest, session_recording, stations
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import format_of, formats, read_recording, ros, write_recording
from carm_kin.recording.recording import Recording
from carm_kin.testing import format as contract
from carm_kin.testing.format import read, result_or_line
from helpers import trackers
from helpers.command import fails, run
from helpers.places import ROOT
from helpers.trackers import FREE, MAKERS, ROTATION, TIME, N, P, assert_poses, written

every = pytest.mark.parametrize("kind", MAKERS)
text_only = pytest.mark.parametrize("kind", [kind for kind in MAKERS if kind not in ("npz", "mat")])
tables = pytest.mark.parametrize(
    "kind", [k for k, make in MAKERS.items() if make().delimiter and make().header is not None]
)


def test_every_format_has_a_sample():
    others = {"ros", "session"}
    assert {make().format for make in MAKERS.values()} | others == formats().keys()


@every
def test_the_poses_and_times_are_read(kind, tmp_path):
    contract.poses_and_times_are_read(MAKERS[kind](), tmp_path)


@every
def test_the_content_tells_the_format_whatever_the_name(kind, tmp_path):
    contract.content_tells_the_format(MAKERS[kind](), tmp_path)


@every
def test_a_file_cut_anywhere_loses_no_frame_in_silence(kind, tmp_path):
    contract.cut_anywhere_it_loses_no_frame_in_silence(MAKERS[kind](), tmp_path)


@pytest.mark.parametrize("kind", ["plus", "nrrd", "motive", "tfm"])
def test_what_the_header_announces_and_the_file_lacks_is_counted(kind, tmp_path):
    sample = MAKERS[kind]()
    lines = sample.content.split(b"\n")
    last = {"plus": -8, "nrrd": -8, "motive": -3, "tfm": -2}[kind]
    recording = read(written(sample, tmp_path, b"\n".join(lines[:last]) + b"\n"), sample)
    (intake,) = recording.intakes
    assert len(recording) < N == intake.frames
    assert "cut off" in intake.in_words()


@every
def test_an_empty_file_is_one_line(kind, tmp_path):
    contract.empty_it_is_one_line(MAKERS[kind](), tmp_path)


@every
def test_a_header_without_frames_is_one_line(kind, tmp_path):
    sample = MAKERS[kind]()
    if sample.header:
        content = b"\n".join(sample.content.split(b"\n")[: sample.header]) + b"\n"
        with pytest.raises(InputError, match=r"no poses|empty|no pose"):
            read_recording(written(sample, tmp_path, content), sample.format, sample.declared)


@text_only
def test_the_byte_order_mark_does_not_matter(kind, tmp_path):
    sample = MAKERS[kind]()
    assert_poses(read(written(sample, tmp_path, b"\xef\xbb\xbf" + sample.content), sample))


@text_only
def test_utf_16_is_refused_with_the_remedy(kind, tmp_path):
    sample = MAKERS[kind]()
    content = sample.content.decode().encode("utf-16")
    with pytest.raises(InputError, match="UTF-8"):
        read_recording(written(sample, tmp_path, content), declared=sample.declared)


@text_only
def test_line_ends_do_not_matter(kind, tmp_path):
    sample = MAKERS[kind]()
    assert_poses(read(written(sample, tmp_path, sample.content.replace(b"\n", b"\r\n")), sample))


@tables
def test_decimal_commas_are_refused_or_read(kind, tmp_path):
    sample = MAKERS[kind]()
    for between in (sample.delimiter, ";"):
        lines = sample.content.decode().split("\n")
        start = sample.header or 0
        swapped = [line.replace(sample.delimiter, between) for line in lines[:start]]
        body = [line.replace(sample.delimiter, between).replace(".", ",") for line in lines[start:]]
        path = written(sample, tmp_path, "\n".join([*swapped, *body]).encode())
        recording = result_or_line(path, sample)
        assert recording is None or np.allclose(recording.p_world_sensor, P, rtol=0, atol=1e-6)


@tables
def test_not_a_number_is_counted_or_refused(kind, tmp_path):
    sample = MAKERS[kind]()
    lines = sample.content.decode().split("\n")
    row = (sample.header or 0) + 4
    cells = lines[row].split(sample.delimiter)
    for word in ("nan", "NaN", "inf", "1e999", "-nan(ind)", "abc", "1.2.3", "1_000", "0x1"):
        for column in (-3, -5, -7):
            changed = [*cells]
            changed[column] = word
            content = "\n".join([*lines[:row], sample.delimiter.join(changed), *lines[row + 1 :]]).encode()
            recording = result_or_line(written(sample, tmp_path, content), sample)
            if recording is not None and recording.missing:
                assert recording.pose_number.tolist() == [i for i in range(N) if i != 4]
                assert_poses(recording, recording.pose_number)
            elif recording is not None:
                assert_poses(recording)


def test_a_frame_of_nan_is_dropped_with_its_reason(tmp_path):
    for kind in ("tum", "ndi", "motive", "custom", "hololens_lines"):
        sample = MAKERS[kind]()
        lines = sample.content.decode().split("\n")
        row = (sample.header or 0) + 4
        cells = lines[row].split(sample.delimiter)
        cells[7] = "nan"
        content = "\n".join([*lines[:row], sample.delimiter.join(cells), *lines[row + 1 :]]).encode()
        recording = read(written(sample, tmp_path, content), sample)
        assert recording.intakes[0].in_words() == "1 without numbers", kind


@tables
def test_the_order_of_columns_does_not_matter_where_they_have_names(kind, tmp_path):
    sample = MAKERS[kind]()
    if sample.fixed:
        return
    first = {"ndi": 2, "ndi_euler": 2}.get(kind, 0)
    lines = [line.split(sample.delimiter) for line in sample.content.decode().split("\n")]
    width = len(lines[-2])
    order = [*range(first), *(first + np.random.default_rng(0).permutation(width - first))]
    if kind == "motive":
        order = [0, *(1 + np.random.default_rng(0).permutation(width - 1))]
    shuffled = [[cells[i] for i in order] if len(cells) == width else cells for cells in lines]
    content = "\n".join(map(sample.delimiter.join, shuffled)).encode()
    if kind == "motive":
        content = content.replace(content.split(b"\n")[0], sample.content.split(b"\n")[0])
    assert_poses(read(written(sample, tmp_path, content), sample))


@every
def test_garbage_is_one_line(kind, tmp_path):
    contract.garbage_is_one_line(MAKERS[kind](), tmp_path)


@every
def test_single_bytes_that_changed_give_a_result_or_one_line(kind, tmp_path):
    contract.changed_bytes_give_a_result_or_one_line(MAKERS[kind](), tmp_path)


@every
def test_what_a_format_writes_it_reads_again(kind, tmp_path):
    contract.what_is_written_is_read_again(MAKERS[kind](), tmp_path)


@every
def test_a_hundred_megabytes_end_soon(kind, tmp_path):
    """A file whose head is sound and whose last line never ends."""
    sample = MAKERS[kind]()
    path = written(sample, tmp_path)
    with path.open("ab") as file:
        for _ in range(10):
            file.write(b"7" * 10_000_000)
    result_or_line(path, sample)


def test_a_folder_of_files_is_read_in_the_order_of_its_numbers(tmp_path):
    sample = trackers.ndi()
    header, *rows = sample.content.decode().rstrip().split("\n")
    for i, row in enumerate(rows, 1):
        (tmp_path / f"NDI_{i}.csv").write_text(f"{header}\n{row}\n")
    (tmp_path / "notes.txt").write_text("nothing")
    recording = read(tmp_path, sample)
    assert_poses(recording)
    assert recording.metadata["file"].tolist() == [f"NDI_{i}.csv" for i in range(1, N + 1)]
    (note,) = [note for note in recording.warnings if note.code == "files_left_out"]
    assert "notes.txt" in note.message


def test_a_folder_of_several_formats_or_of_none_is_refused(tmp_path):
    with pytest.raises(InputError, match="no file in a known format"):
        read_recording(tmp_path)
    for make in (trackers.ndi, trackers.tum):
        written(make(), tmp_path)
    with pytest.raises(InputError, match="several formats: ndi, tum"):
        read_recording(tmp_path)


@pytest.mark.parametrize("file", ["rec.igs.mha", "rec.seq.nrrd", "rec.tum"])
def test_what_is_written_is_read_again(file, tmp_path):
    number = np.array([0, 1, *range(4, N + 2)])
    given = Recording(P, ROTATION.as_matrix(), TIME, missing=2, pose_number=number)
    if file.endswith("tum"):
        given = Recording(P, ROTATION.as_matrix(), TIME)
    write_recording(given, tmp_path / file)
    again = read_recording(tmp_path / file)
    assert np.allclose(again.p_world_sensor, P, rtol=1e-15, atol=0)
    assert np.allclose(again.R_world_sensor, given.R_world_sensor, rtol=0, atol=4e-15)
    assert again.time_s.tolist() == TIME.tolist()
    assert (again.missing, again.pose_number.tolist()) == (given.missing, given.pose_number.tolist())


@pytest.mark.parametrize("file", ["rec.mha", "rec.tum"])
def test_what_a_format_cannot_hold_is_not_written(file, tmp_path):
    with pytest.raises(InputError, match="orientations"):
        write_recording(Recording(P, time_s=TIME), tmp_path / file)
    assert list(tmp_path.iterdir()) == []


def test_convert_counts_and_writes(tmp_path, capsys):
    sample = trackers.ndi()
    content = sample.content.replace(b"503,1,OK", b"503,1,MISSING")
    path = written(sample, tmp_path, content)
    ended = run(capsys, "convert", path, "-o", tmp_path / "rec.csv")
    assert ended.status == 0
    assert re.search(r"frames +30 \(ndi, Port 2: Marker s/n:1A2B\)\n +kept +29\n +MISSING +1\n", ended.out), ended.out
    assert ended.err == f"written: {tmp_path / 'rec.csv'} (29 poses)\n"
    assert_poses(carm_kin.read_recording(tmp_path / "rec.csv"), np.arange(N) != 3)
    ended = run(capsys, "convert", tmp_path / "rec.csv", "-o", tmp_path / "rec.mha")
    assert "warning" not in ended.err


def test_convert_says_what_is_lost(tmp_path, capsys):
    given = Recording(P, ROTATION.as_matrix(), TIME, sweep=["s"] * N)
    write_recording(given, tmp_path / "rec.csv")
    ended = run(capsys, "convert", tmp_path / "rec.csv", "-o", tmp_path / "rec.tum")
    assert "'tum' does not hold sweep" in ended.err


@pytest.mark.parametrize(
    "arguments, expected",
    [
        (("none.csv", "-o", "a.csv"), "none.csv: no such file"),
        (("ndi.csv", "-o", "a.xyz"), "the extension does not tell the format; choose from csv, plus, tum"),
        (("ndi.csv", "-o", "a.csv", "--to", "ros"), "no format 'ros' here"),
        (("ndi.csv", "-o", "none/a.csv"), "the folder none does not exist"),
        (("ndi.csv", "-o", "a.csv", "--tool", "marke"), None),
        (("ndi.csv", "-o", "a.csv", "--tool", "pointer"), "--tool: no tool 'pointer'; the file has Port 2"),
        (("ndi.csv", "-o", "a.csv", "--unit", "inch"), "--unit 'inch' is unknown; it is one of mm, cm, m"),
        (("ndi.csv", "-o", "a.csv", "--euler", "XXZ"), "--euler 'XXZ' is unknown"),
        (("ndi.csv", "-o", "a.csv", "--format", "tum"), "ndi.csv, line 1, column"),
    ],
)
def test_arguments_of_convert(arguments, expected, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    written(trackers.ndi(), tmp_path)
    if expected is None:
        assert run(capsys, "convert", *arguments).status == 0
    else:
        assert expected in fails(capsys, "convert", *arguments)
        assert not (tmp_path / "a.csv").exists()


def test_formats_lists_every_format(capsys):
    ended = run(capsys, "formats")
    assert ended.status == 0
    for name, format in formats().items():
        assert re.search(
            rf"^ +{name} +read{', write' if format.write else ''} +{re.escape(format.summary)}$", ended.out, re.M
        )


def test_declarations_reach_the_command(tmp_path, capsys):
    sample = trackers.custom()
    path = written(sample, tmp_path)
    assert "--unit mm, cm or m" in fails(capsys, "convert", path, "-o", tmp_path / "a.csv")
    assert run(capsys, "convert", path, "-o", tmp_path / "a.csv", "--unit", "cm").status == 0
    found = carm_kin.read_recording(tmp_path / "a.csv")
    assert np.allclose(found.p_world_sensor, P * 10, rtol=0, atol=1e-5)


def test_an_unknown_option_value_of_a_declaration_names_the_option():
    with pytest.raises(InputError, match="--quaternion 'wzyx' is unknown; it is one of wxyz, xyzw"):
        Declarations(quaternion="wzyx")


@pytest.mark.parametrize(
    "kind", ["VersorRigid3D", "Euler3D", "Euler3D ZYX", "Translation", "MatrixOffsetTransformBase"]
)
def test_the_rigid_transforms_of_itk(kind, tmp_path):
    """Their parameters as ITK's guide defines them: versor or angles, then the translation; the centre is fixed."""
    R, t, center = ROTATION[7], np.array([1.0, -2.0, 3.0]), np.array([10.0, 20.0, -30.0])
    fixed = list(center)
    if kind == "Translation":
        R, name, parameters = R.identity(), "TranslationTransform", []
    elif kind == "VersorRigid3D":
        name, parameters = "VersorRigid3DTransform", list(R.as_quat(canonical=True)[:3])
    elif kind.startswith("Euler3D"):
        order = "ZYX" if kind.endswith("ZYX") else "ZXY"
        angles = dict(zip(order, R.as_euler(order), strict=True))
        name, parameters = "Euler3DTransform", [angles[axis] for axis in "XYZ"]
        fixed.append(float(order == "ZYX"))
    else:
        name, parameters = kind, list(R.as_matrix().ravel())
    lines = ["#Insight Transform File V1.0", f"Transform: {name}_double_3_3"]
    lines += ["Parameters: " + " ".join(map(str, [*parameters, *t])), "FixedParameters: " + " ".join(map(str, fixed))]
    (tmp_path / "one.tfm").write_text("\n".join(lines))
    recording = read_recording(tmp_path / "one.tfm")
    to_ras, points = np.diag([-1, -1, 1]), np.random.default_rng(0).normal(size=(5, 3))
    in_child = R.apply(points - center) + t + center
    assert recording.R_world_sensor is not None
    back = (to_ras @ in_child.T).T @ recording.R_world_sensor[0].T + recording.p_world_sensor[0] * 1e3
    assert np.allclose(back, (to_ras @ points.T).T, rtol=0, atol=1e-9)


def test_other_transforms_of_itk_are_refused_by_name(tmp_path):
    (tmp_path / "one.tfm").write_text("#Insight Transform File V1.0\nTransform: BSplineTransform_double_3_3\n")
    with pytest.raises(InputError, match=r"one\.tfm, line 2: 'BSplineTransform_double_3_3' is no rigid transform"):
        read_recording(tmp_path / "one.tfm")


PAGES = ROOT / "docs" / "formats"
OPTIONS = {"hololens": Declarations(left_handed=True), "table": Declarations(tool="a", unit="mm")}


def excerpts(page: str) -> list[str]:
    """The blocks of a page that are in no language: what a file looks like."""
    blocks = page.split("```")[1::2]
    return [block.removeprefix("\n") for block in blocks if block.startswith("\n")]


@pytest.mark.parametrize("name", [name for name in formats() if name not in ("csv", "session")])
def test_every_format_has_a_page_and_what_it_shows_is_read(name, tmp_path):
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert "carm-kin calibrate " in page
    assert f"[{name}]({name}.md)" in (PAGES / "README.md").read_text(encoding="utf-8")
    assert excerpts(page) or name in ("ros", "npz", "mat")
    for k, text in enumerate(excerpts(page)):
        path = tmp_path / f"{k}.dat"
        path.write_text(text)
        found = format_of(path)
        assert found is not None
        assert found.name == name
        declared = OPTIONS.get(name, FREE) if "Tx" in text or name == "table" else FREE
        assert len(read_recording(path, declared=declared)) >= 1


def test_every_reason_is_in_the_documentation():
    text = (PAGES / "README.md").read_text(encoding="utf-8")
    reasons = (ingest.REPEATED, ingest.CUT_OFF, stations.OUTSIDE, session_recording.OUTSIDE, ros.GAP)
    assert [reason for reason in reasons if f"`{reason}`" not in text] == []
