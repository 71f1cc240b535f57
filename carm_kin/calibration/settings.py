"""How a recording is calibrated: the options of `carm-kin calibrate` as one value, and which of them go together.

The command, a batch, a comparison and `carm_kin.calibrate` take their rules from here.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import radians
from typing import Any

import solvers
from carm_kin.calibration.options import options_of
from carm_kin.errors import InputError
from carm_kin.recording.recording import Recording
from carm_kin.results.provenance import command_line
from carm_kin.typed import above_zero, check_from_zero
from solvers.plugins import PluginError

CHAIN = "chain"
"""The solver of a URDF's whole chain."""
CIRCLE = "circle"
"""The locus of a C-arm's pivot."""
POINT = "point"
"""The locus of a pointer's tip."""
AUTO = "auto"
"""All systematic effects that the data ask for."""
LOCUS_SOLVER = "direct"
"""The solver that takes any locus."""

Named = Callable[[str], str]
"""What a setting is called where it was given, such as ``--sigma-t-mm`` for ``sigma_t_mm``."""


def solver_for(solver: str | None, locus: str = CIRCLE, urdf: str | None = None) -> str:
    """The solver that is meant: the given one, else ``direct`` for another locus than a C-arm's, ``chain`` with a URDF,
    ``kinematic``.

    Raises InputError where solver, locus and URDF do not go together.
    """
    name = solver or (LOCUS_SOLVER if locus != CIRCLE else CHAIN if urdf is not None else "kinematic")
    if name == CHAIN and (urdf is None or locus != CIRCLE):
        needs = "a urdf (--urdf; in Python calibrate_chain(recording, urdf)), and the locus 'circle'"
        raise InputError(f"the solver 'chain' needs {needs}")
    if locus != CIRCLE and name != LOCUS_SOLVER:
        raise InputError(f"locus '{locus}' needs the solver '{LOCUS_SOLVER}', not '{name}'")
    return name


def effects_of(systematic: str | Sequence[str]) -> tuple[str, ...]:
    """The names of the effects that are meant by ``auto``, ``none``, or a list of them, as text with commas or not.

    Raises InputError for an effect that there is not.
    """
    from solvers.effects.columns import EFFECTS

    if systematic == AUTO:
        return tuple(EFFECTS)
    if systematic == "none":
        return ()
    names = systematic.split(",") if isinstance(systematic, str) else list(systematic)
    names = [name.strip() for name in names]
    for name in names:
        if name not in EFFECTS:
            raise InputError(f"systematic: '{name}' is no effect; give auto, none, or some of {', '.join(EFFECTS)}")
    return tuple(name for name in EFFECTS if name in names)


def options_class(solver: str) -> type:
    """The dataclass of a solver's options. Raises InputError for an unknown solver."""
    if solver == CHAIN:
        from solvers.chain.chain import Options

        return Options
    try:
        return solvers.solver(solver).Options
    except KeyError:
        known = ", ".join((CHAIN, *solvers.solver_names()))
        raise InputError(f"solver '{solver}' is unknown; it is one of {known}") from None
    except PluginError as error:
        raise InputError(f"solver {error}") from None


@dataclass(frozen=True)
class Settings:
    """What stands in a list of recordings, under the names of the command's options."""

    solver: str | None = None
    """One of `solvers.solver_names()`, or ``chain``; by default that of `solver_for`."""
    locus: str = CIRCLE
    urdf: str | None = None
    """A path or the name of a bundled machine."""
    angular: str | None = None
    orbital: str | None = None
    sensor_link: str | None = None
    sigma_t_mm: float | None = None
    sigma_r_deg: float | None = None
    sigma_label_deg: float | None = None
    """Standard deviation of the labels of held joints; by default that of rounding to their last digit."""
    labels_exact: bool = False
    """Whether these labels are exact."""
    known_length: str | None = None
    """``400:400.8``, a gauge's true length and the same as tracked, mm, or ``major_radius:80``."""
    systematic: str = AUTO
    """Effects for which the ± allows: auto, none, or names with commas between."""
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
        """The solver that is meant. Raises InputError as `solver_for`."""
        return solver_for(self.solver, self.locus, self.urdf)

    @property
    def noise(self) -> dict[str, float | None]:
        """The tracker's noise as `carm_kin.calibrate` takes it, m and rad; None where it is not given."""
        return {
            "sigma_t_m": None if self.sigma_t_mm is None else self.sigma_t_mm * 1e-3,
            "sigma_r_rad": None if self.sigma_r_deg is None else self.sigma_r_deg * radians(1),
        }

    @property
    def sigma_label_rad(self) -> float | None:
        """As `carm_kin.calibrate` takes it: 0 where the labels are exact."""
        if self.labels_exact:
            return 0.0
        return None if self.sigma_label_deg is None else radians(self.sigma_label_deg)

    def check(self, named: Named = str) -> None:
        """Raise InputError for what is wrong whatever the recording, in the words of where it was given."""
        name = self.solver_name
        own = [named(key) for key in OF_CHAIN if getattr(self, key) != getattr(Settings(), key)]
        if own and name != CHAIN:
            raise only_with_chain(", ".join(own))
        for key in ("sigma_t_mm", "sigma_r_deg"):
            above_zero(named(key), getattr(self, key), 1.0)
        if self.sigma_label_deg is not None and name == CHAIN:
            raise InputError(f"{named('sigma_label_deg')}: the calibration of a chain takes labels as exact")
        if self.sigma_label_deg is not None and self.labels_exact:
            raise InputError(f"{named('sigma_label_deg')} and {named('labels_exact')} contradict each other; keep one")
        for key in ("sigma_label_deg", "sigma_reading_deg", "sigma_reading_mm"):
            check_from_zero(named(key), getattr(self, key))
        if self.cross_validate is not None and self.cross_validate < 2:
            raise InputError(f"{named('cross_validate')} needs at least 2 parts, not {self.cross_validate}")
        if self.known_length is not None:
            self._check_known_length(named("known_length"), name)
        effects_of(self.systematic)
        options_of(options_class(name), name, self.options)
        if self.urdf is not None:
            from carm_kin.machine.urdf import read_urdf

            read_urdf(self.urdf)

    def _check_known_length(self, option: str, solver: str) -> None:
        from carm_kin.calibration.known_length import KnownLength

        known = KnownLength.of(self.known_length or "")
        if solver == CHAIN:
            raise InputError(f"{option}: the calibration of a chain takes the tracker's scale as right")
        if known.name and self.locus != CIRCLE:
            raise InputError(f"{option}: the locus '{self.locus}' has no {known.name}; give a gauge, such as 400:400.8")

    def joint_names(self, recording: Recording) -> tuple[str, str]:
        """The names of the angular and the orbital joint in the recording: given, from the URDF, or the usual ones.

        Raises InputError where the recording names joints, but not those that were asked for.
        """
        names = {*recording.joints, *(() if recording.moving is None else recording.moving)} - {""}
        has = f"the recording has {', '.join(sorted(names))}"
        for option, joint in (("--angular", self.angular), ("--orbital", self.orbital)):
            if joint is not None and names and joint not in names:
                raise InputError(f"{option}: no joint '{joint}'; {has}")
        if self.urdf is None:
            return self.angular or "angular", self.orbital or "orbital"
        from carm_kin.machine.chain import chain_of
        from carm_kin.machine.urdf import read_urdf

        chain = chain_of(read_urdf(self.urdf), self.sensor_link, self.angular, self.orbital)
        axes = chain.names[chain.angular], chain.names[chain.orbital]
        if names and not names & set(axes):
            raise InputError(f"--urdf: its axes are '{axes[0]}' and '{axes[1]}'; {has}; is it another machine?")
        return axes

    def command(self, path: str) -> str:
        """The command that makes the same result of the recording in ``path``."""
        arguments = ["calibrate", path]
        for name, value in vars(self).items():
            if name != "options" and value != getattr(Settings(), name):
                arguments += ["--" + name.replace("_", "-"), *([] if value is True else [str(value)])]
        for name, value in self.options.items():
            arguments += ["--option", f"{name}={value if isinstance(value, str) else json.dumps(value)}"]
        return command_line(arguments)


OF_CHAIN = ("free", "zeros", "gains", "sigma_reading_deg", "sigma_reading_mm")
"""Settings that the calibration of a chain alone has."""


def only_with_chain(what: str) -> InputError:
    """The error of what a two-axis calibration does not have."""
    return InputError(f"{what}: needs the calibration of a chain, a urdf without another solver")
