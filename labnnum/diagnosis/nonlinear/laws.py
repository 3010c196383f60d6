"""What a nonlinear law looks like to the diagnosis: its parameters and where a search over them starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.force import CODES, LAWS, N_P
from labnnum.diagnosis.nonlinear.prescribed import along


@dataclass(frozen=True, slots=True)
class LawShape:
    """A law for regression and fit.

    `linear`: number of leading parameters that the force is linear in. `positive`: whether those must be positive.
    `inner`: grids of the others, relative to the largest motion (a length), to the slip motion, or as they are.
    """

    law: str
    linear: int
    positive: bool
    grows: tuple[int, ...]
    """Powers with which each parameter grows where the motion is read larger and the force smaller by one factor, which
    leaves what the law does to the structure as it was."""
    inner: tuple[str, ...] = ()
    shaped: tuple[float, ...] = ()
    """Where those begin, and about where they are expected, that only shape a loop."""
    within: tuple[tuple[float, float], ...] = ()
    """Bounds of these."""

    @property
    def code(self) -> int:
        """Number of the law in the march."""
        return CODES[self.law]

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters."""
        return LAWS[self.law]


PASSIVE = 0.5
"""Share of beta in a hysteretic law from which on no loop of it returns more than it took (Erlicher and Point 2004:
gamma between -beta and beta); far below, the law is no loop but a spring that softens."""
ELASTIC = 1.7
"""The same of a loop that stiffens, up to which it loses enough to be told from a hardening spring; with two it loses
nothing.
"""

SHAPES: dict[str, LawShape] = {
    "cubic-stiffness": LawShape("cubic", 1, False, (-4,)),
    "quadratic-stiffness": LawShape("quadratic", 1, False, (-3,)),
    "one-sided-gap": LawShape("one-sided-gap", 1, True, (-2, 1), ("length",)),
    "clearance": LawShape("clearance", 1, True, (-2, 1), ("length",)),
    "coulomb-friction": LawShape("coulomb", 1, True, (-1,)),
    "quadratic-damping": LawShape("quadratic-damping", 1, True, (-3,)),
    "stick-slip": LawShape("stick-slip", 1, True, (-2, -1), ("slip",)),
    "hysteresis": LawShape(
        "hysteresis", 1, True, (-2, 1, 0, 0), ("length", "power", "share"), (1.5, 0.5), ((0.6, 6.0), (PASSIVE, 1.0))
    ),
    "stiffening": LawShape(
        "hysteresis", 1, True, (-2, 1, 0, 0), ("length", "power", "share"), (1.0, 1.5), ((0.6, 6.0), (1.0, ELASTIC))
    ),
    "general": LawShape("general", 10, False, (-3, -3, -4, -6, -3, -4, -4, -3, -3, -4)),
    "sliders": LawShape("sliders", 1, True, (-2, -1, 0), ("slip", "share")),
}
"""Mechanism id, `sliders` for a stick-slip whose limits are spread, or `stiffening` for hysteresis of the classes in
which the two shares of its loop have opposite signs, which no slider comes near -> law."""
NAMES = {"sliders": "stick-slip", "stiffening": "hysteresis"}
"""Mechanism that a law is named by, where that is not its own."""


def form_of(mechanism: str, p: NDArray) -> str:
    """The law that a mechanism with the parameters `p` is."""
    if mechanism == "stick-slip" and p[2]:
        return "sliders"
    return "stiffening" if mechanism == "hysteresis" and p[3] > 1.0 else mechanism


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
        row[2 : 2 + len(shape.shaped)] = shape.shaped
        rows.append(row)
    return np.array(rows)


def force_along(shape: LawShape, z: NDArray, v: NDArray, p: NDArray, around: bool = True) -> NDArray[np.float64]:
    """Opposing force along a motion z, v (n,), which comes around again or begins at rest."""
    quick = _without_memory(shape.law, z, v, p)
    if quick is not None:
        return quick
    turns = 2 if around and shape.law in ("stick-slip", "sliders", "hysteresis") else 1
    return along(shape.code, np.ascontiguousarray(z), np.ascontiguousarray(v), np.ascontiguousarray(p), turns)


def _without_memory(law: str, z: NDArray, v: NDArray, p: NDArray) -> NDArray[np.float64] | None:
    """Forces of the laws that follow from motion and speed alone, all samples at once; None for others."""
    if law == "cubic":
        return p[0] * z * z * z
    if law == "quadratic":
        return p[0] * z * z
    if law == "quadratic-damping":
        return p[0] * v * np.abs(v)
    if law == "one-sided-gap":
        return p[0] * np.maximum(z - p[1], 0.0)
    if law == "clearance":
        return p[0] * (z - np.clip(z, -p[1], p[1]))
    if law == "general":
        out = np.zeros_like(z)
        for i in np.flatnonzero(p):
            out += p[i] * TERMS[i](z, v)
        return out
    return None


TERMS: tuple[Callable[[NDArray, NDArray], NDArray], ...] = (
    lambda z, v: z * np.abs(z),
    lambda z, v: z * z,
    lambda z, v: z * z * z,
    lambda z, v: (z * z) ** 2 * z,
    lambda z, v: v * np.abs(v),
    lambda z, v: v * v * v,
    lambda z, v: z * z * v,
    lambda z, v: np.abs(z) * v,
    lambda z, v: z * v,
    lambda z, v: v * v * z,
)
"""Terms of the general law."""


def general_basis(z: NDArray, v: NDArray) -> NDArray[np.float64]:
    """z|z|, z^2, z^3, z^5, v|v|, v^3, z^2 v, |z| v, z v, v^2 z: a smooth law without memory, shape (10, n)."""
    return np.array([term(z, v) for term in TERMS])
