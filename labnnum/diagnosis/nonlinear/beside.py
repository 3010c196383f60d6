"""Linear physics that stands beside a law and keeps it from being named: put into the model, the law sought again.

A clamp that gives misleads the base that every law is fitted with, and the law hides the clamp from the linear search.
What a law that comes near leaves after its share has been taken out is mostly the clamp's; with that in the model the
law is sought once more.
"""

from __future__ import annotations

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.explore import LEAVES, STRAINED
from labnnum.diagnosis.verdict import Diagnosis
from labnnum.errors import LabnnumError
from labnnum.mechanisms.extended import Added, ExtendedStructure
from labnnum.parameters import Parameter

WORTH = 0.75
"""Part of what the base alone leaves beside a law to which something linear must bring it down to be tried there."""


def strained(found: NonlinearAnswer) -> bool:
    """Whether a law explains most, and the base beside it pays more than a sound one: it stands in for something."""
    last, base = found.laws[-1].made, found.study.base
    most = found.misfit < LEAVES * base.data_part / base.count
    return most and bool(found.linearised) and last.prior_part > STRAINED * last.n_base


def added_to(engine: Engine, rest: Diagnosis) -> Engine | None:
    """The engine of the structure with what the linear search found in it, named or not: whether it was that, the law
    decides. None where nothing was found, or something that is no part of a structure.
    """
    chain = rest.detail["selection"].chain
    best = chain[-1]
    if not best.terms or best.cost > WORTH * chain[0].cost or any(t.mechanism.domain != "linear" for t in best.terms):
        return None
    added, at = [], 0
    for t in best.terms:
        values = zip(t.parameters, best.fit.point.terms[at : at + t.n], strict=True)
        added.append(Added(t.sought, tuple(_about(p, float(v)) for p, v in values)))
        at += t.n
    try:
        wider = Engine(ExtendedStructure(engine.structure, tuple(added)), engine.outputs, engine.inputs, engine.band)
    except (LabnnumError, np.linalg.LinAlgError):
        return None  # no mode of it lies in the band, for instance
    n = min(wider.zeta0.size, engine.zeta0.size)
    wider.zeta0[:n] = engine.zeta0[:n]  # what moves in a support has no damping of its own, and modes no less for it
    return wider


def _about(p: Parameter, value: float) -> Parameter:
    """The parameter with a prior as wide as its value: what a law hides is known by its kind, hardly by its size."""
    return Parameter(p.name, value, min(p.lower, value), max(p.upper, value), p.unit, max(abs(value), 1e-300))
