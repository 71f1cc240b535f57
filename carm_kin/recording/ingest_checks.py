"""What in a recording contradicts what was declared of its file."""

from collections.abc import Iterable, Iterator

import numpy as np

from carm_kin.recording.declarations import UNITS_M, Declarations
from carm_kin.recording.intake import Intake
from carm_kin.recording.raw import Raw
from carm_kin.recording.recording import Recording
from solvers.estimate import Note
from solvers.se3 import Array

TURNED_RAD = float(np.radians(10.0))
"""Range of orientations from which on the distance of the sensor from what it turns about can be judged."""
LEVER_M = (0.02, 10.0)
"""A sensor closer to or farther from what it turns about is none on a C-arm."""
USUAL_M = (0.05, 3.0)
"""Where it usually is, and"""
TYPICAL_M = 0.5
GAP = 10.0
"""An interval of this many times the median is a gap,"""
GAP_S = 1.0
"""if it is also longer than this."""


def notes_of(recording: Recording, raw: Raw, declared: Declarations) -> Iterator[Note]:
    """The contradictions, each with what would agree."""
    for option in ("unit", "quaternion", "euler", "left_handed"):
        says, states = getattr(raw, option), getattr(declared, option)
        if says and states is not None and says != states:
            option = option.replace("_", "-")
            yield Note("contradicts_file", f"--{option} {states} was followed, but the file's own {option} is {says}")
    unit = declared.unit or raw.unit
    if unit and recording.R_world_sensor is not None:
        yield from _implausible_unit(recording.p_world_sensor, recording.R_world_sensor, unit)
    if recording.time_s is not None:
        yield from _gaps(recording, recording.time_s)


def contradicted(intakes: Iterable[Intake], causes: Iterable[Note]) -> Iterator[Note]:
    """What the causes of a misfit, found by calibrating, say of how the files were read."""
    stated = dict.fromkeys(option for one in intakes for option in one.stated)
    for code in {cause.code: None for cause in causes}:
        otherwise = _otherwise(code, list(stated))
        if otherwise and any(one.format != "csv" or one.stated for one in intakes):
            message = (
                f"the poses contradict how the file was read ({' '.join(stated) or 'without options'}): {otherwise}"
            )
            yield Note("contradicts_declaration", message)


def _otherwise(code: str, stated: list[str]) -> str:
    """How to read it otherwise; "" where no option does."""
    if code == "quaternion_order" and any(option.startswith("--quaternion") for option in stated):
        return f"read it with --quaternion {'xyzw' if '--quaternion wxyz' in stated else 'wxyz'}"
    if code == "inverted_poses":
        return "read it without --invert" if "--invert" in stated else "read it with --invert"
    if code == "left_handed_frame":
        return "read it with " + ("--right-handed" if "--left-handed" in stated else "--left-handed")
    if code == "transposed_rotation":
        euler = any(option.startswith("--euler") for option in stated)
        return "read it with another order of --euler" if euler else ""
    return ""


def _implausible_unit(p: Array, R: Array, unit: str) -> Iterator[Note]:
    """The distance that the sensor travels over the angle that it turns by is its distance from the axis."""
    some = slice(None, None, max(1, len(p) // 1000))
    cosine = (np.einsum("nij,ij->n", R[some], R[0]) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1))
    if angle.max() < TURNED_RAD:
        return
    lever = np.linalg.norm(p[some] - p[0], axis=1)[np.argmax(angle)] / (2 * np.sin(angle.max() / 2))
    if LEVER_M[0] <= lever <= LEVER_M[1]:
        return
    otherwise = {u: lever * size / UNITS_M[unit] for u, size in UNITS_M.items()}
    best = min(otherwise, key=lambda u: abs(np.log(max(otherwise[u], 1e-9) / TYPICAL_M)))
    fits = USUAL_M[0] <= otherwise[best] <= USUAL_M[1]
    meant = f"; read with --unit {best} it would be {otherwise[best] * 1e3:.3g} mm" if fits else ""
    yield Note(
        "implausible_unit",
        f"read in {unit}, the sensor seems to be {lever * 1e3:.3g} mm from what it turns about, as on no C-arm{meant}",
    )


def _gaps(recording: Recording, time_s: Array) -> Iterator[Note]:
    step = np.diff(time_s)
    if not step.size:
        return
    gap = np.flatnonzero((step > GAP * np.median(step)) & (step > GAP_S))
    if gap.size:
        longest = gap[np.argmax(step[gap])]
        message = f"{len(gap)} gaps in time, the longest of {step[longest]:.3g} s after pose "
        yield Note("time_gaps", f"{message}{recording.pose_number[longest]}")
