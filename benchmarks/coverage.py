"""Coverage of the 95% intervals of `kinematic`: ``python -m benchmarks.coverage``.

Every run draws a machine, its noise and a recording of some 200 poses; the noise is estimated from it.
"""

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from benchmarks import scenes
from benchmarks.scenes import Motion
from solvers import kinematic
from solvers.estimate import Estimate
from solvers.likelihood.covariance import NORMAL_95, interval_of_magnitude
from solvers.se3 import Array, orthonormal_complement
from solvers.torus import Torus

STREAM = 0xC0F
SIGMA_T, SIGMA_R = 5e-4, float(np.radians(0.1))
EPSILON = float(np.radians(1.0))
"""The non-orthogonality of each machine is uniform between minus and plus this, rad."""
COLUMNS = ("offset", "ellipsoid", "R", "minor R", "epsilon", "|R| interval", "centre", "angular axis", "orbital axis")


@dataclass(frozen=True)
class Scene:
    """One kind of recording."""

    name: str
    R: float | None = None
    """Major radius, m; None: random."""
    ring: bool = False
    arc_deg: float = 360.0
    labels: bool = True
    placements: int = 1

    def motion(self) -> Motion:
        """Three orbital sweeps and two angular ones for each placement."""
        full = self.arc_deg >= 360
        poses = 40 if self.placements == 1 else 24
        path = np.linspace(-0.5, 0.5, poses, endpoint=not full) * self.arc_deg
        alphas, betas = ((-80, 0, 80), (0, 80)) if full else (np.array((-0.5, 0, 0.5)) * self.arc_deg, (-20, 20))
        parts = [scenes.sweeps_deg(alphas, path, betas, path, p, first_sweep=5 * p) for p in range(self.placements)]
        return parts[0] if len(parts) == 1 else scenes.joined(*parts)


GEOMETRIES = (
    Scene("ring"),
    Scene("spindle"),
    Scene("isocentric, R = 0", R=0.0),
    Scene("spindle, arcs of 60 deg", arc_deg=60.0),
)
SCENES = tuple(
    replace(scene, ring=scene.name == "ring", labels=labels, placements=placements)
    for placements in (1, 2)
    for scene in GEOMETRIES
    for labels in (True, False)
)


def one_run(job: tuple[int, int]) -> tuple[Array, bool, bool]:
    """Whether each interval holds the truth, in the order of `slots`; whether epsilon was taken as 0; converged."""
    number, seed = job
    scene = SCENES[number]
    rng = np.random.default_rng([seed, number, STREAM])
    epsilon = rng.uniform(-EPSILON, EPSILON)
    truth = scenes.random_torus(rng, scene.R, scene.ring, epsilon, scene.placements)
    problem, _ = scenes.observed(truth, scene.motion(), SIGMA_T, SIGMA_R, rng)
    estimate = kinematic.solve(problem if scene.labels else problem.without_labels())
    fixed = any(note.code == "non_orthogonality_fixed" for note in estimate.notes)
    return np.array(_held(estimate, truth)), fixed, estimate.converged


def _held(estimate: Estimate, truth: Torus) -> list[bool]:
    """The signs of R and epsilon are those that the true directions of the axes give them, so that R has no edge
    at 0, but in the reported interval of |R|; unit vectors are compared in the tangent plane at the estimate."""
    torus, covariance = estimate.torus, estimate.covariance
    assert torus is not None
    assert covariance is not None
    n, a = scenes.signs(torus, truth)
    offset, spread = torus.offset - truth.offset, covariance.block("offset")
    held = [*_within(offset, spread), bool(offset @ np.linalg.solve(spread, offset) <= chdtri(3, 0.05))]
    scalars = (
        ("major_radius", n * a * torus.major_radius - truth.major_radius),
        ("minor_radius", torus.minor_radius - truth.minor_radius),
        ("axis_non_orthogonality", n * a * torus.non_orthogonality - truth.non_orthogonality),
    )
    for name, error in scalars:
        held += _within(np.array([error]), covariance.block(name))
    low, high = interval_of_magnitude(torus.major_radius, float(covariance.sigma("major_radius")[0]))
    held.append(low <= abs(truth.major_radius) <= high)
    for p in range(len(truth.center)):
        held += _within(torus.center[p] - truth.center[p], covariance.block(f"torus_center_world[{p}]"))
    for p in range(len(truth.center)):
        angular = covariance.block(f"angular_axis_world[{p}]")
        held += _directions(torus.angular_axis[p], n * truth.angular_axis[p], angular)
    return held + _directions(torus.orbital_axis, a * truth.orbital_axis, covariance.block("orbital_axis"))


def _within(error: Array, covariance: Array) -> list[bool]:
    return [bool(x) for x in np.abs(error) <= NORMAL_95 * np.sqrt(np.diagonal(covariance))]


def _directions(estimate: Array, truth: Array, covariance: Array) -> list[bool]:
    """Both components in the tangent plane; the covariance (3, 3) has rank 2."""
    tangents = orthonormal_complement(estimate)
    return _within(tangents.T @ (estimate - truth), tangents.T @ covariance @ tangents)


def slots(placements: int) -> list[tuple[str, int]]:
    """Column and length of the parts of what `one_run` returns."""
    return list(zip(COLUMNS, (3, 1, 1, 1, 1, 1, 3 * placements, 2 * placements, 2), strict=True))


def table(scenes_runs: list[tuple[Scene, list[tuple[Array, bool, bool]]]]) -> tuple[str, list[float]]:
    """The table, and all its shares."""
    lines, every = [], []
    for scene, runs in scenes_runs:
        share = np.mean([held for held, _, _ in runs], axis=0)
        fixed = sum(f for _, f, _ in runs)
        name = f"{scene.name}, {'labels' if scene.labels else 'no labels'}"
        name += ", two placements" if scene.placements == 2 else ""
        lines.append([name + (f" (epsilon taken as 0 in {fixed})" if fixed else "")])
        start = 0
        for _, length in slots(scene.placements):
            part = share[start : start + length]
            lines[-1].append(" ".join(f"{100 * x:.1f}" + ("" if 0.93 <= x <= 0.97 else "*") for x in part))
            start += length
        every += list(share)
    return scenes.show("Share of runs whose 95% interval holds the truth, %", ["recording", *COLUMNS], lines), every


NOTES = """Three orbital and two angular sweeps, {arcs}, 200 poses (240 at two placements), noise 0.5 mm and 0.1 deg
an axis, estimated by the solver; R 50 to 200 mm but where stated, epsilon uniform within 1 deg; default options.
Several numbers in a cell are components. The ellipsoid is the 95% one of the offset. R = 0 is the edge of |R|, so R
and epsilon are taken with the signs that the true directions of both axes give them (they change sign with either
axis; turning both changes nothing); the errors of R are then two-sided everywhere. The |R| interval is the reported
one: the image of R ± 1.96 sigma under |.|, from 0 on where R is not told from 0. Axes are unit vectors: their
errors are compared in the two directions of the tangent plane, their 3x3 covariance having rank 2. An asterisk marks
what is outside 93% to 97%: {out} of {total} numbers. With {runs} runs a share has a standard error of {error:.2f}%,
and {expected:.0f} numbers would be outside by chance if every true coverage were 95%. The mean of all shares is
{mean:.2f}%; {failed} fits did not converge."""


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    begin = time.perf_counter()
    work = [(number, seed) for number in range(len(SCENES)) for seed in range(given.runs)]
    found = scenes.run_all(one_run, work, given.jobs)
    runs = [(scene, found[k * given.runs : (k + 1) * given.runs]) for k, scene in enumerate(SCENES)]
    text, shares = table(runs)
    chance = _chance_outside(given.runs)
    notes = NOTES.format(
        arcs="full circles or arcs of 60 deg",
        out=sum(not 0.93 <= x <= 0.97 for x in shares),
        total=len(shares),
        runs=given.runs,
        error=100 * np.sqrt(0.95 * 0.05 / given.runs),
        expected=chance * len(shares),
        mean=100 * np.mean(shares),
        failed=sum(not converged for _, _, converged in found),
    )
    head = scenes.provenance(f"python -m benchmarks.coverage --runs {given.runs}", time.perf_counter() - begin)
    scenes.write_section("coverage", "\n\n".join(["## Coverage of the intervals", head, notes, text]))


def _chance_outside(runs: int) -> float:
    """Probability that the share in so many runs is outside 93% to 97% at a true coverage of 95%."""
    from scipy.stats import binom

    k = np.arange(runs + 1)
    outside = (k < 0.93 * runs - 1e-9) | (k > 0.97 * runs + 1e-9)
    return float(binom.pmf(k, runs, 0.95)[outside].sum())


if __name__ == "__main__":
    main()
