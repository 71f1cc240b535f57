"""A ROS 2 static transform: the parameters of tf2_ros's publisher as YAML, and its command line."""

import json
import shlex
from pathlib import Path

from carm_kin.exports._wanted import Subject, Wanted, facts, subject_of
from carm_kin.files import write_atomically
from carm_kin.results.result import CalibrationResult
from solvers.se3 import quat_wxyz_from_rotation

ENDING = ".yaml"
SUMMARY = "ROS 2 static transform: parameters of tf2_ros (metres, quaternion xyzw) and the command line."
TAKES = ("transform", "placement", "parent_frame", "child_frame")


def write(result: CalibrationResult, out: Path, wanted: Wanted) -> None:
    """Write the file; translations in metres."""
    subject = subject_of(result, wanted)
    convention = f"frame_id = parent, child_frame_id = child; p_{subject.parent} = T p_{subject.child}"
    lines = [f"# {line}" for line in facts(result, subject, convention, "metres; quaternion x, y, z, w")]
    numbers = _numbers(subject)
    lines += [f"# command: {_command(subject, numbers)}", "/**:", "  ros__parameters:"]
    lines += [f"    frame_id: {json.dumps(subject.parent)}", f"    child_frame_id: {json.dumps(subject.child)}"]
    for group, names in (("translation", ("x", "y", "z")), ("rotation", ("qx", "qy", "qz", "qw"))):
        lines += [f"    {group}:", *(f"      {name[-1]}: {numbers[name]}" for name in names)]
    write_atomically(out, "\n".join(lines) + "\n")


def _numbers(subject: Subject) -> dict[str, str]:
    """Decimals with a point and no exponent, as YAML and the parameters' type want them."""
    w, x, y, z = quat_wxyz_from_rotation(subject.T_parent_child[:3, :3])
    values = (*subject.T_parent_child[:3, 3], x, y, z, w)
    return {
        name: f"{value + 0.0:.15f}" for name, value in zip(("x", "y", "z", "qx", "qy", "qz", "qw"), values, strict=True)
    }


def _command(subject: Subject, numbers: dict[str, str]) -> str:
    words = ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    words += [word for name, value in numbers.items() for word in (f"--{name}", value)]
    return shlex.join([*words, "--frame-id", subject.parent, "--child-frame-id", subject.child])
