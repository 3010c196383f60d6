"""Runs as they are compared: in the model's band, and held out with the channels of those that are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.pool import what_of
from labnnum.recording import Recording


def matched(o: Observation, like: Observation) -> Observation | None:
    """The observation with the responses of another, in their order; None where it lacks one, or has another input."""
    if what_of(o.frf.inputs) != what_of(like.frf.inputs):
        return None
    have, want = (what_of(one.frf.outputs) for one in (o, like))
    if have == want:
        return o
    if any(c not in have for c in want):
        return None
    rows = [have.index(c) for c in want]
    run = o.run and replace(o.run, y=o.run.y[rows], noise=o.run.noise[rows], outputs=like.frf.outputs)
    slope = None if o.drift_slope is None else o.drift_slope.rows(rows)
    distortion = {k: v[rows] if v.size == len(have) else v for k, v in o.distortion.items()}
    names = [c.name for c in like.frf.outputs]
    recordings = tuple(_less(r, names) for r in o.recordings)
    return replace(o, frf=o.frf.rows(rows), run=run, drift_slope=slope, distortion=distortion, recordings=recordings)


def within(o: Observation, span: tuple[float, float]) -> Observation:
    """The observation with its run compared inside a band in Hz only."""
    if o.run is None:
        return o
    inside = (o.run.frequency >= span[0]) & (o.run.frequency <= span[1])
    return replace(o, run=replace(o.run, use=inside if o.run.use is None else o.run.use & inside))


def _less(recording: Recording, outputs: Sequence[str]) -> Recording:
    """The recording with these responses, in this order, after all that is no response."""
    others = [c.name for c in recording.channels if c.role != "response"]
    return recording.select([*others, *outputs])
