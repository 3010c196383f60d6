"""The answer to nonlinear signs: a law at a place or an abstention, errors before and after, and linearised data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Scatter
from labnnum.diagnosis.nonlinear.detect import signs
from labnnum.diagnosis.nonlinear.further import further, needed
from labnnum.diagnosis.nonlinear.joined import joined, records
from labnnum.diagnosis.nonlinear.linearise import linearised, linearised_records
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, spots
from labnnum.diagnosis.nonlinear.problem import Joint, Made
from labnnum.diagnosis.nonlinear.records import changed, split
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.nonlinear.study import (
    Prospect,
    Study,
    Tried,
    at_places,
    base_again,
    explore,
    of_known,
    refined,
    search,
)
from labnnum.diagnosis.nonlinear.suspect import FEW, back, finer, heard, suspect, without
from labnnum.diagnosis.nonlinear.timing import Timed, timing, told
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.verdict import Alternative, Limits, Named
from labnnum.mechanisms import CATALOGUE
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.nonlinear_law import NonlinearMechanism

UNCONFIRMED = "no nonlinear law gains more than a sound structure's scatter"
"""Signs without a law: a converter's steps and a shaker's harmonics repeat every period as well."""

KNOWN = "the laws that the model holds explain the change with level"
"""The reason where nothing is missing."""

MECHANISMS = {m.id: m for m in CATALOGUE if isinstance(m, NonlinearMechanism)}


@dataclass(frozen=True, eq=False)
class Curve:
    """Recovered force against the motion, and the law along it, for one run."""

    level: float
    z: NDArray[np.float64]
    v: NDArray[np.float64]
    force: NDArray[np.float64]
    law: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NonlinearAnswer:
    """What the nonlinear signs mean.

    `named` is empty where no law of the catalogue explains them; `place` is then where something acts. Errors are
    relative RMS of the response spectra on all lines of the band, over (training, held-out) runs. `linearised` are
    the observations with the law's share taken out of their FRFs.
    """

    named: tuple[Named, ...]
    place: Place | None
    alternatives: tuple[Alternative, ...]
    located: tuple[tuple[Place, float], ...]
    base_error: tuple[float, float]
    extended_error: tuple[float, float]
    reason: str
    linearised: tuple[Observation, ...]
    linearised_held_out: tuple[Observation, ...]
    curves: tuple[Curve, ...]
    study: Study
    laws: tuple[Tried, ...]
    misfit: float
    base_x: NDArray[np.float64]
    """Vector of the base model that errors are compared with: fitted to all runs, an identified one to the quietest."""
    noise: float = 0.0
    """Relative RMS that noise alone leaves of the responses held out."""
    orbits: tuple[Any, ...] = ()
    """Steady states of the last fit, of training runs and of those held out."""
    lying: int | None = None
    """Number of a response that was left out, because a law explains the others far better without it."""
    held_out: tuple[Run, ...] = ()
    scatter: Scatter = field(default_factory=Scatter)


def answer(
    engine: Engine, train: Sequence[Observation], test: Sequence[Observation], places: Places, scatter: Scatter,
    limits: Limits, span: tuple[float, float], progress: Callable[[str], None] = lambda text: None,
    others: Sequence[Observation] = (), known: Sequence[Lead] = (), nearly: float = 0.0, doubted: int | None = None,
) -> NonlinearAnswer | None:  # fmt: skip
    """What nonlinear physics the observations show; None where they show none.

    Parameters
    ----------
    train, test : sequence of Observation
        Periodic runs with their spectra.
    others : sequence of Observation
        Hits and random data, which are looked at where there are no periodic runs.
    known : sequence of Lead
        Laws that the model holds: where they explain the data nothing else is sought.
    span : (low, high)
        Band in Hz.
    nearly : float
        Part of the base's held-out error to which a law must bring it down for its misfit to be excused, of a model
        that was identified and misses its own data; 0 for others, which have `NEARLY`. The place of such a model is
        told by the time at which distortion comes, where that tells.
    doubted : int, optional
        Number of a response of periodic runs that is left out.
    """
    train = sorted((o for o in train if o.run is not None), key=lambda o: o.level)
    test = sorted((o for o in test if o.run is not None), key=lambda o: o.level)
    runs = [o.run for o in train if o.run is not None]
    whole: tuple[Observation, ...] = ()
    if not runs:
        if not changed(others):
            return None
        b = engine.band_modes
        parts = split(others, float(1 / np.min(engine.zeta0[b] * engine.state(engine.theta0).omega[b])))
        train = sorted((_within(o, span) for o in parts.train), key=lambda o: o.level)
        test = sorted((_within(o, span) for o in parts.test), key=lambda o: o.level)
        runs, whole = [o.run for o in train if o.run is not None], parts.whole
    elif not signs(runs).present:
        return None
    train, runs = _levels(train, runs)
    i = quietest(runs)
    point = base_point(engine, train[i], scatter, span)
    if known:
        progress("fitting the laws of the model")
        held = of_known(engine, point, runs, i, known, scatter)
        if held is not None and held.best.made.data_part < MISFIT * held.best.made.count:
            made = _decide(held, [held.best], train, test, scatter, limits, whole)
            return replace(made, named=(), place=None, reason=KNOWN)
    site = engine.site(places.nodes, places.elements, places.supports)
    every = spots(engine, site)
    timed = timing(train, every) if nearly else []
    if told(timed, limits):
        every = [s for s in every if s.place == timed[0].spot.place]

    def exploring(some: Sequence[Observation]) -> Prospect | None:
        own = base_point(engine, some[i], scatter, span)
        return explore(
            engine, own, [o.run for o in some if o.run is not None], i, every, scatter, lines=FEW, carry_on=False
        )

    seen = explore(engine, point, runs, i, every, scatter, progress=progress)
    believed: tuple[Observation, ...] = ()
    if doubted is not None:
        again = exploring([without(o, doubted) for o in train])
        lying = None if again is None else (doubted, again)
    else:
        lying = suspect(train, seen, exploring) if not (whole or nearly) else None
    if lying is not None and seen is not None and doubted is None:
        whole_again = back(seen, lying[1])
        if whole_again is not None:  # it was the way to the law that was hard to find, not the channel that lied
            seen, lying = whole_again, None
    if lying is not None:
        progress(f"without channel {runs[0].outputs[lying[0]].name}")
        believed = (*train, *test)
        train, test = ([without(o, lying[0]) for o in part] for part in (train, test))
        seen = finer(lying[1])
    found = None if seen is None else search(seen, progress, unsure=nearly > 0)
    if found is None:
        return None
    progress("comparing places and laws")
    tried = refined(found, scatter, _rivals(found, every, scatter))
    if not tried:
        return None
    found = replace(found, tried=tuple(tried), base=base_again(found, scatter))
    laws = _chain(found, every, train, test, scatter, limits, progress)
    more = records(others, span, runs[0].miss) if nearly and not whole else []
    if more:
        progress("fitting records that are not periodic")
        laws[-1] = joined(found, laws[-1], more, scatter)
    made = _decide(found, laws, train, test, scatter, limits, whole, nearly or NEARLY, timed)
    if lying is None:
        return made
    every_channel = linearised(found, made.laws[-1].made, made.orbits, believed, scatter, lying[0])
    return replace(
        made, lying=lying[0], linearised=tuple(every_channel[: len(train)]),
        linearised_held_out=tuple(every_channel[len(train) :]),
    )  # fmt: skip


def _within(o: Observation, span: tuple[float, float]) -> Observation:
    """The observation with its run compared inside the band only."""
    assert o.run is not None
    inside = (o.run.frequency >= span[0]) & (o.run.frequency <= span[1])
    return replace(o, run=replace(o.run, use=inside if o.run.use is None else o.run.use & inside))


FURTHER = 0.97
"""Part of the held-out error so far that one more law must bring it below."""


def _chain(
    found: Study, every: Sequence[Spot], train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter,
    limits: Limits, progress: Callable[[str], None],
) -> list[Tried]:  # fmt: skip
    """The best law, then one more at a time while the prediction of held-out runs gains; at last a general one.

    Laws that those found later make needless are taken out again.
    """
    laws = [found.best]
    if laws[0].made.data_part < 1.3 * laws[0].made.count:
        return laws

    def held_out(t: Tried) -> float:
        joint, (x, orbits) = _on(found, t, train, test, scatter)
        return _errors_of(joint, x, orbits, len(train))[1]

    error = held_out(laws[0])
    refused = False
    for general in (False, False, True):
        if refused and not general:
            continue
        progress(f"looking for nonlinear law {len(laws) + 1}")
        more = further(found, laws[-1], every, scatter, limits.further, general=general)
        told = held_out(more) if more is not None else np.inf
        if more is None or told > FURTHER * error:
            refused = True
            continue
        laws.append(more)
        error = told
    return needed(found, laws, scatter, limits.further) if len(laws) > 1 else laws


def _levels(train: Sequence[Observation], runs: list[Run], most: int = 4) -> tuple[list[Observation], list[Run]]:
    """At most `most` runs, spread over the levels."""
    if len(runs) <= most:
        return list(train), runs
    pick = np.unique(np.linspace(0, len(runs) - 1, most).round().astype(int))
    return [train[i] for i in pick], [runs[i] for i in pick]


def _rivals(found: Study, every: Sequence[Spot], scatter: Scatter) -> list[Tried]:
    """The winning law at the spots that explain the distortion next best."""
    best = found.best
    have = {(t.spot.place, t.spot.axis) for t in found.tried if t.mechanism == best.mechanism}
    own = next((q.gain for q in found.recovered if q.spot.place == best.spot.place), found.recovered[0].gain)
    near = [q.spot for q in found.recovered if (q.spot.place, q.spot.axis) not in have and q.gain > RIVAL * own]
    return at_places(found, best, near[:3], scatter)


RIVAL = 0.8
"""Part of what a general law removes at the best place that it must remove at another for the law to be tried there."""


USELESS = "the best nonlinear law does not improve the prediction of data held out"
"""The reason where distortion stands above the noise, and no law helps to predict."""
GAINS = 0.9
"""Part of the base's held-out error below which a law must bring it, however near the noise that is."""


def _decide(
    found: Study, laws: Sequence[Tried], train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter,
    limits: Limits, whole: Sequence[Observation] = (), enough: float = 0.1, timed: Sequence[Timed] = (),
) -> NonlinearAnswer:  # fmt: skip
    best, base, last = found.best, found.base, laws[-1]
    excess = max(1.0, best.made.data_part / best.made.count)
    rivals = [t for t in found.tried if not t.same(best)]
    equals = [t.cost for t in rivals if t.simulated and not _only_smoother(t, best)]
    lead = (min(equals) - best.cost) / excess if equals else np.inf
    total = (base.objective * best.made.count / base.count - best.made.objective) / excess
    misfit = last.made.data_part / last.made.count
    general = _level(found.general, last) if found.general is not None else np.inf
    behind = (last.cost - general) / max(1.0, misfit)
    joint, made = _on(found, last, train, test, scatter)
    x, orbits = made
    plain = found.base.x if enough == NEARLY else found.quiet.x
    base_error = _errors(found, train, test, plain, scatter)
    extended_error = _errors_of(joint, x, orbits, len(train))
    nearly = extended_error[1] < enough * base_error[1]
    reason = ""
    noise = _noise(test or train)
    if total < limits.alarm and base_error[1] < max(limits.sound, 3 * noise):
        reason = UNCONFIRMED
    elif misfit > MISFIT and not nearly:
        reason = "what the best nonlinear law leaves is far more than noise"
    elif behind > max(limits.alarm, limits.behind * total) and not nearly:
        reason = "a general law of motion and speed explains far more than any named one"
    elif lead < limits.name:
        reason = "two nonlinear laws explain it equally well"
    if not reason and extended_error[1] > limits.improve * base_error[1] and extended_error[1] > 3 * noise:
        reason = USELESS
    if not reason and extended_error[1] > GAINS * base_error[1]:
        reason = USELESS
    if not reason and len({(t.mechanism, t.spot.place) for t in laws if t.mechanism in MECHANISMS}) > MOST:
        reason = "it takes more than two named laws, which may stand for one that has no name"
    named = () if reason else _all_named(laws, best, rivals)
    place = best.spot.place
    if reason and found.general is not None and general < _level(best, last):
        place = found.general.spot.place
    poor = min(general, _level(best, last)) > LITTLE * _level_of(base, last)
    if reason and poor and any(r.quiet.any() for r in found.runs):
        place = max(found.recovered, key=lambda q: q.share).spot.place  # no law says anything; the distortion does
    if whole:
        linear, n_train = linearised_records(found, last.made, whole, scatter), len(whole)
    else:
        linear, n_train = linearised(found, last.made, orbits, (*train, *test), scatter), len(train)
    alternatives = _alternatives(best, rivals, limits)
    located = _located(found)
    if told(timed, limits):
        located = tuple((t.spot.place, t.share) for t in timed[:10])
    return NonlinearAnswer(
        named, place, alternatives, located, base_error, extended_error if not reason else base_error, reason,
        tuple(linear[:n_train]), tuple(linear[n_train:]), _curves(found, best), found, tuple(laws), misfit, plain,
        noise, tuple(orbits), held_out=tuple(o.run for o in test if o.run is not None), scatter=scatter,
    )  # fmt: skip


def _only_smoother(t: Tried, best: Tried) -> bool:
    """Whether a law is the best one with its corners rounded, which explains no less: the simpler is preferred."""
    return t.mechanism == "hysteresis" and best.mechanism == "stick-slip" and t.spot.place == best.spot.place


def _level(t: Tried, other: Tried) -> float:
    """Cost of a fit, raised to as many values as the other's."""
    return t.cost * other.made.count / t.made.count


def _level_of(base: Made, other: Tried) -> float:
    """The same of the base."""
    return base.objective * other.made.count / base.count


MOST = 2
"""Different laws, or places, that are named together."""
LITTLE = 0.3
"""Part of the base's objective above which a fit that has no name says nothing of the place."""
MISFIT = 3.0
"""Chi-square per value above which nothing is called explained,"""
NEARLY = 0.1
"""unless the held-out error falls to this of the base's: what is left is then a small correction to the law."""


def _all_named(laws: Sequence[Tried], best: Tried, rivals: Sequence[Tried]) -> tuple[Named, ...]:
    """Every named law of the chain, its parameters from the last fit; a general one has no name."""
    last = laws[-1].made
    excess = max(1.0, last.data_part / last.count)
    out = []
    for i, t in enumerate(laws):
        if t.mechanism not in MECHANISMS:
            continue
        mechanism = MECHANISMS[t.mechanism]
        value, std = last.law(i)
        n = len(mechanism.names)
        term = mechanism.term(t.spot.place, t.spot.axis, t.spot.column)
        trust = _confidence(best, rivals) if i == 0 else 0.95
        out.append(Named(term, value[:n], std[:n] * np.sqrt(excess), trust))
    return tuple(out)


def _confidence(best: Tried, rivals: Sequence[Tried]) -> float:
    excess = max(1.0, best.made.data_part / best.made.count)
    weights = np.exp(-np.clip([(t.cost - best.cost) / excess / 2 for t in rivals], 0, 700)) if rivals else np.zeros(0)
    return float(1.0 / (1.0 + weights.sum()))


def _alternatives(best: Tried, rivals: Sequence[Tried], limits: Limits) -> tuple[Alternative, ...]:
    out = []
    for t in sorted(rivals, key=lambda t: t.cost)[:6]:
        gap = t.cost - best.cost
        name = f"{best.mechanism} at {best.spot.place}"
        equal = gap < limits.name
        why = f"explains as well as {name} (chi-square + {gap:.1f})" if equal else f"leaves {gap:.0f} more than {name}"
        mechanism = MECHANISMS[t.mechanism]
        term = mechanism.term(t.spot.place, t.spot.axis, t.spot.column)
        out.append(Alternative(term, float("nan"), t.cost, why))
    return tuple(out)


def _located(found: Study) -> tuple[tuple[Place, float], ...]:
    """Places by the share of the distortion that a force there explains; a fitted law's place first."""
    shares: dict[Place, float] = {}
    for q in found.recovered:
        shares[q.spot.place] = max(shares.get(q.spot.place, 0.0), q.share)
    total = found.base.objective
    for t in found.tried:
        gain = max(total - t.made.objective, 0.0) / total
        shares[t.spot.place] = max(shares.get(t.spot.place, 0.0), gain)
    return tuple(sorted(shares.items(), key=lambda row: -row[1])[:10])


def _noise(observations: Sequence[Observation]) -> float:
    parts = []
    for o in observations:
        assert o.run is not None
        at, known = o.run.compared, heard(o.run)
        ratio = np.sum(o.run.noise[:, at], axis=1) / np.sum(np.abs(o.run.seen(o.run.y)[:, at]) ** 2, axis=1)
        parts.append(np.mean(ratio[known]))
    return float(np.sqrt(np.mean(parts)))


def _on(
    found: Study, best: Tried, train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter
) -> tuple[Joint, tuple[NDArray, list[Any]]]:
    """The best law's steady states on training and held-out runs."""
    runs = [o.run for o in (*train, *test) if o.run is not None]
    joint = Joint(
        found.engine, found.point, runs, best.made.terms, scatter, [choose_lines(r, 300, scatter.floor) for r in runs]
    )
    start = [*best.made.orbits, *([None] * (len(runs) - len(best.made.orbits)))]
    return joint, (best.made.x, joint.settle(best.made.x, start, 12))


def _errors(
    found: Study, train: Sequence[Observation], test: Sequence[Observation], x: NDArray, scatter: Scatter
) -> tuple[float, float]:
    """Of the base model alone, at the vector `x`."""
    runs = [o.run for o in (*train, *test) if o.run is not None]
    joint = Joint(found.engine, found.point, runs, (), scatter, [choose_lines(r, 300, scatter.floor) for r in runs])
    return _errors_of(joint, x, [None] * len(runs), len(train))


def _errors_of(joint: Joint, x: NDArray, orbits: Sequence[Any], n_train: int) -> tuple[float, float]:
    """Relative RMS errors over training and held-out runs; sensors' ordinary errors are taken from the training."""
    r, b = joint.parts(x, orbits)
    cuts = np.cumsum([2 * lines.at.size for lines in joint.lines])
    own = slice(0, cuts[n_train - 1])
    gram = np.matmul(b[..., own], b[..., own].transpose(0, 2, 1)) + np.eye(b.shape[1])
    size = np.linalg.solve(gram, np.matmul(b[..., own], r[:, own, None]))
    left = r - np.matmul(b.transpose(0, 2, 1), size)[..., 0]
    each = []
    for run, lines, part in zip(joint.runs, joint.lines, np.split(left, cuts[:-1], axis=1), strict=True):
        spread = np.tile(lines.sigma, 2) / np.sqrt(2.0)
        power = np.sum(np.abs(run.seen(run.y)[:, lines.at]) ** 2, axis=1)
        each.append(np.mean((np.sum((part * spread) ** 2, axis=1) / power)[heard(run)]))
    train, test = each[:n_train], each[n_train:] or each[:n_train]
    return float(np.sqrt(np.mean(train))), float(np.sqrt(np.mean(test)))


def _curves(found: Study, best: Tried) -> tuple[Curve, ...]:
    """Force recovered from the measurement and the law along the motion, at the best place, thinned for drawing."""
    from labnnum.diagnosis.nonlinear.laws import force_along

    mine = next((q for q in found.recovered if q.spot.place == best.spot.place), None)
    if mine is None:
        return ()
    sign = -1.0 if best.spot.axis.startswith("-") else 1.0
    p, _ = best.made.law(0)
    full = np.zeros(10)
    full[: p.size] = p
    out = []
    for run, z, v, f in zip(found.runs, mine.z, mine.v, mine.f, strict=True):
        law = force_along(best.made.terms[0].shape, sign * z, sign * v, full) * sign
        pick = slice(0, None, max(z.size // 3000, 1))
        out.append(Curve(run.level, z[pick], v[pick], -f[pick], law[pick]))
    return tuple(out)


def term_of(tried: Tried) -> Term:
    """The law of a candidate as a term."""
    return MECHANISMS[tried.mechanism].term(tried.spot.place, tried.spot.axis, tried.spot.column)
