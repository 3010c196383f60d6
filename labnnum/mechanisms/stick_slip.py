"""stick-slip: spring in series with a dry slider (Jenkins)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from labnnum.mechanisms.base import Term
from labnnum.mechanisms.nonlinear_law import NonlinearMechanism, less_spring
from labnnum.nonlinear import Element

SLIDERS = 8
"""Sliders that stand for limits that are spread, where no other number is told; at most."""


@final
@dataclass(frozen=True)
class StickSlip(NonlinearMechanism):
    """f = k_t (z - z_s), |f| <= F_s; with a `spread` several such `sliders` side by side, k_t and F_s of all together.

    Their limits are spread evenly over the mean one times 1 - spread to 1 + spread (Iwan 1966), so that they let go one
    after the other. Where the model was identified while it stuck, the model has k_t already (`held` 1): it then acts
    as f - k_t z, which is nothing until it slides.
    """

    id = "stick-slip"
    title = "spring in series with a dry slider (Jenkins)"
    equation = "f = k_t (z - z_s), |f| <= F_s"
    shows = "softer with level, losses with a hump over level"
    told_apart = "coulomb-friction has no elastic part; hysteresis yields gradually"
    symbol = "spring and slider"
    reference = "Iwan (1966)"
    names = ("k_t", "F_s", "spread", "sliders", "held")
    units = ("N/m", "N", "1", "1", "1")
    positive = True
    sides = False
    defaults: ClassVar[dict[str, float]] = {"spread": 0.0, "sliders": SLIDERS, "held": 0.0}
    whole: ClassVar[dict[str, tuple[int, int]]] = {"sliders": (1, SLIDERS), "held": (0, 1)}

    def elements(self, term: Term, p: Sequence[float]) -> tuple[Element, ...]:
        """One slider, or one for each part of the spread, and off them what the structure holds."""
        k, force, spread, many, held = (*(float(v) for v in p), *(0.0, SLIDERS, 0.0)[len(p) - 2 :])
        column = np.asarray(term.data["column"], float)
        less = less_spring(column, held * k)
        if spread == 0.0:
            return (Element("jenkins", column, (k, force)), *less)
        n = int(many)
        odds = 1.0 + spread * (2.0 * np.arange(n) + 1.0 - n) / n
        return (*(Element("jenkins", column, (k / n, force / n * float(o))) for o in odds), *less)
