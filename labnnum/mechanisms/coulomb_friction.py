"""coulomb-friction: dry friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class CoulombFriction(NonlinearMechanism):
    """f = F sign(z')."""

    id = "coulomb-friction"
    title = "dry friction"
    equation = "f = F sign(z')"
    shows = "odd distortion whose share falls as the level rises; losses fall with level"
    told_apart = "quadratic-damping does the opposite; stick-slip is elastic before it slides"
    symbol = "slider"
    reference = "Den Hartog (1931)"
    names = ("F",)
    units = ("N",)
    positive = True
    sides = False
