"""The objective of a fit: whitened residuals, ordinary errors fitted or marginalised, and its Gauss-Newton model.

A sound model is never exact: another mesh moves its frequencies by some tenths of a percent, its damping is a guess,
its shapes and gains are a percent off. These errors are given to the fit as quantities with a prior (`Scatter`): per
mode a frequency offset, a damping ratio and a size, which are fitted; per response shape errors and a gain, and in
common to all responses the structure's own irregularity, which are marginalised exactly. Missing physics is what they
cannot explain at a reasonable price.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.point import Response
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.errors import LabnnumError
from labnnum.mechanisms.base import Term
from labnnum.mechanisms.changes import Change


@dataclass(frozen=True, eq=False)
class Normal:
    """Quadratic model of the objective about one point."""

    objective: float
    data_part: float
    prior_part: float
    gradient: NDArray
    hessian: NDArray
    nuisance: NDArray
    common: NDArray
    moved: NDArray


ROUGH = 0.1
"""Relative error of what a finer mesh is told to do to a frequency."""


def frequency_spread(engine: Engine, scatter: Scatter) -> NDArray[np.float64]:
    """Standard deviation (m_b,) of the frequency offsets, the mesh's part in it as far as that is not settled."""
    share = {None: 1.0, True: ROUGH, False: 0.0}[engine.finer]
    return np.hypot(scatter.frequency, share * engine.mesh_shift)


LOOSE = 40.0
"""A loose channel's errors over the ordinary ones: shapes and gain by more than half of themselves."""


class Problem:
    """The objective of one fit: data, terms and scatter; evaluates itself and its Gauss-Newton model."""

    def __init__(self, engine: Engine, data: Data, terms: Sequence[Term], scatter: Scatter) -> None:
        self.engine, self.terms, self.scatter = engine, tuple(terms), scatter
        self.data = self._without_dropped(data)
        start = engine.start(self.terms)
        self.start = start
        self._spread = frequency_spread(engine, scatter)
        parameters = engine.structure.parameters
        m = start.shift.size
        self.mean = np.concatenate([start.theta, start.terms, start.shift, start.log_zeta, np.zeros(m), 0 * start.law])
        flat = np.full(start.terms.size, np.inf)
        self.std = np.concatenate(
            [[p.spread for p in parameters], flat, self._spread, np.full(m, scatter.damping),
             np.full(m, scatter.residue), [1.0, scatter.cords][: start.law.size]]
        )  # fmt: skip
        own = [q for t in self.terms for q in t.parameters]
        wide = np.concatenate([np.full(m, 0.5), np.full(m, 12.0), np.full(m, 0.9)])
        low = np.concatenate([[p.lower for p in parameters], [q.lower for q in own], -wide])
        high = np.concatenate([[p.upper for p in parameters], [q.upper for q in own], wide])
        at = start.theta.size + start.terms.size + m
        high[at : at + m] = np.log(0.7)
        low = np.append(low, 0.0 * start.law)
        high = np.append(high, [1.0, 0.5][: start.law.size])
        if scatter.trim:
            free = self.start.theta.size + self.start.terms.size
            for first, width in ((free, self._spread), (free + 2 * m, scatter.residue)):
                at = slice(first, first + m)
                low[at], high[at] = self.mean[at] - scatter.trim * width, self.mean[at] + scatter.trim * width
                self.std[first : first + m] = 10.0 * scatter.trim * width
        self.low, self.high = low, high
        self.root2 = np.sqrt(2.0)
        own_reach = [max(q.upper - q.lower, 1e-300) for t in self.terms for q in t.parameters]
        self.reach = np.concatenate(
            [
                [p.upper - p.lower for p in parameters],
                own_reach,
                np.full(m, 0.02),
                np.full(m, 0.7),
                np.full(m, 0.5),
                [1.0, 0.1][: start.law.size],
            ]
        )

    def scale(self, hessian: NDArray) -> NDArray[np.float64]:
        """Root of the diagonal; infinite, so that no step is made, where the data do not feel the whole range."""
        own = np.diag(hessian)
        with np.errstate(over="ignore", invalid="ignore"):
            felt = own * self.reach**2 > 1e-10
        return np.where(felt, np.sqrt(np.where(felt, own, 1.0)), np.inf)

    def clip(self, x: NDArray) -> NDArray:
        """Inside the bounds."""
        return np.minimum(np.maximum(x, self.low), self.high)

    def centred(self, x: NDArray, ahead: NDArray) -> NDArray:
        """`ahead`, its frequency offsets corrected so that the modes land where the step from `x` meant them to.

        Parameters move frequencies along a curve, the offsets undo it along a line; on peaks sharper than the
        difference a step would be lost. The data then see a straight step, and only the price sees the curve.
        """
        here, there = self.start.with_vector(x), self.start.with_vector(ahead)
        if np.array_equal(here.theta, there.theta) and not self._whole:
            return ahead
        e, b = self.engine, self.engine.band_modes
        try:
            old = e.state(here.theta, [(w, here.terms[c]) for w, c in self._whole])
            new = e.state(there.theta, [(w, there.terms[c]) for w, c in self._whole])
        except LabnnumError:
            return ahead
        if min(old.omega[b].min(), new.omega[b].min()) <= 0:  # buckled: there is no peak to keep
            return ahead
        moved = [there.theta - here.theta, *(there.terms[c] - here.terms[c] for _, c in self._whole)]
        meant = np.log(old.omega[b]) + np.concatenate(moved) @ old.d_log[:, b]
        meant += np.log1p(here.shift) + (there.shift - here.shift) / (1 + here.shift)
        shift = np.exp(meant) / new.omega[b] - 1
        shift = np.where(np.abs(shift - there.shift) < 0.02, shift, there.shift)
        return replace(there, shift=shift).vector()

    @cached_property
    def _whole(self) -> list[tuple[Change, slice]]:
        out, at = [], 0
        for t in self.terms:
            if t.whole is not None:
                out.append((t.whole, slice(at, at + t.n)))
            at += t.n
        return out

    def _rows(self, a: Any) -> NDArray:
        """Complex (..., o, i, f) over sigma to real (o i, 2 f, ...)."""
        a = a * (self.root2 / self.data.sigma)
        a = a.reshape(*a.shape[:-3], -1, a.shape[-1])
        a = np.concatenate([a.real, a.imag], axis=-1)
        return a if a.ndim == 2 else np.moveaxis(a, 0, -1)

    def _nuisance(self, r: Response, x: NDArray) -> NDArray:
        """Whitened columns (rows, 2 f, n) of what is marginalised, times their standard deviations."""
        sc, e = self.scatter, self.engine
        assert r.modal is not None
        assert r.modal_out is not None
        assert r.lift is not None
        assert r.rest is not None
        if sc.trim:
            return np.zeros((r.value.shape[0] * r.value.shape[1], 2 * self.data.s.size, 1))
        b = e.band_modes
        n_o, n_i = len(e.outputs), len(e.inputs)
        if n_i > n_o:
            modal = np.broadcast_to(r.modal_out[:, :, None, :], (b.size, n_o, n_i, self.data.s.size))
        else:
            modal = np.broadcast_to(r.modal[:, None, :, :], (b.size, n_o, n_i, self.data.s.size))
        shapes = sc.shape * e.typical[:, None, None, None] * modal * r.lift
        typical = np.broadcast_to(np.abs(r.rest).mean(axis=(0, 2), keepdims=True), r.rest.shape)
        s = self.data.s / np.abs(self.data.s).max()
        others = np.stack(
            [
                sc.gain * r.value,
                1j * sc.phase * r.value,
                s * sc.phase * r.value,
                sc.remainder * r.rest * r.lift,
                0.3j * sc.remainder * r.rest * r.lift,
                0.3 * sc.remainder * typical * r.lift,
            ]
        )
        parts = [shapes, 1j * (sc.complexity / sc.shape) * shapes, others]
        if r.other_modal is not None and r.other_modal.shape[1] == n_i:
            parts.append(sc.shape * r.other_modal[np.searchsorted(e.outside_modes, e.modes_above)][:, None] * r.lift)
        if r.rigid is not None:  # soft springs and their loss under a free structure: a share that falls as 1/s^2
            low = np.min(np.abs(self.data.s.imag))
            held = sc.suspension * r.rigid * r.lift * (low / self.data.s) ** 2
            parts.append(np.stack([held, 0.5j * held]))
        if self.data.s.real.min() > 0:  # hits: an offset not taken off is 1/s in each row, from the record's start
            size = np.median(np.abs(self.data.value), axis=2, keepdims=True)
            offset = sc.offset * size * np.min(np.abs(self.data.s)) / self.data.s
            offset = offset * np.exp(1j * self.data.s.imag * self.data.lead)
            parts.append(np.stack([offset, 1j * offset]))
        columns = self._rows(np.concatenate([*parts, *self._moved_supports(r, x)]))
        for i in self._loose:
            columns = self._loosened(columns, i, r)
        return columns

    def _inputs(self, r: Response) -> NDArray[np.complex128]:
        """Columns (3 n_in, n_out, n_in, n_f) of each input's gain and phase, an error that all its responses share."""
        sc, s = self.scatter, self.data.s / np.abs(self.data.s).max()
        every = [sc.gain * np.ones_like(s), 1j * sc.phase * np.ones_like(s), s * sc.phase]
        out = np.zeros((len(every) * len(self.engine.inputs), *r.value.shape), complex)
        for i in range(len(self.engine.inputs)):
            for k, factor in enumerate(every):
                out[len(every) * i + k, :, i] = factor * r.value[:, i]
        return out

    def _loosened(self, columns: NDArray, channel: int, r: Response) -> NDArray:
        """The columns with those of one channel's rows widened, and its share of every mode outside the band free."""
        assert r.other_modal is not None
        assert r.lift is not None
        rows = self._rows_of(channel)
        columns[rows] *= LOOSE
        if not len(r.other_modal):
            return columns
        free = self._rows(r.other_modal[:, None] * r.lift)
        more = np.zeros((columns.shape[0], columns.shape[1], free.shape[2]))
        more[rows] = free[rows]
        return np.concatenate([columns, more], axis=2)

    def _without_dropped(self, data: Data) -> Data:
        """The data with nothing known of channels that a term gives up."""
        dropped = [t.data["dropped"] for t in self.terms if "dropped" in t.data]
        if not dropped:
            return data
        sigma = data.sigma.copy()
        rows = sigma.reshape(-1, sigma.shape[-1])
        for i in dropped:
            rows[self._rows_of(i)] *= 1e6
        return replace(data, sigma=rows.reshape(sigma.shape))

    @cached_property
    def _loose(self) -> list[int]:
        return [t.data["loose"] for t in self.terms if "loose" in t.data]

    def _rows_of(self, channel: int) -> list[int]:
        n_o, n_i = len(self.engine.outputs), len(self.engine.inputs)
        if channel < n_o:
            return [channel * n_i + j for j in range(n_i)]
        return [o * n_i + channel - n_o for o in range(n_o)]

    def _moved_supports(self, r: Response, x: NDArray) -> list[NDArray]:
        """Columns (6, n_out, n_in, n_f) of each support that may move by itself, sized to the response."""
        out = []
        for term in self.terms:
            if "moved" not in term.data:
                continue
            assert r.lift is not None
            support, axis = term.data["moved"]
            u = self.engine.imposed(support, axis, self.start.with_vector(x), self.data.s)[:, None] * r.lift
            weight = 1.0 / self.data.sigma**2
            size = np.sqrt(np.sum(weight * np.abs(r.value) ** 2) / max(np.sum(weight * np.abs(u) ** 2), 1e-300))
            s = self.data.s / np.abs(self.data.s).max()
            out.append(np.stack([a * size * f * u for f in (np.ones_like(s), s, s**2) for a in (1.0, 1j)]))
        return out

    def value(self, x: NDArray, like: Normal) -> float:
        """Objective at `x` what is marginalised held as at `like`, so that no step profits by changing it."""
        resp = self.engine.response(self.start.with_vector(x), self.terms, self.data.s)
        r = self._rows(self.data.value - resp.value)
        return self._reduce(r, like.nuisance, like.common, self._shifted(x, like.moved)) + self._price(x)

    def marginal(self, x: NDArray) -> float:
        """Whitened squares at `x` with what is marginalised taken off at its price; nothing for `x` itself."""
        r, b, c, _, moved = self._parts(x, jacobian=False)
        return self._reduce(r, b, c, self._shifted(x, moved)) - self._price_of_offsets(x, moved)

    def _price(self, x: NDArray) -> float:
        """Price of what is fitted; of frequency offsets only where no part of the structure explains them."""
        return float(np.sum(self._prior * (x - self.mean) ** 2))

    @cached_property
    def _prior(self) -> NDArray[np.float64]:
        prior = 1.0 / self.std**2
        if self._common is not None:
            prior[self._offsets] = 0.0
        return prior

    @property
    def _common(self) -> NDArray | None:
        return None if self.scatter.trim else self.scatter.common

    @property
    def _offsets(self) -> slice:
        first = self.start.theta.size + self.start.terms.size
        return slice(first, first + self.start.shift.size)

    def _shifted(self, x: NDArray, moved: NDArray) -> NDArray:
        """Gram matrix of the prior of frequency offsets, (k + 1, k + 1): what directions of irregularity move them by,
        and where they are.
        """
        c = np.vstack([-moved, -(x - self.mean)[self._offsets]]) / self.std[self._offsets]
        return c @ c.T if moved.size else np.zeros((1, 1))

    def _parts(self, x: NDArray, *, jacobian: bool) -> tuple[NDArray, NDArray, NDArray, NDArray | None, NDArray]:
        """Residuals (rows, 2 f), what is marginalised by row and in common (rows, 2 f, n), derivatives to `x`, and by
        how much what is common moves frequencies (k, m_b).
        """
        point = self.start.with_vector(x)
        common = self._common
        resp = self.engine.response(point, self.terms, self.data.s, jacobian=jacobian, modal=True, common=common)
        r = self._rows(self.data.value - resp.value)
        j = None if resp.jacobian is None else self._rows(resp.jacobian)
        if resp.common is None or resp.moved is None:
            return r, self._nuisance(resp, x), np.zeros((*r.shape, 0)), j, np.zeros((0, point.shift.size))
        shared = np.concatenate([resp.common, self._inputs(resp)])
        moved = np.vstack([resp.moved, np.zeros((len(shared) - len(resp.moved), point.shift.size))])
        return r, self._nuisance(resp, x), self._rows(shared), j, moved

    @staticmethod
    def _reduce(r: NDArray, b: NDArray, c: NDArray, shifted: NDArray) -> float:
        """Whitened squares of `r` and the price of frequency offsets, what is marginalised taken off at its price."""
        whole = float(np.sum(r * r)) + float(shifted[-1, -1])
        gram = by_rows(np.concatenate([b, c, r[..., None]], axis=2), b.shape[2])
        left = float(common_out(gram + shifted if c.shape[2] else gram, c.shape[2])[-1, -1])
        return left if left >= 1e-9 * whole else whole  # so large that its own ordinary errors would explain anything

    def normal(self, x: NDArray) -> Normal:
        """Objective, gradient and Gauss-Newton Hessian (halved) at `x`."""
        r, b, c, j, moved = self._parts(x, jacobian=True)
        assert j is not None
        k = c.shape[2]
        gram = by_rows(np.concatenate([b, c, j, r[..., None]], axis=2), b.shape[2])
        if k:
            gram += self._with_offsets(x, moved)
        free = common_out(gram, k)
        whole = float(np.sum(r * r))
        both = float(free[-1, -1]) if free[-1, -1] >= 1e-9 * whole else whole
        hessian, gradient = free[:-1, :-1], free[:-1, -1]
        gradient = gradient - self._prior * (x - self.mean)
        asked = self._price_of_offsets(x, moved)
        price = self._price(x)
        return Normal(
            both + price, both - asked, price + asked, gradient, hessian + np.diag(self._prior), b, c, moved
        )  # fmt: skip

    def _with_offsets(self, x: NDArray, moved: NDArray) -> NDArray:
        """The prior of frequency offsets in the normal matrix of [common, x, residual]."""
        k, m = moved.shape
        every = np.zeros((m, k + x.size + 1))
        every[:, :k] = -moved.T
        every[:, k + self._offsets.start : k + self._offsets.stop] = np.eye(m)
        every[:, -1] = -(x - self.mean)[self._offsets]
        every /= self.std[self._offsets][:, None]
        return every.T @ every

    def _price_of_offsets(self, x: NDArray, moved: NDArray) -> float:
        """Price of the frequency offsets, given what parts of the structure may move them by; data left aside."""
        if not moved.size:
            return 0.0
        return float(common_out(self._shifted(x, moved), len(moved))[-1, -1])


def by_rows(every: NDArray, n: int) -> NDArray:
    """Gram matrix of columns (rows, 2 f, n + m), summed over rows; each row's own first n are marginalised."""
    gram = np.matmul(every.transpose(0, 2, 1), every)
    across = gram[:, :n, n:]
    solved = np.linalg.solve(gram[:, :n, :n] + np.eye(n), across)
    return np.sum(gram[:, n:, n:] - np.matmul(across.transpose(0, 2, 1), solved), axis=0)


def common_out(gram: NDArray, k: int) -> NDArray:
    """The same with the first k, common to all rows and of deviation one, left out."""
    if not k:
        return gram
    return gram[k:, k:] - gram[:k, k:].T @ np.linalg.solve(gram[:k, :k] + np.eye(k), gram[:k, k:])
