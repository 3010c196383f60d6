"""Clamps that give, in the model before a law is sought: where one acts at every level, nothing shows the clamp alone.

A law that holds a structure at its quietest level too leaves no recording of the structure without it, and a clamp that
gives may move the first modes by their half. Neither is found without the other. With the compliance as a parameter of
the model, of the size that first order says does so much, both come together from the widest tolerance on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.beside import SURE, widened
from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.verdict import Named
from labnnum.mechanisms.base import Term
from labnnum.mechanisms.extended import Added, ExtendedStructure
from labnnum.mechanisms.support_compliance import FARTHEST, SupportCompliance
from labnnum.parameters import Parameter

WIDE = 3.0
"""Standard deviation of a compliance, in units of the one that moves a squared frequency by itself at first order."""

TOLD = 3.0
"""Standard deviations from nothing at which a clamp gives."""


def giving(engine: Engine, places: Places) -> list[Engine]:
    """Engines of the structure in which one of its clamps gives, in all motions that load each other; none where no
    clamp is known.
    """
    site = engine.site(places.nodes, places.elements, places.supports)
    widest: dict[str, Term] = {}
    for t in SupportCompliance().terms(site):
        released = t.place.id in site.held and "fitted" in t.data
        if released and t.n > (widest[t.place.id].n if t.place.id in widest else 0):
            widest[t.place.id] = t
    made = (widened(engine, [Added(t, tuple(_open(p) for p in t.parameters))]) for t in widest.values())
    return [wider for wider in made if wider is not None]


def nearer_to(engine: Engine, wider: Engine, x: NDArray) -> Engine | None:
    """The engine of the structure with a clamp as a fit on `wider`, one of `giving`, has left it at the vector `x`: the
    modes of another clamp are a basis that gives its frequencies some percent too high.
    """
    (added,) = wider.structure.added if isinstance(wider.structure, ExtendedStructure) else (None,)
    if added is None:
        return None
    n = engine.theta0.size
    values = zip(added.parameters, x[n : n + len(added.parameters)], strict=True)
    return widened(engine, [Added(added.term, tuple(_about(p, max(float(v), 0.0)) for p, v in values))])


def named_in(found: NonlinearAnswer) -> tuple[Named, ...]:
    """The clamps of the structure on which a law was found, as its fit has left them, where they give at all; their
    standard deviations grow with what it leaves.
    """
    engine, last = found.study.engine, found.laws[-1].made
    added = engine.structure.added if isinstance(engine.structure, ExtendedStructure) else ()
    at, out = engine.theta0.size - sum(len(a.parameters) for a in added), []
    grown = np.sqrt(max(1.0, last.data_part / last.count))
    for a in added:
        here = slice(at, at + len(a.parameters))
        value, std = last.x[here], grown * np.sqrt(np.maximum(np.diag(last.covariance)[here], 0.0))
        if np.any(value > TOLD * std):
            out.append(Named(a.term.fitted, value, std, SURE))
        at += len(a.parameters)
    return tuple(out)


def _open(p: Parameter) -> Parameter:
    """A compliance begun where first order says that it doubles a mode's flexibility (`SupportCompliance`)."""
    first = p.upper / FARTHEST
    return Parameter(p.name, first, p.lower, p.upper, p.unit, WIDE * first)


def _about(p: Parameter, value: float) -> Parameter:
    """A compliance begun at a value, of which it may be off by as much, or by as much as it was begun with."""
    return Parameter(p.name, value, p.lower, max(p.upper, value), p.unit, max(value, p.spread))
