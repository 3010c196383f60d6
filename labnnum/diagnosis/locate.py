"""Where the mismatch is, without a name: forces recovered at each place, and the apparent dynamic stiffness there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.evaluation import Evaluation
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.scatter import Data
from labnnum.mechanisms.base import Place, Term


@dataclass(frozen=True, eq=False)
class Recovered:
    """A force at a place that explains the residual, and what it says.

    `share` of the whitened residual that it removes; `stiffness` (n_f,) force over motion, negative: the apparent
    dynamic stiffness of what is missing, in N/m, with `error` its standard deviation.
    """

    place: Place
    variant: str
    share: float
    omega: NDArray[np.float64]
    stiffness: NDArray[np.complex128]
    error: NDArray[np.float64]


def recover(engine: Engine, data: Data, point: Point, term: Term) -> Recovered:
    r"""Force at the first motion of `term` that best explains data minus model at `point`.

    .. math:: \hat f = \frac{h^H \Sigma^{-1} r}{h^H \Sigma^{-1} h}, \quad
        E = \frac{\sum |h^H \Sigma^{-1} r|^2 / (h^H \Sigma^{-1} h)}{\sum r^H \Sigma^{-1} r}, \quad
        Z = -\hat f / (z_0 + G \hat f)

    With several inputs one dynamic stiffness is shared by all columns.
    """
    one = Evaluation(engine, replace(point, terms=np.zeros(term.n)), [term], data.s)
    k = term.columns.shape[1]
    x, h, z, g = one.ingredients(k)
    lift = one._lift()
    r = data.value - x * lift
    best: Recovered | None = None
    for c in range(k):
        hc = h[:, c][:, None, :] * lift
        w = 1.0 / data.sigma**2
        if z.shape[1] == 1:
            force = np.sum(np.conj(hc) * w * r, axis=0) / np.sum(np.abs(hc) ** 2 * w, axis=0)  # (i, f)
            explained = hc * force[None]
            motion = z[c] + g[c, c] * force
            stiffness = -(force / motion)[0]
            error = (1.0 / np.sqrt(np.sum(np.abs(hc) ** 2 * w, axis=0)) / np.abs(motion))[0]
        else:
            # r = -h t z with t = (1/Z + G)^-1 common to all inputs
            column = hc * z[c][None]
            size = np.sum(np.abs(column) ** 2 * w, axis=(0, 1))
            t = -np.sum(np.conj(column) * w * r, axis=(0, 1)) / size
            explained = -column * t
            stiffness = t / (1 - g[c, c] * t)
            error = np.abs(stiffness / t) ** 2 / np.sqrt(size)
        total = float(np.sum(w * np.abs(r) ** 2))
        share = 1.0 - float(np.sum(w * np.abs(r - explained) ** 2)) / total if total > 0 else 0.0
        made = Recovered(term.place, term.variant, share, data.s.imag, stiffness, error)
        if best is None or share > best.share:
            best = made
    assert best is not None
    return best


def channel_shares(data: Data, value: NDArray, names: list[str]) -> dict[Place, float]:
    """Share of the whitened residual that stands on each response channel alone."""
    w = np.abs(data.value - value) ** 2 / data.sigma**2
    rows = w.sum(axis=(1, 2))
    total = rows.sum()
    return {Place("channel", n): float(r / total) if total > 0 else 0.0 for n, r in zip(names, rows, strict=True)}
