"""What a linear FRF does not tell: a structure throughout stiffer and heavier than its model.

Where everything of a structure is 1 + mu times the model, its resonances stay where they are and its responses are
smaller by one factor, which the gains of the channels hide. Parameters of what is missing are found relative to the
model; those that are a mass, a stiffness or a rate of damping are off by the same factor.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from labnnum.parameters import Parameter


def grows(unit: str) -> int:
    """Power of the structure's scale with which a quantity of this unit grows.

    >>> grows("N*m/rad"), grows("kg"), grows("m/N"), grows("Hz")
    (1, 1, -1, 0)
    """
    parts = unit.replace("(", "").replace(")", "").split("/")
    power = 0
    for i, part in enumerate(parts):
        for name, times in re.findall(r"\b([A-Za-z]+)(?:\^(\d+))?", part):
            if name in ("N", "kg"):
                power += (int(times) if times else 1) * (1 if i == 0 else -1)
    return power


def with_scale(parameters: tuple[Parameter, ...], value: NDArray, std: NDArray, scale: float) -> NDArray[np.float64]:
    """Standard deviations `std` (n,) of `parameters`, with what a structure's common scale, `scale` relative, adds."""
    powers = np.array([grows(p.unit) for p in parameters], float)
    return np.hypot(std, np.abs(powers * value) * scale)
