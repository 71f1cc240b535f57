"""What the simulator does besides sag: play, creep, distortion, smoothing, noise that lasts, rounded labels."""

import json

import numpy as np
import pytest

import carm_kin
from carm_kin.errors import InputError
from carm_kin.simulation.effects import PAUSE_S, RATE_HZ, crept, lagging, smoothed
from carm_kin.simulation.field import Field, distorted
from carm_kin.simulation.noise import Noise, disturbed
from carm_kin.simulation.simulate import simulate
from solvers.se3 import Array, exp_so3, log_so3, transform

MACHINE = "mobile_nonisocentric"
EVERYTHING = {
    "sigma_t_m": 2e-4,
    "sigma_r_rad": 1e-3,
    "anisotropy": 3.0,
    "correlation": 0.9,
    "label_resolution_rad": np.radians(1.0),
    "sag_m": 1e-3,
    "field_m": 2e-4,
    "creep_m": 2e-4,
    "backlash_rad": 1e-3,
    "smoothing_s": 0.05,
    "rate_hz": 20.0,
}


def along(p: Array, R: Array | None = None) -> Array:
    return transform(np.broadcast_to(np.eye(3), (len(p), 3, 3)) if R is None else R, p)


def test_play_by_hand():
    driven = np.array([[0.0, 1.0, 2.0, 1.5, 0.5, -1.0, -0.9]]).T
    np.testing.assert_allclose(lagging(driven, 1.0)[:, 0], [0, 0.5, 1.5, 1.5, 1.0, -0.5, -0.5])


def test_a_reversal_takes_up_the_play(tmp_path):
    """There and back over the same labels, the C stands off by the play about the orbital axis."""
    file = tmp_path / "reversed.toml"
    sweep = '[[sweep]]\nmoving = "orbital"\nfrom_deg = {}\nto_deg = {}\n'
    file.write_text(sweep.format(-30, 30) + sweep.format(30, -30))
    play = np.radians(0.2)
    recording, truth = simulate(MACHINE, file, backlash_rad=play)
    there, back = recording.R_world_sensor[20:61], recording.R_world_sensor[61:][::-1][20:61]
    turn = log_so3(np.swapaxes(there, 1, 2) @ back)[1:-1]
    np.testing.assert_allclose(turn, np.tile(play * truth.orbital_axis_sensor, (len(turn), 1)), atol=1e-12)


def test_a_base_creeps_by_what_was_asked_for_in_every_placement():
    placement = np.repeat([0, 1, 0], [50, 80, 50])
    moved = crept(along(np.zeros((180, 3))), placement, 3e-4, np.random.default_rng(0))[:, :3, 3]
    directions = []
    for number in (0, 1):
        way = moved[placement == number]
        whole = way[-1] - way[0]
        assert np.linalg.norm(whole) == pytest.approx(3e-4)
        np.testing.assert_allclose(way.mean(axis=0), 0, atol=1e-18)
        along_it = (way - way[0]) @ whole / 3e-4**2
        assert (np.diff(along_it) > 0).all()
        assert along_it[len(way) // 4] > 0.4
        directions.append(whole)
    assert abs(directions[0] @ directions[1]) < 0.99 * 3e-4**2


def test_the_distortion_has_the_size_that_was_asked_for():
    clean, _ = simulate(MACHINE, seed=4)
    seen, _ = simulate(MACHINE, field_m=5e-4, seed=4)
    shift = seen.p_world_sensor - clean.p_world_sensor
    assert np.sqrt((shift**2).sum(axis=1).mean()) == pytest.approx(5e-4)
    np.testing.assert_allclose(shift.mean(axis=0), 0, atol=1e-15)
    turn = log_so3(seen.R_world_sensor @ np.swapaxes(clean.R_world_sensor, 1, 2))
    assert 1e-5 < np.sqrt((turn**2).sum(axis=1).mean()) < 5e-3


def test_a_body_turns_by_half_the_curl():
    field, p, h = Field.random(np.random.default_rng(2)), np.random.default_rng(3).uniform(-1, 1, (20, 3)), 1e-5
    slope = [(field.shift(p + h * e) - field.shift(p - h * e)) / (2 * h) for e in np.eye(3)]
    curl = np.stack([slope[a][:, b] - slope[b][:, a] for a, b in ((1, 2), (2, 0), (0, 1))], axis=1)
    np.testing.assert_allclose(field.turn(p), 0.5 * curl, atol=1e-8)
    assert np.abs(curl).max() > 1


def test_the_distortion_is_smooth():
    """Poses a millimetre apart differ by less than 1% of it: the shortest wave is a metre."""
    p = np.linspace(0, 1, 1001)[:, None] * np.array([0.6, 0.0, 0.8])
    shift = distorted(along(p), 1e-3, np.random.default_rng(1))[:, :3, 3] - p
    assert np.abs(np.diff(shift, axis=0)).max() < 5e-5


def test_a_sensor_that_stands_shows_no_distortion():
    with pytest.raises(InputError, match="field_m: the sensor does not move"):
        distorted(along(np.ones((5, 3))), 1e-3, np.random.default_rng(1))


def test_a_low_pass_lags_a_steady_motion_by_its_time_constant():
    tau, rate, speed, w = 0.15, 60.0, np.array([0.1, -0.2, 0.05]), 0.5
    t = np.arange(600) / rate
    axis = np.array([0.6, 0.0, 0.8])
    T = along(t[:, None] * speed, exp_so3(w * t[:, None] * axis))
    seen = smoothed(T, np.zeros(600, dtype=int), t, tau)
    np.testing.assert_allclose((T - seen)[300:, :3, 3], np.tile(tau * speed, (300, 1)), atol=1e-9)
    behind = log_so3(np.swapaxes(seen[300:, :3, :3], 1, 2) @ T[300:, :3, :3])
    np.testing.assert_allclose(behind, np.tile(np.arctan(w * tau) * axis, (300, 1)), atol=1e-6)
    np.testing.assert_allclose((T - seen)[30, :3, 3], tau * (1 - np.exp(-t[30] / tau)) * speed, atol=1e-12)


def test_a_low_pass_shrinks_a_circle():
    """By 1 / sqrt(1 + (w tau)^2): what smoothing takes from the radius of an orbit."""
    tau, w, t = 0.3, 1.0, np.arange(4000) / 100
    p = 0.7 * np.stack([np.cos(w * t), np.sin(w * t), np.zeros_like(t)], axis=1)
    seen = smoothed(along(p), np.zeros(len(t), dtype=int), t, tau)[2000:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 0.7 / np.sqrt(1 + (w * tau) ** 2), rtol=1e-5)


def test_a_low_pass_is_at_rest_when_a_motion_begins():
    part, t = np.repeat([0, 1], 50), np.arange(100) / 10.0
    p = np.stack([t, t, t], axis=1) + 5.0 * part[:, None]
    seen = smoothed(along(p), part, t, 0.2)[:, :3, 3]
    np.testing.assert_array_equal(seen[[0, 50]], p[[0, 50]])
    np.testing.assert_allclose(seen[51:] - p[51:], seen[1:50] - p[1:50], atol=1e-12)


def test_stops_are_not_smoothed(tmp_path):
    file = tmp_path / "stops.toml"
    file.write_text('[[sweep]]\nmoving = "orbital"\nfrom_deg = -30\nto_deg = 30\nstep_deg = 15\n')
    with pytest.raises(InputError, match=r"turns by 150 deg/s from a pose to the next, more than 120"):
        simulate(MACHINE, file, smoothing_s=0.1)
    assert len(simulate(MACHINE, file, smoothing_s=0.1, rate_hz=1.0)[0]) == 5


def test_poses_have_times_where_there_is_a_rate():
    assert simulate(MACHINE, "minimal")[0].time_s is None
    assert np.diff(simulate(MACHINE, "free", smoothing_s=0.1)[0].time_s) == pytest.approx(1 / RATE_HZ)
    time_s = simulate(MACHINE, "minimal", rate_hz=20.0)[0].time_s.reshape(4, 360)
    assert np.diff(time_s, axis=1) == pytest.approx(1 / 20)
    assert time_s[1:, 0] - time_s[:-1, -1] == pytest.approx(PAUSE_S + 1 / 20)


def test_noise_that_lasts_keeps_its_size():
    """Lag k correlates as phi^k; bounds of 4.5 standard errors, Bartlett's."""
    phi, n, sigma = 0.9, 20_000, 2e-3
    p, R, _ = disturbed(along(np.zeros((n, 3))), Noise(sigma, sigma, correlation=phi), np.random.default_rng(6))
    spread = np.sqrt((1 + phi**2) / (1 - phi**2) / n)
    for error in (p, log_so3(R)):
        assert np.abs((error**2).mean(axis=0) / sigma**2 - 1).max() < 4.5 * np.sqrt(2) * spread
        for lag in (1, 3):
            found = (error[lag:] * error[:-lag]).mean(axis=0) / (error**2).mean(axis=0)
            assert np.abs(found - phi**lag).max() < 4.5 * spread
    assert np.abs(np.corrcoef(np.hstack([p, log_so3(R)]).T) - np.eye(6)).max() < 4.5 * spread


def test_noise_begins_anew_with_every_motion():
    n = 20_000
    p, _, _ = disturbed(
        along(np.zeros((n, 3))), Noise(1e-3, correlation=0.9), np.random.default_rng(6), np.arange(n) // 2
    )
    within, between = (np.corrcoef(p[k::2, 0][: n // 2 - 1], p[k + 1 :: 2, 0][: n // 2 - 1])[0, 1] for k in (0, 1))
    assert within == pytest.approx(0.9, abs=4.5 / np.sqrt(n / 2))
    assert abs(between) < 4.5 / np.sqrt(n / 2)
    assert p.std(axis=0) == pytest.approx(1e-3, rel=4.5 / np.sqrt(n / 2))


def test_labels_are_rounded_and_poses_are_not():
    exact, _ = simulate("mobile_skewed", "joints", seed=3)
    read, _ = simulate("mobile_skewed", "joints", label_resolution_rad=np.radians(0.5), seed=3)
    np.testing.assert_array_equal(read.p_world_sensor, exact.p_world_sensor)
    for name, values in read.joints.items():
        steps = np.degrees(values) / 0.5
        if name in exact.prismatic:
            np.testing.assert_array_equal(values, exact.joints[name])
        else:
            np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
            assert 0.2 < np.abs(np.degrees(values - exact.joints[name])).max() <= 0.25 + 1e-9
            assert read.label_step(name) == pytest.approx(np.radians(0.1))


def test_sizes_of_zero_change_no_byte(tmp_path):
    none = dict.fromkeys(EVERYTHING, 0.0) | {"anisotropy": 1.0, "rate_hz": None, "sigma_t_m": 1e-3}
    for name, sizes in (("plain", {"sigma_t_m": 1e-3}), ("zero", none)):
        recording, _ = simulate(MACHINE, "minimal", **sizes, outliers=0.02, missing=0.1, seed=3)
        carm_kin.write_recording(recording, tmp_path / f"{name}.csv")
    assert (tmp_path / "plain.csv").read_bytes() == (tmp_path / "zero.csv").read_bytes()


def test_effects_do_not_change_the_noise():
    own = {"sag_m": 1e-3, "creep_m": 1e-3, "field_m": 1e-3}
    quiet, _ = simulate(MACHINE, **own)
    noisy, _ = simulate(MACHINE, **own, sigma_t_m=1e-3)
    clean, _ = simulate(MACHINE)
    noise, _ = simulate(MACHINE, sigma_t_m=1e-3)
    expected = noise.p_world_sensor - clean.p_world_sensor
    np.testing.assert_allclose(noisy.p_world_sensor - quiet.p_world_sensor, expected, atol=1e-14)


def test_everything_at_once_is_made_again_from_what_its_truth_says(tmp_path):
    recording, truth = simulate(MACHINE, "clinical", **EVERYTHING, outliers=0.01, missing=0.05, seed=9)
    truth.to_json(tmp_path / "truth.json")
    saved = carm_kin.read_result(tmp_path / "truth.json")
    assert json.loads((tmp_path / "truth.json").read_text())["options"]["sag_mm"] == pytest.approx(1.0)
    again, _ = simulate(MACHINE, **saved.options, seed=saved.provenance.seed)
    np.testing.assert_allclose(again.p_world_sensor, recording.p_world_sensor, atol=1e-12)
    np.testing.assert_allclose(again.time_s, recording.time_s)
    for copy in ("a", "b"):
        carm_kin.write_recording(simulate(MACHINE, **EVERYTHING, seed=9)[0], tmp_path / f"{copy}.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert (tmp_path / "a.csv").read_text().startswith("x_m")
