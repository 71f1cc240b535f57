"""The live view of a C that bends: the offset at the pose at hand, against a sag known in closed form."""

import io
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from carm_kin.streams.capture import Scene
from carm_kin.streams.estimate import current
from carm_kin.streams.frames import Frame
from carm_kin.streams.live import Live, Pose
from carm_kin.streams.marks import Marks
from carm_kin.streams.view import Title, panel
from helpers import bending


@pytest.fixture(scope="module")
def now():
    """The calibration of a capture with labels of its sweeps."""
    motion = bending.sweeps()
    poses = []
    for T, held, label in zip(bending.recorded(motion, 1).T_world_sensor, motion.held, motion.label, strict=True):
        joint = int(held[1] >= 0)
        marks = Marks(sweep=int(held.max()), within=True, moving=("orbital", "angular")[joint])
        poses.append(Pose(T, replace(marks, held_deg=float(np.degrees(label[joint])))))
    return current(poses, 10 * len(poses))


def shown(now, angles_deg, placement=1) -> str:
    marks, motion = Marks(placement=placement), bending.sweeps_deg((angles_deg[0],), (angles_deg[1],), (), ())
    live = Live(marks)
    live.add([Frame(0.0, 0.0, T) for T in bending.recorded(motion, 8).T_world_sensor], marks)
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(panel(Title("s", "t", None, "f", None), Scene(live.snapshot(), now, True, Counter(), "")))
    return console.export_text()


@pytest.mark.parametrize("angles_deg", [(50, -50), (-50, 50), (0, 0)])
def test_the_offset_is_that_of_the_pose_at_hand(now, angles_deg):
    text = shown(now, angles_deg)
    row = next(line for line in text.splitlines() if "here" in line)
    numbers = np.array([[float(x) for x in pair] for pair in re.findall(r"(-?[\d.]+) ± ([\d.]+)", row)])
    truth = (bending.mean_mount()[:3, 3] + bending.shift_m(np.radians([angles_deg]))[0]) * 1e3
    assert (np.abs(numbers[:, 0] - truth) < 3 * numbers[:, 1]).all()
    assert np.linalg.norm(numbers[:, 0] - truth) < 0.5
    assert "EXTRAPOLATED" not in row


def test_a_pose_beyond_the_swept_angles_is_marked(now):
    assert "EXTRAPOLATED" in shown(now, (110, 0))
    assert "here" not in shown(now, (0, 0), placement=2)


def test_systematic_errors_are_not_divided_by_the_number_of_poses(now):
    """Ten times as many poses leave a tenth of the variance of the noise, and all of the sag's."""
    assert now.centre is not None
    parts = {part.cause: part.offset_sensor_pivot_m**2 for part in now.centre.result.sigma_parts}
    noise = parts.pop("noise") + parts.pop("correlation", np.zeros(3))
    systematic = np.sum(list(parts.values()), axis=0)
    np.testing.assert_allclose(now.sigma_m**2, noise / 10 + systematic, rtol=1e-6)
    assert (systematic > noise).all()
