"""Comparing solvers: the same poses for all, errors against an independent truth, studies, the command."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import carm_kin
from carm_kin.batches.local_workers import LocalWorkers
from carm_kin.calibration.settings import Settings
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.study.compare import Comparison, agreement, compare
from carm_kin.study.compare_view import apart_from
from carm_kin.study.monte_carlo import Simulation, study
from helpers.command import fails, run
from helpers.here import Here

SIGMA_T_M, SIGMA_R_RAD = 1e-3, float(np.radians(0.1))


@pytest.fixture(scope="module")
def simulated():
    """A recording with 3% outliers, and its truth."""
    recording, truth = carm_kin.simulate(
        "mobile_nonisocentric", "clinical", sigma_t_m=SIGMA_T_M, sigma_r_rad=SIGMA_R_RAD, outliers=0.03, seed=4
    )
    return recording, truth


@pytest.fixture(scope="module")
def thinned(simulated) -> Recording:
    recording = simulated[0]
    return recording.select(agreement(recording)).select(slice(None, None, 4))


@pytest.fixture(scope="module")
def compared(simulated, thinned) -> Comparison:
    return compare(thinned, truth=simulated[1], folds=2)


@pytest.fixture
def rec(thinned, simulated, tmp_path) -> Path:
    carm_kin.write_recording(thinned, tmp_path / "rec.csv")
    simulated[1].to_json(tmp_path / "rec.truth.json")
    return tmp_path / "rec.csv"


def test_what_disagrees_is_left_out_before_any_solver_sees_it(simulated):
    recording, truth = simulated
    kept = recording.pose_number[agreement(recording)]
    assert not set(kept) & set(truth.outliers.indices)
    wrongly = len(recording) - len(truth.outliers.indices) - len(kept)
    assert wrongly < 0.005 * len(recording)  # 6 sigma is never reached by noise; the limit is 4.5 or more


def test_every_solver_gets_the_same_poses_and_comes_near_the_truth(compared, simulated, thinned):
    assert [run.solver for run in compared.runs] == ["closed_form", "decomposed", "direct", "kinematic", "surface"]
    assert {run.result.poses for run in compared.runs} == {len(thinned)} == {compared.poses}
    truth = simulated[1].offset_sensor_pivot_m
    for run_ in compared.runs:
        if run_.solver == "surface":
            assert run_.held_out is None
            assert "holds no complete chain" in run_.errors_reason
            continue
        error = np.linalg.norm(run_.result.offset_sensor_pivot_m - truth)
        (difference,) = [
            d for d in compared.differences if (d.first, d.second, d.quantity) == (run_.solver, "truth", "offset")
        ]
        assert difference.difference_m == pytest.approx(error, rel=1e-12)
        assert error < 1e-3  # the bound is some 0.15 mm an axis; one millimetre is beyond any of these solvers
        held = run_.held_out
        assert held.translation_rms_m == pytest.approx(np.sqrt(3) * SIGMA_T_M, rel=0.25)
        assert held.refusal is None
        assert (run_.fitted.poses, held.poses) == (len(thinned), len(thinned)), run_.solver
        assert run_.fitted.translation_rms_m < held.translation_rms_m
        assert run_.time_s > 0


def test_errors_of_outliers_do_not_count_where_all_poses_are_given(simulated):
    """Every solver is scored on the same poses, whatever it rejects itself."""
    recording = simulated[0]
    together = agreement(recording)
    found = compare(recording, ["decomposed", "kinematic"], counted=together, folds=2)
    assert (found.poses, found.counted) == (len(recording), together.sum())
    for run_ in found.runs:
        assert run_.fitted.poses == run_.held_out.poses == together.sum()
        assert run_.held_out.translation_rms_m < 2.5e-3  # outliers are 50 mm off and more
    everything = compare(recording, ["kinematic"], folds=None).runs[0]
    assert everything.fitted.translation_rms_m > 10e-3


def test_fitted_errors_are_the_residuals_of_a_solver_that_rejects_nothing(compared):
    kinematic = next(run for run in compared.runs if run.solver == "kinematic")
    assert kinematic.result.used == compared.counted
    assert kinematic.fitted.translation_rms_m == pytest.approx(kinematic.result.residuals.translation_rms_m, rel=1e-3)
    assert kinematic.fitted.rotation_rms_rad == pytest.approx(kinematic.result.residuals.rotation_rms_rad, rel=1e-3)


def test_all_share_one_gauge(compared):
    """With the published energy the offsets would be apart along the orbital axis by far more than their sigmas."""
    offset = {run.solver: run.result.offset_sensor_pivot_m for run in compared.runs if run.solver != "surface"}
    sigma = next(run.result.sigma.offset_sensor_pivot_m for run in compared.runs if run.solver == "kinematic")
    for name, value in offset.items():
        assert np.linalg.norm(value - offset["kinematic"]) < 4 * np.linalg.norm(sigma), name


def test_every_two_solvers_are_compared_once(compared):
    pairs = [(d.first, d.second) for d in compared.differences if d.quantity == "major radius"]
    names = [run.solver for run in compared.runs]
    expected = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]] + [(name, "truth") for name in names]
    assert pairs == expected


@pytest.mark.parametrize("solver", ["direct", "surface"])
def test_a_solver_is_shown_in_its_own_sigmas_and_in_those_of_the_reference(solver, compared):
    """``direct`` stands before ``kinematic`` and ``surface`` behind it."""
    results = {run.solver: run.result for run in compared.runs}
    shown = apart_from(compared, "kinematic")[solver]["major radius"]
    apart = abs(results[solver].major_radius_m - results["kinematic"].major_radius_m)
    assert shown.own == pytest.approx(apart / results[solver].sigma.major_radius_m)
    assert shown.other == pytest.approx(apart / results["kinematic"].sigma.major_radius_m)


def test_a_solver_that_the_recording_does_not_allow_says_why(thinned):
    bare = replace(thinned, sweep=None, moving=None, joints={})
    (one,) = compare(bare, ["decomposed"], folds=None).runs
    assert one.result is None
    assert one.reason.code == "not_possible"
    assert "sweep" in one.reason.message
    positions = replace(thinned, R_world_sensor=None)
    runs = compare(positions, folds=None).runs
    assert [run.solver for run in runs if run.result] == ["surface"]
    assert agreement(positions).all()


def test_a_refusal_keeps_its_code(thinned):
    orbital = thinned.select(thinned.sweep == thinned.sweeps[0].label)
    (one,) = compare(orbital, ["kinematic"], folds=None).runs
    assert (one.result, one.reason.code) == (None, "one_axis_only")


def test_the_chain_of_a_urdf_is_one_more_solver(thinned):
    settings = Settings(urdf="mobile_nonisocentric", labels_exact=True)  # as the chain takes them
    runs = compare(thinned, ["kinematic", "chain"], settings=settings, folds=None).runs
    assert [run.solver for run in runs] == ["kinematic", "chain"]
    both = [run.result.offset_sensor_pivot_m for run in runs]
    np.testing.assert_allclose(*both, atol=2e-5)


def test_unknown_solvers_are_refused_before_the_work(thinned):
    with pytest.raises(InputError, match="solver 'bogus' is unknown"):
        compare(thinned, ["kinematic", "bogus"])


def test_the_command_writes_table_json_csv_and_figure(rec, tmp_path, capsys):
    arguments = ["--json", "-", "--csv", tmp_path / "c.csv", "--figure", tmp_path / "c.svg", "--folds", 2]
    ended = run(capsys, "compare", rec, *arguments)
    assert ended.status == 0, ended.err
    data = json.loads(ended.out)
    assert data["schema"] == "carm-kin/comparison/1"
    with (tmp_path / "c.csv").open(newline="") as file:
        rows = {row["solver"]: row for row in csv.DictReader(file)}
    truth = json.loads((tmp_path / "rec.truth.json").read_text())
    for one in data["runs"]:
        name = one["solver"]
        assert name in ended.err
        if name == "surface":
            assert rows[name]["offset_x_mm"] == ""
            continue
        offset = one["result"]["offset_sensor_pivot_mm"]
        assert [float(rows[name][f"offset_{axis}_mm"]) for axis in "xyz"] == offset
        error = np.linalg.norm(np.subtract(offset, truth["offset_sensor_pivot_mm"]))
        assert float(rows[name]["error_offset_mm"]) == pytest.approx(error, rel=1e-9)
        assert f"{error:.4f}" in ended.err
        assert f"{one['held_out']['translation_rms_mm']:.4f}" in ended.err
    assert {f"written: {tmp_path / name}" for name in ("c.csv", "c.svg")} <= set(ended.err.splitlines())
    figure = (tmp_path / "c.svg").read_text()
    assert figure.startswith("<?xml")
    assert all(name in figure for name in ("kinematic", "decomposed", "offset less that of the truth"))


def test_without_a_truth_nothing_is_called_an_error(rec, capsys):
    rec.with_suffix(".truth.json").unlink()
    ended = run(capsys, "compare", rec, "--solvers", "closed_form,direct", "--folds", 0)
    assert ended.status == 0
    assert "Difference to closed_form" in ended.out
    assert "Error" not in ended.out + ended.err


def test_all_poses_are_given_where_that_is_asked_for(simulated, tmp_path, capsys):
    recording, truth = simulated
    carm_kin.write_recording(recording, tmp_path / "whole.csv")
    arguments = ("compare", tmp_path / "whole.csv", "--solvers", "kinematic", "--folds", 0)
    everything, together = (run(capsys, *arguments, *more).out for more in (["--all-poses"], []))
    left_out = int(together.split("; ")[1].split()[0])
    assert len(truth.outliers.indices) <= left_out <= len(truth.outliers.indices) + 7
    assert f"{len(recording)} poses, the same for every solver; 0 left out that disagree" in everything
    assert f"errors are of the {len(recording) - left_out} poses that agree" in everything


def test_a_recording_that_no_solver_can_use_ends_with_status_3(thinned, tmp_path, capsys):
    orbital = thinned.select(thinned.sweep == thinned.sweeps[0].label)
    carm_kin.write_recording(orbital, tmp_path / "orbital.csv")
    ended = run(capsys, "compare", tmp_path / "orbital.csv", "--solvers", "kinematic,decomposed")
    assert ended.status == 3
    assert "kinematic: no angular motion" in ended.out
    assert ended.err.splitlines()[-1] == "refused (no_result): no solver has a result"


@pytest.mark.parametrize(
    "arguments, expected",
    {
        (): "a recording is missing, or --repeat",
        ("none.csv",): "none.csv: no such file",
        ("rec.csv", "--repeat", "5"): "leave out the recording",
        ("--repeat", "5"): "--repeat needs --urdf",
        ("--repeat", "1", "--urdf", "mobile_skewed"): "at least 2 recordings",
        ("--repeat", "5", "--urdf", "bogus"): "no such file; bundled machines",
        ("--repeat", "5", "--urdf", "mobile_skewed", "--protocol", "bogus"): "protocol 'bogus' is unknown",
        ("--repeat", "5", "--urdf", "mobile_skewed", "--solvers", "bogus"): "solver 'bogus' is unknown",
        ("rec.csv", "--seed", "3"): "--repeat is missing",
        ("rec.csv", "--solvers", "direct,bogus"): "solver 'bogus' is unknown",
        ("rec.csv", "--solvers", "chain"): "the solver 'chain' needs a urdf",
        ("rec.csv", "--angular", "bogus"): "bogus",
        ("rec.csv", "--truth", "none.json"): "none.json: no such file",
        ("rec.csv", "--figure", "x.gif"): "the extension of a figure is one of svg, png, pdf",
        ("rec.csv", "--figure", "none/x.svg"): "the folder none does not exist",
        ("rec.csv", "--csv", "none/x.csv"): "the folder none does not exist",
        ("rec.csv", "--json", "none/x.json"): "the folder none does not exist",
    }.items(),
)
def test_bad_usage_is_one_line(arguments, expected, rec, monkeypatch, capsys):
    monkeypatch.chdir(rec.parent)
    assert expected in fails(capsys, "compare", *arguments)


def test_a_missing_matplotlib_says_how_to_get_it(rec, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    problem = fails(capsys, "compare", rec, "--figure", rec.with_suffix(".svg"))
    assert "pip install 'carm-kin[figures]'" in problem


def test_a_study_measures_errors_that_can_be_made_again_by_hand():
    simulation = Simulation("mobile_nonisocentric", "minimal", SIGMA_T_M, SIGMA_R_RAD)
    told = []
    found = study(simulation, ["kinematic", "decomposed"], 8, Here(), seed=5, told=told.append)
    assert found.seeds == tuple(range(5, 13))
    assert sorted(told) == sorted(f"seed {seed}" for seed in found.seeds)
    squares, inside = [], []
    for seed, error in zip(found.seeds, found.offset_errors_m[0], strict=True):
        recording, truth = carm_kin.simulate(
            "mobile_nonisocentric", "minimal", sigma_t_m=SIGMA_T_M, sigma_r_rad=SIGMA_R_RAD, seed=seed
        )
        result = carm_kin.calibrate(recording, "kinematic")
        by_hand = result.offset_sensor_pivot_m - truth.offset_sensor_pivot_m
        assert error == pytest.approx(np.linalg.norm(by_hand), rel=1e-9)
        squares.append(error**2)
        weight = np.linalg.inv(result.covariance.block("offset_sensor_pivot"))
        inside.append(by_hand @ weight @ by_hand <= chi2.ppf(0.95, 3))
    first = found.solvers[0]
    assert first.coverage == np.mean(inside)
    assert first.offset_rms_m == pytest.approx(np.sqrt(np.mean(squares)))
    low, high = first.offset_rms_95_m
    assert min(squares) ** 0.5 <= low <= first.offset_rms_m <= high <= max(squares) ** 0.5
    (pair,) = found.pairs
    assert (pair.first, pair.second, pair.runs) == ("kinematic", "decomposed", 8)
    assert pair.offset_ratio == pytest.approx(first.offset_rms_m / found.solvers[1].offset_rms_m)
    nearer = np.mean(np.array(found.offset_errors_m[0]) < np.array(found.offset_errors_m[1]))
    assert pair.first_nearer == nearer


def test_the_numbers_of_a_study_do_not_depend_on_the_workers():
    simulation = Simulation("mobile_nonisocentric", "minimal", SIGMA_T_M, SIGMA_R_RAD)
    here = study(simulation, ["closed_form"], 4, Here())
    there = study(simulation, ["closed_form"], 4, LocalWorkers(2))
    assert here.offset_errors_m == there.offset_errors_m


def test_runs_without_a_result_are_counted_and_explained():
    simulation = Simulation("mobile_nonisocentric", "free", SIGMA_T_M, SIGMA_R_RAD)
    found = study(simulation, ["closed_form", "decomposed"], 2, Here())
    good, none = found.solvers
    assert (good.refused, good.first_reason) == (0, None)
    assert none.refused == none.runs == 2
    assert "sweep" in none.first_reason
    assert none.offset_rms_m is none.offset_rms_95_m is none.coverage is None
    assert found.pairs[0].runs == 0
    assert found.to_dict()["offset_errors_mm"][1] == [None, None]


def test_the_command_makes_a_study(tmp_path, capsys):
    arguments = ["--repeat", 3, "--urdf", "mobile_nonisocentric", "--protocol", "minimal", "--sigma-t-mm", 1]
    places = ["--json", tmp_path / "s.json", "--csv", tmp_path / "s.csv", "--figure", tmp_path / "s.svg"]
    ended = run(capsys, "compare", *arguments, *places)
    assert ended.status == 0, ended.err
    data = json.loads((tmp_path / "s.json").read_text())
    assert [one["solver"] for one in data["solvers"]] == ["direct", "decomposed"]
    with (tmp_path / "s.csv").open(newline="") as file:
        rows = {(row["solver"], row["number"]): row for row in csv.DictReader(file)}
    for one in data["solvers"]:
        row = rows[one["solver"], "offset RMS, mm"]
        assert float(row["value"]) == one["offset_rms_mm"]
        assert [float(row["low_95"]), float(row["high_95"])] == one["offset_rms_95_mm"]
        assert f"{one['offset_rms_mm']:.3g} [" in ended.out
    assert "direct / decomposed" in ended.out
    assert {f"written: {place}" for place in places[1::2]} <= set(ended.err.splitlines())
    assert (tmp_path / "s.svg").read_text().startswith("<?xml")


@pytest.mark.study
def test_coverage_of_a_study():
    """`pytest -m study tests/study`. 300 runs at 0.95 spread by 0.0126 (one sigma): 3 sigmas either side."""
    simulation = Simulation("mobile_nonisocentric", "minimal", SIGMA_T_M, SIGMA_R_RAD)
    (found,) = study(simulation, ["kinematic"], 300, LocalWorkers(2)).solvers
    assert 0.912 < found.coverage < 0.988
    assert found.coverage_95[0] < 0.95 < found.coverage_95[1]
