"""The options of `carm-kin calibrate` that belong to the calibration of a URDF's whole chain, and its run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carm_kin.cli.arguments import writable
from carm_kin.errors import InputError

if TYPE_CHECKING:
    from carm_kin.recording.recording import Recording
    from carm_kin.results.result import CalibrationResult

PANEL = "Calibration of the whole chain, with --urdf"


@dataclass(frozen=True)
class ChainOptions:
    """What is free, how good readings and nominal numbers are, where the calibrated URDF goes."""

    free: tuple[str, ...]
    zeros: tuple[str, ...]
    gains: tuple[str, ...]
    sigma_reading_rad: float | None
    sigma_reading_m: float | None
    prior_t: float | None
    prior_r: float | None
    urdf_out: Path | None

    @property
    def given(self) -> list[str]:
        """The options that were given."""
        default = chain_options()
        names = {"sigma_reading_rad": "sigma-reading-deg", "sigma_reading_m": "sigma-reading-mm"}
        names |= {"prior_t": "prior-mm", "prior_r": "prior-deg"}
        differ = [name for name in vars(self) if getattr(self, name) != getattr(default, name)]
        return ["--" + names.get(name, name).replace("_", "-") for name in differ]


def _option(*names: str, help: str) -> Any:
    return typer.Option(*names, help=help, rich_help_panel=PANEL)


def chain_options(
    free: Annotated[
        str, _option("--free", help="Joints whose origin is unknown: all, axes, none or names, comma between.")
    ] = "all",
    zeros: Annotated[str, _option("--zeros", help="Joints whose zero is unknown, in the same way.")] = "none",
    gains: Annotated[str, _option("--gains", help="Joints whose scale is unknown, in the same way.")] = "none",
    sigma_reading_deg: Annotated[
        float | None, _option("--sigma-reading-deg", help="Noise of joint readings; 0 exact; left out: estimated.")
    ] = None,
    sigma_reading_mm: Annotated[float | None, _option("--sigma-reading-mm", help="The same of sliding joints.")] = None,
    prior_mm: Annotated[float | None, _option("--prior-mm", help="One sigma of the URDF's positions.")] = None,
    prior_deg: Annotated[float | None, _option("--prior-deg", help="One sigma of the URDF's directions.")] = None,
    urdf_out: Annotated[Path | None, _option("--urdf-out", help="Write the calibrated URDF here.")] = None,
) -> ChainOptions:
    """The options. Raises InputError for one that is no number of its kind."""
    return ChainOptions(
        *(tuple(name.strip() for name in names.split(",")) for names in (free, zeros, gains)),
        sigma_reading_rad=_number("--sigma-reading-deg", sigma_reading_deg, radians(1), zero=True),
        sigma_reading_m=_number("--sigma-reading-mm", sigma_reading_mm, 1e-3, zero=True),
        prior_t=_number("--prior-mm", prior_mm, 1e-3, zero=False),
        prior_r=_number("--prior-deg", prior_deg, radians(1), zero=False),
        urdf_out=writable(urdf_out) if urdf_out else None,
    )


def calibrate_with(
    chain: ChainOptions,
    recordings: "Sequence[Recording]",
    urdf: str,
    settings: Mapping[str, Any],
    options: Mapping[str, Any],
) -> "CalibrationResult":
    """The result of the chain's calibration; the calibrated URDF is written where it was asked for and not refused.

    ``settings`` are those of the command itself and ``options`` those of ``--option``. Raises InputError where an
    option is no option of the solver, or an option of the command as well.
    """
    from carm_kin.calibration.chain.calibrate import FreeJoints, calibrate_chain
    from carm_kin.calibration.chain.calibrated_urdf import calibrated_urdf
    from carm_kin.machine.urdf import read_urdf, write_urdf

    file = read_urdf(urdf)
    priors = {name: value for name in ("prior_t", "prior_r") if (value := getattr(chain, name)) is not None}
    own = {
        "free": FreeJoints(chain.free, chain.zeros, chain.gains),
        "sigma_reading_rad": chain.sigma_reading_rad,
        "sigma_reading_m": chain.sigma_reading_m,
        **priors,
        **settings,
    }
    for name in options:
        if name in {"recordings", "urdf", *own}:
            raise InputError(f"--option '{name}' is an option of the command itself (see carm-kin calibrate --help)")
    result = calibrate_chain(recordings, file, **own, **options)
    if chain.urdf_out and result.chain:
        write_urdf(calibrated_urdf(file, result.chain), chain.urdf_out)
    return result


def _number(option: str, value: float | None, unit: float, *, zero: bool) -> float | None:
    if value is None:
        return None
    if not 0 <= value < inf or (value == 0 and not zero):
        raise InputError(f"{option} must be a finite number {'from 0 on' if zero else 'above 0'}, not {value}")
    return value * unit
