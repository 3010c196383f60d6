"""labnnum calibrate-diagnosis: thresholds from repeats of one's own sound structure."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def calibrate_diagnosis(
    repeats: Annotated[
        list[Path], typer.Argument(help="Sessions or files of a structure known to be sound, one for each remount.")
    ],
    model: Annotated[Path, typer.Option("--model", "-m", help="model.toml of the structure.")],
    rig: Annotated[Path, typer.Option(help="rig.toml; the thresholds are stored beside it.")],
    channels: Annotated[Path | None, typer.Option(help="channels.toml, if the files are another program's.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the thresholds as JSON and nothing else.")] = False,
) -> None:
    """Set the diagnosis' thresholds by what a sound structure on this bench does.

    Every repeat is diagnosed as if it were suspect. The largest gain that any mechanism makes on a sound structure
    sets the alarm, and the frequency errors that the model needed set the scatter. Five repeats or more are wanted,
    remounted in between; the thresholds never fall below the shipped ones when there are fewer.

    For example:

        labnnum calibrate-diagnosis sound1.h5 sound2.h5 sound3.h5 --model beam.toml --rig rig.toml
    """
    import json
    from dataclasses import asdict

    from sessions.calibrate_diagnosis import calibrate
    from sessions.commands.printing import stages

    with stages("reading") as tell:
        made = calibrate(repeats, model, rig, channels, progress=tell)
    if as_json:
        typer.echo(json.dumps({"scatter": asdict(made.scatter), "limits": asdict(made.limits), "gains": made.gains}))
        return
    typer.echo(f"gains on sound repeats: {', '.join(f'{g:.1f}' for g in made.gains)}")
    typer.echo(f"alarm {made.limits.alarm:.1f}, frequency scatter {100 * made.scatter.frequency:.2f} %")
    typer.echo(f"stored in {made.path}")
