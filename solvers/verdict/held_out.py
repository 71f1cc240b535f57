"""Does every part of a recording agree with the rest? Each is left out in turn, by downdating (docs/estimation.md).

A part is a sweep, or where there are none a contiguous eighth of the poses of a base placement. With K Henderson's
equations of the chain's unknowns and the effects' coefficients (`solvers.effects.variance`), K_b, g_b the information
and the gradient of part b at the best estimate, the estimate without the part moves by

    delta_b = (K - K_b)^-1 g_b,    Cov delta_b = (K - K_b)^-1 - K^-1

where noise and effects are what the fit takes them for. A machine that slips and a base that was moved move it further;
then the jackknife, C_J = (B - 1) / B sum delta_b delta_b', shows how far the estimate may be off.
"""

from dataclasses import dataclass

import numpy as np

from solvers.effects.systematic import Systematic
from solvers.estimate import Covariance, Note
from solvers.likelihood.covariance import reported_jacobian
from solvers.likelihood.f_test import f_tail
from solvers.problem import Problem
from solvers.se3 import Array

BLOCKS = 8
"""Parts into which the poses of a placement are cut where there are no sweeps."""
LEAST_SWEEPS, LEAST_BLOCKS = 6, 4
"""Fewest sweeps that show how the estimate moves; where there are fewer, so many blocks do."""
MOST_GAIN = 10.0
"""A part without which the variance grows by so many times the variance is one that the rest cannot do without."""
LEAST_POSES = 3
"""Fewest poses of a block."""
EXACT = 1e-6
"""Noise below this, m and rad, is rounding."""
PROBABILITY = 1e-3
"""Probability of a disagreement where there is none."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """How the reported quantities move where a part of the poses is left out."""

    names: tuple[str, ...]
    moves: Array
    """(B, K) m and rad."""
    ratio: float
    """Mean square of the offset's moves over what the noise explains: 1 where all is as the fit says."""
    probability: float
    """Of a larger ratio by the noise alone."""

    @property
    def disagree(self) -> bool:
        """Whether noise does not explain how the parts differ."""
        return self.probability < PROBABILITY

    @property
    def note(self) -> Note:
        """What the disagreement means."""
        offset = [self.names.index(f"offset_sensor_pivot_{axis}") for axis in "xyz"]
        most = float(np.linalg.norm(self.moves[:, offset], axis=1).max())
        return Note(
            "parts_disagree",
            f"the parts of the recording disagree: without one of them the offset moves by up to {most * 1e3:.2g} mm, "
            f"{np.sqrt(self.ratio):.1f} times as far as the noise explains. The ± is widened by how much they differ; "
            "a C that sags or a tracker that distorts may be off by more",
        )

    @property
    def covariance(self) -> Array:
        """(K, K) by the jackknife, times what makes 1.96 standard deviations Student's 95%."""
        parts = len(self.moves)
        return (student_95(parts - 1) / student_95(np.inf)) ** 2 * (parts - 1) / parts * self.moves.T @ self.moves

    def widened(self, stated: Covariance) -> Covariance:
        """The stated covariance and that of the jackknife together."""
        index = [self.names.index(name) for name in stated.names]
        return Covariance(stated.names, stated.matrix + _block(self.covariance, index))


def left_out(found: Systematic) -> LeftOut | None:
    """Leave every part out beside the effects ``found``. None where there are too few parts, or no noise."""
    scene = found.scene
    if max(scene.sigma) < EXACT:
        return None
    some = scene.problem.select(scene.blocks.middle)
    for parts, least in ((sweeps_of(some), LEAST_SWEEPS), (blocks_of(some), LEAST_BLOCKS)):
        moves = _moves(found, parts)
        if len(moves.moves) >= least:
            return moves
    return None


def sweeps_of(problem: Problem) -> list[np.ndarray]:
    """The poses of every sweep; those of no sweep in contiguous blocks of their placement."""
    held = problem.held.max(axis=1)
    sweeps = [np.flatnonzero(held == number) for number in np.unique(held[held >= 0])]
    return sweeps + _blocks(problem, np.flatnonzero(held < 0))


def blocks_of(problem: Problem) -> list[np.ndarray]:
    """Contiguous blocks of the poses of every placement."""
    return _blocks(problem, np.arange(len(problem)))


def _blocks(problem: Problem, poses: np.ndarray) -> list[np.ndarray]:
    here = [poses[problem.placement[poses] == placement] for placement in np.unique(problem.placement[poses])]
    return [block for some in here for block in np.array_split(some, min(BLOCKS, len(some) // LEAST_POSES) or 1)]


def _moves(found: Systematic, parts: list[np.ndarray]) -> LeftOut:
    """The moves without each of the ``parts``, but for one that the rest cannot do without."""
    J, names = reported_jacobian(found.scene.torus)
    offset = [names.index(f"offset_sensor_pivot_{axis}") for axis in "xyz"]
    equations = found.parted(parts)
    J = J[:, found.scene.blocks.active]
    J = np.hstack([J, np.zeros((len(J), equations.whole.shape[1] - J.shape[1]))]) * equations.scale
    C = _inverse(equations.whole)
    whole = _block(J @ C @ J.T, offset)
    moves, whitened, information = [], [], []
    for K, gradient in zip(equations.parts, equations.gradients, strict=True):
        without = _inverse(equations.whole - K)
        values, vectors = np.linalg.eigh(_block(J @ (without - C) @ J.T, offset))
        if values[-1] < MOST_GAIN * np.linalg.eigvalsh(whole)[-1]:
            told = values > 1e-9 * values[-1]
            whiten = vectors[:, told].T / np.sqrt(values[told])[:, None]
            moves.append(-J @ without @ gradient)
            whitened.append(whiten @ moves[-1][offset])
            information.append((whiten @ J[offset] @ without, K))
    ratio = float(np.mean(np.concatenate(whitened) ** 2)) if whitened else 1.0
    return LeftOut(names, np.array(moves), ratio, f_tail(_freedom(information, C) if moves else 1.0, 1e6, ratio))


def _inverse(K: Array) -> Array:
    """Of what a part may leave without information, which then gets a large variance."""
    values, vectors = np.linalg.eigh(K)
    return (vectors / np.maximum(values, 1e-12 * values[-1])) @ vectors.T


def _freedom(parts: list[tuple[Array, Array]], C: Array) -> float:
    """Degrees of freedom of the mean square of all whitened moves, by Satterthwaite.

    The gradients of the parts have ``Cov g_b = K_b - K_b C K_b`` and ``Cov(g_b, g_c) = -K_b C K_c``.
    """
    rows = np.concatenate([W @ K for W, K in parts])
    covariance = -rows @ C @ rows.T
    start = 0
    for W, K in parts:
        here = slice(start, start + len(W))
        covariance[here, here] += W @ K @ W.T
        start += len(W)
    return float(np.trace(covariance) ** 2 / (covariance**2).sum())


def student_95(degrees: float) -> float:
    """The 97.5% quantile of Student's distribution, to 1% from 2 degrees of freedom on (Cornish and Fisher)."""
    z, n = 1.959964, degrees
    terms = ((z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96, (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384)
    return z + sum(term / n ** (k + 1) for k, term in enumerate(terms))


def _block(matrix: Array, index: list[int]) -> Array:
    return matrix[np.ix_(index, index)]
