"""labnnum import: files of other programs into a session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(help="NPZ, NPY, CSV, TXT, JSON, MAT, WAV, UFF; each becomes a run.", show_default=False),
    ],
    channels: Annotated[
        Path | None,
        typer.Option("--channels", "-c", help="What the arrays are (channels.toml); looked for beside the file."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Session to write (.h5); must not exist.")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="model.toml to keep in the session.")] = None,
    rig: Annotated[Path | None, typer.Option(help="rig.toml to keep in the session.")] = None,
    keep_bad: Annotated[
        bool, typer.Option("--keep-bad", help="Store channels with NaN, constant or clipped ones too, marked.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was imported as JSON.")] = False,
) -> None:
    """Bring measurements of other programs into a session: recordings, or FRFs.

    A file of arrays says nothing about rate, units or places; `channels.toml` does:

        sample_rate = 25600

        [[channel]]
        name = "hammer"
        quantity = "force"
        unit = "lbf"
        role = "reference"
        node = "3"
        direction = "z"

        [[channel]]
        name = "tip"
        unit = "g"
        node = "5"
        direction = "-z"

    Each channel is the array of its name, or the row of `data` at its place; `source = 2`, `source = "Y[0]"` say
    otherwise. Units become SI through what they measure: g, lbf, mil, in/s, kip, psi, ... Universal files say all
    of that themselves. docs/formats.md has every key, and examples/recordings has such files for public data.

    For example:

        labnnum import hits_*.npy --channels channels.toml -o hits.h5

        labnnum import frf.uff -o beam.h5
    """
    import json

    from sessions.commands.info import describe_session
    from sessions.commands.printing import bar, finite, note, plural
    from sessions.importing import import_files
    from sessions.store import open_session

    target = output or Path(f"{files[0].stem}.h5")
    with bar("importing") as progress:
        notes = import_files(files, target, channels, model, rig, keep_bad, progress)
    for one in notes:
        note(one)
    with open_session(target) as session:
        said = describe_session(session)
    if as_json:
        typer.echo(json.dumps(finite({"session": str(target), **said})))
        return
    held = said["runs"]
    samples = sum(run["samples"] for run in held)
    what = f"{plural(len(held), 'run')}, {samples} samples a channel" if held else "one FRF"
    typer.echo(f"{target}: {what} from {plural(len(files), 'file')}")
    for run in held:
        channel_count = plural(len(run["channels"]), "channel")
        typer.echo(f"  {run['index']}  {run['label']}: {channel_count}, {run['duration']:.6g} s")
        for c in run["channels"]:
            if c["overloads"]:
                note(f"{run['label']}: channel {c['name']!r} is clipped {plural(c['overloads'], 'time')}, and kept so")
    typer.echo(f"next: labnnum {'frf' if held else 'info'} {target}")
