"""What a structure is, in a few numbers: enough to refuse an updater that was trained on another one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ModelError
from labnnum.structures.base import Structure

_TOLERANCE = 1e-6


def fingerprint(structure: Structure) -> NDArray[np.float64]:
    """Numbers that change with the structure, its parameters and bounds, and stay under rounding.

    Quadratic forms of M, C, K and D at three parameter sets, with the bounds, shape (12 + 4 n_parameters,).
    """
    low, high = (np.array([getattr(p, side) for p in structure.parameters]) for side in ("lower", "upper"))
    numbers = []
    for share in (0.5, 0.2, 0.8):
        m = structure.matrices(low + share * (high - low))
        probe = np.cos(np.arange(m.M.shape[0]) * 1.3 + share)
        numbers += [float(probe @ a @ probe) for a in (m.M, m.C, m.K, m.D)]
    spread = [-1.0 if p.std is None else p.std for p in structure.parameters]
    return np.concatenate([numbers, structure.nominal, low, high, spread])


def require_same(structure: Structure, names: tuple[str, ...], stored: ArrayLike, what: str) -> None:
    """ModelError that says how `structure` differs from the one that `what` was trained on."""
    mine = tuple(p.name for p in structure.parameters)
    if mine != names:
        raise ModelError(
            f"{what} was trained for the parameters {', '.join(names)}; the model has {', '.join(mine)}: train again"
        )
    found, wanted = fingerprint(structure), np.asarray(stored, float)
    size = np.maximum(np.abs(wanted), np.abs(found))
    if found.shape != wanted.shape or not (np.abs(found - wanted) <= _TOLERANCE * size).all():
        raise ModelError(
            f"{what} was trained on another model: matrices, bounds or priors have changed since; train again with"
            " 'labnnum train'"
        )
