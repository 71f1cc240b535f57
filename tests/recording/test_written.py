"""The step of the last digit with which joint values seem to be written."""

import numpy as np
import pytest

from carm_kin.recording.written import written_step


@pytest.mark.parametrize(
    "degrees, step",
    [
        ([-30, 0, 90, np.nan], 1.0),
        ([0, 0], 1.0),
        ([-30, 22.5], 0.1),
        ([12.34, 30], 0.01),
        ([-29.96470, 22.57458], 1e-5),
        ([-29.988178375299743], 1e-6),
    ],
)
def test_degrees(degrees, step):
    assert np.degrees(written_step(np.radians(degrees))) == pytest.approx(step)


def test_radians_millimetres_and_nothing():
    assert written_step(np.array([0.524, -1.2])) == pytest.approx(1e-3)
    assert written_step(np.array([0.25, 0.1005]), prismatic=True) == pytest.approx(1e-4)
    assert np.isnan(written_step(np.array([np.nan])))
