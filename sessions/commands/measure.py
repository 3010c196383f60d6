"""labnnum measure: run a plan on the bench."""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer


def measure(
    rig: Annotated[Path, typer.Argument(help="rig.toml: devices, channels, excitation, plan.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Session; taken up again if it exists. Default: rig's name, .h5."),
    ] = None,
    live: Annotated[
        bool, typer.Option("--live", help="Open a window: scope, spectrum, FRF, hits, lamps, stop.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show nothing while measuring.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print what came out as JSON.")] = False,
) -> None:
    """Measure what is left of the plan in a rig.toml, and estimate FRFs from it.

    Every block is on the disk before anything is computed from it. A plan that was interrupted, by you, a fault or
    the end of the day, goes on where it stopped when the same command is given again. With a shaker the generator
    is switched off first on any stop, limit or error.

    Keys while measuring: `a` accept and `r` reject the last hit, `u` undo, `n` next point, `q` stop.

    `labnnum measure rig.toml -o beam.h5 --live`
    """
    from sessions.bench import measure as run
    from sessions.devices import model_text
    from sessions.rig import read_rig

    found = read_rig(rig)
    path = output or rig.with_suffix(".h5")
    try:
        with _orderly(), _display(live, quiet) as display:
            outcome = run(found, path, display, model_text(found))
    except KeyboardInterrupt:
        typer.echo("labnnum: interrupted; the same command goes on from here", err=True)
        raise typer.Exit(130) from None
    e = found.toml.excitation
    _tell(outcome, (e.low, e.high or 0.4 * found.rate), as_json)
    if not outcome.complete:
        raise typer.Exit(3)


@contextmanager
def _orderly() -> Generator[None]:
    """A termination or a closed terminal ends the run like Ctrl-C does: the generator is switched off."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    here = threading.current_thread() is threading.main_thread()  # only there can signals be taken
    before = {one: signal.signal(one, stop) for one in known} if here else {}
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def _display(live: bool, quiet: bool):
    from sessions.display import Quiet, Text

    if live:
        from sessions.window.link import Window

        return Window()
    return Quiet() if quiet else Text()


def _coherence(frf, band: tuple[float, float]) -> float | None:
    """Mean coherence of the lines in the excitation's band; None if there is none."""
    import numpy as np

    inside = (frf.frequency >= band[0]) & (frf.frequency <= band[1])
    if frf.coherence is None or not np.isfinite(frf.coherence[..., inside]).any():
        return None
    return round(float(np.nanmean(frf.coherence[..., inside])), 6)


def _tell(outcome, band: tuple[float, float], as_json: bool) -> None:
    import json

    mean = {k: _coherence(f, band) for k, f in outcome.frfs.items()}
    if as_json:
        told = {
            "session": str(outcome.path),
            "complete": outcome.complete,
            "items": dict(outcome.items),
            "frfs": {
                k: {"averages": _number(f.n_averages), "mean_coherence": mean[k]} for k, f in outcome.frfs.items()
            },
            "messages": list(outcome.messages),
        }
        typer.echo(json.dumps(told))
        return
    for key, how in outcome.items.items():
        typer.echo(f"{key}: {how or 'to do'}")
    for key, frf in outcome.frfs.items():
        coherence = "" if mean[key] is None else f", mean coherence {mean[key]:.3f} from {band[0]:g} to {band[1]:g} Hz"
        typer.echo(f"FRF {key}: {frf.value.shape[0]} x {frf.value.shape[1]}, {frf.frequency.size} lines{coherence}")
    for text in outcome.messages:
        typer.echo(f"note: {text}", err=True)
    typer.echo(f"stored in {outcome.path}")


def _number(value: float) -> float | None:
    return None if value != value else float(value)
