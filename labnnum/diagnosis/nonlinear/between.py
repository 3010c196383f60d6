"""What damping between the modes of the base model adds to its receptances, and to their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.coupling import Coupled


@dataclass(frozen=True, eq=False)
class Between:
    """Motions of coupled modes, (k_c, n, f), by unit forces at n places: `together`, and `alone` each on its own.

    A receptance between two places is the sum over modes of one's participation and the other's motion; what coupling
    adds to it is made of the difference.
    """

    modes: NDArray[np.int64]
    shared: Coupled
    s: NDArray[np.complex128]
    d: NDArray[np.complex128]
    together: NDArray[np.complex128]
    alone: NDArray[np.complex128]

    @classmethod
    def of(cls, modes: NDArray, shared: Coupled, d: NDArray, s: NDArray, places: NDArray) -> Between:
        """With modal receptances `d` (m, f) on lines `s` (f,), of participations `places` (m, n)."""
        own, alone = d[modes], d[modes][:, None] * places[modes][..., None]
        loop = np.eye(modes.size) + own.T[:, :, None] * shared.damping * s[:, None, None]
        together = np.moveaxis(np.linalg.solve(loop, np.moveaxis(alone, 2, 0)), 0, 2)
        return cls(modes, shared, s, own, together, alone)

    def added(self, places: NDArray) -> NDArray[np.complex128]:
        """To receptances from the n places to those of participations `places` (m, l): (l, n, f)."""
        return np.einsum("cl,cnf->lnf", places[self.modes], self.together - self.alone, optimize=True)

    def by_places(self, moved: NDArray, right: Between) -> NDArray[np.complex128]:
        """Derivative of what is added between the places here and those of `right`, (n, r, f), where participations
        here change by `moved` (m, n).
        """
        return np.einsum("cn,crf->nrf", moved[self.modes], right.together - right.alone, optimize=True)

    def by_receptance(self, dd: NDArray, right: Between) -> NDArray[np.complex128]:
        """The same where modal receptances change by `dd` (m, f)."""
        own = dd[self.modes]
        some = np.flatnonzero(own.any(axis=1))
        if not some.size:
            return np.zeros((self.alone.shape[1], right.alone.shape[1], self.s.size), complex)
        safe = np.where(self.d[some] == 0.0, np.inf, self.d[some])
        factor = own[some] / safe**2
        both = np.einsum("cf,cnf,crf->nrf", factor, self.together[some], right.together[some], optimize=True)
        return both - np.einsum("cf,cnf,crf->nrf", factor, self.alone[some], right.alone[some], optimize=True)

    def by_damping(self, change: NDArray, right: Between) -> NDArray[np.complex128]:
        """The same where the damping between modes changes by `change` (k_c, k_c)."""
        pushed = np.einsum("cd,drf->crf", change, right.together, optimize=True) * self.s
        return -np.einsum("cnf,crf->nrf", self.together, pushed, optimize=True)

    def eased(self, rates: NDArray) -> NDArray[np.float64]:
        """Change (k_c, k_c) of the damping between modes with logarithms `rates` (k_c,) of their own damping."""
        return 0.5 * self.shared.damping * (rates[:, None] + rates)

    def of_some(self, which: slice) -> Between:
        """Of some of the places."""
        return replace(self, together=self.together[:, which], alone=self.alone[:, which])


Moved = tuple[NDArray | None, NDArray | None, NDArray | None]
"""Changes of participations of the outputs (m, o), of the input (m, 1) and of the places (m, k); None where none."""


@dataclass(frozen=True, eq=False)
class Among:
    """Coupled motions by the outputs, the input and the places, for derivatives of the receptances between them."""

    parts: tuple[Between, Between, Between]
    pairs: tuple[tuple[int, int], ...]
    """Which receptances are wanted: of plain, h, z and g, as numbers of two of the parts."""

    @classmethod
    def of(
        cls, modes: NDArray, shared: Coupled, d: NDArray, s: NDArray, places: tuple[NDArray, NDArray, NDArray],
        pairs: tuple[tuple[int, int], ...],
    ) -> Among:  # fmt: skip
        """With participations `places`, (m, o), (m, 1) and (m, k)."""
        whole = Between.of(modes, shared, d, s, np.hstack(places))
        ends = np.cumsum([0, *(p.shape[1] for p in places)])
        out, load, at = (whole.of_some(slice(a, b)) for a, b in pairwise(ends))
        return cls((out, load, at), pairs)

    @property
    def one(self) -> Between:
        """Any of them."""
        return self.parts[0]

    def slopes(
        self, moved: Moved = (None, None, None), dd: NDArray | None = None, damping: NDArray | None = None
    ) -> list[NDArray[np.complex128]]:  # fmt: skip
        """Derivatives of what coupling adds to each wanted receptance, (l, r, f), where participations, modal
        receptances (m, f) and the damping between modes (k_c, k_c) change so.
        """
        out = []
        for a, b in self.pairs:
            left, right = self.parts[a], self.parts[b]
            change = np.zeros((left.alone.shape[1], right.alone.shape[1], left.s.size), complex)
            if (mine := moved[a]) is not None:
                change += left.by_places(mine, right)
            if (theirs := moved[b]) is not None:
                change += np.swapaxes(right.by_places(theirs, left), 0, 1)
            if dd is not None:
                change += left.by_receptance(dd, right)
            if damping is not None and damping.any():
                change += left.by_damping(damping, right)
            out.append(change)
        return out
