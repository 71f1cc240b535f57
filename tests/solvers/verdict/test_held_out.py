"""Parts of a recording left out by downdating: against fits without them, noise of known size, and a C that sags."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

import carm_kin
from carm_kin.recording.recording import Recording
from helpers.command import run
from helpers.simulated import machine, problem, sweeps_deg
from solvers import kinematic
from solvers.effects.systematic import systematic
from solvers.kinematic import Options
from solvers.likelihood.covariance import active_unknowns
from solvers.verdict.held_out import blocks_of, left_out, student_95, sweeps_of

SIGMA_T, SIGMA_R = 3e-4, 1.4e-3
MOTION = sweeps_deg((-30, -15, 0, 15, 30), np.arange(0, 115, 2.5), (10, 50, 90), np.arange(-40, 40, 2.5))


DENSE = sweeps_deg((-30, -15, 0, 15, 30), np.arange(0, 115, 0.5), (10, 50, 90), np.arange(-40, 40, 0.5))


def noisy(seed: int, sag_m: float = 0.0, motion=MOTION):
    """Eight sweeps without labels; the sensor gives way by ``sag_m`` with both angles, in the C-arm's frame."""
    truth = machine(seed, 0.1, np.radians(0.4))
    data = problem(truth, motion, SIGMA_T, SIGMA_R, seed)
    alpha, beta = motion.angles.T
    waves = np.stack([np.cos(beta), np.sin(beta), np.sin(alpha), np.sin(alpha) * np.sin(beta)], axis=1)
    shape = (waves - waves.mean(axis=0)) @ np.random.default_rng([seed, 9]).normal(size=(4, 3))
    shape /= np.abs(shape).max()
    R_world_carm = data.R_world_sensor @ truth.T_sensor_carm[:3, :3]
    sag = np.einsum("nij,nj->ni", R_world_carm, sag_m * shape)
    unlabelled = np.full_like(data.label, np.nan)
    data = replace(data, p_world_sensor=data.p_world_sensor + sag, label=unlabelled)
    mixed = np.random.default_rng([seed, 11]).permutation(len(data))  # in time the sag would count as correlated noise
    return truth, data.select(mixed)


def moves_of(data):
    estimate = kinematic.solve(data, Options(reject_outliers=False))
    active = active_unknowns(data, estimate.torus.non_orthogonality == 0.0)
    sigma = estimate.sigma_t, estimate.sigma_r
    found = systematic(data, estimate.torus, estimate.angles.T, sigma, active, effects=())
    return estimate, left_out(found)


def offset_sigma(covariance):
    return np.sqrt(np.diag(covariance.block("offset")))


def test_a_move_is_that_of_the_fit_without_the_part():
    _, data = noisy(3)
    estimate, found = moves_of(data)
    given = replace(data, sigma_t=estimate.sigma_t, sigma_r=estimate.sigma_r)
    for move, poses in list(zip(found.moves, sweeps_of(data), strict=True))[::3]:
        rest = given.select(np.setdiff1d(np.arange(len(data)), poses))
        without = kinematic.solve(rest, Options(reject_outliers=False, fix_non_orthogonality=False))
        sigma = offset_sigma(without.covariance)
        assert np.all(np.abs(without.offset - estimate.offset - move[:3]) < 0.05 * sigma)  # first order of a small step


def test_noise_alone_does_not_disagree():
    """Of 30 recordings none is below a probability of 1e-3 by chance in 97% of choices of the seeds."""
    found = [moves_of(noisy(seed)[1])[1] for seed in range(30)]
    assert not any(one.disagree for one in found)
    assert np.mean([one.ratio for one in found]) == pytest.approx(1, abs=0.35)  # 3 sigma of 30 means of some 12 squares


def test_a_sag_disagrees_or_lasts():
    """Of 3 mm: it shows as parts that disagree, or as noise that lasts for a sweep, which widens the ± as well."""
    for seed in range(8):
        estimate, found = moves_of(noisy(seed, 3e-3, DENSE)[1])
        assert found.disagree or estimate.correlation.longest > 5
        widened = offset_sigma(found.widened(estimate.covariance))
        assert not found.disagree or np.any(widened > 1.5 * offset_sigma(estimate.covariance))


def test_a_part_that_the_rest_cannot_do_without_is_passed_over():
    motion = sweeps_deg((-30, 0, 30), np.arange(0, 115, 2.5), (50,), np.arange(-40, 40, 2.5))
    data = problem(machine(1, 0.1, 0.01), motion, SIGMA_T, SIGMA_R, 1)
    _, found = moves_of(data)
    assert 4 <= len(found.moves) <= len(blocks_of(data))
    assert np.all(np.abs(found.moves[:, :3]) < 5e-3)


def test_there_is_nothing_to_learn_without_noise():
    assert moves_of(problem(machine(1, 0.1, 0.01), MOTION))[1] is None


@pytest.mark.parametrize("degrees", [3, 4, 7, 11, 23, 1000])
def test_students_quantile(degrees):
    assert student_95(degrees) == pytest.approx(student.ppf(0.975, degrees), rel=0.01)


def test_a_doubtful_result_says_so(tmp_path, capsys):
    truth, data = noisy(0, 3e-3)
    sweep = np.array([str(k) for k in data.held.max(axis=1)])
    moving = np.where(data.held[:, 0] >= 0, "orbital", "angular")
    recording = Recording(data.p_world_sensor, data.R_world_sensor, sweep=sweep, moving=moving)
    result = carm_kin.calibrate(recording, systematic="none")
    assert (result.status, result.refusal) == ("doubtful", None)
    assert "parts_disagree" in {note.code for note in result.warnings}
    assert np.abs(result.offset_sensor_pivot_m - truth.T_sensor_carm[:3, 3]).max() < 3e-3
    result.to_json(tmp_path / "result.json")
    assert carm_kin.read_result(tmp_path / "result.json").to_json() == result.to_json()
    carm_kin.write_recording(recording, tmp_path / "rec.csv")
    ended = run(capsys, "calibrate", tmp_path / "rec.csv", "--systematic", "none")
    assert ended.status == 3
    assert ended.out.startswith("doubtful: ")
    assert ended.err.splitlines()[-1].startswith("doubtful: the parts of the recording disagree")
    ended = run(capsys, "batch", tmp_path / "rec.csv", "-o", tmp_path / "out", "--jobs", 1, "--systematic", "none")
    assert ended.status == 3
    assert [path.name for path in (tmp_path / "out" / "doubtful").iterdir()] == ["rec.json"]
