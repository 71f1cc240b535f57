"""The command `carm-kin`. The only place that prints and sets the exit status.

0 done; 2 bad usage or bad input; 3 refused, since the data cannot support a result; 1 a defect of ours;
130 interrupted. Results, tables and verdicts go to stdout; warnings, progress, what was written and the reason of
every status that is not 0 to stderr. With ``--json -`` stdout has the JSON alone, and stderr the rest.
"""

import sys
import warnings
from typing import Annotated, Any

import typer

import carm_kin
from carm_kin.cli import batch, calibrate, compare, experiment, export, files, isocentre, live, machine, trend, verify
from carm_kin.cli.loudness import App, Quiet, Verbose, heard, set_loudness
from carm_kin.cli.output import ended
from carm_kin.cli.terminal import to_stdout, use_any_encoding, use_plain_warnings
from carm_kin.errors import CarmKinError, InputError, RefusedError

app = App(
    name="carm-kin",
    help="Radiation-free calibration of C-arms and the sensors attached to them.",
    rich_markup_mode="rich",
)
for _commands in (
    machine,
    calibrate,
    compare,
    verify,
    isocentre,
    trend,
    batch,
    experiment,
    export,
    files,
    live,
):
    _commands.register(app)


_UsageError: type[Exception] = typer.BadParameter.__bases__[0]
"""What typer raises for bad usage; it has no public name in every version."""


def main() -> None:
    """Entry point of the console command."""
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    use_any_encoding()
    use_plain_warnings()
    try:
        with heard():
            status = app(prog_name="carm-kin", standalone_mode=False)
    except RefusedError as error:
        what = "partial" if error.code == "partial" else f"refused ({error.code})"
        status = ended(3, what, str(error))
    except CarmKinError as error:
        status = ended(2, "error", str(error))
    except _UsageError as error:
        status = ended(2, "error", _usage(error))
    except (KeyboardInterrupt, typer.Abort):
        status = 130
    sys.exit(status if isinstance(status, int) else 0)


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
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    set_loudness(quiet, verbose)
    if context.invoked_subcommand is None:
        raise InputError("a command is missing; start with carm-kin demo, or see carm-kin --help")
