"""A result in words, for the terminal: one fact a line, each within 80 columns."""

import numpy as np
from rich.console import Console

from carm_kin.result import CalibrationResult
from solvers.se3 import Array

_NAME_WIDTH = 34


def show(result: CalibrationResult, console: Console) -> None:
    """Print the verdict, the numbers with their sigmas, what the poses leave, and the warnings."""
    verdict = f"solver {result.solver}, {result.used} of {result.poses} poses"
    console.print(f"{result.status}: ", style="bold green" if result.status == "ok" else "bold red", end="")
    console.print(verdict)
    show_numbers(result, console)
    for line in _quality(result):
        console.print(f"  {line}", soft_wrap=True)
    for warning in result.warnings:
        console.print(f"warning ({warning.code}): ", style="yellow", end="")
        console.print(warning.message, soft_wrap=True)


def show_numbers(result: CalibrationResult, console: Console) -> None:
    """Print the numbers with their sigmas alone."""
    for line in _numbers(result):
        console.print(f"  {line}", soft_wrap=True)


def _numbers(result: CalibrationResult) -> list[str]:
    sigma = result.sigma
    lines = _vector("offset sensor to rotation centre", result.offset_sensor_pivot_m, sigma.offset_sensor_pivot_m)
    lines += _length("major radius", result.major_radius_m, sigma.major_radius_m)
    lines += _length("minor radius", result.minor_radius_m, sigma.minor_radius_m)
    skew = result.axis_non_orthogonality_rad
    if skew is not None:
        lines.append(_line("non-orthogonality", np.degrees(skew), _degrees(sigma.axis_non_orthogonality_rad), "deg"))
    lines += _direction("orbital axis in the sensor", result.orbital_axis_sensor, sigma.orbital_axis_sensor)
    for k, placement in enumerate(result.placements):
        one = sigma.placements[k] if sigma.placements else None
        if len(result.placements) > 1:
            lines.append(f"placement {placement.label}")
        lines += _vector("centre in the world", placement.torus_center_world_m, one and one.torus_center_world_m)
        lines += _direction("angular axis in the world", placement.angular_axis_world, one and one.angular_axis_world)
    return lines


def _quality(result: CalibrationResult) -> list[str]:
    residuals, noise = result.residuals, result.noise
    rms = _both(residuals.translation_rms_m, residuals.rotation_rms_rad)
    level = _both(noise.translation_m, noise.rotation_rad)
    kind = "estimated" if noise.estimated else "given"
    return [f"{'residuals, rms':<{_NAME_WIDTH}}{rms}", f"{f'noise an axis, {kind}':<{_NAME_WIDTH}}{level}"]


def _both(length: float | None, angle: float | None) -> str:
    """A length and an angle, as far as they are known."""
    known = [] if length is None else [f"{length * 1e3:.3f} mm"]
    known += [] if angle is None else [f"{np.degrees(angle):.3f} deg"]
    return ", ".join(known)


def _line(name: str, value: float, sigma: float | None, unit: str) -> str:
    return f"{name:<{_NAME_WIDTH}}{value:>10.3f}" + ("" if sigma is None else f" ± {sigma:.3f}") + f" {unit}"


def _length(name: str, value: float | None, sigma: float | None) -> list[str]:
    return [] if value is None else [_line(name, value * 1e3, None if sigma is None else sigma * 1e3, "mm")]


def _vector(name: str, value: Array | None, sigma: Array | None) -> list[str]:
    if value is None:
        return []
    names = [f"{name}, x", f"{'':<{len(name)}}  y", f"{'':<{len(name)}}  z"]
    sigmas = [None] * 3 if sigma is None else list(sigma * 1e3)
    return [_line(n, v * 1e3, s, "mm") for n, v, s in zip(names, value, sigmas, strict=True)]


def _direction(name: str, value: Array | None, sigma: Array | None) -> list[str]:
    if value is None:
        return []
    text = f"{name:<{_NAME_WIDTH}}({value[0]:+.5f}, {value[1]:+.5f}, {value[2]:+.5f})"
    return [text if sigma is None else f"{text} ± {np.degrees(np.linalg.norm(sigma)):.4f} deg"]


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else float(np.degrees(angle))
