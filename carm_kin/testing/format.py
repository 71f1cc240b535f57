"""The contract of a format, each check a function of a sample; an AssertionError says what is broken."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.spatial.transform import Rotation

from carm_kin.errors import InputError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import format_of, read_recording, write_recording, writer_of
from carm_kin.recording.recording import Recording
from solvers.se3 import Array

NEAR = 1e-6
"""m and rad within which a sample holds its poses."""
LONGEST = 600
"""Characters of an error."""


@dataclass(frozen=True)
class Sample:
    """A sound file of a format, and the N poses in it, known from elsewhere."""

    format: str
    file: str
    """Its name."""
    content: bytes
    p_world_sensor: Array
    """(N, 3), m, exact to 1e-6."""
    R_world_sensor: Array
    """(N, 3, 3), exact to 1e-6."""
    time_s: Array | None = None
    """(N,); None where the file tells no time."""
    declared: Declarations = field(default_factory=Declarations)
    """What must be said to read it."""
    header: int | None = None
    """Lines above the first frame where a frame is a line, else None."""

    def frames_in(self, content: bytes) -> int:
        """Lines of frames, the last one perhaps cut; 0 where frames are no lines."""
        return 0 if self.header is None else max(0, len(content.splitlines()) - self.header)


def check_format(sample: Sample) -> None:
    """Every check below. Raises AssertionError for a broken promise."""
    for check in (
        poses_and_times_are_read,
        content_tells_the_format,
        cut_anywhere_it_loses_no_frame_in_silence,
        empty_it_is_one_line,
        garbage_is_one_line,
        changed_bytes_give_a_result_or_one_line,
        what_is_written_is_read_again,
    ):
        with TemporaryDirectory() as folder:
            check(sample, Path(folder))


def poses_and_times_are_read(sample: Sample, folder: Path) -> None:
    """All poses, in metres, and the time between them; the format is told without its name."""
    path = written(sample, folder)
    found = format_of(path)
    assert found is not None, "no format is found"
    assert found.name == sample.format, f"the file is taken for '{found.name}'"
    recording = read(path, sample)
    assert_poses(recording, sample)
    assert recording.missing == 0, f"{recording.missing} frames of a sound file are missing"
    assert recording.intakes[0].format == sample.format, f"it was read as '{recording.intakes[0].format}'"
    assert (recording.time_s is None) == (sample.time_s is None), "times are there in one case alone"
    if recording.time_s is not None and sample.time_s is not None:
        steps = np.diff(recording.time_s), np.diff(sample.time_s)
        np.testing.assert_allclose(*steps, rtol=0, atol=1e-6, err_msg="times")


def content_tells_the_format(sample: Sample, folder: Path) -> None:
    """Whatever the file is called."""
    found = format_of(written(replace(sample, file="noname.dat"), folder))
    assert found is not None, "no format is found by the content"
    assert found.name == sample.format, f"the content is taken for '{found.name}'"


def cut_anywhere_it_loses_no_frame_in_silence(sample: Sample, folder: Path) -> None:
    """A frame that is cut is counted, or there is an error of one line."""
    whole = len(sample.content)
    for end in {*range(0, whole, max(1, whole // 60)), *range(max(0, whole - 40), whole)}:
        content = sample.content[:end]
        recording = result_or_line(written(sample, folder, content), sample)
        if recording is not None:
            there, told = sample.frames_in(content), recording.intakes[0].frames
            assert told >= there, f"cut after {end} bytes, {there} frames begin and {told} are counted"
            if content.endswith(b"\n"):
                assert_poses(recording, sample, recording.pose_number)


def empty_it_is_one_line(sample: Sample, folder: Path) -> None:
    """Of an error."""
    found = outcome(written(sample, folder, b""), sample.format, sample.declared)
    assert isinstance(found, str), "an empty file gives a recording"
    _assert_line(found)


def garbage_is_one_line(sample: Sample, folder: Path) -> None:
    """Or a recording, where the file begins well, whose frames are counted."""
    rng, half = np.random.default_rng(0), sample.content[: len(sample.content) // 2]
    noise = rng.integers(0, 256, 50_000, dtype=np.uint8).tobytes()
    for content in (noise, half + noise, b"\0" * 1000, bytes(range(256)) * 4):
        path = written(sample, folder, content)
        for format in (None, sample.format):
            found = outcome(path, format, sample.declared)
            if isinstance(found, str):
                _assert_line(found)
            else:
                assert found.intakes[0].frames >= sample.frames_in(half), "frames are lost in silence"


def changed_bytes_give_a_result_or_one_line(sample: Sample, folder: Path) -> None:
    """Single bytes, at forty places."""
    rng = np.random.default_rng(1)
    for _ in range(40):
        content = bytearray(sample.content)
        content[rng.integers(len(content))] = rng.integers(256)
        result_or_line(written(sample, folder, bytes(content)), sample)


def what_is_written_is_read_again(sample: Sample, folder: Path) -> None:
    """Where the format writes: the same poses."""
    try:
        writer_of(folder / sample.file, sample.format)
    except InputError:
        return
    given = Recording(sample.p_world_sensor, sample.R_world_sensor, sample.time_s)
    write_recording(given, folder / sample.file, sample.format)
    assert_poses(read_recording(folder / sample.file, sample.format, sample.declared), sample)


def written(sample: Sample, folder: Path, content: bytes | None = None) -> Path:
    """The sample as a file in the folder, or the ``content`` under its name."""
    path = folder / sample.file
    path.write_bytes(sample.content if content is None else content)
    return path


def read(path: Path, sample: Sample) -> Recording:
    """The recording, every frame of which is kept or counted."""
    recording = read_recording(path, declared=sample.declared)
    (intake,) = recording.intakes
    assert intake.kept == len(recording), "kept frames are miscounted"
    assert intake.frames == intake.kept + sum(drop.count for drop in intake.dropped), "dropped frames are miscounted"
    assert recording.missing == intake.frames - intake.kept, "missing frames are miscounted"
    return recording


def outcome(path: Path, format: str | None, declared: Declarations) -> Recording | str:
    """A recording, or the message of the error."""
    try:
        return read_recording(path, format, declared)
    except InputError as error:
        return str(error)


def result_or_line(path: Path, sample: Sample) -> Recording | None:
    """A recording, or None where there is an error of one line that names the file."""
    found = outcome(path, None, sample.declared)
    if isinstance(found, str):
        assert str(path) in found, f"the error does not name the file: {found}"
        _assert_line(found)
        return None
    return read(path, sample)


def _assert_line(error: str) -> None:
    assert "\n" not in error, f"the error has several lines: {error}"
    assert len(error) < LONGEST, f"the error is long: {error}"


def assert_poses(recording: Recording, sample: Sample, frames: slice | np.ndarray = slice(None)) -> None:
    """The poses are those of the sample's ``frames``, to 1e-6 m and 1e-6 rad."""
    p, R = sample.p_world_sensor[frames], sample.R_world_sensor[frames]
    np.testing.assert_allclose(recording.p_world_sensor, p, rtol=0, atol=NEAR, err_msg="positions")
    assert recording.R_world_sensor is not None, "the orientations are missing"
    turn = Rotation.from_matrix(R).inv() * Rotation.from_matrix(recording.R_world_sensor)
    assert turn.magnitude().max() < NEAR, f"orientations are off by {turn.magnitude().max():.3g} rad"
