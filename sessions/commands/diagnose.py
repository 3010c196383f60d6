"""labnnum diagnose: which physics did the model leave out?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def diagnose(
    recordings: Annotated[
        list[Path], typer.Argument(help="Sessions (.h5) or files of another program; several levels are best.")
    ],
    model: Annotated[Path, typer.Option("--model", "-m", help="model.toml of the nominal structure.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for diagnosis.json, diagnosis.html, extended.toml.")],
    rig: Annotated[Path | None, typer.Option(help="rig.toml; its calibrated thresholds are used.")] = None,
    held_out: Annotated[
        list[Path] | None, typer.Option("--held-out", help="Recordings that no fit may see; may be given again.")
    ] = None,
    channels: Annotated[Path | None, typer.Option(help="channels.toml, if the files are another program's.")] = None,
    mechanism: Annotated[
        list[Path] | None,
        typer.Option(help="Python file with a mechanism of your own (it is run); may be given again."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print diagnosis.json and nothing else.")] = False,
) -> None:
    """Locate the mismatch between model and measurement, name what is missing, and show the fit improve.

    The model's parameters and its damping are updated first. What they and the ordinary errors of a sound model
    cannot explain is searched for over the catalogue of mechanisms and over the faults of the measurement chain; the
    best is fitted together with the parameters, and judged on data that no fit saw. The verdict may be "consistent",
    "parameters", "missing-physics", "measurement-fault" or "unexplained".

    For example:

        labnnum diagnose low.h5 high.h5 --model beam.toml -o diagnosis

    A table of natural frequencies (a .csv with columns f1, f2, ..., one row a repeat) is diagnosed too; it says which
    modes the updated model misses, with the uncertainty over the repeats, and which mechanisms would explain them.
    """
    import json

    from labnnum.errors import FileError
    from sessions.commands.printing import stages
    from sessions.diagnose import diagnose_files
    from sessions.diagnose_modes import diagnose_modal_file, is_modal_table

    if out.exists() and not out.is_dir():
        raise FileError(f"{out}: is a file; --out names a folder for the answer")
    if any(is_modal_table(path) for path in recordings):
        if len(recordings) > 1:
            raise FileError(f"{recordings[0]}: a table of natural frequencies is diagnosed alone; give one file")
        content = diagnose_modal_file(recordings[0], model, out)
        typer.echo(json.dumps(content) if as_json else f"verdict: {content['verdict']}\n{content['summary']}")
        return
    with stages("reading") as tell:
        content = diagnose_files(
            recordings,
            model,
            out,
            held_out or (),
            channels,
            rig,
            progress=tell,
            mechanisms=mechanism or (),
        )
    if as_json:
        typer.echo(json.dumps(content))
        return
    typer.echo(f"verdict: {content['verdict']}")
    typer.echo(content["summary"])
    if content["next_experiment"]:
        typer.echo(f"next: {content['next_experiment']}")
    typer.echo(f"page: {out / 'diagnosis.html'}")
