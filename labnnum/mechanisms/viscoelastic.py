"""viscoelastic: an element whose stiffness and loss vary together with frequency (Zener solid)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import TRANSLATIONS, Group, Mechanism, Place, Site, Term, amount
from labnnum.mechanisms.geometry import element_gain, element_stiffness, factors
from labnnum.mechanisms.laws import Maxwell
from labnnum.parameters import Parameter


@final
@dataclass(frozen=True)
class Viscoelastic(Mechanism):
    """Z += k1 s tau / (1 + s tau) on an element (k1 relative to its stiffness) or from a node to ground."""

    id = "viscoelastic"
    title = "viscoelastic element or mount"
    equation = "f = k1 s tau / (1 + s tau) u"
    shows = "stiffness and loss vary with frequency together"
    told_apart = "a dashpot, unless the band spans 1 / tau"
    symbol = "spring and dashpot in series"
    reference = "Zener (1948); Nashif, Jones and Henderson (1985), chapter 3"

    def terms(self, site: Site) -> Iterable[Term]:
        """Every element, and every node's translation to ground."""
        for a, b in site.elements:
            found = element_stiffness(site, a, b)
            if found is None:
                continue
            index, k, _ = found
            columns = np.zeros((site.stiffness.shape[0], factors(k).shape[1]))
            columns[index] = factors(k)
            law, gain = Maxwell(("relative_k1", "tau"), ("1", "s")), element_gain(site, a, b)
            yield from self._term(site, Place("element", a, b), law, columns, "", gain)
        for node in site.free_nodes:
            for axis in TRANSLATIONS:
                columns = site.rows(node, (axis,))
                if columns.size:
                    yield from self._term(site, Place("ground", node), Maxwell(), columns, axis)

    def _term(
        self, site: Site, place: Place, law: Maxwell, columns: np.ndarray, variant: str, gain: np.ndarray | None = None
    ) -> Iterable[Term]:
        low, high = site.omega.min(), site.omega.max()
        middle = 1.0 / np.sqrt(low * high)
        scale = site.scale(law, columns, np.array([0.0, middle]), 0)
        if not np.isfinite(scale):
            return
        tau = Parameter("tau", middle, 0.05 / high, 20.0 / low, law.units[1])
        k1 = amount(law.names[0], law.units[0], scale)
        taus = np.geomspace(0.3 / high, 3.0 / low, 5)
        sizes = scale * np.array([0.003, 0.01, 0.03, 0.1, 0.3, 1.0])
        starts = np.array([[k, t] for k in sizes for t in taus])
        yield Term(self, place, (k1, tau), starts, (Group(law, columns, 0, gain),), variant)
