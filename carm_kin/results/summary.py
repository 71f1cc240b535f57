"""A result in words, for the terminal: one fact a line, each within 80 columns."""

from collections.abc import Iterable

import numpy as np
from rich.console import Console

from carm_kin.recording.intake import Intake
from carm_kin.results.chain_result import ChainCalibration
from carm_kin.results.check_result import Angle, Check, Length
from carm_kin.results.held_out import HeldOut
from carm_kin.results.result import CalibrationResult
from carm_kin.results.virtual_centre_result import VirtualCentre
from solvers.estimate import Note
from solvers.se3 import Array

_NAME_WIDTH = 34


def show(result: CalibrationResult, console: Console) -> None:
    """Print the verdict, the numbers with their sigmas and what the poses leave."""
    verdict = f"solver {result.solver}, {result.used} of {result.poses} poses"
    console.print(f"{result.status}: ", style="bold green" if result.status == "ok" else "bold red", end="")
    console.print(verdict)
    show_intakes(result.provenance.intakes, console)
    show_numbers(result, console)
    for line in _quality(result):
        console.print(f"  {line}", soft_wrap=True)
    for line in _chain(result.chain) if result.chain else ():
        console.print(f"  {line}", soft_wrap=True)
    if result.cross_validation:
        for row in (result.cross_validation.overall, *result.cross_validation.per_fold):
            console.print(f"  {f'held out, {row.label}':<{_NAME_WIDTH}}{_held_out(row)}", soft_wrap=True)


def show_check(check: Check, console: Console) -> None:
    """Print what was compared, what failed, and what this recording cannot show; the verdict is the caller's."""
    compared = {
        "offset": check.offset,
        "orbital axis": check.orbital_axis,
        "turn about the orbital axis": check.orbital_zero,
        "major radius": check.major_radius,
        "non-orthogonality": check.non_orthogonality,
        "pose positions": check.pose_position,
        "pose orientations": check.pose_rotation,
    }
    console.print(f"{check.used} of {check.poses} poses compared with the saved calibration")
    for name, change in compared.items():
        if change is not None:
            console.print(f"  {name:<{_NAME_WIDTH}}{_change(change)}", soft_wrap=True)
    for words in check.unseen:
        console.print(f"  not seen: {words}", soft_wrap=True)


def show_centre(found: VirtualCentre, console: Console) -> None:
    """Print where the virtual centre is and how far it moved; the verdict is the caller's."""
    turn = "" if found.turn_rad is None else f" over {np.degrees(found.turn_rad):.1f} deg"
    console.print(f"{found.used} of {found.poses} poses{turn}")
    sigma, spread = found.sigma, found.spread
    lines = [
        *_vector("virtual centre in the C-arm", found.centre_carm_m, sigma and sigma.centre_carm_m),
        *_vector("in the sensor", found.centre_sensor_m, sigma and sigma.centre_sensor_m),
        *_vector("in the world", found.centre_world_m, sigma and sigma.centre_world_m),
        *_length("circle of the rotation centre", found.path_radius_m, sigma and sigma.path_radius_m),
        *_length("distance from that circle, rms", found.path_rms_m, None),
    ]
    if found.alpha_rad is not None:
        lines.append(_line("angle about the angular axis", float(np.degrees(found.alpha_rad)), None, "deg"))
    if spread:
        lines += _length("spread of the centre, rms", spread.rms_m, None)
        lines += _length("of it by noise", spread.noise_m, None)
        lines += [f"{line} (pose {spread.largest_pose})" for line in _length("largest", spread.largest_m, None)]
    for line in lines:
        console.print(f"  {line}", soft_wrap=True)


def show_intakes(intakes: tuple[Intake, ...], console: Console) -> None:
    """Print how many frames were read, kept, and dropped for which reason; nothing of a sound native file."""
    for one in intakes:
        if one.kept == one.frames and one.format == "csv":
            continue
        what = ", ".join(filter(None, (one.format, one.tool, one.reference and f"in {one.reference}")))
        rows = {"kept": one.kept, **{drop.reason: drop.count for drop in one.dropped}}
        rows |= {"rotations projected": one.projected} if one.projected else {}
        rows |= {"stations": one.stations} if one.stations else {}
        console.print(f"  {'frames':<{_NAME_WIDTH}}{one.frames:>10} ({what})", soft_wrap=True)
        for name, count in rows.items():
            console.print(f"    {name:<{_NAME_WIDTH - 2}}{count:>10}", soft_wrap=True)


def show_warnings(warnings: Iterable[Note], console: Console) -> None:
    """Print the warnings of a result, a line each."""
    for warning in warnings:
        console.print(f"warning ({warning.code}): ", style="yellow", end="")
        console.print(warning.message, soft_wrap=True)


def _change(change: Length | Angle) -> str:
    if isinstance(change, Length):
        values, unit = (change.difference_m * 1e3, change.limit_m * 1e3), "mm"
    else:
        values, unit = (np.degrees(change.difference_rad), np.degrees(change.limit_rad)), "deg"
    return f"{values[0]:>10.3f} {unit}, at most {values[1]:.3f}" + ("" if change.within else "  FAILED")


def _held_out(row: HeldOut) -> str:
    if row.refusal or not row.dof or row.chi2_per_dof is None:
        return f"refused ({row.refusal.code}): {row.refusal.message}" if row.refusal else "no poses"
    absorbed = 6 - row.dof / row.poses
    errors = _both(row.translation_rms_m, row.rotation_rms_rad)
    return f"{errors}, chi2/dof {row.chi2_per_dof:.2f}, angles absorb {absorbed:.1f} of 6"


def show_numbers(result: CalibrationResult, console: Console) -> None:
    """Print the numbers with their sigmas alone."""
    for line in _numbers(result):
        console.print(f"  {line}", soft_wrap=True)


def _numbers(result: CalibrationResult) -> list[str]:
    sigma = result.sigma
    lines = _vector("offset sensor to rotation centre", result.offset_sensor_pivot_m, sigma.offset_sensor_pivot_m)
    lines += _major_radius(result)
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


def _major_radius(result: CalibrationResult) -> list[str]:
    """With an upper limit instead of a sigma where the interval is one-sided."""
    interval = result.major_radius_interval_95_m
    if interval is None or interval[0] > 0:
        return _length("major radius", result.major_radius_m, result.sigma.major_radius_m)
    (line,) = _length("major radius", result.major_radius_m, None)
    return [f"{line}, at most {interval[1] * 1e3:.3f} mm (95%)"]


def _quality(result: CalibrationResult) -> list[str]:
    residuals, noise = result.residuals, result.noise
    rms = _both(residuals.translation_rms_m, residuals.rotation_rms_rad)
    level = _both(noise.translation_m, noise.rotation_rad)
    kind = "estimated" if noise.estimated else "given"
    return [f"{'residuals, rms':<{_NAME_WIDTH}}{rms}", f"{f'noise an axis, {kind}':<{_NAME_WIDTH}}{level}"]


def _chain(chain: ChainCalibration) -> list[str]:
    """What the URDF's numbers leave, and how they changed."""
    nominal = _both(chain.nominal.translation_rms_m, chain.nominal.rotation_rms_rad)
    lines = [f"{'residuals of the nominal URDF':<{_NAME_WIDTH}}{nominal}"]
    for joint in chain.joints:
        rows = [*zip("xyz", joint.shift_m * 1e3, joint.shift_sigma_m * 1e3, ["mm"] * 3, strict=True)]
        turns, sigmas = np.degrees(joint.turn_rad), np.degrees(joint.turn_sigma_rad)
        rows += zip(("rx", "ry", "rz"), turns, sigmas, ["deg"] * 3, strict=True)
        if joint.zero_rad is not None and joint.zero_sigma_rad is not None:
            rows.append(("zero", np.degrees(joint.zero_rad), np.degrees(joint.zero_sigma_rad), "deg"))
        if joint.zero_m is not None and joint.zero_sigma_m is not None:
            rows.append(("zero", joint.zero_m * 1e3, joint.zero_sigma_m * 1e3, "mm"))
        rows.append(("gain", joint.gain * 1e2, joint.gain_sigma * 1e2, "%"))
        lines += [_line(f"change of {joint.joint}, {n}", v, s, unit) for n, v, s, unit in rows if n in joint.estimated]
    return [*lines, *(f"not told: {words}" for words in chain.not_identifiable)]


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
