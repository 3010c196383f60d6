"""stick-slip: spring in series with a dry slider (Jenkins)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.nonlinear_law import NonlinearMechanism


@final
@dataclass(frozen=True)
class StickSlip(NonlinearMechanism):
    """f = k_t (z - z_s), |f| <= F_s."""

    id = "stick-slip"
    title = "spring in series with a dry slider (Jenkins)"
    equation = "f = k_t (z - z_s), |f| <= F_s"
    shows = "softer with level, losses with a hump over level"
    told_apart = "coulomb-friction has no elastic part; hysteresis yields gradually"
    symbol = "spring and slider"
    reference = "Iwan (1966)"
    names = ("k_t", "F_s")
    units = ("N/m", "N")
    positive = True
    sides = False
