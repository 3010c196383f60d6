"""What a nonlinear law looks like to the diagnosis: its parameters and where a search over them starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.march import CODES, LAWS, N_P, along


@dataclass(frozen=True, slots=True)
class LawShape:
    """A law for regression and fit.

    `linear`: number of leading parameters that the force is linear in. `positive`: whether those must be positive.
    `inner`: grids of the others, relative to the largest motion (a length), to the slip motion, or as they are.
    """

    law: str
    linear: int
    positive: bool
    inner: tuple[str, ...] = ()

    @property
    def code(self) -> int:
        """Number of the law in the march."""
        return CODES[self.law]

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters."""
        return LAWS[self.law]


SHAPES: dict[str, LawShape] = {
    "cubic-stiffness": LawShape("cubic", 1, False),
    "quadratic-stiffness": LawShape("quadratic", 1, False),
    "one-sided-gap": LawShape("one-sided-gap", 1, True, ("length",)),
    "clearance": LawShape("clearance", 1, True, ("length",)),
    "coulomb-friction": LawShape("coulomb", 1, True),
    "quadratic-damping": LawShape("quadratic-damping", 1, True),
    "stick-slip": LawShape("stick-slip", 1, True, ("slip",)),
    "hysteresis": LawShape("hysteresis", 1, True, ("length", "power", "share")),
    "general": LawShape("general", 10, False),
}
"""Mechanism id -> law."""

FRACTIONS = np.array([0.0, 0.03, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.92])
"""Gaps and slip motions that are tried, of the largest motion."""


def candidates(shape: LawShape, top: float) -> NDArray[np.float64]:
    """Parameters (n, N_P) of unit strength to try where the motion reaches `top`."""
    rows = []
    if not shape.inner:
        row = np.zeros(N_P)
        row[0] = 1.0
        rows.append(row)
    for fraction in FRACTIONS if shape.inner else ():
        if fraction == 0.0 and shape.law != "one-sided-gap":
            continue
        row = np.zeros(N_P)
        row[0] = 1.0
        row[1] = fraction * top
        if shape.law == "hysteresis":
            row[2], row[3] = 1.5, 0.5
        rows.append(row)
    return np.array(rows)


def force_along(shape: LawShape, z: NDArray, v: NDArray, p: NDArray, around: bool = True) -> NDArray[np.float64]:
    """Opposing force along a motion z, v (n,), which comes around again or begins at rest."""
    turns = 2 if around and shape.law in ("stick-slip", "hysteresis") else 1
    return along(shape.code, np.ascontiguousarray(z), np.ascontiguousarray(v), np.ascontiguousarray(p), turns)


def general_basis(z: NDArray, v: NDArray) -> NDArray[np.float64]:
    """z|z|, z^2, z^3, z^5, v|v|, v^3, z^2 v, |z| v, z v, v^2 z: a smooth law without memory, shape (10, n)."""
    az, av = np.abs(z), np.abs(v)
    return np.array([z * az, z * z, z**3, z**5, v * av, v**3, z * z * v, az * v, z * v, v * v * z])
