"""Stops of the C: found, averaged, and no more certain than the tracker is from stop to stop."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import carm_kin
from carm_kin.errors import InputError
from carm_kin.recording.formats import read_recording, write_recording
from carm_kin.recording.recording import Recording
from carm_kin.recording.stations import at_stations, refitted
from helpers import trackers
from helpers.command import fails, run
from solvers import kinematic
from solvers.likelihood.elimination import normal_equations
from solvers.likelihood.linearise import AngleModel
from solvers.problem import Problem
from solvers.se3 import exp_so3, rot_x, rot_y, transform

STOPS, FRAMES = 24, 40
MOUNT = transform(Rotation.from_euler("XYZ", [0.4, -0.3, 0.2]).as_matrix(), [0.13, 0.08, -0.7])
"""T_carm_sensor."""
OFFSET = -MOUNT[:3, :3].T @ MOUNT[:3, 3]
RADIUS = 0.1


def poses(alpha, beta):
    """(N, 4, 4) of the chain of the design, the torus at the origin of the world."""
    R, p = rot_x(alpha), RADIUS * np.column_stack([0 * alpha, -np.sin(alpha), np.cos(alpha)])
    return transform(R, p) @ transform(rot_y(beta), np.zeros(3)) @ MOUNT


def stop_and_go(rng, between=(3e-4, 1e-3), within=(2e-4, 8e-4), rho=0.8, stops=STOPS, frames=FRAMES):
    """Stops of as many frames with the motion between them; the noise of a stop, and that of its frames, of which
    neighbours correlate by rho. Also the number of the stop of each frame, -1 in motion."""
    angles = rng.uniform([-0.7, -0.8], [0.7, 0.8], (stops, 2))
    path, station, noise = [], [], []
    for k in range(stops):
        shift = rng.normal(size=6) * np.repeat(between, 3)
        path += [angles[k]] * frames
        station += [k] * frames
        noise += [shift] * frames
        if k + 1 < stops:
            path += list(np.linspace(angles[k], angles[k + 1], 30)[1:-1])
            station += [-1] * 28
            noise += [shift] * 28
    white = rng.normal(size=(len(path), 6)) * np.repeat(within, 3)
    fast = white.copy()
    for i in range(1, len(fast)):
        fast[i] = rho * fast[i - 1] + np.sqrt(1 - rho**2) * white[i]
    T, e = poses(*np.array(path).T), np.array(noise) + fast
    R = T[:, :3, :3] @ exp_so3(e[:, 3:])
    return Recording(T[:, :3, 3] + e[:, :3], R, 0.05 * np.arange(len(path))), np.array(station)


def test_the_stops_are_found_and_averaged():
    recording, station = stop_and_go(np.random.default_rng(0))
    found = at_stations(recording)
    assert len(found) == STOPS
    for k in range(STOPS):
        here = recording.select(station == k)
        assert np.linalg.norm(found.p_world_sensor[k] - here.p_world_sensor.mean(axis=0)) < 3e-4
        mean = Rotation.from_matrix(here.R_world_sensor).mean()
        assert (mean.inv() * Rotation.from_matrix(found.R_world_sensor[k])).magnitude() < 1e-3
        assert abs(found.time_s[k] - here.time_s.mean()) < 0.3
    assert (found.metadata["frames"].astype(int) > FRAMES / 2).all()


def test_no_frame_in_motion_is_averaged():
    recording, station = stop_and_go(np.random.default_rng(1), within=(1e-5, 1e-5), between=(0, 0))
    found = at_stations(recording)
    still = [recording.select(station == k) for k in range(STOPS)]
    off = [
        np.linalg.norm(p - part.p_world_sensor.mean(axis=0))
        for p, part in zip(found.p_world_sensor, still, strict=True)
    ]
    assert max(off) < 1e-4


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_the_variance_of_a_mean_heeds_the_correlation_of_the_frames(rho):
    """Against the spread of the means themselves over many stops without any other noise: with correlation rho the
    variance of a mean is (1 + rho) / (1 - rho) times that of independent frames. Within 30%: 600 stops know their own
    spread to 4%, and a correlation time that is cut off and taken against each stop's own mean is some 20% short."""
    recording, station = stop_and_go(np.random.default_rng(2), (0, 0), (2e-4, 8e-4), rho, stops=200, frames=120)
    truth, _ = stop_and_go(np.random.default_rng(2), (0, 0), (0, 0), rho, stops=200, frames=120)
    kept = station >= 0
    name = np.char.mod("%d", station[kept]).astype(object)
    whole, exact = (replace(r.select(kept), metadata={"file": name}) for r in (recording, truth))
    found, right = at_stations(whole), at_stations(exact)
    error = (found.p_world_sensor - right.p_world_sensor).ravel()
    turn = Rotation.from_matrix(np.swapaxes(right.R_world_sensor, 1, 2) @ found.R_world_sensor).as_rotvec().ravel()
    assert found.variance[:, 0].mean() == pytest.approx(np.mean(error**2), rel=0.3)
    assert found.variance[:, 1].mean() == pytest.approx(np.mean(turn**2), rel=0.3)


def test_stations_tell_how_sure_the_offset_is_where_frames_do_not():
    """80 runs: the mean square of the normalised errors is known to sqrt(2 / 240) = 0.09; 4 of these."""
    z, z_of_frames = [], []
    for seed in range(80):
        recording, station = stop_and_go(np.random.default_rng(seed))
        name = np.char.mod("%d", station[station >= 0]).astype(object)
        still = replace(recording.select(station >= 0), metadata={"file": name})
        result = carm_kin.calibrate(at_stations(still), reject_outliers=False, fix_non_orthogonality=True)
        z.append((result.offset_sensor_pivot_m - OFFSET) / result.sigma.offset_sensor_pivot_m)
        if seed < 5:
            naive = kinematic.solve(Problem.of_poses(still.p_world_sensor, still.R_world_sensor))
            z_of_frames.append((naive.offset - OFFSET) / naive.covariance.sigma("offset_sensor_pivot_x"))
    assert np.mean(np.square(z)) == pytest.approx(1, abs=4 * 0.09)
    # frames of a stop share its error, which shows as noise correlated over a stop and is heeded in part
    assert np.mean(np.square(z_of_frames)) > 1.5


def test_a_stop_of_few_frames_counts_less():
    """With no other noise, a pose of one frame has the weight of one frame and a mean of 100 that of 100."""
    rng = np.random.default_rng(3)
    T = poses(*rng.uniform(-0.7, 0.7, (2, 40)))
    count = np.where(np.arange(40) % 2, 100, 1)
    sigma = np.array([1e-3, 2e-3])[:, None] / np.sqrt(count)
    p = T[:, :3, 3] + sigma[0][:, None] * rng.normal(size=(40, 3))
    R = T[:, :3, :3] @ exp_so3(sigma[1][:, None] * rng.normal(size=(40, 3)))
    problem = Problem.of_poses(p, R)
    estimate = kinematic.solve(problem)
    scaled = refitted(problem, estimate, (sigma**2).T)
    assert np.allclose(scaled.scale[:, 0] / scaled.scale[:, 1], 10, rtol=0.5)
    assert np.allclose((scaled.scale**2).mean(axis=1), 1)
    alike, weighed = (
        carm_kin.calibrate(Recording(p, R, variance=v), reject_outliers=False) for v in (None, (sigma**2).T)
    )
    gain = alike.sigma.offset_sensor_pivot_m / weighed.sigma.offset_sensor_pivot_m
    assert (gain > 2).all()
    assert (np.abs(weighed.offset_sensor_pivot_m - OFFSET) < 4 * weighed.sigma.offset_sensor_pivot_m).all()


def test_the_scale_is_that_of_the_covariance_in_the_normal_equations():
    """A pose of scale 2 adds a quarter of its information: as if it stood there once and the others four times."""
    rng = np.random.default_rng(4)
    alpha, beta = rng.uniform(-0.7, 0.7, (2, 12))
    T = poses(alpha, beta)
    p, R = T[:, :3, 3] + 1e-3 * rng.normal(size=(12, 3)), T[:, :3, :3] @ exp_so3(1e-3 * rng.normal(size=(12, 3)))
    torus = kinematic.solve(Problem.of_poses(p, R)).torus
    scale = np.where(np.arange(12) < 5, 2.0, 1.0)
    one = replace(Problem.of_poses(p, R), scale=np.stack([scale, scale]))
    often = np.repeat(np.arange(12), np.where(np.arange(12) < 5, 1, 4))
    two = Problem.of_poses(p[often], R[often])
    angles = torus.angles(one).T
    first = normal_equations(torus, angles, one, AngleModel.of(one), (1e-3, 1e-3))
    second = normal_equations(torus, angles[:, often], two, AngleModel.of(two), (2e-3, 2e-3))
    assert np.allclose(first.H, second.H, rtol=1e-9, atol=1e-9 * np.abs(first.H).max())
    assert np.allclose(first.g, second.g, rtol=0, atol=1e-9 * np.abs(first.g).max())
    assert first.squares[0] == pytest.approx(second.squares[0] / 4)


def test_sweeps_and_labels_are_kept():
    recording, _ = stop_and_go(np.random.default_rng(5))
    sweep = np.where(np.arange(len(recording)) < len(recording) // 2, "a", "b")
    labelled = replace(
        recording,
        sweep=sweep,
        moving=["orbital"] * len(recording),
        joints={"angular": np.where(sweep == "a", 0.1, 0.2)},
    )
    found = at_stations(labelled)
    assert set(found.sweep) == {"a", "b"}
    assert [sweep.held for sweep in found.sweeps] == [{"angular": 0.1}, {"angular": 0.2}]
    assert STOPS <= len(found) <= STOPS + 1


def test_a_recording_without_stops_is_refused():
    alpha = np.linspace(-0.7, 0.7, 400)
    T = poses(alpha, 0.8 * np.sin(3 * alpha))
    with pytest.raises(InputError, match="stands still nowhere"):
        at_stations(Recording(T[:, :3, 3], T[:, :3, :3]))
    with pytest.raises(InputError, match="needs orientations"):
        at_stations(Recording(T[:, :3, 3]))


def test_files_in_which_the_c_moves_are_refused(tmp_path):
    header, *rows = trackers.ndi().content.decode().rstrip().split("\n")
    for i in range(3):
        (tmp_path / f"{i}.csv").write_text("\n".join([header, *rows[10 * i : 10 * i + 10], ""]))
    with pytest.raises(InputError, match=r"moves by .* mm in '0\.csv'; each file must be one stop"):
        at_stations(read_recording(tmp_path))


def test_the_command_averages_and_counts(tmp_path, capsys):
    recording, _ = stop_and_go(np.random.default_rng(6))
    write_recording(recording, tmp_path / "rec.igs.mha")
    ended = run(capsys, "calibrate", tmp_path / "rec.igs.mha", "--stations")
    assert ended.status == 0
    assert f"{STOPS} of {STOPS} poses" in ended.out
    assert "not in a stop of the C" in ended.out
    assert ["stations", str(STOPS)] in [line.split() for line in ended.out.splitlines()]
    ended = run(capsys, "convert", tmp_path / "rec.igs.mha", "-o", tmp_path / "rec.csv", "--stations")
    again, whole = read_recording(tmp_path / "rec.csv"), at_stations(read_recording(tmp_path / "rec.igs.mha"))
    assert np.allclose(again.variance, whole.variance, rtol=1e-12)
    assert "stations" in fails(capsys, "convert", tmp_path / "rec.csv", "-o", tmp_path / "x.csv", "--stations")
    (tmp_path / "s.toml").write_text('stations = true\n[[sweep]]\nfile = "rec.igs.mha"\n')
    assert len(read_recording(tmp_path / "s.toml")) == STOPS
