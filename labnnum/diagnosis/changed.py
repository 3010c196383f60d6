"""A structure's matrices with changes of the whole structure, their derivatives, and its modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, eigh, get_lapack_funcs

from labnnum.errors import ModelError
from labnnum.mechanisms.changes import Change, Freed
from labnnum.mechanisms.let_go import LetGo


@dataclass(frozen=True, eq=False)
class Changed:
    """M and K with changes, their derivatives, and the shapes and base loads of coordinates that were appended."""

    mass: NDArray
    stiffness: NDArray
    slopes: list[tuple[NDArray, NDArray]]
    """To the structure's parameters, then to each change's."""
    static: NDArray
    own_load: NDArray


def changed(
    mass: NDArray, stiffness: NDArray, slopes: list[tuple[NDArray, NDArray]],
    changes: Sequence[tuple[Change, NDArray]], off: NDArray, nominal: NDArray, gone: LetGo | None,
) -> Changed:  # fmt: skip
    """M and K, their `slopes` to the structure's parameters, which are `off` nominal, with changes at their parameters;
    `nominal` is the mass there; `gone` are the supports that changes let go.
    """
    static, own_load = np.zeros((len(mass), 0)), np.zeros(0)
    if gone is not None:
        static, own_load = np.hstack([c.static for c in gone.gone]), np.concatenate([c.own_load for c in gone.gone])
        mass, stiffness, slopes = _freed(mass, stiffness, slopes, gone.gone, nominal)
    every, at = [], len(stiffness) - static.shape[1]
    for change, p in changes:
        if isinstance(change, Freed):
            one: Change = OfSupport(change, at, len(stiffness))
            at += change.static.shape[1]
        else:
            one = change if gone is None else gone.change(change)
        more, stiffer = one.matrices(p, off)
        mass, stiffness = mass + more, stiffness + stiffer
        for j, (a, b) in enumerate(one.structure_derivatives(p, off)):
            slopes[j] = (slopes[j][0] + a, slopes[j][1] + b)
        every += one.derivatives(p, off)
    return Changed(mass, stiffness, [*slopes, *every], static, own_load)


@final
@dataclass(frozen=True, eq=False)
class OfSupport(Change):
    """What a support opposes to its motions q, and how their mass joins the others': coordinates from `at` of n."""

    freed: Freed
    at: int
    n: int

    def _placed(self, own: NDArray) -> NDArray[np.float64]:
        out = np.zeros((self.n, self.n), own.dtype)
        here = slice(self.at, self.at + len(own))
        out[here, here] = own
        return out

    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """Of all coordinates, (n, n) each."""
        mass, stiffness = (self._placed(m) for m in self.freed.matrices(p, change))
        load = self.freed.load
        here = slice(self.at, self.at + load.shape[1])
        mass[: len(load), here] += load
        mass[here, : len(load)] += load.T
        return mass, stiffness

    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """To each compliance."""
        return [(self._placed(a), self._placed(b)) for a, b in self.freed.derivatives(p, change)]

    def structure_derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """To each parameter of the structure."""
        return [(self._placed(a), self._placed(b)) for a, b in self.freed.structure_derivatives(p, change)]


def _freed(
    mass: NDArray, stiffness: NDArray, slopes: list, free: Sequence[Freed], nominal: NDArray
) -> tuple[NDArray, NDArray, list[tuple[NDArray, NDArray]]]:
    """The structure's own over y and q, u = y + R q: mass that came to u loads y and q alike; R is static, so that of
    the stiffness, in which parameters change all alike, nothing ties them.
    """
    static = np.hstack([c.static for c in free])
    n, d = static.shape
    spread = np.hstack([np.eye(n), static])

    def lifted(pair: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
        made = np.pad(pair[1], (0, d))
        made[n:, n:] -= across[1] * (static.T @ pair[1] @ static)
        return spread.T @ pair[0] @ spread, made

    across = _across(free, nominal)
    more, stiffness = lifted((mass - nominal, stiffness))
    mass = np.pad(nominal, (0, d)) + more
    mass[n:, n:] += across[0]
    return mass, stiffness, [lifted(pair) for pair in slopes]


def _across(free: Sequence[Freed], mass: NDArray) -> tuple[NDArray, NDArray]:
    """Mass between motions of different supports, (d, d), and ones where those stand: of each support the shapes R are
    with the others held, so that two are coupled by R1' L2 + L1' R2 - R1' M R2 and by -R1' K R2.
    """
    static, load = (np.hstack([getattr(c, k) for c in free]) for k in ("static", "load"))
    own = np.repeat(np.arange(len(free)), [c.static.shape[1] for c in free])
    apart = (own[:, None] != own[None, :]).astype(float)
    both = static.T @ load
    return apart * (both + both.T - static.T @ mass @ static), apart


(_WHOLE,) = get_lapack_funcs(("sygvd",), (np.zeros(1), np.zeros(1)))
"""What `eigh` calls for all modes, which spends as long again on what it is given."""


def eigen(
    mass: NDArray, stiffness: NDArray, theta: NDArray, n: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eigenvalues and vectors, of all modes or the first n, at the parameters `theta`."""
    try:
        if n is not None:
            return eigh(stiffness, mass, subset_by_index=[0, n - 1])
        value, own, failed = _WHOLE(stiffness, mass)
        if not failed:
            return value, own
    except LinAlgError:
        pass
    raise ModelError(f"the model is singular at parameters {np.array2string(theta, precision=4)}")
