"""FRFs from the recordings of a session: estimated again with any settings, stored beside the raw data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from labnnum.calibration import corrected
from labnnum.errors import EstimationError
from labnnum.estimators import H1, H2, Hits, Hv, Welch, periodic
from labnnum.frf import Frf
from labnnum.local import local_frf
from labnnum.recording import Recording
from sessions.calibration import without_inputs
from sessions.pooling import Inputs, Uncoloured, Used, alike, averaged, inputs_of, used_of
from sessions.runs import Run
from sessions.screen import require_unclipped
from sessions.splitting import store_told, tell_apart
from sessions.store import Session

Method = Literal["auto", "H1", "H2", "Hv", "periodic", "local"]
ESTIMATORS = {"H1": H1, "H2": H2, "Hv": Hv}
AVERAGES = 16
"""Segments without overlap that a record is cut into where nobody says how long they are."""


@dataclass(frozen=True, slots=True)
class FrfSettings:
    """How FRFs are estimated; None and "auto" are decided by the recordings.

    Parameters
    ----------
    estimator : str
        "H1", "H2", "Hv", "periodic" (averaging of periods), "local" (rational functions of the whole record), or
        "auto": periodic where a period is known.
    segment : int or None
        Samples in a segment, or of each hit that are used; None is a period, or a burst with its silence.
    window : str or None
        One of `labnnum.windows.WINDOWS`; None is "hann" for noise and none for hits, periods and bursts.
    overlap : float or None
        Share of a segment that the next repeats; None is one half under a window and nothing under "boxcar".
    hits : bool or None
        Whether each stretch is one hammer hit; None looks at the force.
    decay : float
        1/s, exponential window on hits.
    gate : float
        Seconds of the force kept after its peak; 0 keeps all.
    lead : float or None
        Seconds of the force kept before its peak; as many as `gate` if None.
    keep_clipped : bool
        Estimate from clipped channels all the same.
    """

    estimator: Method = "auto"
    segment: int | None = None
    window: str | None = None
    overlap: float | None = None
    hits: bool | None = None
    decay: float = 0.0
    gate: float = 0.0
    lead: float | None = None
    keep_clipped: bool = False

    def __post_init__(self) -> None:
        for name, unit in (("decay", "1/s"), ("gate", "s")):
            if not 0 <= getattr(self, name) < np.inf:
                raise EstimationError(f"{name} is {getattr(self, name)}: it must be 0 or more, in {unit}")


def are_hits(recordings: Sequence[Recording]) -> bool:
    """Whether the recordings are hammer hits: each stretch has one short pulse of force, and nothing after it.

    Examples
    --------
    >>> from labnnum.recording import Channel
    >>> pulse = np.zeros((1, 1000)); pulse[0, 10:15] = 1.0
    >>> force = (Channel("f", "force", "reference"),)
    >>> are_hits([Recording(force, pulse, 1e3)]), are_hits([Recording(force, np.sin(np.arange(1000))[None], 1e3)])
    (True, False)
    """
    for recording in recordings:
        inputs = recording.with_role("reference")
        if len(inputs) != 1 or recording.period:
            return False
        force = np.abs(recording.data[inputs[0]])
        for start, stop in recording.spans():
            piece = force[start:stop]
            if np.count_nonzero(piece > 0.1 * piece.max(initial=0.0)) > 0.05 * piece.size:
                return False
    return bool(recordings)


def groups(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Recordings that belong in one estimate: the same channels (calibrated anew or not), rate, period and level."""
    out: dict[tuple[Any, ...], list[Recording]] = {}
    for r in recordings:
        level = None if np.isnan(r.level) else r.level
        out.setdefault((tuple(c.signal for c in r.channels), r.rate, r.period, r.burst, level), []).append(r)
    return list(out.values())


def chosen(recordings: Sequence[Recording], settings: FrfSettings) -> FrfSettings:
    """The settings with everything decided that was left open."""
    period, whole = recordings[0].period, recordings[0].period or recordings[0].burst
    estimator = settings.estimator
    welch = settings.window is not None or settings.overlap is not None or settings.segment is not None
    if estimator == "auto":
        estimator = "periodic" if period and not welch and settings.hits is not True else "H1"
    if estimator in ("periodic", "local"):
        return replace(settings, estimator=estimator, hits=False)
    hits = settings.hits
    if hits is None:
        hits = settings.window is None and settings.overlap is None and are_hits(recordings)
    if hits:
        return replace(settings, estimator=estimator, hits=True, window="boxcar", overlap=0.0)
    window = settings.window or ("boxcar" if whole else "hann")
    overlap = settings.overlap if settings.overlap is not None else 0.0 if window == "boxcar" else 0.5
    segment = settings.segment or whole or _usual_segment(recordings)
    return replace(settings, estimator=estimator, hits=False, window=window, overlap=overlap, segment=segment)


def _usual_segment(recordings: Sequence[Recording]) -> int:
    """A power of two that gives about `AVERAGES` segments without overlap."""
    lengths = [stop - start for r in recordings for start, stop in r.spans()]
    if not lengths or max(lengths) < 4:
        raise EstimationError(f"{recordings[0].label}: no unbroken stretch of it can be used")
    wanted = min(max(sum(lengths) // AVERAGES, 2), max(lengths))
    return 2 ** int(np.log2(wanted))


def played_lines(runs: Sequence[Run]) -> tuple[int, ...] | None:
    """Lines, multiples of rate / period, that were played in every run; None where a run does not know."""
    told = [run.info.get("lines") for run in runs]
    if not told or any(not lines for lines in told):
        return None
    return tuple(sorted(set.intersection(*(set(lines) for lines in told if lines))))


def estimate(recordings: Sequence[Recording], settings: FrfSettings, lines: Sequence[int] | None = None) -> Frf:
    """One FRF from all of `recordings`, which belong together; of runs of a session, see `estimate_runs`.

    `lines` that were played, where the bench knows them; else periodic estimates find them from the inputs.

    Raises
    ------
    ChannelError
        If a channel is clipped, and `keep_clipped` is not set; or not finite, constant or absent.
    EstimationError
        If no estimate exists under these settings: too few segments, unlike recordings, ...
    """
    return _estimated(recordings if settings.keep_clipped else usable(recordings, settings), settings, lines)


def estimate_runs(runs: Sequence[Run], recordings: Sequence[Recording], settings: FrfSettings) -> tuple[Frf, Used]:
    """One FRF from runs that belong together, without what their inputs did, and what of the runs it rests on.

    `recordings` are those of the runs. Raises as `estimate` does.
    """
    cleaned = recordings if settings.keep_clipped else usable(recordings, settings)
    used, lines, inputs = used_of(runs, recordings, cleaned), played_lines(runs), [inputs_of(run) for run in runs]
    if all(one == inputs[0] for one in inputs):
        return without_inputs(_estimated(cleaned, settings, lines), runs), used
    if chosen(cleaned, settings).estimator in ESTIMATORS:
        frf = _estimated(cleaned, settings, lines, inputs)
    else:
        frf = averaged([corrected(_estimated(held, settings, lines), told) for told, held in alike(cleaned, inputs)])
    said = {str(run.index): run.info.get("inputs", {}) for run in runs}
    return replace(frf, settings=frf.settings | {"inputs": said}), used


def _estimated(
    recordings: Sequence[Recording],
    settings: FrfSettings,
    lines: Sequence[int] | None,
    inputs: Sequence[Inputs] = (),
) -> Frf:
    """FRF from recordings as they are; `inputs` of each are divided out of its spectra where they are given."""
    if settings.segment is not None and settings.segment < 2:
        raise EstimationError(f"segment {settings.segment} must be 2 samples or more")
    done = chosen(recordings, settings)
    if done.estimator == "periodic":
        _require_period(recordings)
        return periodic(list(recordings), None if lines is None else np.array(lines))
    if done.estimator not in (*ESTIMATORS, "local"):
        raise EstimationError(
            f"estimator {done.estimator!r} is not one of auto, {', '.join(ESTIMATORS)}, periodic, local"
        )
    if (done.decay or done.gate) and not done.hits:
        raise EstimationError(
            f"{recordings[0].label}: decay and gate are for hammer hits, and this is none; say --hits if it is"
        )
    if done.estimator == "local":
        return local_frf(list(recordings))
    processor = processor_of(recordings, done)
    return ESTIMATORS[done.estimator](Uncoloured(processor, tuple(inputs)) if inputs else processor)(list(recordings))


def processor_of(recordings: Sequence[Recording], settings: FrfSettings) -> Hits | Welch:
    """What cuts the recordings into segments under these settings; into the usual ones where the estimator has none."""
    done = chosen(recordings, settings)
    if done.estimator not in ESTIMATORS:
        done = chosen(recordings, replace(settings, estimator="H1", hits=settings.hits or False))
    if done.hits:
        gate = (done.gate if done.lead is None else done.lead, done.gate) if done.gate else None
        return Hits(done.segment, done.decay, gate)
    assert done.segment is not None and done.window is not None and done.overlap is not None  # noqa: PT018
    return Welch(done.segment, done.window, done.overlap)


def usable(recordings: Sequence[Recording], settings: FrfSettings) -> list[Recording]:
    """Recordings without their overloaded stretches; of hammer hits the whole hit is left out.

    Raises
    ------
    ChannelError
        If a channel is clipped where nobody noticed.
    """
    out = []
    hits = chosen(recordings, settings).hits
    for recording in recordings:
        bad = [(a, b) for c, a, b in recording.overloads if recording.channels[c].role != "monitor"]
        if hits:
            bad = [s for s in recording.spans() if any(a < s[1] and b > s[0] for a, b in bad)]
        cleaned = replace(recording, excluded=(*recording.excluded, *bad))
        require_unclipped(cleaned, "or use it all the same with --keep-clipped")
        if not any(True for _ in cleaned.spans()):
            raise EstimationError(
                f"{recording.label}: every stretch of it is overloaded or excluded; lower the gain and record again"
            )
        out.append(cleaned)
    return out


def _require_period(recordings: Sequence[Recording]) -> None:
    for recording in recordings:
        if not recording.period:
            raise EstimationError(
                f"{recording.label}: has no period, so periods cannot be averaged; set period in channels.toml, or"
                " choose H1, H2 or Hv"
            )


def reprocess(
    session: Session,
    settings: FrfSettings,
    runs: Sequence[int] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[tuple[str, Frf]]:
    """Estimate an FRF from each group of runs and store it, beside it what lowers its coherence; (path in the session,
    FRF) of each.

    Parameters
    ----------
    session : Session
        Open for appending; its raw data are not touched.
    settings : FrfSettings
    runs : sequence of int
        Numbers of the runs to use; if empty, all that may be used: accepted, and complete where a generator played.
    progress : callable
        Told how many groups are done, and of how many.

    Raises
    ------
    EstimationError
        If there is no such run, or one that is named, or every one, may not be used: it says why.
    """
    known = {run.index: run for run in session.runs}
    missing = [n for n in runs if n not in known]
    if missing:
        raise EstimationError(f"{session.path}: there is no run {missing[0]}; there are {_listed(list(known))}")
    asked = [known[n] for n in (runs or sorted(known)) if known[n].n_samples]
    if not asked:
        raise EstimationError(f"{session.path}: there are no samples to estimate from")
    left_out = {run.index: why for run in asked if (why := run.unusable)}
    kept = [run for run in asked if run.index not in left_out]
    if not kept or (runs and left_out):
        said = "; ".join(f"run {n} {why}" for n, why in left_out.items())
        raise EstimationError(f"{session.path}: cannot be used: {said}")
    recordings = {run.index: run.recording() for run in kept}
    batches = groups(list(recordings.values()))
    out = []
    for i, batch in enumerate(batches):
        used = [n for n, r in recordings.items() if any(r is b for b in batch)]
        mine = [known[n] for n in used]
        frf, rests = estimate_runs(mine, batch, settings)
        said = {k: v for k, v in asdict(chosen(batch, settings)).items() if v is not None}
        told = {"runs": used, "requested": said, **_level(batch), **rests.settings}
        told |= {"left_out": {str(n): why for n, why in left_out.items()}} if left_out else {}
        path, name = session.add_frf(frf, told, name=_title(used, batch)), _title(used, batch)
        out.append((path, frf))
        cleaned = batch if settings.keep_clipped else usable(batch, settings)
        store_told(session, tell_apart(cleaned, processor_of(cleaned, settings), played_lines(mine), path), name)
        progress(i + 1, len(batches))
    return out


def _level(batch: Sequence[Recording]) -> dict[str, float]:
    return {} if np.isnan(batch[0].level) else {"level": batch[0].level}


def _title(used: Sequence[int], batch: Sequence[Recording]) -> str:
    level = "" if np.isnan(batch[0].level) else f", level {batch[0].level:g}"
    return f"runs {_listed(used)}{level}" if len(used) > 1 else f"run {used[0]}{level}"


def _listed(numbers: Sequence[int]) -> str:
    if len(numbers) > 2 and numbers[-1] - numbers[0] == len(numbers) - 1:
        return f"{numbers[0]} to {numbers[-1]}"
    return ", ".join(str(n) for n in numbers) or "none"
