"""Forward selection of linear terms: base fit, search, full fits of the leads, and again on what is left."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Data, Fit, Scatter, changes_of, fit
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.search import Lead, broaden, direction_score, grid_score, shortlist, subspace_score, thin
from labnnum.diagnosis.verdict import Limits
from labnnum.errors import ModelError
from labnnum.frf import Frf
from labnnum.mechanisms.base import Freed, Place, Term

LADDER = (0.05, 0.015, 0.005, 0.0015)
"""Relative half-widths to which resonances are broadened on the way from a rough start to the lines themselves."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model with its terms, fitted."""

    terms: tuple[Term, ...]
    fit: Fit
    cost: float
    """Objective plus the price of the terms' parameters."""

    @property
    def last(self) -> Term:
        """The term added last."""
        return self.terms[-1]


@dataclass(frozen=True, eq=False)
class Selection:
    """How the forward selection went: the chain of accepted models, and each stage's candidates, best first."""

    chain: tuple[Candidate, ...]
    stages: tuple[tuple[Candidate, ...], ...]
    general: Candidate | None
    """The best general local law beside the first stage."""

    gains: dict[Place, float]
    """Place -> the most that any term there removed from the base's objective, fitted or scored."""


QUIET = 0.25
"""Least dispersion that is believed: smaller residuals may be luck, larger ones are taken as they are."""


def dispersion(made: Fit, data: Data) -> float:
    """Ratio of the residuals' variance to the assumed one, for the best model; gains are divided by it.

    McCullagh and Nelder (1989), section 4.5: with errors larger than assumed, differences of chi-square are too large
    by the same factor.
    """
    return max(QUIET, made.data_part / (2 * data.value.size))


def choose_lines(frf: Frf, n: int = 0) -> Frf:
    """At most `n` lines (400, or fewer with more than four rows), dense where the FRFs turn quickly.

    Lines are taken at equal increments of an arc length: the change of log H between neighbours, noise left out,
    plus an even share in log frequency.
    """
    n = n or int(np.clip(1600 // (frf.value.shape[0] * frf.value.shape[1]), 220, 400))
    if frf.frequency.size <= n:
        return frf
    h = frf.value.reshape(-1, frf.frequency.size)
    noise = np.sqrt(frf.variance.reshape(h.shape)) if frf.variance is not None else 0 * np.abs(h)
    size = np.sqrt(np.abs(h[:, 1:]) * np.abs(h[:, :-1])) + 1e-300
    turn = np.maximum(np.abs(np.diff(h, axis=1)) - 2 * noise[:, 1:], 0) / size
    turn = np.minimum(turn, 0.7).mean(axis=0)
    even = np.diff(np.log(frf.frequency))
    weight = 0.6 * turn / max(turn.sum(), 1e-300) + 0.4 * even / even.sum()
    arc = np.concatenate([[0], np.cumsum(weight)])
    pick = np.unique(np.searchsorted(arc, np.linspace(0, arc[-1], n)).clip(0, frf.frequency.size - 1))
    return frf.at(pick)


def data_of(frf: Frf, scatter: Scatter) -> Data:
    """Fit data of an Frf whose variance is known; an exponential window becomes a shift of s."""
    assert frf.variance is not None
    decay = float(frf.settings.get("window_decay", 0.0))
    s = np.asarray(decay + 1j * frf.omega, complex)
    return Data(s, frf.value, np.sqrt(frf.variance)).with_floor(scatter.floor)


@dataclass(frozen=True, eq=False)
class Task:
    """What every fit of one selection shares: lines, the same thinned, the same broadened, errors and limits."""

    engine: Engine
    data: Data
    coarse: Data
    ladder: tuple[Data, ...]
    scatter: Scatter
    limits: Limits
    counts: Mapping[str, int] = field(default_factory=dict)
    """How many terms each mechanism has: a name that may act in many places matches by chance more often."""

    def down(self, terms: Sequence[Term], x: NDArray, first: int = 0) -> Fit:
        """Fit the broadened data from rung `first` to the finest, then the thinned lines."""
        rough = x
        for level in self.ladder[first:]:
            rough = fit(self.engine, level, terms, self.scatter, rough, steps=8, tolerance=1.0).point.vector()
        return fit(self.engine, self.coarse, terms, self.scatter, rough, steps=20 if terms else 40)

    def refined(self, made: Fit, steps: int = 12) -> Fit:
        """A fit to the thinned lines carried on to all lines."""
        if self.coarse is self.data:
            return made
        return fit(self.engine, self.data, made.terms, self.scatter, made.point.vector(), steps=steps)

    def priced(self, terms: tuple[Term, ...], made: Fit) -> Candidate:
        """The fit as a candidate: its objective plus the price of its terms' parameters."""
        places = 2.0 * sum(np.log(self.counts.get(t.mechanism.id, 1)) for t in terms)
        given_up = self._given_up(terms, made)
        own = self.limits.parameter * sum(_count(t) for t in terms)
        return Candidate(terms, made, made.objective + own + places + given_up)

    def _given_up(self, terms: Sequence[Term], made: Fit) -> float:
        """What the rows of channels that a term gives up would cost if they fitted as the others do, or their noise."""
        n_o, n_i = len(self.engine.outputs), len(self.engine.inputs)
        share = sum(1 / n_o if t.data["dropped"] < n_o else 1 / n_i for t in terms if "dropped" in t.data)
        return max(made.data_part / (1 - share), 2.0 * self.data.value.size) * share if share else 0.0


def base_fit(task: Task, held: Sequence[Term], start: Point) -> Fit:
    """The structure as it is, its parameters, damping and ordinary errors fitted."""
    x = start.vector()
    found = [task.down(held, x, first) for first in range(len(task.ladder) + 1)]
    best = min(found, key=lambda f: f.objective)
    if best.prior_part > OFF * (best.point.shift.size + best.point.theta.size):
        best = min([best, *(task.down(held, p, 0) for p in _corners(task.engine, x))], key=lambda f: f.objective)
    typical = np.full_like(best.point.log_zeta, np.median(best.point.log_zeta))
    x = replace(best.point, log_zeta=typical).vector()
    again = fit(task.engine, task.coarse, held, task.scatter, x, steps=40)
    return task.refined(min(best, again, key=lambda f: f.objective), steps=40)


OFF = 4.0
"""Price of the fitted errors, a parameter, beyond which other starts are worth a try: two deviations each."""


def _corners(engine: Engine, x: NDArray) -> list[NDArray[np.float64]]:
    """Starts with one of the structure's parameters two deviations off, up and down."""
    out = []
    for i, p in enumerate(engine.structure.parameters):
        for step in (2.0, -2.0):
            y = x.copy()
            y[i] = np.clip(y[i] + step * p.spread, p.lower, p.upper)
            out.append(y)
    return out


LOOSE = Scatter(
    frequency=0.02, damping=1.5, residue=0.2, shape=0.15, gain=0.2, phase=0.1, complexity=0.1, remainder=0.5
)
"""Errors so large that only what no mode can follow is left: how much noise FRFs hold whose noise nobody measured."""


def with_noise_found(task: Task, held: Sequence[Term], start: Point) -> Data:
    """The data with `sigma` raised to what the structure's modes leave when they may have any frequency and shape."""
    made = base_fit(replace(task, scatter=LOOSE), held, start)
    return replace(task.data, sigma=task.data.sigma * np.sqrt(max(dispersion(made, task.data), 1.0)))


def select(
    engine: Engine, frf: Frf, terms: Sequence[Term], general: Sequence[Term], scatter: Scatter, limits: Limits,
    *, measured_noise: bool = True, initial: Sequence[tuple[Term, NDArray]] = (), depth: int = 3, width: int = 8,
    progress: Callable[[str], None] = lambda text: None,
) -> Selection:  # fmt: skip
    """Add the best term while it pays (`limits`), `depth` at most.

    Parameters
    ----------
    frf : Frf
        Training data with variance; lines are thinned here.
    terms : sequence of Term
        The catalogue at its places.
    general : sequence of Term
        General local laws, for location and for the decision to abstain.
    measured_noise : bool
        Whether the variance was measured; if not, it is raised to what a loose fit leaves.
    initial : sequence of (Term, values)
        Mechanisms that the model holds already.
    width : int
        Leads of each score that get a full fit.
    """
    data = data_of(choose_lines(frf), scatter)
    held = tuple(t for t, _ in initial)
    start = engine.start(held, np.concatenate([np.empty(0), *(p for _, p in initial)]))
    ladder = tuple(broaden(engine, data, start, held, k) for k in LADDER)
    counts = Counter(t.mechanism.id for t in terms)
    task = Task(engine, data, thin(data, data.s.size * 2 // 5), ladder, scatter, limits, counts)
    if not measured_noise:
        progress("estimating the noise")
        data = with_noise_found(task, held, start)
        task = replace(task, data=data, coarse=thin(data, data.s.size * 2 // 5))
    progress("fitting the model as it is")
    base = base_fit(task, held, start)
    chain = [Candidate(held, base, base.objective)]
    stages: list[tuple[Candidate, ...]] = []
    law: Candidate | None = None
    gains: dict[Place, float] = {}
    for stage in range(depth):
        left = _still_open(terms, chain[-1].terms)
        told = stage > 0 and _told(law, chain, data, limits)
        if stage and not told and _finished(task, left, chain[-1]):
            break
        progress(f"searching the catalogue for mechanism {stage + 1}")
        found = _stage(task, left, chain[-1], width)
        if not found:
            break
        if stage == 1:
            alone = _in_its_place(task, found, chain[-1])
            if alone is not None:
                chain[-1], stages = alone, [_order(alone, stages[0])]
                left = _still_open(terms, alone.terms)
                told = _told(law, chain, data, limits)
                if not told and _finished(task, left, alone):
                    break
                found = _stage(task, left, alone, width)
        stages.append(tuple(found))
        if stage == 0:
            laws = _unnamed(task, general, chain[0], found[0])
            law = laws[0] if laws else None
            if law is not None and found[0].cost - law.cost > limits.name:
                found = _among(found, _told_by(task, left, chain[0], law))
                stages[-1] = tuple(found)
            for c in [*found, *laws]:
                place = c.last.place
                gains[place] = max(gains.get(place, 0.0), base.objective - c.cost)
        best = _simplest(found, limits) if found else chain[-1]
        excess = max(dispersion(best.fit, data), 1.0)
        gain = (chain[-1].cost - best.cost) / excess
        if not found or gain < (limits.alarm if stage == 0 else limits.further):
            break
        if told and law is not None and best.cost > law.cost - limits.name:
            break  # two names are believed beside one law that explains all where they say it more simply
        chain.append(best)
    if len(chain) > 2:
        progress("looking again at what came first")
        chain, stages = _revisited(task, terms, chain, stages[: len(chain) - 1], width)
    return Selection(tuple(chain), tuple(stages), law, gains)


def _in_its_place(task: Task, found: Sequence[Candidate], first: Candidate) -> Candidate | None:
    """The best second mechanism without the first, where it does better alone than the first did: that had only been
    found because the second was out of reach from where the base stood.
    """
    alone = []
    for c in found[:2]:
        n = len(c.terms)
        alone.append(_with_terms(task, c, (*range(n - 2), n - 1)))
    best = min(alone, key=lambda c: c.cost)
    return best if best.cost < first.cost - task.limits.name else None


def _order(first: Candidate, others: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The first, then the others, each term once."""
    return (first, *(c for c in others if c.last is not first.last))


def _revisited(
    task: Task, terms: Sequence[Term], chain: list[Candidate], stages: list[tuple[Candidate, ...]], width: int
) -> tuple[list[Candidate], list[tuple[Candidate, ...]]]:
    """The chain with each mechanism but the last searched anew beside those that came after it.

    What was named while another was missing may have stood in for both.
    """
    held, last, found_anew = len(chain[0].terms), chain[-1], False
    for _ in range(len(stages) - 1):
        before = _with_terms(task, last, (*range(held), *range(held + 1, len(last.terms))))  # the eldest goes
        found = _stage(task, _still_open(terms, before.terms), before, width)
        if not found or found[0].cost > last.cost - task.limits.name:
            break
        last, stages, found_anew = found[0], [*stages[1:], tuple(found)], True
    if not found_anew:
        return chain, stages
    steps = [_with_terms(task, last, range(held + i + 1)) for i in range(len(stages) - 1)]
    return [chain[0], *steps, last], stages


def _with_terms(task: Task, last: Candidate, pick: Sequence[int]) -> Candidate:
    """The model with some of its terms only, fitted anew."""
    sizes = np.cumsum([0, *(t.n for t in last.terms)])
    kept = np.concatenate([np.zeros(0), *(np.arange(sizes[i], sizes[i + 1]) for i in pick)]).astype(int)
    terms = tuple(last.terms[i] for i in pick)
    point = replace(last.fit.point, terms=last.fit.point.terms[kept])
    return task.priced(terms, fit(task.engine, task.data, terms, task.scatter, point.vector(), steps=20))


def _still_open(terms: Sequence[Term], held: Sequence[Term]) -> list[Term]:
    """Terms that may still join: what a support has let go cannot be let go again."""
    gone = {t.place for t in held if isinstance(t.whole, Freed)}
    return [t for t in terms if not (isinstance(t.fitted.whole, Freed) and t.place in gone)]


def _told_by(task: Task, terms: Sequence[Term], before: Candidate, law: Candidate) -> list[Candidate]:
    """Named terms at the nodes of an unnamed law, fitted from where the law has put the parameters.

    On sharp peaks a name may not find the way there by itself; what the law took for its dynamic stiffness shows it.
    """
    nodes = {law.last.place.id, law.last.place.to} - {None}
    here = [t for t in terms if nodes & {t.place.id, t.place.to} and law.last.groups and t.groups]
    if not here:
        return []
    race, origin = _Race(task, before), winner_base(before, law)
    x = origin.fit.point.vector()
    for level in (task.coarse, task.ladder[2]):
        leads = grid_score(task.engine, level, task.scatter, here, x, before.terms)
        for lead in _one_each(sorted(leads, key=lambda lead: -(lead.gain - 3.0 * lead.term.n)))[:5]:
            for p in (lead.start, *lead.others[:1]):
                race.enter(replace(lead, start=p), None if level is task.coarse else 2, origin)
    ahead = sorted(race.found, key=lambda c: c.cost)[:3]
    return [task.priced(c.terms, task.refined(c.fit)) for c in ahead if not _shadows(task.engine, c)]


def _among(found: Sequence[Candidate], more: Sequence[Candidate]) -> list[Candidate]:
    """Candidates of two searches, best first, each term once."""
    best: dict[int, Candidate] = {}
    for c in (*found, *more):
        if id(c.last) not in best or c.cost < best[id(c.last)].cost:
            best[id(c.last)] = c
    return sorted(best.values(), key=lambda c: c.cost)


def _told(law: Candidate | None, chain: Sequence[Candidate], data: Data, limits: Limits) -> bool:
    """Whether one unnamed law explains all and the best name does not."""
    if law is None or len(chain) != 2:
        return False
    return settled(law.fit, data, limits) and not settled(chain[-1].fit, data, limits)


def _finished(task: Task, terms: Sequence[Term], last: Candidate) -> bool:
    """Whether the model explains the data, and no step along any term's signature promises a mechanism more."""
    if not settled(last.fit, task.data, task.limits):
        return False
    x = last.fit.point.vector()
    leads = direction_score(task.engine, task.coarse, task.scatter, terms, x, last.terms)
    most = max((lead.gain - task.limits.parameter * _count(lead.term) for lead in leads), default=0.0)
    return most < 0.5 * task.limits.further  # a score at first order, beside what a fit may gain


def settled(made: Fit, data: Data, limits: Limits) -> bool:
    """Whether a fit leaves no more than noise, and asks of the structure no more than a sound one does."""
    errors = made.point.shift.size + made.n_theta
    return made.data_part < limits.unsettled * 2 * data.value.size and made.prior_part < OFF * errors


def _unnamed(task: Task, general: Sequence[Term], base: Candidate, named: Candidate) -> list[Candidate]:
    """The best unnamed laws, best first: smooth local ones, loose ones, and pairs where nothing else is enough."""
    plain = replace(task, counts={})
    single, pairs = ([t for t in general if t.width == k] for k in (1, 2))
    found = _stage(plain, single, base, 4)[:2]
    found += _loosened(plain, [t for t in general if t.width == 0], base)

    def enough() -> bool:
        best = min([*found, named], key=lambda c: c.cost)
        return settled(best.fit, task.data, task.limits)

    if not enough():
        found += _surveyed(plain, single, base, 2)
    if pairs and not enough():
        found += [*_surveyed(plain, pairs, base), *_stage(plain, pairs, base, 4)[:2]]
    return sorted(found, key=lambda c: c.cost)


def _surveyed(task: Task, laws: Sequence[Term], base: Candidate, each: int = 3, n: int = 2) -> list[Candidate]:
    """Laws of many coefficients, best first: those whose coefficients together promise most, rung by rung, fitted."""
    x = base.fit.point.vector()
    nominal = _afresh(task.engine, base).vector()
    levels = [(0, task.ladder[0], nominal), (1, task.ladder[1], x), (2, task.ladder[2], x), (None, task.coarse, x)]
    race = _Race(task, base)
    for rung, level, at in levels:
        leads = subspace_score(task.engine, level, task.scatter, laws, at, base.terms)
        for lead in sorted(leads, key=lambda lead: -lead.gain)[:each]:
            race.enter(lead, rung)
    ahead = _among(race.found, ())[:n]
    return sorted((task.priced(c.terms, task.refined(c.fit)) for c in ahead), key=lambda c: c.cost)


def _loosened(task: Task, loose: Sequence[Term], base: Candidate, n: int = 2) -> list[Candidate]:
    """Terms without parameters, each fitted from the base and afresh: the base may have bent to what they excuse."""
    found = []
    nominal = _afresh(task.engine, base).vector()
    for term in loose:
        terms = (*base.terms, term)
        made = [task.down(terms, base.fit.point.vector(), len(task.ladder)), task.down(terms, nominal)]
        found.append(task.priced(terms, min(made, key=lambda f: f.objective)))
    best = sorted(found, key=lambda c: c.cost)[:n]
    return [task.priced(c.terms, task.refined(c.fit)) for c in best]


def _simplest(found: Sequence[Candidate], limits: Limits) -> Candidate:
    """The best; among those that tie with it, the one with the fewest parameters."""
    ties = [c for c in found if c.cost < found[0].cost + limits.parameter]
    return min(ties, key=lambda c: (c.last.n, c.cost))


class _Race:
    """Candidates for one more term, fitted one after another.

    None is given up halfway: on sharp peaks the right one may stand a thousand times above the leader until its last
    steps.
    """

    def __init__(self, task: Task, before: Candidate) -> None:
        self.task, self.before = task, before
        self.found: list[Candidate] = []

    @property
    def leader(self) -> Candidate:
        """The best so far."""
        return min(self.found, key=lambda c: c.cost)

    def enter(self, lead: Lead, rung: int | None = None, origin: Candidate | None = None) -> None:
        """Fit of the model before (at `origin`'s point) with the lead's term, down the ladder from `rung`."""
        task, before = self.task, origin or self.before
        terms = (*before.terms, lead.term.fitted)
        old = _afresh(task.engine, before) if rung == 0 else before.fit.point
        x = replace(old, terms=np.concatenate([old.terms, lead.start])).vector()
        rung = len(task.ladder) if rung is None else rung
        try:
            self.found.append(task.priced(terms, task.down(terms, x, rung)))
        except ModelError:
            return  # a start that the model cannot hold, such as a mass below nothing


def _afresh(engine: Engine, before: Candidate) -> Point:
    """The model before with its terms as they are and everything else at its start: errors that were fitted without
    the next mechanism may stand in its way.
    """
    return engine.start(before.terms, before.fit.point.terms)


def _count(term: Term) -> int:
    return term.data.get("price", max(term.n, 1))


def _stage(task: Task, terms: Sequence[Term], before: Candidate, width: int) -> list[Candidate]:
    """The best candidates with one more term, best first: leads of both scores, fitted, raced, and fitted finely."""
    engine, scatter = task.engine, task.scatter
    x = before.fit.point.vector()
    nominal = _afresh(engine, before).vector()
    fine = shortlist(direction_score(engine, task.coarse, scatter, terms, x, before.terms), width, task.counts)
    rough = shortlist(grid_score(engine, task.ladder[0], scatter, terms, nominal, before.terms), width, task.counts)
    middle = grid_score(engine, task.ladder[1], scatter, terms, x, before.terms) if task.counts else []
    race = _Race(task, before)
    for lead in rough:
        race.enter(lead, 0)
    for lead in shortlist(middle, 4, task.counts):
        race.enter(lead, 1)
    for lead in (*fine, *(_faint(x) for x in fine[:3])):
        race.enter(lead)
    for lead in (x for x in rough[:4] if x.term.n in (1, 2, 3)):
        for p in lead.others[: lead.term.n + 1]:  # the more parameters, the more starts
            race.enter(replace(lead, start=p), 0)
            race.enter(replace(lead, start=p), 2)
    if race.found:
        done = {id(c.last) for c in race.found if c.cost < before.cost}
        _elsewhere(race, terms, done)
        if task.counts:
            _otherwise(race, terms)
            _again(race, terms, done)
    ahead = _among([c for c in race.found if not _shadows(engine, c)], ())[: width + 1]
    return sorted((task.priced(c.terms, task.refined(c.fit)) for c in ahead), key=lambda c: c.cost)


def _shadows(engine: Engine, c: Candidate) -> bool:
    """Whether an added mode sits on one that the structure has: then it mends that peak and is no mode of its own."""
    if not c.last.data.get("extra_mode"):
        return False
    b = engine.band_modes
    own = engine.state(c.fit.point.theta, changes_of(c.fit)).omega[b] * (1 + c.fit.point.shift) / 2 / np.pi
    frequency = c.fit.point.terms[c.fit.point.terms.size - c.last.n]
    return bool(np.any(np.abs(own - frequency) < 0.015 * frequency))


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


def _otherwise(race: _Race, terms: Sequence[Term], n: int = 4) -> None:
    """The leader's mechanism in its other variants at the same place, such as both compliances of a clamp at once."""
    task, before, last = race.task, race.before, race.leader.last
    kin = [t for t in terms if t.mechanism.id == last.mechanism.id and t.place == last.place and t.fitted is not last]
    if not kin:
        return
    nominal = _afresh(task.engine, before).vector()
    leads = grid_score(task.engine, task.ladder[0], task.scatter, kin, nominal, before.terms)
    for lead in sorted(leads, key=lambda lead: -lead.gain)[:n]:
        for p in (lead.start, *lead.others):
            race.enter(replace(lead, start=p), 0)
            if lead.term.n > 1:
                race.enter(replace(lead, start=p), 2)


def _elsewhere(race: _Race, terms: Sequence[Term], done: set[int], n: int = 4) -> None:
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
    for lead in shortlist(grid_score(task.engine, task.coarse, task.scatter, sized, x, before.terms), n):
        race.enter(Lead(own[str(lead.term.place), lead.term.variant], lead.start, lead.gain), None, origin)


def _again(race: _Race, terms: Sequence[Term], done: set[int], n: int = 5) -> None:
    """Every other term scored anew where the leader has put the parameters; at its own place, whatever was tried."""
    task, before, winner = race.task, race.before, race.leader
    origin = winner_base(before, winner)
    others = [t for t in terms if t.fitted is not winner.last]
    leads = grid_score(task.engine, task.ladder[1], task.scatter, others, origin.fit.point.vector(), before.terms)
    leads = _one_each(sorted(leads, key=lambda lead: -(lead.gain - 3.0 * lead.term.n)))
    here = [lead for lead in leads if lead.term.place.touches(winner.last.place)][:n]
    away = [lead for lead in leads if lead not in here and id(lead.term.fitted) not in done][: n - 1]
    for lead in (*here, *away):
        race.enter(lead, 2, origin)
    for lead in (x for x in here if x.term.n > 1):
        for p in lead.others:
            race.enter(replace(lead, start=p), 2, origin)
            race.enter(replace(lead, start=p), None, origin)


def _one_each(leads: Sequence[Lead]) -> list[Lead]:
    """The best lead of each mechanism and place."""
    seen: set[tuple[str, Place]] = set()
    out = []
    for lead in leads:
        key = (lead.term.mechanism.id, lead.term.place)
        if key not in seen:
            seen.add(key)
            out.append(lead)
    return out


def winner_base(before: Candidate, winner: Candidate) -> Candidate:
    """The model before, at the parameters and ordinary errors that the winner found."""
    point = winner.fit.point
    point = replace(point, terms=point.terms[: -winner.last.n] if winner.last.n else point.terms)
    return Candidate(before.terms, replace(winner.fit, point=point), before.cost)
