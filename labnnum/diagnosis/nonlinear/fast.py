"""Dry friction that hardly ever slips: at the quietest level a place that is held fast.

A linear search finds a spring there, or a dashpot, so stiff that only its force is known. Friction beside a base that
was fitted without that is sought along a motion that is next to none, and with it in the structure nothing is left
for friction to hold. Here it takes the place of what holds, at the base beside which that was found.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, loudest
from labnnum.diagnosis.nonlinear.explore import LONG
from labnnum.diagnosis.nonlinear.fitting import reduced
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, recover
from labnnum.diagnosis.nonlinear.stuck import own_stiffness, spot_along
from labnnum.diagnosis.nonlinear.study import FINE
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Term

COARSE = 160
"""Lines of a run by which force and motion are recovered."""
FAST = 10.0
"""Force at a place, of what its own stiffness makes of the motion there, from which on the place is held fast."""
LIMITS = (0.95, 0.8, 0.6, 0.4, 0.2)
"""Limits of friction that are looked at, of the largest force that holds at the highest level: above it nothing slips,
and no fit is drawn anywhere."""


def held_fast(bench: Bench, x: NDArray, held: Sequence[Term], spots: Sequence[Spot]) -> tuple[tuple[Lead, ...], ...]:
    """Friction, one form a place, in the stead of what a structure holds and that holds its place fast.

    Parameters
    ----------
    bench : Bench
        Of the structure without it.
    x : ndarray
        Base vector of that.
    held : sequence of Term
        What the quietest level showed besides.
    """
    bench = bench.on(COARSE)
    high = int(np.argmax([r.level for r in bench.runs]))
    out = []
    for term in held:
        spot = spot_along(term, spots)
        if spot is None:
            continue
        q = recover(bench.joint([]), x, bench.point, spot)
        own = own_stiffness(bench.engine, spot.column)
        if np.std(q.f[high]) < FAST * own * np.std(q.z[high]):
            continue
        out.append((_nearest(bench, x, spot, float(np.max(np.abs(q.f[high]))), q.gain),))
    return tuple(out)


def fast_kin(study: Study, best: Tried, scatter: Scatter) -> list[Tried]:
    """Laws, the best first: the one given, and dry friction in its stead where it holds its place fast.

    What holds moves next to nothing, so that its own law hardly matters, and anything strong enough explains most: what
    little it does move tells friction, which lets go at a limit, from the rest.
    """
    loud = loudest(best, study.runs) if best.simulated else None
    if loud is None or best.more or best.mechanism == "coulomb-friction":
        return [best]
    force, motion = loud.time[:, 0], loud.motion[:, 0, 0]
    if np.std(force) < FAST * own_stiffness(study.engine, best.spot.column) * np.std(motion):
        return [best]
    bench, base = Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE), best.made.x[: best.made.bare]
    lead = _nearest(bench, base, best.spot, float(np.max(np.abs(force))), best.lead.gain)
    dry = bench.both(base, [lead], LONG)
    return [best] if dry is None else sorted([best, dry], key=lambda t: t.cost)


def _nearest(bench: Bench, x: NDArray, spot: Spot, most: float, gain: float) -> Lead:
    """Friction with the limit, of those looked at, that leaves least, the base as it stands."""
    forms = [Lead(spot, "coulomb-friction", _limit(part * most), gain) for part in LIMITS]
    return min(forms, key=lambda lead: _left(bench, x, lead))


def _limit(force: float) -> NDArray[np.float64]:
    p = np.zeros(N_P)
    p[0] = force
    return p


def _left(bench: Bench, x: NDArray, lead: Lead) -> float:
    """Objective of a law as it stands, over all runs; infinite where no steady state is found."""
    joint = bench.joint([lead])
    start = joint.start(x)
    orbits = joint.settle(start, [None] * len(bench.runs), 8)
    if any(o is None or not np.isfinite(o.closing) for o in orbits):
        return np.inf
    return reduced(*joint.parts(start, orbits))[0]
