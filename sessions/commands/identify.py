"""labnnum identify: a base model from the recordings themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def identify(
    recordings: Annotated[list[Path], typer.Argument(help="Sessions (.h5) or files of another program.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="model.toml to write.")] = Path("model.toml"),
    channels: Annotated[Path | None, typer.Option(help="channels.toml, if the files are another program's.")] = None,
    low: Annotated[float | None, typer.Option(help="Lower end of the band, Hz.")] = None,
    high: Annotated[float | None, typer.Option(help="Upper end of the band, Hz.")] = None,
    order: Annotated[int, typer.Option(help="Highest order of the stabilisation diagram.", min=4)] = 40,
    modes: Annotated[int | None, typer.Option(help="How many modes to keep.", min=1)] = None,
    only: Annotated[str, typer.Option(help="Take recordings whose label contains this.")] = "",
    report: Annotated[bool, typer.Option(help="Write a page beside the model: diagram, FRFs, modes, MAC.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Identify modes in the recording of the lowest level and write them as a model of kind "modal".

    The sensors are its nodes, so that a diagnosis may look for physics at each and between each two. One force must
    drive a place where a response is measured; FRFs of a hammer that roves before one sensor are taken by reciprocity.

    Beside the model a page is written, base.html for base.toml: the stabilisation diagram, measured and synthesised
    FRFs, natural frequencies and damping ratios with their standard deviations, mode shapes and their MAC matrix.

    For example:

        labnnum identify low.h5 middle.h5 high.h5 --low 2 --high 15 -o base.toml
    """
    import json

    from labnnum.identification import IDENTIFIED
    from sessions.commands.printing import note
    from sessions.identify import identify_files, remarks

    said = identify_files(recordings, out, channels, low, high, order, modes, only, report)
    if as_json:
        typer.echo(json.dumps(said))
        return
    error = f"error {100 * said['error']:.2g} %"
    if said["beyond_noise"] > IDENTIFIED:
        error += f", {100 * said['beyond_noise']:.2g} % of it beyond noise (structure.error)"
    typer.echo(f"{said['model']}: {len(said['modes'])} modes of {said['recording']}, {error}")
    for line in remarks(said["recording"], said["clipped"], said["nodal_at_drive"]):
        note(line)
    for m in said["modes"]:
        typer.echo(f"{m['frequency']:12.4f} Hz {100 * m['damping_ratio']:8.3f} %")
    if said["report"]:
        typer.echo(f"report: {said['report']}")
