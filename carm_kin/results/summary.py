"""A result in words, for the terminal, for `print` and for a notebook: one fact a line, each within 80 columns."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from carm_kin.errors import printable
from carm_kin.recording.intake import Intake
from carm_kin.results.chain_result import ChainCalibration
from carm_kin.results.held_out import HeldOut
from carm_kin.results.parts import SigmaPart, ToldOffset
from carm_kin.results.shown import FIXED, NOT_DETERMINED, determined, direction_determined, length_determined
from solvers.estimate import MEANINGLESS_M, MEANINGLESS_RAD, Note
from solvers.se3 import Array

if TYPE_CHECKING:
    from rich.console import Console

    from carm_kin.results.check_result import Angle, Check, Length
    from carm_kin.results.result import CalibrationResult
    from carm_kin.results.virtual_centre_result import VirtualCentre

_NAME_WIDTH = 34
NOT_TOLD = "not told"
MOST_PARTS, LEAST_PART = 4, 0.1
"""Of the uncertainty that are named, and the least share of the greatest one."""
MOST_SIGMA = {"mm": MEANINGLESS_M * 1e3, "deg": float(np.degrees(MEANINGLESS_RAD))}
"""A number that is uncertain by more is not determined."""


class Row(NamedTuple):
    """A number with its name, as words; a row without a value is a line of text."""

    name: str
    value: str = ""
    sigma: str = ""
    unit: str = ""

    @property
    def text(self) -> str:
        """The row in its columns."""
        if not self.value:
            return self.name
        sigma, unit = (f" ± {self.sigma}" if self.sigma else ""), (f" {self.unit}" if self.unit else "")
        return f"{self.name:<{_NAME_WIDTH}}{self.value}{sigma}{unit}"


class Line(NamedTuple):
    """One line of a summary."""

    text: str
    head: str = ""
    """What stands before the text, in a style of its own."""
    style: str = ""


def show(result: "CalibrationResult", console: "Console") -> None:
    """Print the verdict, the numbers with their sigmas and what the poses leave; the warnings are the caller's."""
    _print(result_lines(result), console)


def show_check(check: "Check", console: "Console") -> None:
    """Print what was compared, what failed, and what this recording cannot show; the verdict is the caller's."""
    _print(check_lines(check), console)


def show_centre(found: "VirtualCentre", console: "Console") -> None:
    """Print where the virtual centre is and how far it moved; the verdict is the caller's."""
    _print(centre_lines(found), console)


def show_intakes(intakes: tuple[Intake, ...], console: "Console") -> None:
    """Print how many frames were read, kept, and dropped for which reason; nothing of a sound native file."""
    _print(_intake_lines(intakes), console)


def show_numbers(result: "CalibrationResult", console: "Console") -> None:
    """Print the numbers with their sigmas alone."""
    _print(_indented(_numbers(result)), console)


def show_warnings(warnings: Iterable[Note], console: "Console") -> None:
    """Print the warnings of a result, a line each."""
    _print(_warning_lines(warnings), console)


def text_of(lines: Sequence[Line], warnings: Iterable[Note], refusal: Note | None = None) -> str:
    """The lines as `show` prints them, the warnings, and what a command says of the ``refusal`` below them."""
    every = [*lines, *_warning_lines(warnings)]
    if refusal:
        every.append(Line(refusal.message, f"refused ({refusal.code}): "))
    return "\n".join(printable(line.head + line.text) for line in every)


def in_mm(value: Array, sigma: Array | None) -> str:
    """A vector (3,), m, on one line: ``(x, y, z) ± (x, y, z) mm``."""
    if not length_determined(sigma):
        return NOT_DETERMINED
    words = [f"({', '.join(f'{x * 1e3:.3f}' for x in vector)})" for vector in (value, sigma) if vector is not None]
    return f"{' ± '.join(words)} mm"


def _print(lines: Sequence[Line], console: "Console") -> None:
    for line in lines:
        if line.head:
            console.print(line.head, style=line.style, end="")
        console.print(line.text, soft_wrap=True)


def result_lines(result: "CalibrationResult") -> list[Line]:
    """The verdict, the numbers with their sigmas and what the poses leave."""
    return [
        Line(f"solver {result.solver}, {result.used} of {result.poses} poses", *_verdict(result.status)),
        *_intake_lines(result.provenance.intakes),
        *_indented(result_rows(result)),
    ]


def result_rows(result: "CalibrationResult") -> list[Row]:
    """The numbers with their sigmas, and how good they are."""
    rows = [*_numbers(result), *_quality(result), *(_chain(result.chain) if result.chain else ())]
    if result.cross_validation:
        parts = (result.cross_validation.overall, *result.cross_validation.per_fold)
        rows += [Row(f"held out, {row.label}", _held_out(row)) for row in parts]
    return rows


def check_lines(check: "Check") -> list[Line]:
    """What was compared, what failed, and what this recording cannot show."""
    compared = {
        "offset": check.offset,
        "orbital axis": check.orbital_axis,
        "turn about the orbital axis": check.orbital_zero,
        "major radius": check.major_radius,
        "non-orthogonality": check.non_orthogonality,
        "pose positions": check.pose_position,
        "pose orientations": check.pose_rotation,
    }
    return [
        Line(f"{check.used} of {check.poses} poses compared with the saved calibration"),
        *_indented([_change(name, change) for name, change in compared.items() if change is not None]),
        *_indented([Row(f"not seen: {words}") for words in check.unseen]),
    ]


def centre_lines(found: "VirtualCentre") -> list[Line]:
    """Where the virtual centre is and how far it moved."""
    turn = "" if found.turn_rad is None else f" over {np.degrees(found.turn_rad):.1f} deg"
    sigma, spread = found.sigma, found.spread
    rows = [
        *_vector("virtual centre in the C-arm", found.centre_carm_m, sigma and sigma.centre_carm_m),
        *_vector("in the sensor", found.centre_sensor_m, sigma and sigma.centre_sensor_m),
        *_vector("in the world", found.centre_world_m, sigma and sigma.centre_world_m),
        *_length("circle of the rotation centre", found.path_radius_m, sigma and sigma.path_radius_m),
        *_length("distance from that circle, rms", found.path_rms_m, None),
    ]
    if found.alpha_rad is not None:
        rows.append(_row("angle about the angular axis", float(np.degrees(found.alpha_rad)), None, "deg"))
    if spread:
        rows += _length("spread of the centre, rms", spread.rms_m, None)
        rows += _length("of it by noise", spread.noise_m, None)
        rows += _length("largest", spread.largest_m, None, f" (pose {spread.largest_pose})")
    return [Line(f"{found.used} of {found.poses} poses{turn}"), *_indented(rows)]


def _verdict(status: str) -> tuple[str, str]:
    colours = {"ok": "bold green", "doubtful": "bold yellow", "partial": "bold yellow"}
    return f"{status}: ", colours.get(status, "bold red")


def _indented(rows: Sequence[Row]) -> list[Line]:
    return [Line(f"  {row.text}") for row in rows]


def _intake_lines(intakes: tuple[Intake, ...]) -> list[Line]:
    lines = []
    for one in intakes:
        if one.kept == one.frames and one.format == "csv":
            continue
        what = ", ".join(filter(None, (one.format, one.tool, one.reference and f"in {one.reference}")))
        rows = {"kept": one.kept, **{drop.reason: drop.count for drop in one.dropped}}
        rows |= {"rotations projected": one.projected} if one.projected else {}
        rows |= {"stations": one.stations} if one.stations else {}
        lines.append(Line(f"  {'frames':<{_NAME_WIDTH}}{one.frames:>10} ({what})"))
        lines += [Line(f"    {name:<{_NAME_WIDTH - 2}}{count:>10}") for name, count in rows.items()]
    return lines


def _warning_lines(warnings: Iterable[Note]) -> list[Line]:
    return [Line(warning.message, f"warning ({warning.code}): ", "yellow") for warning in warnings]


def _change(name: str, change: "Length | Angle") -> Row:
    difference, limit, unit = change.shown
    failed = "" if change.within else "  FAILED"
    return Row(name, f"{difference:>10.3f}", unit=f"{unit}, at most {limit:.3f}{failed}")


def _held_out(row: HeldOut) -> str:
    if row.refusal or not row.dof or row.chi2_per_dof is None:
        return f"refused ({row.refusal.code}): {row.refusal.message}" if row.refusal else "no poses"
    errors = f"{_both(row.translation_rms_m, row.rotation_rms_rad)}, chi2/dof {row.chi2_per_dof:.2f}"
    if row.rotation_rms_rad is None:
        return errors
    return f"{errors}, angles absorb {6 - row.dof / row.poses:.1f} of 6"


def _numbers(result: "CalibrationResult") -> list[Row]:
    sigma = result.sigma
    rows = _told(result.told) if result.told else []
    rows += _vector("offset sensor to rotation centre", result.offset_sensor_pivot_m, sigma.offset_sensor_pivot_m)
    if length_determined(sigma.offset_sensor_pivot_m):
        rows += _length("offset off by at most (95%)", result.offset_within_95_m, None)
        rows += _parts(result.sigma_parts)
    rows += _major_radius(result)
    rows += _length("minor radius", result.minor_radius_m, _sigma_of(result, "minor_radius", sigma.minor_radius_m))
    skew = result.axis_non_orthogonality_rad
    if skew is not None:
        skew_sigma = _sigma_of(result, "axis_non_orthogonality", sigma.axis_non_orthogonality_rad)
        rows.append(_row("non-orthogonality", np.degrees(skew), _degrees(skew_sigma), "deg"))
    rows += _direction("orbital axis in the sensor", result.orbital_axis_sensor, sigma.orbital_axis_sensor)
    for k, placement in enumerate(result.placements):
        one = sigma.placements[k] if sigma.placements else None
        if len(result.placements) > 1:
            rows.append(Row(f"placement {placement.label}"))
        rows += _vector("centre in the world", placement.torus_center_world_m, one and one.torus_center_world_m)
        rows += _direction("angular axis in the world", placement.angular_axis_world, one and one.angular_axis_world)
    return rows


def _parts(parts: tuple[SigmaPart, ...]) -> list[Row]:
    """What the uncertainty of the offset is made of: the length of each part, those that count."""
    lengths = {part.cause: float(np.linalg.norm(part.offset_sensor_pivot_m)) * 1e3 for part in parts}
    counting = sorted(lengths, key=lambda cause: -lengths[cause])[:MOST_PARTS]
    counting = [cause for cause in lengths if cause in counting and lengths[cause] > LEAST_PART * max(lengths.values())]
    if len(counting) < 2:
        return []
    return [Row("its ± is made of", ", ".join(f"{cause} {lengths[cause]:.3f}" for cause in counting), unit="mm")]


def _sigma_of(result: "CalibrationResult", quantity: str, sigma: float | None) -> float | None:
    """0 of a quantity that was fixed."""
    return 0.0 if quantity in result.fixed else sigma


def _told(told: ToldOffset) -> list[Row]:
    """The told components, the line on which the pivot lies, and what is not told."""
    rows = [
        _row(f"offset along {_triple(one.direction_sensor)}", one.offset_m * 1e3, one.sigma_m * 1e3, "mm")
        for one in told.told
    ]
    for direction, sigma in zip(told.untold_directions_sensor, told.untold_sigma_rad, strict=True):
        rows.append(Row(f"offset along {_triple(direction)}", f"{NOT_TOLD:>10}"))
        if len(told.untold_directions_sensor) == 1:
            rows.append(Row("the rotation centre lies on a line in the sensor's frame, a spun tool's shaft:"))
            rows.append(Row("its point nearest the sensor", in_mm(told.nearest_sensor_m + 0.0, None)))
            rows.append(Row("its direction", _triple(direction), f"{np.degrees(sigma):.4f}", "deg"))
    return rows


def _triple(direction: Array) -> str:
    return f"({', '.join(f'{x:+.3f}' for x in np.round(direction, 3) + 0.0)})"


def _major_radius(result: "CalibrationResult") -> list[Row]:
    """With an upper limit instead of a sigma where the interval is one-sided."""
    interval = result.major_radius_interval_95_m
    if interval is None or interval[0] > 0:
        sigma = _sigma_of(result, "major_radius", result.sigma.major_radius_m)
        return _length("major radius", result.major_radius_m, sigma)
    if not length_determined(result.sigma.major_radius_m):
        return [Row("major radius", NOT_DETERMINED)]
    return _length("major radius", result.major_radius_m, None, f", at most {interval[1] * 1e3:.3f} mm (95%)")


def _quality(result: "CalibrationResult") -> list[Row]:
    residuals, noise = result.residuals, result.noise
    if not noise.translation_m:
        return []  # there was no estimate
    rms = _both(residuals.translation_rms_m, residuals.rotation_rms_rad)
    level = _both(noise.translation_m, noise.rotation_rad)
    kind = "estimated" if noise.estimated else "given"
    rows = [Row("residuals, rms", rms), Row(f"noise an axis, {kind}", level)]
    if result.tracker_scale is not None:
        scale = result.tracker_scale
        rows.append(Row("tracker's scale", f"{scale.scale:>10.5f}", f"{scale.sigma:.5f}", f"by {scale.known_length}"))
    if noise.axes is not None:
        shifts, turns = noise.axes.translation_m * 1e3, np.degrees(noise.axes.rotation_rad)
        words = [", ".join(f"{x:.3f}" for x in values) for values in (shifts, turns)]
        rows.append(Row("along the tracker's axes", f"{words[0]} mm; {words[1]} deg"))
    if noise.effective_poses is not None and round(noise.effective_poses) < result.used:
        lasts = f"{result.used / noise.effective_poses:.1f} poses: {noise.effective_poses:.0f} of {result.used} count"
        rows.append(Row("noise correlated over", lasts))
    return rows


def _chain(chain: ChainCalibration) -> list[Row]:
    """What the URDF's numbers leave, and how they changed."""
    nominal = _both(chain.nominal.translation_rms_m, chain.nominal.rotation_rms_rad)
    found = [Row("residuals of the nominal URDF", nominal)]
    for joint in chain.joints:
        rows = [*zip("xyz", joint.shift_m * 1e3, joint.shift_sigma_m * 1e3, ["mm"] * 3, strict=True)]
        turns, sigmas = np.degrees(joint.turn_rad), np.degrees(joint.turn_sigma_rad)
        rows += zip(("rx", "ry", "rz"), turns, sigmas, ["deg"] * 3, strict=True)
        if joint.zero_rad is not None and joint.zero_sigma_rad is not None:
            rows.append(("zero", np.degrees(joint.zero_rad), np.degrees(joint.zero_sigma_rad), "deg"))
        if joint.zero_m is not None and joint.zero_sigma_m is not None:
            rows.append(("zero", joint.zero_m * 1e3, joint.zero_sigma_m * 1e3, "mm"))
        rows.append(("gain", joint.gain * 1e2, joint.gain_sigma * 1e2, "%"))
        found += [_row(f"change of {joint.joint}, {n}", v, s, unit) for n, v, s, unit in rows if n in joint.estimated]
    return [*found, *(Row(f"not told: {words}") for words in chain.not_identifiable)]


def _both(length: float | None, angle: float | None) -> str:
    """A length and an angle, as far as they are known."""
    known = [] if length is None else [f"{length * 1e3:.3f} mm"]
    known += [] if angle is None else [f"{np.degrees(angle):.3f} deg"]
    return ", ".join(known)


def _row(name: str, value: float, sigma: float | None, unit: str) -> Row:
    """A number with its ``sigma``: None where there is none, 0 where it is fixed."""
    if not determined(sigma, MOST_SIGMA.get(unit[:3].strip(" ,"), np.inf)):
        return Row(name, NOT_DETERMINED)
    if sigma == 0.0:
        return Row(name, f"{value:>10.3f}", unit=f"{unit} ({FIXED})")
    return Row(name, f"{value:>10.3f}", "" if sigma is None else f"{sigma:.3f}", unit)


def _length(name: str, value: float | None, sigma: float | None, more: str = "") -> list[Row]:
    """In mm; ``more`` stands behind the unit."""
    if value is None:
        return []
    return [_row(name, value * 1e3, None if sigma is None else sigma * 1e3, f"mm{more}")]


def _vector(name: str, value: Array | None, sigma: Array | None) -> list[Row]:
    if value is None:
        return []
    names = [f"{name}, x", f"{'':<{len(name)}}  y", f"{'':<{len(name)}}  z"]
    sigmas = [None] * 3 if sigma is None else list(sigma * 1e3)
    return [_row(n, v * 1e3, s, "mm") for n, v, s in zip(names, value, sigmas, strict=True)]


def _direction(name: str, value: Array | None, sigma: Array | None) -> list[Row]:
    if value is None:
        return []
    text = f"({value[0]:+.5f}, {value[1]:+.5f}, {value[2]:+.5f})"
    if not direction_determined(sigma):
        return [Row(name, NOT_DETERMINED)]
    return [Row(name, text) if sigma is None else Row(name, text, f"{np.degrees(np.linalg.norm(sigma)):.4f}", "deg")]


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else float(np.degrees(angle))
