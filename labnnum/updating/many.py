"""Least squares on many FRFs of one structure at once: every step vectorised over the measurements.

What `labnnum.updating.refine` does for one measurement with all its care, this does for thousands with errors that
are independent from line to line: verification, benchmarks, parameters that drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError
from labnnum.parameters import Parameter, bounds

_BYTES = 64 << 20
"""Memory that the slopes of one group may take."""

LARGEST = float(np.finfo(float).max ** 0.25)
"""Largest |H| that can be fitted: least squares square residuals, and the square's square, an information, must be a
number. Ten to the power of 77, in whatever unit."""


class ManyFrfs(Protocol):
    """What computes the FRFs of many parameter sets at once: `FrfBatch`, `SweepBatch`."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free parameters."""
        ...

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of one FRF: (n_out, n_in, n_f)."""
        ...

    def frf(self, theta: ArrayLike) -> NDArray[np.complex128]:
        """FRFs, shape (n, n_out, n_in, n_f), of parameter sets (n, n_parameters)."""
        ...

    def sensitivity(self, theta: ArrayLike) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """FRFs and their derivatives, shape (n, n_parameters, n_out, n_in, n_f)."""
        ...


@dataclass(frozen=True, eq=False)
class Many:
    """Estimates of many measurements.

    Parameters
    ----------
    value : ndarray, shape (n, n_parameters)
    cost : ndarray, shape (n,)
        Half the sum of squared residuals.
    steps : ndarray of int, shape (n,)
        Evaluations of model and slopes.
    converged : ndarray of bool, shape (n,)
    """

    value: NDArray[np.float64]
    cost: NDArray[np.float64]
    steps: NDArray[np.int64]
    converged: NDArray[np.bool_]


def refine_many(
    batch: ManyFrfs,
    measured: NDArray,
    start: ArrayLike,
    *,
    scatter: NDArray | None = None,
    approach: bool = False,
    reach: float = 0.5,
    max_steps: int = 40,
    tolerance: float = 1e-9,
) -> Many:
    r"""Parameters that fit many measured FRFs, by damped least squares.

    Parameters
    ----------
    batch : ManyFrfs
    measured : ndarray, shape (n, n_out, n_in, n_f)
    start : array_like, shape (n, n_parameters)
    scatter : ndarray, broadcastable to `measured`, optional
        Standard deviation of the complex error of each line; by default proportional to \|H\|, for which log H is
        fitted.
    approach : bool
        Fits the FRF's image on the Riemann sphere first, then the smaller of the two ratios of model and measurement,
        both of which stay smooth where an undamped resonance passes over a line: for structures without damping, and
        for starts far away.
    reach : float
        Share of the range by which an estimate may leave the bounds.
    max_steps : int
    tolerance : float
        Step, in units of the priors' spread, below which a set has converged.

    Raises
    ------
    EstimationError
        If a measured FRF is not finite, or too large to be squared.

    Notes
    -----
    .. math:: \min_\theta \sum_{o,i,f} |\log H(\theta) - \log \hat H|^2
       \quad\text{or}\quad \sum_{o,i,f} |H(\theta) - \hat H|^2 / \sigma^2
    """
    first = np.atleast_2d(np.asarray(start, float))
    row = first_beyond(measured)
    if row is not None:
        number, out, inp, line = row
        raise EstimationError(
            f"FRF {number} of {len(measured)}, output {out}, input {inp}, is {abs(measured[row]):.3g} at line {line}:"
            f" expected finite numbers up to {LARGEST:.0e}; check that channel's unit and sensitivity"
        )
    parameters = batch.parameters
    low, high = bounds(parameters)
    wide = reach * (high - low)
    limits = (np.where(low > 0, np.maximum(low - wide, 0.05 * low), low - wide), high + wide)
    spread = np.array([p.spread for p in parameters])
    row = len(parameters) * int(np.prod(measured.shape[1:])) * 16 * 3
    size = max(1, _BYTES // max(row, 1))
    groups = []
    for a in range(0, len(first), size):
        part = slice(a, a + size)
        own = None if scatter is None else np.broadcast_to(scatter, measured.shape)[part]
        job = _Group(batch, measured[part], own, spread, limits)
        begin = first[part]
        if approach:
            for how in ("sphere", "ratio"):
                begin = replace(job, how=how).run(begin, max_steps, 1e-5).value
        groups.append(job.run(begin, max_steps, tolerance))
    return Many(*(np.concatenate([getattr(g, f) for g in groups]) for f in ("value", "cost", "steps", "converged")))


def refine_from(batch: ManyFrfs, measured: NDArray, starts: Sequence[ArrayLike], limit: float, **settings: Any) -> Many:
    """The same from several starts: sets whose cost exceeds `limit` are tried from the next one; the lowest is kept.

    Parameters
    ----------
    starts : sequence of array_like, each (n, n_parameters)
        Most trusted first.
    limit : float
        Cost below which a set is taken as explained by its noise.
    settings
        Of `refine_many`.
    """
    found = refine_many(batch, measured, starts[0], **settings)
    for start in starts[1:]:
        again = np.flatnonzero(~(found.cost <= limit))
        if not again.size:
            break
        scatter = settings.get("scatter")
        own = settings if scatter is None else {**settings, "scatter": np.broadcast_to(scatter, measured.shape)[again]}
        other = refine_many(batch, measured[again], np.asarray(start, float)[again], **own)
        better = other.cost < found.cost[again]
        for name in ("value", "cost", "converged"):
            getattr(found, name)[again[better]] = getattr(other, name)[better]
        found.steps[again] += other.steps
    return found


@dataclass(frozen=True, eq=False)
class _Group:
    """Measurements that are refined together."""

    batch: ManyFrfs
    measured: NDArray
    scatter: NDArray | None
    spread: NDArray
    limits: tuple[NDArray, NDArray]
    how: Literal["final", "sphere", "ratio"] = "final"

    def run(self, start: NDArray, max_steps: int, tolerance: float) -> Many:
        n = len(start)
        theta = np.clip(start, *self.limits)
        normal, gradient, cost = self._normal(theta, np.arange(n))
        damping, growth = np.full(n, 1e-6), np.full(n, 2.0)
        steps, converged, active = np.ones(n, np.int64), np.zeros(n, bool), np.arange(n)
        for _ in range(max_steps):
            if active.size == 0:
                break
            step = _damped(normal[active], gradient[active], damping[active])
            trial = np.clip(theta[active] + step * self.spread, *self.limits)
            moved = (trial - theta[active]) / self.spread
            new_normal, new_gradient, new_cost = self._normal(trial, active)
            steps[active] += 1
            predicted = -np.einsum("np,np->n", gradient[active], moved) - 0.5 * np.einsum(
                "np,npq,nq->n", moved, normal[active], moved
            )
            gain = (cost[active] - new_cost) / np.where(predicted > 0, predicted, np.inf)
            small = np.abs(moved).max(axis=1) < tolerance
            good = np.isfinite(new_cost) & (new_cost <= cost[active])
            took = active[good]
            theta[took], cost[took] = trial[good], new_cost[good]
            normal[took], gradient[took] = new_normal[good], new_gradient[good]
            ease = np.maximum(1 / 3, 1 - (2 * np.clip(gain, 0, 1) - 1) ** 3)
            damping[took] = np.maximum(damping[took] * ease[good], 1e-14)
            growth[took] = 2.0
            missed = active[~good]
            damping[missed] = np.maximum(damping[missed], 1e-8) * growth[missed]
            growth[missed] *= 2
            done = small | (damping[active] > 1e12)
            converged[active[small]] = True
            active = active[~done]
        return Many(theta, cost, steps, converged)

    def _normal(self, theta: NDArray, rows: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """J'J, J'r and half r'r of each set, in units of the spread."""
        with np.errstate(all="ignore"):
            value, slope = self.batch.sensitivity(theta)
            n = len(theta)
            r, j = self._residual(value, slope, rows)
            r, j = r.reshape(n, -1), j.reshape(n, slope.shape[1], -1) * self.spread[:, None]
            real = np.concatenate([np.real(j), np.imag(j)], axis=-1) if np.iscomplexobj(j) else j
            flat = np.concatenate([np.real(r), np.imag(r)], axis=-1) if np.iscomplexobj(r) else r
            normal = real @ real.swapaxes(-1, -2)
            return normal, (real @ flat[..., None])[..., 0], 0.5 * np.einsum("nm,nm->n", flat, flat)

    def _residual(self, value: NDArray, slope: NDArray, rows: NDArray) -> tuple[NDArray, NDArray]:
        """Residuals and their derivatives: log ratio, weighted difference, or difference on the sphere."""
        measured = self.measured[rows]
        if self.how != "final":
            scale = np.median(np.abs(measured), axis=-1, keepdims=True)
            mine, theirs = value / scale, measured / scale
            return (_sphere if self.how == "sphere" else _ratio)(mine, theirs, slope / scale[:, None])
        if self.scatter is not None:
            weight = np.sqrt(2) / self.scatter[rows]
            return (value - measured) * weight, slope * weight[:, None]
        ratio = value / measured
        return np.log(np.abs(ratio)) + 1j * np.angle(ratio), slope / value[:, None]


def first_beyond(value: NDArray) -> tuple[int, ...] | None:
    """Index of the first FRF value that is not finite or larger than `LARGEST`; None where all can be computed with."""
    bad = ~(np.abs(value) <= LARGEST)
    return tuple(int(i) for i in np.argwhere(bad)[0]) if bad.any() else None


def on_sphere(h: NDArray, slope: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points of the Riemann sphere, coordinates on a new last axis of 3, and their derivatives to the parameters.

    Parameters
    ----------
    h : ndarray, shape (n, ...)
    slope : ndarray, shape (n, n_parameters, ...)

    Examples
    --------
    >>> on_sphere(np.array([0.0, 1.0, 1e9]), np.zeros((3, 0)))[0].round(6)
    array([[ 0.,  0., -1.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    bottom = 1 + np.abs(h) ** 2
    x, y, z = 2 * np.real(h) / bottom, 2 * np.imag(h) / bottom, 1 - 2 / bottom
    a, b = np.real(slope), np.imag(slope)
    down = (2 * (np.real(h)[:, None] * a + np.imag(h)[:, None] * b)) / bottom[:, None]
    steep = [2 * a / bottom[:, None] - x[:, None] * down, 2 * b / bottom[:, None] - y[:, None] * down]
    steep.append((1 - z[:, None]) * down)
    return np.stack([x, y, z], axis=-1), np.stack(steep, axis=-1)


def _sphere(mine: NDArray, theirs: NDArray, slope: NDArray) -> tuple[NDArray, NDArray]:
    point, steep = on_sphere(mine, slope)
    return point - on_sphere(theirs, slope[:, :0])[0], steep


def _ratio(mine: NDArray, theirs: NDArray, slope: NDArray) -> tuple[NDArray, NDArray]:
    """Relative differences, of 1/H where |H| is large and of H where it is small."""
    large = np.abs(theirs) > 1
    r = np.where(large, 1 - theirs / mine, mine / theirs - 1)
    return r, slope * np.where(large, theirs / mine**2, 1 / theirs)[:, None]


def _damped(normal: NDArray, gradient: NDArray, damping: NDArray) -> NDArray[np.float64]:
    """Solutions of (N + damping diag N) step = -gradient, scaled to unit diagonal."""
    diagonal = np.einsum("npp->np", normal)
    root = 1 / np.sqrt(np.maximum(diagonal, 1e-24 * diagonal.max(axis=1, keepdims=True) + 1e-300))
    scaled = normal * root[:, :, None] * root[:, None, :]
    index = np.arange(scaled.shape[1])
    scaled[:, index, index] += damping[:, None] + 1e-14
    scaled = np.where(np.isfinite(scaled), scaled, 0.0)
    step = np.linalg.solve(scaled, np.nan_to_num(-gradient * root)[..., None])[..., 0]
    return step * root


def bound_deviations(batch: ManyFrfs, theta: ArrayLike, scatter: float | NDArray) -> NDArray[np.float64]:
    r"""Least standard deviations that any unbiased estimate can have (Cramer and Rao), shape (n, n_parameters).

    Parameters
    ----------
    theta : array_like, shape (n, n_parameters)
        Truths.
    scatter : float or ndarray
        Standard deviation of the complex Gaussian error of each line: as a share of \|H\| where it is a number.
    """
    rows = np.atleast_2d(np.asarray(theta, float))
    spread = np.array([p.spread for p in batch.parameters])
    out = []
    step = max(1, _BYTES // (len(spread) * 16 * 3 * int(np.prod(batch.shape))))
    for a in range(0, len(rows), step):
        value, slope = batch.sensitivity(rows[a : a + step])
        size = np.abs(value) * scatter if np.ndim(scatter) == 0 else np.broadcast_to(scatter, value.shape)
        j = slope / size[:, None] * spread[:, None, None, None]
        j = j.reshape(*slope.shape[:2], -1)
        information = 2 * np.real(j @ j.conj().swapaxes(-1, -2))
        diagonal = np.sqrt(np.einsum("npp->np", information))
        scaled = information / (diagonal[:, :, None] * diagonal[:, None, :])
        inverse = np.linalg.inv(scaled + 1e-15 * np.eye(scaled.shape[1]))
        out.append(np.sqrt(np.abs(np.einsum("npp->np", inverse))) / diagonal * spread)
    return np.concatenate(out)
