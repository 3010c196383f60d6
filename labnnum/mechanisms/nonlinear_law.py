"""A nonlinear law at a motion: what its mechanisms share."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError
from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS, Mechanism, Place, Site, Term
from labnnum.mechanisms.local_dashpot import relative
from labnnum.nonlinear import Element
from labnnum.parameters import Parameter


class NonlinearMechanism(Mechanism):
    """A force f(z, z') that opposes the motion z of a node against the ground, or of two neighbours.

    It has no dynamic stiffness: in a linear model it acts as nothing, in time and in harmonic balance as its law.
    """

    domain = "nonlinear"
    names: tuple[str, ...]
    units: tuple[str, ...]
    positive: bool = True
    sides: bool = False
    """Whether the law differs for the two senses of the motion; variants "-x" stand for the reversed one."""
    defaults: ClassVar[dict[str, float]] = {}
    """Parameters that a model file may leave out, with their values there."""
    whole: ClassVar[dict[str, tuple[int, int]]] = {}
    """Parameters that are whole numbers, with the least and the largest."""

    def terms(self, site: Site) -> Iterable[Term]:
        """Each translation of each node against the ground, each motion of neighbours against each other."""
        for node in site.free_nodes:
            for axis in TRANSLATIONS:
                column = site.rows(node, (axis,))
                if column.size:
                    yield from self._both(Place("ground", node), axis, column[:, 0])
        for a, b in site.elements:
            for axis in (*TRANSLATIONS, *ROTATIONS):
                column = between(site, a, b, axis)
                if column is not None:
                    yield from self._both(Place("joint", a, b), axis, column[:, 0])

    def _both(self, place: Place, axis: str, column: NDArray) -> Iterable[Term]:
        yield self.term(place, axis, column)
        if self.sides:
            yield self.term(place, "-" + axis, -column)

    def term(self, place: Place, variant: str, column: NDArray) -> Term:
        """The law at one motion; on an angle its parameters are those of a moment."""
        low = 0.0 if self.positive else -np.inf
        turned = variant.lstrip("-") in ROTATIONS
        parameters = tuple(
            Parameter(n, 0.0, low if i == 0 else 0.0, np.inf, of_angle(u) if turned else u)
            for i, (n, u) in enumerate(zip(self.names, self.units, strict=True))
        )
        starts = np.zeros((0, len(parameters)))
        return Term(self, place, parameters, starts, variant=variant, data={"column": column})

    def at(self, site: Site, place: Place, variant: str) -> Term:
        """The law at a place of the structure of `site`; ConfigError if it has no such motion."""
        axis = variant.lstrip("-")
        if not axis:
            raise ConfigError(
                f"mechanism {self.id!r} at {place}: key variant is missing; it gives the direction of the motion, one"
                " of x, y, z, rx, ry, rz, with a leading minus where a stop is on the other side"
            )
        sign = -1.0 if variant.startswith("-") else 1.0
        if place.to is None:
            found = site.rows(place.id, (axis,))
            column = found if found.size else None
        else:
            column = between(site, place.id, place.to, axis)
        if column is None:
            raise ConfigError(f"mechanism {self.id!r} cannot act at {place} along {axis!r}: there is no such motion")
        return self.term(place, variant, sign * column[:, 0])

    def elements(self, term: Term, p: Sequence[float]) -> tuple[Element, ...]:
        """The law of a term for `labnnum.nonlinear`, in its words: elements that act side by side."""
        law = {"coulomb-friction": "coulomb"}.get(self.id, self.id)
        values = tuple(float(v) for v in p)
        return (Element(law.removesuffix("-stiffness"), np.asarray(term.data["column"], float), values),)

    def sense(self, term: Term, p: NDArray) -> str | None:
        """Hardening or softening where the sign of the first parameter says so."""
        if self.positive:
            return None
        return "hardening" if p[0] > 0 else "softening"


def less_spring(column: NDArray, spring: float) -> tuple[Element, ...]:
    """What takes a spring off that the structure holds already; nothing where it holds none."""
    return (Element("clearance", column, (-spring, 0.0)),) if spring else ()


def of_angle(unit: str) -> str:
    """Unit of a law on an angle, from that of the same law on a motion.

    >>> of_angle("N*s^2/m^2")
    'N*m*s^2/rad^2'
    """
    return re.sub(r"\b(N|m)\b", lambda found: {"N": "N*m", "m": "rad"}[found[0]], unit)


def between(site: Site, a: str, b: str, axis: str) -> NDArray[np.float64] | None:
    """Column, shape (n, 1), of the motion of b less that of a, also where coordinates are modal."""
    column = relative(site, a, b, axis)
    if column is None and f"{a}:{axis}" in site.dofs and f"{b}:{axis}" in site.dofs:
        column = (site.dofs[f"{b}:{axis}"] - site.dofs[f"{a}:{axis}"])[:, None]
    return column
