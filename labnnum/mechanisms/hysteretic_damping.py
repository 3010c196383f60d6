"""hysteretic-damping: a loss that does not depend on frequency, of an element or of the whole structure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import Mechanism, Place, Site, Term, scalar_term
from labnnum.mechanisms.geometry import element_gain, element_stiffness, factors
from labnnum.mechanisms.laws import LossySpring


@final
@dataclass(frozen=True)
class HystereticDamping(Mechanism):
    """Z += i eta K_e, or i eta K."""

    id = "hysteretic-damping"
    title = "lossy element (hysteretic damping)"
    equation = "f = i eta K_e u"
    shows = "a loss that is flat in frequency"
    told_apart = "viscous damping grows with frequency: it takes several modes to tell"
    symbol = "hatched element"
    reference = "Nashif, Jones and Henderson (1985), chapter 2"

    def terms(self, site: Site) -> Iterable[Term]:
        """The loss factor of the whole structure, then of each element."""
        law = LossySpring(("loss_factor",), ("1",))
        modal = site.mass @ site.shape * site.omega
        whole = scalar_term(self, site, Place("global", "structure"), law, modal, variant="structure")
        if whole is not None:
            yield whole
        for a, b in site.elements:
            found = element_stiffness(site, a, b)
            if found is None:
                continue
            index, k, _ = found
            columns = np.zeros((site.stiffness.shape[0], factors(k).shape[1]))
            columns[index] = factors(k)
            term = scalar_term(self, site, Place("element", a, b), law, columns, gain=element_gain(site, a, b))
            if term is not None:
                yield term
