"""labnnum init: commented files to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def init(
    folder: Annotated[Path, typer.Argument(help="Where to write; made if it is not there.")] = Path(),
    rig: Annotated[
        str, typer.Option("--rig", help="What you measure with: simulated, simulated-hammer, shaker or hammer.")
    ] = "simulated",
    structure: Annotated[
        str, typer.Option("--structure", help="What you measure: beam, chain, frame or matrices.")
    ] = "beam",
    as_json: Annotated[bool, typer.Option("--json", help="Print the files that were written.")] = False,
) -> None:
    """Write a commented rig.toml and model.toml to start from.

    rig.toml describes the bench: device, channels with their sensitivities, excitation, trigger, processing and
    safety limits. model.toml describes the structure, its parameters with bounds and prior, and the frequency bands.
    Both work as they are with a simulated rig; change what differs on yours. Nothing is written over.

    For example:

        labnnum init first --rig simulated --structure beam

        labnnum init bridge --rig hammer --structure frame
    """
    from sessions.starters import RIGS, STRUCTURES, write_starter

    paths = write_starter(folder, rig, structure)
    if as_json:
        import json

        typer.echo(json.dumps({"files": [str(p) for p in paths]}))
        return
    typer.echo(f"{STRUCTURES[structure].about}, measured with {RIGS[rig]}:")
    for path in paths:
        typer.echo(f"  {path}")
    session = folder / "first.h5"
    typer.echo(f"next: labnnum measure {folder / 'rig.toml'} -o {session}")
    typer.echo(f"then: labnnum train {folder / 'model.toml'} --frf {session} -o {folder / 'updater.h5'}")
    typer.echo(f"      labnnum update {session} --updater {folder / 'updater.h5'}")
    typer.echo(f"      labnnum report {session}")
