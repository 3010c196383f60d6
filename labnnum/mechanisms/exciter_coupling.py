"""exciter-coupling: the shaker's moving mass, suspension and damping, carried by the structure at the drive point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import Group, Mechanism, Place, Site, Term, amount
from labnnum.mechanisms.laws import Dashpot, Mass, Spring


@final
@dataclass(frozen=True)
class ExciterCoupling(Mechanism):
    """Z += m s^2 + c s + k at the drive point: what hangs between the force cell and the structure, or beyond it."""

    id = "exciter-coupling"
    title = "shaker carried by the structure"
    equation = "f = m u'' + c u' + k u at the drive point"
    shows = "force drops at resonance and is noisy there"
    told_apart = "damping of the resonance itself; added-mass alone"
    symbol = "shaker"
    reference = "McConnell and Varoto (2008), chapter 7; Tomlinson (1979)"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each driven degree of freedom."""
        for dof in site.drive:
            columns = site.dofs[dof][:, None]
            laws = (Mass(), Dashpot(), Spring())
            scales = [site.scale(law, columns, np.zeros(1), 0) for law in laws]
            if not np.isfinite(scales).all():
                continue
            parameters = tuple(amount(law.names[0], law.units[0], s) for law, s in zip(laws, scales, strict=True))
            sizes = (0.01, 0.1, 0.5)
            starts = np.array([[m, c, k] for m in sizes for c in (0.003, 0.03) for k in sizes]) * np.array(scales)
            groups = tuple(Group(law, columns, i) for i, law in enumerate(laws))
            yield Term(self, Place("node", dof.split(":")[0]), parameters, starts, groups, dof.split(":")[1])
