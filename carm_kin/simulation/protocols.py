"""Acquisition protocols: which joint moves how, while which angles are held. Angles in radians."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from carm_kin.errors import InputError
from carm_kin.files import read_toml
from carm_kin.machine.chain import Chain
from carm_kin.typed import record
from solvers.estimate import Note
from solvers.se3 import Array

VIRTUAL = "virtual"
"""The protocol of `carm_kin.simulation.virtual`, which needs more than the chain."""
FREE_POSES = 1000
MAX_POSES = 1_000_000
"""More poses than this in one protocol are taken for a mistake."""
MAX_DEG = 3600.0
"""A sweep that starts or ends beyond ten turns is taken for a mistake."""
WIDEST = {"revolute": 2 * np.pi, "continuous": 2 * np.pi, "prismatic": 0.5}
"""Range, rad or m, of which a named protocol makes use where the limits of a joint are wider."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint values of a part of a recording."""

    q: Array
    """(M, J) in the chain's order, rad or m."""
    sweep: str
    """Its label; "" where several joints move."""
    moving: str
    """The joint that moves; "" where several do."""
    told: Mapping[str, Array]
    """Joint name -> (M,) values that the recording has, rad or m: labels of held joints, readings of others."""


@dataclass(frozen=True)
class SweepPlan:
    """One sweep of a protocol file."""

    moving: str
    """The joint that moves, one of the two axes."""
    from_deg: float
    to_deg: float
    step_deg: float = 1.0
    held_deg: Mapping[str, float] = field(default_factory=dict)
    """Angles of revolute joints that are held, in degrees; others stand at zero."""
    held_mm: Mapping[str, float] = field(default_factory=dict)
    """Positions of prismatic joints that are held, in mm."""

    @property
    def poses(self) -> int:
        """How many poses the sweep has; the last one stands at ``to_deg`` or less than a step before it."""
        return int(abs(self.to_deg - self.from_deg) / self.step_deg + 1e-9) + 1


def motions(chain: Chain, protocol: str | Path, rng: np.random.Generator) -> tuple[list[Motion], tuple[Note, ...]]:
    """The motions of a named protocol or of a TOML file, and what there is to say about them.

    Raises InputError for an unknown name, a broken file, or a joint that the chain does not have.
    """
    if str(protocol) in NAMED:
        plan = NAMED[str(protocol)](chain, rng)
    elif str(protocol).endswith(".toml"):
        plan = _from_file(chain, Path(protocol))
    else:
        names = ", ".join([*NAMED, VIRTUAL])
        raise InputError(f"protocol '{protocol}' is unknown; it is one of {names}, or a .toml file")
    return plan, _beyond_limits(chain, plan)


def _paper(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """19 orbital and 9 angular full circles, 10,080 poses (Lee et al. 2020, Section 4)."""
    return _grid(chain, range(-90, 91, 10), np.arange(360.0), range(0, 161, 20), np.arange(360.0))


def _minimal(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """Three orbital circles at -90, 0 and 90 degrees and one angular circle."""
    return _grid(chain, (-90, 0, 90), np.arange(360.0), (0,), np.arange(360.0))


def _clinical(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """Five orbital and three angular sweeps within the joint limits, a pose every degree."""
    low, high = np.degrees(joint_range(chain, chain.angular))
    if low < 90 and high > -90:
        low, high = max(low, -90.0), min(high, 90.0)
    start, stop = np.degrees(joint_range(chain, chain.orbital))
    return _grid(
        chain, np.linspace(low, high, 5), _degrees(start, stop), np.linspace(start, stop, 5)[1:4], _degrees(low, high)
    )


def _free(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """Both axes on smooth random paths within their limits; no sweeps, and no angle is told."""
    return [Motion(_wandering(chain, (chain.angular, chain.orbital), rng), "", "", {})]


def _joints(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """Every joint of the chain on a smooth random path within its limits, with all readings."""
    q = _wandering(chain, range(len(chain.names)), rng)
    return [Motion(q, "", "", dict(zip(chain.names, q.T, strict=True)))]


NAMED: dict[str, Callable[[Chain, np.random.Generator], list[Motion]]] = {
    "paper": _paper,
    "clinical": _clinical,
    "minimal": _minimal,
    "free": _free,
    "joints": _joints,
}


def joint_range(chain: Chain, joint: int) -> Array:
    """The joint's limits (2,), rad or m; where they are wider than `WIDEST`, the part nearest to zero."""
    low, high = chain.lower[joint], chain.upper[joint]
    half = WIDEST[chain.types[joint]] / 2
    if high - low <= 2 * half:
        return np.array([low, high])
    return np.clip(0.0, low + half, high - half) + np.array([-half, half])


def _wandering(chain: Chain, joints: Iterable[int], rng: np.random.Generator) -> Array:
    """Joint values (FREE_POSES, J): some joints on smooth random paths through all their range, others at zero."""
    time = np.linspace(0, 2 * np.pi, FREE_POSES)
    q = np.zeros((FREE_POSES, len(chain.names)))
    for joint in joints:
        low, high = joint_range(chain, joint)
        waves = [np.sin(k * time + rng.uniform(0, 2 * np.pi)) * rng.normal() / k for k in (1, 2, 3, 5, 8)]
        wave = np.sum(waves, axis=0)
        q[:, joint] = low + (high - low) * (wave - wave.min()) / np.ptp(wave)
    return q


def _degrees(low: float, high: float) -> Array:
    """From one limit to the other in equal steps of at most a degree."""
    return np.linspace(low, high, int(np.ceil(high - low - 1e-9)) + 1)


def _grid(
    chain: Chain, alphas_deg: Iterable[float], orbital_deg: Array, betas_deg: Iterable[float], angular_deg: Array
) -> list[Motion]:
    """An orbital sweep at each alpha, then an angular sweep at each beta."""
    angular, orbital = chain.names[chain.angular], chain.names[chain.orbital]
    parts = [(f"{orbital} {a:+.1f} deg", orbital, orbital_deg, angular, a) for a in alphas_deg]
    parts += [(f"{angular} {b:+.1f} deg", angular, angular_deg, orbital, b) for b in betas_deg]
    found = []
    for label, moving, path, held, value in parts:
        q = np.zeros((len(path), len(chain.names)))
        q[:, chain.index(moving)] = np.radians(path)
        q[:, chain.index(held)] = np.radians(value)
        found.append(Motion(q, label, moving, {held: q[:, chain.index(held)]}))
    return found


def _from_file(chain: Chain, path: Path) -> list[Motion]:
    """The motions of a protocol file. Raises InputError with the number of the sweep."""
    try:
        tables = read_toml(path, "protocol").get("sweep")
        if not isinstance(tables, list) or not tables:
            keys = "moving, from_deg, to_deg and may have step_deg, held_deg, held_mm"
            raise InputError(f"no [[sweep]] table; each needs {keys}")
        plans = [_plan(chain, table, f"[[sweep]] number {k}") for k, table in enumerate(tables, 1)]
        if (poses := sum(plan.poses for plan in plans)) > MAX_POSES:
            raise InputError(f"the sweeps have {poses} poses; at most {MAX_POSES} are made: take larger steps")
    except InputError as error:
        raise InputError(str(error), file=path) from None
    width = len(str(len(plans)))
    axes = {chain.names[chain.angular], chain.names[chain.orbital]}
    named = axes.union(*(plan.held_deg for plan in plans), *(plan.held_mm for plan in plans))
    return [_swept(chain, f"{k:0{width}d}", plan, named) for k, plan in enumerate(plans, 1)]


def _plan(chain: Chain, table: Any, place: str) -> SweepPlan:
    """One checked sweep: its types, its numbers and its joints."""
    plan = record(SweepPlan, table, place)
    if plan.step_deg <= 0:
        raise InputError(f"{place}: step_deg must be above 0, not {plan.step_deg}; from_deg and to_deg give the sense")
    if max(abs(plan.from_deg), abs(plan.to_deg)) > MAX_DEG:
        raise InputError(f"{place}: from_deg and to_deg must lie within {MAX_DEG:g} degrees")
    axes = [chain.names[chain.angular], chain.names[chain.orbital]]
    if plan.moving not in axes:
        raise InputError(f"{place}: moving must be one of {', '.join(axes)}, not '{plan.moving}'")
    if plan.moving in plan.held_deg:
        raise InputError(f"{place}: '{plan.moving}' moves and cannot stand in held_deg")
    for key, names, prismatic in (("held_deg", plan.held_deg, False), ("held_mm", plan.held_mm, True)):
        valid = [n for n, kind in zip(chain.names, chain.types, strict=True) if (kind == "prismatic") == prismatic]
        for name in names:
            if name not in valid:
                raise InputError(f"{place}: {key} cannot hold '{name}'; it may have {', '.join(valid) or 'none'}")
    return plan


def _swept(chain: Chain, label: str, plan: SweepPlan, named: set[str]) -> Motion:
    """The motion of one sweep; the recording has the positions of all ``named`` joints that it holds."""
    q = np.zeros((plan.poses, len(chain.names)))
    for name, value in plan.held_deg.items():
        q[:, chain.index(name)] = np.radians(value)
    for name, value in plan.held_mm.items():
        q[:, chain.index(name)] = value / 1000
    sense = np.sign(plan.to_deg - plan.from_deg)
    q[:, chain.index(plan.moving)] = np.radians(plan.from_deg + sense * plan.step_deg * np.arange(plan.poses))
    told = {name: q[:, j] for j, name in enumerate(chain.names) if name in named - {plan.moving}}
    return Motion(q, label, plan.moving, told)


def _beyond_limits(chain: Chain, plan: list[Motion]) -> tuple[Note, ...]:
    q = np.concatenate([motion.q for motion in plan])
    low, high = q.min(axis=0) < chain.lower - 1e-9, q.max(axis=0) > chain.upper + 1e-9
    names = [name for name, beyond in zip(chain.names, low | high, strict=True) if beyond]
    if not names:
        return ()
    return (Note("joint_limits_ignored", f"the protocol moves {', '.join(names)} beyond the limits of the URDF"),)
