"""quadratic-damping: drag that grows with the square of speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class QuadraticDamping(NonlinearMechanism):
    """f = c2 z' |z'|."""

    id = "quadratic-damping"
    title = "drag that grows with the square of speed"
    equation = "f = c2 z' |z'|"
    shows = "odd distortion; losses rise with level"
    told_apart = "coulomb-friction does the opposite"
    symbol = "dashpot, squared"
    reference = "Worden and Tomlinson (2001), section 2.2"
    names = ("c2",)
    units = ("N*s^2/m^2",)
    positive = True
    sides = False
