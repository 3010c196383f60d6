"""Laws without a name beside the catalogue: found, fitted, and asked for the names that their places suggest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labnnum.diagnosis.locate import imitated
from labnnum.diagnosis.race import Entry, Race, no_peak, one_each, stage_of
from labnnum.diagnosis.scatter import Data
from labnnum.diagnosis.search import Lead, grid_score, subspace_score
from labnnum.diagnosis.task import Candidate, Task, afresh, among, idle, settled, winner_base
from labnnum.diagnosis.verdict import Limits
from labnnum.mechanisms.base import Term


def unnamed(task: Task, general: Sequence[Term], base: Candidate, named: Candidate) -> list[Candidate]:
    """The best unnamed laws, best first: smooth local ones, loose ones, and pairs where nothing else is enough."""
    plain = replace(task, counts={})
    single, pairs = ([t for t in general if t.width == k] for k in (1, 2))
    found = stage_of(plain, single, base, 4)[:2]
    if not settled(named.fit, task.data, task.limits):
        found += _imitated(plain, single, base)
    found += _loosened(plain, [t for t in general if t.width == 0], base)

    def enough(*, places: bool = False) -> bool:
        """Whether one of them explains all; of what acts at `places` only, since a channel may excuse anything."""
        some = [c for c in (*found, named) if c.last.groups or not places]
        best = min(some, key=lambda c: c.cost, default=base)
        return settled(best.fit, task.data, task.limits) or idle(task, base, best, task.data)

    if not enough():
        found += _surveyed(plain, single, base, 2)
    if pairs and not enough(places=True):
        found += [*_imitated(plain, pairs, base), *_surveyed(plain, pairs, base), *stage_of(plain, pairs, base, 4)[:2]]
    return sorted(found, key=lambda c: c.cost)


FREE = 3
"""Places, by what a free law there can do from one origin, at which one is fitted."""


def freely(task: Task, laws: Sequence[Term], base: Candidate, found: Sequence[Candidate]) -> Candidate | None:
    """The best free law, which says where something acts that no smooth law comes near; None where none is fitted.

    Begun as unnamed laws are (`_imitated`), from where the best of them, `found`, have put the model's own parameters
    too, and at their places from themselves, which they hold.
    """
    if not laws or base.terms:
        return None
    plain = replace(task, counts={})
    fresh = replace(base, fit=replace(base.fit, point=afresh(task.engine, base)))
    smooth = [c for c in found if c.last.mechanism.id == "local-law"][:2]
    race, entries = Race(plain, base), []
    for rung, origin in ((0, fresh), (1, base), *((2, winner_base(base, c)) for c in smooth)):
        level = task.ladder[rung]
        shown = [(*imitated(task.engine, level, origin.fit.point, t), t) for t in laws]
        shown.sort(key=lambda x: -x[0])
        entries += [Entry(Lead(t, p, share), rung, origin) for share, p, t in shown[:FREE]]
    for c in smooth:
        own = c.fit.point.terms[-c.last.n :]
        for t in laws:
            if t.place == c.last.place and t.variant == c.last.variant:
                start = np.concatenate([own, np.zeros(t.n - own.size)])
                entries.append(Entry(Lead(t, start, 0.0), None, winner_base(base, c)))
    race.run(entries)
    if race.found:  # nearer to the truth than any before it, and next to it perhaps
        there = winner_base(base, race.leader)
        shown = [(*imitated(task.engine, task.coarse, there.fit.point, t), t) for t in laws]
        shown = sorted((x for x in shown if x[2] is not race.leader.last), key=lambda x: -x[0])
        race.run([Entry(Lead(t, p, share), None, there) for share, p, t in shown[:FREE]])
    ahead = among(race.found, ())[:2]
    return min((plain.priced(c.terms, plain.refined(c.fit)) for c in ahead), key=lambda c: c.cost, default=None)


def _imitated(task: Task, laws: Sequence[Term], base: Candidate, each: int = 2, n: int = 2) -> list[Candidate]:
    """Laws fitted from the dynamic stiffness that the data show line by line at their places (`locate.imitated`).

    Nothing is assumed of its size on the way: an inerter that turns a joint's stiffness round within the band is out of
    reach from any small start.
    """
    if base.terms:
        return []
    nominal = afresh(task.engine, base)
    fresh = replace(base, fit=replace(base.fit, point=nominal))
    race, entries = Race(task, base), []
    for rung, origin in ((0, fresh), (1, fresh), (1, base)):
        level = task.ladder[rung]
        shown = [(*imitated(task.engine, level, origin.fit.point, t), t) for t in laws]
        shown.sort(key=lambda x: -x[0])
        entries += [Entry(Lead(t, p, share), rung, origin) for share, p, t in shown[:each]]
    race.run(entries)
    ahead = among(race.found, ())[:n]
    return sorted((task.priced(c.terms, task.refined(c.fit)) for c in ahead), key=lambda c: c.cost)


def _surveyed(task: Task, laws: Sequence[Term], base: Candidate, each: int = 3, n: int = 2) -> list[Candidate]:
    """Laws of many coefficients, best first: those whose coefficients together promise most, rung by rung, fitted."""
    x = base.fit.point.vector()
    nominal = afresh(task.engine, base).vector()
    levels = [(0, task.ladder[0], nominal), (1, task.ladder[1], x), (2, task.ladder[2], x), (None, task.coarse, x)]
    race, entries = Race(task, base), []
    for rung, level, at in levels:
        leads = subspace_score(task.engine, level, task.errors_on(level), laws, at, base.terms)
        entries += [Entry(lead, rung) for lead in sorted(leads, key=lambda lead: -lead.gain)[:each]]
    race.run(entries)
    ahead = among(race.found, ())[:n]
    return sorted((task.priced(c.terms, task.refined(c.fit)) for c in ahead), key=lambda c: c.cost)


def _loosened(task: Task, loose: Sequence[Term], base: Candidate, n: int = 2) -> list[Candidate]:
    """Terms without parameters, each fitted from the base and afresh: the base may have bent to what they excuse."""
    race = Race(task, base)
    leads = [Lead(term, np.zeros(0), 0.0) for term in loose]
    race.run([Entry(lead, rung) for lead in leads for rung in (0, None)])
    best = among(race.found, ())[:n]
    return [task.priced(c.terms, task.refined(c.fit)) for c in best]


def told_by(task: Task, terms: Sequence[Term], before: Candidate, law: Candidate) -> list[Candidate]:
    """Named terms at the nodes of an unnamed law, fitted from where the law has put the parameters.

    On sharp peaks a name may not find the way there by itself; what the law took for its dynamic stiffness shows it.
    """
    nodes = {law.last.place.id, law.last.place.to} - {None}
    here = [t for t in terms if nodes & {t.place.id, t.place.to} and law.last.groups and t.groups]
    if not here:
        return []
    race, origin = Race(task, before), winner_base(before, law)
    x = origin.fit.point.vector()
    entries = []
    for rung, level in ((None, task.coarse), (2, task.ladder[2])):
        leads = grid_score(task.engine, level, task.errors_on(level), here, x, before.terms)
        for lead in one_each(sorted(leads, key=lambda lead: -(lead.gain - 3.0 * lead.term.n)))[:5]:
            entries += [Entry(replace(lead, start=p), rung, origin) for p in (lead.start, *lead.others[:1])]
    race.run(entries)
    ahead = sorted(race.found, key=lambda c: c.cost)[:3]
    return [task.priced(c.terms, task.refined(c.fit)) for c in ahead if not no_peak(task, c)]


def told_all(law: Candidate | None, chain: Sequence[Candidate], data: Data, limits: Limits) -> bool:
    """Whether one unnamed law explains all and the best name does not."""
    if law is None or len(chain) != 2:
        return False
    return settled(law.fit, data, limits) and not settled(chain[-1].fit, data, limits)
