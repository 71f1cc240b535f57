"""A calibration drawn from what it holds itself, without its recording."""

from typing import TYPE_CHECKING, Any

import numpy as np

from carm_kin.canvas import figure, in_space
from carm_kin.errors import InputError
from solvers.se3 import Array
from solvers.torus import Torus

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from carm_kin.results.result import CalibrationResult

CIRCLE = np.linspace(0, 2 * np.pi, 181)
POSES, PIVOT, ANGULAR, ORBITAL = "#1f6feb", "#c2410c", "#6b7280", "#0b6e4f"


def result_figure(result: "CalibrationResult") -> "Figure":
    """As `CalibrationResult.figure` says."""
    torus = _torus(result)
    known = result.angles_rad is not None
    drawn = figure(10 if known else 6, 5)
    space = drawn.add_subplot(1, 2 if known else 1, 1, projection="3d")
    _machine(space, torus, np.zeros((0, 2)) if result.angles_rad is None else result.angles_rad)
    if result.angles_rad is not None:
        angles = drawn.add_subplot(1, 2, 2)
        angles.plot(*np.degrees(result.angles_rad).T, ".", color=POSES, markersize=3)
        angles.set(xlabel="α, deg", ylabel="β, deg", title="Angles of the poses")
        angles.grid(color="#d0d7de", linewidth=0.5)
    drawn.legend(*space.get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return drawn


def _torus(result: "CalibrationResult") -> Torus:
    """The chain in the frame of its torus, which is the same at every placement."""
    if result.refusal:
        raise InputError(f"a refused calibration ({result.refusal.code}) holds no C-arm to draw")
    if result.T_sensor_carm is None or result.major_radius_signed_m is None:
        raise InputError(f"a result of the solver '{result.solver}' holds no complete chain to draw; use 'kinematic'")
    epsilon = result.axis_non_orthogonality_rad or 0.0
    R, known = result.major_radius_signed_m, np.ones(1, dtype=bool)
    return Torus(np.eye(4)[None], R, epsilon, result.T_sensor_carm, known, result.orbital_referenced)


def _machine(space: Any, torus: Torus, angles: Array) -> None:
    """The two axes, the circle of the rotation centre, the sensor's orbit at alpha = 0, and the poses, in mm."""
    zero = np.zeros_like(CIRCLE)
    swivel, orbit = np.stack([CIRCLE, zero], axis=1), np.stack([zero, CIRCLE], axis=1)
    reach = 1.2 * torus.minor_radius
    carm = torus.T_torus_carm(np.zeros((1, 2)))[0]
    orbital = carm[:3, 3] + reach * np.outer([-1, 1], carm[:3, 1])
    for at, colour, name in (
        (reach * np.outer([-1, 1], [1, 0, 0]), ANGULAR, "angular axis"),
        (orbital, ORBITAL, "orbital axis at α = 0"),
        (torus.T_torus_carm(swivel)[:, :3, 3], PIVOT, "circle of the rotation centre"),
        (_sensor(torus, orbit), POSES, "orbit of the sensor at α = 0"),
    ):
        space.plot(*(at * 1e3).T, color=colour, label=name, linewidth=1.2)
    if len(angles):
        space.plot(*(_sensor(torus, angles) * 1e3).T, ".", color=POSES, markersize=2, label="fitted poses")
    in_space(space, "The C-arm in the frame of its torus")


def _sensor(torus: Torus, angles: Array) -> Array:
    """(N, 3) where the sensor is at the angles (N, 2)."""
    return torus.poses(angles, np.zeros(len(angles), dtype=int))[:, :3, 3]
