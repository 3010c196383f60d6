"""A strong law's place: where else its force would do as well, and whether the law does better there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Tried
from labnnum.diagnosis.nonlinear.elsewhere import answered
from labnnum.diagnosis.nonlinear.locate import Spot
from labnnum.diagnosis.nonlinear.slack import BRIEF, FAR, SETTLED, STEPS
from labnnum.mechanisms.base import Place

ROUNDS, OTHERS, ALMOST = 3, 4, 0.9
"""How often a law moves on; places at which it is tried each time, at most; and the part of what its force removes
where it is that the force must remove there."""
CLOSE = 1.5
"""Cost, of the best so far, up to which a law at another place is carried on: there it has only begun."""
SOUND, FIRM = 4.0, 1.3
"""Times what noise leaves, up to which a law leaves nothing; the same of runs that are given no tolerance."""


def heard(bench: Bench, wide: Bench) -> float:
    """Chi-square per value that noise leaves at most of a law that explains all, with the tolerance of `wide`."""
    times = [FIRM if i in wide.firm else SOUND for i in range(len(wide.runs))]
    both = zip(times, bench.lines, wide.lines, strict=True)
    return float(np.mean(np.concatenate([np.ravel(n * (a.sigma / b.sigma) ** 2) for n, a, b in both])))


def moved(
    wide: Bench, x: NDArray, near: Sequence[Tried], spots: Sequence[Spot], noise: float
) -> list[Tried]:  # fmt: skip
    """The nearest law where it does better than at its own place, if it leaves more than `noise` a value there.

    Where a law holds a structure, the force that it makes at one place a slightly larger one makes at the next, and
    the share of the distortion tells little with few sensors. The force that was found says where the like would do as
    well; the law is fitted there, from its own base and from the vector `x`, and from the best once more.
    """
    best = min(near, key=lambda t: t.cost, default=None)
    if best is None:
        return []
    out: list[Tried] = []
    seen: set[tuple[Place, str]] = set()  # the law may come back to where it was, with what it learnt elsewhere
    for _ in range(ROUNDS):
        if best.made.data_part < noise * best.made.count:
            break
        bases = best.made.x[: best.made.bare], x
        leads = [q for gain, q in answered(wide, best.made.x, best, spots) if gain > ALMOST]
        fresh = [q for q in leads if q.spot.where not in seen][:OTHERS]
        made = [one for q in fresh if (one := wide.direct(bases, q, BRIEF, soften=False)) is not None]
        seen |= {q.spot.where for q in fresh}
        made = [wide.carry_on(t, STEPS, last=False) if t.cost < FAR * best.cost else t for t in made]
        first = min(made, key=lambda t: t.cost, default=best)
        if first.cost >= CLOSE * best.cost:
            break
        first = wide.carry_on(first, SETTLED, last=False)
        if first.cost >= best.cost:
            break
        best = first
        out.append(best)
    return out
