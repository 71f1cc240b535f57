"""Files of real trackers, read with the counts that other means give; they are not part of the project."""

import csv
import re
from itertools import pairwise

import numpy as np
import pytest

import carm_kin
from carm_kin.errors import InputError
from carm_kin.recording.declarations import Declarations
from carm_kin.recording.formats import read_recording
from helpers.command import fails, run
from helpers.places import DATA

FORMATS = DATA / "formats"
PLUS = FORMATS / "plus/EightLandmarkPointsTrackedForPhantomRegistration.igs.mha"

pytestmark = pytest.mark.skipif(not FORMATS.is_dir(), reason="../shared/data/formats is not here")

CASES = {
    "plus stylus": (PLUS, {"tool": "Stylus"}, "plus", 1000, 996, "4 identical to the frame before"),
    "plus in its reference": (PLUS, {"reference": "Reference"}, "plus", 1000, 996, "4 identical to the frame before"),
    "plus synthetic": (
        FORMATS / "plus/SyntheticTrackerBuffer20.igs.mha",
        {},
        "plus",
        20,
        18,
        "2 identical to the frame before",
    ),
    "ndi": (FORMATS / "ndi/ndi_tooltracker_pose1.csv", {}, "ndi", 100, 100, ""),
    "ndi folder": (FORMATS / "ndi/one_pose_per_file", {}, "ndi", 14, 14, ""),
    "aurora": (
        FORMATS / "ndi/ndi_aurora_4sensor_custom.csv",
        {"tool": "a", "unit": "mm"},
        "table",
        159,
        154,
        "2 all zero, 2 identical to the frame before, 1 cut off",
    ),
    "motive": (
        FORMATS / "motive/rigid_body_motion_optitrack.csv",
        {"tool": "RigidBody 01", "unit": "mm", "euler": "XYZ"},
        "motive",
        227,
        227,
        "",
    ),
    "tum": (FORMATS / "tum/freiburg1_xyz-groundtruth-head.txt", {}, "tum", 397, 397, ""),
    "ros": (FORMATS / "ros/tf_example.bag", {}, "ros", 517, 210, "307 identical to the frame before"),
    "tfm": (FORMATS / "tfm", {}, "tfm", 4, 3, "1 identical to the frame before"),
}


@pytest.mark.parametrize("case", CASES)
def test_every_sample_is_read_with_its_counts(case):
    path, declared, format, frames, kept, reasons = CASES[case]
    recording = read_recording(path, declared=Declarations(**declared))
    (intake,) = recording.intakes
    assert (intake.format, intake.frames, intake.kept, intake.in_words()) == (format, frames, kept, reasons)
    assert len(recording) == kept


@pytest.mark.parametrize(
    "file, words",
    [
        ("plus/NrrdSample.igs.nrrd", "no tracked transform"),
        ("plus/PlusDeviceSet_Server_NDIPolaris.xml", "does not tell the format"),
        ("plus/EightLandmarkPointsTrackedForPhantomRegistration.igs.mha", r"--tool .*Reference \(1000.*Stylus \(1000"),
        ("ndi/ndi_aurora_4sensor_custom.csv", r"--tool .*a \(156 frames\); b \(154 frames\); c \(149 frames\)"),
        ("motive/rigid_body_motion_optitrack.csv", "--tool .*RigidBody 01.*RigidBody 02"),
        ("ndi", "several formats: ndi, table"),
    ],
)
def test_what_cannot_be_read_without_a_word_says_which(file, words):
    with pytest.raises(InputError, match=words):
        read_recording(FORMATS / file)


def test_the_counts_of_the_aurora_log_are_those_of_its_zeros():
    with (FORMATS / "ndi/ndi_aurora_4sensor_custom.csv").open(newline="") as file:
        rows = [row for row in csv.reader(file) if len(row) == 34 and row[0].isdigit()]
    for k, sensor in enumerate("abcd"):
        poses = [tuple(map(float, row[5 + 7 * k : 12 + 7 * k])) for row in rows]
        seen = [pose for pose in poses if any(pose)]
        new = 1 + sum(a != b for a, b in pairwise(seen))
        declared = Declarations(tool=sensor, unit="mm")
        recording = read_recording(FORMATS / "ndi/ndi_aurora_4sensor_custom.csv", declared=declared)
        assert len(recording) == new
        assert np.allclose(recording.p_world_sensor[-1] * 1e3, seen[-1][:3])


def test_a_motive_export_of_old_asks_for_its_unit_and_its_order():
    path = FORMATS / "motive/rigid_body_motion_optitrack.csv"
    with pytest.raises(InputError, match="--euler: XYZ"):
        read_recording(path, declared=Declarations(tool="RigidBody 01"))
    with pytest.raises(InputError, match="--unit mm, cm or m"):
        read_recording(path, declared=Declarations(tool="RigidBody 01", euler="XYZ"))


def test_the_positions_of_the_sequence_are_those_in_its_text():
    text = PLUS.read_text()
    found = re.search(r"Seq_Frame0999_StylusToTrackerTransform = (.*)", text)
    assert found is not None
    T = np.array(found[1].split(), dtype=float).reshape(4, 4)
    recording = read_recording(PLUS, declared=Declarations(tool="Stylus"))
    assert recording.pose_number[-1] == 999
    assert np.allclose(recording.p_world_sensor[-1], T[:3, 3] / 1e3, rtol=0, atol=1e-15)
    assert np.allclose(recording.R_world_sensor[-1], T[:3, :3], rtol=0, atol=5e-4)


def test_slicers_transform_is_inverted_and_turned_to_ras():
    """affine.tfm in LPS from the parent: 30 degrees about x, (0, 2.38406, -1.41421) mm."""
    c, s, t = np.cos(np.pi / 6), np.sin(np.pi / 6), np.array([0, 2.38406, -1.41421])
    A = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    to_ras = np.diag([-1, -1, 1])
    recording = read_recording(FORMATS / "tfm/affine.tfm")
    assert np.allclose(recording.R_world_sensor[0], to_ras @ A.T @ to_ras, atol=1e-12)
    assert np.allclose(recording.p_world_sensor[0] * 1e3, -to_ras @ A.T @ t, atol=1e-12)


def test_the_folder_of_single_poses_is_placement_a_of_the_c_arm(capsys):
    native = carm_kin.read_recording(DATA / "real-carm/marker_two_placements.csv")
    assert native.placement is not None
    raw = read_recording(FORMATS / "ndi/one_pose_per_file")
    one, two = (carm_kin.calibrate(r) for r in (native.select(native.placement == "A"), raw))
    assert two.status == one.status
    assert two.status in ("ok", "doubtful")
    assert np.allclose(one.offset_sensor_pivot_m, two.offset_sensor_pivot_m, rtol=0, atol=1e-6)
    assert one.major_radius_m == pytest.approx(two.major_radius_m, abs=1e-6)
    ended = run(capsys, "calibrate", FORMATS / "ndi/one_pose_per_file")
    assert ended.status == (0 if two.status == "ok" else 3)
    assert f"{two.status}: solver kinematic, 14 of 14 poses" in ended.out


def test_the_command_says_which_option_is_missing(capsys):
    assert "--tool" in fails(capsys, "calibrate", PLUS)
