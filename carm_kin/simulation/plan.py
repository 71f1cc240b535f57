"""What is simulated: the motions of a protocol, and the two-axis geometry that is true in each part of them."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from carm_kin.machine.chain import Chain, NominalGeometry, nominal_geometry
from carm_kin.machine.urdf import UrdfFile
from carm_kin.simulation.protocols import VIRTUAL, Motion, motions
from carm_kin.simulation.virtual import virtual_motions
from solvers.estimate import Note
from solvers.se3 import Array


@dataclass(frozen=True, eq=False)
class Plan:
    """The motions of N poses, and where the torus stands."""

    motions: list[Motion]
    geometries: list[NominalGeometry]
    """One for each base placement."""
    placement: np.ndarray
    """(N,) the number of each pose's placement."""
    notes: tuple[Note, ...]

    @cached_property
    def part(self) -> np.ndarray:
        """(N,) the number of each pose's motion."""
        return np.repeat(np.arange(len(self.motions)), [len(motion.q) for motion in self.motions])

    @cached_property
    def q(self) -> Array:
        """(N, J), rad or m."""
        return np.concatenate([motion.q for motion in self.motions])


def plan_of(urdf: UrdfFile, chain: Chain, protocol: str | Path, rng: np.random.Generator) -> Plan:
    """The plan of a protocol. Raises InputError as `motions` and `virtual_motions` do, and for parallel axes.

    The joints other than the two axes give a base placement for each of their positions, since the torus stands
    elsewhere there. Where they move from pose to pose, the one geometry is that with all of them at zero.
    """
    if str(protocol) == VIRTUAL:
        parts, geometry = virtual_motions(urdf, chain)
        return Plan(parts, [geometry], np.zeros(sum(len(motion.q) for motion in parts), dtype=int), ())
    parts, notes = motions(chain, protocol, rng)
    stations, placement = _stations(chain, np.concatenate([motion.q for motion in parts]))
    if any(_others(chain, motion.q).any() for motion in parts):
        stations, placement = np.zeros((1, len(chain.names))), np.zeros(len(placement), dtype=int)
        notes = (
            *notes,
            Note("truth_at_zero", "more joints than the two axes move: the truth is that with them at zero"),
        )
    return Plan(parts, [nominal_geometry(chain, station) for station in stations], placement, notes)


def _others(chain: Chain, q: Array) -> np.ndarray:
    """(J,) which of the joints other than the two axes move."""
    moves = np.ptp(q, axis=0) > 0
    moves[[chain.angular, chain.orbital]] = False
    return moves


def _stations(chain: Chain, q: Array) -> tuple[Array, np.ndarray]:
    """The distinct positions (K, J) of all joints but the two axes, and the number (N,) of each pose's."""
    others = q.copy()
    others[:, [chain.angular, chain.orbital]] = 0
    _, first, number = np.unique(others, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))
    return others[np.sort(first)], order[number.ravel()]
