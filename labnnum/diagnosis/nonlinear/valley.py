"""Down a curved valley: a last fit goes on where a law and the base trade with each other.

A slider that sticks is a spring at low levels, and the base's frequencies may hold that spring instead; a wrong motion
at the place is a wrong scale of the law. Both pairs move together along valleys that turn, in which the steps of a fit
are short and gain so little that it ends, far from the bottom: with frequencies and motions off by more than any
sound model's, and the law off by as much. The undamped step tells that: it promises a fall that the fit did not find.
A part of it is taken then, however high that leads, and the fit is begun again from there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, tried_fit
from labnnum.diagnosis.nonlinear.decision import MECHANISMS
from labnnum.diagnosis.nonlinear.effort import tired
from labnnum.diagnosis.nonlinear.fitting import promised
from labnnum.diagnosis.nonlinear.laws import NAMES, SHAPES
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.receptance import per_place
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
BEGUN, NEAR = 4, 0.5
"""Steps of such a beginning, and the part of what a fit leaves beyond the noise by which it may be behind then."""
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
    """The fit begun again with the motions at the places as the model has them, where they pay more than a sound
    model's, and with laws that do through them what they did: by the motion that is off most, by all of them, or as
    they are.
    """
    joint = bench.joint_of(one.made.terms)
    begin = [x for scaled in (_worst, _mean, None) if (x := _plain(joint, one.made.x, scaled)) is not None]
    if not begin:
        return None
    value, _, _ = promised(joint, one.made)
    tried = [tried_fit(joint, x, one.made.orbits, one.lead, BEGUN, more=one.more) for x in begin]
    best = min((t for t in tried if t is not None), key=lambda t: t.made.objective, default=None)
    if best is None or best.made.objective > value + NEAR * max(value - best.made.count, PROMISE):
        return None
    made = tried_fit(joint, best.made.x, best.made.orbits, one.lead, STEPS, always=True, more=one.more)
    return made if made is not None and value - made.made.objective > KEPT * PROMISE * _excess(one) else None


def _plain(joint: Joint, x: NDArray, scaled: Callable[[NDArray, NDArray], float] | None) -> NDArray[np.float64] | None:
    """The vector with motions that pay too much put back, and their laws scaled; None where none pays too much."""
    out, m, n = x.copy(), per_place(joint.engine), joint.n_base
    dear = False
    for i, term in enumerate(joint.terms):
        at = slice(n - (joint.k - i) * m, n - (joint.k - i - 1) * m)
        if np.sum((x[at] / joint.std[at]) ** 2) < DEAR + m:
            continue
        dear = True
        out[at] = 0.0
        grown = 1.0 if scaled is None else scaled(x[at], joint.std[at])
        first = n + sum(t.n for t in joint.terms[:i])
        for j, unit in enumerate(_units(term.mechanism)[: term.n]):
            force, motion = powers(unit)
            out[first + j] *= grown ** (force - motion)
    return out if dear else None


def _worst(motion: NDArray, std: NDArray) -> float:
    return float(1.0 + motion[np.argmax(np.abs(motion / std))])


def _mean(motion: NDArray, std: NDArray) -> float:
    return float(1.0 + np.sum(motion / std**2) / np.sum(1.0 / std**2))


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
        if value - made.made.objective > KEPT * least:
            return made
    return None
