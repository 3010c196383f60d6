"""Changes of the whole structure's matrices: what acts everywhere, and supports that let go."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.laws import Release

if TYPE_CHECKING:
    from labnnum.mechanisms.base import Site


class Change(ABC):
    """A change of the whole structure's matrices: what acts everywhere is taken to the modes, not to attachments."""

    @abstractmethod
    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """Change of M and K, each (n, n), at the term's parameters p, the structure's off nominal by `change`."""

    @abstractmethod
    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """Its derivative to each parameter of the term."""

    def structure_derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """Its derivative to each parameter of the structure; empty where there is none."""
        return []

    def again(self, site: Site) -> Change | None:
        """The same change of another structure that holds the same elements; None where it has no such form."""
        return None


@dataclass(frozen=True, eq=False)
class Over(Change):
    """A change of the motions T u as one of the motions u: T' M T and T' K T."""

    change: Change
    spread: NDArray[np.float64]
    """T, (n, n_u)."""

    stiffness: bool = True
    """Whether the stiffness is taken so; else that of the first n motions is left as it is, and has no part in others.
    """

    def _taken(self, pair: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
        mass, stiffness = pair
        t = self.spread
        beyond = t.shape[1] - t.shape[0]
        return t.T @ mass @ t, t.T @ stiffness @ t if self.stiffness else np.pad(stiffness, (0, beyond))

    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """Change of M and K, (n_u, n_u) each."""
        return self._taken(self.change.matrices(p, change))

    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """Of those, to each parameter of the term."""
        return [self._taken(pair) for pair in self.change.derivatives(p, change)]

    def structure_derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """Of those, to each parameter of the structure."""
        return [self._taken(pair) for pair in self.change.structure_derivatives(p, change)]


@dataclass(frozen=True, eq=False)
class Freed(Change):
    """Motions q, `axes`, that `support` holds let go: coordinates appended to the structure's, u = y + `static` q.

    `load`, (n, d), couples q to y through mass; `own_load`, (d,), is what base motion loads q with beyond load' r;
    `gain`, (n_theta,), the relative change of the stiffness against q with each parameter of the structure.
    """

    law: Release
    site: Site
    support: str
    axes: tuple[str, ...]
    static: NDArray[np.float64]
    load: NDArray[np.float64]
    own_load: NDArray[np.float64]
    gain: NDArray[np.float64]

    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """M and K of the appended coordinates, (d, d) each."""
        factor = 1.0 + self.gain @ change if len(self.gain) else 1.0
        mass = self.law.mass + 1e-9 * np.diag(np.diag(self.law.mass))  # of a lumped model q may have none of its own
        return mass, factor * self.law.stiffness + np.diag(self.law.held(p)[0])

    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """Of those, to each compliance."""
        zero = np.zeros_like(self.law.mass)
        return [(zero, np.diag(row)) for row in np.diag(self.law.held(p)[1])]

    def structure_derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """Of those, to each parameter of the structure."""
        return [(np.zeros_like(self.law.mass), g * self.law.stiffness) for g in self.gain]
