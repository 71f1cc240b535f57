"""What outliers cost: shares of gross outliers up to 70%, and structured ones: ``python -m benchmarks.robustness``.

The paper's 10,080 labelled poses of random geometries at 1 mm and 0.1 deg, noise unknown to the solvers.
"""

import argparse
import time
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

import solvers
from benchmarks import scenes
from carm_kin.recording.checks import repeated
from solvers import kinematic
from solvers.likelihood.bound import cramer_rao
from solvers.problem import Problem
from solvers.se3 import Array, exp_se3
from solvers.torus import Torus
from solvers.verdict.assess import assess

STREAM = 0x0B5
SIGMA_T, SIGMA_R = 1e-3, float(np.radians(0.1))
SHARES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
SOLVERS = ("kinematic", "closed_form", "direct")
STRUCTURED = ("marker flipped", "tracker frozen", "base bumped at 80%")
BAD = 0.2
"""Share of poses that a structured disturbance reaches."""
BUMP_M, BUMP_RAD = 0.020, float(np.radians(1.0))
WITHIN = 1.5
"""A seed counts as good up to this many times the bound's 95% ellipsoid."""
DISTANT = 36.0
"""Squared distance of an outlier above 6 sigma."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """One solver on one recording."""

    error2: float
    """Squared error of the offset, m^2."""
    bound2: float
    """Trace of the bound of the sound poses, m^2."""
    within: bool
    """Inside `WITHIN` times the 95% ellipsoid of that bound."""
    missed: int
    """Bad poses above 6 sigma that were used."""
    distant: int
    """Bad poses above 6 sigma."""
    false_rejections: float
    """Share of the sound poses that were not used."""
    verdict: str = ""
    """Codes of the notes and of the refusal, where assessed."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A disturbed recording and its truth."""

    problem: Problem
    bad: np.ndarray
    """(N,) the disturbed poses."""
    distant: np.ndarray
    """(N,) those of them above 6 sigma."""
    truth: Torus
    angles: Array

    @staticmethod
    def of(problem: Problem, bad: np.ndarray, truth: Torus, angles: Array) -> "Scene":
        """Tells which bad poses the true machine cannot explain."""
        distant = bad.copy()
        if bad.any():
            known = replace(problem.select(bad), sigma_t=SIGMA_T, sigma_r=SIGMA_R)
            distant[bad] = kinematic.fit_angles(known, truth)[1].distance2 > DISTANT
        return Scene(problem, bad, distant, truth, angles)


def judged(solver: str, scene: Scene, verdict: bool) -> Outcome:
    """Solve without the poses that repeat the one before, as `carm_kin.calibrate` does, and compare with the truth."""
    bad, truth, angles = scene.bad, scene.truth, scene.angles
    kept = ~repeated(scene.problem.p_world_sensor, scene.problem.R_world_sensor)
    problem = scene.problem.select(kept)
    estimate = solvers.solver(solver).solve(problem)
    sound = scene.problem.select(~bad)
    free = solver == "kinematic"
    model = sound if free else sound.without_labels()
    C = cramer_rao(truth, angles[~bad], model, SIGMA_T, SIGMA_R, fix_non_orthogonality=not free).block("offset")
    error = estimate.offset - truth.offset
    reach = WITHIN**2 * chdtri(3, 0.05)
    used = kept.copy()
    used[kept] = True if estimate.used is None else estimate.used
    codes = ""
    if verdict:
        found = assess(problem, estimate)
        codes = " + ".join([*(note.code for note in found.notes), *([found.refusal.code] if found.refusal else [])])
    return Outcome(
        float(error @ error),
        float(np.trace(C)),
        bool(error @ np.linalg.solve(C, error) <= reach),
        int((used & scene.distant).sum()),
        int(scene.distant.sum()),
        float((~used & ~bad).sum() / (~bad).sum()),
        codes or "ok",
    )


def gross(job: tuple[float, int]) -> list[Outcome]:
    """All solvers with a share of gross outliers."""
    share, seed = job
    rng = np.random.default_rng([seed, STREAM])
    truth, motion = scenes.random_torus(rng), scenes.paper()
    problem, bad = scenes.observed(truth, motion, SIGMA_T, SIGMA_R, rng, share)
    scene = Scene.of(problem, bad, truth, motion.angles)
    return [judged(name, scene, verdict=False) for name in SOLVERS]


def structured(job: tuple[str, bool, int]) -> Outcome:
    """`kinematic` on one kind of structured outliers, with labels or without."""
    kind, labels, seed = job
    rng = np.random.default_rng([seed, STREAM, STRUCTURED.index(kind)])
    truth, motion = scenes.random_torus(rng), scenes.paper()
    problem, _ = scenes.observed(truth, motion, SIGMA_T, SIGMA_R, rng)
    problem, bad = _disturbed(problem, kind, rng)
    scene = Scene.of(problem if labels else problem.without_labels(), bad, truth, motion.angles)
    return judged("kinematic", scene, verdict=True)


def _disturbed(problem: Problem, kind: str, rng: np.random.Generator) -> tuple[Problem, np.ndarray]:
    """The recording with a contiguous fifth of its poses disturbed, and their mask."""
    n = len(problem)
    first = int(rng.integers(1, round((1 - BAD) * n)))
    if kind == "base bumped at 80%":
        first = round((1 - BAD) * n)
    bad = np.zeros(n, dtype=bool)
    bad[first : first + round(BAD * n)] = True
    p, R = problem.p_world_sensor.copy(), problem.rotations.copy()
    if kind == "marker flipped":
        R[bad] = R[bad] @ np.diag([1.0, -1.0, -1.0])
    elif kind == "tracker frozen":
        p[bad], R[bad] = p[first - 1], R[first - 1]
    else:
        direction = rng.normal(size=(2, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        T = exp_se3(np.concatenate([BUMP_M * direction[0], BUMP_RAD * direction[1]]))
        # about the machine, not the tracker's origin: 20 mm at the mean position
        middle = p.mean(axis=0)
        p[bad], R[bad] = (p[bad] - middle) @ T[:3, :3].T + T[:3, 3] + middle, T[:3, :3] @ R[bad]
    return replace(problem, p_world_sensor=p, R_world_sensor=R), bad


def _cells(found: list[Outcome]) -> list[str]:
    """Bound, RMS, ratio, share within, missed outliers, false rejections."""
    rms, bound = (np.sqrt(np.mean([getattr(o, name) for o in found])) for name in ("error2", "bound2"))
    missed, distant = sum(o.missed for o in found), sum(o.distant for o in found)
    return [
        f"{bound * 1e3:.4f}",
        f"{rms * 1e3:.4f}" if rms < 0.01 else f"{rms * 1e3:.0f}",
        f"{rms / bound:.2f}" if rms < 100 * bound else f"{rms / bound:.0f}",
        f"{100 * np.mean([o.within for o in found]):.0f}%",
        f"{missed} of {distant}",
        f"{100 * np.mean([o.false_rejections for o in found]):.3f}%",
    ]


HEADER = ("bound mm", "RMS mm", "ratio", "within", "missed", "false rejections")


def gross_table(found: dict[float, list[list[Outcome]]]) -> tuple[str, str]:
    """The table of gross outliers and a sentence with the breakdown points."""
    rows, breakdown = [], []
    for k, name in enumerate(SOLVERS):
        good = True
        last = None
        for share in SHARES:
            outcomes = [runs[k] for runs in found[share]]
            rows.append([f"{name}, {share:.0%}", *_cells(outcomes)])
            good = good and np.mean([o.within for o in outcomes]) >= 0.95
            last = share if good else last
        breakdown.append(f"{name} {'none' if last is None else f'{last:.0%}'}")
    return scenes.show("Gross outliers", ["solver, share", *HEADER], rows), ", ".join(breakdown)


def structured_table(found: dict[tuple[str, bool], list[Outcome]]) -> str:
    """The table of structured outliers."""
    rows = []
    for (kind, labels), outcomes in found.items():
        verdicts = Counter(o.verdict for o in outcomes).most_common(3)
        row = [f"{kind}, {'labels' if labels else 'no labels'}", *_cells(outcomes)]
        rows.append([*row, ", ".join(f"{code} ({count})" for code, count in verdicts)])
    return scenes.show("Structured outliers, 20% of the poses, kinematic", ["kind", *HEADER, "verdict (seeds)"], rows)


NOTES = f"""Random geometries, the paper's 10,080 labelled poses at 1 mm and 0.1 deg, noise unknown, default options.
A gross outlier is 50 to 500 mm off with a random orientation. The bound is that of the sound poses alone, for the
solver's own unknowns. Ratio: RMS error of the offset over the seeds by the root of the bound's mean trace. Within:
share of seeds whose error e is inside {WITHIN} times the bound's 95% ellipsoid, sqrt(eT inv(C) e) <= {WITHIN} *
2.795: an estimator whose spread is just {WITHIN} times the bound has 95% of its seeds there. Missed: bad poses that
were used, of those more than 6 sigma from what the true machine can do. False rejections: sound poses that were not
used. The breakdown point is the largest share up to which at least 95% of the seeds are within. Poses that repeat the
one before them are left out first, as `carm_kin.calibrate` does, and count as not used."""


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    begin = time.perf_counter()
    seeds = range(given.seeds)
    results = iter(scenes.run_all(gross, [(share, seed) for share in SHARES for seed in seeds], given.jobs))
    table, breakdown = gross_table({share: [next(results) for _ in seeds] for share in SHARES})
    kinds = [(kind, labels) for kind in STRUCTURED for labels in (True, False)]
    more = iter(scenes.run_all(structured, [(*kind, seed) for kind in kinds for seed in seeds], given.jobs))
    structure = structured_table({kind: [next(more) for _ in seeds] for kind in kinds})
    point = f"**Breakdown points**: {breakdown} (tried up to {SHARES[-1]:.0%})."
    print(point)
    head = scenes.provenance(f"python -m benchmarks.robustness --seeds {given.seeds}", time.perf_counter() - begin)
    scenes.write_section("robustness", "\n\n".join(["## Robustness", head, NOTES, table, point, structure]))


if __name__ == "__main__":
    main()
