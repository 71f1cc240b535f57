"""Simulated recordings: what is moved, what the machine and the tracker do, and the noise."""

from math import radians
from pathlib import Path
from typing import Annotated, Any

import typer

import carm_kin
from carm_kin.cli.arguments import Angular, Orbital, Seed, SensorLink, Urdf, writable
from carm_kin.cli.options import grouped
from carm_kin.cli.output import warn, written
from carm_kin.typed import check_from_zero

PANEL = "Of real machines and trackers"


def effect_options(
    sag_mm: Annotated[
        float,
        typer.Option(
            min=0, rich_help_panel=PANEL, help="Greatest shift of the sensor by the weight on the C, over its range."
        ),
    ] = 0.0,
    field_mm: Annotated[
        float, typer.Option(min=0, rich_help_panel=PANEL, help="Distortion of the tracker, root mean square.")
    ] = 0.0,
    creep_mm: Annotated[
        float, typer.Option(min=0, rich_help_panel=PANEL, help="How far the base creeps during the recording.")
    ] = 0.0,
    backlash_deg: Annotated[
        float, typer.Option(min=0, rich_help_panel=PANEL, help="Play of both joints, from stop to stop.")
    ] = 0.0,
    smoothing_s: Annotated[
        float, typer.Option(min=0, rich_help_panel=PANEL, help="Time constant of the tracker's low pass.")
    ] = 0.0,
    rate_hz: Annotated[
        float | None,
        typer.Option(
            min=0, rich_help_panel=PANEL, help="Frames a second: poses get times. Default: none; 10 if smoothed."
        ),
    ] = None,
) -> dict[str, Any]:
    """The options, as keywords of `carm_kin.simulate`."""
    sizes = {"sag-mm": sag_mm, "field-mm": field_mm, "creep-mm": creep_mm, "backlash-deg": backlash_deg}
    for name, value in (sizes | {"smoothing-s": smoothing_s, "rate-hz": rate_hz}).items():
        check_from_zero(f"--{name}", value)
    return {
        "sag_m": sag_mm / 1000,
        "field_m": field_mm / 1000,
        "creep_m": creep_mm / 1000,
        "backlash_rad": radians(backlash_deg),
        "smoothing_s": smoothing_s,
        "rate_hz": rate_hz,
    }


@grouped("effects", effect_options)
def simulate(
    effects: dict[str, Any],
    urdf: Urdf,
    out: Annotated[Path, typer.Option("--out", "-o", help="The recording; its truth goes to NAME.truth.json.")],
    protocol: Annotated[
        str, typer.Option(help="paper, clinical, minimal, free, joints, virtual or a .toml file.")
    ] = "clinical",
    sigma_t_mm: Annotated[float, typer.Option(min=0, help="Position noise, one sigma an axis.")] = 0.0,
    sigma_r_deg: Annotated[float, typer.Option(min=0, help="Orientation noise, one sigma an axis.")] = 0.0,
    anisotropy: Annotated[
        float, typer.Option(min=0.01, help="Noise along the tracker's line of sight (z) over that across it.")
    ] = 1.0,
    correlation: Annotated[float, typer.Option(help="Of the noise from frame to frame, 0 to below 1.")] = 0.0,
    outliers: Annotated[float, typer.Option(help="Share of gross outliers, 0 to 1.")] = 0.0,
    missing: Annotated[float, typer.Option(help="Share of missing frames, 0 to 1.")] = 0.0,
    sigma_reading_deg: Annotated[float, typer.Option(min=0, help="Error of the angles that are recorded.")] = 0.0,
    sigma_reading_mm: Annotated[float, typer.Option(min=0, help="Error of the lengths that are recorded.")] = 0.0,
    label_resolution_deg: Annotated[
        float, typer.Option(min=0, help="Step to which the recorded angles are rounded; 0: exact.")
    ] = 0.0,
    labels: Annotated[bool, typer.Option(help="Keep sweeps and known angles.")] = True,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    seed: Seed = 0,
) -> None:
    """Simulate a recording of a C-arm, with its truth beside it."""
    check_from_zero("--sigma-t-mm", sigma_t_mm)
    check_from_zero("--sigma-r-deg", sigma_r_deg)
    check_from_zero("--sigma-reading-deg", sigma_reading_deg)
    check_from_zero("--sigma-reading-mm", sigma_reading_mm)
    check_from_zero("--label-resolution-deg", label_resolution_deg)
    truth_file = writable(writable(out).with_suffix(".truth.json"))
    recording, truth = carm_kin.simulate(
        urdf,
        protocol,
        sigma_t_m=sigma_t_mm / 1000,
        sigma_r_rad=radians(sigma_r_deg),
        anisotropy=anisotropy,
        correlation=correlation,
        outliers=outliers,
        missing=missing,
        sigma_reading_rad=radians(sigma_reading_deg),
        sigma_reading_m=sigma_reading_mm / 1000,
        label_resolution_rad=radians(label_resolution_deg),
        **effects,
        labels=labels,
        angular=angular,
        orbital=orbital,
        sensor_link=sensor_link,
        seed=seed,
    )
    carm_kin.write_recording(recording, out)
    truth.to_json(truth_file)
    warn(truth.warnings)
    written(out, f"{len(recording)} poses")
    written(truth_file, "the truth")
