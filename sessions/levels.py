"""Signs of nonlinearity level by level, for diagnosis.json and its page: distortion, change of the FRFs, what coherence
mixes, harmonics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from labnnum.diagnosis import Observation
from labnnum.diagnosis.runs import level_dependence
from labnnum.estimators import Hits, Welch
from labnnum.orders import Orders
from sessions.splitting import Told, tell_apart

SAME = 1.1
"""Ratio of two levels up to which they count as one."""
SEGMENTS = 16
"""Parts of a record that are averaged for its coherence."""


def per_level(observations: Sequence[Observation]) -> list[dict[str, Any]]:
    """A row for each kind of excitation and level, the quietest first, ready for JSON.

    Each holds kind, level (RMS of the input, or peak of a blow, in its SI unit), runs, odd_db and even_db (power on
    detection lines relative to the played ones, the largest of all responses) with odd_over_noise_db and
    even_over_noise_db, change (relative RMS change of the FRFs from the quietest level, noise taken out), shares (of
    the responses' power that ordinary coherence lacks, mean over responses and lines) and harmonics (order -> dB
    relative to the fundamental over the sweep, the largest of all responses); null where the excitation cannot tell.
    """
    rows = []
    for kind in dict.fromkeys(o.kind for o in observations):
        groups = _groups([o for o in observations if o.kind == kind])
        for group in groups:
            told = _told(group)
            rows.append(
                {
                    "kind": kind,
                    "level": None if not np.isfinite(group[0].level) else float(group[0].level),
                    "runs": sum(max(len(o.recordings), 1) if kind == "hammer" else 1 for o in group),
                    **{f"{name}{more}_db": _largest(group, name + more) for name in ("odd", "even")
                       for more in ("", "_over_noise")},
                    "change": None if group is groups[0] else _change(groups[0], group),
                    "shares": _shares(told),
                    "harmonics": None if told is None or told.harmonics is None else _harmonics(told.harmonics),
                }
            )  # fmt: skip
    return rows


def _groups(some: Sequence[Observation]) -> list[list[Observation]]:
    """Those of one level together, levels ascending; unknown ones last."""
    out: list[list[Observation]] = []
    for o in sorted(some, key=lambda o: o.level if np.isfinite(o.level) else np.inf):
        near = out and (o.level < SAME * out[-1][0].level or not np.isfinite(out[-1][0].level))
        if near:
            out[-1].append(o)
        else:
            out.append([o])
    return out


def _largest(group: Sequence[Observation], name: str) -> float | None:
    found = [float(np.max(o.distortion[name])) for o in group if name in o.distortion]
    return max(found) if found else None


def _change(lowest: Sequence[Observation], group: Sequence[Observation]) -> float | None:
    """The largest change of an FRF from a run of the quietest level to one of this."""
    found = [level_dependence([a, b]) for a in lowest[:1] for b in group if _alike(a, b)]
    return max((f for f in found if f is not None), default=None)


def _alike(a: Observation, b: Observation) -> bool:
    return a.frf.value.shape[:2] == b.frf.value.shape[:2] and [c.dof for c in a.frf.inputs] == [
        c.dof for c in b.frf.inputs
    ]


def _told(group: Sequence[Observation]) -> Told | None:
    """What the records of one level tell apart; None of FRFs, and where that cannot be made."""
    first = group[0]
    recordings = [r for o in group for r in o.recordings]
    if not recordings or any(r.channels != recordings[0].channels for r in recordings):
        return None
    if first.kind == "hammer":
        processor = Hits(decay=float(first.frf.settings.get("window_decay", 0.0)))
    else:
        longest = max(b - a for r in recordings for a, b in r.spans())
        processor = Welch(max(2 ** int(np.log2(max(longest // SEGMENTS, 2))), 2))
    return tell_apart(recordings, processor)


def _shares(told: Told | None) -> dict[str, float] | None:
    """Mean of each part over responses and lines; below zero means nothing."""
    if told is None or told.split is None:
        return None
    parts = {**told.split.parts, **told.split.beside}
    return {name: float(np.mean(part)) for name, part in parts.items()}


def _harmonics(found: Orders) -> dict[str, float | None]:
    """Order -> its power in the response that holds most of it; null where all are below their floor."""
    out: dict[str, float | None] = {}
    for row in found.table():
        if row["channel"] != found.channels[0].name:
            have, new = out.get(str(row["order"])), row["power_db"]
            out[str(row["order"])] = have if new is None else new if have is None else max(have, new)
    return out
