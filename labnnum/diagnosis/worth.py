"""What a chain of mechanisms is worth: when it is an alarm, which of them stay, what is missing without a name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit, fit
from labnnum.diagnosis.prediction import errors_of, foretold, trimmed
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.task import Candidate, Selection, count, dispersion, settled
from labnnum.diagnosis.verdict import Limits
from labnnum.errors import ModelError
from labnnum.frf import Frf


def improves(
    selection: Selection, n: int, limits: Limits, data: Data, base_error: float, extended_error: float,
    score: tuple[float, float],
) -> bool:  # fmt: skip
    """Whether `n` names are worth it: the prediction is better, or a misfit that no sound model has is gone.

    A fault of a few lines, such as an appendage's notch, or of one row of many hardly shows in an error over all;
    `score` is the chi-square of the data held out, of base and extended model (`prediction.foretold`).
    """
    if extended_error <= limits.improve**n * base_error:
        return True
    enough = (limits.improve_further**n, n * limits.name)
    if foretells(selection, score, enough, limits, base_error) and extended_error <= 1.05 * base_error:
        return True
    base, final = selection.chain[0].fit, selection.chain[-1].fit
    evident = base.objective > limits.misfit * 2 * data.value.size and settled(final, data, limits)
    return evident and extended_error <= 1.05 * base_error


PLAIN = 0.04
"""Held-out error below which, where errors have their largest sizes, what sound models lack is a large part of it."""


def foretells(
    selection: Selection, score: tuple[float, float], enough: tuple[float, float], limits: Limits, error: float
) -> bool:
    """Whether the chi-square of held-out data falls far enough: by `enough[1]` where errors have the size that the data
    support; else to the part `enough[0]` and by as much as alarms.
    """
    if selection.scatter.common is not None:
        return score[0] - score[1] >= enough[1]
    return score[1] <= enough[0] * score[0] and score[0] - score[1] >= limits.alarm * max(1.0, PLAIN / error)


def one_law(
    engine: Engine, lines: Frf, selection: Selection, limits: Limits, scatter: Scatter, data: Data, train: Frf,
    test: Frf, error: float,
) -> bool:  # fmt: skip
    """Whether one unnamed local law explains the data, and predicts nearly as well as several names do."""
    law = selection.general
    if law is None or not law.last.groups or not settled(law.fit, data, limits):
        return False
    if selection.chain[-1].cost < law.cost - limits.name and _apart(selection):
        return False
    return error > limits.improve_further * errors_of(engine, trimmed(engine, lines, law.fit, scatter), train, test)[1]


def _apart(selection: Selection) -> bool:
    """Whether the named mechanisms stand at places of their own: two at one are one law in two parts."""
    places = [t.place for t in selection.chain[-1].terms[len(selection.chain[0].terms) :]]
    return not any(a.touches(b) for a, b in combinations(places, 2))


def alarmed(selection: Selection, limits: Limits, data: Data, error: float) -> Selection:
    """The selection without its chain where what it gains is what sound structures have.

    Gains count in what the best model leaves, where that is more than noise. Where errors have their largest sizes,
    what a sound model leaves is smooth, and some mechanism always explains a part of it: that gain is discounted where
    the base predicts well; what the base had to ask of modal frequencies and loads counts in full.
    """
    if len(selection.chain) < 2:
        return selection
    base = selection.chain[0]
    best = min(selection.chain[1:], key=lambda c: c.cost)  # of two that need each other the first alone may be worse
    asked, plain = 0.0, 1.0
    if selection.scatter.common is None:
        asked, plain = max(base.fit.prior_part - best.fit.prior_part, 0.0), max(1.0, PLAIN / max(error, 1e-9))
    smooth = (base.cost - best.cost - asked) / max(dispersion(best.fit, data), 1.0)
    return selection if smooth / plain + asked >= limits.alarm else replace(selection, chain=(base,))


@dataclass(frozen=True, eq=False)
class Judge:
    """How models are judged by data that no fit saw."""

    errors: Callable[[Fit], tuple[float, float]]
    """Relative errors of a trimmed fit, on training and on held-out data."""

    score: Callable[[Fit], float]
    """Chi-square of the held-out data under a fit (`prediction.foretold`)."""


def worthwhile(
    engine: Engine, lines: Frf, data: Data, selection: Selection, limits: Limits, scatter: Scatter,
    base: tuple[Fit, tuple[float, float]], judge: Judge,
) -> tuple[Selection, Fit, tuple[float, float]]:  # fmt: skip
    """The chain as far as its mechanisms improve the prediction; its model as used, and its errors.

    What one mechanism began a later one may show. Then those go without which the rest predicts as well: the first
    that came may have stood in for those after it.
    """
    before, kept = selection.chain[0], 0
    plain, error = base
    tried = [(c, trimmed(engine, lines, c.fit, scatter)) for c in selection.chain[1:]]
    score = judge.score(before.fit)
    for i, (c, made) in enumerate(tried):
        told, foreseen = judge.errors(made), judge.score(c.fit)
        closer = told[1] <= min(
            limits.improve_further ** (i + 1 - kept) * error[1], limits.improve ** (i + 1) * base[1][1]
        )
        if i and not closer and not _foreseen(selection, (score, foreseen), i + 1 - kept, limits, (error[1], told[1])):
            continue
        kept, plain, error, score = i + 1, made, told, foreseen
    stages: tuple[tuple[Candidate, ...], ...] = selection.stages[: max(kept, 1)]
    last = selection.chain[kept]
    while kept and len(stages) > 1:
        leaner = [
            _without(engine, data, last, len(before.terms) + i, selection.scatter, stages, limits)
            for i in range(len(stages))
        ]
        used = [last.fit if c is None else trimmed(engine, lines, c.fit, scatter) for c in leaner]
        nothing = (np.inf, np.inf)
        left = [nothing if c is None else judge.errors(made) for c, made in zip(leaner, used, strict=True)]
        scores = [np.inf if c is None else judge.score(c.fit) for c in leaner]
        i = min(range(len(left)), key=lambda k: left[k][1])
        if left[i][1] > 1.1 * error[1] or _foreseen(selection, (scores[i], score), 1, limits, (left[i][1], error[1])):
            last, stages = _foremost(last, len(before.terms), stages, [t[1] for t in left])
            break
        made = leaner[i]
        if made is None:
            break
        last, plain, error, score = made, used[i], left[i], scores[i]
        stages = (*stages[:i], *stages[i + 1 :])
    steps = [replace(last, terms=last.terms[: len(before.terms) + i + 1]) for i in range(len(stages) - 1)]
    return replace(selection, chain=(before, *steps, last) if kept else (before,), stages=stages), plain, error


def _foreseen(
    selection: Selection, score: tuple[float, float], n: int, limits: Limits, error: tuple[float, float]
) -> bool:
    """Whether `n` mechanisms more foretell data held out by that much better, and predict no worse."""
    nearer = score[1] <= limits.foreseen**n * score[0]
    enough = (limits.improve_further**n, n * limits.further)
    return nearer and foretells(selection, score, enough, limits, error[0]) and error[1] <= 1.05 * error[0]


def _foremost(
    last: Candidate, n: int, stages: Sequence[tuple[Candidate, ...]], without: Sequence[float]
) -> tuple[Candidate, tuple[tuple[Candidate, ...], ...]]:
    """The last model with its new terms, those after the first `n`, ordered: what is missed most comes first."""
    order = [*range(n), *(n + i for i in sorted(range(len(without)), key=lambda i: -without[i]))]
    sizes = np.cumsum([0, *(t.n for t in last.terms)])
    pick = np.concatenate([np.arange(sizes[i], sizes[i + 1]) for i in order]).astype(int)
    first = last.fit.point.theta.size
    every = np.arange(last.fit.covariance.shape[0])
    every[first : first + pick.size] = first + pick
    terms = tuple(last.terms[i] for i in order)
    point = replace(last.fit.point, terms=last.fit.point.terms[pick])
    made = replace(last.fit, terms=terms, point=point, covariance=last.fit.covariance[np.ix_(every, every)])
    return replace(last, terms=terms, fit=made), tuple(stages[i - n] for i in order[n:])


def _without(
    engine: Engine, data: Data, last: Candidate, which: int, scatter: Scatter,
    stages: Sequence[tuple[Candidate, ...]], limits: Limits,
) -> Candidate | None:  # fmt: skip
    """The last model without one of its terms, fitted anew; or the same model as it came by in the search. None where
    it is no structure without that.
    """
    sizes = np.cumsum([0, *(t.n for t in last.terms)])
    terms = (*last.terms[:which], *last.terms[which + 1 :])
    point = replace(last.fit.point, terms=np.delete(last.fit.point.terms, np.arange(sizes[which], sizes[which + 1])))
    try:
        made = fit(engine, data, terms, scatter, point.vector(), steps=25)
    except ModelError:
        return None
    met = [c for stage in stages for c in stage if c.terms == terms]
    price = last.cost - last.fit.objective - limits.parameter * count(last.terms[which])
    price = min((c.cost - c.fit.objective for c in met), default=price)
    best = min([made, *(c.fit for c in met)], key=lambda f: f.objective)
    return Candidate(terms, best, best.objective + price)


def missing(
    engine: Engine, lines: Frf, selection: Selection, limits: Limits, scatter: Scatter, data: Data, train: Frf,
    test: Frf, base_error: tuple[float, float], extended_error: tuple[float, float], measured: bool,
    score: tuple[float, float],
) -> bool:  # fmt: skip
    """Whether something is missing though it has no name: the base is far off, or some extension predicts better."""
    if foretells(selection, score, (limits.doubt, limits.alarm), limits, base_error[1]):
        return True
    if measured and selection.chain[0].fit.objective > limits.misfit * 2 * data.value.size:
        return True
    if extended_error[1] < limits.doubt * base_error[1]:
        return True
    law = selection.general
    if law is None:
        return False
    if not law.last.groups:
        return spoilt(selection, limits, data)
    if selection.scatter.common is not None:
        told = (score[0], foretold(engine, law.fit, test, selection.scatter))
        if foretells(selection, told, (limits.doubt, limits.alarm), limits, base_error[1]):
            return True
    return errors_of(engine, trimmed(engine, lines, law.fit, scatter), train, test)[1] < limits.doubt * base_error[1]


def spoilt(selection: Selection, limits: Limits, data: Data) -> bool:
    """Whether a channel or a support that may do anything takes away a good part of what the base leaves.

    Such a law foretells nothing, so that held-out data cannot judge it; what it is worth shows in the objective, from
    which its own price has been taken off.
    """
    base, law = selection.chain[0], selection.general
    if law is None or law.last.groups or law.cost > limits.doubt * base.cost:
        return False
    if selection.stages and law.cost > min(c.cost for c in selection.stages[0]):
        return False
    return (base.cost - law.cost) / max(dispersion(law.fit, data), 1.0) > limits.alarm
