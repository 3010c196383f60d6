"""The `labnnum` command: an explicit list of commands, and one place where errors become exit statuses."""

from __future__ import annotations

import errno
import os
import sys
from importlib import import_module
from typing import NoReturn

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
    ("curve", "sessions.commands.curve:curve"),
    ("train", "sessions.commands.train:train"),
    ("update", "sessions.commands.update:update"),
    ("report", "sessions.commands.report:report"),
    ("identify", "sessions.commands.identify:identify"),
    ("diagnose", "sessions.commands.diagnose:diagnose"),
    ("component", "sessions.commands.component:component"),
    ("calibrate-diagnosis", "sessions.commands.calibrate_diagnosis:calibrate_diagnosis"),
    ("prove", "sessions.commands.prove:prove"),
    ("reproduce", "sessions.commands.reproduce:reproduce"),
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


USAGE: type[Exception] = typer.BadParameter.__mro__[1]  # ty: ignore[invalid-assignment]
"""What is raised where the command line itself cannot be read."""

NOT_THERE = (
    errno.ENOENT,
    errno.EEXIST,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.ENAMETOOLONG,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
)
"""Failures of the system that a name given by the user causes."""

for _name, _where in COMMANDS:
    _module, _function = _where.split(":")
    app.command(_name)(getattr(import_module(_module), _function))


def main() -> None:
    """Run the command line: status 2 for input that cannot be used, 1 for a failure, with one line why."""
    try:
        status = app(prog_name="labnnum", standalone_mode=False)
    except InputError as error:
        _end(error, 2)
    except LabnnumError as error:
        _end(error, 1)
    except USAGE as error:
        if len(sys.argv) == 1:  # the help is printed already
            sys.exit(2)
        _end(_usage(error), 2)
    except BrokenPipeError:  # whoever read the output, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _end(f"{where}{error.strerror or error}", 2 if error.errno in NOT_THERE else 1)
    except MemoryError as error:
        _end(f"more memory is needed than there is ({error}): use fewer samples, lines or parameter sets", 1)
    except (KeyboardInterrupt, typer.Abort):
        _end("interrupted", 130)
    else:
        sys.exit(status if isinstance(status, int) else 0)


def _end(why: object, status: int) -> NoReturn:
    sys.stderr.write(f"labnnum: {why}\n")
    sys.exit(status)


def _usage(error: Exception) -> str:
    """One line on a command line that cannot be read."""
    said = getattr(error, "format_message", lambda: str(error))()
    told = " ".join(said.split()).rstrip(".")
    command = getattr(getattr(error, "ctx", None), "command_path", "labnnum")
    return f"{told[:1].lower()}{told[1:]}; see '{command} --help'"


if __name__ == "__main__":
    main()
