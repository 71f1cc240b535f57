"""Which poses agree with one C-arm: random small samples, solved in a batch by the closed form.

A sample of `SAMPLE` poses gives both axes as the rank-one minimum of ``sum (nT R_i a)^2``, reached from
several starts at once, then c, R and t linearly. Both residuals of a pose are linear in the entries of
its matrix, so all hypotheses of a batch are scored on all scored poses by two matrix products. The best
is refitted to the poses that agree with it until they no longer change. The scale comes from the data;
no threshold in millimetres has to be chosen.
"""

from dataclasses import dataclass

import numpy as np

from solvers.problem import Problem
from solvers.se3 import Array, skew
from solvers.start.axes import axes_of, refit
from solvers.start.rank_one import axes_energy, refine_axes
from solvers.torus import Axes

SAMPLE = 5
"""Poses of one hypothesis; four determine the axes."""
STARTS = 6
"""Orbital axes from which each hypothesis starts."""
BATCHES = (8, *(64,) * 60)
"""Hypotheses that are solved together; with clean data the first batch is enough."""
SCORED = 600
"""Poses on which hypotheses are ranked and the best is refitted."""
SHARE = 0.3
"""A hypothesis is ranked by the residual below which this share of the poses lies: up to 70% outliers."""
CONFIDENCE = 1e-4
"""Probability accepted of never having drawn a sample without outliers."""
GROWTH = 3.2
"""Poses agree within this many medians of those that agreed before: 5.9 sigma of a residual in 4-space."""
STREAM = 0x0B57
"""Keeps the draws apart from those of a simulation with the same seed."""
LEAST_SPREAD = 5e-4
"""Least 1 - |mean direction| of either axis over the agreeing poses (1.8 degrees rms): fewer do not count as a
C-arm, since a single sweep is explained by many."""
MAX_RELATIVE = 0.1
"""A pose off by more than this part of the offset's length does not support a hypothesis."""
FLOOR_M = 5e-6
"""Poses always agree within this, so that noise-free data keep all of them."""


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """B two-axis chains of one base placement, without zeros of the angles."""

    center: Array
    """(B, 3), m."""
    angular_axis: Array
    """(B, 3)."""
    major_radius: Array
    """(B,), m."""
    sine: Array
    """(B,) sin(epsilon)."""
    offset: Array
    """(B, 3), m."""
    orbital_axis: Array
    """(B, 3)."""

    @staticmethod
    def of(axes: Axes) -> "Hypotheses":
        """One hypothesis: the axes of a single placement."""
        radius, sine = np.array([axes.major_radius]), np.sin([axes.non_orthogonality])
        return Hypotheses(axes.center, axes.angular_axis, radius, sine, axes.offset[None], axes.orbital_axis[None])

    def axes(self, i: int) -> Axes:
        """Hypothesis i."""
        one = slice(i, i + 1)
        epsilon = float(np.arcsin(self.sine[i]))
        radius = float(self.major_radius[i])
        return Axes(self.center[one], self.angular_axis[one], radius, epsilon, self.offset[i], self.orbital_axis[i])

    def spread(self, problem: Problem, agreeing: np.ndarray) -> Array:
        """(B,) the lesser of 1 - |mean of R_i a| and 1 - |mean of R_iT n| over the agreeing poses (B, N)."""
        weight = agreeing / np.maximum(agreeing.sum(axis=1, keepdims=True), 1)
        mean_R = (weight @ problem.rotations.reshape(-1, 9)).reshape(-1, 3, 3)
        along = np.einsum("bij,bj->bi", mean_R, self.orbital_axis), np.einsum("bij,bi->bj", mean_R, self.angular_axis)
        return 1 - np.maximum(*(np.linalg.norm(mean, axis=1) for mean in along))

    def distances(self, problem: Problem) -> Array:
        """(B, N) residual, m: off the locus, and the angle between the axes times the length of the offset."""
        R = problem.rotations.reshape(-1, 9)
        on_offset = np.einsum("ij,bk->bijk", np.eye(3), self.offset)
        turned = skew(self.angular_axis) * self.major_radius[:, None, None]
        on_circle = np.einsum("bij,bk->bijk", turned, self.orbital_axis)
        off = ((on_offset - on_circle).reshape(-1, 9) @ R.T).reshape(len(self.sine), 3, -1)
        off += problem.p_world_sensor.T - self.center[:, :, None]
        lever = np.linalg.norm(self.offset, axis=1)
        angle = np.einsum("bi,bj->bij", self.angular_axis, self.orbital_axis).reshape(-1, 9) @ R.T + self.sine[:, None]
        return np.sqrt((off**2).sum(axis=1) + (lever[:, None] * angle) ** 2)


def inliers(problem: Problem, seed: int = 0) -> np.ndarray:
    """(N,) mask of the poses that agree with one C-arm, each base placement by itself.

    Placements of fewer than three samples are kept whole. Needs orientations.
    """
    mask = np.ones(len(problem), dtype=bool)
    rng = np.random.default_rng([seed, STREAM])
    for p in range(problem.placements):
        here = np.flatnonzero(problem.placement == p)
        if len(here) >= 3 * SAMPLE:
            one = Problem.of_poses(problem.p_world_sensor[here], problem.rotations[here])
            mask[here] = _agreeing(one, rng)
    return mask


def _agreeing(problem: Problem, rng: np.random.Generator) -> np.ndarray:
    scored = problem.select(np.sort(rng.permutation(len(problem))[:SCORED]))
    axes, distance = _best(problem, scored, rng)
    mask = distance <= GROWTH * max(float(np.quantile(distance, SHARE)), FLOOR_M)
    while True:
        axes = refit(scored.select(mask), axes)
        fitted = Hypotheses.of(axes)
        distance = fitted.distances(scored)[0]
        reach = GROWTH * max(float(np.median(distance[mask])), FLOOR_M)
        grown = distance <= reach
        if grown.sum() <= mask.sum():
            return fitted.distances(problem)[0] <= reach
        mask = grown


def _best(problem: Problem, scored: Problem, rng: np.random.Generator) -> tuple[Axes, Array]:
    """The best hypothesis and the distances (M,) of the scored poses from it: the fit to all of them, or one
    from as many samples as the share of agreeing poses asks for."""
    axes = refit(scored, axes_of(scored))
    tried, best = 0, Hypotheses.of(axes).distances(scored)[0]
    rank = float(np.quantile(best, SHARE))
    for size in BATCHES:
        sample = rng.integers(len(problem), size=(size, SAMPLE))
        batch = solve_samples(problem.rotations[sample], problem.p_world_sensor[sample], rng)
        distances = batch.distances(scored)
        ranks = np.quantile(distances, SHARE, axis=1)
        agreeing = distances <= GROWTH * np.maximum(ranks, FLOOR_M)[:, None]
        ranks[batch.spread(scored, agreeing) < LEAST_SPREAD] = np.inf
        i = int(np.argmin(ranks))
        if ranks[i] < rank and rank > FLOOR_M:
            axes, best, rank = batch.axes(i), distances[i], float(ranks[i])
        tried += size
        share = np.mean(best <= min(GROWTH * max(rank, FLOOR_M), MAX_RELATIVE * np.linalg.norm(axes.offset)))
        if tried * np.log1p(-min(0.9 * share**SAMPLE, 1 - 1e-9)) < np.log(CONFIDENCE):
            break
    return axes, best


def solve_samples(R: Array, p: Array, rng: np.random.Generator) -> Hypotheses:
    """The closed form, axes perpendicular, for samples of poses: R (B, m, 3, 3), p (B, m, 3)."""
    n, a = _axes_of_samples(R, rng)
    z = np.cross(n[:, None], np.einsum("bmij,bj->bmi", R, a))
    z /= np.maximum(np.linalg.norm(z, axis=-1, keepdims=True), 1e-12)
    mean_p, mean_R, mean_z = p.mean(axis=1), R.mean(axis=1), z.mean(axis=1)
    A = np.concatenate([mean_R[:, None] - R, (z - mean_z[:, None])[..., None]], axis=3).reshape(len(R), -1, 4)
    At = np.swapaxes(A, 1, 2)
    x = np.linalg.solve(At @ A + 1e-12 * np.eye(4), At @ (p - mean_p[:, None]).reshape(len(R), -1, 1))[..., 0]
    t, radius = x[:, :3], x[:, 3]
    center = mean_p + np.einsum("bij,bj->bi", mean_R, t) - radius[:, None] * mean_z
    return Hypotheses(center, n, radius, np.zeros(len(R)), t, a)


def _axes_of_samples(R: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """n and a (B, 3) of each sample: the best of several starts, all refined together."""
    B, m = R.shape[:2]
    v = np.concatenate([R.reshape(B, m, 9), np.ones((B, m, 1))], axis=2)
    M = np.repeat(np.swapaxes(v, 1, 2) @ v, STARTS, axis=0)[:, None]
    a = rng.normal(size=(B, STARTS, 3))
    a /= np.linalg.norm(a, axis=-1, keepdims=True)
    y = np.einsum("bmij,bsj->bsmi", R, a)
    n = np.linalg.eigh(np.swapaxes(y, 2, 3) @ y)[1][..., 0]
    n, a = n.reshape(-1, 1, 3), a.reshape(-1, 3)
    zero = np.zeros(len(a))
    n, a, _ = refine_axes(M, n, a, zero, fixed=True)
    energy = axes_energy(M, n, a, zero).reshape(B, STARTS)
    best = np.arange(B) * STARTS + np.argmin(energy, axis=1)
    return n[best, 0], a[best]
