"""Supports that were let go, and how all else in a model moves with them.

The motions u of the structure are y + R q: q, what the supports held, carries the static shapes R along. Whatever acts
on u therefore acts on y and q alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.attached import Attached
from labnnum.mechanisms.base import Place, Site
from labnnum.mechanisms.changes import Change, Freed, Over
from labnnum.mechanisms.geometry import AXES, meets, with_support
from labnnum.mechanisms.site import site_of
from labnnum.structures.base import Matrices, Structure


@final
@dataclass(frozen=True, eq=False)
class LetGo:
    """The structure `inner` over y (n,) and the motions q (d,) of the supports that were let go."""

    inner: Structure
    free: Structure
    """The inner structure without these supports; its coordinates are u and all that they held."""

    held: tuple[tuple[str, str], ...]
    """Support and axis of each q."""

    spread: NDArray[np.float64]
    """T, (n_free, n + d): motions of the free structure from y and q."""

    gone: tuple[Freed, ...]

    _lifted: dict[int, tuple[Change, Change]] = field(default_factory=dict)

    @classmethod
    def of(cls, inner: Structure, gone: Sequence[Freed]) -> LetGo | None:
        """What is `gone` of the structure's supports; None where all hold."""
        if not gone:
            return None
        free = inner
        for support in dict.fromkeys(c.support for c in gone):
            free = free.released(support) or free
        held = tuple((c.support, axis) for c in gone for axis in c.axes)
        nominal = inner.nominal
        supports = {s for s, _ in held}
        extra = [d for d in free.dofs if d.partition(":")[0] in supports and d not in inner.dofs]
        at = {d: int(np.argmax(np.abs(np.real(free.participation(d, nominal))))) for d in extra}
        size = len(free.matrices(nominal).M)
        rest = np.setdiff1d(np.arange(size), list(at.values()))
        static = np.hstack([c.static for c in gone])
        spread = np.zeros((size, rest.size + len(held)))
        spread[rest, np.arange(rest.size)] = 1.0
        spread[rest, rest.size :] = static
        for i, (support, axis) in enumerate(held):
            spread[at[f"{support}:{axis}"], rest.size + i] = 1.0
        return cls(inner, free, held, spread, tuple(gone))

    @property
    def n(self) -> int:
        """Number of coordinates of the inner structure."""
        return self.spread.shape[1] - len(self.held)

    @cached_property
    def _static(self) -> NDArray[np.float64]:
        return self.spread[np.any(self.spread[:, : self.n] != 0, axis=1), self.n :]

    def _taken(self, matrix: NDArray) -> NDArray:
        return self.spread.T @ matrix @ self.spread

    @cached_property
    def _nominal(self) -> tuple[NDArray, NDArray]:
        """Stiffness of the free structure, and the same over y and q: nothing ties them, as R is static."""
        free = np.real(self.free.matrices(self.inner.nominal).K)
        whole, n = self._taken(free), self.n
        whole[:n, n:] = whole[n:, :n] = 0.0
        size = np.sqrt(np.abs([free[i, i] for i in self._rows]))
        own = whole[n:, n:]
        own[np.abs(own) < 1e-7 * np.outer(size, size)] = 0.0  # free of others, a support moves the whole as a body
        return free, whole

    @cached_property
    def _rows(self) -> NDArray[np.intp]:
        """Coordinate of each q in the free structure."""
        moved = np.where(np.any(self.spread[:, : self.n] != 0, axis=1)[:, None], 0.0, self.spread[:, self.n :])
        return np.argmax(moved, axis=0)

    def matrices(self, theta: NDArray) -> tuple[NDArray, NDArray]:
        """M and K over y and q, (n + d, n + d), without the springs that the supports became."""
        made: Matrices = self.free.matrices(theta)
        free, nominal = self._nominal
        return self._taken(made.M), nominal + self._taken(made.K - free)

    def held_load(self, theta: NDArray) -> NDArray:
        """Mass, (n + d,), by which base motion of all that supports hold or held loads y and q."""
        moved = np.array(self.free.rigid(theta))
        moved[np.any(self.spread[:, : self.n] != 0, axis=1)] = 0.0
        return self.spread.T @ (self.free.matrices(theta).M @ moved + self.free.held_load(theta))

    def lifted(self, place: Place, columns: NDArray) -> NDArray[np.float64]:
        """Columns over y and q, (n + d, k), of those over u, (n, k), of something that acts at `place`."""
        if place.kind in ("global", "system"):  # what acts on the strain of all: R is static, and has no part in it
            return np.vstack([columns, np.zeros((len(self.held), columns.shape[1]))])
        return np.vstack([columns, self._static.T @ columns + self._at_support(place, columns)])

    def _at_support(self, place: Place, columns: NDArray) -> NDArray[np.float64]:
        """What columns (n, k) between a node and a support have at the support's own motions, (d, k)."""
        out = np.zeros((len(self.held), columns.shape[1]))
        for i, (support, axis) in enumerate(self.held):
            if meets(place, support):
                rows = self._numbers(str(place.id if support == place.to else place.to))
                out[i] = with_support(self.inner.nodes, rows, place, columns, support, axis)
        return out

    def _numbers(self, node: str) -> dict[str, int]:
        """Direction -> coordinate of the inner structure, of a node's single coordinates."""
        out = {}
        for dof in self.inner.dofs:
            name, _, axis = dof.partition(":")
            row = np.real(self.inner.participation(dof, self.inner.nominal)) if name == node and axis in AXES else None
            if row is not None and np.count_nonzero(row) == 1 and row.max() == 1:
                out[axis] = int(np.argmax(row))
        return out

    def change(self, one: Change) -> Change:
        """What a change of the structure is over y and q: of the free structure, if it has such a form."""
        if id(one) not in self._lifted:
            self._lifted[id(one)] = (one, self._over(one))  # holding it keeps its identity from being used again
        return self._lifted[id(one)][1]

    def _over(self, one: Change) -> Change:
        if isinstance(one, Attached):
            return one.lifted(self.gone)
        free = one.again(self._site)
        if free is not None:
            return Over(free, self.spread)
        return Over(one, np.hstack([np.eye(self.n), self._static]), stiffness=False)

    @cached_property
    def _site(self) -> Site:
        return site_of(self.free, held=False)
