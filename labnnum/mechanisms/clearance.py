"""clearance: play: a spring on both sides, behind gaps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class Clearance(NonlinearMechanism):
    """f = k (z -+ g) where |z| > g."""

    id = "clearance"
    title = "play: a spring on both sides, behind gaps"
    equation = "f = k (z -+ g) where |z| > g"
    shows = "odd distortion above a threshold"
    told_apart = "cubic-stiffness has no threshold; channel-clipping distorts one channel alone"
    symbol = "gap"
    reference = "Worden and Tomlinson (2001), section 2.2"
    names = ("k", "g")
    units = ("N/m", "m")
    positive = True
    sides = False
