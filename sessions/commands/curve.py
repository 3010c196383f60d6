"""labnnum curve: periodic responses of a model with nonlinear laws, branches and stability."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def curve(
    model: Annotated[Path, typer.Argument(help="model.toml, with its laws as [[mechanism]].", show_default=False)],
    force: Annotated[float, typer.Option(help="Amplitude of the force (N, N m) or base acceleration (m/s^2).")],
    low: Annotated[float, typer.Option(help="Lower end, Hz.")],
    high: Annotated[float, typer.Option(help="Upper end, Hz.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="File to write, .csv or .npz; must not exist.")],
    drive: Annotated[
        str, typer.Option(help='Where it acts: "node:direction", or "base". Default: base if the model has one.')
    ] = "",
    response: Annotated[
        list[str] | None, typer.Option(help="node:direction of a response; repeat. Default: the driven one.")
    ] = None,
    harmonics: Annotated[int, typer.Option(help="Highest harmonic; stops and friction want 15 or more.")] = 15,
    sweep: Annotated[
        str, typer.Option(help="forward or backward: write what a slow sweep finds in the stead of the curve.")
    ] = "",
    lines: Annotated[int, typer.Option(help="Frequencies of the sweep, evenly from end to end.")] = 401,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Follow the periodic response of a model with nonlinear laws over frequency: both branches, and their stability.

    The laws are those of the model's [[mechanism]] entries. The curve is followed around its folds; a sweep stays on
    its branch until that ends, and jumps. Where laws act only weakly this is the FRF times the force.

    For example:

        labnnum curve extended.toml --drive 2:x --force 10 --low 5 --high 40 -o curve.csv

        labnnum curve extended.toml --drive 2:x --force 10 --low 5 --high 40 --sweep backward -o down.csv
    """
    import json

    import numpy as np

    from labnnum.errors import ConfigError
    from labnnum.harmonic import HarmonicBalance
    from sessions.commands.printing import bar
    from sessions.curve import describe, in_words, require_writable, write_curve
    from sessions.model import read_model

    require_writable(output)
    if sweep not in ("", "forward", "backward"):
        raise ConfigError(f"--sweep {sweep!r}: expected forward or backward")
    if lines < 2:
        raise ConfigError(f"--lines {lines}: expected 2 or more")
    structure = read_model(model).structure
    place = drive or ("base" if structure.base else "")
    if not place:
        raise ConfigError('--drive is missing: expected "node:direction", such as ' + ", ".join(structure.dofs[:3]))
    made = HarmonicBalance(structure, place, force, tuple(response or ()), harmonics=harmonics)
    with bar("curve") as progress:
        found = made.curve(low, high, progress=lambda done, span: progress(round(1000 * done / span), 1000))
    swept = None
    if sweep:
        at = np.linspace(low, high, lines)
        swept = at, found.sweep(at, "forward" if sweep == "forward" else "backward")
    write_curve(output, found, swept)
    told = describe(found) | {"file": str(output)}
    typer.echo(json.dumps(told) if as_json else f"{output}: {in_words(told)}")
