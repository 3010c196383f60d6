"""labnnum simulate: a session as a bench would have recorded it from a model."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

EXCITATIONS = ("random", "burst-random", "periodic-random", "multisine", "hammer", "sweep")


def simulate(
    model: Annotated[Path, typer.Argument(help="model.toml: the structure that is measured.", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="Session to write (.h5); must not exist.")],
    excitation: Annotated[
        str, typer.Option(help=f"What excites: {', '.join(EXCITATIONS)}.", rich_help_panel="Excitation")
    ] = "random",
    level: Annotated[
        list[float] | None,
        typer.Option(help="RMS of the force (N) or base acceleration (m/s^2); a hammer's peak. Repeat for a run each."),
    ] = None,
    duration: Annotated[float, typer.Option(help="Seconds to record (random, burst-random).")] = 30.0,
    periods: Annotated[int, typer.Option(help="Periods to record (periodic excitations).")] = 8,
    period: Annotated[int, typer.Option(help="Samples in a period, or in a burst with its silence.")] = 4096,
    realisations: Annotated[int, typer.Option(help="Runs at each level, each with its own waveform.")] = 1,
    detection: Annotated[
        int, typer.Option(help="Multisine: odd lines only, and one of each group of this many withheld; 0 excites all.")
    ] = 0,
    low: Annotated[float, typer.Option(help="Lower end of the band, Hz.")] = 0.0,
    high: Annotated[float | None, typer.Option(help="Upper end of the band, Hz; 0.4 of the rate if not given.")] = None,
    hits: Annotated[int, typer.Option(help="Hammer blows to record.")] = 5,
    tip: Annotated[
        str, typer.Option(help="Hammer tip: steel, aluminium, plastic, hard rubber, rubber, soft rubber.")
    ] = "plastic",
    interval: Annotated[
        float | None, typer.Option(help="Seconds between blows; as long as the response needs if not given.")
    ] = None,
    rate: Annotated[float, typer.Option(help="Samples per second.")] = 2560.0,
    drive: Annotated[
        str, typer.Option(help='Where it acts: "node:direction", or "base". Default: base if the model has one.')
    ] = "",
    response: Annotated[
        list[str] | None, typer.Option(help="node:direction of an accelerometer; repeat. Default: every translation.")
    ] = None,
    noise: Annotated[float, typer.Option(help="RMS of each channel's noise over that of its signal.")] = 0.0,
    bits: Annotated[int, typer.Option(help="Of the converter, with ranges that fit; 0 without steps.")] = 0,
    parameter: Annotated[
        list[str] | None, typer.Option("--set", help="Truth of one parameter, NAME=VALUE; others are nominal. Repeat.")
    ] = None,
    nonlinear: Annotated[
        list[str] | None,
        typer.Option(
            help='A nonlinear force: "cubic 2:x k3=1e9", "clearance 3:z 2:z k=1e5 gap=1e-4". It feels the first place'
            " less the second (or ground): a one-sided gap closes where that grows. Repeat."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same session.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Write the session that a bench would have recorded from a model.

    The structure is marched exactly in time, with what sensors and converters add; the file is a session like any
    other, so that estimates, updating and diagnosis can be tried before anything is built.

    `labnnum simulate model.toml --excitation random --low 5 --high 1000 --noise 0.01 --bits 12 -o run.h5`
    """
    import json
    from dataclasses import replace

    from rich.progress import Progress

    from drivers.simulated import Drive, Input
    from sessions.devices import laws_in, true_parameters
    from sessions.model import read_model
    from sessions.simulate import Bench, default_inputs, settling, simulate_run
    from sessions.store import create_session, require_new

    require_new(output)
    _check(excitation, rate, noise, bits, level or [], hits, realisations, interval)
    read = read_model(model)
    structure = read.structure
    theta = true_parameters(structure, _values(parameter or []), model)
    channel = _drive(structure, drive)
    inputs = [Input(c, full_scale=float("inf"), bits=0) for c in default_inputs(structure, channel, response or [])]
    bench = Bench(rate, noise, bits, seed=seed, tip=tip, interval=interval or 1.2 * settling(structure, theta))
    elements = [*(_element(structure, theta, text) for text in nonlinear or []), *laws_in(structure)]
    levels = level or [100.0 if excitation == "hammer" else 1.0]
    runs = [(one, r) for one in levels for r in range(realisations)]
    table = _excitation(excitation, duration, periods, period, detection, low, high, seed)
    with (
        _no_remains(output),
        create_session(output, model_text=model.read_text(encoding="utf-8")) as session,
        Progress(console=_stderr(), transient=True) as bar,
    ):
        for number, (one, again) in enumerate(runs):
            task = bar.add_task(f"level {one:g}", total=1.0)
            simulate_run(
                session, structure, theta, inputs, Drive(channel), table, replace(bench, seed=seed + 104729 * number),
                level=one, hits=hits, realisation=number, label=f"level {one:g} #{again + 1}", elements=elements,
                progress=lambda done, total, task=task: bar.update(task, completed=done / total),
            )  # fmt: skip
    told = {
        "session": str(output),
        "runs": len(runs),
        "channels": [i.channel.name for i in inputs],
        "parameters": {p.name: float(v) for p, v in zip(structure.parameters, theta, strict=True)},
    }
    if as_json:
        typer.echo(json.dumps(told))
    else:
        typer.echo(f"{output}: {len(runs)} run{'s' * (len(runs) > 1)} of {len(inputs)} channels; see 'labnnum info'")


def _check(
    excitation: str, rate: float, noise: float, bits: int, levels: list[float], hits: int, realisations: int,
    interval: float | None,
) -> None:  # fmt: skip
    """ConfigError that names the first option that cannot be."""
    from math import inf

    from labnnum.errors import ConfigError

    if excitation not in EXCITATIONS:
        raise ConfigError(f"--excitation {excitation!r}: expected one of {', '.join(EXCITATIONS)}")
    positive = [("--rate", rate), *(("--level", one) for one in levels)]
    positive += [("--interval", interval)] if interval is not None else []
    for name, value in positive:
        if not 0 < value < inf:
            raise ConfigError(f"{name} {value:g}: expected a positive number")
    if not 0 <= noise < inf:
        raise ConfigError(f"--noise {noise:g}: expected 0 or more")
    if not 0 <= bits <= 32:
        raise ConfigError(f"--bits {bits}: expected 1 to 32, or 0 for no steps")
    for name, count in (("--hits", hits), ("--realisations", realisations)):
        if count < 1:
            raise ConfigError(f"{name} {count}: expected 1 or more")


@contextmanager
def _no_remains(path: Path) -> Generator[None]:
    """What cannot be simulated leaves no file behind."""
    from labnnum.errors import LabnnumError

    try:
        yield
    except LabnnumError:
        path.unlink(missing_ok=True)
        raise


def _stderr():
    from rich.console import Console

    return Console(stderr=True)


def _values(texts: list[str]) -> dict[str, float]:
    from labnnum.errors import ConfigError

    out = {}
    for text in texts:
        name, equals, value = text.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise ConfigError(f"--set {text!r}: expected NAME=VALUE, such as E=1.05") from None
        if not equals:
            raise ConfigError(f"--set {text!r}: expected NAME=VALUE, such as E=1.05")
    return out


def _element(structure, theta, text: str):
    from drivers.simulated import element

    law, *words = text.split()
    places = [w for w in words if "=" not in w]
    values = _values([w for w in words if "=" in w])
    return element(structure, theta, law, *(places or [""])[:2], **values)


def _drive(structure, asked: str):
    from labnnum.errors import ConfigError
    from labnnum.recording import Channel

    if asked == "base" or (not asked and structure.base):
        if not structure.base:
            raise ConfigError(
                "--drive base: the model has no base excitation; set structure.base, or give node:direction"
            )
        return Channel("base", "acceleration", "base", "", structure.base)
    place = asked or next((d for d in structure.dofs if d.partition(":")[2] in ("x", "y", "z")), structure.dofs[0])
    node, _, direction = place.partition(":")
    structure.require_dof(f"{node}:{direction.lstrip('+-')}")
    moment = direction.lstrip("+-").startswith("r")
    return Channel("force", "moment" if moment else "force", "reference", node, direction)


def _excitation(kind, duration, periods, period, detection, low, high, seed):
    from pydantic import ValidationError

    from labnnum.errors import ConfigError
    from sessions.rig_tables import ExcitationTable

    name = {"sweep": "chirp"}.get(kind, kind.replace("-", " "))
    asked = {"kind": name, "duration": duration, "periods": periods, "period": period, "seed": seed, "low": low}
    asked |= {"high": high, "detection": detection, "odd": detection > 0}
    try:
        return ExcitationTable.model_validate(asked)
    except ValidationError as error:
        one = error.errors()[0]
        key = "".join(f"--{part} " for part in one["loc"])
        raise ConfigError(f"{key}{one['msg'].removeprefix('Value error, ')}") from None
