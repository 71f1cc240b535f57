"""The machine of a result as marks in the frame of its torus, mm."""

from collections.abc import Callable

import numpy as np
from scipy.special import chdtri

from carm_kin.report.circle import span
from carm_kin.report.colours import ELLIPSOID, INK, PIVOT, RAMPS, SURFACE, TRIAD
from carm_kin.report.marks import Line, Mark, Points, Surface, Text, segments
from carm_kin.report.poses import Fit, Poses
from carm_kin.results.result import CalibrationResult
from solvers.se3 import Array, inverse

MARGIN_RAD = float(np.radians(6))
"""How far the surface is drawn beyond the outermost poses."""
SAMPLES, MESH = 49, 13
"""Points of the surface and of its lines, and lines, each way."""
FRAME_SHARE, ELLIPSOID_SHARE, AXIS_SHARE = 0.13, 0.08, 0.5
"""Length of a frame's axes, largest half-axis of the enlarged ellipsoid, half-length of the two axes: of the extent."""
OPACITY = 0.16
"""Of the surface; half of it where the surface covers itself."""
CONFIDENCE = 0.95
AXIS_COLOURS = RAMPS["angular"][0], RAMPS["orbital"][0]
MM = 1e3


def machine_marks(result: CalibrationResult, poses: Poses, p: Array) -> tuple[list[Mark], str]:
    """Surface, circle, axes, frames and ellipsoid, and what there is to say of them; ``p`` (N, 3) are the sensor's
    positions in the torus, mm."""
    fit = poses.fit
    assert fit is not None
    extent = float(np.ptp(np.concatenate([p[poses.used], np.zeros((1, 3))]), axis=0).max())
    T_torus_carm = fit.torus.T_torus_carm(fit.angles[[_middle(poses, fit)]])[0]
    T_torus_sensor = T_torus_carm @ inverse(fit.torus.T_sensor_carm)
    marks = [*_surface(fit, poses.used), *_pivot(fit, T_torus_carm, T_torus_sensor)]
    marks += _axes(T_torus_carm, AXIS_SHARE * extent)
    marks += _frames({"torus": np.eye(4), "C-arm": T_torus_carm, "sensor": T_torus_sensor}, FRAME_SHARE * extent)
    ellipsoid, words = _ellipsoid(result, T_torus_carm, T_torus_sensor, ELLIPSOID_SHARE * extent)
    return [*marks, *ellipsoid], words


def _middle(poses: Poses, fit: Fit) -> int:
    """The used pose nearest to the middle of both angles."""
    off = np.zeros(len(poses.used))
    for angle in fit.angles.T:
        low, high = span(angle[poses.used])
        off += np.angle(np.exp(1j * (angle - (low + high) / 2))) ** 2
    return int(np.argmin(np.where(poses.used, off, np.inf)))


def _surface(fit: Fit, used: np.ndarray) -> list[Mark]:
    """The part of the torus on which the poses lie, with lines of equal angles."""
    q = inverse(fit.torus.T_sensor_carm)[:3, 3]

    def at(alpha: Array, beta: Array) -> Array:
        T = fit.torus.T_torus_carm(np.stack([alpha.ravel(), beta.ravel()], axis=1))
        return ((T[:, :3, :3] @ q + T[:, :3, 3]) * MM).reshape(*alpha.shape, 3)

    (a, coarse_a), (b, coarse_b) = (_samples(angle[used]) for angle in fit.angles.T)
    lines = [at(np.full(SAMPLES, alpha), b) for alpha in coarse_a] + [
        at(a, np.full(SAMPLES, beta)) for beta in coarse_b
    ]
    name, whole = "torus surface", min(np.ptp(a), np.ptp(b)) > np.pi
    return [
        Surface(name, at(*np.meshgrid(a, b, indexing="ij")), SURFACE, OPACITY * (0.5 if whole else 1.0)),
        Line(name, segments(*lines), SURFACE, 1.0),
    ]


def _samples(angle: Array) -> tuple[Array, Array]:
    """Fine and coarse angles over the range of (N,)."""
    low, high = span(angle)
    room = min(MARGIN_RAD, (2 * np.pi - (high - low)) / 2)
    return np.linspace(low - room, high + room, SAMPLES), np.linspace(low - room, high + room, MESH)


def _pivot(fit: Fit, T_torus_carm: Array, T_torus_sensor: Array) -> list[Mark]:
    """The circle of the rotation centre, itself, the torus centre, and the offset."""
    turn = np.linspace(0, 2 * np.pi, 97)
    radius = fit.torus.major_radius * MM
    circle = radius * np.stack([np.zeros_like(turn), -np.sin(turn), np.cos(turn)], axis=1)
    pivot, sensor = T_torus_carm[:3, 3] * MM, T_torus_sensor[:3, 3] * MM
    return [
        Line("circle of the rotation centre", circle, PIVOT, 4),
        Points("rotation centre", pivot[None], PIVOT, ("rotation centre",), "diamond", 6),
        Points("torus centre", np.zeros((1, 3)), INK, ("torus centre",), "square", 4),
        Line("offset", np.stack([sensor, pivot]), PIVOT, 3, dashed=True),
    ]


def _axes(T_torus_carm: Array, reach_mm: float) -> list[Mark]:
    ends = np.array([[-1.0], [1.0]]) * reach_mm
    angular = ends * [1.0, 0.0, 0.0]
    orbital = T_torus_carm[:3, 3] * MM + ends * T_torus_carm[:3, 1]
    return [
        Line("angular axis", angular, AXIS_COLOURS[0], 5),
        Line("orbital axis", orbital, AXIS_COLOURS[1], 5),
    ]


def _frames(frames: dict[str, Array], length_mm: float) -> list[Mark]:
    marks: list[Mark] = []
    for column, (axis, colour) in enumerate(zip("xyz", TRIAD, strict=True)):
        arms = [np.stack([T[:3, 3] * MM, T[:3, 3] * MM + length_mm * T[:3, column]]) for T in frames.values()]
        marks.append(Line(f"{axis} of the frames", segments(*arms), colour, 5))
    beside = {"C-arm": [0, 1.3, 0], "sensor": [0, 0, 1.3]}
    named = ((name, frames[name], side) for name, side in beside.items())
    return marks + [Text(T[:3, 3] * MM + length_mm * T[:3, :3] @ side, name) for name, T, side in named]


def _ellipsoid(
    result: CalibrationResult, T_torus_carm: Array, T_torus_sensor: Array, reach_mm: float
) -> tuple[list[Mark], str]:
    """Where the offset lies with 95%, about the rotation centre, enlarged to be seen."""
    C = result.covariance.block("offset_sensor_pivot") if result.covariance else np.zeros((0, 0))
    if C.shape != (3, 3):
        return [], ""
    values, vectors = np.linalg.eigh(C)
    half_axes = np.sqrt(np.maximum(values, 0.0) * chdtri(3, 1 - CONFIDENCE)) * MM
    if half_axes[-1] <= 0:
        return [], ""
    times = _round_down(reach_mm / half_axes[-1])
    ball = _ball(lambda unit: unit * half_axes @ vectors.T @ T_torus_sensor[:3, :3].T * times)
    axes = " × ".join(f"{axis:.3f}" for axis in half_axes[::-1])
    words = (
        f" The ellipsoid, enlarged {times:g} times, holds the true offset with {CONFIDENCE:.0%}; its half-axes are "
        f"{axes} mm."
    )
    return [Surface("uncertainty of the offset", ball + T_torus_carm[:3, 3] * MM, ELLIPSOID, 0.45)], words


def _ball(shape: Callable[[Array], Array]) -> Array:
    """(13, 25, 3) a grid on the unit sphere, shaped."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, 13), np.linspace(0, 2 * np.pi, 25), indexing="ij")
    sine = np.sin(polar)
    return shape(np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=-1))


def _round_down(value: float) -> float:
    """1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(power * max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))
