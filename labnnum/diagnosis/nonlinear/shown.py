"""The recovered force against the motion with the law through it, for the page of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Study, Tried
from labnnum.diagnosis.nonlinear.laws import force_along


@dataclass(frozen=True, eq=False)
class Curve:
    """Recovered force against the motion, and the law along it, for one run."""

    level: float
    z: NDArray[np.float64]
    v: NDArray[np.float64]
    force: NDArray[np.float64]
    law: NDArray[np.float64]


def curves(found: Study, best: Tried) -> tuple[Curve, ...]:
    """Force recovered from the measurement and the law along the motion, at the best place, thinned for drawing."""
    here = best.spot.place, best.spot.axis.lstrip("-")
    mine = next((q for q in found.recovered if (q.spot.place, q.spot.axis) == here), None)
    if mine is None:
        return ()
    sign = -1.0 if best.spot.axis.startswith("-") else 1.0
    p, _ = best.made.law(0)
    full = np.zeros(10)
    full[: p.size] = p
    out = []
    for run, z, v, f in zip(found.runs, mine.z, mine.v, mine.f, strict=True):
        law = force_along(best.made.terms[0].shape, sign * z, sign * v, full) * sign
        pick = slice(0, None, max(z.size // 3000, 1))
        out.append(Curve(run.level, z[pick], v[pick], -f[pick], law[pick]))
    return tuple(out)
