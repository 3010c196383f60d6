"""Linear physics that stands beside a law and keeps it from being named: put into the model, the law sought again.

A clamp that gives misleads the base that every law is fitted with, and the law hides the clamp from the linear search.
What a law that comes near leaves after its share has been taken out is mostly the clamp's; with that in the model the
law is sought once more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from labnnum.diagnosis.decide import named_of
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import fit
from labnnum.diagnosis.linear import far
from labnnum.diagnosis.nonlinear.bench import Bench
from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.explore import LEAVES, LINES, MISLED, STRAINED, calmed
from labnnum.diagnosis.nonlinear.fitting import fit as fit_base
from labnnum.diagnosis.nonlinear.locate import recover, spots
from labnnum.diagnosis.nonlinear.mended import Fault, faults_of
from labnnum.diagnosis.nonlinear.records import Split
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.task import Candidate, choose_lines, data_of
from labnnum.diagnosis.verdict import Diagnosis, Named
from labnnum.errors import LabnnumError
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.extended import Added, ExtendedStructure
from labnnum.parameters import Parameter

PROMISING = 0.9
"""The same for what is found at the quietest level, where the law itself makes a part of what is left."""
SURE = 0.99
"""Confidence in a fault of a channel without which a law explains what it does not with it."""
ONE_LEVEL = 1.05
"""Ratio of two levels below which they are one."""
WORTH = 0.75
"""Part of what the base alone leaves beside a law to which something linear must bring it down to be tried there."""

AGREE = 3.0
"""Standard deviations of both within which two searches find one fault."""
MOSTLY = 0.5
"""Part of what the base leaves beside a law to which a channel's fault, that was off when the law was found, must bring
it down to be believed."""


def strained(found: NonlinearAnswer) -> bool:
    """Whether a law explains most, and the base beside it pays more than a sound one: it stands in for something."""
    last, base = found.laws[-1].made, found.study.base
    most = found.misfit < LEAVES * base.data_part / base.count
    return most and bool(found.linearised) and last.prior_part > STRAINED * last.n_base


def added_to(engine: Engine, rest: Diagnosis) -> Engine | None:
    """The engine of the structure with what the linear search found in it, named or not: whether it was that, the law
    decides. None where nothing was found, or something that is no part of a structure.
    """
    found, held = _found(rest), _held(rest)
    if found is None or not all(_structural(t) for t in found.terms[held:]):
        return None
    wider = _with(engine, found, range(held, len(found.terms)))
    return None if wider is engine else wider


def channels_of(rest: Diagnosis) -> tuple[Named, ...]:
    """The faults of channels that a linear search beside a law found, named or not, where it found nothing else."""
    found, held = _found(rest), _held(rest)
    if found is None or not _faults(found):
        return ()
    scatter = rest.detail["selection"].scatter
    every = tuple(named_of(found.fit, i, SURE, scatter) for i in range(held, len(found.terms)))
    return every if all(n.term.mechanism.domain == "channel" for n in every) else ()


@dataclass(frozen=True, eq=False)
class Beneath:
    """Engines with linear physics of the quietest level in their structure, one mechanism each, since one of several is
    the law as that level sees it: the likely ones first; the faults of channels there; and these as they are named
    where a law beside them leaves nothing.
    """

    engines: list[Engine]
    faults: list[Fault]
    named: tuple[Named, ...]


def beneath(
    engine: Engine, quiet: Diagnosis, loud: Observation, shares: Mapping[frozenset, float] | None = None
) -> Beneath | None:  # fmt: skip
    """The same from the quietest level alone, where most laws are next to linear: the engine with what was found in the
    structure, and the faults of channels; of a model that leaves far more than noise only these. None where nothing
    was found.

    Of several mechanisms that one is the law whose place explains most of the distortion (`shares_of`); where nothing
    tells that, the one which the loudest level, `loud`, would change most.
    """
    found = _found(quiet, PROMISING)
    if found is None:
        return None
    faults = faults_of(found.terms, found.fit.point.terms)
    if any(f.lost for f in faults):
        return None
    if far(found, quiet.detail["selection"].data) and len(faults) < len(found.terms):
        return None  # of what leaves so much only a channel's fault is believed: no law looks like one
    linear = [i for i, t in enumerate(found.terms) if _structural(t)]
    if len(linear) < 2:
        some = [linear]
    else:
        if shares:
            law = [shares.get(ends_of(t.place), 0.0) for t in found.terms]
        else:
            law = _changes(engine, found, quiet.detail["selection"].scatter, loud)
        some = [[i] for i in sorted(linear, key=lambda i: law[i])]
    engines = [_with(engine, found, which) for which in some]
    if all(e is engine for e in engines) and not faults:
        return None
    scatter = quiet.detail["selection"].scatter
    every = [named_of(found.fit, i, SURE, scatter) for i in range(len(found.terms))]
    wrong = {f.term for f in faults}
    return Beneath(engines, faults, tuple(n for n in every if n.term in wrong))


def finds_first(rest: Diagnosis, faults: Sequence[Fault]) -> bool:
    """Whether what a linear search finds first is one of the channels' faults, named or not, and explains most."""
    chain = rest.detail["selection"].chain
    if len(chain) < 2 or chain[1].cost > MOSTLY * chain[0].cost:
        return False
    first = chain[1].last
    return any(first.mechanism.id == f.term.mechanism.id and first.place == f.term.place for f in faults)


def confirmed(rest: Diagnosis, quiet: Diagnosis) -> tuple[Named, ...]:
    """The fault of a channel that a linear search beside a law finds first, where the search at the quietest level
    finds the same first, and as large: what keeps either from naming it is not in both. None where they differ.
    """
    beside, alone = _first_fault(rest), _first_fault(quiet)
    if beside is None or alone is None:
        return ()
    same = beside.term.mechanism.id == alone.term.mechanism.id and beside.place == alone.place
    apart = np.abs(beside.value - alone.value)
    return (beside,) if same and np.all(apart < AGREE * np.hypot(beside.std, alone.std)) else ()


def _first_fault(d: Diagnosis) -> Named | None:
    """What a linear search finds first, if it is a channel's fault that can be taken off."""
    chain = d.detail["selection"].chain
    held = _held(d)
    if len(chain) < 2 or len(chain[1].terms) != held + 1:
        return None
    faults = _faults(chain[1])
    if not faults or any(f.lost for f in faults):
        return None
    return named_of(chain[1].fit, held, SURE, d.detail["selection"].scatter)


def supposed(engine: Engine, rest: Diagnosis) -> Beneath | None:
    """The same from what a linear search beside a law finds first, where that removes much of what is left and has no
    name yet: the law's own errors, fitted without it, may be what stands in its way.
    """
    chain = rest.detail["selection"].chain
    held = _held(rest)
    if len(chain) < 2 or len(chain[1].terms) != held + 1 or chain[1].cost > WORTH * chain[0].cost:
        return None
    found, scatter = chain[1], rest.detail["selection"].scatter
    faults = _faults(found)
    if faults:
        one = Beneath([engine], faults, (named_of(found.fit, held, SURE, scatter),))
        return None if any(f.lost for f in faults) else one
    wider = _with(engine, found, range(held, held + 1))
    return None if wider is engine else Beneath([wider], [], ())


def shares_of(
    engine: Engine, train: Sequence[Observation], places: Places, scatter: Scatter, span: tuple[float, float]
) -> dict[frozenset, float]:
    """Part of the distortion that a force at each place explains, by the ends of the place; empty where no line shows
    distortion alone.
    """
    runs = [o.run for o in train if o.run is not None]
    if not any(r.quiet.any() for r in runs):
        return {}
    i = quietest(runs)
    point = base_point(engine, train[i], scatter, span)
    plain = Bench(engine, point, tuple(runs), scatter, ()).on(LINES).joint([])
    x = calmed(engine, point, runs[i], scatter).x
    out: dict[frozenset, float] = {}
    for s in spots(engine, engine.site(places.nodes, places.elements, places.supports)):
        ends = ends_of(s.place)
        out[ends] = max(out.get(ends, 0.0), recover(plain, x, point, s).share)
    return out


def ends_of(place: Place) -> frozenset:
    """The ends of a place: an element and the joint in it are the same, and so are a node and the ground under it."""
    return frozenset({place.id, place.to} - {None})


def _changes(engine: Engine, found: Candidate, scatter: Scatter, loud: Observation) -> list[float]:
    """How much each mechanism found at the quietest level would have to change for the loudest: the square of the
    change of its parameters over its variance; zeros where that level's noise is not known.
    """
    if loud.frf.variance is None:
        return [0.0 for _ in found.terms]
    here, n = found.fit, engine.theta0.size
    data = data_of(choose_lines(loud.frf), scatter)
    there = fit(engine, data, found.terms, scatter, here.point.vector(), steps=CHANGING)
    cuts = np.cumsum([0, *(t.n for t in found.terms)])
    out = []
    for a, b in pairwise(cuts):
        step = (there.point.terms - here.point.terms)[a:b]
        both = (there.covariance + here.covariance)[n + a : n + b, n + a : n + b]
        out.append(float(step @ np.linalg.pinv(both) @ step))
    return out


CHANGING = 20
"""Steps of the fit to the loudest level."""


def misled(engine: Engine, parts: Split, scatter: Scatter, span: tuple[float, float]) -> bool:
    """Whether the base leaves more than noise of the run that distorts least, or explains it at too high a price: a
    strong law is missing, or something linear.
    """
    runs = [o.run for o in parts.train if o.run is not None]
    i = quietest(runs)
    calm = calmed(engine, base_point(engine, parts.train[i], scatter, span), runs[i], scatter)
    return calm.data_part > MISLED * calm.count or calm.prior_part > STRAINED * calm.n_base


def left_alone(engine: Engine, parts: Split, scatter: Scatter, span: tuple[float, float]) -> float:
    """Chi-square per value that the base leaves of all runs by itself, fitted from the quietest level."""
    runs = tuple(o.run for o in parts.train if o.run is not None)
    i = quietest(runs)
    point = base_point(engine, parts.train[i], scatter, span)
    plain = Bench(engine, point, runs, scatter, ()).on(LINES).joint([])
    made = fit_base(plain, plain.start(calmed(engine, point, runs[i], scatter).x), [None] * len(runs), steps=STEPS)
    return made.data_part / made.count


STEPS = 12
"""Steps of the base's fit to all runs."""


def quietest_of(usable: Sequence[Observation], train: Sequence[Observation]) -> list[Observation]:
    """Runs of the lowest level, of those that are fitted where these are periodic."""
    some = [o for o in train if o.run is not None] or list(usable)
    least = min(o.level for o in some)
    return [o for o in some if o.level < ONE_LEVEL * least]


def _found(rest: Diagnosis, worth: float = WORTH) -> Candidate | None:
    """The last model of a linear search, if it is named or worth far more than the structure as it is."""
    chain = rest.detail["selection"].chain
    enough = bool(rest.named) or chain[-1].cost < worth * chain[0].cost
    return chain[-1] if len(chain[-1].terms) > _held(rest) and enough else None


def _held(rest: Diagnosis) -> int:
    """How many mechanisms the structure held before a linear search: they lead in all its models."""
    return len(rest.detail["selection"].chain[0].terms)


def _faults(found: Candidate) -> list[Fault]:
    """The channels' faults in a model of a linear search; what the structure held before has none."""
    return faults_of(found.terms, found.fit.point.terms)


def _with(engine: Engine, found: Candidate, which: Sequence[int]) -> Engine:
    """The engine of the structure that holds those of the linear mechanisms found that have the numbers `which`;
    without the last where it cannot be built with it, and so on: a motion that has no mass, or no mode in the band.
    """
    added, at = [], 0
    for i, t in enumerate(found.terms):
        values = zip(t.parameters, found.fit.point.terms[at : at + t.n], strict=True)
        if _structural(t) and i in which:
            added.append(Added(t.sought, tuple(_about(p, float(v)) for p, v in values)))
        at += t.n
    while added:
        wider = widened(engine, added)
        if wider is not None:
            return wider
        added.pop()
    return engine


def widened(engine: Engine, added: Sequence[Added]) -> Engine | None:
    """The engine of the structure that holds mechanisms besides; None where it cannot be built with them."""
    plain = engine.structure
    try:
        if isinstance(plain, ExtendedStructure):
            structure = replace(plain, added=(*plain.added, *added))
        else:
            structure = ExtendedStructure(plain, tuple(added))
        wider = Engine(structure, engine.outputs, engine.inputs, engine.band)
    except (LabnnumError, np.linalg.LinAlgError):
        return None
    n = min(wider.zeta0.size, engine.zeta0.size)
    wider.zeta0[:n] = engine.zeta0[:n]  # what moves in a support has no damping of its own, and modes no less
    if engine.coupling is not None:
        wider.couple()
    return wider


def _structural(t: Term) -> bool:
    """Whether a term is part of the structure: no channel, and no mode of something else, which a law may look like."""
    return t.mechanism.domain == "linear" or (t.mechanism.domain == "modal" and t.fitted.whole is not None)


NONE = 1e-6
"""Deviation, of its range, of a parameter that the fit has put at nothing."""


def _about(p: Parameter, value: float) -> Parameter:
    """The parameter with a prior as wide as its value: what a law hides is known by its kind, hardly by its size."""
    span = p.upper - p.lower
    std = abs(value) or NONE * (span if 0 < span < np.inf else 1.0)
    return Parameter(p.name, value, min(p.lower, value), max(p.upper, value), p.unit, std)
