"""The `labnnum` command: an explicit list of commands, and one place where errors become exit statuses."""

from __future__ import annotations

import os
import sys
from importlib import import_module

import typer

from labnnum import __version__
from labnnum.errors import InputError, LabnnumError

for _library in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_library, "1")  # many small matrices: threads cost more than they give, and change the bits

COMMANDS: tuple[tuple[str, str], ...] = (
    ("demo", "sessions.commands.demo:demo"),
    ("init", "sessions.commands.init:init"),
    ("plan", "sessions.commands.plan:plan"),
    ("measure", "sessions.commands.measure:measure"),
    ("devices", "sessions.commands.devices:devices"),
    ("calibrate", "sessions.commands.calibrate:calibrate"),
    ("simulate", "sessions.commands.simulate:simulate"),
    ("import", "sessions.commands.import_:import_"),
    ("export", "sessions.commands.export:export"),
    ("info", "sessions.commands.info:info"),
    ("frf", "sessions.commands.frf:frf"),
    ("modes", "sessions.commands.modes:modes"),
    ("train", "sessions.commands.train:train"),
    ("update", "sessions.commands.update:update"),
    ("report", "sessions.commands.report:report"),
    ("diagnose", "sessions.commands.diagnose:diagnose"),
    ("calibrate-diagnosis", "sessions.commands.calibrate_diagnosis:calibrate_diagnosis"),
    ("prove", "sessions.commands.prove:prove"),
)
"""Command name -> "module:function", in the order that --help shows them."""

app = typer.Typer(
    name="labnnum",
    help="Measure a structure, update its model, and be told which physics the model left out.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def root(version: bool = typer.Option(False, "--version", help="Print the version and stop.")) -> None:
    """Print the version if asked."""
    if version:
        typer.echo(f"labnnum {__version__}")
        raise typer.Exit


for _name, _where in COMMANDS:
    _module, _function = _where.split(":")
    app.command(_name)(getattr(import_module(_module), _function))


def main() -> None:
    """Run the command line: status 2 for input that cannot be used, 1 for a failure, with one line why."""
    try:
        app()
    except InputError as error:
        sys.stderr.write(f"labnnum: {error}\n")
        sys.exit(2)
    except LabnnumError as error:
        sys.stderr.write(f"labnnum: {error}\n")
        sys.exit(1)
    except KeyboardInterrupt:
        sys.stderr.write("labnnum: interrupted\n")
        sys.exit(130)


if __name__ == "__main__":
    main()
