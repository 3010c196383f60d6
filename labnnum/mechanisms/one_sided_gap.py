"""one-sided-gap: stop on one side, behind a gap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class OneSidedGap(NonlinearMechanism):
    """f = k max(z - g, 0)."""

    id = "one-sided-gap"
    title = "stop on one side, behind a gap"
    equation = "f = k max(z - g, 0)"
    shows = "even and odd distortion above a sharp threshold"
    told_apart = "quadratic-stiffness has no threshold"
    symbol = "stop"
    reference = "Worden and Tomlinson (2001), section 2.2"
    names = ("k", "g")
    units = ("N/m", "m")
    positive = True
    sides = True
