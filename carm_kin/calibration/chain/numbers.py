"""From the chain solver's estimate to the numbers that a result reports, each with its sigma."""

from collections.abc import Callable

import numpy as np

from carm_kin.calibration.chain.model import ChainModel
from carm_kin.machine.chain import NominalGeometry, nominal_geometry
from carm_kin.results.chain_result import JointChange, SensorGeometry
from solvers.chain.chain import ChainEstimate, moved
from solvers.chain.machine import Machine
from solvers.chain.problem import ChainProblem
from solvers.estimate import Covariance, SigmaPart
from solvers.se3 import Array, inverse, log_se3

DELTA = 1e-6
"""Step of the central differences, m and rad."""
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


def stations(problem: ChainProblem, estimate: ChainEstimate, placements: int) -> Array:
    """(P, J) median joint values of each base placement, where the joints that are not the two axes stand."""
    return np.array([np.median(estimate.values[problem.placement == p], axis=0) for p in range(placements)])


def geometry(model: ChainModel, machine: Machine, sensor: int, q: Array | None = None) -> NominalGeometry:
    """The two-axis geometry of a sensor's chain, all other joints at zero or at ``q`` (J,)."""
    path = machine.paths[sensor]
    return nominal_geometry(model.chain(machine, sensor), None if q is None else q[path])


def tori(model: ChainModel, machine: Machine, at: Array) -> Array:
    """T_world_torus (P, 4, 4) of the first sensor's chain, the other joints at the stations (P, J)."""
    return np.array(
        [T @ geometry(model, machine, 0, q).T_base_torus for T, q in zip(machine.T_world_base, at, strict=True)]
    )


def covariance(model: ChainModel, estimate: ChainEstimate, at: Array) -> tuple[Covariance, tuple[SigmaPart, ...]]:
    """Of the first sensor's offset, axes, radii and centres, by central differences of the estimated unknowns; and the
    parts of which it is made, if systematic effects are among them."""

    def numbers(machine: Machine) -> Array:
        g, T = geometry(model, machine, 0), tori(model, machine, at)
        axis = g.T_sensor_carm[:3, 1]
        rows = [g.offset, [g.major_radius, g.minor_radius, g.non_orthogonality], axis]
        rows += [part for torus in T for part in (torus[:3, 3], torus[:3, 0])]
        return np.concatenate(rows)

    names = [f"offset_sensor_pivot_{k}" for k in "xyz"]
    names += ["major_radius", "minor_radius", "axis_non_orthogonality", *(f"orbital_axis_sensor_{k}" for k in "xyz")]
    for p in range(len(at)):
        names += [f"torus_center_world[{p}]_{k}" for k in "xyz"] + [f"angular_axis_world[{p}]_{k}" for k in "xyz"]
    index, J = _derivative(estimate, numbers)

    def propagated(C: Array) -> Covariance:
        return Covariance(tuple(names), J @ C[np.ix_(index, index)] @ J.T)

    noise = estimate.covariance - sum(estimate.parts.values())
    parts = {"noise": noise, **estimate.parts} if estimate.parts else {}
    return propagated(estimate.covariance), tuple(SigmaPart(name, propagated(C)) for name, C in parts.items())


def sensor_geometry(model: ChainModel, estimate: ChainEstimate, sensor: int) -> SensorGeometry:
    """What the calibrated chain of one sensor is as a C-arm."""
    g = geometry(model, estimate.machine, sensor)
    spread = _propagated(estimate, lambda machine: geometry(model, machine, sensor).offset)
    return SensorGeometry(
        link=model.sensor_links[sensor],
        offset_sensor_pivot_m=g.offset,
        offset_sigma_m=np.sqrt(np.diagonal(spread)),
        major_radius_m=abs(g.major_radius),
        axis_non_orthogonality_rad=g.non_orthogonality,
        T_sensor_carm=g.T_sensor_carm,
        T_link_sensor=inverse(model.chains[sensor].T_last_sensor) @ estimate.machine.T_last_sensor[sensor],
    )


def joint_changes(model: ChainModel, estimate: ChainEstimate) -> tuple[JointChange, ...]:
    """The joints of which anything was estimated."""
    machine, layout = estimate.machine, estimate.layout
    sigma = np.sqrt(np.diagonal(estimate.covariance))
    changed = log_se3(inverse(model.machine.placements) @ machine.placements)
    found = []
    for j, name in enumerate(model.names):
        own = layout.placement(j)
        flags = [*estimate.active[own], estimate.active[layout.offset(j)], estimate.active[layout.gain(j)]]
        if not any(flags):
            continue
        slides = bool(machine.prismatic[j])
        zero, zero_sigma = float(machine.offsets[j]), float(sigma[layout.offset(j)])
        found.append(
            JointChange(
                joint=name,
                estimated=tuple(n for n, flag in zip((*DIRECTIONS, "zero", "gain"), flags, strict=True) if flag),
                shift_m=changed[j, :3],
                shift_sigma_m=sigma[own[:3]],
                turn_rad=changed[j, 3:],
                turn_sigma_rad=sigma[own[3:]],
                zero_rad=None if slides else zero,
                zero_m=zero if slides else None,
                zero_sigma_rad=None if slides else zero_sigma,
                zero_sigma_m=zero_sigma if slides else None,
                gain=float(machine.gains[j]),
                gain_sigma=float(sigma[layout.gain(j)]),
            )
        )
    return tuple(found)


def not_identifiable(
    model: ChainModel, estimate: ChainEstimate, placements: tuple[str, ...], still: tuple[str, ...]
) -> tuple[str, ...]:
    """What was set free but stays nominal, and what it cannot be told from: a sentence a joint, base or mount, and one
    for the joints that stand ``still``."""
    owners, parts = _owners(model, estimate, placements)
    together: dict[str, tuple[list[str], dict[str, None]]] = {}
    for dependence in estimate.dependent:
        directions, others = together.setdefault(owners[dependence.unknown], ([], {}))
        directions.append(parts[dependence.unknown])
        order = np.argsort(-np.abs(dependence.coefficients))
        others |= {owners[dependence.others[k]]: None for k in order}
    found = [
        f"{owner} ({', '.join(directions)}): {_reason(owner, list(others))}"
        for owner, (directions, others) in together.items()
    ]
    return (*found, *([f"{', '.join(still)}: at rest or hardly moved in all poses"] if still else []))


def _reason(owner: str, others: list[str]) -> str:
    """Why something is not identifiable."""
    if others == [owner]:
        return "the unknown joint values take it up, or its own other directions"
    others = [other for other in others if other != owner]
    return f"the poses do not tell it from {' and '.join(others)}" if others else "it moves the sensor in no pose"


def _owners(model: ChainModel, estimate: ChainEstimate, placements: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """(D,) of what each unknown is a number, and (D,) which one."""
    bases = [f"the base{f' in placement {label}' if label else ''}" for label in placements]
    mounts = [f"the mount of {link}" for link in model.sensor_links]
    names = list(model.names)
    owners = [owner for owner in (*bases, *names) for _ in DIRECTIONS] + names + names
    owners += [owner for owner in mounts for _ in DIRECTIONS]
    parts = [*DIRECTIONS] * (len(bases) + len(names)) + ["zero"] * len(names) + ["gain"] * len(names)
    parts += [*DIRECTIONS] * len(mounts)
    constants = range(estimate.layout.constants)
    return owners + ["unknown held values" for _ in constants], parts + [str(k + 1) for k in constants]


def _propagated(estimate: ChainEstimate, numbers: Callable[[Machine], Array]) -> Array:
    """Covariance (K, K) of a function of the machine, which the unknown held values are no part of."""
    index, J = _derivative(estimate, numbers)
    return J @ estimate.covariance[np.ix_(index, index)] @ J.T


def _derivative(estimate: ChainEstimate, numbers: Callable[[Machine], Array]) -> tuple[np.ndarray, Array]:
    """The estimated unknowns (k,) and the derivative (K, k) of a function of the machine by them."""
    index = np.flatnonzero(estimate.active[: estimate.layout.constant(0)])
    columns = []
    for i in index:
        step = np.zeros(estimate.layout.size)
        step[i] = DELTA
        ahead, behind = (numbers(moved(estimate.machine, estimate.layout, s)) for s in (step, -step))
        columns.append((ahead - behind) / (2 * DELTA))
    return index, np.stack(columns, axis=1)
