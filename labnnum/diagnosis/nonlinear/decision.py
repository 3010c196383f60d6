"""What the fits mean: a name and its place, or an abstention with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.alike import Equals, others_of
from labnnum.diagnosis.nonlinear.bench import Study, Tried
from labnnum.diagnosis.nonlinear.errors import (
    alone,
    base_errors,
    errors_of,
    foretold,
    noise_of,
    settled_on,
    shown_error,
)
from labnnum.diagnosis.nonlinear.explore import GAINS, Prospect
from labnnum.diagnosis.nonlinear.fitting import GROUPS, Made
from labnnum.diagnosis.nonlinear.linearise import linearised, linearised_records
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.scales import scale_std
from labnnum.diagnosis.nonlinear.shown import Curve, curves
from labnnum.diagnosis.nonlinear.suspect import heard
from labnnum.diagnosis.nonlinear.timing import Timed, told
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Alternative, Limits, Named
from labnnum.mechanisms import CATALOGUE
from labnnum.mechanisms.base import Place
from labnnum.mechanisms.nonlinear_law import NonlinearMechanism
from labnnum.structures.modal import ModalStructure

if TYPE_CHECKING:
    from labnnum.diagnosis.nonlinear.recorder import Recorder

UNCONFIRMED = "no nonlinear law gains more than a sound structure's scatter"
"""Signs without a law: a converter's steps and a shaker's harmonics repeat every period as well."""

KNOWN = "the laws that the model holds explain the change with level"
"""The reason where nothing is missing."""

MECHANISMS = {m.id: m for m in CATALOGUE if isinstance(m, NonlinearMechanism)}


@dataclass(frozen=True, eq=False)
class NonlinearAnswer:
    """What the nonlinear signs mean.

    `named` is empty where no law of the catalogue explains them; `place` is then where something acts. Errors are
    relative RMS of the response spectra on all lines of the band, over (training, held-out) runs. `linearised` are
    the observations with the law's share taken out of their FRFs; there are none where nothing was simulated.
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
    reached: tuple[float, float] = (float("nan"), float("nan"))
    """`extended_error` with the laws, whether they are named or not."""
    gained: bool = True
    """Whether the laws leave less than half of what the base does: something nonlinear is there, named or not."""
    orbits: tuple[Any, ...] = ()
    """Steady states of the last fit, of training runs and of those held out."""
    lying: int | None = None
    """Number of a response that was left out, because a law explains the others far better without it."""
    held_out: tuple[Run, ...] = ()
    scatter: Scatter = field(default_factory=Scatter)
    equal: tuple[Place, ...] = ()
    """Other places that move as that of the best law does: there it would do the same."""
    recorder: Recorder | None = None
    """The recorder's filter, where one was found: it is off the study's runs, and off those held out."""
    shown: float = float("nan")
    """Error over the runs held out with the laws' forces along the motion that these show, and not simulated."""
    undecided: tuple[tuple[str, Place], ...] = ()
    """Laws, by mechanism and place, of which one acts beside those that are named, and nothing tells which."""


NAMELESS = "a smooth law that the catalogue does not hold explains it best"
GENERAL = "a general law of motion and speed explains far more than any named one"
EQUAL = "two nonlinear laws explain it equally well"
NOTHING = "what the best nonlinear law leaves is far more than noise"
BOUGHT = "the base beside the best nonlinear law is bent further than the ordinary errors of any sound model"
UNTOLD = "the strength of the best nonlinear law may be anything: it holds its place fast, or does next to nothing"
FOUND = (NAMELESS, GENERAL)
"""Reasons for which nothing is named although nonlinear physics is certain, and at its place."""
USELESS = "the best nonlinear law does not improve the prediction of data held out"
"""The reason where distortion stands above the noise, and no law helps to predict."""


def decide(
    found: Study, laws: Sequence[Tried], train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter,
    limits: Limits, whole: Sequence[Observation] = (), enough: float = 0.1, timed: Sequence[Timed] = (),
    equal: Equals | None = None,
) -> NonlinearAnswer:  # fmt: skip
    """The answer that the fits allow: named laws, or a place and the reason why nothing is named there.

    Parameters
    ----------
    found : Study
    laws : sequence of Tried
        The chain, best first; the last one's fit holds all of them.
    whole : sequence of Observation
        Originals of hits, noise and sweeps.
    enough : float
        Part of the base's held-out error that excuses what the laws leave.
    timed : sequence of Timed
        Places by the time at which distortion comes.
    equal : mapping, optional
        Other places that move as a place does along an axis (`alike`).
    """
    named = next((t for t in found.tried if t.named and t.simulated), laws[0])
    best = named if laws[0].named else laws[0]  # the best law alone; a chain may have put another first
    base, last = found.base, laws[-1]
    excess = max(1.0, best.made.data_part / best.made.count)
    rivals = [t for t in found.tried if t.named and not t.same(best) and not best.all_of_it < t.all_of_it]
    sound = enough == NEARLY and best.made.prior_part < SOUND * best.made.n_base
    against = [t for t in rivals if t.simulated and not _only_smoother(t, best) and not (sound and _warped(t))]
    total = (base.objective * best.made.count / base.count - best.made.objective) / excess
    misfit = last.made.data_part / last.made.count
    general = _level(found.general, last) if found.general is not None else np.inf
    behind = (last.cost - general) / max(1.0, misfit)
    left = (last.made.data_part - last.made.count) / max(1.0, misfit)
    systematic = misfit > limits.misfit and enough == NEARLY
    lead = lead_over(best.cost, min((t.cost for t in against), default=np.inf), excess, systematic)
    if found.company and lead < limits.name:
        near = min(t.made.objective * last.made.count / t.made.count for t in found.company)
        lead = lead_over(last.made.objective, near, max(1.0, misfit), systematic)
    joint, made = settled_on(found, last, train, test, scatter)
    x, orbits = made
    plain = found.base.x if enough == NEARLY else found.quiet.x
    if enough == NEARLY and base.prior_part > BENT * base.n_base and last.made.prior_part < SOUND * last.made.n_base:
        plain = unbent(found.engine, plain)
    base_error = base_errors(found, train, test, plain, scatter)
    extended_error = errors_of(joint, x, orbits, len(train))
    bent = last.made.prior_part > BENT * last.made.n_base and enough == NEARLY
    nearly = not bent and extended_error[1] < enough * base_error[1]
    reason = ""
    noise = noise_of(test or train)
    heard_noise = noise if np.isfinite(noise) else 0.0  # what nobody knows excuses nothing
    if total < limits.alarm and base_error[1] < max(limits.sound, 3 * heard_noise):
        reason = UNCONFIRMED
    elif misfit > MISFIT and not nearly and not _stands_out(found, best, last, base_error, extended_error):
        reason = NOTHING
    elif _warped(last) and enough == NEARLY:
        reason = BOUGHT
    elif not best.named:
        reason = NAMELESS
    elif behind > max(limits.alarm, HALF * left) and not (nearly and enough > NEARLY):
        reason = GENERAL
    elif lead < limits.name:
        reason = EQUAL
    elif any(_untold(last.made, i) for i, t in enumerate(laws) if t.named):
        reason = UNTOLD
    sure = not reason or reason in (*FOUND, EQUAL)
    shown = shown_error(joint, x, orbits, len(train))
    left = shown if _astray(misfit, shown, extended_error[1], heard_noise) else extended_error[1]
    useless = left > limits.improve * base_error[1] and left > 3 * heard_noise
    if sure and (useless or left > GAINS * base_error[1] or extended_error[1] > 1.05 * base_error[1]):
        both = alone(found, train, test, scatter), joint
        scores = (
            foretold(both[0], plain, [None] * len(both[0].runs), len(train)),
            foretold(joint, x, orbits, len(train)),
        )
        if extended_error[1] > 1.05 * base_error[1] or not _foretells(scores, limits):
            reason = USELESS
    identified = isinstance(found.engine.structure, ModalStructure)
    most = MOST_IDENTIFIED if identified else MOST
    if not reason and len({(t.name, t.spot.place) for t in laws if t.name in MECHANISMS}) > most:
        reason = f"it takes more than {NUMBERS[most]} named laws, which may stand for one that has no name"
    all_of_it = base.data_part > limits.misfit * base.count and misfit < limits.unsettled
    if max(base_error) < scatter.floor and not all_of_it:
        reason = UNCONFIRMED  # the base explains all that a sound model does; sensors and shakers distort as much
    near = [t for t in against if (t.cost - best.cost) / excess < limits.name]
    common = shared(best, near) if reason == EQUAL and not (found.company or systematic) else frozenset()
    names = () if reason and not common else _all_named(found, laws, best, rivals, scatter)
    if common:  # a chain that has come by other laws names none of them
        names = tuple(n for n in names if (n.term.mechanism.id, n.place) in common)
        reason = "" if names else EQUAL
    place = best.spot.place
    if reason and found.general is not None and general < _level(best, last):
        place = found.general.spot.place
    poor = min(general, _level(best, last)) > LITTLE * _level_of(base, last)
    if reason and poor and found.recovered and any(r.quiet.any() for r in found.runs):
        place = max(found.recovered, key=lambda q: q.share).spot.place  # no law says anything; the distortion does
    if whole:
        linear, n_train = linearised_records(found, last.made, whole, scatter), len(whole)
    else:
        n_train = len(train)
        linear = linearised(found, last.made, orbits, (*train, *test), scatter, known=n_train)
    gained = misfit < HALF * base.data_part / base.count and reason not in (UNCONFIRMED, USELESS)
    alternatives = _alternatives(best, rivals, limits)
    if reason and best.name in MECHANISMS:
        alternatives = (_unnamed(best, reason), *alternatives)
    located = _located(found, equal)
    if told(timed, limits):
        located = tuple((t.spot.place, t.share) for t in timed[:10])
    return NonlinearAnswer(
        names, place, alternatives, located, base_error, extended_error if not reason else base_error, reason,
        tuple(linear[:n_train]), tuple(linear[n_train:]), curves(found, best, last.made, scatter), found, tuple(laws),
        misfit, plain, noise, extended_error, gained, tuple(orbits), scatter=scatter,
        held_out=tuple(o.run for o in test if o.run is not None), equal=others_of(equal or {}, best.spot),
        shown=shown, undecided=apart(best, near, common) if common and names else (),
    )  # fmt: skip


def shared(best: Tried, near: Sequence[Tried]) -> frozenset[tuple[str, Place]]:
    """Laws, by name and place, of the best two or more that all others which explain as well have too."""
    return best.all_of_it.intersection(*(t.all_of_it for t in near)) if best.more and near else frozenset()


def apart(best: Tried, near: Sequence[Tried], common: frozenset[tuple[str, Place]]) -> tuple[tuple[str, Place], ...]:
    """The other laws of all of these, the best one's first."""
    every = [(lead.name, lead.spot.place) for t in (best, *near) for lead in (t.lead, *t.more)]
    return tuple(one for one in dict.fromkeys(every) if one not in common)


def strays(found: NonlinearAnswer) -> bool:
    """Whether laws that leave next to nothing of the runs of the fit, and along the measured motion of those held out,
    simulate these in another steady state than the structure's.
    """
    noise = found.noise if np.isfinite(found.noise) else 0.0
    return _astray(found.misfit, found.shown, found.extended_error[1], noise)


def _astray(misfit: float, shown: float, simulated: float, noise: float) -> bool:
    return misfit < MISFIT and ASTRAY * shown < simulated and ASTRAY * noise < simulated


def _foretells(scores: tuple[tuple[float, int], tuple[float, int]], limits: Limits) -> bool:
    """Whether a law foretells runs held out where a relative error hardly shows it: distortion stands on lines where
    next to nothing is. The base must misfit, and the law leave no more than a sound model does.
    """
    (base, _), (law, n) = scores
    return base > limits.misfit * n and law < limits.unsettled * n and base - law > limits.alarm


def _stands_out(
    found: Study, best: Tried, last: Tried, base_error: tuple[float, float], error: tuple[float, float]
) -> bool:  # fmt: skip
    """Whether the laws explain nearly all, and the first of them far more than any other does at any place: what they
    leave is then something else beside them, or a small error of theirs, and no other name would do.
    """
    others = [t for t in found.tried if not t.same(best) and not best.all_of_it < t.all_of_it]
    if found.general is not None:
        others.append(found.general)
    alone = best.cost / best.made.count
    ahead = all(t.cost / t.made.count > AHEAD * alone for t in others)
    explains = last.made.objective / last.made.count < EXPLAINS * found.base.objective / found.base.count
    return ahead and explains and not _warped(last) and error[1] < FORETELLS * base_error[1]


def _untold(made: Made, i: int) -> bool:
    """Whether the i-th law has one parameter, its strength, which is within one deviation of nothing."""
    value, std = made.law(i)
    return value.size == 1 and bool(abs(value[0]) < std[0])


def _warped(t: Tried) -> bool:
    """Whether the base beside a law is another structure: such a law has no name, nor is it a rival of one whose base
    is sound.
    """
    return t.made.prior_part > WARPED * t.made.n_base


def unbent(engine: Engine, x: NDArray) -> NDArray[np.float64]:
    """The base vector with its parameters and damping, and its modes as these make them."""
    n, m = engine.theta0.size, engine.band_modes.size
    out = x.copy()
    out[n : n + m] = 0.0
    out[n + 2 * m : n + 3 * m] = 0.0
    return out


def lead_over(cost: float, other: float, excess: float, systematic: bool) -> float:
    """Lead of one fit over another, in chi-square; `excess` is what the first leaves, per value.

    Where what is left is no noise but `systematic`, it is wrong alike at neighbouring lines: a group of lines then
    counts as one value whose size of error nobody knows.
    """
    lead = (other - cost) / excess
    return min(lead, GROUPS * float(np.log(other / cost))) if systematic else lead


def unsimulated(
    seen: Prospect, train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter,
    equal: Equals | None = None,
) -> NonlinearAnswer:  # fmt: skip
    """The answer that the fits along the motion give alone.

    Either a law without a name is so far ahead that no simulation can turn that, or no law says anything; the place is
    then where a force explains most of the distortion.
    """
    best, bench = seen.near[0], seen.bench
    tried = tuple(replace(t, simulated=False) for t in seen.near)
    found = Study(bench.engine, bench.point, bench.runs, seen.base, seen.calm, tried, None, seen.recovered)
    error = base_errors(found, train, test, seen.base.x, scatter)
    rivals = [t for t in tried if t.named]
    place = best.spot.place if seen.nameless else max(seen.recovered, key=lambda q: q.share).spot.place
    return NonlinearAnswer(
        (), place, _alternatives(best, rivals, Limits()), _located(found, equal), error, error,
        NAMELESS if seen.nameless else NOTHING, (), (), curves(found, best), found, (best,), seen.level, seen.base.x,
        noise_of(test or train), gained=seen.nameless, held_out=tuple(o.run for o in test if o.run is not None),
        scatter=scatter, equal=others_of(equal or {}, best.spot),
    )  # fmt: skip


def _only_smoother(t: Tried, best: Tried) -> bool:
    """Whether a law is the best one with its corners rounded, or with a spring to it, which explains no less: the
    simpler is preferred.
    """
    if t.spot.place != best.spot.place:
        return False
    rounded = t.mechanism == "hysteresis" and best.name == "stick-slip"
    return rounded or (t.name in ("hysteresis", "stick-slip") and best.name == "coulomb-friction")


def _level(t: Tried, other: Tried) -> float:
    """Cost of a fit, raised to as many values as the other's."""
    return t.cost * other.made.count / t.made.count


def _level_of(base: Made, other: Tried) -> float:
    """The same of the base."""
    return base.objective * other.made.count / base.count


EXPLAINS, AHEAD, FORETELLS = 0.05, 2.0, 1 / 3
"""Part of what the base leaves that laws which stand out may leave; by how much more every other law leaves, each
alone; the part of the base's held-out error to which they bring it;"""
WARPED = 100.0
"""price of the base beside them, of its entries, above which it is another structure: ten deviations each."""
SOUND = 4.0
"""Price of the base beside the laws, of its entries, up to which it is the structure that was given: what the base
alone can do only as another one, with modes moved beyond their ordinary errors, is no prediction of that structure's.
"""
HALF = 0.5
"""Part of what the named laws leave beyond noise that a general law must explain for the names to be wrong."""
MOST = 2
"""Different laws, or places, that are named together."""
MOST_IDENTIFIED = 3
"""The same where the base was identified: a further law is kept only where runs held out are predicted better."""
NUMBERS = {MOST: "two", MOST_IDENTIFIED: "three"}
BENT = 10.0
"""Price of the base beside the laws, of its entries, above which that excuse does not hold: sound ones pay up to 2."""
LITTLE = 0.3
"""Part of the base's objective above which a fit that has no name says nothing of the place."""
ASTRAY = 3.0
"""Times the noise, and the error along the measured motion, beyond which a simulation has gone another way."""
MISFIT = 3.0
"""Chi-square per value above which nothing is called explained,"""
NEARLY = 0.1
"""unless the held-out error falls to this of the base's: what is left is then a small correction to the law."""


def _all_named(
    found: Study, laws: Sequence[Tried], best: Tried, rivals: Sequence[Tried], scatter: Scatter
) -> tuple[Named, ...]:  # fmt: skip
    """Every named law of the chain, its parameters from the last fit; a general one has no name. The confidence in the
    first is told from `best`, which was fitted to the lines of its rivals.

    Standard deviations grow with what the fit leaves, and hold what common scales leave open (`scales`).
    """
    last = laws[-1].made
    excess = max(1.0, last.data_part / last.count)
    based, n_out = found.engine.is_base, int(np.count_nonzero(heard(found.runs[0])))
    out = []
    for i, t in enumerate(laws):
        if not t.named:
            continue
        mechanism = MECHANISMS[t.name]
        value, std = last.law(i)
        n, whole = value.size, last.whole(i)
        told = [*range(n), *(j for j in range(n, len(mechanism.names)) if whole[j])]  # what no fit moves, if any
        value, std = whole[told], np.append(std, np.zeros(len(told) - n))
        term = mechanism.term(t.spot.place, t.spot.axis, t.spot.column)
        term = replace(term, parameters=tuple(term.parameters[j] for j in told))
        others = [r for r in rivals if (t.name, t.spot.place) not in r.all_of_it]
        trust = _confidence(best if (t.name, t.spot.place) in best.all_of_it else t, others) if i == 0 else 0.95
        common = scale_std([mechanism.units[j] for j in told], value, scatter, max(n_out, 1), based)
        out.append(Named(term, value, np.hypot(std * np.sqrt(excess), common), trust))
    return tuple(out)


def _confidence(best: Tried, rivals: Sequence[Tried]) -> float:
    excess = max(1.0, best.made.data_part / best.made.count)
    weights = np.exp(-np.clip([(t.cost - best.cost) / excess / 2 for t in rivals], 0, 700)) if rivals else np.zeros(0)
    return float(1.0 / (1.0 + weights.sum()))


def _alternatives(best: Tried, rivals: Sequence[Tried], limits: Limits) -> tuple[Alternative, ...]:
    """The six nearest rivals, each law once at a place, along whichever motion there it does best, beside the same
    other laws.
    """
    near: dict[frozenset, Tried] = {}
    for t in sorted(rivals, key=lambda t: t.cost):
        near.setdefault(t.all_of_it, t)
    out = []
    for t in list(near.values())[:6]:
        gap = t.cost - best.cost
        name = f"{best.name} at {best.spot.place}"
        if gap < -limits.name:
            why = f"leaves {-gap:.3g} less in chi-square than {name}"
        elif gap < limits.name:
            why = f"explains as well as {name} (chi-square {gap:+.1f})"
        else:
            why = f"leaves {gap:.3g} more in chi-square than {name}"
        if t.more:
            others = " and ".join(f"{q.name} at {q.spot.place}" for q in t.more)
            why = f"beside {others} it {why}"
        mechanism = MECHANISMS[t.name]
        term = mechanism.term(t.spot.place, t.spot.axis, t.spot.column)
        out.append(Alternative(term, float("nan"), t.cost, why))
    return tuple(out)


def _unnamed(best: Tried, reason: str) -> Alternative:
    """The best law, which has no name for a reason: the others are compared with it."""
    term = MECHANISMS[best.name].term(best.spot.place, best.spot.axis, best.spot.column)
    return Alternative(term, float("nan"), best.cost, f"comes nearest; {reason}")


def _located(found: Study, equal: Equals | None) -> tuple[tuple[Place, float], ...]:
    """Places by the share of the distortion that a force there explains; a fitted law's place first."""
    shares: dict[Place, float] = {}
    for q in found.recovered:
        shares[q.spot.place] = max(shares.get(q.spot.place, 0.0), q.share)
    total = found.base.objective
    for t in found.tried:
        gain = max(total - t.made.objective, 0.0) / total
        shares[t.spot.place] = max(shares.get(t.spot.place, 0.0), gain)
    for spot in [*(t.spot for t in found.tried), *(q.spot for q in found.recovered)]:
        for other in others_of(equal or {}, spot):
            shares[other] = max(shares.get(other, 0.0), shares[spot.place])
    return tuple(sorted(shares.items(), key=lambda row: -row[1])[:10])
