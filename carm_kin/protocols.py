"""Acquisition protocols: which joint moves how, while which angles are held. Angles in radians."""

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from carm_kin.chain import Chain
from carm_kin.errors import InputError
from solvers.estimate import Note
from solvers.se3 import Array

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FREE_POSES = 1000
MAX_POSES = 10_000_000
"""More poses than this in one protocol are taken for a mistake."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint values of a part of a recording."""

    q: Array
    """(M, J) in the chain's order, rad or m."""
    sweep: str
    """Its label; "" where several joints move."""
    moving: str
    """The joint that moves; "" where several do."""


@dataclass(frozen=True)
class SweepPlan:
    """One sweep of a protocol file."""

    moving: str
    from_deg: float
    to_deg: float
    step_deg: float = 1.0
    held_deg: dict[str, float] = field(default_factory=dict)
    """Angles of revolute joints that are held, in degrees; others stand at zero."""
    held_mm: dict[str, float] = field(default_factory=dict)
    """Positions of prismatic joints that are held, in mm."""


def motions(chain: Chain, protocol: str | Path, rng: np.random.Generator) -> tuple[list[Motion], tuple[Note, ...]]:
    """The motions of a named protocol or of a TOML file, and what there is to say about them.

    Raises InputError for an unknown name, a broken file, or a joint that the chain does not have.
    """
    if str(protocol) in NAMED:
        plan = NAMED[str(protocol)](chain, rng)
    elif str(protocol).endswith(".toml"):
        plan = [_swept(chain, f"{k:02d}", sweep) for k, sweep in enumerate(_read(Path(protocol)))]
    else:
        names = ", ".join(NAMED)
        raise InputError(f"protocol '{protocol}' is unknown; it is one of {names}, or a .toml file")
    return plan, _beyond_limits(chain, plan)


def _paper(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """19 orbital and 9 angular full circles, 10,080 poses (Lee et al. 2020, Section 4)."""
    return _grid(chain, range(-90, 91, 10), np.arange(360), range(0, 161, 20), np.arange(360))


def _minimal(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """Three orbital circles at -90, 0 and 90 degrees and one angular circle."""
    return _grid(chain, (-90, 0, 90), np.arange(360), (0,), np.arange(360))


def _clinical(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """Five orbital and three angular sweeps within the joint limits."""
    alpha, beta = (_range_deg(chain, joint) for joint in (chain.angular, chain.orbital))
    alpha = np.clip(alpha, -90, 90)
    return _grid(
        chain,
        np.linspace(*alpha, 5),
        np.arange(np.ceil(beta[0]), beta[1] + 1e-9),
        np.linspace(*beta, 5)[1:4],
        np.arange(np.ceil(alpha[0]), alpha[1] + 1e-9),
    )


def _free(chain: Chain, rng: np.random.Generator) -> list[Motion]:
    """Both joints on smooth random paths within their limits; no sweeps."""
    time = np.linspace(0, 2 * np.pi, FREE_POSES)
    q = np.zeros((FREE_POSES, len(chain.names)))
    for joint in (chain.angular, chain.orbital):
        low, high = np.radians(_range_deg(chain, joint))
        wave = sum(np.sin(k * time + rng.uniform(0, 2 * np.pi)) * rng.normal() / k for k in (1, 2, 3, 5, 8))
        q[:, joint] = low + (high - low) * (wave - wave.min()) / np.ptp(wave)
    return [Motion(q, "", "")]


NAMED: dict[str, Callable[[Chain, np.random.Generator], list[Motion]]] = {
    "paper": _paper,
    "clinical": _clinical,
    "minimal": _minimal,
    "free": _free,
}


def _range_deg(chain: Chain, joint: int) -> Array:
    return np.clip(np.degrees([chain.lower[joint], chain.upper[joint]]), -180, 180)


def _grid(chain: Chain, alphas_deg, orbital_deg: Array, betas_deg, angular_deg: Array) -> list[Motion]:
    """An orbital sweep at each alpha, then an angular sweep at each beta."""
    angular, orbital = chain.names[chain.angular], chain.names[chain.orbital]
    parts = [(f"orbital {a:+.1f} deg", orbital, orbital_deg, angular, a) for a in alphas_deg]
    parts += [(f"angular {b:+.1f} deg", angular, angular_deg, orbital, b) for b in betas_deg]
    found = []
    for label, moving, path, held, value in parts:
        q = np.zeros((len(path), len(chain.names)))
        q[:, chain.index(moving)] = np.radians(path)
        q[:, chain.index(held)] = np.radians(value)
        found.append(Motion(q, label, moving))
    return found


def _swept(chain: Chain, label: str, plan: SweepPlan) -> Motion:
    path = np.arange(0.0, abs(plan.to_deg - plan.from_deg) + 1e-9, abs(plan.step_deg))
    q = np.zeros((len(path), len(chain.names)))
    for name, value in plan.held_deg.items():
        q[:, chain.index(name)] = np.radians(value)
    for name, value in plan.held_mm.items():
        q[:, chain.index(name)] = value / 1000
    q[:, chain.index(plan.moving)] = np.radians(plan.from_deg + np.sign(plan.to_deg - plan.from_deg) * path)
    return Motion(q, label, plan.moving)


def _read(path: Path) -> list[SweepPlan]:
    """The ``[[sweep]]`` tables of a protocol file."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=path) from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"no valid TOML: {error}", file=path) from None
    tables = content.get("sweep")
    if not isinstance(tables, list) or not tables:
        raise InputError(
            "no [[sweep]] table; each needs moving, from_deg, to_deg and may have step_deg, held_deg, held_mm",
            file=path,
        )
    return [_plan(path, k, table) for k, table in enumerate(tables)]


def _plan(path: Path, k: int, table: dict) -> SweepPlan:
    place = f"[[sweep]] number {k + 1}"
    try:
        plan = SweepPlan(**table)
        numbers = np.array([plan.from_deg, plan.to_deg, plan.step_deg, *plan.held_deg.values(), *plan.held_mm.values()])
    except (TypeError, AttributeError):
        raise InputError(
            f"{place}: needs moving, from_deg, to_deg; may have step_deg, held_deg, held_mm; has {', '.join(table)}",
            file=path,
        ) from None
    if numbers.dtype.kind not in "if" or not np.isfinite(numbers).all():
        raise InputError(f"{place}: every angle and position must be a finite number", file=path)
    if plan.step_deg == 0 or abs(plan.to_deg - plan.from_deg) / abs(plan.step_deg) > MAX_POSES:
        raise InputError(f"{place}: step_deg = {plan.step_deg} gives too many poses", file=path)
    return plan


def _beyond_limits(chain: Chain, plan: list[Motion]) -> tuple[Note, ...]:
    q = np.concatenate([motion.q for motion in plan])
    low, high = q.min(axis=0) < chain.lower - 1e-9, q.max(axis=0) > chain.upper + 1e-9
    names = [name for name, beyond in zip(chain.names, low | high, strict=True) if beyond]
    if not names:
        return ()
    return (Note("joint_limits_ignored", f"the protocol moves {', '.join(names)} beyond the limits of the URDF"),)
