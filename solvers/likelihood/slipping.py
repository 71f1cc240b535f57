"""Held joints that do not stay where they are: docs/estimation.md, "Held joints are soft".

The angle of a held joint is one unknown a sweep only as long as the poses, each with angles of its own, agree that it
does not move; a brake that slips, or a C that bends as if it did, makes it one a pose.
"""

from dataclasses import dataclass, replace

import numpy as np

from solvers.estimate import Note
from solvers.likelihood.correlation import Stretches, correlation_time
from solvers.likelihood.f_test import f_tail
from solvers.problem import ANGULAR, ORBITAL, Problem
from solvers.se3 import Array
from solvers.torus import Torus

ORDERS = 3
"""Of the polynomial of time by which a held angle may move."""
LEAST_POSES = 8
"""Of a sweep in which a slip is looked for."""
FALSE_ALARM = 1e-8
"""Probability of letting go a joint that is held, in any sweep."""
MOST_RAD = float(np.radians(5.0))
"""Beyond this a joint does not slip, but moves, and the sweep is not what it is said to be."""
TOLD_RAD = float(np.radians(0.3))
"""From this slip on it is said."""
EXACT_RAD = 1e-6
"""Noise of the angles below which it is rounding."""
NAMES = ("angular", "orbital")


def let_go(problem: Problem, torus: Torus, used: np.ndarray) -> tuple[Problem, tuple[Note, ...]]:
    """The problem with every joint soft that slips in its sweep, and what there is to say of them.

    The pose nearest to the middle of the slip stays: there the label tells the zero, with so much more doubt. ``used``
    (N,) are the poses believed.
    """
    courses = _courses(problem, torus, used)
    lasts = _lasts(courses)
    soft = np.zeros(problem.held.shape, dtype=bool)
    sigma = np.zeros(soft.shape) if problem.sigma_label is None else problem.sigma_label.copy()
    slipping = [one for one in courses if one.probability(lasts) < FALSE_ALARM and one.size < MOST_RAD]
    if not slipping:
        return problem, ()
    for course in slipping:
        middle, joint = course.middle, course.joint
        sigma[middle, joint] = np.hypot(sigma[middle, joint], course.slip.std())
        soft[course.poses, joint] = course.poses != middle
    told = [course for course in slipping if course.size > TOLD_RAD]
    return replace(problem, sigma_label=sigma).softened(soft), (_note(problem, told),) if told else ()


@dataclass(frozen=True, eq=False)
class _Course:
    """The angle of a held joint in the course of a sweep."""

    poses: np.ndarray
    """(n,) of the sweep."""
    used: np.ndarray
    """(n,) mask."""
    joint: int
    slip: Array
    """(n,) the polynomial of time that it follows, about its mean, rad."""
    left: Array
    """(m,) what that leaves of the used poses, rad."""

    @staticmethod
    def of(angle: Array, poses: np.ndarray, used: np.ndarray, joint: int) -> "_Course":
        """From the angles (n,) that the poses show by themselves."""
        off = np.angle(np.exp(1j * (angle - np.angle(np.exp(1j * angle[used]).sum()))))
        waves = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(angle)), ORDERS)
        course = waves @ np.linalg.lstsq(waves[used], off[used], rcond=None)[0]
        return _Course(poses, used, joint, course - course[used].mean(), (off - course)[used])

    @property
    def size(self) -> float:
        """From end to end, rad."""
        return float(np.ptp(self.slip))

    @property
    def middle(self) -> int:
        """The used pose nearest to the mean of the slip."""
        return int(self.poses[np.argmin(np.where(self.used, np.abs(self.slip), np.inf))])

    def probability(self, lasts: float) -> float:
        """That noise which lasts for so many poses alone makes it seem to slip as much."""
        n = len(self.left)
        dof = n / lasts - ORDERS - 1
        variance = max(float((self.left**2).sum()) / (n - ORDERS - 1), EXACT_RAD**2)
        F = float((self.slip[self.used] ** 2).sum()) / (ORDERS * lasts * variance)
        return f_tail(ORDERS, dof, F) if dof > 0 else 1.0


def _note(problem: Problem, slipping: list[_Course]) -> Note:
    """What there is to say of them."""
    worst = max(slipping, key=lambda course: course.size)
    sweeps = sorted({int(problem.held[course.poses[0], course.joint]) + 1 for course in slipping})
    named = f"sweep{'s' * (len(sweeps) > 1)} {', '.join(map(str, sweeps))}"
    return Note(
        "held_joint_slips",
        f"a joint that is said to be held turns, or the C bends as if it did: in {named}, most the "
        f"{NAMES[worst.joint]} joint at poses {worst.poses.min()} to {worst.poses.max()}, by "
        f"{np.degrees(worst.size):.2g} deg; its angle was taken as unknown there",
    )


def _courses(problem: Problem, torus: Torus, used: np.ndarray) -> list[_Course]:
    """Of every held joint that enough poses tell of."""
    if not (problem.held >= 0).any():
        return []
    angles, courses = torus.angles(problem), []
    for joint in (ANGULAR, ORBITAL):
        for sweep in np.unique(problem.held[problem.held[:, joint] >= 0, joint]):
            here = np.flatnonzero(problem.held[:, joint] == sweep)
            if used[here].sum() >= LEAST_POSES:
                courses.append(_Course.of(angles[here, joint], here, used[here], joint))
    return courses


def _lasts(courses: list[_Course]) -> float:
    """For how many poses the noise of the angles lasts, in all sweeps together."""
    if not courses:
        return 1.0
    sizes = [len(course.left) for course in courses]
    every = np.concatenate([course.left / max(float(course.left.std()), EXACT_RAD) for course in courses])
    stretches = Stretches.within([np.repeat(np.arange(len(courses)), sizes)], None)
    return correlation_time(every[:, None], stretches, (ORDERS + 1.0) * len(courses))
