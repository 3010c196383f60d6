"""ground-stiffness: a spring from a node to ground (to the moving base under base excitation)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.base import TRANSLATIONS, Mechanism, Place, Site, Term, scalar_term
from labnnum.mechanisms.laws import Spring


@final
@dataclass(frozen=True)
class GroundStiffness(Mechanism):
    """Z += k at one translation of the node."""

    id = "ground-stiffness"
    title = "spring from a node to ground"
    equation = "f = k u"
    shows = "low modes rise most; apparent dynamic stiffness constant"
    told_apart = "added-mass goes as -omega^2; an element's stiffness acts on relative motion"
    symbol = "spring to ground"
    reference = "Ewins (2000), section 4.4"

    def terms(self, site: Site) -> Iterable[Term]:
        """One spring at each translation of each node."""
        for node in site.free_nodes:
            for axis in TRANSLATIONS:
                term = scalar_term(self, site, Place("ground", node), Spring(), site.rows(node, (axis,)), variant=axis)
                if term is not None:
                    yield term
