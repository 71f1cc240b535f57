"""Likely causes of poses that do not fit, tried one by one.

Every cause is a small function in `CAUSES` that suggests corrected problems. A suggestion is accepted where
the chain fits the corrected poses far better than the given ones. docs/refusals.md says what cannot be told.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solvers import kinematic
from solvers.estimate import Estimate, Note
from solvers.problem import Problem
from solvers.start import robust
from solvers.verdict.limits import Limits
from solvers.verdict.misread import conflicting_sweeps, misreadings, reversed_sweeps

MIN_POSES = 6
"""Fewer rejected poses than this are not asked for a cause."""
LOUDER = 1.5
"""Ratio of the noise of two fits from which on the second explains the poses by noise."""
CONTIGUOUS = 0.8
"""Share of rejected poses within the stretch that they span, from which on they count as one stretch."""
TRIED = 500
"""Poses on which a cause is tried."""
SAMPLES = 48
"""Samples of five poses from which a misreading is judged before it is fitted."""
MOST_REJECTED = 0.25
"""Largest share of poses that a cause may leave unexplained, unless far more were rejected without it."""
EQUALLY_GOOD = 1.5
"""Causes whose residuals differ by less than this factor are all named."""
LABELS = ("wrong_label", "reversed_sweep")
"""Causes that concern some sweeps only: the others may be sound."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """A cause and the problem as it would be without it."""

    note: Note
    corrected: Problem


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the causes look at."""

    problem: Problem
    """All poses."""
    estimate: Estimate
    limits: Limits

    @cached_property
    def some(self) -> np.ndarray:
        """The poses on which causes are tried, spread over every sweep and placement."""
        key = np.column_stack([self.problem.held, self.problem.placement])
        group = np.unique(key, axis=0, return_inverse=True)[1].ravel()
        chosen = np.zeros(len(self.problem), dtype=bool)
        for g in range(group.max() + 1):
            members = np.flatnonzero(group == g)
            step = min(-(-len(self.problem) // TRIED), max(1, len(members) // MIN_POSES))
            chosen[members[::step]] = True
        return np.flatnonzero(chosen)

    @cached_property
    def blank(self) -> Estimate | None:
        """The fit to some poses with nothing known of the joints, where it explains them."""
        some = self.problem.select(self.some).without_labels()
        if locus_distance(some) > self.limits.max_sigma_t_m:
            return None
        fit = _fitted(some, kinematic.Options())
        return fit if fit and self.plausible(fit) else None

    @cached_property
    def trusted(self) -> np.ndarray:
        """The poses on which causes in the labels are tried: those that agree with one C-arm without them."""
        return self.some if self.blank is None or self.blank.used is None else self.some[self.blank.used]

    def plausible(self, fit: Estimate) -> bool:
        """Whether a fit leaves noise that a tracker may have."""
        sigma_t, sigma_r = fit.sigma_t or 0.0, fit.sigma_r or 0.0
        return sigma_t <= self.limits.max_sigma_t_m and sigma_r <= self.limits.max_sigma_r_rad


def causes_of(problem: Problem, estimate: Estimate, limits: Limits = Limits()) -> tuple[Note, ...]:
    """The causes that explain why poses do not fit, the likeliest first; those that explain them equally well
    follow. Takes at most a second or so."""
    if problem.R_world_sensor is None or len(problem) < 2 * MIN_POSES:
        return ()
    evidence = Evidence(problem, estimate, limits)
    found: list[tuple[float, Note]] = []
    for cause in CAUSES:
        for suspect in cause(evidence):
            noise = _noise_if_explained(evidence, suspect)
            if noise is not None:
                found.append((noise, suspect.note))
        if found:
            break
    least = min((noise for noise, _ in found), default=0.0)
    return tuple(note for noise, note in found if noise <= EQUALLY_GOOD * least)


def misread_poses(evidence: Evidence) -> Iterator[Suspect]:
    """Orientations or positions that were read in another convention, where that makes one C-arm of them."""
    some = evidence.problem.select(evidence.some)
    before = locus_distance(some)
    if before <= evidence.limits.max_sigma_t_m / evidence.limits.min_gain:
        return
    for note, corrected in misreadings(some):
        if locus_distance(corrected) * evidence.limits.min_gain <= before:
            yield Suspect(note, corrected)


def exchanged_roles(evidence: Evidence) -> Iterator[Suspect]:
    """World in sensor instead of sensor in world, or the names of the two joints exchanged."""
    problem = evidence.problem.select(evidence.trusted)
    if problem.placements > 1 or (evidence.blank and (problem.held >= 0).any()):
        R = np.swapaxes(problem.rotations, 1, 2)
        p = -(R @ problem.p_world_sensor[..., None])[..., 0]
        note = Note("inverted_poses", "the poses seem to be inverted (the world in the sensor's frame); invert each")
        yield Suspect(note, replace(problem, p_world_sensor=p, R_world_sensor=R))
    if evidence.blank and (problem.held >= 0).any():
        note = Note("exchanged_joints", "the names of the angular and the orbital joint seem to be exchanged")
        yield Suspect(note, replace(problem, held=problem.held[:, ::-1], label=problem.label[:, ::-1]))


def wrong_label(evidence: Evidence) -> Iterator[Suspect]:
    """Sweeps whose `moving` or held angle contradicts the poses of the other sweeps."""
    if evidence.blank is None or evidence.blank.torus is None:
        return
    for note, poses in conflicting_sweeps(evidence.problem, evidence.blank.torus):
        held, label = evidence.problem.held.copy(), evidence.problem.label.copy()
        held[poses], label[poses] = -1, np.nan
        yield Suspect(note, replace(evidence.problem, held=held, label=label).select(evidence.trusted))


def reversed_sweep(evidence: Evidence) -> Iterator[Suspect]:
    """Sweeps whose readings of the moving joint run against the motion."""
    if evidence.blank is None or evidence.blank.torus is None:
        return
    for note, joint, sweeps in reversed_sweeps(evidence.problem, evidence.blank.torus):
        label = evidence.problem.label.copy()
        for poses in sweeps:
            label[poses, joint] = label[poses[::-1], joint]
        yield Suspect(note, replace(evidence.problem, label=label).select(evidence.trusted))


def moved_base(evidence: Evidence) -> Iterator[Suspect]:
    """The base moved, where the solver itself rejected too little to show it."""
    if evidence.estimate.used is not None and base_moved_at(evidence.problem, evidence.estimate) is not None:
        return
    some = evidence.problem.select(evidence.some)
    fit = _fitted(some, kinematic.Options())
    at = base_moved_at(some, fit) if fit else None
    if at is None:
        return
    here = np.flatnonzero(some.placement == some.placement[at])
    pose = evidence.some[at]
    note = Note("base_moved", f"the base seems to have been moved at about pose {pose}; give each part a 'placement'")
    yield Suspect(note, some.apart(here[here >= at]))


CAUSES: tuple[Callable[[Evidence], Iterator[Suspect]], ...] = (
    misread_poses,
    wrong_label,
    reversed_sweep,
    exchanged_roles,
    moved_base,
)
"""In the order in which they are tried; the first kind that explains the poses ends the search."""


def locus_distance(problem: Problem, seed: int = 0) -> float:
    """Median distance, m, of the poses of the largest placement from the best of some two-axis chains, each
    through five of its poses. Labels play no part; outliers below half of the poses hardly any."""
    counts = np.bincount(problem.placement)
    here = np.flatnonzero(problem.placement == counts.argmax())
    one = Problem.of_poses(problem.p_world_sensor[here], problem.rotations[here])
    rng = np.random.default_rng([seed, 0xD1A6])
    sample = rng.integers(len(one), size=(SAMPLES, robust.SAMPLE))
    batch = robust.solve_samples(one.rotations[sample], one.p_world_sensor[sample], rng)
    return float(np.median(batch.distances(one), axis=1).min())


def _noise_if_explained(evidence: Evidence, suspect: Suspect) -> float | None:
    """The position noise that the corrected poses show, where it is so much less that the cause is accepted."""
    limits = evidence.limits
    whole = len(suspect.corrected) == len(evidence.some)
    fit = _fitted(suspect.corrected, kinematic.Options(reject_outliers=whole))
    if fit is None or fit.used is None or not fit.converged or not evidence.plausible(fit):
        return None
    rejected = 0.0 if evidence.estimate.used is None else 1 - evidence.estimate.used.mean()
    if 1 - fit.used.mean() > max(MOST_REJECTED if rejected < MOST_REJECTED else 0.0, 0.5 * rejected):
        return None
    given = evidence.problem.select(evidence.some if whole else evidence.trusted)
    before = _fitted(given, kinematic.Options(reject_outliers=False, max_iterations=12))
    if before is None:
        return fit.sigma_t
    gains = [
        (b or 0.0) / max(a or 0.0, 1e-9) for b, a in ((before.sigma_t, fit.sigma_t), (before.sigma_r, fit.sigma_r))
    ]
    return fit.sigma_t if max(gains) >= limits.min_gain else None


def _fitted(problem: Problem, options: kinematic.Options) -> Estimate | None:
    """The most likely chain with the noise estimated, None where there is none."""
    try:
        return kinematic.solve(replace(problem, sigma_t=None, sigma_r=None), options)
    except (np.linalg.LinAlgError, ValueError):
        return None


def base_moved_at(problem: Problem, estimate: Estimate) -> int | None:
    """The first pose after the base was moved, or None.

    Tried where the rejected poses form one stretch of one placement at its beginning or end: the stretch is
    given a placement of its own, and the cause is accepted if most of it then agrees with the same machine.
    """
    rejected = np.flatnonzero(~estimate.used) if estimate.used is not None else np.zeros(0, dtype=int)
    if len(rejected) < MIN_POSES or problem.R_world_sensor is None:
        return None
    placement = np.bincount(problem.placement[rejected]).argmax()
    here = np.flatnonzero(problem.placement == placement)
    ours = np.isin(here, rejected)
    change = _best_split(ours)
    if change is None:
        return None
    stretch = here[:change] if ours[:change].mean() > ours[change:].mean() else here[change:]
    try:
        fit = kinematic.solve(problem.apart(stretch))
    except np.linalg.LinAlgError:
        return None
    agrees = fit.used is not None and fit.used[stretch].mean() > CONTIGUOUS
    return int(here[change]) if agrees and _as_quiet(fit, estimate) else None


def _as_quiet(fit: Estimate, before: Estimate) -> bool:
    """Whether the noise did not have to grow for it."""
    pairs = (fit.sigma_t, before.sigma_t), (fit.sigma_r, before.sigma_r)
    return all(new is not None and old is not None and new < LOUDER * old for new, old in pairs)


def _best_split(rejected: np.ndarray) -> int | None:
    """Where a sequence of flags is best cut into kept and rejected; None if it is no such sequence."""
    n = len(rejected)
    before = np.concatenate([[0], np.cumsum(rejected)])
    after = before[-1] - before
    cut = np.arange(n + 1)
    errors = np.minimum(before + (n - cut - after), (cut - before) + after)
    best = int(np.argmin(errors))
    enough = min(best, n - best) >= MIN_POSES
    return best if enough and errors[best] <= (1 - CONTIGUOUS) * rejected.sum() else None
