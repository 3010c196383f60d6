"""labnnum train: a network that answers with parameters, stored with all that its use needs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from labnnum.frf import Frf
    from labnnum.recording import Channel
    from labnnum.updating import Updater
    from sessions.model import Model


def train(
    model: Annotated[Path, typer.Argument(help="model.toml: structure, parameters and bands.", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="Updater to write (.h5); must not exist.")],
    frf: Annotated[
        Path | None,
        typer.Option(
            help="A measurement of the kind to come (session, or a file of FRFs): its channels, lines, window and"
            " random error are what the network is trained for.",
            rich_help_panel="What will be measured",
        ),
    ] = None,
    channels: Annotated[
        Path | None, typer.Option(help="channels.toml of --frf, if it is another program's file.")
    ] = None,
    response: Annotated[
        list[str] | None,
        typer.Option(
            help='Without --frf: "node:direction" of an accelerometer, or with its quantity,'
            ' "2:z:displacement". Repeat.',
            rich_help_panel="What will be measured",
        ),
    ] = None,
    drive: Annotated[
        list[str] | None,
        typer.Option(
            help='Without --frf: "node:direction" of a force, or "base". Repeat.',
            rich_help_panel="What will be measured",
        ),
    ] = None,
    step: Annotated[
        float | None,
        typer.Option(help="Without --frf: distance of the lines, Hz.", rich_help_panel="What will be measured"),
    ] = None,
    samples: Annotated[int, typer.Option(help="Parameter sets to train on.")] = 1000,
    centres: Annotated[
        int | None, typer.Option(help="Fewer centres than samples: least squares, for many or noisy samples.")
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same updater.")] = 0,
    features: Annotated[
        str, typer.Option(help="Input of the network: log, integrals, sphere; score for --noise.")
    ] = "log",
    network: Annotated[str, typer.Option(help="tuned, or printed (the dissertation's own).")] = "tuned",
    noise: Annotated[float, typer.Option(help="Random error put on the training FRFs, as a share of |H|.")] = 0.0,
    workers: Annotated[int, typer.Option(help="Processes; the numbers do not depend on it.")] = 1,
    scheduler: Annotated[
        str, typer.Option(help="Address of a dask scheduler (extra dask); the numbers do not depend on it.")
    ] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print the validation as JSON.")] = False,
) -> None:
    """Train an updater: a network from bands of FRFs to the model's parameters.

    FRFs of many parameter sets are computed from the model, seen through the window of the measurement; a radial
    basis function network learns the way back. That takes seconds to minutes, once; an estimate afterwards takes
    microseconds, and `labnnum update` refines it by least squares.

    An interrupted training goes on where it stopped when the same command is given again; with another measurement,
    channels, bands or options it begins anew.

    For example:

        labnnum train beam.toml --frf first-run.h5 -o beam-updater.h5

        labnnum train truck.toml --response 3:z:displacement --drive 1:z --step 0.02 -o truck-updater.h5
    """
    from sessions.model import read_model
    from sessions.updaters import require_free, save_updater

    require_free(output)
    _check(noise, centres, seed)
    read = read_model(model)
    like, outputs, inputs, lines = _measurement(read, frf, channels, response or [], drive or [], step)
    trained = _trained(
        read, outputs, inputs, lines, like, output, samples=samples, seed=seed, features=features, noise=noise,
        network=network, centres=centres, workers=workers, scheduler=scheduler,
    )  # fmt: skip
    save_updater(output, trained, read)
    _show(trained, output, as_json)


def _check(noise: float, centres: int | None, seed: int) -> None:
    """ConfigError that names the option that cannot be."""
    from math import inf

    from labnnum.errors import ConfigError

    if not 0 <= noise < inf:
        raise ConfigError(f"--noise {noise:g}: expected 0 or more, as a share of |H|")
    if centres is not None and centres < 1:
        raise ConfigError(f"--centres {centres}: expected 1 or more")
    if seed < 0:
        raise ConfigError(f"--seed {seed}: expected 0 or more")


def _measurement(read: Model, frf: Path | None, channels: Path | None, response: list[str], drive: list[str],
                 step: float | None):  # fmt: skip
    """The measurement itself if there is one, its channels and its lines."""
    import numpy as np

    from labnnum.errors import ConfigError
    from sessions.exchange import load_frf

    if frf is not None:
        found = load_frf(frf, channels)
        return found, found.outputs, found.inputs, found.frequency
    if not read.bands:
        raise ConfigError(f"{read.path}: has no [[band]]: say between which frequencies to look")
    if not response or step is None or not drive:
        raise ConfigError("without --frf, give --response, --drive and --step: what will be measured, and how finely")
    top = max(b.high for b in read.bands)
    bottom = min(b.low for b in read.bands)
    if not 0 < step <= top - bottom:
        raise ConfigError(f"--step {step:g} Hz must be positive and less than the width of the bands")
    lines = step * np.arange(np.floor(bottom / step), np.ceil(top / step) + 1)
    return None, tuple(_response(r) for r in response), tuple(_drive(d, read) for d in drive), lines[lines > 0]


def _response(text: str) -> Channel:
    from labnnum.errors import ConfigError
    from labnnum.recording import Channel

    parts = text.split(":")
    if len(parts) not in (2, 3):
        raise ConfigError(f'--response {text!r}: expected "node:direction" or "node:direction:quantity"')
    return Channel(text, parts[2] if len(parts) == 3 else "acceleration", "response", parts[0], parts[1])


def _drive(text: str, read: Model) -> Channel:
    from labnnum.errors import ConfigError
    from labnnum.recording import Channel

    if text == "base":
        return Channel("base", "acceleration", "base", "", read.structure.base)
    node, _, direction = text.partition(":")
    if not direction:
        raise ConfigError(f'--drive {text!r}: expected "node:direction", or "base"')
    quantity = "moment" if direction.lstrip("+-").startswith("r") else "force"
    return Channel(text, quantity, "reference", node, direction)


def _trained(read: Model, outputs, inputs, lines, like: Frf | None, output: Path, **options) -> Updater:
    import time

    from rich.console import Console
    from rich.progress import Progress

    from labnnum.updating import Updater
    from sessions.updaters import load_training, save_training, training_key
    from sessions.workers import executor

    workers, scheduler = options.pop("workers"), options.pop("scheduler")
    decisive = {k: v for k, v in options.items() if k != "centres"}
    key = training_key(read.structure, read.bands, outputs, inputs, lines, like, decisive)
    kept = output.with_name(f"{output.name}.training")
    written = time.monotonic()

    def keep(data) -> None:
        nonlocal written
        if time.monotonic() - written > 10 and not data.is_complete:
            save_training(kept, data, key)
            written = time.monotonic()

    resume = load_training(kept, key)
    console = Console(stderr=True)
    quiet = not console.is_terminal
    with Progress(console=console, transient=True, disable=quiet) as bar, executor(workers, scheduler) as pool:
        task = bar.add_task("Training FRFs", total=options["samples"])
        made = Updater.train(
            read.structure, read.bands, outputs, inputs, lines, like=like, resume=resume, save=keep, executor=pool,
            progress=lambda done, total: bar.update(task, completed=done, total=total), **options,
        )  # fmt: skip
    kept.unlink(missing_ok=True)
    return made


def _show(trained: Updater, output: Path, as_json: bool) -> None:
    import json

    from rich.console import Console
    from rich.table import Table

    names = [p.name for p in trained.structure.parameters]
    if as_json:
        rows = {n: {"e_avg": float(a), "e_max": float(b)} for n, a, b in zip(names, *trained.validation, strict=True)}
        typer.echo(json.dumps({"updater": str(output), "validation": rows, "settings": trained.settings}))
        return
    table = Table(title=f"{output}: error of the network alone, % over {256} sets from the prior")
    for heading in ("parameter", "mean", "largest"):
        table.add_column(heading, justify="left" if heading == "parameter" else "right")
    for name, mean, most in zip(names, *trained.validation, strict=True):
        table.add_row(name, f"{mean:.3g}", f"{most:.3g}")
    Console().print(table)
