"""The command `carm-kin`. The only place that prints and sets the exit status.

0 done; 2 bad usage or bad input; 3 refused, since the data cannot support a result; 1 a defect of ours.
Human text goes to stderr, results asked for with ``--json -`` to stdout.
"""

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from carm_kin.errors import CarmKinError, InputError, RefusedError

app = typer.Typer(
    name="carm-kin",
    help="Radiation-free calibration of C-arms and the sensors attached to them.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Json = Annotated[str | None, typer.Option("--json", help="Write the result to this file; - for stdout.")]
Angular = Annotated[str | None, typer.Option(help="Name of the angular joint.")]
Orbital = Annotated[str | None, typer.Option(help="Name of the orbital joint.")]


def main() -> None:
    """Entry point of the console command."""
    try:
        app()
    except RefusedError as error:
        sys.stderr.write(f"refused ({error.code}): {error}\n")
        sys.exit(3)
    except CarmKinError as error:
        sys.stderr.write(f"error: {error}\n")
        sys.exit(2)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)


@app.command(epilog="Example: carm-kin demo")
def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the files.")] = Path("carm-kin-demo"),
    seed: Seed = 0,
) -> None:
    """Simulate a clinical recording, calibrate it with every solver, compare with the truth."""
    from carm_kin.demo import run

    run(out, seed)


@app.command(epilog="Example: carm-kin inspect mobile_nonisocentric")
def inspect(
    urdf: Annotated[str, typer.Argument(help="A URDF file or the name of a bundled machine.")],
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: Annotated[str | None, typer.Option(help="Link that carries the sensor.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the same as JSON on stdout.")] = False,
) -> None:
    """Print the chain, its ranges and the nominal geometry of a C-arm."""
    from carm_kin import inspection

    found = inspection.inspect(urdf, sensor_link, angular, orbital)
    if as_json:
        sys.stdout.write(json.dumps(found.to_dict(), indent=2) + "\n")
    else:
        inspection.show(found)


@app.command(epilog="Example: carm-kin simulate mobile_nonisocentric -o rec.csv --sigma-t-mm 0.5 --sigma-r-deg 0.1")
def simulate(
    urdf: Annotated[str, typer.Argument(help="A URDF file or the name of a bundled machine.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The recording; its truth goes to NAME.truth.json.")],
    protocol: Annotated[str, typer.Option(help="paper, clinical, minimal, free or a .toml file.")] = "clinical",
    sigma_t_mm: Annotated[float, typer.Option(min=0, help="Position noise, one sigma an axis.")] = 0.0,
    sigma_r_deg: Annotated[float, typer.Option(min=0, help="Orientation noise, one sigma an axis.")] = 0.0,
    outliers: Annotated[float, typer.Option(help="Share of gross outliers, 0 to 1.")] = 0.0,
    missing: Annotated[float, typer.Option(help="Share of missing frames, 0 to 1.")] = 0.0,
    labels: Annotated[bool, typer.Option(help="Keep sweeps and known angles.")] = True,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: Annotated[str | None, typer.Option(help="Link that carries the sensor.")] = None,
    seed: Seed = 0,
) -> None:
    """Simulate a recording of a C-arm, with its truth beside it."""
    from math import radians

    import carm_kin

    recording, truth = carm_kin.simulate(
        urdf,
        protocol,
        sigma_t_m=sigma_t_mm / 1000,
        sigma_r_rad=radians(sigma_r_deg),
        outliers=outliers,
        missing=missing,
        labels=labels,
        angular=angular,
        orbital=orbital,
        sensor_link=sensor_link,
        seed=seed,
    )
    carm_kin.write_recording(recording, out)
    truth_file = out.with_suffix(".truth.json")
    truth.to_json(truth_file)
    for note in truth.warnings:
        sys.stderr.write(f"warning ({note.code}): {note.message}\n")
    sys.stderr.write(f"{len(recording)} poses written to {out}, the truth to {truth_file}\n")


@app.command(epilog="Example: carm-kin calibrate rec.csv --solver kinematic --json result.json")
def calibrate(
    recording: Annotated[Path, typer.Argument(help="The recording.")],
    solver: Annotated[str | None, typer.Option(help="closed_form, decomposed, direct, kinematic, surface.")] = None,
    locus: Annotated[str, typer.Option(help="What the pivot moves on: circle (a C-arm) or point.")] = "circle",
    urdf: Annotated[str | None, typer.Option(help="Take the joint names from this URDF.")] = None,
    angular: Angular = None,
    orbital: Orbital = None,
    sigma_t_mm: Annotated[float | None, typer.Option(help="Position noise, if it is known.")] = None,
    sigma_r_deg: Annotated[float | None, typer.Option(help="Orientation noise, if it is known.")] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", "-O", help="Option of the solver, NAME=VALUE; may be repeated.")
    ] = None,
    as_json: Json = None,
) -> None:
    """Calibrate a recording: offset, radii, axes, and how good they are."""
    from math import radians

    import carm_kin
    from carm_kin import summary

    joints = _joint_names(urdf, angular, orbital)
    result = carm_kin.calibrate(
        carm_kin.read_recording(recording),
        solver,
        locus=locus,
        angular=joints[0],
        orbital=joints[1],
        sigma_t_m=None if sigma_t_mm is None else sigma_t_mm / 1000,
        sigma_r_rad=None if sigma_r_deg is None else radians(sigma_r_deg),
        command=shlex.join(["carm-kin", *(a.rsplit("/", 1)[-1] for a in sys.argv[1:])]),
        **_options(option or []),
    )
    if as_json == "-":
        sys.stdout.write(result.to_json())
    elif as_json:
        result.to_json(as_json)
    summary.show(result)
    if result.refusal:
        raise RefusedError(result.refusal.code, result.refusal.message)


def _joint_names(urdf: str | None, angular: str | None, orbital: str | None) -> tuple[str, str]:
    """The names of the two joints in the recording: by option, from the URDF, or the usual ones."""
    if urdf is None:
        return angular or "angular", orbital or "orbital"
    from carm_kin.chain import chain_of
    from carm_kin.urdf import read_urdf

    chain = chain_of(read_urdf(urdf), None, angular, orbital)
    return chain.names[chain.angular], chain.names[chain.orbital]


def _options(pairs: list[str]) -> dict[str, Any]:
    """``NAME=VALUE`` pairs; a value is JSON where it can be (true, 0.05, null), else text."""
    found = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise InputError(f"--option '{pair}' is not of the form NAME=VALUE")
        try:
            value = json.loads(text)
        except json.JSONDecodeError:
            value = text
        found[name.replace("-", "_")] = value
    return found
