"""attached-oscillator: an appendage, cable or absorber that moves on its own at a node."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import TRANSLATIONS, Group, Mechanism, Place, Site, Term, amount
from labnnum.mechanisms.laws import Mass, Oscillator
from labnnum.parameters import Parameter


@final
@dataclass(frozen=True)
class AttachedOscillator(Mechanism):
    """Z += m s^2 (w^2 + 2 zeta w s) / (s^2 + 2 zeta w s + w^2) at a translation of the node."""

    id = "attached-oscillator"
    title = "appendage that moves on its own"
    equation = "f = m s^2 (w^2 + 2 zeta w s) / (s^2 + 2 zeta w s + w^2) u"
    shows = "a split peak, and a notch at the attachment"
    told_apart = "added-mass when stiff: then the simpler name is given"
    symbol = "mass on a spring"
    reference = "Den Hartog (1956), section 3.2"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each translation of each node."""
        low, high = site.omega.min() / 2 / np.pi, site.omega.max() / 2 / np.pi
        grid = np.exp(np.arange(np.log(0.4 * low), np.log(1.4 * high), 0.05))
        for node in site.free_nodes:
            for axis in TRANSLATIONS:
                columns = site.rows(node, (axis,))
                scale = site.scale(Mass(), columns, np.zeros(1), 0) if columns.size else np.inf
                if not np.isfinite(scale):
                    continue
                parameters = (
                    amount("mass", "kg", scale),
                    Parameter("frequency", float(np.sqrt(low * high)), 0.3 * low, 2.5 * high, "Hz"),
                    Parameter("damping_ratio", 0.02, 1e-4, 0.5, "1"),
                )
                starts = np.array(
                    [[m * scale, f, z] for f in grid for m, z in ((0.01, 0.01), (0.06, 0.03), (0.3, 0.03))]
                )
                yield Term(self, Place("node", node), parameters, starts, (Group(Oscillator(), columns, 0),), axis)
