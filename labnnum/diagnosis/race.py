"""The search for one more term: leads of both scores fitted, the best to the end, the winner tried elsewhere, again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.fit import changes_of, fit
from labnnum.diagnosis.scatter import Data
from labnnum.diagnosis.search import Lead, direction_score, grid_score, shortlist
from labnnum.diagnosis.task import Candidate, Task, afresh, among, idle, settled, winner_base
from labnnum.errors import ModelError
from labnnum.mechanisms.base import Place, Term


@dataclass(frozen=True, eq=False)
class Entry:
    """A lead that joins a race at a rung of the ladder, None below the last, about a model that is not the race's."""

    lead: Lead
    rung: int | None = None
    origin: Candidate | None = None


KEPT = (8, 6, 5, 4)
"""How many of those that are on a rung go on to the next, the last of these from every further one.

On broadened peaks rivals can be told: of the winners of forty searches all but two, which gained little, were among
the first four on the first rung. On the lines themselves the right one may stand a thousand times above the leader
until its last steps, and none is given up there. Nor is one where noise, or where each hit went, hides how large
errors are: shear in a free beam, whose FRFs came without their noise, is last on the first rung and best in the end.
"""


class Race:
    """Candidates for one more term, fitted."""

    def __init__(self, task: Task, before: Candidate) -> None:
        self.task, self.before = task, before
        self.found: list[Candidate] = []

    @property
    def leader(self) -> Candidate:
        """The best so far."""
        return min(self.found, key=lambda c: c.cost)

    def run(self, entries: Sequence[Entry]) -> None:
        """Entries down the ladder from their rungs, of which the best go on from each, fitted to the thinned lines."""
        task, on = self.task, []
        for rung, level in enumerate(task.ladder):
            on += [self._started(e) for e in entries if e.rung == rung]
            fitted = [self._fitted(terms, x, level) for terms, x in on]
            ranked = sorted((c for c in fitted if c is not None), key=lambda c: c.cost)
            best = _different(ranked)[: KEPT[min(rung, len(KEPT) - 1)] if task.ranked else None]
            on = [(c.terms, c.fit.point.vector()) for c in best]
        on += [self._started(e) for e in entries if e.rung is None]
        for terms, x in on:
            made = self._fitted(terms, x, None)
            self.found += [] if made is None else [made]

    def _started(self, entry: Entry) -> tuple[tuple[Term, ...], NDArray[np.float64]]:
        """The model before (at the origin's point) with the lead's term, and where its fit starts."""
        before = entry.origin or self.before
        old = afresh(self.task.engine, before) if entry.rung == 0 else before.fit.point
        x = replace(old, terms=np.concatenate([old.terms, entry.lead.start])).vector()
        return (*before.terms, entry.lead.term.fitted), x

    def _fitted(self, terms: tuple[Term, ...], x: NDArray, level: Data | None) -> Candidate | None:
        """Fitted to one level of the ladder, or to the thinned lines; None from a start that the model cannot hold,
        such as a mass below nothing.
        """
        task = self.task
        try:
            if level is None:
                goal = self.leader.fit.objective if self.found else None
                made = fit(task.engine, task.coarse, terms, task.scatter, x, steps=20, goal=goal)
            else:
                made = task.rough(terms, x, level)
        except ModelError:
            return None
        return task.priced(terms, made, level or task.coarse)


def _different(ranked: Sequence[Candidate]) -> list[Candidate]:
    """Candidates, best first, without those that ended where a better one of the same term did."""
    out: list[Candidate] = []
    for c in ranked:
        if not any(c.last is o.last and c.cost - o.cost < 1e-3 * o.cost + 0.5 for o in out):
            out.append(c)
    return out


def stage_of(task: Task, terms: Sequence[Term], before: Candidate, width: int) -> list[Candidate]:
    """The best candidates with one more term, best first: leads of both scores, fitted, raced, and fitted finely."""
    engine, scatter = task.engine, task.scatter
    x = before.fit.point.vector()
    nominal = afresh(engine, before).vector()
    fine = shortlist(direction_score(engine, task.coarse, scatter, terms, x, before.terms), width, task.counts)
    rough = shortlist(grid_score(engine, task.ladder[0], task.wide, terms, nominal, before.terms), width, task.counts)
    middle = grid_score(engine, task.ladder[1], task.wide, terms, x, before.terms) if task.counts else []
    race = Race(task, before)
    leads = [Entry(lead, 0) for lead in rough] + [Entry(lead, 1) for lead in shortlist(middle, 4, task.counts)]
    race.run([*leads, *(Entry(lead) for lead in (*fine, *(_faint(x) for x in fine[:3])))])
    begun = task.priced(before.terms, task.down(before.terms, x, len(task.ladder)), task.coarse)
    if not (race.found and idle(task, begun, race.leader, task.coarse)):
        _further(race, terms, rough)
    ahead = among([c for c in race.found if not no_peak(task, c)], ())[: width // 2 + 1]
    return sorted((task.priced(c.terms, task.refined(c.fit)) for c in ahead), key=lambda c: c.cost)


def _further(race: Race, terms: Sequence[Term], rough: Sequence[Lead]) -> None:
    """More starts where nothing settles what is left; the leader in other variants and places, the others beside it."""
    task, before = race.task, race.before
    if not race.found or not settled(race.leader.fit, task.coarse, task.limits):
        again = [x for x in rough[:4] if x.term.n in (1, 2, 3)]  # the more parameters, the more starts
        starts = [replace(lead, start=p) for lead in again for p in lead.others[: lead.term.n + 1]]
        race.run([Entry(lead, rung) for lead in starts for rung in (0, 2)])
    if race.found:
        done = {id(c.last) for c in race.found if c.cost < before.cost}
        _elsewhere(race, terms, done)
        if task.counts:
            _otherwise(race, terms)
            _again(race, terms, done)
        _mirrored(race, terms)


def no_peak(task: Task, c: Candidate) -> bool:
    """Whether an added mode is no peak of its own: it mends one that the structure has, lies outside the lines, where
    nobody sees a peak, or has run to a bound of its damping, as flanks and single lines make it do.
    """
    if not c.last.data.get("extra_mode"):
        return False
    engine, b = task.engine, task.engine.band_modes
    own = engine.state(c.fit.point.theta, changes_of(c.fit)).omega[b] * (1 + c.fit.point.shift) / 2 / np.pi
    frequency, ratio = c.fit.point.terms[c.fit.point.terms.size - c.last.n :][:2]
    if np.any(np.abs(own - frequency) < 0.015 * frequency):
        return True
    lines, damping = task.data.s.imag / 2 / np.pi, c.last.parameters[1]
    return not (lines[0] < frequency < lines[-1] and 1.05 * damping.lower < ratio < damping.upper / 1.05)


def _faint(lead: Lead) -> Lead:
    """The lead from its faintest start: the fitted errors already align the peaks, and are traded in step by step."""
    if not lead.term.n:
        return lead
    same_way = lead.term.starts[np.sign(lead.term.starts[:, 0]) == np.sign(lead.start[0])]
    if not same_way.size:
        return lead
    start = lead.start.copy()
    start[0] = same_way[np.argmin(np.abs(same_way[:, 0])), 0]
    return Lead(lead.term, start, lead.gain)


def _otherwise(race: Race, terms: Sequence[Term], n: int = 4) -> None:
    """The leader's mechanism in its other variants at the same place, such as both compliances of a clamp at once."""
    task, before, last = race.task, race.before, race.leader.last
    kin = [t for t in terms if t.mechanism.id == last.mechanism.id and t.place == last.place and t.fitted is not last]
    if not kin:
        return
    nominal = afresh(task.engine, before).vector()
    leads = grid_score(task.engine, task.ladder[0], task.wide, kin, nominal, before.terms)
    best = sorted(leads, key=lambda lead: -lead.gain)[:n]
    starts = [replace(lead, start=p) for lead in best for p in (lead.start, *lead.others)]
    race.run([Entry(lead, rung) for lead in starts for rung in (0, 2)[: min(lead.term.n, 2)]])


def _elsewhere(race: Race, terms: Sequence[Term], done: set[int], n: int = 4) -> None:
    """The leader's mechanism at the places where it was not tried, from the leader's parameters: its true rivals."""
    task, before, winner = race.task, race.before, race.leader
    kin = [
        t
        for t in terms
        if t.mechanism.id == winner.last.mechanism.id and id(t.fitted) not in done and t.n == winner.last.n
    ]
    if not kin or not winner.last.n:
        return
    p = winner.fit.point.terms[-winner.last.n :]
    sized = []
    for t in kin:
        scale = t.parameters[0].upper / winner.last.parameters[0].upper if np.isfinite(t.parameters[0].upper) else 1.0
        starts = np.array([[f * scale * p[0], *p[1:]] for f in (0.25, 0.5, 1.0, 2.0)] + [[p[0], *p[1:]]])
        low, high = [q.lower for q in t.parameters], [q.upper for q in t.parameters]
        sized.append(replace(t, starts=np.clip(starts, low, high)))
    origin = winner_base(before, winner)
    x = origin.fit.point.vector()
    own = {(str(t.place), t.variant): t for t in kin}
    leads = shortlist(grid_score(task.engine, task.coarse, task.scatter, sized, x, before.terms), n)
    leads = [Lead(own[str(lead.term.place), lead.term.variant], lead.start, lead.gain) for lead in leads]
    race.run([Entry(lead, None, origin) for lead in leads])


TWIN = 0.99
"""Correlation of the motions' sizes over the modes from which on a place is another one's mirror image."""


def _mirrored(race: Race, terms: Sequence[Term], n: int = 2) -> None:
    """The leader's mechanism at mirror images of its place, exactly as the leader has it, tried before or not: near
    each resonance they do the same, so that which of the two a search has settled is luck of its starts.
    """
    task, before, winner = race.task, race.before, race.leader
    shape = task.engine.state(task.engine.theta0).shape[:, task.engine.band_modes]
    own, last = _motions(winner.last.sought, shape), winner.last
    kin = [t for t in terms if t.mechanism.id == last.mechanism.id and t.n == last.n and t.place != last.place]
    twins = [(_likeness(own, _motions(t, shape)), t) for t in kin if t.variant == last.sought.variant]
    origin = winner_base(before, winner)
    p = winner.fit.point.terms[winner.fit.point.terms.size - last.n :]
    best = [t for likeness, t in sorted(twins, key=lambda pair: -pair[0]) if likeness > TWIN][:n]
    race.run([Entry(Lead(t, p, 0.0), None, origin) for t in best])


def _motions(term: Term, shape: NDArray) -> list[NDArray[np.float64]]:
    """How far each mode moves each group of the term's columns, at length one over the modes."""
    sizes = [np.linalg.norm(g.columns.T @ shape, axis=0) for g in term.groups]
    return [x / max(float(np.linalg.norm(x)), 1e-300) for x in sizes]


def _likeness(a: Sequence[NDArray], b: Sequence[NDArray]) -> float:
    """The least correlation of two terms' motions, group by group; nothing where they have none in common."""
    if not a or len(a) != len(b):
        return 0.0
    return min(float(x @ y) for x, y in zip(a, b, strict=True))


def _again(race: Race, terms: Sequence[Term], done: set[int], n: int = 5) -> None:
    """Every other term scored anew where the leader has put the parameters; at its own place, whatever was tried."""
    task, before, winner = race.task, race.before, race.leader
    origin = winner_base(before, winner)
    others = [t for t in terms if t.fitted is not winner.last]
    leads = grid_score(task.engine, task.ladder[1], task.wide, others, origin.fit.point.vector(), before.terms)
    leads = one_each(sorted(leads, key=lambda lead: -(lead.gain - 3.0 * lead.term.n)))
    here = [lead for lead in leads if lead.term.place.touches(winner.last.place)][:n]
    away = [lead for lead in leads if lead not in here and id(lead.term.fitted) not in done][: n - 1]
    starts = [replace(lead, start=p) for lead in here if lead.term.n > 1 for p in lead.others]
    entries = [Entry(lead, 2, origin) for lead in (*here, *away)]
    race.run([*entries, *(Entry(lead, rung, origin) for lead in starts for rung in (2, None))])


def one_each(leads: Sequence[Lead]) -> list[Lead]:
    """The best lead of each mechanism and place."""
    seen: set[tuple[str, Place]] = set()
    out = []
    for lead in leads:
        key = (lead.term.mechanism.id, lead.term.place)
        if key not in seen:
            seen.add(key)
            out.append(lead)
    return out
