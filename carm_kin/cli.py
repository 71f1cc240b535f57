"""The command `carm-kin`. The only place that prints and sets the exit status.

0 done; 2 bad usage or bad input; 3 refused, since the data cannot support a result; 1 a defect of ours;
130 interrupted. Human text goes to stderr; results, where they are asked for with ``--json -``, to stdout.
"""

import json
import sys
import warnings
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Annotated, Any

import typer

import carm_kin
from carm_kin import cli_batch, cli_compare
from carm_kin.cli_arguments import above_zero, joint_names, options, writable
from carm_kin.cli_chain import ChainOptions, calibrate_with, chain_options
from carm_kin.cli_options import grouped
from carm_kin.errors import CarmKinError, InputError, RefusedError
from carm_kin.terminal import Stderr, to_stdout, use_any_encoding

app = typer.Typer(
    name="carm-kin",
    help="Radiation-free calibration of C-arms and the sensors attached to them.",
    add_completion=False,
    rich_markup_mode="rich",
)
cli_batch.register(app)
cli_compare.register(app)

Urdf = Annotated[str, typer.Argument(help="A URDF file or the name of a bundled machine.")]
AsJson = Annotated[str | None, typer.Option("--json", help="Write the result here; - for stdout.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of everything random.")]
Angular = Annotated[str | None, typer.Option(help="Name of the angular joint.")]
Orbital = Annotated[str | None, typer.Option(help="Name of the orbital joint.")]
SensorLink = Annotated[str | None, typer.Option(help="Link that carries the sensor.")]

_UsageError: type[Exception] = typer.BadParameter.__bases__[0]
"""What typer raises for bad usage; it has no public name in every version."""


def main() -> None:
    """Entry point of the console command."""
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    use_any_encoding()
    try:
        status = app(prog_name="carm-kin", standalone_mode=False)
    except RefusedError as error:
        status = _ended(3, f"refused ({error.code})", str(error))
    except CarmKinError as error:
        status = _ended(2, "error", str(error))
    except _UsageError as error:
        status = _ended(2, "error", _usage(error))
    except (KeyboardInterrupt, typer.Abort):
        status = 130
    sys.exit(status if isinstance(status, int) else 0)


def _ended(status: int, verdict: str, message: str) -> int:
    """Say on one line why the command ended, and give back its status."""
    console = Stderr()
    console.print(f"{verdict}: ", style="bold red", end="")
    console.print(message.replace("\n", "\\n"), soft_wrap=True)
    return status


def _usage(error: Any) -> str:
    """Typer's reason, and where help is."""
    command = error.ctx.command_path if error.ctx else "carm-kin"
    return f"{' '.join(error.format_message().split()).rstrip('.')} (see {command} --help)"


def _show_version(wanted: bool) -> None:
    if wanted:
        to_stdout(f"carm-kin {carm_kin.__version__}\n")
        raise typer.Exit


@app.callback(invoke_without_command=True, epilog="Example: carm-kin demo")
def _every_command(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    if context.invoked_subcommand is None:
        raise InputError("a command is missing; start with carm-kin demo, or see carm-kin --help")


@app.command(epilog="Example: carm-kin demo --out my-first-calibration")
def demo(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the files.")] = Path("carm-kin-demo"),
    seed: Seed = 0,
) -> None:
    """Simulate a clinical recording, calibrate it with every solver, compare with the truth."""
    from carm_kin.demo import run

    run(out, seed, Stderr())


@app.command(epilog="Example: carm-kin inspect mobile_nonisocentric")
def inspect(
    urdf: Urdf,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the same as JSON on stdout.")] = False,
) -> None:
    """Print the chain, its ranges and the nominal geometry of a C-arm."""
    from carm_kin import inspection

    found = inspection.inspect(urdf, sensor_link, angular, orbital)
    if as_json:
        to_stdout(json.dumps(found.to_dict(), indent=2) + "\n")
    else:
        inspection.show(found, Stderr())


@app.command(epilog="Example: carm-kin simulate mobile_nonisocentric -o rec.csv --sigma-t-mm 0.5 --sigma-r-deg 0.1")
def simulate(
    urdf: Urdf,
    out: Annotated[Path, typer.Option("--out", "-o", help="The recording; its truth goes to NAME.truth.json.")],
    protocol: Annotated[str, typer.Option(help="paper, clinical, minimal, free or a .toml file.")] = "clinical",
    sigma_t_mm: Annotated[float, typer.Option(min=0, help="Position noise, one sigma an axis.")] = 0.0,
    sigma_r_deg: Annotated[float, typer.Option(min=0, help="Orientation noise, one sigma an axis.")] = 0.0,
    outliers: Annotated[float, typer.Option(help="Share of gross outliers, 0 to 1.")] = 0.0,
    missing: Annotated[float, typer.Option(help="Share of missing frames, 0 to 1.")] = 0.0,
    labels: Annotated[bool, typer.Option(help="Keep sweeps and known angles.")] = True,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    seed: Seed = 0,
) -> None:
    """Simulate a recording of a C-arm, with its truth beside it."""
    truth_file = writable(writable(out).with_suffix(".truth.json"))
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
    truth.to_json(truth_file)
    console = Stderr()
    for note in truth.warnings:
        console.print(f"warning ({note.code}): {note.message}", soft_wrap=True)
    console.print(f"{len(recording)} poses written to {out}, the truth to {truth_file}", soft_wrap=True)


@app.command(epilog="Example: carm-kin calibrate rec.csv --solver kinematic --json result.json")
@grouped("chain", chain_options)
def calibrate(
    recording: Annotated[list[Path], typer.Argument(help="The recording; with --urdf there may be several.")],
    chain: ChainOptions,
    solver: Annotated[
        str | None, typer.Option(help="chain (with --urdf), closed_form, decomposed, direct, kinematic, surface.")
    ] = None,
    locus: Annotated[str, typer.Option(help="What the pivot moves on: circle (a C-arm) or point.")] = "circle",
    urdf: Annotated[
        str | None, typer.Option(help="Calibrate the chain of this URDF; with --solver only take its joint names.")
    ] = None,
    angular: Angular = None,
    orbital: Orbital = None,
    sensor_link: SensorLink = None,
    sigma_t_mm: Annotated[float | None, typer.Option(help="Position noise, if it is known.")] = None,
    sigma_r_deg: Annotated[float | None, typer.Option(help="Orientation noise, if it is known.")] = None,
    option: Annotated[
        list[str] | None, typer.Option("--option", "-O", help="Option of the solver, NAME=VALUE; may be repeated.")
    ] = None,
    cross_validate: Annotated[
        int | None, typer.Option(help="Predict each of so many parts of the recording by the fit to the others.")
    ] = None,
    as_json: AsJson = None,
) -> None:
    """Calibrate a recording: offset, radii, axes, and how good they are."""
    from carm_kin import summary
    from carm_kin.provenance import command_line

    if as_json not in (None, "-"):
        writable(Path(as_json))
    recordings = [carm_kin.read_recording(path) for path in recording]
    settings: dict[str, Any] = {
        "sigma_t_m": above_zero("--sigma-t-mm", sigma_t_mm, 1e-3),
        "sigma_r_rad": above_zero("--sigma-r-deg", sigma_r_deg, radians(1)),
        **options(option or []),
    }
    command = command_line(sys.argv[1:])
    if solver == "chain" or (urdf and solver is None and locus == "circle"):
        if urdf is None or locus != "circle":
            raise InputError("the solver 'chain' needs --urdf, and the locus 'circle'")
        settings |= {"angular": angular, "orbital": orbital, "sensor_link": sensor_link}
        result = calibrate_with(chain, recordings, urdf, folds=cross_validate, command=command, **settings)
    else:
        if chain.given or len(recordings) > 1:
            what = ", ".join(chain.given) or "several recordings"
            raise InputError(f"{what}: needs the calibration of a chain, --urdf without another --solver")
        poses = recordings[0]
        joints = joint_names(poses, urdf, sensor_link, angular, orbital)
        settings |= {"locus": locus, "angular": joints[0], "orbital": joints[1]}
        result = carm_kin.calibrate(poses, solver, command=command, **settings)
        if cross_validate is not None and result.refusal is None:
            from carm_kin.cross_validate import cross_validate as held_out

            result = replace(result, cross_validation=held_out(poses, cross_validate, solver, **settings))
    _deliver(result, as_json)
    summary.show(result, Stderr())
    if result.refusal:
        raise RefusedError(result.refusal.code, result.refusal.message)


@app.command(epilog="Example: carm-kin check result.json new.csv --tolerance-mm 1 --tolerance-deg 0.5")
def check(
    result: Annotated[Path, typer.Argument(help="The saved calibration, as calibrate --json writes it.")],
    recording: Annotated[Path, typer.Argument(help="A new recording with motion about both axes.")],
    tolerance_mm: Annotated[float, typer.Option(help="Change of a length that is accepted.")] = 1.0,
    tolerance_deg: Annotated[float, typer.Option(help="Change of an angle that is accepted.")] = 0.5,
    angular: Angular = None,
    orbital: Orbital = None,
    sigma_t_mm: Annotated[float | None, typer.Option(help="Position noise, if it is known.")] = None,
    sigma_r_deg: Annotated[float | None, typer.Option(help="Orientation noise, if it is known.")] = None,
    as_json: AsJson = None,
) -> None:
    """Check whether a saved calibration still holds: status 0 passed, 3 failed or refused."""
    from carm_kin import summary
    from carm_kin.check import check as apply
    from carm_kin.provenance import command_line

    if as_json not in (None, "-"):
        writable(Path(as_json))
    saved = carm_kin.CalibrationResult.from_json(result)
    poses = carm_kin.read_recording(recording)
    joints = joint_names(poses, None, None, angular, orbital)
    found = apply(
        saved,
        poses,
        tolerance_m=tolerance_mm / 1e3,
        tolerance_rad=radians(tolerance_deg),
        angular=joints[0],
        orbital=joints[1],
        sigma_t_m=above_zero("--sigma-t-mm", sigma_t_mm, 1e-3),
        sigma_r_rad=above_zero("--sigma-r-deg", sigma_r_deg, radians(1)),
        command=command_line(sys.argv[1:]),
    )
    _deliver(found, as_json)
    summary.show_check(found, Stderr())
    if found.refusal:
        raise RefusedError(found.refusal.code, found.refusal.message)
    if found.failures:
        raise typer.Exit(_ended(3, "failed", "; ".join(found.failures)))
    Stderr().print("passed: the saved calibration holds", style="bold green")


def _deliver(result: Any, as_json: str | None) -> None:
    """Write the JSON of a result where it was asked for."""
    if as_json == "-":
        to_stdout(result.to_json())
    elif as_json is not None:
        result.to_json(as_json)
