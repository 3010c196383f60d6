"""Sweeps that begin at rest: what came before them is known, and counts as a part of the record."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.recording import Recording

__all__ = ["begins_at_rest", "lead_of", "led"]

LEAD = 1 / 3
"""Part of a sweep that is put before it, in which nothing moves: under a Hann window over both its first lines weigh
half and not nothing, and without one their phase turns from line to line, as that of what the ends leave does not."""
CALM, HEAD = 0.2, 4
"""RMS of every channel over the first sixteenth of a period, and these samples at least, of that over the first one
below which it is at rest: a sine that crosses zero has 0.3;"""
SLIGHT = 0.02
"""and of that over the whole sweep, below which a response is noise, or matters little."""


def lead_of(recordings: Sequence[Recording]) -> int:
    """Samples of rest to be put before each of several records, so that they share their lines; 0 unless all are sweeps
    that go up and begin at rest, equally long.
    """
    spans = [max(r.spans(), key=lambda span: span[1] - span[0]) for r in recordings]
    lengths = {(b - a, r.rate) for r, (a, b) in zip(recordings, spans, strict=True)}
    if len(lengths) != 1 or any(len(r.inputs) != 1 for r in recordings):
        return 0
    parts = [(r.data[:, a:b], r.inputs[0]) for r, (a, b) in zip(recordings, spans, strict=True)]
    n = spans[0][1] - spans[0][0]
    return int(LEAD * n) if all(goes_up(x[i]) and begins_at_rest(x, i) for x, i in parts) else 0


def led(x: NDArray, lead: int) -> NDArray[np.float64]:
    """Samples (channels, n) after `lead` samples in which nothing moves."""
    return np.pad(x, ((0, 0), (lead, 0))) if lead else x


def goes_up(u: NDArray) -> bool:
    """Whether a signal (n,) is one sine whose frequency rises: each of eight parts passes zero more often than the one
    before it, and is as large.
    """
    parts = np.array_split(u - np.median(u), 8)
    passes = np.array([np.count_nonzero(np.diff(np.signbit(p))) for p in parts])
    size = np.array([np.std(p) for p in parts])
    return bool(np.all(np.diff(passes) > 0) and passes[-1] > 2 * passes[0] and size.min() > size.max() / 4)


def begins_at_rest(x: NDArray, driver: int) -> bool:
    """Whether nothing moves yet where samples (channels, n) begin: all channels, the input `driver` too, are far below
    what they are within its first period. A record cut out of a longer one passes zero, and not so softly.
    """
    x = x - np.median(x, axis=1, keepdims=True)
    u = x[driver]
    loud = np.flatnonzero(np.abs(u) > 0.5 * np.max(np.abs(u)))
    turns = np.flatnonzero(np.diff(np.signbit(u)))
    turns = turns[turns > loud[0]] if loud.size else turns
    if turns.size < 2:
        return False
    period = 2 * int(turns[1] - turns[0])
    head = max(period // 16, HEAD)
    first = np.sqrt(np.mean(x[:, :head] ** 2, axis=1))
    then = np.sqrt(np.mean(x[:, head : head + max(period, 4 * HEAD)] ** 2, axis=1))
    heard = np.maximum(CALM * then, SLIGHT * np.std(x, axis=1))
    return bool(first[driver] < CALM * then[driver] and np.all(first < heard))
