"""What the recordings cannot tell, whatever was found: linear from nonlinear at one level, and damping where they end
while the response still rings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labnnum.hammer import HitSettings

if TYPE_CHECKING:
    from labnnum.diagnosis.observe import Observation
    from labnnum.diagnosis.verdict import Diagnosis

APART = 1.2
"""Ratio of two levels from which they tell whether FRFs change with level."""
LEFT = HitSettings.settled
"""Part of its beginning that a mode may still have where a record ends."""
OPEN = ("missing-physics", "unexplained")
"""Verdicts that speak of physics that is missing."""


def one_level(observations: Sequence[Observation]) -> bool:
    """Whether no two levels are there."""
    levels = [o.level for o in observations if np.isfinite(o.level)]
    return bool(max(levels, default=0.0) < APART * min(levels, default=1.0))


def level_blind(observations: Sequence[Observation]) -> bool:
    """Whether nothing that was recorded tells linear from nonlinear: one level, and no lines left out of it."""
    return one_level(observations) and not any({"odd", "even"} & set(o.distortion) for o in observations)


def of_one_level(d: Diagnosis, observations: Sequence[Observation]) -> str:
    """That a name, or the lack of one, rests on one level, which cannot tell linear from nonlinear; empty where more
    was recorded, or nothing is missing.
    """
    if d.verdict not in OPEN or not observations or not level_blind(observations):
        return ""
    kinds = {o.kind for o in observations}
    what = "One level was recorded, and no line left out of it"
    if kinds in ({"hammer"}, {"frf"}):
        what = "All hits are of one level" if kinds == {"hammer"} else "FRFs alone tell no level"
    laws = [n for n in d.named if n.term.mechanism.domain not in ("nonlinear", "channel")]
    if not laws:
        return f" {what}: that cannot tell linear from nonlinear, and what is missing may change with level."
    first = laws[0]
    return (
        f" {what}: that cannot tell linear from nonlinear, and {first.term.mechanism.id} at {first.place} may stand for"
        " a law that changes with level."
    )


@dataclass(frozen=True)
class Ringing:
    """A mode that still rings where records end: their length and what would be enough, in s; Hz; part left."""

    hits: bool
    length: float
    enough: float
    frequency: float
    left: float


def ringing(d: Diagnosis, observations: Sequence[Observation]) -> Ringing | None:
    """The mode of the band that has most of its beginning left where a record of hits, noise or a sweep ends; None
    where all have died away, or every run is periodic.
    """
    engine = d.detail.get("engine")
    ends = [(o.kind == "hammer", _length(o)) for o in observations if o.recordings and o.kind in ("hammer", "random")]
    if engine is None or not ends:
        return None
    hits, length = min(ends, key=lambda e: e[1])
    seen = np.isin(engine.band_modes, engine.seen_modes)
    omega = engine.state(d.theta).omega[engine.band_modes]
    rate = np.where(seen & (omega > 0), omega * d.damping, np.inf)
    slowest = int(np.argmin(rate))
    left = float(np.exp(-rate[slowest] * length))
    if left <= LEFT:
        return None
    enough = float(-np.log(LEFT) / rate[slowest])
    return Ringing(hits, length, enough, float(omega[slowest] / (2 * np.pi)), left)


def _length(o: Observation) -> float:
    """Seconds in which a response may die away: of the shortest hit after its blow, or the longest stretch."""
    spans = [(b - a) / r.rate for r in o.recordings for a, b in r.spans()]
    return min(spans) - float(o.frf.settings.get("lead", 0.0)) if o.kind == "hammer" else max(spans)


def of_ringing(d: Diagnosis, observations: Sequence[Observation]) -> str:
    """That records end while the response still rings; empty where they do not, or nothing is missing."""
    found = ringing(d, observations) if d.verdict in OPEN else None
    if found is None:
        return ""
    mode = f"the mode at {found.frequency:.4g} Hz still has {100 * found.left:.2g} % of its beginning"
    if found.hits:
        return (
            f" Where the record of a hit ends, after {found.length:.3g} s, {mode}: the window that takes the rest off"
            " is allowed for, but damps more than the mode itself, and what is told of damping there rests on little."
        )
    return (
        f" Where a record ends, after {found.length:.3g} s, {mode}: leakage of its ends is told from what is missing"
        " there only as far as neighbouring lines tell it."
    )


def asked(d: Diagnosis, observations: Sequence[Observation], then: str) -> str:
    """The next experiment `then` with what would tell these: further levels, longer records."""
    if d.verdict not in OPEN or not observations:
        return then
    out = []
    if level_blind(observations):
        also = "" if "repeat at two further levels" in then.lower() else ": repeat at two and at four times the level"
        out.append(f"One level cannot tell linear from nonlinear{also}.")
    found = ringing(d, observations)
    if found is not None:
        after = "after a blow" if found.hits else "without a break"
        out.append(
            f"Record {found.enough:.2g} s or more {after}, in which the mode at {found.frequency:.4g} Hz dies away."
        )
    return " ".join([*out, then]).strip()
