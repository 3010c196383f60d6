"""support-compliance: a clamp that gives."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS, Group, Mechanism, Place, Site, Term, scalar_term
from labnnum.mechanisms.geometry import cross_stiffness, dof_rows, support_columns
from labnnum.mechanisms.laws import Compliance, CompliancePair, Spring
from labnnum.parameters import Parameter


@final
@dataclass(frozen=True)
class SupportCompliance(Mechanism):
    """The clamped motion q gets a compliance c: Z -= K_fs c / (1 + c K_ss) K_sf."""

    id = "support-compliance"
    title = "clamp that gives"
    equation = "q = c f_support"
    shows = "all modes fall, the low ones most"
    told_apart = "an error of E or of the length moves all modes by one factor"
    symbol = "clamp with spring"
    reference = "Ewins (2000), section 5.7; Rixen (2004)"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each clamped axis of each support, or a changed stiffness where the support is elastic already."""
        for support in site.supports:
            place = Place("support", support)
            free = dof_rows(site, support)
            single: dict[str, tuple[np.ndarray, float, Term]] = {}
            for axis in TRANSLATIONS + ROTATIONS:
                turning = axis in ROTATIONS
                if axis in free:
                    unit = "N*m/rad" if turning else "N/m"
                    law = Spring(("stiffness",), (unit,))
                    term = scalar_term(
                        self, site, place, law, site.rows(support, (axis,)), positive=False, variant=axis
                    )
                else:
                    found = support_columns(site, support, axis)
                    if found is None:
                        continue
                    load, stiffness = found
                    unit = "rad/(N*m)" if turning else "m/N"
                    law = Compliance(stiffness, ("compliance",), (unit,))
                    term = scalar_term(self, site, place, law, (load / stiffness)[:, None], variant=axis)
                if term is not None:
                    yield term
                    if axis not in free:
                        single[axis] = (load, stiffness, term)
            yield from self._pairs(site, place, single)

    def _pairs(self, site: Site, place: Place, single: dict[str, tuple[np.ndarray, float, Term]]) -> Iterable[Term]:
        """A translation and a rotation that load the same motion give together."""
        for move in TRANSLATIONS:
            for turn in ROTATIONS:
                if move not in single or turn not in single:
                    continue
                (load_m, k_m, term_m), (load_t, k_t, term_t) = single[move], single[turn]
                across = cross_stiffness(site, place.id, turn, load_m)
                if abs(across) < 0.05 * np.sqrt(k_m * k_t) or across**2 > 0.999 * k_m * k_t:
                    continue
                law = CompliancePair(np.array([[k_m, across], [across, k_t]]))
                parameters = tuple(
                    Parameter(n, 0.0, 0.0, t.parameters[0].upper, u)
                    for n, u, t in zip(("compliance", "compliance_turn"), law.units, (term_m, term_t), strict=True)
                )
                starts = np.array([[a[0], b[0]] for a in term_m.starts[1:] for b in term_t.starts[1:]])
                columns = np.stack([load_m, load_t], axis=1)
                yield Term(self, place, parameters, starts, (Group(law, columns, 0),), f"{move} and {turn}")
