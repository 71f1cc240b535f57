"""The numbers of a result as rows of tables, with units and standard deviations, and its verdict in words."""

from dataclasses import dataclass
from math import degrees, floor, log10

import numpy as np

from carm_kin.results.parts import ToldOffset
from carm_kin.results.result import CalibrationResult
from carm_kin.results.shown import FIXED, NOT_DETERMINED, determined, direction_determined, length_determined
from carm_kin.results.summary import MOST_SIGMA
from solvers.se3 import Array


@dataclass(frozen=True)
class Row:
    """One number, or several of one kind."""

    name: str
    values: tuple[str, ...]
    sigmas: tuple[str, ...]
    """As many, or none where no standard deviation is known."""
    unit: str
    remark: str = ""


def verdict(result: CalibrationResult) -> str:
    """One sentence."""
    if result.refusal:
        return result.refusal.message
    if result.told:
        return f"Calibrated in part. Not told: {'; '.join(result.observability.unobservable)}."
    sigma = result.sigma.offset_sensor_pivot_m
    share = f"{result.used} of {result.poses} poses"
    if result.offset_sensor_pivot_m is None:
        return f"Calibrated from {share}; the solver '{result.solver}' cannot tell the offset."
    if sigma is None:
        return f"Calibrated from {share}; the solver '{result.solver}' gives no uncertainty."
    if not length_determined(sigma):
        return f"Calibrated from {share}; the offset is not determined."
    return (
        f"Calibrated from {share}; the offset is known to {number(float(np.linalg.norm(sigma)) * 1e3)} mm (one sigma)."
    )


def rows_of(result: CalibrationResult) -> tuple[Row, ...]:
    """What belongs to sensor and machine."""
    sigma = result.sigma
    rows = [
        _vector("Offset: rotation centre in the sensor", result.offset_sensor_pivot_m, sigma.offset_sensor_pivot_m),
        _major_radius(result),
        _length("Minor radius", result.minor_radius_m, sigma.minor_radius_m, _fixed(result, "minor_radius")),
        _angle(
            "Non-orthogonality of the axes",
            result.axis_non_orthogonality_rad,
            sigma.axis_non_orthogonality_rad,
            _fixed(result, "axis_non_orthogonality"),
        ),
        _direction("Orbital axis in the sensor", result.orbital_axis_sensor, sigma.orbital_axis_sensor),
    ]
    return (*_told(result.told), *(row for row in rows if row is not None))


def _fixed(result: CalibrationResult, quantity: str) -> str:
    """The remark on a quantity that was not estimated."""
    return FIXED if quantity in result.fixed else ""


def _told(told: ToldOffset | None) -> tuple[Row, ...]:
    """What of an offset is told, and where the line lies that it leaves."""
    if told is None:
        return ()
    rows = [
        _row(f"Offset along {_of(d.direction_sensor)}", [d.offset_m * 1e3], [d.sigma_m * 1e3], "mm") for d in told.told
    ]
    for direction, sigma in zip(told.untold_directions_sensor, told.untold_sigma_rad, strict=True):
        rows.append(Row(f"Offset along {_of(direction)}", ("not told",), (), ""))
        if len(told.untold_directions_sensor) == 1:
            lean = f"± {number(degrees(sigma))} deg"
            rows.append(Row("Line of the pivot in the sensor: direction", (_of(direction),), (), "", lean))
            nearest = _vector("Its point nearest the sensor", told.nearest_sensor_m + 0.0, None)
            rows += [nearest] if nearest else []
    return tuple(rows)


def _of(direction: Array) -> str:
    return f"({', '.join(f'{x:+.3f}' for x in np.round(direction, 3) + 0.0)})"


def placement_rows(result: CalibrationResult) -> tuple[tuple[str, tuple[Row, ...]], ...]:
    """Label and numbers of every base placement."""
    found = []
    for k, placement in enumerate(result.placements):
        one = result.sigma.placements[k] if result.sigma.placements else None
        rows = [
            _vector("Torus centre in the world", placement.torus_center_world_m, one and one.torus_center_world_m),
            _direction("Angular axis in the world", placement.angular_axis_world, one and one.angular_axis_world),
        ]
        found.append((placement.label, tuple(row for row in rows if row is not None)))
    return tuple(found)


def quality_rows(result: CalibrationResult) -> tuple[Row, ...]:
    """What the poses leave."""
    if result.used == 0 or not result.noise.translation_m:
        return ()
    residuals, noise = result.residuals, result.noise
    kind = "estimated" if noise.estimated else "given"
    rows = [
        _length("Position residual, rms", residuals.translation_rms_m, None),
        _angle("Rotation residual, rms", residuals.rotation_rms_rad, None),
        _length(f"Position noise an axis, {kind}", noise.translation_m, None),
        _angle(f"Rotation noise an axis, {kind}", noise.rotation_rad, None),
    ]
    if residuals.chi2_per_dof is not None and not noise.estimated:
        rows.append(Row("Chi-square per degree of freedom", (number(residuals.chi2_per_dof),), (), ""))
    return tuple(row for row in rows if row is not None)


def number(value: float, digits: int = 2) -> str:
    """``digits`` significant digits, without an exponent where that is short."""
    if value == 0 or not np.isfinite(value):
        return f"{value:g}"
    decimals = digits - 1 - floor(log10(abs(value)))
    return f"{value:.{max(decimals, 0)}f}" if decimals <= 7 else f"{value:.{digits - 1}e}"


def with_sigma(value: float, sigma: float | None) -> tuple[str, str]:
    """Both with as many decimals as make two digits of sigma."""
    if sigma is None or not 0 < sigma < np.inf:
        return f"{value:.3f}", ""
    decimals = int(np.clip(1 - floor(log10(sigma)), 0, 6))
    return f"{value:.{decimals}f}", f"{sigma:.{decimals}f}"


def _row(name: str, values: list[float], sigmas: list[float] | None, unit: str, remark: str = "") -> Row:
    if not determined(None if sigmas is None else np.array(sigmas), MOST_SIGMA.get(unit, np.inf)):
        return Row(name, (NOT_DETERMINED,), (), "", remark)
    pairs = [with_sigma(v, None if sigmas is None else sigmas[k]) for k, v in enumerate(values)]
    known = tuple(s for _, s in pairs) if all(s for _, s in pairs) else ()
    return Row(name, tuple(v for v, _ in pairs), known, unit, remark)


def _length(name: str, value: float | None, sigma: float | None, remark: str = "") -> Row | None:
    return None if value is None else _row(name, [value * 1e3], None if sigma is None else [sigma * 1e3], "mm", remark)


def _angle(name: str, value: float | None, sigma: float | None, remark: str = "") -> Row | None:
    sigmas = None if sigma is None else [degrees(sigma)]
    return None if value is None else _row(name, [degrees(value)], sigmas, "deg", remark)


def _vector(name: str, value: Array | None, sigma: Array | None) -> Row | None:
    if value is None:
        return None
    return _row(name, list(value * 1e3), None if sigma is None else list(sigma * 1e3), "mm")


def _direction(name: str, value: Array | None, sigma: Array | None) -> Row | None:
    if value is None:
        return None
    values = tuple(f"{x:+.5f}" for x in value)
    if sigma is None:
        return Row(name, values, (), "")
    if not direction_determined(sigma):
        return Row(name, (NOT_DETERMINED,), (), "")
    return Row(name, values, (), "", f"± {number(degrees(float(np.linalg.norm(sigma))))} deg")


def _major_radius(result: CalibrationResult) -> Row | None:
    """With an upper limit instead of a sigma where it is not told from 0."""
    interval, name = result.major_radius_interval_95_m, "Major radius: distance of the axes"
    if interval is None or interval[0] > 0 or not length_determined(result.sigma.major_radius_m):
        return _length(name, result.major_radius_m, result.sigma.major_radius_m, _fixed(result, "major_radius"))
    remark = f"at most {interval[1] * 1e3:.3f} mm (95%)"
    return _length(name, result.major_radius_m, None, remark)
