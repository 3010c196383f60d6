"""cubic-stiffness: spring whose force grows with the cube of the motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class CubicStiffness(NonlinearMechanism):
    """f = k3 z^3."""

    id = "cubic-stiffness"
    title = "spring whose force grows with the cube of the motion"
    equation = "f = k3 z^3"
    shows = "odd distortion, +2 dB per dB of level, no threshold; peaks bend"
    told_apart = "clearance has a threshold; quadratic-damping changes losses"
    symbol = "cubic"
    reference = "Worden and Tomlinson (2001), section 2.2"
    names = ("k3",)
    units = ("N/m^3",)
    positive = False
    sides = False
