"""The options of every command that calibrates: what `carm_kin.calibration.settings.Settings` holds, by name."""

import json
from dataclasses import fields
from math import radians
from typing import Annotated, Any

import typer

from carm_kin.cli.arguments import Angular, Orbital, SensorLink
from carm_kin.errors import InputError
from carm_kin.typed import above_zero

PANEL = "How to calibrate"
CHAIN_PANEL = "Calibration of the whole chain, with --urdf"


def named(setting: str) -> str:
    """The option of a setting."""
    return "--" + setting.replace("_", "-")


def _option(*names: str, help: str) -> Any:
    return typer.Option(*names, help=help, rich_help_panel=PANEL)


def _of_chain(*names: str, help: str) -> Any:
    return typer.Option(*names, help=help, rich_help_panel=CHAIN_PANEL)


def settings_options(
    solver: Annotated[
        str | None,
        _option("--solver", help="chain (with --urdf), {solvers}."),
    ] = None,
    locus: Annotated[
        str | None, _option("--locus", help="What the pivot moves on: {loci}; circle, the default, is a C-arm.")
    ] = None,
    urdf: Annotated[
        str | None,
        _option("--urdf", help="Calibrate the chain of this URDF; with --solver only take its joint names."),
    ] = None,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    sigma_t_mm: Annotated[float | None, _option("--sigma-t-mm", help="Position noise, if it is known.")] = None,
    sigma_r_deg: Annotated[float | None, _option("--sigma-r-deg", help="Orientation noise, if it is known.")] = None,
    sigma_label_deg: Annotated[
        float | None,
        _option("--sigma-label-deg", help="Error of the labels of held joints; left out: from their digits."),
    ] = None,
    labels_exact: Annotated[bool | None, _option("--labels-exact", help="The labels of held joints are exact.")] = None,
    known_length: Annotated[
        str | None,
        _option("--known-length", help="TRUE:TRACKED of a gauge in mm, or major_radius:MM; '+-MM' behind it."),
    ] = None,
    systematic: Annotated[
        str | None,
        _option(
            "--systematic", help="Effects for which the ± allows: auto (by default), none, or {effects}, with commas."
        ),
    ] = None,
    option: Annotated[
        list[str] | None, _option("--option", "-O", help="Option of the solver, NAME=VALUE; may be repeated.")
    ] = None,
    cross_validate: Annotated[
        int | None,
        _option("--cross-validate", help="Predict each of so many parts of the recording by the fit to the others."),
    ] = None,
    free: Annotated[
        str | None,
        _of_chain("--free", help="Joints whose origin is unknown: all (by default), axes, none or names, with commas."),
    ] = None,
    zeros: Annotated[
        str | None, _of_chain("--zeros", help="Joints whose zero is unknown, in the same way; none by default.")
    ] = None,
    gains: Annotated[
        str | None, _of_chain("--gains", help="Joints whose scale is unknown, in the same way; none by default.")
    ] = None,
    sigma_reading_deg: Annotated[
        float | None, _of_chain("--sigma-reading-deg", help="Noise of joint readings; 0 exact; left out: estimated.")
    ] = None,
    sigma_reading_mm: Annotated[
        float | None, _of_chain("--sigma-reading-mm", help="The same of sliding joints.")
    ] = None,
    prior_mm: Annotated[float | None, _of_chain("--prior-mm", help="One sigma of the URDF's positions.")] = None,
    prior_deg: Annotated[float | None, _of_chain("--prior-deg", help="One sigma of the URDF's directions.")] = None,
) -> dict[str, Any]:
    """The settings that were given. Raises InputError for an option of a solver that is not of the form NAME=VALUE."""
    given = {name: value for name, value in locals().items() if value is not None}
    chosen = _solver_options(given.pop("option", []))
    for setting, (name, unit) in _PRIORS.items():
        value = above_zero(named(setting), given.pop(setting, None), unit)
        if value is not None and name in chosen:
            raise InputError(f"{named(setting)} and --option '{name}' say the same; leave one out")
        chosen |= {} if value is None else {name: value}
    return given | ({"options": chosen} if chosen else {})


_PRIORS = {"prior_mm": ("prior_t", 1e-3), "prior_deg": ("prior_r", radians(1))}
"""Option of the command -> option of the solver ``chain``, and its unit."""


def _solver_options(pairs: list[str]) -> dict[str, Any]:
    """``NAME=VALUE`` pairs; a value is JSON where it can be (true, 0.05, null), else text."""
    from carm_kin.calibration.settings import Settings

    found: dict[str, Any] = {}
    settings = {field.name for field in fields(Settings)}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name:
            raise InputError(f"--option '{pair}' is not of the form NAME=VALUE")
        if name in settings:
            raise InputError(f"--option '{name}' is no option of a solver, but one of the command: {named(name)}")
        if name in found:
            raise InputError(f"--option '{name}' is given twice")
        try:
            found[name] = json.loads(text)
        except (ValueError, RecursionError):
            found[name] = text
    return found
