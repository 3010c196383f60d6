"""drift: a structure that changes while it is measured."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

from labnnum.mechanisms.base import Mechanism, Site, Term


@final
@dataclass(frozen=True)
class Drift(Mechanism):
    """k(t) = k (1 + d t / T): all stiffness changes by the fraction d over a session of length T."""

    id = "drift"
    title = "stiffness changes while it is measured"
    equation = "k(t) = k (1 + d t / T)"
    shows = "all natural frequencies move together, from period to period and from hit to hit"
    told_apart = "noise differs from period to period without direction"
    symbol = "clock"
    reference = "Pintelon and Schoukens (2012), chapter 6"

    def terms(self, site: Site) -> Iterable[Term]:
        """None: it is judged before the fit, see `labnnum.diagnosis.gates`."""
        return ()
