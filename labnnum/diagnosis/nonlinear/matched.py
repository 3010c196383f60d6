"""Runs as they are compared: in the model's band, and held out with the channels of those that are fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from numpy.typing import NDArray

from labnnum.diagnosis.observe import Observation
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording


def matched(o: Observation, like: Observation) -> Observation | None:
    """The observation with the responses of another, in their order; None where it lacks one, or has another input."""
    if [_what(c) for c in o.frf.inputs] != [_what(c) for c in like.frf.inputs]:
        return None
    have, want = ([_what(c) for c in one.frf.outputs] for one in (o, like))
    if have == want:
        return o
    if any(c not in have for c in want):
        return None
    rows = [have.index(c) for c in want]
    run = o.run and replace(o.run, y=o.run.y[rows], noise=o.run.noise[rows], outputs=like.frf.outputs)
    slope = None if o.drift_slope is None else _with_rows(o.drift_slope, rows)
    distortion = {k: v[rows] if v.size == len(have) else v for k, v in o.distortion.items()}
    names = [c.name for c in like.frf.outputs]
    recordings = tuple(_less(r, names) for r in o.recordings)
    return replace(
        o, frf=_with_rows(o.frf, rows), run=run, drift_slope=slope, distortion=distortion, recordings=recordings
    )


def within(o: Observation, span: tuple[float, float]) -> Observation:
    """The observation with its run compared inside a band in Hz only."""
    if o.run is None:
        return o
    inside = (o.run.frequency >= span[0]) & (o.run.frequency <= span[1])
    return replace(o, run=replace(o.run, use=inside if o.run.use is None else o.run.use & inside))


def _what(c: Channel) -> tuple[str, str, float, str]:
    """What a channel is, and where."""
    return c.name, c.dof, c.sign, c.quantity


def _with_rows(frf: Frf, rows: Sequence[int]) -> Frf:
    def cut(a: NDArray | None) -> NDArray | None:
        return None if a is None else a[list(rows)]

    return replace(
        frf, value=frf.value[list(rows)], outputs=tuple(frf.outputs[i] for i in rows), variance=cut(frf.variance),
        coherence=cut(frf.coherence), shared=cut(frf.shared),
    )  # fmt: skip


def _less(recording: Recording, outputs: Sequence[str]) -> Recording:
    """The recording with these responses, in this order, after all that is no response."""
    others = [c.name for c in recording.channels if c.role != "response"]
    return recording.select([*others, *outputs])
