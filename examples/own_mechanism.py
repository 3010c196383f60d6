"""A mechanism of one's own: an inerter, whose force follows the relative acceleration of its two ends.

labnnum diagnose run.h5 --model chain.toml --mechanism examples/own_mechanism.py -o out
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms import Mechanism, Place, Site, Term
from labnnum.mechanisms.base import TRANSLATIONS, scalar_term
from labnnum.mechanisms.laws import Law
from labnnum.mechanisms.local_dashpot import relative


@final
@dataclass(frozen=True)
class Inertance(Law):
    """g = b s^2 between two motions."""

    names: tuple[str, ...] = ("inertance",)
    units: tuple[str, ...] = ("kg",)

    def value(self, s, p):
        """g(s), in N/m."""
        return p[0] * s**2

    def derivative(self, s, p):
        """dg/db."""
        return (s**2)[None]

    def local(self, p):
        """M = [b]."""
        zero = np.zeros((1, 1))
        return np.array([[p[0]]]), zero, zero, zero


@final
@dataclass(frozen=True)
class Inerter(Mechanism):
    """Z += b s^2 along an element."""

    id = "inerter"
    title = "flywheel between two nodes"
    equation = "f = b (u1'' - u2'')"
    shows = "modes that stretch the element fall, the others stay"
    told_apart = "added-mass loads every motion of its node"
    symbol = "flywheel"
    reference = "Smith (2002)"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each relative translation along each element."""
        for a, b in site.elements:
            for axis in TRANSLATIONS:
                columns = relative(site, a, b, axis)
                if columns is not None:
                    term = scalar_term(self, site, Place("element", a, b), Inertance(), columns, variant=axis)
                    if term is not None:
                        yield term
