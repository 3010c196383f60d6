"""Symmetric elimination without pivoting, vectorised over parameter sets and lines, for small sparse structures.

Every number of the factorisation is an array over (sets, lines). What does not depend on the parameters stays an
array over lines alone until it meets something that does, and is eliminated first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Cell = Callable[[int, int], NDArray]
"""Row, column (row >= column) -> entry of Z, broadcastable to (n_sets, n_lines)."""


@dataclass(frozen=True, eq=False)
class Elimination:
    """Order and fill of the elimination of one sparsity pattern.

    Parameters
    ----------
    order : tuple of int
        Coordinates in the order of elimination.
    below : tuple of tuple of int
        For each eliminated coordinate the later ones that it is joined to, fill included.
    own : frozenset of (row, column)
        Entries that Z has from the start, by coordinate, row >= column.
    """

    order: tuple[int, ...]
    below: tuple[tuple[int, ...], ...]
    own: frozenset[tuple[int, int]]

    @classmethod
    def of(cls, size: int, entries: frozenset[tuple[int, int]], late: frozenset[int]) -> Elimination:
        """Smallest degree first, with the coordinates of `late` after all others."""
        joined: dict[int, set[int]] = {i: set() for i in range(size)}
        for i, j in entries:
            if i != j:
                joined[i].add(j)
                joined[j].add(i)
        order, below, left = [], [], set(range(size))
        while left:
            early = (left - late) or left
            pick = min(early, key=lambda i: (len(joined[i]), i))
            near = joined.pop(pick)
            order.append(pick)
            below.append(tuple(sorted(near)))
            left.discard(pick)
            for i in near:
                joined[i] |= near
                joined[i] -= {i, pick}
        return cls(tuple(order), tuple(below), entries)

    def factor(self, cell: Cell) -> Factors:
        """L D L^T of Z, each entry an array."""
        work: dict[tuple[int, int], NDArray] = {}

        def take(i: int, j: int) -> NDArray | float:
            key = (i, j) if i >= j else (j, i)
            if key in work:
                return work[key]
            return cell(*key) if key in self.own else 0.0

        inverse, lower = {}, {}
        for pick, near in zip(self.order, self.below, strict=True):
            inverse[pick] = 1 / np.asarray(take(pick, pick))
            column = {i: take(i, pick) for i in near}
            scaled = {i: v * inverse[pick] for i, v in column.items()}
            for a, i in enumerate(near):
                for j in near[: a + 1]:
                    work[i, j] = take(i, j) - scaled[i] * column[j]
            lower[pick] = scaled
            work.pop((pick, pick), None)
        return Factors(self, inverse, lower)


@dataclass(frozen=True, eq=False)
class Factors:
    """A factorised Z: solves for loads."""

    plan: Elimination
    inverse: dict[int, NDArray]
    lower: dict[int, dict[int, NDArray]]

    def solve(self, load: dict[int, NDArray | float], wanted: frozenset[int]) -> dict[int, NDArray]:
        """Responses of the coordinates `wanted` (at least) to a load given by coordinate."""
        x: dict[int, NDArray | float] = dict(load)
        for pick in self.plan.order:
            if pick in x:
                for i, factor in self.lower[pick].items():
                    x[i] = x.get(i, 0.0) - factor * x[pick]
        needed = self._needed(wanted)
        out: dict[int, NDArray] = {}
        for pick in reversed(self.plan.order):
            if pick not in needed:
                continue
            value = x[pick] * self.inverse[pick] if pick in x else 0.0
            for i, factor in self.lower[pick].items():
                value = value - factor * out[i]
            out[pick] = np.asarray(value)
        return out

    def _needed(self, wanted: frozenset[int]) -> set[int]:
        """Coordinates that back substitution has to visit for the wanted ones."""
        needed = set(wanted)
        for pick in self.plan.order:
            if pick in needed:
                needed.update(self.lower[pick])
        return needed
