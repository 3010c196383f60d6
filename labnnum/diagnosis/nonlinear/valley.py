"""Down a curved valley: a last fit goes on where a law and the base trade with each other.

A slider that sticks is a spring at low levels, and the base's frequencies may hold that spring instead; a wrong motion
at the place is a wrong scale of the law. Both pairs move together along valleys that turn, in which the steps of a fit
are short and gain so little that it ends, far from the bottom: with frequencies and motions off by more than any
sound model's, and the law off by as much. The undamped step tells that: it promises a fall that the fit did not find.
A part of it is taken then, however high that leads, and the fit is begun again from there.
"""

from __future__ import annotations

import numpy as np

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, tried_fit
from labnnum.diagnosis.nonlinear.decision import MECHANISMS
from labnnum.diagnosis.nonlinear.effort import tired
from labnnum.diagnosis.nonlinear.fitting import promised
from labnnum.diagnosis.nonlinear.laws import NAMES, SHAPES
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.scales import powers
from labnnum.diagnosis.nonlinear.study import FINE
from labnnum.diagnosis.scatter import Scatter

PROMISE = 10.0
"""Fall of the objective that an undamped step must promise to be worth a try."""
PARTS = (1.0, 0.4, 0.15)
"""Parts of that step which are tried."""
KEPT = 0.2
"""Share of `PROMISE` that a part must keep to be followed further."""
DEAR = 10.0
"""Price of the motions at the places, beyond one each, from which they are tried as the model has them."""
ROUNDS, STEPS = 5, 12
"""Such steps at most, and those of a fit from where one leads."""
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
        ahead = _stepped(bench, one) or _straightened(bench, one)
        if ahead is None:
            break
        one = ahead
    return one


def _excess(one: Tried) -> float:
    """What a fit leaves per value, one at least: differences are as much too large."""
    return max(1.0, one.made.data_part / one.made.count)


def _units(law: str) -> tuple[str, ...]:
    """Units of a law's parameters; none where forces and motions do not tell them, which are then left."""
    units = MECHANISMS[NAMES.get(law, law)].units if law in SHAPES and law != "general" else ()
    return () if any("rad" in u for u in units) else units


def _straightened(bench: Bench, one: Tried) -> Tried | None:
    """The fit begun again with the motions at the places as the model has them, and laws that do the same through
    them, where the motions pay more than a sound model's: the motion that is off most was the law's scale.
    """
    joint = bench.joint_of(one.made.terms)
    x, m = one.made.x.copy(), joint.engine.band_modes.size
    dear, n = False, joint.n_base
    for i, term in enumerate(joint.terms):
        at = slice(n - (joint.k - i) * m, n - (joint.k - i - 1) * m)
        off = (x[at] / joint.std[at]) ** 2
        if np.sum(off) < DEAR + m:
            continue
        dear = True
        grown = 1.0 + x[at][np.argmax(off)]
        x[at] = 0.0
        first = n + sum(t.n for t in joint.terms[:i])
        for j, unit in enumerate(_units(term.mechanism)[: term.n]):
            force, motion = powers(unit)
            x[first + j] *= grown ** (force - motion)
    if not dear:
        return None
    value, _, _ = promised(joint, one.made)
    made = tried_fit(joint, x, one.made.orbits, one.lead, STEPS, always=True, more=one.more)
    return made if made is not None and value - made.made.objective > KEPT * PROMISE * _excess(one) else None


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
        if made is not None and value - made.made.objective > KEPT * least:
            return made
    return None
