"""How large the ordinary errors of this very structure and bench are, told by what a fit had to take of each kind.

`Scatter` says what a sound model may differ by at most. Most differ by less, and the less they do the fainter a fault
that shows: each kind of error gets the size that the data support, between a tenth and the whole of what it may be.
Variance components by restricted maximum likelihood (Patterson and Thompson 1971), by MacKay's fixed point (1992,
equation 4.16): each variance is the sum of squares over the number of components that the data determine, both with
`BELIEF` components of the usual size added.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit
from labnnum.diagnosis.objective import Problem
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.task import data_of
from labnnum.frf import Frf

BELIEF = 6.0
"""Components that the usual size of an error counts for."""

USUAL = {
    "shape": 0.25, "complexity": 0.1, "gain": 0.8, "phase": 0.2, "remainder": 0.35, "frequency": 0.5, "residue": 0.3,
    "stiffness": 0.5, "mass": 0.5, "loss": 0.4, "zone": 0.6, "floor": 0.4,
}  # fmt: skip
"""Usual size of each kind of error over the largest that a sound one has (root mean square over sound structures)."""

LEAST = 0.1
"""Part of its largest size below which no error is believed to be, but for the floor."""

CLEAN = 0.15
"""Part of the floor below which no row's is believed to be: products of two errors of a percent are as large."""

FEW = 0.1
"""Variance over the noise's below which a direction of the structure's irregularity is left out."""

MOST = 24
"""Directions of irregularity at most."""


def sharpened(engine: Engine, lines: Frf, made: Fit, wide: Scatter, given: Data, *, explained: bool = True) -> Scatter:
    """The scatter that the errors of a fit support, each between `LEAST` and the whole of what `wide` allows.

    Parameters
    ----------
    lines : Frf
        What was fitted, with its measured variance.
    made : Fit
        Fitted under whatever scatter.
    wide : Scatter
        Largest errors of a sound model and bench.
    given : Data
        The lines under `wide`.
    explained : bool
        Whether the fit is taken to explain the data. If not, errors get their usual size at most: what is missing may
        have gone into them.
    """
    parts = engine.irregular.kinds
    sizes = np.array([getattr(wide, k) for k in parts])
    problem = Problem(engine, given, made.terms, replace(wide, common=np.diag(sizes)) if parts else wide)
    found, phi = _Components(problem, made, parts).found()
    scale = {k: float(np.clip(v, LEAST, 1.0 if explained else USUAL[k])) for k, v in found.items()}
    sharp = replace(wide, common=None, **{k: v * getattr(wide, k) for k, v in scale.items()})
    rows = wide.floor * _floors(lines, given, phi)
    sharp = replace(sharp, floor=float(np.sqrt(np.mean(rows**2))), rows=rows)
    return replace(sharp, common=_directions(engine, data_of(lines, sharp), made, sharp, parts))


def _floors(lines: Frf, given: Data, phi: NDArray) -> NDArray[np.float64]:
    """Part of the floor, (n_out, n_in), with which a row's errors have the variance found, `phi` times the assumed."""
    assert lines.covering_variance is not None
    noise = lines.covering_variance / given.sigma**2
    own = np.maximum(1.0 - noise, 0.0)
    phi = phi.reshape(noise.shape[:2])
    low, high = np.full(phi.shape, CLEAN), np.ones(phi.shape)
    for _ in range(30):
        middle = np.sqrt(low * high)
        more = np.mean(phi[..., None] / np.maximum(noise + middle[..., None] ** 2 * own, 1e-12), axis=2) > 1.0
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    return np.sqrt(low * high)


def _directions(engine: Engine, data: Data, made: Fit, sharp: Scatter, parts: list[str]) -> NDArray | None:
    """Directions (n_parts, k), one standard deviation long, in which the structure's irregularity shows."""
    if not parts:
        return None
    weight = np.array([getattr(sharp, k) for k in parts])
    p = Problem(engine, data, made.terms, replace(sharp, common=np.diag(weight)))
    _, b, c, j, moved = p._parts(made.point.vector(), jacobian=True)
    assert j is not None
    c = (c + j[:, :, p._offsets] @ moved.T)[:, :, : len(parts)]
    inner = np.linalg.solve(np.matmul(b.transpose(0, 2, 1), b) + np.eye(b.shape[2]), np.matmul(b.transpose(0, 2, 1), c))
    gram = (np.matmul(c.transpose(0, 2, 1), c) - np.matmul(np.matmul(c.transpose(0, 2, 1), b), inner)).sum(0)
    value, vector = np.linalg.eigh(gram)
    pick = np.flatnonzero(value > FEW)[::-1][:MOST]
    return weight[:, None] * vector[:, pick] if pick.size else None


class _Components:
    """Variance components of one fit's linear model: rows' own columns, common ones, what is fitted, noise."""

    def __init__(self, problem: Problem, made: Fit, parts: list[str]) -> None:
        self.problem = problem
        x = made.point.vector()
        r, b, c, j, moved = problem._parts(x, jacobian=True)
        assert j is not None
        if parts:
            c = c + j[:, :, problem._offsets] @ moved.T
        m = problem.start.shift.size
        free = made.point.theta.size + made.point.terms.size
        own = ["shape"] * m + ["complexity"] * m + ["gain", "phase", "phase", "remainder", "remainder", "remainder"]
        self.rows = np.array(own + [""] * (b.shape[2] - len(own)))
        fitted = [""] * free + ["frequency"] * m + [""] * m + ["residue"] * m + [""] * (x.size - free - 3 * m)
        inputs = ["gain", "phase", "phase"] * len(problem.engine.inputs) if parts else []
        n = c.shape[2]
        self.shared = np.array([*parts, *inputs, *fitted])
        std = np.concatenate([np.ones(n), problem.std])
        self.flat = ~np.isfinite(std)
        self.std = np.where(self.flat, 1.0, std)
        self.off = np.concatenate([np.zeros(n), np.where(self.flat[n:], 0.0, x - problem.mean)])
        y = np.concatenate([c, j, r[..., None]], axis=2)
        bt = b.transpose(0, 2, 1)
        self.bb, self.by, self.yy = np.matmul(bt, b), np.matmul(bt, y), np.matmul(y.transpose(0, 2, 1), y)
        self.n = r.size
        self.believed = [i for i in range(len(r)) if i not in {k for c in problem._loose for k in problem._rows_of(c)}]

    def found(self, rounds: int = 12) -> tuple[dict[str, float], NDArray]:
        """Size of each kind over the largest, and each row's variance of noise over the one assumed."""
        kinds = [k for k in USUAL if k != "floor" and (k in self.rows or k in self.shared)]
        size = {k: USUAL[k] for k in kinds}
        phi = np.full(len(self.bb), USUAL["floor"] ** 2)
        for _ in range(rounds):
            size, phi = self._round(size, phi)
        return size, phi

    def _round(self, size: dict[str, float], phi: NDArray) -> tuple[dict[str, float], NDArray]:
        t = np.array([size.get(k, 1.0) for k in self.rows])
        deviation = self.std * np.array([size.get(k, 1.0) for k in self.shared])
        prior = np.where(self.flat, 0.0, 1.0 / deviation**2)
        level = phi[:, None, None]
        inverse = np.linalg.inv(self.bb * np.outer(t, t) / level + np.eye(t.size))
        scaled = self.by * t[None, :, None] / np.sqrt(level)
        solved = np.matmul(inverse, scaled)
        each = (self.yy - np.matmul(scaled.transpose(0, 2, 1), solved)) / level
        a = each.sum(0)
        hessian, gradient = a[:-1, :-1] + np.diag(prior), a[:-1, -1] - prior * self.off
        n = self.shared.size - self.problem.reach.size
        if not np.isfinite(hessian).all():  # a fit beyond all numbers tells of no error
            return size, phi
        own_scale = np.sqrt(np.maximum(np.diag(hessian)[:n], prior[:n]))  # rounding may leave less than the prior
        scale = np.concatenate([own_scale, self.problem.scale(hessian[n:, n:])])  # infinite where nothing is felt
        covariance = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-12, hermitian=True)
        covariance = covariance / np.outer(scale, scale)
        step = covariance @ gradient
        at = self.off + step
        mean = (solved[:, :, -1] - solved[:, :, :-1] @ step) / np.sqrt(phi)[:, None]  # rows' own, in prior deviations
        spread = np.diagonal(inverse, axis1=1, axis2=2).copy()
        spread += (
            np.einsum("rny,yz,rnz->rn", solved[:, :, :-1], covariance, solved[:, :, :-1], optimize=True)
            / (phi[:, None])
        )
        own = (at / deviation) ** 2, np.clip(1.0 - np.diag(covariance) * prior, 0, 1)
        told = np.clip(1.0 - spread, 0, 1)
        new = {}
        pick = self.believed
        for k, was in size.items():
            one, two = self.rows == k, (self.shared == k) & ~self.flat
            squares = float((mean[pick][:, one] ** 2).sum() + own[0][two].sum())
            count = float(told[pick][:, one].sum() + own[1][two].sum())
            new[k] = float(np.sqrt((was**2 * squares + BELIEF * USUAL[k] ** 2) / (count + BELIEF)))
        left = each[:, -1, -1] - 2 * each[:, :-1, -1] @ step + np.einsum("x,rxy,y->r", step, each[:, :-1, :-1], step)
        left = phi * (left - (mean**2).sum(axis=1))
        free = self.n / len(phi) - told.sum(axis=1) - own[1].sum() / len(phi)
        return new, np.clip(left / np.maximum(free, 0.2 * self.n / len(phi)), 1e-4, 1e4)
