"""labnnum export: recordings and FRFs for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    source: Annotated[Path, typer.Argument(help="A session, or any file that can be imported.", show_default=False)],
    target: Annotated[
        Path, typer.Argument(help="File to write: .uff, .npz, .csv, .mat, .wav; must not exist.", show_default=False)
    ],
    frf: Annotated[bool, typer.Option("--frf", help="Export the FRF, not the recordings.")] = False,
    number: Annotated[
        int | None, typer.Option("--number", "-n", help="Which run, or which FRF; all runs, the last FRF.")
    ] = None,
    ascii_: Annotated[bool, typer.Option("--ascii", help="Universal files as text, 13 digits; else binary.")] = False,
    channels: Annotated[Path | None, typer.Option("--channels", "-c", help="channels.toml of the source.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the files written as JSON.")] = False,
) -> None:
    """Write recordings or an FRF in SI units for another program; read back, they are what they were.

    Universal files (dataset 58, binary unless `--ascii`) hold every run; other formats hold one run a file, and
    several get numbers in their names. NPZ, CSV and MAT carry a channels.toml inside, WAV beside them, so that
    `labnnum import` needs nothing else. FRFs go with their coherence and variance. A file that exists is never
    written over.

    For example:

        labnnum export beam.h5 beam.uff --frf

        labnnum export beam.h5 run2.csv --number 2
    """
    import json

    from sessions.exchange.export import export_frf, export_recordings
    from sessions.exporting import chosen_frf, chosen_recordings

    if frf:
        written = [export_frf(target, chosen_frf(source, number, channels), ascii_)]
    else:
        written = export_recordings(target, chosen_recordings(source, number, channels), ascii_)
    if as_json:
        typer.echo(json.dumps({"files": [str(path) for path in written]}))
    else:
        typer.echo("\n".join(str(path) for path in written))
