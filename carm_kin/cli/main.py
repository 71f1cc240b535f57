"""The command `carm-kin`. The only place that prints and sets the exit status.

0 done; 2 bad usage or bad input; 3 refused, since the data cannot support a result; 1 a defect of ours;
130 interrupted. Human text goes to stderr; results, where they are asked for with ``--json -``, to stdout.
"""

import sys
import warnings
from typing import Annotated, Any

import typer

import carm_kin
from carm_kin.cli import batch, calibrate, compare, experiment, export, files, live, machine, verify
from carm_kin.cli.output import ended
from carm_kin.cli.terminal import to_stdout, use_any_encoding, use_plain_warnings
from carm_kin.errors import CarmKinError, InputError, RefusedError

app = typer.Typer(
    name="carm-kin",
    help="Radiation-free calibration of C-arms and the sensors attached to them.",
    add_completion=False,
    rich_markup_mode="rich",
)
for _commands in (
    machine,
    calibrate,
    compare,
    verify,
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
        status = app(prog_name="carm-kin", standalone_mode=False)
    except RefusedError as error:
        status = ended(3, f"refused ({error.code})", str(error))
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
) -> None:
    if context.invoked_subcommand is None:
        raise InputError("a command is missing; start with carm-kin demo, or see carm-kin --help")
