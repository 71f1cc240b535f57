"""Smooth random functions: of an angle or a place by the leading eigenfunctions of their covariance, of time by
polynomials."""

from dataclasses import dataclass

import numpy as np

from solvers.se3 import Array

LEAST_VARIANCE = 1e-3
"""Share of the greatest eigenvalue below which an eigenfunction is left out."""
NODES = 120
"""Places by which a function of the place is described."""
DRIFT_ORDERS = 4
"""Of the polynomials in time of what creeps."""


@dataclass(frozen=True, eq=False)
class Process:
    """A Gaussian process of variance 1 and squared exponential covariance, k(x, x') = exp(-|x - x'|² / 2 l²).

    Its values are ``basis(x)ᵀ z`` with independent normal z. By the eigenvectors u_j and eigenvalues λ_j of k on the
    nodes, the basis is φ_j(x) = Σ_i k(x, x_i) u_ij / √λ_j (Nyström). A ``centred`` one has the mean 0 over its nodes.
    """

    nodes: Array
    """(M, d)."""
    length: float
    """l, in the unit of the nodes."""
    centred: bool
    _weights: Array
    """(M, K) u_ij / √λ_j."""

    @staticmethod
    def over(nodes: Array, length: float, centred: bool = False) -> "Process":
        """The process on ``nodes`` (M, d) that fill the domain evenly."""
        k = _covariance(nodes, nodes, length)
        if centred:
            mean = k.mean(axis=0)
            k = k - mean - mean[:, None] + mean.mean()
        values, vectors = np.linalg.eigh(k)
        kept = values > LEAST_VARIANCE * values[-1]
        return Process(nodes, length, centred, (vectors[:, kept] / np.sqrt(values[kept]))[:, ::-1])

    def basis(self, x: Array) -> Array:
        """(K, N) values of the eigenfunctions at ``x`` (N, d), those of the greatest variance first."""
        k = _covariance(x, self.nodes, self.length)
        if self.centred:
            own = _covariance(self.nodes, self.nodes, self.length)
            k = k - k.mean(axis=1, keepdims=True) - own.mean(axis=0) + own.mean()
        return (k @ self._weights).T


def _covariance(a: Array, b: Array, length: float) -> Array:
    square = (a**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * a @ b.T
    return np.exp(-0.5 * np.maximum(square, 0.0) / length**2)


def grid(low: Array, high: Array, steps: int) -> Array:
    """(steps ** d, d) points that fill the box from ``low`` (d,) to ``high`` (d,) evenly."""
    axes = np.linspace(low, high, steps).T
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low))


def over_places(p: Array, length: float) -> Array:
    """(K, N) basis of a function of the places p (N, 3) with the length l, m."""
    some = np.linspace(0, len(p) - 1, min(len(p), NODES)).astype(int)
    return Process.over(p[some], length).basis(p)


def centred(basis: Array) -> Array:
    """The ``basis`` (K, N) less its mean over the poses."""
    return basis - basis.mean(axis=1, keepdims=True)


def legendre(clock: Array, orders: int) -> Array:
    """(orders, n) Legendre's polynomials over the span of the times (n,), from order k = 1 on, over k."""
    span, k = float(np.ptp(clock)), np.arange(1, orders + 1)
    time = 2 * (clock - clock.min()) / span - 1 if span > 0 else np.zeros(len(clock))
    return (np.polynomial.legendre.legvander(time, orders)[:, 1:] / k).T


def over_times(placement: np.ndarray, clock: Array | None) -> Array:
    """(P * DRIFT_ORDERS, N) polynomials of time in every placement of the numbers (N,), 0 in the others; without a
    ``clock`` (N,) the number of the pose stands for the time."""
    count = int(placement.max()) + 1
    waves = np.zeros((count, DRIFT_ORDERS, len(placement)))
    for p in range(count):
        here = np.flatnonzero(placement == p)
        if here.size:
            waves[p][:, here] = legendre(here.astype(float) if clock is None else clock[here], DRIFT_ORDERS)
    return waves.reshape(-1, len(placement))


def play(way: Array) -> Array:
    """(N,) the play operator: from 0, it follows the ``way`` (N,) within -1 and 1."""
    state, states = 0.0, np.empty(len(way))
    for k, step in enumerate(np.diff(way, prepend=way[:1]).tolist()):
        state = min(1.0, max(-1.0, state + step))
        states[k] = state
    return states
