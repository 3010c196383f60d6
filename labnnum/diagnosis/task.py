"""What every fit of a selection shares, and what comes of one: lines, data, candidates with their price."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit, fit
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.verdict import Limits
from labnnum.frf import Frf
from labnnum.mechanisms.base import Place, Term


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

    scatter: Scatter
    """The ordinary errors that the data support (`sharpen`)."""

    data: Data
    """What the last fits were fitted to."""

    free: Candidate | None = None
    """The best free law, where nothing else came near."""


QUIET = 0.25
"""Least dispersion that is believed: smaller residuals may be luck, larger ones are taken as they are."""


def dispersion(made: Fit, data: Data) -> float:
    """Ratio of the residuals' variance to the assumed one, for the best model; gains are divided by it.

    McCullagh and Nelder (1989), section 4.5: with errors larger than assumed, differences of chi-square are too large
    by the same factor.
    """
    return max(QUIET, made.data_part / (2 * data.value.size))


CHANCE = 3.0
"""Deviations of a difference that are left out of the turning: else lines would be chosen for their noise."""


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
    measured = np.isfinite(frf.n_averages)  # else the noise is taken from differences, which peaks make large
    chance = CHANCE * np.hypot(noise[:, 1:], noise[:, :-1]) if measured else 2 * noise[:, 1:]
    turn = np.maximum(np.abs(np.diff(h, axis=1)) - chance, 0) / size
    turn = np.minimum(turn, 0.7).mean(axis=0)
    even = np.diff(np.log(frf.frequency))
    weight = 0.6 * turn / max(turn.sum(), 1e-300) + 0.4 * even / even.sum()
    arc = np.concatenate([[0], np.cumsum(weight)])
    pick = np.unique(np.searchsorted(arc, np.linspace(0, arc[-1], n)).clip(0, frf.frequency.size - 1))
    return frf.at(pick)


def data_of(frf: Frf, scatter: Scatter) -> Data:
    """Fit data of an Frf whose variance is known."""
    rows = scatter.rows
    floor = scatter.floor if rows is None or rows.shape != frf.value.shape[:2] else rows
    return measured(frf).with_floor(floor)


def measured(frf: Frf) -> Data:
    """Fit data of an Frf, with its noise only; an exponential window becomes a shift of s."""
    assert frf.covering_variance is not None
    made = frf.settings
    lead = made.get("lead", made.get("pretrigger", 0) / made.get("rate", np.inf))
    s = np.asarray(float(made.get("window_decay", 0.0)) + 1j * frf.omega, complex)
    return Data(s, frf.value, np.sqrt(frf.covering_variance), float(lead))


@dataclass(frozen=True, eq=False)
class Task:
    """What every fit of one selection shares: lines, the same thinned, the same broadened, errors and limits."""

    engine: Engine
    data: Data
    coarse: Data
    ladder: tuple[Data, ...]
    scatter: Scatter
    """The ordinary errors that the data support."""
    wide: Scatter
    """The largest ones, on the broadened data, which are rough themselves."""
    limits: Limits
    counts: Mapping[str, int] = field(default_factory=dict)
    """How many terms each mechanism has: a name that may act in many places matches by chance more often."""
    ranked: bool = True
    """Whether rivals are told on broadened data, whose errors are known."""

    def down(self, terms: Sequence[Term], x: NDArray, first: int = 0) -> Fit:
        """Fit the broadened data from rung `first` to the finest, then the thinned lines."""
        rough = x
        for level in self.ladder[first:]:
            rough = self.rough(terms, rough, level).point.vector()
        return fit(self.engine, self.coarse, terms, self.scatter, rough, steps=20 if terms else 40)

    def rough(self, terms: Sequence[Term], x: NDArray, level: Data) -> Fit:
        """A few steps on one rung, all errors as large as they may be."""
        return fit(self.engine, level, terms, self.wide, x, steps=8, tolerance=1.0, follow=False)

    def errors_on(self, level: Data) -> Scatter:
        """The ordinary errors that go with the lines themselves, or with one of the broadened data."""
        return self.scatter if level is self.coarse or level is self.data else self.wide

    def refined(self, made: Fit, steps: int = 12) -> Fit:
        """A fit to the thinned lines carried on to all lines."""
        if self.coarse is self.data:
            return made
        return fit(self.engine, self.data, made.terms, self.scatter, made.point.vector(), steps=steps)

    def priced(self, terms: tuple[Term, ...], made: Fit, data: Data | None = None) -> Candidate:
        """The fit (to `data` if given, else to all lines) as a candidate: its objective plus the price of its terms'
        parameters.
        """
        places = 2.0 * sum(np.log(self.counts.get(t.mechanism.id, 1)) for t in terms)
        given_up = self._given_up(terms, made, data or self.data)
        own = self.limits.parameter * sum(count(t) for t in terms)
        return Candidate(terms, made, made.objective + own + places + given_up)

    def _given_up(self, terms: Sequence[Term], made: Fit, data: Data) -> float:
        """What the rows of channels that a term gives up would cost if they fitted as the others do, or their noise."""
        n_o, n_i = len(self.engine.outputs), len(self.engine.inputs)
        share = sum(1 / n_o if t.data["dropped"] < n_o else 1 / n_i for t in terms if "dropped" in t.data)
        return max(made.data_part / (1 - share), 2.0 * data.value.size) * share if share else 0.0


OFF = 4.0
"""Price of the fitted errors, a parameter, beyond which other starts are worth a try: two deviations each."""


def settled(made: Fit, data: Data, limits: Limits) -> bool:
    """Whether a fit leaves no more than noise, and asks of the structure no more than a sound one does."""
    errors = made.point.shift.size + made.n_theta
    return made.data_part < limits.unsettled * 2 * data.value.size and made.prior_part < OFF * errors


IDLE = 0.25
"""Part of an alarm's gain below which the best of a search is followed no further where noise is all that is left."""


def idle(task: Task, before: Candidate, best: Candidate, data: Data) -> bool:
    """Whether a model leaves no more of `data` than noise, and the best addition found to it gains next to nothing."""
    quiet = before.fit.data_part < task.limits.unsettled * 2 * data.value.size
    return quiet and before.fit.objective - best.cost < IDLE * task.limits.alarm


def count(term: Term) -> int:
    """Parameters that a term is priced for."""
    return term.data.get("price", max(term.n, 1))


def afresh(engine: Engine, before: Candidate) -> Point:
    """The model before with its terms as they are and everything else at its start: errors that were fitted without
    the next mechanism may stand in its way.
    """
    return engine.start(before.terms, before.fit.point.terms)


def winner_base(before: Candidate, winner: Candidate) -> Candidate:
    """The model before, at the parameters and ordinary errors that the winner found."""
    point = winner.fit.point
    point = replace(point, terms=point.terms[: -winner.last.n] if winner.last.n else point.terms)
    return Candidate(before.terms, replace(winner.fit, point=point), before.cost)


def with_terms(task: Task, last: Candidate, pick: Sequence[int]) -> Candidate:
    """The model with some of its terms only, fitted anew."""
    sizes = np.cumsum([0, *(t.n for t in last.terms)])
    kept = np.concatenate([np.zeros(0), *(np.arange(sizes[i], sizes[i + 1]) for i in pick)]).astype(int)
    terms = tuple(last.terms[i] for i in pick)
    point = replace(last.fit.point, terms=last.fit.point.terms[kept])
    return task.priced(terms, fit(task.engine, task.data, terms, task.scatter, point.vector(), steps=20))


def among(found: Sequence[Candidate], more: Sequence[Candidate]) -> list[Candidate]:
    """Candidates of two searches, best first, each term once."""
    best: dict[int, Candidate] = {}
    for c in (*found, *more):
        if id(c.last) not in best or c.cost < best[id(c.last)].cost:
            best[id(c.last)] = c
    return sorted(best.values(), key=lambda c: c.cost)


def simplest(found: Sequence[Candidate], limits: Limits) -> Candidate:
    """The best; among those that tie with it, the one with the fewest parameters."""
    ties = [c for c in found if c.cost < found[0].cost + limits.parameter]
    return min(ties, key=lambda c: (c.last.n, c.cost))
