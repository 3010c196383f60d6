"""added-mass: a mass that the model does not hold, at a node."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import (
    ROTATIONS,
    SIZES,
    TRANSLATIONS,
    Group,
    Mechanism,
    Place,
    Site,
    Term,
    amount,
    scalar_term,
)
from labnnum.mechanisms.laws import Inertia, Mass


@final
@dataclass(frozen=True)
class AddedMass(Mechanism):
    """Z += s^2 m at the node's translations (s^2 J at its rotations)."""

    id = "added-mass"
    title = "mass added at a node"
    equation = "f = m u''"
    shows = "all modes fall by the square of the shape there; apparent dynamic stiffness -omega^2 m"
    told_apart = "ground-stiffness is constant, not -omega^2"
    symbol = "square"
    reference = "Ewins (2000), section 4.4"

    def terms(self, site: Site) -> Iterable[Term]:
        """Mass at every node; mass with rotary inertia where the node has rotations."""
        for node in site.free_nodes:
            place = Place("node", node)
            moved = site.rows(node, TRANSLATIONS)
            only = scalar_term(self, site, place, Mass(), moved, positive=False)
            if only is None:
                continue
            yield only
            turned = site.rows(node, ROTATIONS)
            scale = site.scale(Inertia(), turned, np.zeros(1), 0) if turned.size else np.inf
            if np.isfinite(scale):
                mass = only.parameters[0]
                inertia = amount("inertia", "kg*m^2", scale)
                sizes = mass.upper / 30 * SIZES
                starts = np.array([[m, j] for m in sizes[1:5] for j in scale * SIZES[1:5]])
                groups = (Group(Mass(), moved, 0), Group(Inertia(), turned, 1))
                yield Term(self, place, (mass, inertia), starts, groups, "with inertia")

    def sense(self, term: Term, p: np.ndarray) -> str | None:
        """Either "more" or "less" mass than the model holds."""
        return "more" if p[0] >= 0 else "less"
