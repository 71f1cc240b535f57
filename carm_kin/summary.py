"""A result in words, for the terminal."""

import numpy as np
from rich.console import Console

from carm_kin.result import CalibrationResult
from solvers.se3 import Array


def show(result: CalibrationResult, console: Console | None = None) -> None:
    """Print the verdict, the numbers with their sigmas, and the warnings; by default on stderr."""
    console = console or Console(stderr=True, highlight=False)
    verdict = "[bold green]ok[/]" if result.status == "ok" else "[bold red]refused[/]"
    console.print(f"{verdict}: solver {result.solver}, {result.used} of {result.poses} poses")
    for line in (*_numbers(result), *_quality(result)):
        console.print(f"  {line}", soft_wrap=True)
    for warning in result.warnings:
        console.print(f"[yellow]warning[/] ({warning.code}): {warning.message}", soft_wrap=True)


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
        where = f", placement {placement.label}" if len(result.placements) > 1 else ""
        lines += _vector(
            f"centre in the world{where}", placement.torus_center_world_m, one and one.torus_center_world_m
        )
        lines += _direction(f"angular axis{where}", placement.angular_axis_world, one and one.angular_axis_world)
    return lines


def _quality(result: CalibrationResult) -> list[str]:
    residuals, noise = result.residuals, result.noise
    rms = f"{residuals.translation_rms_m * 1e3:.3f} mm"
    level = f"{(noise.translation_m or 0.0) * 1e3:.3f} mm"
    if residuals.rotation_rms_rad is not None and noise.rotation_rad is not None:
        rms += f", {np.degrees(residuals.rotation_rms_rad):.3f} deg"
        level += f", {np.degrees(noise.rotation_rad):.3f} deg"
    kind = "estimated" if noise.estimated else "given"
    return [f"{'residuals, rms':<34}{rms}", f"{f'noise an axis, {kind}':<34}{level}"]


def _line(name: str, value: float, sigma: float | None, unit: str) -> str:
    return f"{name:<34}{value:>10.3f}" + ("" if sigma is None else f" ± {sigma:.3f}") + f" {unit}"


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
    text = f"{name:<34}({value[0]:+.5f}, {value[1]:+.5f}, {value[2]:+.5f})"
    return [text if sigma is None else f"{text} ± {np.degrees(np.linalg.norm(sigma)):.4f} deg"]


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else float(np.degrees(angle))
