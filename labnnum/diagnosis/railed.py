"""A channel that ends at one reading in several loud runs or hits, beside a structure that distorts all channels.

Distortion lines and FRFs that change with level tell a channel that clips from others that do not; where the structure
itself is nonlinear they say nothing. What is left is the rail: peaks that follow the input in all channels but one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.clipping import noise_level
from labnnum.diagnosis.observe import Observation

LOUD = 0.8
"""Level, of the loudest, from which on runs are looked at."""
PILED = 3.0
"""Excess of samples at the rail over those just inside it, in one of two runs that end there."""
ONE_RAIL = 1.005
"""Ratio of the peaks of two runs up to which they end at one reading."""
HITS = 3
"""Hits, the hardest of the loudest level, that must end at one reading,"""
EXACT, NOISES, ALIKE, VARIED = 1e-3, 6.0, 0.01, 0.04
"""their spread, relative: this, or so many deviations of the channel's noise up to a hundredth; and that of the other
channels in the middle: hits by hand differ by more."""


def railed(observations: Sequence[Observation]) -> list[str]:
    """Run by run, the channel that ends at a rail there; empty elsewhere, and everywhere where none does or several do.

    Parameters
    ----------
    observations : sequence of Observation
        With their highest readings (`peaks`), and those at which samples pile up (`clipped`).
    """
    none = [""] * len(observations)
    known = [o for o in observations if np.isfinite(o.level) and o.level > 0]
    if len(known) < len(observations) or not known:
        return none
    top = max(o.level for o in known)
    loud = [o for o in known if o.level > LOUD * top]
    hits = [o for o in loud if o.kind == "hammer"]
    rails = _of_hits(hits[0]) if len(hits) == len(loud) == 1 else _of_runs(loud)
    if len(rails) != 1:
        return none
    name, rail = rails.popitem()
    return [name if o.peaks.get(name, 0.0) > rail / ONE_RAIL else "" for o in observations]


def _of_runs(loud: Sequence[Observation]) -> dict[str, float]:
    """Channels in which samples pile up at the end of a run, and another one ends at the same reading."""
    out: dict[str, float] = {}
    for i, o in enumerate(loud):
        for name, clip in o.clipped.items():
            own = o.peaks.get(name, np.nan)
            ends = [other.peaks.get(name, np.nan) / own for j, other in enumerate(loud) if j != i]
            if clip.score > PILED and any(1 / ONE_RAIL < e < ONE_RAIL for e in ends):
                out[name] = min(out.get(name, np.inf), own)
    return out


def _of_hits(o: Observation) -> dict[str, float]:
    """Channels whose hardest hits end at one reading while those of the others do not."""
    every = [peaks_of(r.data[:, a:b]) for r in o.recordings for a, b in r.spans()]
    kept = [i for i, c in enumerate(o.recordings[0].channels) if c.role != "monitor"] if o.recordings else []
    names = [o.recordings[0].channels[i].name for i in kept]
    if len(every) < HITS or len(names) < 3:
        return {}
    hardest = np.sort(np.array(every)[:, kept], axis=0)[-HITS:]
    spread = hardest.max(axis=0) / np.maximum(hardest.min(axis=0), 1e-300) - 1.0
    noise = np.max([[noise_level(x) for x in r.data[kept]] for r in o.recordings], axis=0)
    limit = np.clip(NOISES * noise / np.maximum(hardest.min(axis=0), 1e-300), EXACT, ALIKE)
    out: dict[str, float] = {}
    for i, name in enumerate(names):
        if spread[i] < limit[i] and float(np.median(np.delete(spread, i))) > VARIED:
            out[name] = min(float(hardest[:, i].min()), o.peaks.get(name, np.inf))
    return out


def peaks_of(x: NDArray) -> NDArray[np.float64]:
    """Largest reading (n_channels,) of samples (n_channels, n) on the side on which it is larger."""
    return np.max(np.abs(x - np.median(x, axis=1, keepdims=True)), axis=1)
