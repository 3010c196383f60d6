"""labnnum demo: the whole way, from a recording to updated parameters, without any hardware."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from sessions.demo import Demo


def demo(
    seed: Annotated[int, typer.Option(help="Draws the true parameters, the excitation and the noise.", min=0)] = 0,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for the session, the updater and the report.")
    ] = Path("labnnum-demo"),
    samples: Annotated[int, typer.Option(help="Parameter sets to train on, the first time.", min=50)] = 1000,
    as_json: Annotated[bool, typer.Option("--json", help="Print true and estimated values and nothing else.")] = False,
) -> None:
    """Measure a beam on a simulated bench, update its model, and see how close it comes.

    A cantilevered aluminium beam with an accelerometer stands on a shaker (section 5.6 of Atalla's dissertation).
    Mass and inertia of the accelerometer and two damping constants are drawn at random; the bench shakes the base
    with noise from 5 to 1000 Hz, and two accelerometers with noise are digitised to 12 bits. From that session come
    the FRF (H1, Hann window) with its coherence, then the parameters: a trained network first, least squares on the
    FRF after it. The report is a page to open in a browser.

    The first run trains the network; later ones in the same folder load it.

    For example:

        labnnum demo --seed 3
    """
    from rich.console import Console

    from sessions.demo import STEPS, run_demo

    console = Console(stderr=True)
    with console.status("") as status:
        done = run_demo(
            output, seed, samples, lambda step: status.update(f"{STEPS.index(step) + 1}/{len(STEPS)} {step} ...")
        )
    if as_json:
        import json

        typer.echo(json.dumps(done.as_dict()))
    else:
        _show(done)


def _show(done: Demo) -> None:
    from rich.console import Console
    from rich.table import Table

    found = done.estimate
    table = Table(title=f"{found.method}, chi2 {found.chi2:.3g} (1 is chance)")
    for heading in ("parameter", "true", "estimated", "std", "unit", "error in std"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for p, value, std in zip(found.parameters, found.value, found.std, strict=True):
        true = done.truth[p.name]
        table.add_row(p.name, f"{true:.6g}", f"{value:.6g}", f"{std:.2g}", p.unit, f"{(value - true) / std:+.2f}")
    console = Console()
    console.print(table)
    for warning in found.warnings:
        typer.echo(f"warning: {warning}", err=True)
    typer.echo(f"session: {done.session}")
    typer.echo(f"updater: {done.updater}")
    typer.echo(f"report:  {done.report}   (open it in a browser)")
