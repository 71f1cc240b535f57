"""Whether a part of the poses is from another sensor, or from one mounted anew: docs/estimation.md, "Two sensors".

Which poses is either known, as those of a placement, or not, as with two tools under one name. Then the residuals fall
into two groups a constant displacement of the sensor apart.
"""

import numpy as np

from solvers.estimate import Note
from solvers.likelihood.linearise import Linearisation
from solvers.problem import Problem
from solvers.se3 import Array
from solvers.torus import Torus
from solvers.verdict.change import BASE, SENSOR, rows_of
from solvers.verdict.displaced import Nuisance

LEAST_POSES = 12
"""Fewest poses of a group."""
LEAST_GAP = 4.2
"""Standard deviations between the two groups. A sag or a play that sways with an angle splits into groups at most 4.1
of their own apart, as the halves of a sine do."""
LEAST_BESIDE_M, LEAST_BESIDE_RAD = 0.5e-3, float(np.radians(0.1))
"""No two tools are mounted nearer to each other; groups that are sway with an angle by what bends or has play."""
LEAST_REMOUNTED_M, LEAST_REMOUNTED_RAD = 2e-3, float(np.radians(0.3))
"""A tracker that distorts sets the sensors of two placements apart by less; that is the effect `remounting`."""
LEAST_SEEN = 0.6
"""Share of it that the poses show: their own angles take away two of its six components."""
FAR_LESS = 1.5
"""Ratio of the sums of squares without and with two sensors, from which on groups that take turns are told, however
near: two groups made of noise have 1.2, since they part one of its four directions, by 64%."""
FALSE_ALARM = 1e-6
"""Probability of naming a sensor of its own where there is none, under independent noise."""
EDGES = 49
"""Poses between which a stretch is looked for."""
AT_EDGES = 0.05
"""Share of a placement by which a stretch that begins or ends near its edge may miss it."""
VISIBLE = 0.5
"""Least displacement of a stretch's poses, in standard deviations of one pose, root mean square: less is a wander."""
BETTER = 10.0
"""By how much more a sensor elsewhere must lower the weighted sum of squares than a base elsewhere."""
QUIET = 1e-3
"""Nothing is left if noise alone makes another stretch with this probability."""
RARE = 1e-5
"""The same between placements, which are known."""
MOST_POSES = 1000
"""Poses from which the groups are found."""
SHY = 0.01
"""Weight at which the other poses hold a group's displacement back: poses at one angle do not see all of it."""
STARTS = 6
ITERATIONS = 60
SETTLED = 1e-6


def two_sensors_of(
    problem: Problem, torus: Torus, angles: Array, sigma: tuple[float, float], line: Linearisation, numbers: np.ndarray
) -> Note | None:
    """A cause of a misfit from the residuals ``line`` of a problem's poses at ``angles`` (2, n): `two_sensors`, or
    `sensor_moved` between placements. ``numbers`` (n,) are the poses' among all."""
    if len(problem) < 2 * LEAST_POSES:
        return None
    bent = Nuisance.of(rows_of(line, angles, problem, sigma, flex=True), problem)
    if note := _between_placements(bent, torus):
        return note
    rows = rows_of(line, angles, problem, sigma, flex=False)
    groups = _groups(rows)
    if groups is not None:
        spread, apart = groups
        nuisance = Nuisance.of(rows, problem)
        found = nuisance.displaced(apart)
        few = apart if apart.mean() <= 0.5 else ~apart
        orders = (np.arange(len(apart)), *np.argsort(angles, axis=1))
        by_turns = all(_alternates(apart[order]) for order in orders) and found.lowered > (FAR_LESS - 1) * found.left
        shift, turn = found.of_sensor(torus)
        beside = (shift > LEAST_BESIDE_M or turn > LEAST_BESIDE_RAD) and _seen(rows[..., few], found.delta, sigma)
        lasts = nuisance.correlation_time(apart, found)
        if beside and (spread * LEAST_GAP <= 1 or by_turns) and found.probability(lasts) < FALSE_ALARM:
            return Note(
                "two_sensors",
                f"{few.sum()} of {len(few)} poses are of a sensor {found.of_sensor_in_words(torus)} beside that of the "
                f"others (poses {_listed(numbers[few])}): two tools under one name, or one that slips to and fro; keep "
                "one",
            )
    return _for_a_stretch(bent, torus, numbers)


def _seen(rows: Array, delta: Array, sigma: tuple[float, float]) -> bool:
    """Whether the poses of ``rows`` show as much of the displacement as two tools would: it may be great in directions
    of which they tell nothing."""
    moved = (np.einsum("rin,i->rn", rows[:, SENSOR], delta) ** 2).reshape(2, 3, -1).sum(axis=1).mean(axis=1)
    least = np.array([LEAST_BESIDE_M, LEAST_BESIDE_RAD]) * LEAST_SEEN
    return bool((np.sqrt(moved) * sigma > least).any())


def _between_placements(nuisance: Nuisance, torus: Torus) -> Note | None:
    """The placement whose sensor stands most clearly elsewhere, no function of the angles explaining it."""
    placement, count = nuisance.problem.placement, nuisance.problem.placements
    if count < 2:
        return None
    tests = [nuisance.displaced(placement == p) for p in range(count)]
    p = int(np.argmax([test.lowered for test in tests]))
    shift, turn = tests[p].of_sensor(torus)
    if shift < LEAST_REMOUNTED_M and turn < LEAST_REMOUNTED_RAD:
        return None
    if count * tests[p].probability(nuisance.correlation_time(placement == p, tests[p])) > RARE:
        return None
    return Note(
        "sensor_moved",
        f"the sensor seems to have been moved on the C by about {tests[p].of_sensor_in_words(torus)} between "
        f"placements: that of placement {p + 1} stands elsewhere than at the others; calibrate each by itself",
    )


def _for_a_stretch(nuisance: Nuisance, torus: Torus, numbers: np.ndarray) -> Note | None:
    """A stretch of poses in whose course the sensor stood elsewhere, by half the noise of a pose or more.

    A displacement of the base there must explain it worse, and no other stretch be left: a machine that bends or has
    play leaves one at every step.
    """
    n = len(nuisance.problem)
    edges = np.unique(np.linspace(0, n, min(EDGES, n // LEAST_POSES + 1)).astype(int))
    first, last, found = nuisance.stretch(edges)
    # the stretch and the rest change roles where it is the greater part
    size = min(last - first, n - (last - first))
    here = (np.arange(n) >= first) & (np.arange(n) < last)
    share = np.array([here[nuisance.problem.placement == p].mean() for p in range(nuisance.problem.placements)])
    if len(share) > 1 and (np.minimum(share, 1 - share) < AT_EDGES).all():
        return None  # whole placements, which were judged before
    if found.lowered < size * VISIBLE**2 or found.probability(nuisance.correlation_time(here, found)) > FALSE_ALARM:
        return None
    if nuisance.stretch(edges, BASE)[2].lowered + BETTER > found.lowered:
        return None
    if nuisance.besides(here).stretch(edges)[2].probability() < QUIET:
        return None
    return Note(
        "sensor_moved",
        f"the sensor seems to stand {found.of_sensor_in_words(torus)} elsewhere on the C at about poses "
        f"{numbers[first]} to {numbers[last - 1]} than at the others; calibrate each part by itself",
    )


def _groups(rows: Array) -> tuple[float, np.ndarray] | None:
    """The two groups of residuals that lie farthest apart: their spread over the gap, and the poses (n,) of one.

    Two constant displacements by turns: assign each pose to the nearer one, fit each to its poses, of `MOST_POSES`
    evenly picked ones.
    """
    D, y = np.moveaxis(rows[:, SENSOR], -1, 0), -np.moveaxis(rows[:, -1], -1, 0)
    step = max(1, -(-len(y) // MOST_POSES))
    some, best = (D[::step], y[::step]), None
    n = len(some[1])
    information = np.einsum("nri,nrk->nik", some[0], some[0])
    pull = np.einsum("nri,nr->ni", *some)
    every = information.sum(axis=0)
    far = np.argsort(-(some[1] ** 2).sum(axis=1))
    for k in range(STARTS):
        # a start from the poses whose residuals lie to one side, as those of one with a great residual do
        seed = far[k * n // (4 * STARTS)]
        second = _nearer(*some, np.zeros(6), _fit(information[seed], pull[seed]))
        for _ in range(ITERATIONS):
            if min(second.sum(), (~second).sum()) * step < LEAST_POSES:
                break
            a, b = (
                _fit(information[part].sum(axis=0) + SHY * part.mean() * every, pull[part].sum(axis=0))
                for part in (~second, second)
            )
            new = _nearer(*some, a, b)
            if (new == second).all():
                spread, group = _spread(D, y, a, b)
                if min(group.sum(), (~group).sum()) >= LEAST_POSES and (best is None or spread < best[0]):
                    best = spread, group
                break
            second = new
    return best


def _nearer(D: Array, y: Array, a: Array, b: Array) -> np.ndarray:
    """(n,) mask of the poses nearer the displacement b than a."""
    moved = D @ (b - a)
    return np.einsum("nr,nr->n", moved, y - D @ a - 0.5 * moved) > 0


def _spread(D: Array, y: Array, a: Array, b: Array) -> tuple[float, np.ndarray]:
    """Along the line between two displacements the residuals are at 0 or 1: how they spread about these, which is the
    measure of the gap, and which are at 1."""
    between, rest, second = D @ (b - a), y - D @ a, _nearer(D, y, a, b)
    length2 = np.maximum((between**2).sum(axis=1), 1e-12)
    off = (np.einsum("nr,nr->n", between, rest) / length2 - second) ** 2
    return float(np.sqrt(max(off.mean(), np.average(off, weights=length2)))), second


def _alternates(second: np.ndarray) -> bool:
    """Whether the groups (n,) take turns half as often as by chance, as no function of what orders them does."""
    share = second.mean()
    return bool((second[1:] != second[:-1]).mean() > share * (1 - share))


def _fit(H: Array, g: Array) -> Array:
    """The displacement (6,) of the least squares, none in the directions that the poses do not see."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    return scale * np.linalg.lstsq(H * np.outer(scale, scale), g * scale, rcond=1e-9)[0]


def _listed(numbers: np.ndarray) -> str:
    return ", ".join(map(str, numbers[:5])) + (f", ... {numbers[-1]}" if len(numbers) > 5 else "")
