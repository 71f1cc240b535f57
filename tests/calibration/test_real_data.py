"""Recordings of real trackers; the figures are those of the notes beside them."""

from dataclasses import replace

import numpy as np
import pytest

import carm_kin
from carm_kin.calibration.problem import to_problem
from carm_kin.recording.recording import Recording
from helpers.command import run
from helpers.places import DATA
from solvers import pivot

CARM = DATA / "real-carm" / "marker_two_placements.csv"
STATIONS = DATA / "real-carm-raw" / "stations_1_to_56.csv"
PIVOT = DATA / "static-pivot" / "pointer_481.csv"

OFFSET_MM = np.array([-157.4, 9.8, 685.1])
ORBITAL_AXIS = np.array([0.966, 0.108, 0.234])
TIP_MM = np.array([-17.780, 1.111, -156.865])
DIVOT_MM = np.array([146.901, -62.969, -1042.140])

needs_carm = pytest.mark.skipif(not CARM.is_file(), reason="../shared/data/real-carm is not here")
needs_pivot = pytest.mark.skipif(not PIVOT.is_file(), reason="../shared/data/static-pivot is not here")


@pytest.fixture(scope="module")
def carm() -> Recording:
    return carm_kin.read_recording(CARM)


@needs_carm
@pytest.mark.parametrize("solver", ["kinematic", "direct", "closed_form"])
def test_two_placements_with_one_sensor_mount(solver, carm):
    result = carm_kin.calibrate(carm, solver)
    assert result.status in ("ok", "doubtful")  # fits of single placements scatter by several of their sigmas
    assert [placement.label for placement in result.placements] == ["A", "B"]
    assert np.linalg.norm(result.offset_sensor_pivot_m * 1e3 - OFFSET_MM) < 3
    assert result.residuals.translation_rms_m < 1e-3
    assert result.major_radius_m == pytest.approx(0.015, abs=0.003)
    sine = np.linalg.norm(np.cross(result.orbital_axis_sensor, ORBITAL_AXIS))
    assert np.degrees(sine) < 0.5


@needs_carm
def test_as_the_note_with_perpendicular_axes(carm):
    result = carm_kin.calibrate(carm, fix_non_orthogonality=True, systematic="none")
    assert np.linalg.norm(result.offset_sensor_pivot_m * 1e3 - OFFSET_MM) < 1
    assert result.major_radius_m == pytest.approx(0.015, abs=0.001)


@needs_carm
@pytest.mark.parametrize(
    "label, offset_mm, radius_mm, rms_mm", [("A", (-157.4, 9.2, 684.5), 13, 0.8), ("B", (-157.7, 9.8, 685.2), 17, 0.6)]
)
def test_each_placement_alone(label, offset_mm, radius_mm, rms_mm, carm):
    assert carm.placement is not None
    result = carm_kin.calibrate(carm.select(carm.placement == label))
    assert result.status in ("ok", "doubtful")
    assert np.linalg.norm(result.offset_sensor_pivot_m * 1e3 - offset_mm) < 3
    assert result.major_radius_m * 1e3 == pytest.approx(radius_mm, abs=4)
    assert result.residuals.translation_rms_m * 1e3 < rms_mm


@needs_carm
@pytest.mark.parametrize("solver", ["kinematic", "direct", "closed_form"])
def test_a_moved_base_that_is_not_told_is_a_misfit(solver, carm, tmp_path, capsys):
    moved = replace(carm, placement=None)
    result = carm_kin.calibrate(moved, solver)
    assert result.status == "refused"
    assert result.refusal is not None
    assert result.refusal.code == "misfit"
    assert "base" in result.refusal.message
    assert "moved" in result.refusal.message
    assert result.offset_sensor_pivot_m is None
    carm_kin.write_recording(moved, tmp_path / "moved.csv")
    assert run(capsys, "calibrate", tmp_path / "moved.csv", "--solver", solver).status == 3


@needs_pivot
def test_a_static_pivot():
    result = carm_kin.calibrate(carm_kin.read_recording(PIVOT), locus="point")
    assert result.status == "ok"
    # the published tip is that of least squares; its quarters scatter by 0.3 mm (their errors are correlated in
    # time, 0.92 from pose to pose), so that it is known to 0.14 mm: three of these
    problem = to_problem(carm_kin.read_recording(PIVOT))
    t, c = pivot.least_squares(problem, np.ones(len(problem), dtype=bool))
    assert np.linalg.norm(t * 1e3 - TIP_MM) < 0.05
    assert np.linalg.norm(c[0] * 1e3 - DIVOT_MM) < 0.05
    assert np.linalg.norm(result.offset_sensor_pivot_m * 1e3 - TIP_MM) < 0.42
    assert result.residuals.translation_rms_m * 1e3 == pytest.approx(0.295 * np.sqrt(3), rel=0.1)
    assert result.major_radius_m == 0
    assert result.orbital_axis_sensor is None


@needs_pivot
def test_a_static_pivot_is_no_c_arm():
    result = carm_kin.calibrate(carm_kin.read_recording(PIVOT))
    assert result.status == "refused"


@pytest.mark.skipif(not STATIONS.is_file(), reason="../shared/data/real-carm-raw is not here")
def test_a_placement_without_angular_motion_does_not_spoil_the_others():
    """Stations 27 to 35 turn about the orbital axis alone; every other set of the groups agrees within its ±."""
    raw = carm_kin.read_recording(STATIONS)
    group = np.full(len(raw), -1)
    for k, (first, last) in enumerate(((1, 17), (19, 26), (27, 35), (37, 56))):
        group[first - 1 : last] = k
    T = np.tile(np.eye(4), (len(raw), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = raw.R_world_sensor, raw.p_world_sensor
    for some in ((0, 1, 2, 3), (0, 2, 3), (1, 2, 3), (0, 1, 2)):
        here = np.isin(group, some)
        found = carm_kin.calibrate(Recording.from_poses(T[here], placement=group[here].astype(str)))
        assert found.status == "ok"
        message = next(note.message for note in found.warnings if note.code == "placement_left_out")
        assert message.startswith("placement '2' (9 poses) left out")
        assert found.poses == here.sum()
        assert len(found.placements) == len(some) - 1
        assert set(np.flatnonzero(group[here] == 2)) <= set(found.outliers.indices)
        off = found.offset_sensor_pivot_m - np.array([-0.157, 0.010, 0.686])
        assert (np.abs(off) < 2.5 * found.sigma.offset_sensor_pivot_m).all()
