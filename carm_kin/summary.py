"""A result in words, for the terminal."""

from rich.console import Console
from rich.table import Table

from carm_kin.result import CalibrationResult
from solvers.se3 import Array


def show(result: CalibrationResult, console: Console | None = None) -> None:
    """Print the verdict, the numbers with their sigmas, and the warnings; by default on stderr."""
    console = console or Console(stderr=True, highlight=False)
    verdict = "[bold green]ok[/]" if result.status == "ok" else "[bold red]refused[/]"
    console.print(f"{verdict}  solver {result.solver}, {result.used} of {result.poses} poses")
    if result.status == "ok":
        console.print(_numbers(result))
    console.print(_residuals(result))
    for warning in result.warnings:
        console.print(f"[yellow]warning[/] ({warning.code}): {warning.message}")


def _numbers(result: CalibrationResult) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    sigma = result.sigma
    _row(table, "offset sensor -> rotation centre", result.offset_sensor_pivot_m, sigma.offset_sensor_pivot_m, 1e3, "mm")
    _row(table, "major radius", result.major_radius_m, sigma.major_radius_m, 1e3, "mm")
    _row(table, "minor radius", result.minor_radius_m, sigma.minor_radius_m, 1e3, "mm")
    skew, skew_sigma = result.axis_non_orthogonality_rad, sigma.axis_non_orthogonality_rad
    _row(table, "non-orthogonality of the axes", skew, skew_sigma, 57.29577951308232, "deg")
    _row(table, "orbital axis (sensor frame)", result.orbital_axis_sensor, sigma.orbital_axis_sensor, 1.0, "")
    for k, placement in enumerate(result.placements):
        one = sigma.placements[k] if sigma.placements else None
        name = f" of placement {placement.label}" if len(result.placements) > 1 else ""
        center = placement.torus_center_world_m
        _row(table, f"centre{name} (world)", center, one.torus_center_world_m if one else None, 1e3, "mm")
        axis = placement.angular_axis_world
        _row(table, f"angular axis{name} (world)", axis, one.angular_axis_world if one else None, 1.0, "")
    return table


def _row(table: Table, name: str, value: Array | float | None, sigma: Array | float | None, scale: float, unit: str) -> None:
    if value is None:
        return
    digits = 3 if unit else 6
    table.add_row(name, _text(value, scale, digits), "" if sigma is None else f"± {_text(sigma, scale, digits)}", unit)


def _text(value: Array | float, scale: float, digits: int) -> str:
    if isinstance(value, float):
        return f"{value * scale:.{digits}f}"
    return "(" + ", ".join(f"{x * scale:.{digits}f}" for x in value) + ")"


def _residuals(result: CalibrationResult) -> str:
    residuals, noise = result.residuals, result.noise
    rotation = residuals.rotation_rms_rad
    text = f"residuals: {residuals.translation_rms_m * 1e3:.3f} mm rms"
    text += "" if rotation is None else f", {rotation * 57.29577951308232:.3f} deg rms"
    kind = "estimated" if noise.estimated else "given"
    text += f"; noise an axis ({kind}): {(noise.translation_m or 0.0) * 1e3:.3f} mm"
    return text + ("" if noise.rotation_rad is None else f", {noise.rotation_rad * 57.29577951308232:.3f} deg")
