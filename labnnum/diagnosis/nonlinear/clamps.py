"""Clamps that give, in the model before a law is sought: where one acts at every level, nothing shows the clamp alone.

A law that holds a structure at its quietest level too leaves no recording of the structure without it, and a clamp that
gives may move the first modes by their half. Neither is found without the other. With the compliance as a parameter of
the model, of the size that first order says does so much, both come together from the widest tolerance on.
"""

from __future__ import annotations

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.places import Places
from labnnum.errors import LabnnumError
from labnnum.mechanisms.base import Term
from labnnum.mechanisms.extended import Added, ExtendedStructure
from labnnum.mechanisms.support_compliance import FARTHEST, SupportCompliance
from labnnum.parameters import Parameter

WIDE = 3.0
"""Standard deviation of a compliance, in units of the one that moves a squared frequency by itself at first order."""


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
    out = []
    for t in widest.values():
        try:
            structure = ExtendedStructure(engine.structure, (Added(t, tuple(_open(p) for p in t.parameters)),))
            wider = Engine(structure, engine.outputs, engine.inputs, engine.band)
        except (LabnnumError, np.linalg.LinAlgError):
            continue
        n = min(wider.zeta0.size, engine.zeta0.size)
        wider.zeta0[:n] = engine.zeta0[:n]
        out.append(wider)
    return out


def _open(p: Parameter) -> Parameter:
    """A compliance begun where first order says that it doubles a mode's flexibility (`SupportCompliance`)."""
    first = p.upper / FARTHEST
    return Parameter(p.name, first, p.lower, p.upper, p.unit, WIDE * first)
