"""labnnum update: parameters of the model from a measured FRF, with their standard deviations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from labnnum.parameters import Estimate
    from sessions.updating import Update


def update(
    measurement: Annotated[
        Path, typer.Argument(help="Session (.h5) with an FRF, or a file of FRFs.", show_default=False)
    ],
    updater: Annotated[Path | None, typer.Option("--updater", "-u", help="Trained by `labnnum train`.")] = None,
    model: Annotated[
        Path | None, typer.Option("--model", "-m", help="model.toml; without --updater it is fitted from nominal.")
    ] = None,
    frf: Annotated[str, typer.Option(help='Which FRF of the session, such as "results/frf/0002"; else the last.')] = "",
    channels: Annotated[Path | None, typer.Option(help="channels.toml, if it is another program's file.")] = None,
    method: Annotated[
        str,
        typer.Option(
            help="refined (network, then least squares), network, least-squares, or one of the classical methods:"
            " penalty, regularised, equation-error, output-error, filter."
        ),
    ] = "refined",
    prior: Annotated[bool, typer.Option("--prior", help="Count the parameters' priors as data.")] = False,
    floor: Annotated[
        float | None, typer.Option(help="Relative error of the model, added to the random error of every line.")
    ] = None,
    advise: Annotated[
        bool, typer.Option("--advise", help="Say which further sensor or band would narrow the parameters most.")
    ] = False,
    keep: Annotated[bool, typer.Option(help="Store the estimate in the session.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON and nothing else.")] = False,
) -> None:
    """Update a model's parameters from a measured FRF.

    With an updater, its network answers first and least squares on the FRF itself refine the answer; with a model
    alone, least squares start from its nominal values. The model is seen through the window of the measurement, and
    residuals are weighted by the measured random error. What comes out: values, standard deviations, chi2 (about 1
    where the model explains the data), and every reason to doubt them.

    For example:

        labnnum update run.h5 --updater beam-updater.h5

        labnnum update run.h5 --model beam.toml --json
    """
    from math import inf

    from labnnum.errors import ConfigError
    from sessions.updating import choose_frf, run_update, store

    if floor is not None and not 0 <= floor < inf:
        raise ConfigError(f"--floor {floor:g}: expected 0 or more, as a share of |H|")

    measured = choose_frf(measurement, frf, channels)
    done = run_update(measured, updater, model, method, prior=prior, floor=floor)
    if keep and measurement.suffix.lower() in (".h5", ".hdf5"):
        store(measurement, done)
    _show(done, as_json, _advice(done) if advise else None)


def _advice(done: Update) -> list[dict]:
    """Sensors and bands that would tell more, at the estimate."""
    from labnnum.bands import Band
    from labnnum.updating.advice import suggestions

    bands = done.bands or (Band(float(done.frf.frequency[1]), float(done.frf.frequency[-1])),)
    found = suggestions(
        done.structure, done.estimate.value, bands, done.frf.outputs, done.frf.inputs,
        highest=float(done.frf.frequency[-1]),
    )  # fmt: skip
    names = [p.name for p in done.estimate.parameters]
    return [
        {"kind": s.kind, "what": s.what, "std_ratio": dict(zip(names, s.deviation.tolist(), strict=True))}
        for s in found
    ]


def _show(done: Update, as_json: bool, advice: list[dict] | None) -> None:
    import json

    estimate = done.estimate
    if as_json:
        typer.echo(json.dumps(_plain(estimate) | ({} if advice is None else {"advice": advice})))
        return
    from rich.console import Console
    from rich.table import Table

    granted = f" with a model error of {100 * done.settings['floor']:.3g} %" if done.settings["floor"] else ""
    table = Table(title=f"{done.frf_name}: {estimate.method}, chi2 {estimate.chi2:.3g}{granted}")
    for heading in ("parameter", "value", "std", "unit", "nominal"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for p, v, s in zip(estimate.parameters, estimate.value, estimate.std, strict=True):
        table.add_row(p.name, f"{v:.6g}", f"{s:.2g}", p.unit, f"{p.nominal:.6g}")
    Console().print(table)
    for warning in estimate.warnings:
        typer.echo(f"warning: {warning}", err=True)
    for one in advice or ():
        name, ratio = min(one["std_ratio"].items(), key=lambda pair: pair[1])
        where = f"sensor at {one['what']}" if one["kind"] == "sensor" else f"band from {one['what']}"
        typer.echo(f"a {where} would bring the standard deviation of {name} to {100 * ratio:.3g} %")
    if advice == []:
        typer.echo("no further sensor, and no band that the FRF covers, would narrow the parameters by more than 1 %")


def _plain(estimate: Estimate) -> dict:
    return {
        "parameters": estimate.as_dict(),
        "correlation": estimate.correlation.tolist(),
        "chi2": float(estimate.chi2) if estimate.chi2 == estimate.chi2 else None,
        "method": estimate.method,
        "converged": bool(estimate.converged),
        "warnings": list(estimate.warnings),
    }
