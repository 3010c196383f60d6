"""Runs: which are held out, and what their levels and distortions say before any model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.pool import pool, require_one_set_up
from labnnum.frf import Frf

if TYPE_CHECKING:
    pass


def split_runs(observations: Sequence[Observation], held_out: Sequence[Observation]) -> tuple[Frf, Frf]:
    """Training and held-out FRFs."""
    if held_out:
        return pool(observations), pool(held_out)
    if len(observations) > 1:
        require_one_set_up(observations)
        kept = kept_back(observations)
        rest = [o for i, o in enumerate(observations) if i not in kept]
        return pool(rest), pool([observations[i] for i in sorted(kept)])
    frf = observations[0].frf
    if frf.frequency.size < 24:
        return frf, frf
    block = max(frf.frequency.size // 60, 1)
    back = (np.arange(frf.frequency.size) // block) % 4 == 2
    return frf.at(~back), frf.at(back)


CLEARER = 10.0
"""Decibels of distortion over the noise by which one run of a level must be ahead of another to be fitted instead."""


def kept_back(observations: Sequence[Observation]) -> set[int]:
    """Numbers of the runs held out: the last of each level that was repeated, else the last run.

    Where that one shows far more distortion than another of its level, the other is held out: a gap that one input
    closes and another does not can only be told from the first.
    """
    repeated = _of_repeated(observations, _by_level(observations))
    return repeated or {len(observations) - 1}


def kept_from_law(observations: Sequence[Observation]) -> set[int]:
    """Numbers of the runs held out of a search for what changes with level: as `kept_back` where a level was repeated;
    else the one in the middle of three levels or more, and none of two.

    The loudest shows the law best and may alone reach it, and the quietest what the structure is without.
    """
    groups = _by_level(observations)
    repeated = _of_repeated(observations, groups)
    if repeated or len(groups) < 3:
        return repeated
    return set(groups[sorted(groups)[len(groups) // 2]])


def _by_level(observations: Sequence[Observation]) -> dict[int, list[int]]:
    """Numbers of the runs of each level, in decibels; those of unknown level together."""
    groups: dict[int, list[int]] = {}
    for i, o in enumerate(observations):
        key = round(10 * np.log10(o.level)) if np.isfinite(o.level) and o.level > 0 else 0
        groups.setdefault(key, []).append(i)
    return groups


def _of_repeated(observations: Sequence[Observation], groups: dict[int, list[int]]) -> set[int]:
    """One run of each level that has more."""
    return {_least(observations, g) for g in groups.values() if len(g) > 1}


def _least(observations: Sequence[Observation], group: Sequence[int]) -> int:
    """The last of a group, or the one that distorts least where it is far behind the last."""
    kinds = ("odd_over_noise", "even_over_noise")
    seen = [max(float(np.max(observations[i].distortion.get(k, 0.0))) for k in kinds) for i in group]
    least = int(np.argmin(seen))
    return group[least] if seen[least] < seen[-1] - CLEARER else group[-1]


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
