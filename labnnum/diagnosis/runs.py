"""Runs: which are held out, and what their levels and distortions say before any model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.pool import pool
from labnnum.frf import Frf

if TYPE_CHECKING:
    pass


def split_runs(observations: Sequence[Observation], held_out: Sequence[Observation]) -> tuple[Frf, Frf]:
    """Training and held-out FRFs."""
    if held_out:
        return pool(observations), pool(held_out)
    if len(observations) > 1:
        kept = kept_back(observations)
        rest = [o for i, o in enumerate(observations) if i not in kept]
        return pool(rest), pool([observations[i] for i in sorted(kept)])
    frf = observations[0].frf
    if frf.frequency.size < 24:
        return frf, frf
    block = max(frf.frequency.size // 60, 1)
    back = (np.arange(frf.frequency.size) // block) % 4 == 2
    return frf.at(~back), frf.at(back)


def kept_back(observations: Sequence[Observation]) -> set[int]:
    """Numbers of the runs held out: the last of each level that was repeated, else the last run."""
    groups: dict[int, list[int]] = {}
    for i, o in enumerate(observations):
        key = round(10 * np.log10(o.level)) if np.isfinite(o.level) and o.level > 0 else 0
        groups.setdefault(key, []).append(i)
    repeated = [g[-1] for g in groups.values() if len(g) > 1]
    return set(repeated) if repeated else {len(observations) - 1}


def nonlinear_signs(observations: Sequence[Observation]) -> dict[str, float | None]:
    """Level dependence and distortion over all runs; None where the excitation cannot tell."""
    odd = [float(np.max(o.distortion["odd"])) for o in observations if "odd" in o.distortion]
    even = [float(np.max(o.distortion["even"])) for o in observations if "even" in o.distortion]
    return {
        "level_dependence": level_dependence(observations),
        "odd_distortion_db": max(odd) if odd else None,
        "even_distortion_db": max(even) if even else None,
    }


def level_dependence(observations: Sequence[Observation]) -> float | None:
    """Relative RMS change of the FRFs from the lowest to the highest level, noise taken out; None with one level."""
    known = sorted((o for o in observations if np.isfinite(o.level) and o.level > 0), key=lambda o: o.level)
    if len(known) < 2 or known[-1].level < 1.2 * known[0].level:
        return None
    low, high = known[0].frf, known[-1].frf
    shared, i, j = np.intersect1d(np.round(low.frequency, 6), np.round(high.frequency, 6), return_indices=True)
    if shared.size < 8:
        return None
    a, b = low.value[..., i], high.value[..., j]
    noise = 0.0
    for frf, at in ((low, i), (high, j)):
        if frf.variance is not None:
            noise = noise + np.sum(frf.variance[..., at])
    power = max(float(np.sum(np.abs(a - b) ** 2) - noise), 0.0)
    return float(np.sqrt(power / np.sum(np.abs(a) ** 2)))
