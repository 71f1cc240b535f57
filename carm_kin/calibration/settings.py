"""How a recording is calibrated: the options of `carm-kin calibrate` as one value, and what they make of it."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import radians
from typing import Any

import solvers
from carm_kin.calibration.calibrate import calibrate
from carm_kin.calibration.cross_validate import cross_validate
from carm_kin.calibration.options import options_of
from carm_kin.cli.arguments import above_zero, joint_names
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.results.provenance import command_line
from carm_kin.results.result import CalibrationResult

CHAIN = "chain"
"""The solver of a URDF's whole chain."""


@dataclass(frozen=True)
class Settings:
    """What stands in a list of recordings, under the names of the command's options."""

    solver: str | None = None
    """One of `solvers.solver_names()`, or ``chain``; by default ``chain`` with a URDF, else ``kinematic``."""
    locus: str = "circle"
    urdf: str | None = None
    """A path or the name of a bundled machine."""
    angular: str | None = None
    orbital: str | None = None
    sensor_link: str | None = None
    sigma_t_mm: float | None = None
    sigma_r_deg: float | None = None
    cross_validate: int | None = None
    """Number of parts that are predicted by the fit to the others."""
    free: str = "all"
    """Of the chain: joints whose origin is unknown; all, axes, none or names, comma between."""
    zeros: str = "none"
    gains: str = "none"
    sigma_reading_deg: float | None = None
    sigma_reading_mm: float | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    """Those of the solver."""

    @property
    def solver_name(self) -> str:
        """The solver, by default that of the command."""
        if self.solver is not None:
            return self.solver
        if self.locus != "circle":
            return "direct"
        return "kinematic" if self.urdf is None else CHAIN

    def check(self) -> None:
        """Raise InputError for what is wrong whatever the recording."""
        name = self.solver_name
        if name == CHAIN and (self.urdf is None or self.locus != "circle"):
            raise InputError("the solver 'chain' needs a urdf, and the locus 'circle'")
        own = [name for name in _OF_CHAIN if getattr(self, name) != getattr(Settings(), name)]
        if own and name != CHAIN:
            raise InputError(f"{', '.join(own)}: needs the calibration of a chain, a urdf without another solver")
        if self.urdf is not None:
            from carm_kin.machine.urdf import read_urdf

            read_urdf(self.urdf)
        if self.cross_validate is not None and self.cross_validate < 2:
            raise InputError(f"cross_validate needs at least 2 parts, not {self.cross_validate}")
        _noise(self)
        if name == CHAIN:
            from solvers.chain.chain import Options
        elif name in solvers.solver_names():
            Options = solvers.solver(name).Options
        else:
            raise InputError(f"solver '{name}' is unknown; it is one of {', '.join((CHAIN, *solvers.solver_names()))}")
        options_of(Options, name, self.options)

    def command(self, path: str) -> str:
        """The command that makes the same result of the recording in ``path``."""
        arguments = ["calibrate", path]
        for name, value in vars(self).items():
            if name != "options" and value != getattr(Settings(), name):
                arguments += ["--" + name.replace("_", "-"), str(value)]
        for name, value in self.options.items():
            arguments += ["--option", f"{name}={value if isinstance(value, str) else json.dumps(value)}"]
        return command_line(arguments)


_OF_CHAIN = ("free", "zeros", "gains", "sigma_reading_deg", "sigma_reading_mm")


def calibrate_as(recording: Recording, settings: Settings, command: str | None = None) -> CalibrationResult:
    """Calibrate a recording as the settings say.

    Raises InputError where they are wrong, or the recording lacks what they need; a refusal is a result.
    """
    settings.check()
    calibrated = _chain if settings.solver_name == CHAIN else _two_axes
    return calibrated(recording, settings, command)


def two_axes_arguments(recording: Recording, settings: Settings) -> dict[str, Any]:
    """What `carm_kin.calibrate` takes besides the solver. Raises InputError for joints the recording does not have."""
    names = joint_names(recording, settings.urdf, settings.sensor_link, settings.angular, settings.orbital)
    chosen = {"locus": settings.locus, "angular": names[0], "orbital": names[1]}
    return chosen | _noise(settings) | dict(settings.options)


def _two_axes(recording: Recording, settings: Settings, command: str | None) -> CalibrationResult:
    chosen = two_axes_arguments(recording, settings)
    result = calibrate(recording, settings.solver, command=command, **chosen)
    if settings.cross_validate is None or result.refusal:
        return result
    held_out = cross_validate(recording, settings.cross_validate, settings.solver, **chosen)
    return replace(result, cross_validation=held_out)


def _chain(recording: Recording, settings: Settings, command: str | None) -> CalibrationResult:
    from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain

    assert settings.urdf is not None
    free, zeros, gains = (
        tuple(name.strip() for name in names.split(",")) for names in (settings.free, settings.zeros, settings.gains)
    )
    reading_deg, reading_mm = settings.sigma_reading_deg, settings.sigma_reading_mm
    return calibrate_chain(
        recording,
        settings.urdf,
        free=FreeJoints(free, zeros, gains),
        sensor_link=settings.sensor_link,
        angular=settings.angular,
        orbital=settings.orbital,
        sigma_reading_rad=None if reading_deg is None else radians(reading_deg),
        sigma_reading_m=None if reading_mm is None else reading_mm * 1e-3,
        folds=settings.cross_validate,
        command=command,
        **_noise(settings),
        **settings.options,
    )


def _noise(settings: Settings) -> dict[str, Any]:
    """The tracker's noise as `calibrate` takes it."""
    return {
        "sigma_t_m": above_zero("sigma_t_mm", settings.sigma_t_mm, 1e-3),
        "sigma_r_rad": above_zero("sigma_r_deg", settings.sigma_r_deg, radians(1)),
    }
