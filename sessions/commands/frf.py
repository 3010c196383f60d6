"""labnnum frf: FRFs and coherence from the recordings of a session."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from labnnum.bands import Band
    from labnnum.frf import Frf
    from sessions.store import Session


def frf(
    session: Annotated[Path, typer.Argument(help="The session (.h5); its raw data stay as they are.")],
    estimator: Annotated[
        str, typer.Option(help="H1 (noise on responses), H2 (on the input), Hv, periodic, local, or auto.")
    ] = "auto",
    segment: Annotated[
        int | None, typer.Option(help="Samples in a segment: lines are rate / segment apart.", show_default=False)
    ] = None,
    window: Annotated[
        str | None, typer.Option(help="hann, boxcar, flattop, ...; a wrong name lists them.", show_default=False)
    ] = None,
    overlap: Annotated[
        float | None, typer.Option(help="Share of a segment that the next repeats, 0 to 1.", show_default=False)
    ] = None,
    run: Annotated[list[int] | None, typer.Option(help="Use this run only; repeat for several.")] = None,
    hits: Annotated[
        bool | None, typer.Option("--hits/--no-hits", help="Each stretch is one hammer hit. Default: look at it.")
    ] = None,
    decay: Annotated[float, typer.Option(help="Hits: exponential window, 1/s; its damping is taken out later.")] = 0.0,
    gate: Annotated[float, typer.Option(help="Hits: seconds of force kept around its peak; 0 keeps all.")] = 0.0,
    band: Annotated[
        list[str] | None, typer.Option(help="Judge coherence from LOW to HIGH Hz, as 50:2000; repeat.")
    ] = None,
    coherence: Annotated[float, typer.Option(help="Mean coherence below which a channel is warned of.")] = 0.9,
    strict: Annotated[bool, typer.Option("--strict", help="Fail if a channel is below it.")] = False,
    keep_clipped: Annotated[bool, typer.Option("--keep-clipped", help="Use clipped channels all the same.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")] = False,
) -> None:
    """Estimate FRFs with coherence and random error, and store them in the session.

    Runs with the same channels, rate, period and level are averaged together; other levels get an FRF of their
    own. Runs of a plan that were cut off, or without an accepted hit, are left out and named. Try as many settings as
    you like: each estimate is stored beside the others with the settings that made it, and the raw data are never
    touched. What is left open is decided from the recordings: periods are averaged where a period is known, hits and
    bursts are taken one by one, and noise is cut into segments under a Hann window.

    A low coherence is named with its likely cause: noise, leakage (a longer segment helps), nonlinearity, an
    overload. One average has coherence 1 whatever the data, and is not called good. What coherence lacks is told apart
    as far as the recordings allow: periods and realisations tell noise, nonlinear distortion and transients; noise and
    sweeps tell what leaks, and noise from distortion where one signal was played twice; hits tell noise from what
    differs between them. Of a sweep the harmonics are told, order by order.

    For example:

        labnnum frf beam.h5

        labnnum frf beam.h5 --window boxcar --segment 4096 --overlap 0.5 --estimator H1

        labnnum frf hits.h5 --hits --decay 20 --band 50:2000
    """
    import json
    from typing import cast

    from labnnum.errors import ConfigError
    from sessions.commands.printing import bar, finite
    from sessions.reprocess import FrfSettings, Method, reprocess
    from sessions.splitting import KIND, in_words, told_of
    from sessions.store import open_session

    bands = [_band(text) for text in band or []]
    if not 0 <= coherence <= 1:
        raise ConfigError(f"--coherence {coherence:g}: expected a number from 0 to 1")
    settings = FrfSettings(
        estimator=cast(Method, estimator),
        segment=segment,
        window=window,
        overlap=overlap,
        hits=hits,
        decay=decay,
        gate=gate,
        keep_clipped=keep_clipped,
    )
    with open_session(session, "a") as store, bar("estimating") as progress:
        _require_within(bands, store)
        done = reprocess(store, settings, run or [], progress)
        results = store.results(KIND)
    apart = {path: told_of(results, path) for path, _ in done}
    ranges = [(b.low, b.high) for b in bands]
    said = [_described(path, one, coherence, bands) for path, one in done]
    for (path, _), one in zip(done, said, strict=True):
        told = apart[path]
        one["split"] = told.as_dict(ranges) if told is not None else None
    if as_json:
        typer.echo(json.dumps(finite({"session": str(session), "frfs": said})))
    else:
        for (path, _), one in zip(done, said, strict=True):
            typer.echo(_text(one))
            told = apart[path]
            for line in in_words(told, ranges) if told is not None else ():
                typer.echo(f"  {line}")
    if strict:
        for _, one in done:
            one.require_coherence(coherence, bands)


def _band(text: str) -> Band:
    from labnnum.bands import Band
    from labnnum.errors import BandError

    low, _, high = text.partition(":")
    try:
        return Band(float(low), float(high))
    except ValueError as error:
        if isinstance(error, BandError):
            raise
        raise BandError(f"band {text!r} is not LOW:HIGH in Hz, such as 50:2000") from None


def _require_within(bands: list[Band], store: Session) -> None:
    """BandError for a band above half of every run's rate, before anything is estimated and stored."""
    from labnnum.errors import BandError

    top = max((run.rate for run in store.runs), default=0.0) / 2
    for band in bands:
        if store.runs and band.low >= top:
            raise BandError(f"band {band.low:g} to {band.high:g} Hz lies above half the sample rate, {top:g} Hz")


def _described(path: str, one: Frf, threshold: float, bands: list[Band]) -> dict[str, Any]:
    from dataclasses import asdict

    import numpy as np

    from labnnum.bands import band_mask
    from labnnum.quality import coherence_verdicts

    inside = band_mask(bands, one.frequency) if bands else one.frequency >= 0
    rows = one.coherence
    mean = {
        c.name: float(np.nanmean(rows[i][inside])) if rows is not None and inside.any() else None
        for i, c in enumerate(one.outputs)
    }
    return {
        "stored": path,
        "estimator": one.estimator,
        "n_averages": one.n_averages,
        "lines": int(one.frequency.size),
        "low": float(one.frequency[0]),
        "high": float(one.frequency[-1]),
        "inputs": [c.name for c in one.inputs],
        "settings": one.settings,
        "mean_coherence": mean,
        "peaks": {c.name: _peaks(one, i, inside) for i, c in enumerate(one.outputs)},
        "verdicts": [asdict(v) for v in coherence_verdicts(one, threshold, bands)],
    }


def _peaks(one: Frf, output: int, inside: Any, most: int = 12) -> list[float]:
    """Frequencies, in Hz, of the most prominent coherent peaks of an output's FRF to the first input."""
    import numpy as np
    from scipy.signal import find_peaks

    size = np.abs(one.value[output, 0])
    level = 20 * np.log10(np.maximum(size, size.max(initial=0.0) * 1e-12 + 1e-300))
    at, found = find_peaks(level, prominence=6.0)
    kept = inside[at]
    if one.coherence is not None and one.n_averages > 1:
        kept &= one.coherence[output, at] > 0.8
    strongest = at[kept][np.argsort(found["prominences"][kept])[::-1][:most]]
    return [float(f) for f in one.frequency[np.sort(strongest)]]


def _text(said: dict[str, Any]) -> str:
    from sessions.pooling import left_out_hits

    used = said["settings"]
    how = [f"{used[k]} {k}" for k in ("window",) if used.get(k)]
    how += [f"segments of {used['n_segment']}"] if used.get("n_segment") else []
    how += [f"overlap {used['overlap']:g}"] if used.get("overlap") else []
    averages = f"{said['n_averages']:.4g} averages"
    lines = [
        f"{said['stored']}  {said['estimator']}, {', '.join([*how, averages])}: {said['lines']} lines,"
        f" {said['low']:.6g} to {said['high']:.6g} Hz, inputs {', '.join(said['inputs'])}"
    ]
    for name, mean in said["mean_coherence"].items():
        told = "no coherence" if mean is None else f"mean coherence {mean:.4f}"
        peaks = ", ".join(f"{f:.6g}" for f in said["peaks"][name])
        lines.append(f"  {name}: {told}" + (f"; peaks {peaks} Hz" if peaks else ""))
    lines += [f"  note: run {n} is left out: it {why}" for n, why in used.get("left_out", {}).items()]
    if used.get("hits_left_out"):
        lines.append(f"  note: left out, as an overload touches it: {left_out_hits(used['hits_left_out'])}")
    if used.get("overloaded_seconds"):
        lines.append(f"  note: {used['overloaded_seconds']:.4g} s with overloads are left out")
    lines += [f"  warning: {v['reason']}" for v in said["verdicts"] if not v["ok"]]
    return "\n".join(lines)
