"""Channels at the end of their range: samples that pile up where a signal's distribution thins out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.recording import Recording


@dataclass(frozen=True, slots=True)
class Clip:
    """Runs of samples at the end of a channel's range: share there, where (SI), the excess over chance."""

    share: float
    level: float
    score: float


def rails_of(recordings: Sequence[Recording]) -> tuple[dict[str, Clip], dict[str, float]]:
    """Channels that look clipped in any recording, and each channel's largest magnitude."""
    clipped: dict[str, Clip] = {}
    peaks: dict[str, float] = {}
    for r in recordings:
        for c, x in zip(r.channels, r.data, strict=True):
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


def clipping(x: NDArray) -> Clip:
    """Whether samples pile up at both ends of a channel's range, where a signal's distribution thins out.

    The share of samples in the outermost 0.5 % of the range is compared with the share in the 2 % inside it:
    a signal with tails has fewer further out, a clipped one many more, and stays there for several samples.
    """
    top = float(np.max(np.abs(x - np.median(x))))
    if top == 0 or x.size < 200:
        return Clip(0.0, 0.0, 0.0)
    z = (x - np.median(x)) / top
    worst = Clip(0.0, 0.0, 0.0)
    for sign in (1.0, -1.0):
        edge = float(np.max(sign * z))
        outer = sign * z > edge * 0.995
        inner = (sign * z > edge * 0.975) & ~outer
        n_outer, n_inner = int(outer.sum()), int(inner.sum())
        runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], outer.astype(int), [0]]))))[::2]
        longest = int(runs.max(initial=0))
        share = n_outer / x.size
        if n_outer >= 12 and n_outer > 1.5 * (n_inner + 4) and longest >= 2:
            score = n_outer / (n_inner + 4)
            if score > worst.score:
                worst = Clip(share, edge * top, float(score))
    return worst
