"""A slider among several laws that leave too much: in its place many, or what yields gradually.

Of one law alone that is asked while places and laws are compared. A slider beside another law comes from what the
other leaves, and what it lacks itself is then taken up by neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, leads_of
from labnnum.diagnosis.nonlinear.effort import weary
from labnnum.diagnosis.nonlinear.explore import LONG
from labnnum.diagnosis.nonlinear.further import needed
from labnnum.diagnosis.nonlinear.stuck import smooth_of, spread_of
from labnnum.diagnosis.nonlinear.study import FINE
from labnnum.diagnosis.scatter import Scatter

LEAVES, SOFTER = 1.5, 0.8
"""Chi-square per value that laws leave above which their sliders are asked; and the part of what they cost to which
another form must bring it."""


def softened(study: Study, laws: Sequence[Tried], scatter: Scatter, alarm: float) -> list[Tried]:
    """The chain of laws, with a slider of it in another form where that leaves far less; as it is else, or after a long
    search.

    Parameters
    ----------
    laws : sequence of Tried
        The last one's fit holds all of them.
    alarm : float
        Chi-square by which a law must be missed (`needed`).
    """
    last = laws[-1]
    if len(laws) < 2 or last.made.data_part < LEAVES * last.made.count or weary():
        return list(laws)
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE).against(last)
    own, begin = leads_of(laws), last.made.x[: last.made.bare]
    made: list[Tried] = []
    for i, lead in enumerate(own):
        for soft in (spread_of(lead, lead.p), smooth_of(lead, lead.p)) if lead.mechanism == "stick-slip" else ():
            leads = [*own[:i], soft, *own[i + 1 :]]
            one = bench.both(begin, leads, LONG)
            made += [one] if one is not None else []
    best = min(made, key=lambda t: t.cost / t.made.count, default=None)
    if best is None or best.cost * last.made.count > SOFTER * last.cost * best.made.count:
        return list(laws)
    best = bench.carry_on(best, LONG, always=True, last=any(t.last for t in last.made.terms))
    chain = [replace(best, lead=lead, more=()) for lead in (best.lead, *best.more)]
    return needed(study, chain, scatter, alarm, FINE)
