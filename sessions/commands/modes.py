"""labnnum modes: what a model is, and its natural frequencies."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def modes(
    model: Annotated[Path, typer.Argument(help="model.toml.", show_default=False)],
    count: Annotated[int, typer.Option("--count", "-n", help="How many of the lowest modes.", min=1)] = 10,
    as_json: Annotated[bool, typer.Option("--json", help="Print it as JSON.")] = False,
) -> None:
    """Check a model and print its natural frequencies, damping and how they follow each parameter.

    The last columns say by how many percent a mode's frequency moves when a parameter grows by one percent of
    itself, at the nominal values: a column of zeros is a parameter that no frequency in sight depends on, and two
    columns in proportion are parameters that frequencies alone cannot tell apart.

    For example:

        labnnum modes model.toml

        labnnum modes model.toml -n 4 --json
    """
    import json

    from sessions.model import fingerprint, read_model

    read = read_model(model)
    said = describe(read.structure, count) | {"file": str(model), "fingerprint": fingerprint(read)}
    typer.echo(json.dumps(said) if as_json else _text(said))


def describe(structure: Any, count: int) -> dict[str, Any]:
    """Kind, size and modes of a structure at its nominal parameters, as `--json` prints them."""
    import numpy as np

    from labnnum.response import mode_sensitivity

    found, slope = mode_sensitivity(structure, structure.nominal, count)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(found.frequency > 0, slope * structure.nominal[:, None] / found.frequency, 0.0)
    return {
        "kind": type(structure).__name__,
        "coordinates": int(found.shape.shape[0]),
        "base": structure.base,
        "supports": list(structure.supports),
        "parameters": [p.name for p in structure.parameters],
        "modes": [
            {"frequency": float(f), "damping_ratio": float(z), "share": {p.name: float(s) for p, s in row}}
            for f, z, row in zip(found.frequency, found.damping_ratio, _rows(structure.parameters, share), strict=True)
        ],
    }


def _rows(parameters: Any, share: Any) -> list[list[tuple[Any, float]]]:
    return [list(zip(parameters, column, strict=True)) for column in share.T]


def _text(said: dict[str, Any]) -> str:
    from sessions.commands.printing import table

    driven = f", base moves along {said['base']}" if said["base"] else ""
    held = f", supported at {', '.join(said['supports'])}" if said["supports"] else ", free"
    what = f"{said['kind']} of {said['coordinates']} coordinates{held}{driven}"
    title = f"{said['file']}: {what}; model {said['fingerprint']}"
    head = ["mode", "Hz", "damping %", *(f"% per % {name}" for name in said["parameters"])]
    rows = [
        [str(i), f"{m['frequency']:.6g}", f"{100 * m['damping_ratio']:.3g}", *(f"{s:.3f}" for s in m["share"].values())]
        for i, m in enumerate(said["modes"], 1)
    ]
    return f"{title}\n\n{table(head, rows)}"
