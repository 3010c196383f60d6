"""quadratic-stiffness: spring whose force grows with the square of the motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class QuadraticStiffness(NonlinearMechanism):
    """f = k2 z^2."""

    id = "quadratic-stiffness"
    title = "spring whose force grows with the square of the motion"
    equation = "f = k2 z^2"
    shows = "even distortion and a mean shift that grow with level"
    told_apart = "one-sided-gap has a threshold"
    symbol = "parabola"
    reference = "Worden and Tomlinson (2001), section 2.2"
    names = ("k2",)
    units = ("N/m^2",)
    positive = False
    sides = False
