"""Down a curved valley: a last fit goes on where a law and the base trade with each other.

A slider that sticks is a spring at low levels, and the base's frequencies may hold that spring instead. Both move
together along a valley that turns, in which the steps of a fit are short and gain so little that it ends, far from the
bottom: with frequencies off by more than any sound model's, and the law off by as much. The undamped step tells that:
it promises a fall that the fit did not find. A part of it is taken then, however high that leads, and the fit is begun
again from there. (What a place's motion and its law's scale share every fit evens by itself.)
"""

from __future__ import annotations

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, tried_fit
from labnnum.diagnosis.nonlinear.effort import tired
from labnnum.diagnosis.nonlinear.fitting import promised
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.study import FINE
from labnnum.diagnosis.scatter import Scatter

PROMISE = 10.0
"""Fall of the objective that an undamped step must promise to be worth a try."""
PARTS = (1.0, 0.4, 0.15)
"""Parts of that step which are tried."""
KEPT = 0.2
"""Share of `PROMISE` that a part must keep to be followed further."""
ROUNDS, STEPS = 5, 12
"""Such steps at most, and those of a fit from where one leads."""
DEARER = 1.1
"""Growth of the base's price from which a step is none down the valley: what draws it there is the price."""
FAR = 0.7
"""Largest relative change of a law's parameter in one step."""


def deepened(study: Study, one: Tried, scatter: Scatter) -> Tried:
    """The fit of simulated laws carried on as long as an undamped step promises more and part of it keeps some."""
    if not one.simulated:
        return one
    chosen = tuple(choose_lines(r, FINE, scatter.floor) for r in study.runs)
    bench = Bench(study.engine, study.point, study.runs, scatter, chosen)
    for _ in range(ROUNDS):
        if tired():
            break
        ahead = _stepped(bench, one)
        if ahead is None:
            break
        little = one.made.objective - ahead.made.objective < PROMISE * _excess(one)
        one = ahead
        if little:  # the bottom of the valley, where what is promised is roughness
            break
    return one


def _excess(one: Tried) -> float:
    """What a fit leaves per value, one at least: differences are as much too large."""
    return max(1.0, one.made.data_part / one.made.count)


def _stepped(bench: Bench, one: Tried) -> Tried | None:
    joint = bench.joint_of(one.made.terms)
    value, promise, there = promised(joint, one.made)
    least = PROMISE * _excess(one)
    if promise < least:
        return None
    n = one.made.n_base
    here = one.made.x
    change = abs(there[n:] - here[n:]) / (abs(here[n:]) + 0.05 * joint.scale[n:])
    most = min(1.0, FAR / max(float(change.max(initial=0.0)), 1e-12))
    for part in PARTS:
        x = here + part * most * (there - here)
        made = tried_fit(joint, x, one.made.orbits, one.lead, STEPS, always=True, more=one.more)
        if made is None or made.made.prior_part > DEARER * one.made.prior_part + PROMISE:
            continue
        gain = value - made.made.objective
        if gain > KEPT * least:
            return made
        if abs(gain) < KEPT * least:  # it has come back to the bottom, as one from nearer would
            return None
    return None
