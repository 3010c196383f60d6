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
    lift = one.lift
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


ROUGHLY = 0.03
"""Relative error of a model whose ordinary errors are not fitted, in the forces that are recovered with it."""


def imitated(engine: Engine, data: Data, point: Point, law: Term) -> tuple[float, NDArray[np.float64]]:
    """How closely a law that is linear in its parameters can do what data minus model at `point` asks for at its place,
    as a share of the whitened residual, and the parameters with which it does.

    Forces are recovered line by line, the motion that they leave follows, and the parameters from both by least
    squares: with force and motion known a law of any size is linear.
    """
    one = Evaluation(engine, replace(point, terms=np.zeros(law.n)), [law], data.s)
    x, h, z, g = one.ingredients(law.width)
    lift = one.lift
    weight = 1.0 / np.hypot(data.sigma, ROUGHLY * np.abs(data.value))
    r = np.moveaxis((data.value - x * lift) * weight, 2, 0)  # (f, o, i)
    a = np.transpose(h[:, :, None] * (lift * weight)[:, None], (3, 2, 0, 1))  # (f, i, o, k)
    y = np.swapaxes(r, 1, 2)[..., None]
    turned = np.conj(np.swapaxes(a, 2, 3))
    gram = turned @ a
    ridge = 1e-9 * np.trace(gram, axis1=2, axis2=3)[..., None, None] * np.eye(law.width) + 1e-300 * np.eye(law.width)
    force = np.linalg.solve(gram + ridge, turned @ y)
    motion = np.transpose(z, (2, 1, 0))[..., None] + np.moveaxis(g, 2, 0)[:, None] @ force  # (f, i, k, 1)
    slopes = law.stiffness_derivative(data.s, np.zeros(law.n))  # (n, k, k, f)
    push = -np.einsum("nkjf,fij->fikn", slopes, motion[..., 0])
    columns = (a @ push).reshape(-1, law.n)
    wanted = (a @ force).reshape(-1)
    columns, wanted = np.vstack([columns.real, columns.imag]), np.concatenate([wanted.real, wanted.imag])
    size = np.maximum(np.sqrt(np.sum(columns**2, axis=0)), 1e-300)
    p = np.linalg.lstsq(columns / size, wanted, rcond=1e-4)[0] / size
    total = float(np.sum(np.abs(r) ** 2))
    left = total - float(np.sum(wanted**2) - np.sum((wanted - columns @ p) ** 2))
    low, high = [q.lower for q in law.parameters], [q.upper for q in law.parameters]
    return (1.0 - left / total if total > 0 else 0.0), np.clip(p, low, high)


def channel_shares(data: Data, value: NDArray, names: list[str]) -> dict[Place, float]:
    """Share of the whitened residual that stands on each response channel alone."""
    w = np.abs(data.value - value) ** 2 / data.sigma**2
    rows = w.sum(axis=(1, 2))
    total = rows.sum()
    return {Place("channel", n): float(r / total) if total > 0 else 0.0 for n, r in zip(names, rows, strict=True)}
