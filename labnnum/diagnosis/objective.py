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

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis import sums
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.evaluation import Evaluation
from labnnum.diagnosis.marginal import Gathered, Irregularity, Marginal, by_rows, common_out, sensible
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
    held: Marginal
    """What is marginalised, as it is there."""
    moved: NDArray
    irregular: Irregularity | None = None
    """Where some row hardly holds anything but what the structure's irregularity adds: what its parts differ by."""


BENT = 0.2
"""Share of a row's response that the structure's irregularity adds, beyond which that moves and widens with the peaks
of a fit. A sensor that stands still in every mode that is driven, as the joint of a symmetric frame does, sees others
by the irregularity alone; their frequencies and damping are told by nothing else."""
FAR = 8.0
"""Deviations of its irregularity beyond which a structure is no sound one, and its parts are not believed to differ by
that much."""


ROUGH = 0.1
"""Relative error of what a finer mesh is told to do to a frequency."""


def frequency_spread(engine: Engine, scatter: Scatter) -> NDArray[np.float64]:
    """Standard deviation (m_b,) of the frequency offsets, the mesh's part in it as far as that is not settled."""
    share = {None: 1.0, True: ROUGH, False: 0.0}[engine.finer]
    return np.hypot(scatter.frequency, share * engine.mesh_shift)


NUDGE, FINEST = 1e-4, 1e-10
"""Step, in standard deviations of a parameter alone or in its reach, and of itself at least, by which the marginalised
columns' derivatives are taken."""
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
        self._last: tuple[bytes, Evaluation] | None = None
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
        own = hessian.diagonal()
        felt = own > self._unfelt
        return np.where(felt, np.sqrt(np.where(felt, own, 1.0)), np.inf)

    @cached_property
    def _unfelt(self) -> NDArray[np.float64]:
        """Entries of the Hessian's diagonal below which a parameter's whole range is not felt."""
        with np.errstate(over="ignore", divide="ignore"):
            return 1e-10 / self.reach**2

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
        with np.errstate(over="ignore"):  # a step that first order sees no end of: its peaks stay where they come out
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

    @cached_property
    def _weight(self) -> NDArray[np.complex128]:
        """What whitens (o, i, f)."""
        return np.asarray(self.root2 / self.data.sigma, complex)

    def _at(self, x: NDArray) -> Evaluation:
        """The engine evaluated at `x`; the last one is remembered, since a step's value is asked for before its
        derivatives are.
        """
        key = x.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, Evaluation(self.engine, self.start.with_vector(x), self.terms, self.data.s))
        return self._last[1]

    def whitened(self, value: NDArray) -> NDArray[np.float64]:
        """Complex (n, o, i, f) over sigma as real (n, rows, 2 f)."""
        out = np.empty((len(value), value[0, ..., 0].size, 2 * value.shape[-1]))
        _put(out, value, self._weight)
        return out

    def _residuals(self, value: NDArray) -> NDArray[np.float64]:
        """Data minus `value`, whitened, (rows, 2 f)."""
        r = (self.data.value - value) * self._weight
        r = r.reshape(-1, r.shape[-1])
        return np.concatenate([r.real, r.imag], axis=1)

    def _own_columns(self, r: Response, x: NDArray) -> list[tuple[NDArray, NDArray]]:
        """What is marginalised by row, times its standard deviations: each a pair of values (n, o, i, f) and a factor
        (o, i, f), either of which may be one for all outputs or inputs.
        """
        sc, e, s, w = self.scatter, self.engine, self.data.s, self._weight
        assert r.modal is not None
        assert r.modal_out is not None
        assert r.lift is not None
        assert r.rest is not None
        if sc.trim:
            return [(np.zeros((1, 1, 1, s.size), complex), w)]
        lift = r.lift * w
        modal = r.modal_out[:, :, None] if len(e.inputs) > len(e.outputs) else r.modal[:, None]
        shapes = e.typical[:, None, None, None] * modal
        typical = np.abs(r.rest).mean(axis=(0, 2), keepdims=True)
        parts = [
            (sc.shape * shapes, lift),
            (1j * sc.complexity * shapes, lift),
            (self._chained, r.value * w),
            (self._lost, r.rest * lift),
            (0.3 * sc.remainder * typical[None] * np.ones(s.size), lift),
        ]
        if r.other_modal is not None and r.other_modal.shape[1] == len(e.inputs):
            parts.append((sc.shape * r.other_modal[self._above][:, None], lift))
        if r.rigid is not None:
            parts.append((self._held_free, r.rigid * lift))
        if s.real.min() > 0:
            parts.append(self._offset)
        return [*parts, *((u, w) for u in self._moved_supports(r, x))]

    @cached_property
    def _above(self) -> NDArray[np.intp]:
        """Places, among the modes outside the band, of those next above."""
        return np.searchsorted(self.engine.outside_modes, self.engine.modes_above)

    @cached_property
    def _lost(self) -> NDArray[np.complex128]:
        """Factors (2, 1, 1, f) of what modes outside the band contribute, and its loss."""
        loss = np.array([1.0, 0.3j])[:, None, None, None] * self.scatter.remainder
        return np.asarray(np.repeat(loss, self.data.s.size, axis=3), complex)

    @cached_property
    def _held_free(self) -> NDArray[np.complex128]:
        """Factors (2, 1, 1, f) of soft springs and their loss under a free structure: a share that falls as 1/s^2."""
        s = self.data.s
        held = self.scatter.suspension * (np.min(np.abs(s.imag)) / s) ** 2
        return np.stack([held, 0.5j * held])[:, None, None]

    @cached_property
    def _offset(self) -> tuple[NDArray, NDArray]:
        """Of hits: an offset not taken off is 1/s in each row, from the record's start."""
        s = self.data.s
        size = np.median(np.abs(self.data.value), axis=2, keepdims=True)
        offset = self.scatter.offset * np.min(np.abs(s)) / s * np.exp(1j * s.imag * self.data.lead)
        return np.stack([offset, 1j * offset])[:, None, None], size * self._weight

    @cached_property
    def _chained(self) -> NDArray[np.complex128]:
        """Factors (3, 1, 1, f) by which a gain, a phase and a delay change a channel, times their deviations."""
        sc, s = self.scatter, self.data.s / np.abs(self.data.s).max()
        return np.stack([sc.gain * np.ones_like(s), 1j * sc.phase * np.ones_like(s), s * sc.phase])[:, None, None]

    def _inputs(self, value: NDArray) -> list[tuple[NDArray, NDArray]]:
        """Each input's gain, phase and delay, an error that all its responses share."""
        out = []
        for i in range(len(self.engine.inputs)):
            own = np.zeros_like(value)
            own[:, i] = value[:, i] * self._weight[:, i]
            out.append((self._chained, own))
        return out

    def _loosened(self, columns: NDArray, at: int, channel: int, r: Response) -> int:
        """The first `at` columns (n, rows, 2 f) widened in one channel's rows, and after them its share of every mode
        outside the band; the number of columns then.
        """
        assert r.other_modal is not None
        assert r.lift is not None
        rows, end = self._rows_of(channel), at + len(r.other_modal)
        columns[:at, rows] *= LOOSE
        if end > at:
            _put(columns[at:end], r.other_modal[:, None], r.lift * self._weight)
            others = np.ones(columns.shape[1], bool)
            others[rows] = False
            columns[at:end, others] = 0.0
        return end

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
        held = like.irregular
        r = self._residuals(self._at(x).run(False, False, parts=None if held is None else held.parts).value)
        if held is not None:
            r += held.added
        return like.held.reduce(r, self._shifted(x, like.moved)) + self._price(x)

    def anew(self, x: NDArray) -> float:
        """Objective at `x` with what is marginalised as it is there."""
        return self._reduced(x)[0] + self._price(x)

    def marginal(self, x: NDArray) -> float:
        """Whitened squares at `x` with what is marginalised taken off at its price; nothing for `x` itself."""
        left, moved = self._reduced(x)
        return left - self._price_of_offsets(x, moved)

    def _reduced(self, x: NDArray) -> tuple[float, NDArray]:
        """Whitened squares at `x` with what is marginalised taken off at its price, and the price of frequency offsets;
        and by how much what is common moves frequencies (k, m_b).
        """
        g = self._gathered(x, jacobian=False)
        shifted = self._shifted(x, g.moved)
        whole = float(np.sum(g.columns[-1] ** 2)) + float(shifted[-1, -1])
        left = float(common_out(g.gram + shifted if g.common else g.gram, g.common)[-1, -1])
        return sensible(left, whole), g.moved

    def _price(self, x: NDArray) -> float:
        """Price of what is fitted; of frequency offsets only where no part of the structure explains them."""
        return float(np.sum(self._prior * (x - self.mean) ** 2))

    @cached_property
    def _prior(self) -> NDArray[np.float64]:
        prior = 1.0 / self.std**2
        if self._common is not None:
            prior[self._offsets] = 0.0
        return prior

    @cached_property
    def _sizes(self) -> slice:
        """Where the sizes of modes stand in a point's vector."""
        first = self._offsets.stop + self.start.log_zeta.size
        return slice(first, first + self.start.size.size)

    @property
    def _common(self) -> NDArray | None:
        return None if self.scatter.trim else self.scatter.common

    @cached_property
    def _offsets(self) -> slice:
        first = self.start.theta.size + self.start.terms.size
        return slice(first, first + self.start.shift.size)

    def _shifted(self, x: NDArray, moved: NDArray) -> NDArray:
        """Gram matrix of the prior of frequency offsets, (k + 1, k + 1): what directions of irregularity move them by,
        and where they are.
        """
        if not moved.size:
            return np.zeros((1, 1))
        c = np.vstack([-moved, -(x - self.mean)[self._offsets]]) / self.std[self._offsets]
        return c @ c.T

    def _parts(self, x: NDArray, *, jacobian: bool) -> tuple[NDArray, NDArray, NDArray, NDArray | None, NDArray]:
        """Residuals (rows, 2 f), what is marginalised by row and in common (rows, 2 f, n), derivatives to `x`, and by
        how much what is common moves frequencies (k, m_b).
        """
        g = self._gathered(x, jacobian=jacobian)
        n, k, every = g.own, g.common, g.columns.transpose(1, 2, 0)
        slopes = every[..., n + k : -1] if jacobian else None
        return g.columns[-1], every[..., :n], every[..., n : n + k], slopes, g.moved

    def _gathered(self, x: NDArray, *, jacobian: bool) -> Gathered:
        """Whitened columns with their Gram matrix, about the likeliest irregularity where a row holds little else."""
        columns, n, k, moved = self._columns(x, jacobian=jacobian)
        gram, factor = by_rows(columns, n)
        irregular = self._irregular(columns, n, gram, self._shifted(x, moved))
        if irregular is not None:
            columns, *_ = self._columns(x, jacobian=jacobian, parts=irregular.parts)
            irregular = replace(irregular, added=_along(irregular.size, columns[n:]))
            columns[-1] += irregular.added
            gram, factor = by_rows(columns, n)
        return Gathered(columns, n, k, moved, gram, factor, irregular)

    def _moving(self, x: NDArray, g: Gathered) -> Gathered:
        """The same with what `x` moves of the marginalised columns, each as large as it is likeliest there, among the
        derivatives (as in variable projection: Kaufman 1975); sizes of modes move them by next to nothing.
        """
        m, n, k = g.own + g.common, g.own, g.common
        shifted = self._shifted(x, g.moved)
        inner = g.gram[:k, :k] + shifted[:-1, :-1] + np.eye(k)
        shared = np.linalg.solve(inner, g.gram[:k, -1] + shifted[:-1, -1])
        own = np.ascontiguousarray(g.columns[:n].transpose(1, 0, 2))  # (rows, n, 2 f)
        left = g.columns[-1] - np.tensordot(shared, g.columns[n:m], 1)
        size = np.linalg.solve(np.matmul(own, own.transpose(0, 2, 1)) + np.eye(n), np.matmul(own, left[:, :, None]))
        along, weights = None, shared
        if self._common is not None:  # its directions as one, as they are taken together
            directions = self._common.shape[1]
            along = self._common @ shared[:directions, None]
            weights = np.concatenate([[1.0], shared[directions:]])
        parts = None if g.irregular is None else g.irregular.parts

        def taken(at: NDArray) -> NDArray:
            columns, _, together, _ = self._columns(at, jacobian=False, parts=parts, along=along)
            made = np.matmul(size.transpose(0, 2, 1), columns[:n].transpose(1, 0, 2))[:, 0]
            return made + np.tensordot(weights, columns[n : n + together], 1)

        here, columns = taken(x), g.columns.copy()
        felt = np.sqrt(np.sum(columns[m:-1] ** 2, axis=(1, 2)))
        felt[self._sizes] = 0.0
        for i in np.flatnonzero(felt > 0):
            ahead = x.copy()
            ahead[i] += min(max(NUDGE / felt[i], FINEST * abs(x[i])), NUDGE * self.reach[i])
            columns[m + i] += (taken(ahead) - here) / (ahead[i] - x[i])
        gram, factor = by_rows(columns, n)
        return replace(g, columns=columns, gram=gram, factor=factor)

    def _irregular(self, columns: NDArray, n: int, gram: NDArray, shifted: NDArray) -> Irregularity | None:
        """The likeliest irregularity at a point with these columns, where it makes more than `BENT` of a row and is
        none that only something else would make, `FAR`.
        """
        if self._common is None or not self._common.shape[1]:
            return None
        k, m = self._common.shape[1], len(shifted) - 1
        inner = gram[:m, :m] + shifted[:-1, :-1] + np.eye(m)
        size = np.asarray(np.linalg.solve(inner, gram[:m, -1] + shifted[:-1, -1])[:k], float)
        if np.abs(size).max() > FAR:
            return None
        added = _along(size, columns[n:])
        share = np.sqrt(np.sum(added**2, axis=1)) / self._measured
        return Irregularity(size, self._common @ size, added) if share.max() > BENT else None

    @cached_property
    def _measured(self) -> NDArray[np.float64]:
        """Size of each row's whitened data."""
        return np.asarray(np.sqrt(np.sum(np.abs(self.data.value * self._weight) ** 2, axis=2)).ravel(), float)

    def _columns(
        self, x: NDArray, *, jacobian: bool, parts: NDArray | None = None, along: NDArray | None = None
    ) -> tuple[NDArray[np.float64], int, int, NDArray[np.float64]]:  # fmt: skip
        """Whitened columns (n + k + n_x + 1, rows, 2 f): n marginalised by row, k in common, derivatives to `x` where
        asked for, residuals; n; k; and by how much what is common moves frequencies (k, m_b). `along` (n_parts, k') are
        other directions of irregularity than the scatter's.
        """
        r = self._at(x).run(jacobian, True, self._common if along is None else along, parts)
        own, loose = self._own_columns(r, x), self._loose
        shared = [(r.common, self._weight), *self._inputs(r.value)] if r.common is not None else []
        more = len(loose) * len(r.other_modal) if r.other_modal is not None else 0
        n, k = (sum(len(v) for v, _ in part) for part in (own, shared))
        n += more
        n_x = len(r.jacobian) if r.jacobian is not None else 0
        columns = np.empty((n + k + n_x + 1, self.data.value[..., 0].size, 2 * self.data.s.size))
        at = _filled(columns, 0, own)
        for channel in loose:
            at = self._loosened(columns, at, channel, r)
        at = _filled(columns, at, shared)
        if r.jacobian is not None:
            _filled(columns, at, [(r.jacobian, self._weight)])
        columns[-1] = self._residuals(r.value)
        moved = np.zeros((k, self.start.shift.size))
        if r.moved is not None:
            moved[: len(r.moved)] = r.moved
        return columns, n, k, moved

    def normal(self, x: NDArray, *, moving: bool = False) -> Normal:
        """Objective, gradient and Gauss-Newton Hessian (halved) at `x`; `moving` where what is marginalised is to move
        along with `x` as it is there, which costs as many evaluations as `x` has entries.
        """
        g = self._gathered(x, jacobian=True)
        if moving:
            g = self._moving(x, g)
        columns, n, k, moved, gram = g.columns, g.own, g.common, g.moved, g.gram
        held = Marginal(columns[: n + k], n, g.factor[:, :, : n + k], gram[:k, :k].copy())
        if k:
            gram = gram + self._with_offsets(x, moved)
        free = common_out(gram, k)
        both = sensible(float(free[-1, -1]), float(np.sum(columns[-1] ** 2)))
        hessian, gradient = free[:-1, :-1], free[:-1, -1]
        gradient = gradient - self._prior * (x - self.mean)
        asked = self._price_of_offsets(x, moved)
        price = self._price(x)
        hessian = hessian + np.diag(self._prior)
        return Normal(both + price, both - asked, price + asked, gradient, hessian, held, moved, g.irregular)

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


def _along(size: NDArray, columns: NDArray) -> NDArray[np.float64]:
    """The first columns (k + n, rows, 2 f), each times its size (k,), together."""
    return np.asarray(np.tensordot(size, columns[: size.size], 1), np.float64)


def _put(columns: NDArray, values: NDArray, factor: NDArray) -> None:
    sums.put(columns, np.ascontiguousarray(values, complex), np.ascontiguousarray(factor, complex))


def _filled(columns: NDArray, at: int, parts: Sequence[tuple[NDArray, NDArray]]) -> int:
    """Columns (n, rows, 2 f) from `at` on set to values times factors; the number of columns then."""
    for values, factor in parts:
        _put(columns[at : at + len(values)], values, factor)
        at += len(values)
    return at
