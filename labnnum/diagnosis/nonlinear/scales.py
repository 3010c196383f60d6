r"""What a wrong common scale of the force or of the model does to the parameters of a nonlinear law.

A linear model cannot tell a force that is read a little too small from a structure that is a little too stiff and
heavy throughout, and its ordinary errors leave both open. With the true force :math:`1 + \epsilon` times the one read
and the true structure :math:`1 + \mu` times the model, forces grow by the first and motions by the first over the
second, so that a parameter of unit N^a m^b is off by

.. math:: (1 + \epsilon)^a \left(\frac{1 + \epsilon}{1 + \mu}\right)^b

The fit does not see that: the motions in its laws are those of the model. Where the base is shaken instead, its motion
is read, motions grow by :math:`1 + \epsilon` and forces by :math:`(1 + \epsilon) (1 + \mu)`; the sensors then say
nothing of the structure's scale.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.scatter import Scatter


def powers(unit: str) -> tuple[int, int]:
    """Powers of N and of m in a unit such as "N*s^2/m^2".

    >>> powers("N*s^2/m^2")
    (1, -2)
    """
    out = {"N": 0, "m": 0}
    for i, part in enumerate(unit.split("/")):
        for name, power in re.findall(r"\b([A-Za-z]+)(?:\^(\d+))?", part):
            if name in out:
                out[name] += (int(power) if power else 1) * (1 if i == 0 else -1)
    return out["N"], out["m"]


def common(scatter: Scatter, n_out: int, based: bool = False) -> NDArray[np.float64]:
    """Covariance (2, 2) of the scales of input and structure, once `n_out` sensors have agreed with the model.

    Before: the gain of the input's channel, and the model's residues. What the sensors say, each with a gain of its
    own, is the difference of the two, or the first alone where the input is the motion of the base (`based`).
    """
    before = np.diag([scatter.gain**2, scatter.residue**2])
    seen = np.array([1.0, 0.0 if based else -1.0])
    told = before @ seen
    return before - np.outer(told, told) / (seen @ told + scatter.gain**2 / n_out)


def scale_std(
    units: Sequence[str], value: NDArray, scatter: Scatter, n_out: int, based: bool = False
) -> NDArray[np.float64]:  # fmt: skip
    """Standard deviations (n,) of parameters with these units that the common scales leave."""
    dimensions = [powers(u) for u in units]
    grown = np.array([(a + b, a if based else -b) for a, b in dimensions], float)
    relative = np.sqrt(np.einsum("ij,jk,ik->i", grown, common(scatter, n_out, based), grown))
    return relative * np.abs(value)
