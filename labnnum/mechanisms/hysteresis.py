"""hysteresis: gradual yielding (Bouc-Wen)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class Hysteresis(NonlinearMechanism):
    """f = k h, dh/dz = 1 - (b sign(z' h) + 1 - b) |h/limit|^n."""

    id = "hysteresis"
    title = "gradual yielding (Bouc-Wen)"
    equation = "f = k h, dh/dz = 1 - (b sign(z' h) + 1 - b) |h/limit|^n"
    shows = "a loop with memory that yields gradually"
    told_apart = "stick-slip yields at once; n and b trade off"
    symbol = "loop"
    reference = "Wen (1976)"
    names = ("k", "limit", "n", "beta_share")
    units = ("N/m", "m", "1", "1")
    positive = True
    sides = False
