"""A length that the user knows, and what it says of the tracker's scale: docs/estimation.md, "A known length".

Nothing in the poses tells a scale of all positions. A gauge of known length, as the tracker measured it, or a length of
the machine from its data sheet does.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from carm_kin.calibration.assembly import sigma_of
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.results.parts import SigmaPart, ToldOffset, TrackerScale
from carm_kin.results.result import CalibrationResult
from solvers.estimate import Covariance, Note
from solvers.se3 import Array

OF_MACHINE = ("major_radius", "minor_radius")
"""Lengths of the machine that may be known."""
LEAST, MOST = 0.5, 2.0
"""Scales beyond these are a wrong unit or a wrong length."""
MOST_RELATIVE_SIGMA = 0.05
"""A length of the machine that the poses tell less well says nothing of the scale."""
NEAR = 0.01
"""No tracker is off by more: a scale that is gets a warning."""
FORM = re.compile(r"([a-z_]+|[0-9.eE]+):([0-9.eE]+)(?:(?:\+-|±)([0-9.eE]+))?")
EXAMPLES = "'400:400.8' (true length and the same as tracked, mm) or 'major_radius:80', each with '+-0.1' behind it"


@dataclass(frozen=True)
class KnownLength:
    """As it was given."""

    text: str
    true_m: float
    sigma_m: float
    """One standard deviation of the true length."""
    tracked_m: float | None
    """A gauge as the tracker measured it; None for a length of the machine."""
    name: str
    """Of the machine's length; "" for a gauge."""

    @staticmethod
    def of(text: str) -> "KnownLength":
        """Raises InputError for a text of another form, and for lengths that are not above 0."""
        found = FORM.fullmatch(text.replace(" ", "")) if isinstance(text, str) else None
        if found is None:
            raise InputError(f"known_length '{text}' must be of the form {EXAMPLES}")
        first, second, sigma = found.groups()
        try:
            numbers = [float(x) for x in (*(() if first in OF_MACHINE else (first,)), second, sigma or "0")]
        except ValueError:
            known = ", ".join(OF_MACHINE)
            raise InputError(f"known_length '{text}': '{first}' is neither a length nor one of {known}") from None
        if not all(np.isfinite(numbers)) or min(numbers[:-1]) <= 0:
            raise InputError(f"known_length '{text}': lengths must be finite and above 0")
        gauge = first not in OF_MACHINE
        true, tracked = numbers[0] * 1e-3, numbers[1] * 1e-3 if gauge else None
        return KnownLength(text, true, numbers[-1] * 1e-3, tracked, "" if gauge else first)

    def scale_by(self, result: CalibrationResult | None) -> float:
        """True over tracked length; a machine's by the calibration of the recording as it is.

        Raises InputError for a scale that no tracker has, and where the poses do not tell the machine's length.
        """
        tracked = self.tracked_m
        if tracked is None:
            tracked = None if result is None else getattr(result, f"{self.name}_m")
            sigma = None if result is None else getattr(result.sigma, f"{self.name}_m")
            of_machine = self.name.replace("_", " ")
            if result is not None and tracked and result.covariance is None:
                raise InputError(
                    f"known_length '{self.text}': '{result.solver}' gives the {of_machine} no uncertainty here; use "
                    "the solver 'kinematic', or a gauge"
                )
            if not tracked or sigma is None or sigma > MOST_RELATIVE_SIGMA * tracked:
                raise InputError(
                    f"known_length '{self.text}': the recording does not tell the {of_machine} to "
                    f"{MOST_RELATIVE_SIGMA:.0%}, so that it says nothing of the tracker's scale"
                )
        scale = self.true_m / tracked
        if not LEAST <= scale <= MOST:
            raise InputError(
                f"known_length '{self.text}': {self.true_m * 1e3:.6g} mm are {tracked * 1e3:.6g} mm by the tracker, a "
                "scale that no tracker has; is a unit or the length wrong?"
            )
        return scale


def scaled(recording: Recording, scale: float) -> Recording:
    """The recording with all positions times ``scale``."""
    return replace(recording, p_world_sensor=recording.p_world_sensor * scale)


def in_scale_of(result: CalibrationResult, recording: Recording) -> Recording:
    """A recording of the same tracker, in the scale of a result."""
    return recording if result.tracker_scale is None else scaled(recording, result.tracker_scale.scale)


def with_scale(result: CalibrationResult, known: KnownLength, scale: float) -> CalibrationResult:
    """The result of the scaled recording, whose uncertainty has that of the length.

    With y the reported lengths, L the known one and v the machine's: y L / v has the covariance
    A Cov Aᵀ + (σ_L / L)² y yᵀ, A = I - y e_vᵀ / v; a gauge has A = I.
    """
    relative = known.sigma_m / known.true_m
    part = TrackerScale(scale, scale * relative, known.text)
    result = replace(result, warnings=(*result.warnings, *_far_off(known, scale)))
    if result.covariance is None:
        told = result.told and _told(result.told, relative)
        return replace(result, tracker_scale=part, told=told)
    names = result.covariance.names
    y, A = _lengths(result, names), np.eye(len(names))
    if known.name in names:
        v = names.index(known.name)
        A[:, v] -= y / y[v]
        of_length = float(result.covariance.matrix[v, v])
        part = replace(part, sigma=scale * float(np.hypot(relative, np.sqrt(of_length) / abs(y[v]))))
    of_fit, of_true = A @ result.covariance.matrix @ A.T, relative**2 * np.outer(y, y)
    matrix = of_fit + of_true
    covariance = Covariance(names, 0.5 * (matrix + matrix.T))
    return replace(
        result,
        covariance=covariance,
        sigma=sigma_of(covariance, len(result.placements)),
        sigma_parts=_parts(result, Covariance(names, of_fit), Covariance(names, of_true)),
        tracker_scale=part,
    )


def _far_off(known: KnownLength, scale: float) -> tuple[Note, ...]:
    if abs(scale - 1) <= NEAR:
        return ()
    message = (
        f"by the known length '{known.text}' the tracker's scale is off by {scale - 1:+.1%}, as that of no tracker"
    )
    return (Note("tracker_scale", f"{message}; is the length of another unit, or of another part?"),)


def _told(told: ToldOffset, relative: float) -> ToldOffset:
    """What is told of an offset, its lengths uncertain by ``relative`` in common."""
    rows = [replace(one, sigma_m=float(np.hypot(one.sigma_m, relative * one.offset_m))) for one in told.told]
    return replace(told, told=tuple(rows))


def _parts(result: CalibrationResult, of_fit: Covariance, of_true: Covariance) -> tuple[SigmaPart, ...]:
    """The parts of the fit's ± in the proportion they had, and that of the true length."""
    if not result.sigma_parts or result.covariance is None:
        return result.sigma_parts
    offset = [f"offset_sensor_pivot_{axis}" for axis in "xyz"]

    before, after, true = (
        np.append(covariance.sigma(*offset), covariance.sigma("major_radius"))
        for covariance in (result.covariance, of_fit, of_true)
    )
    grown = np.divide(after, before, out=np.ones(4), where=before > 0)
    parts = [
        replace(
            one,
            offset_sensor_pivot_m=one.offset_sensor_pivot_m * grown[:3],
            major_radius_m=one.major_radius_m * float(grown[3]),
        )
        for one in result.sigma_parts
    ]
    return (*parts, SigmaPart("scale", true[:3], float(true[3]))) if true.any() else tuple(parts)


def _lengths(result: CalibrationResult, names: tuple[str, ...]) -> Array:
    """(K,) the reported lengths, 0 for angles and directions."""
    values: dict[str, float] = {}

    def put(name: str, vector: Array | None) -> None:
        if vector is not None:
            values.update({f"{name}_{axis}": float(x) for axis, x in zip("xyz", vector, strict=True)})

    put("offset_sensor_pivot", result.offset_sensor_pivot_m)
    for k, placement in enumerate(result.placements):
        put(f"torus_center_world[{k}]", placement.torus_center_world_m)
    signed = result.major_radius_signed_m
    values["major_radius"] = (signed if signed is not None else result.major_radius_m) or 0.0
    values["minor_radius"] = result.minor_radius_m or 0.0
    return np.array([values.get(name, 0.0) for name in names])
