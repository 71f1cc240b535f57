"""Solvers against each other and the truth over many simulated recordings, with 95% confidence intervals."""

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from itertools import combinations
from typing import NamedTuple

import numpy as np

from carm_kin.batches.pool import Job, Outcome, Workers, run
from carm_kin.calibration.by_settings import calibrate_as
from carm_kin.calibration.settings import Settings
from carm_kin.errors import CarmKinError, InputError
from carm_kin.results.differences import ANGULAR_AXIS, OFFSET, ORBITAL_AXIS, Difference, differences
from carm_kin.results.provenance import provenance_of
from carm_kin.results.result import CalibrationResult
from carm_kin.study.intervals import estimated, mean, median, ratio_of_rms, rms, share
from carm_kin.study.monte_carlo_result import PairStudy, Simulation, SolverStudy, Study

CHI2_95_OF_3 = 7.814727903251179
"""The 95% quantile of chi squared with three degrees of freedom."""


class Errors(NamedTuple):
    """One calibration against its truth. m, rad and s."""

    offset: float
    major_radius: float
    """Estimate less truth."""
    orbital_axis: float
    angular_axis: float
    inside: float
    """1 where the 95% ellipsoid of the offset holds the truth, 0 where not, NaN where there is none."""
    seconds: float


def study(
    simulation: Simulation,
    names: Sequence[str],
    repeat: int,
    workers: Workers,
    *,
    seed: int = 0,
    command: str | None = None,
    told: Callable[[str], None] = lambda label: None,
) -> Study:
    """Simulate ``repeat`` recordings, seeds from ``seed`` on, and calibrate each with every solver of ``names``.

    Every solver has its default options and all poses. The numbers do not depend on the workers; times do.
    ``told`` hears of each recording as it is done. Raises InputError for what cannot be simulated or calibrated.
    """
    if repeat < 2:
        raise InputError(f"a study needs at least 2 recordings, not {repeat}")
    chosen = tuple(dict.fromkeys(names))
    for name in chosen:
        Settings(solver=name, urdf=simulation.urdf).check()
    seeds = tuple(range(seed, seed + repeat))
    found: dict[str, list[Errors | str]] = {}
    jobs = [Job(str(number), errors_of, (simulation, chosen, number)) for number in seeds]
    with closing(run(jobs, workers)) as outcomes:
        for outcome in outcomes:
            found[outcome.job.name] = _value(outcome, len(chosen))
            told(f"seed {outcome.job.name}")
    table = [[found[str(number)][k] for number in seeds] for k in range(len(chosen))]
    offsets = [[one.offset if isinstance(one, Errors) else np.nan for one in row] for row in table]
    return Study(
        simulation,
        seeds,
        tuple(_of_solver(name, row) for name, row in zip(chosen, table, strict=True)),
        tuple(_of_pair(chosen[i], chosen[j], offsets[i], offsets[j]) for i, j in combinations(range(len(chosen)), 2)),
        tuple(tuple(row) for row in offsets),
        provenance_of(None, command, seed),
    )


def _of_solver(name: str, runs: Sequence[Errors | str]) -> SolverStudy:
    good = np.array([run for run in runs if isinstance(run, Errors)]).reshape(-1, len(Errors._fields))
    offset, major_radius, orbital_axis, angular_axis, inside, seconds = good.T
    reasons = [run for run in runs if isinstance(run, str)]
    return SolverStudy(
        name,
        len(runs),
        len(reasons),
        reasons[0] if reasons else None,
        *estimated(offset, rms),
        *estimated(major_radius, mean),
        *estimated(major_radius, rms),
        *estimated(orbital_axis, rms),
        *estimated(angular_axis, rms),
        *share(inside),
        *estimated(seconds, median),
    )


def _of_pair(first: str, second: str, one: Sequence[float], other: Sequence[float]) -> PairStudy:
    both = np.array([one, other])
    both = both[:, np.isfinite(both).all(axis=0)]
    return PairStudy(
        first, second, both.shape[1], *estimated(both, ratio_of_rms), *share((both[0] < both[1]).astype(float))
    )


def errors_of(simulation: Simulation, names: Sequence[str], seed: int) -> list[Errors | str]:
    """The errors of every solver for one seed, or why it has none."""
    from carm_kin.simulation.simulate import simulate

    recording, truth = simulate(**asdict(simulation), seed=seed)
    joints = {name: getattr(simulation, name) for name in ("urdf", "angular", "orbital", "sensor_link")}
    found: list[Errors | str] = []
    for name in names:
        start = time.perf_counter()
        try:
            result = calibrate_as(recording, Settings(solver=name, **joints))
        except InputError as error:
            found.append(str(error))
            continue
        seconds = time.perf_counter() - start
        found.append(result.refusal.message if result.refusal else _errors(result, truth, seconds))
    return found


def _value(outcome: Outcome, count: int) -> list[Errors | str]:
    """What the job found; a job that killed its worker found nothing. Other errors are raised."""
    if outcome.error is None:
        return outcome.value
    if isinstance(outcome.error, InputError) or not isinstance(outcome.error, CarmKinError):
        raise outcome.error
    return [str(outcome.error)] * count


def _errors(result: CalibrationResult, truth: CalibrationResult, seconds: float) -> Errors:
    found = differences(result, truth, "", "")
    return Errors(
        _first(found, OFFSET),
        _number(result.major_radius_m) - _number(truth.major_radius_m),
        _first(found, ORBITAL_AXIS),
        _first(found, ANGULAR_AXIS),
        _inside(result, truth),
        seconds,
    )


def _first(found: Sequence[Difference], quantity: str) -> float:
    """The difference in m or rad, of the first placement where there are several; NaN where the solver has none."""
    sizes = (
        d.difference_m if d.difference_rad is None else d.difference_rad
        for d in found
        if d.quantity == quantity or d.quantity.startswith(f"{quantity} ")
    )
    return _number(next(sizes, None))


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def _inside(result: CalibrationResult, truth: CalibrationResult) -> float:
    if result.covariance is None or result.offset_sensor_pivot_m is None or truth.offset_sensor_pivot_m is None:
        return np.nan
    error = result.offset_sensor_pivot_m - truth.offset_sensor_pivot_m
    square = error @ np.linalg.solve(result.covariance.block("offset_sensor_pivot"), error)
    return float(square <= CHI2_95_OF_3)
