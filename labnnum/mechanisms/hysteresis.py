"""hysteresis: gradual yielding (Bouc-Wen)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from labnnum.mechanisms.base import Term
from labnnum.mechanisms.nonlinear_law import NonlinearMechanism, less_spring
from labnnum.nonlinear import Element


@final
@dataclass(frozen=True)
class Hysteresis(NonlinearMechanism):
    """f = k h, dh/dz = 1 - (b sign(z' h) + 1 - b) |h/limit|^n; with `held` less k z, which the model holds already.

    With b between 1 and 2 the factor of the sign is 2 - b instead: the classes in which beta and gamma have opposite
    signs (Ismail, Ikhouane and Rodellar 2009). Loading then yields late, or stiffens from b = 1.5 on, and the limit is
    where the way back is twice as stiff as the beginning.
    """

    id = "hysteresis"
    title = "gradual yielding (Bouc-Wen)"
    equation = "f = k h, dh/dz = 1 - (b sign(z' h) + 1 - b) |h/limit|^n"
    shows = "a loop with memory that yields gradually, or whose loading stiffens"
    told_apart = "stick-slip yields at once; n and b trade off"
    symbol = "loop"
    reference = "Wen (1976)"
    names = ("k", "limit", "n", "beta_share", "held")
    units = ("N/m", "m", "1", "1", "1")
    positive = True
    sides = False
    defaults: ClassVar[dict[str, float]] = {"held": 0.0}
    whole: ClassVar[dict[str, tuple[int, int]]] = {"held": (0, 1)}

    def elements(self, term: Term, p: Sequence[float]) -> tuple[Element, ...]:
        """The law, and off it what the structure holds."""
        k, limit, n, share, held = (*(float(v) for v in p), 0.0)[:5]
        column = np.asarray(term.data["column"], float)
        of_sign = share if share <= 1.0 else 2.0 - share
        law = Element("bouc-wen", column, (k, of_sign / limit**n, (1.0 - share) / limit**n, n))
        return (law, *less_spring(column, held * k))
