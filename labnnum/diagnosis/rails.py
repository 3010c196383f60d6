"""Channels at the end of their range: samples that pile up where a signal's distribution thins out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.clipping import returns, runs
from labnnum.recording import Recording


@dataclass(frozen=True, slots=True)
class Clip:
    """Samples at the end of a channel's range: share there, where (SI), the excess over chance, times there."""

    share: float
    level: float
    score: float
    times: int = 0


def rails_of(recordings: Sequence[Recording]) -> tuple[dict[str, Clip], dict[str, float]]:
    """Channels that look clipped in any recording, and each channel's largest magnitude."""
    clipped: dict[str, Clip] = {}
    peaks: dict[str, float] = {}
    for r in recordings:
        for c, x in zip(r.channels, r.data, strict=True):
            if c.role == "monitor":  # a tachometer's pulses end at one reading
                continue
            peaks[c.name] = max(peaks.get(c.name, 0.0), float(np.max(np.abs(x))))
            found = clipping(x) if c.role != "reference" else flat_top(x)
            if found.score > max(clipped[c.name].score if c.name in clipped else 0.0, 0.0):
                clipped[c.name] = found
    return clipped, peaks


def flat_top(x: NDArray) -> Clip:
    """Clipping of a pulse: more than three samples in a row at its very top."""
    top = float(np.max(np.abs(x)))
    if top == 0:
        return Clip(0.0, 0.0, 0.0)
    at = np.abs(x) > top * (1 - 1e-6)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(int), [0]])))
    longest = int(np.max(edges[1::2] - edges[::2], initial=0))
    return Clip(float(at.mean()), top, 10.0 if longest > 3 else 0.0)


WIDTHS = (0.001, 0.002, 0.005, 0.01)
"""Parts of the range at its end in which samples may pile up: at a rail alone, with the recorder's noise over it."""
INSIDE = 5.0
"""And of that in which the others lie with which these are compared."""
ENOUGH, EACH, MORE = 12, 4, 1.5
"""Samples at the end at least, in all and in each period of what repeats (a single peak leaves two there, and may leave
none just below); and how many times the others."""


def clipping(x: NDArray, repeats: int = 1) -> Clip:
    """Whether samples pile up at one end of a channel's range, where a signal's distribution thins out.

    The share of samples in the outermost part of the range is compared with the share in the four parts inside it:
    a signal with tails has fewer further out, peaks alone 0.8 times as many, a clipped signal many more. It stays
    there for several samples, or comes back to the very same value. Periods that are repeated `repeats` times tell no
    more than one does.
    """
    x = x - np.median(x)
    top = float(np.max(np.abs(x)))
    if top == 0 or x.size < 200:
        return Clip(0.0, 0.0, 0.0)
    worst = Clip(0.0, 0.0, 0.0)
    for side in (x, -x):
        edge, tied = float(np.max(side)), returns(side)
        for width in WIDTHS:
            outer = side > edge * (1 - width)
            n_outer = int(outer.sum())
            n_inner = int(np.count_nonzero(side > edge * (1 - INSIDE * width))) - n_outer
            stays = [b - a for a, b in runs(outer)]
            if (
                n_outer < max(ENOUGH, EACH * repeats)
                or n_outer <= MORE * (n_inner + 4)
                or not (tied or max(stays) >= 2)
            ):
                continue
            score = n_outer / (n_inner + 4)
            if score > worst.score:
                worst = Clip(n_outer / x.size, edge, float(score), len(stays))
    return worst
