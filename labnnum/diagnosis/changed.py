"""A structure's matrices with changes of the whole structure, their derivatives, and its modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, eigh, get_lapack_funcs

from labnnum.errors import ModelError
from labnnum.mechanisms.changes import Change, Freed


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
    changes: Sequence[tuple[Change, NDArray]], off: NDArray, nominal: NDArray,
) -> Changed:  # fmt: skip
    """M and K, their `slopes` to the structure's parameters, which are `off` nominal, with changes at their parameters;
    `nominal` is the mass there.
    """
    own = []
    for change, p in changes:
        own.append(change.derivatives(p, off))
        if not isinstance(change, Freed):
            more, stiffer = change.matrices(p, off)
            mass, stiffness = mass + more, stiffness + stiffer
            for j, (a, b) in enumerate(change.structure_derivatives(p, off)):
                slopes[j] = (slopes[j][0] + a, slopes[j][1] + b)
    if any(isinstance(c, Freed) for c, _ in changes):
        return _freed(mass, stiffness, slopes, own, changes, off, nominal)
    every = [*slopes, *(pair for part in own for pair in part)]
    return Changed(mass, stiffness, every, np.zeros((len(mass), 0)), np.zeros(0))


def _freed(
    mass: NDArray, stiffness: NDArray, slopes: list, own: list, changes: Sequence[tuple[Change, NDArray]],
    off: NDArray, nominal: NDArray,
) -> Changed:  # fmt: skip
    """With the held motions of supports let go: u = y + R q, so that mass that came to u loads y and q alike."""
    free = [c for c, _ in changes if isinstance(c, Freed)]
    static = np.hstack([c.static for c in free])
    n, d = static.shape
    spread = np.hstack([np.eye(n), static])

    def lifted(pair: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
        return spread.T @ pair[0] @ spread, np.pad(pair[1], (0, d))

    across = _across(free, nominal)
    more, stiffness = lifted((mass - nominal, stiffness))
    mass = np.pad(nominal, (0, d)) + more
    mass[n:, n:] += across[0]
    stiffness[n:, n:] -= across[1] * (static.T @ stiffness[:n, :n] @ static)
    slopes = [lifted(pair) for pair in slopes]
    for _, slope in slopes:
        slope[n:, n:] -= across[1] * (static.T @ slope[:n, :n] @ static)
    every, at = [], n
    for (change, p), part in zip(changes, own, strict=True):
        if not isinstance(change, Freed):
            every += [lifted(pair) for pair in part]
            continue
        here = slice(at, at + change.static.shape[1])
        at = here.stop
        mass[:n, here] += change.load
        mass[here, :n] += change.load.T
        for whole, share in zip((mass, stiffness), change.matrices(p, off), strict=True):
            whole[here, here] += share
        for pair, share in zip(slopes, change.structure_derivatives(p, off), strict=False):
            pair[1][here, here] += share[1]
        for _, slope in part:
            whole = np.zeros_like(stiffness)
            whole[here, here] = slope
            every.append((np.zeros_like(mass), whole))
    return Changed(mass, stiffness, [*slopes, *every], static, np.concatenate([c.own_load for c in free]))


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
