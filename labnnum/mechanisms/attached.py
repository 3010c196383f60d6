"""Terms of springs and masses as a part of the structure: the form in which a fit takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import Group, Place, Term
from labnnum.mechanisms.changes import Change, Freed
from labnnum.mechanisms.geometry import dof_rows, meets, with_support
from labnnum.mechanisms.laws import Compliance, Inertia, Mass, Spring

STEP = 1e-20
"""Imaginary part of the steps that give exact derivatives (Squire and Trapp, 1998)."""


@final
@dataclass(frozen=True, eq=False)
class Attached(Change):
    """Springs and masses on a few motions as a change of the structure's own matrices."""

    groups: tuple[Group, ...]
    place: Place

    def lifted(self, freed: Sequence[Freed]) -> Attached:
        """The same over y and the motions q of supports that were let go, u = y + R q: it acts on u."""
        return replace(self, groups=tuple(replace(g, columns=self._lifted(g.columns, freed)) for g in self.groups))

    def _lifted(self, columns: NDArray, freed: Sequence[Freed]) -> NDArray[np.float64]:
        rows = [columns]
        for c in freed:
            own = c.static.T @ columns
            if meets(self.place, c.support):
                other = str(self.place.id if c.support == self.place.to else self.place.to)
                at = dof_rows(c.site, other)
                own += [with_support(c.site.nodes, at, self.place, columns, c.support, a) for a in c.axes]
            rows.append(own)
        return np.vstack(rows)

    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """Share of M and K."""
        n = len(self.groups[0].columns)
        mass, stiffness = np.zeros((2, n, n), np.result_type(p, change, float))
        for g in self.groups:
            m, _, k, _ = g.law_at(change).local(p[g.first : g.first + len(g.law.names)])
            square = g.columns @ g.columns.T
            mass += m[0, 0] * square
            stiffness += k[0, 0] * square
        return mass, stiffness

    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """To each parameter."""
        return [self._slope(p + 1j * row, change) for row in STEP * np.eye(len(p))]

    def structure_derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """To each parameter of the structure, where the stiffness grows with what it acts on."""
        if all(g.gain is None or not len(g.gain) for g in self.groups):
            return []
        return [self._slope(p, change + 1j * row) for row in STEP * np.eye(len(change))]

    def _slope(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        mass, stiffness = self.matrices(p, change)
        return np.imag(mass) / STEP, np.imag(stiffness) / STEP


def in_structure(term: Term, *, floats: bool) -> Term:
    """The term with its `fitted` form where it is of springs and masses alone.

    Not of springs that hold a structure which `floats`: what were rigid-body motions would be modes of another kind.
    """
    if term.fitted is not term or not term.groups:
        return term
    elastic = all(isinstance(g.law, Mass | Inertia | Spring | Compliance) for g in term.groups)
    held = floats and term.place.kind in ("ground", "support") and not term.inertial.all()
    if elastic and not held and all(g.carried is None for g in term.groups):
        plain = Term(term.mechanism, term.place, term.parameters, term.starts, (), term.variant)
        plain.data.update(change=Attached(term.groups, term.place), sought=term)
        term.data["fitted"] = plain
    return term
