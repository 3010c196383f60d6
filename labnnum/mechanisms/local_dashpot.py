"""local-dashpot: a viscous damper at a node to ground, or along an element."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS, Mechanism, Place, Site, Term, scalar_term
from labnnum.mechanisms.geometry import dof_rows
from labnnum.mechanisms.laws import Dashpot


@final
@dataclass(frozen=True)
class LocalDashpot(Mechanism):
    """Z += c s at a node's translation, or on the relative motion of two nodes."""

    id = "local-dashpot"
    title = "viscous damper"
    equation = "f = c u'"
    shows = "damping rises in the modes that move there"
    told_apart = "free modal damping can hide it; a lossy spring's loss is flat in frequency"
    symbol = "dashpot"
    reference = "Ewins (2000), section 2.5"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each translation of each node to ground, each translation and rotation between neighbours."""
        for node in site.free_nodes:
            for axis in TRANSLATIONS:
                term = scalar_term(self, site, Place("ground", node), Dashpot(), site.rows(node, (axis,)), variant=axis)
                if term is not None:
                    yield term
        for a, b in site.elements:
            for axis in TRANSLATIONS + ROTATIONS:
                column = relative(site, a, b, axis)
                if column is None:
                    continue
                unit = "N*m*s/rad" if axis in ROTATIONS else "N*s/m"
                law = Dashpot(("damping",), (unit,))
                term = scalar_term(self, site, Place("element", a, b), law, column, variant=axis)
                if term is not None:
                    yield term


def relative(site: Site, a: str, b: str, axis: str) -> np.ndarray | None:
    """Column, shape (n, 1), of the motion of b less that of a; a node at a support does not move."""
    ra, rb = dof_rows(site, a).get(axis), dof_rows(site, b).get(axis)
    if ra is None and rb is None:
        return None
    if (ra is None and a not in site.supports) or (rb is None and b not in site.supports):
        return None
    column = np.zeros((site.stiffness.shape[0], 1))
    if rb is not None:
        column[rb] = 1.0
    if ra is not None:
        column[ra] = -1.0
    return column
