"""A recording calibrated as its settings say, as a C-arm of two axes or as the chain of its URDF."""

from collections.abc import Sequence
from dataclasses import replace
from math import radians
from typing import Any

from carm_kin.calibration.calibrate import calibrate
from carm_kin.calibration.settings import AUTO, CHAIN, Settings, only_with_chain
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.results.result import CalibrationResult


def calibrate_as(
    recordings: Recording | Sequence[Recording], settings: Settings, command: str | None = None
) -> CalibrationResult:
    """Calibrate a recording, or with a chain several, as the settings say.

    Raises InputError where they are wrong, or the recording lacks what they need; a refusal is a result.
    """
    settings.check()
    parts = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    if settings.solver_name == CHAIN:
        return _chain(parts, settings, command)
    if not parts:
        raise InputError("no recording is given")
    if len(parts) != 1:
        raise only_with_chain("several recordings")
    return _two_axes(parts[0], settings, command)


def two_axes_arguments(recording: Recording, settings: Settings) -> dict[str, Any]:
    """What `carm_kin.calibrate` takes besides the solver. Raises InputError for joints the recording does not have."""
    angular, orbital = settings.joint_names(recording)
    chosen: dict[str, Any] = {"locus": settings.locus, "angular": angular, "orbital": orbital}
    if settings.known_length is not None:
        chosen["known_length"] = settings.known_length
    if settings.systematic != AUTO:
        chosen["systematic"] = settings.systematic
    if settings.sigma_label_rad is not None:
        chosen["sigma_label_rad"] = settings.sigma_label_rad
    return chosen | settings.noise | dict(settings.options)


def _two_axes(recording: Recording, settings: Settings, command: str | None) -> CalibrationResult:
    chosen = two_axes_arguments(recording, settings)
    result = calibrate(recording, settings.solver, command=command, **chosen)
    if settings.cross_validate is None or result.status != "ok":
        return result
    from carm_kin.calibration.cross_validate import cross_validate

    held_out = cross_validate(recording, settings.cross_validate, settings.solver, **chosen)
    return replace(result, cross_validation=held_out)


def _chain(recordings: Sequence[Recording], settings: Settings, command: str | None) -> CalibrationResult:
    from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain

    assert settings.urdf is not None
    free, zeros, gains = (
        tuple(name.strip() for name in names.split(",")) for names in (settings.free, settings.zeros, settings.gains)
    )
    reading_deg, reading_mm = settings.sigma_reading_deg, settings.sigma_reading_mm
    return calibrate_chain(
        recordings,
        settings.urdf,
        free=FreeJoints(free, zeros, gains),
        sensor_link=settings.sensor_link,
        angular=settings.angular,
        orbital=settings.orbital,
        sigma_reading_rad=None if reading_deg is None else radians(reading_deg),
        sigma_reading_m=None if reading_mm is None else reading_mm * 1e-3,
        systematic=settings.systematic,
        folds=settings.cross_validate,
        command=command,
        **settings.noise,
        **settings.options,
    )
