"""A refinement compiled for one small structure: least squares on log H within a control loop, in a fraction of a ms.

The same problem as `labnnum.updating.many.refine_many` poses for one measurement, without its approach on the sphere:
it starts from a network. FRF and derivatives of a line come from one elimination with row exchanges.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError
from labnnum.parameters import bounds
from labnnum.updating.batch import FrfBatch
from labnnum.updating.engines import EliminationEngine, Setting

Refinement = Callable[[NDArray, NDArray], "Refined"]


@dataclass(frozen=True, eq=False)
class Refined:
    """One estimate.

    Parameters
    ----------
    value : ndarray, shape (n_parameters,)
    cost : float
        Half the sum of squared residuals where the last step began.
    steps : int
        Evaluations of model and slopes.
    converged : bool
    """

    value: NDArray[np.float64]
    cost: float
    steps: int
    converged: bool


def compiled_refinement(
    batch: FrfBatch, *, reach: float = 0.5, max_steps: int = 40, tolerance: float = 1e-5
) -> Refinement:
    r"""Function from a measured FRF (n_out, n_in, n_f) and a start (n_parameters,) to the refined parameters.

    Parameters
    ----------
    batch : FrfBatch
        Of a structure that is small enough to be eliminated.
    reach : float
        Share of the range by which an estimate may leave the bounds.
    max_steps : int
    tolerance : float
        Step, in units of the priors' spread, that is the last: the next would be about its square.

    Raises
    ------
    EstimationError
        If the structure is large, or its matrices are no polynomials of the parameters.

    Notes
    -----
    .. math:: \min_\theta \sum_{o,i,f} |\log H(\theta) - \log \hat H|^2

    The first call compiles, which takes some seconds, once on a machine.
    """
    if not isinstance(batch.engine, EliminationEngine):
        raise EstimationError("refinement: only structures of a few coordinates are compiled; use refine_many")
    model = _model(batch.engine.setting, batch)
    low, high = bounds(batch.parameters)
    wide = reach * (high - low)
    least = np.where(low > 0, np.maximum(low - wide, 0.05 * low), low - wide)
    spread = np.array([p.spread for p in batch.parameters])
    n_pairs, n_lines = len(batch.outputs) * len(batch.inputs), batch.frequency.size

    def refine(measured: ArrayLike, start: ArrayLike) -> Refined:
        value = np.asarray(measured, complex)
        if value.shape != batch.shape:
            raise EstimationError(f"refinement: an FRF of shape {batch.shape} is expected, not {value.shape}")
        log = np.log(value.reshape(n_pairs, n_lines))
        begin = np.clip(np.asarray(start, float), least, high + wide)
        theta, cost, steps, converged = _fit(model, log, begin, spread, least, high + wide, max_steps, tolerance)
        return Refined(theta, float(cost), int(steps), bool(converged))

    return refine


def _model(s: Setting, batch: FrfBatch) -> tuple[NDArray, ...]:
    """The structure as plain arrays."""
    family = s.family
    cells = sorted({(int(i), int(j)) for places in family.places for i, j in places})
    number = {cell: at for at, cell in enumerate(cells)}
    coefficients = np.zeros((4, len(cells), len(family.powers)))
    for kind, (places, c) in enumerate(zip(family.places, family.coefficients, strict=True)):
        for n, (i, j) in enumerate(places):
            coefficients[kind, number[int(i), int(j)]] = c[:, n]
    omega = s.omega
    factor = (1j * omega) ** batch.power[:, :, None]
    held = np.broadcast_to(batch.carried[:, :, None] * (1j * omega) ** (batch.power[:, :, None] - 2.0), factor.shape)
    flat = (len(batch.outputs) * len(batch.inputs), omega.size)
    return (
        family.centre, family.half, np.ascontiguousarray(family.powers), np.array(cells, np.int64), coefficients,
        np.ascontiguousarray(s.rows), np.ascontiguousarray(np.moveaxis(s.loads, 0, -1)), omega,
        np.ascontiguousarray(factor.reshape(flat)), np.ascontiguousarray(held.reshape(flat)),
    )  # fmt: skip


@njit(cache=True)
def _fit(model, log, theta, spread, low, high, max_steps, tolerance):  # pragma: no cover - compiled
    n = theta.size
    normal, gradient, cost = _normal(model, log, theta, spread)
    damping, growth, steps, converged = 1e-6, 2.0, 1, False
    for _ in range(max_steps):
        root = np.empty(n)
        for j in range(n):
            root[j] = 1 / np.sqrt(max(normal[j, j], 1e-300))
        scaled = np.empty((n, n))
        right = np.empty(n)
        for j in range(n):
            for k in range(n):
                scaled[j, k] = normal[j, k] * root[j] * root[k]
            scaled[j, j] += damping + 1e-14
            right[j] = -gradient[j] * root[j]
        step = np.linalg.solve(scaled, right) * root
        trial = np.minimum(np.maximum(theta + step * spread, low), high)
        moved = (trial - theta) / spread
        largest = np.abs(moved).max()
        if largest < tolerance:
            theta, converged = trial, True
            break
        new_normal, new_gradient, new_cost = _normal(model, log, trial, spread)
        steps += 1
        if new_cost <= cost:
            predicted = 0.0
            for j in range(n):
                predicted -= gradient[j] * moved[j]
                for k in range(n):
                    predicted -= 0.5 * moved[j] * normal[j, k] * moved[k]
            gain = (cost - new_cost) / predicted if predicted > 0 else 0.0
            damping = max(damping * max(1 / 3, 1 - (2 * min(max(gain, 0.0), 1.0) - 1) ** 3), 1e-14)
            growth = 2.0
            theta, normal, gradient, cost = trial, new_normal, new_gradient, new_cost
        else:
            damping = max(damping, 1e-8) * growth
            growth *= 2
            if damping > 1e12:
                break
    return theta, cost, steps, converged


@njit(cache=True)
def _terms(theta, centre, half, powers):  # pragma: no cover - compiled
    """Values of the family's polynomials, (n_terms,), and derivatives, (n_parameters, n_terms)."""
    n_terms, n = powers.shape
    top = 0
    for t in range(n_terms):
        for j in range(n):
            top = max(top, powers[t, j])
    value, slope = np.ones((n, top + 1)), np.zeros((n, top + 1))
    for j in range(n):
        x = (theta[j] - centre[j]) / half[j]
        if top:
            value[j, 1], slope[j, 1] = x, 1 / half[j]
        for d in range(2, top + 1):
            value[j, d] = 2 * x * value[j, d - 1] - value[j, d - 2]
            slope[j, d] = 2 * value[j, d - 1] / half[j] + 2 * x * slope[j, d - 1] - slope[j, d - 2]
    terms, slopes = np.ones(n_terms), np.ones((n, n_terms))
    for t in range(n_terms):
        for j in range(n):
            terms[t] *= value[j, powers[t, j]]
            for k in range(n):
                slopes[k, t] *= slope[j, powers[t, j]] if j == k else value[j, powers[t, j]]
    return terms, slopes


@njit(cache=True)
def _eliminate(z, x):  # pragma: no cover - compiled
    """Solve z x = x in place, rows exchanged where a pivot is small."""
    n, m = x.shape
    for i in range(n):
        best, at = -1.0, i
        for r in range(i, n):
            size = abs(z[r, i].real) + abs(z[r, i].imag)
            if size > best:
                best, at = size, r
        if at != i:
            for c in range(i, n):
                z[i, c], z[at, c] = z[at, c], z[i, c]
            for c in range(m):
                x[i, c], x[at, c] = x[at, c], x[i, c]
        inverse = 1 / z[i, i]
        for r in range(i + 1, n):
            if z[r, i] != 0:
                f = z[r, i] * inverse
                for c in range(i + 1, n):
                    z[r, c] -= f * z[i, c]
                for c in range(m):
                    x[r, c] -= f * x[i, c]
    for i in range(n - 1, -1, -1):
        inverse = 1 / z[i, i]
        for c in range(m):
            total = x[i, c]
            for r in range(i + 1, n):
                total -= z[i, r] * x[r, c]
            x[i, c] = total * inverse


@njit(cache=True)
def _normal(model, log, theta, spread):  # pragma: no cover - compiled
    """J'J, J'r and half r'r of the residual log H(theta) - log, in units of the spread."""
    centre, half, powers, cells, coefficients, rows, loads, omega, factor, held = model
    terms, slopes = _terms(theta, centre, half, powers)
    n, n_out, n_in, size, n_cells = theta.size, rows.shape[0], loads.shape[1], rows.shape[1], len(cells)
    entry, turned = np.zeros((4, n_cells)), np.zeros((n, 4, n_cells))
    for kind in range(4):
        for c in range(n_cells):
            for t in range(terms.size):
                a = coefficients[kind, c, t]
                if a != 0.0:
                    entry[kind, c] += a * terms[t]
                    for k in range(n):
                        turned[k, kind, c] += a * slopes[k, t]
    touched = np.zeros((n, n_cells), np.bool_)
    for k in range(n):
        for c in range(n_cells):
            for kind in range(4):
                if turned[k, kind, c] != 0.0:
                    touched[k, c] = True
    load, load_slope = np.zeros((size, n_in)), np.zeros((n, size, n_in))
    for d in range(size):
        for i in range(n_in):
            for t in range(terms.size):
                load[d, i] += loads[d, i, t] * terms[t]
                for k in range(n):
                    load_slope[k, d, i] += loads[d, i, t] * slopes[k, t]
    normal, gradient, cost = np.zeros((n, n)), np.zeros(n), 0.0
    z, x = np.empty((size, size), np.complex128), np.empty((size, n_in + n_out), np.complex128)
    j = np.empty(n, np.complex128)
    for f in range(omega.size):
        w = omega[f]
        z[:] = 0.0
        for c in range(n_cells):
            a, b = cells[c, 0], cells[c, 1]
            one = complex(entry[2, c] - w * w * entry[0, c], w * entry[1, c] + entry[3, c])
            z[a, b] = one
            z[b, a] = one
        for d in range(size):
            for i in range(n_in):
                x[d, i] = load[d, i]
            for o in range(n_out):
                x[d, n_in + o] = rows[o, d]
        _eliminate(z, x)
        for o in range(n_out):
            for i in range(n_in):
                h = 0j
                for d in range(size):
                    h += rows[o, d] * x[d, i]
                pair = o * n_in + i
                h = h * factor[pair, f] + held[pair, f]
                weight = factor[pair, f] / h
                for k in range(n):
                    total = 0j
                    for c in range(n_cells):
                        if touched[k, c]:
                            a, b = cells[c, 0], cells[c, 1]
                            one = complex(
                                turned[k, 2, c] - w * w * turned[k, 0, c], w * turned[k, 1, c] + turned[k, 3, c]
                            )
                            both = x[a, n_in + o] * x[b, i]
                            if a != b:
                                both += x[b, n_in + o] * x[a, i]
                            total -= one * both
                    for d in range(size):
                        if load_slope[k, d, i] != 0.0:
                            total += x[d, n_in + o] * load_slope[k, d, i]
                    j[k] = total * weight * spread[k]
                r = np.log(h) - log[pair, f]
                turn = r.imag - 2 * np.pi * np.round(r.imag / (2 * np.pi))
                cost += 0.5 * (r.real * r.real + turn * turn)
                for k in range(n):
                    gradient[k] += j[k].real * r.real + j[k].imag * turn
                    for m in range(k + 1):
                        normal[k, m] += j[k].real * j[m].real + j[k].imag * j[m].imag
    for k in range(n):
        for m in range(k):
            normal[m, k] = normal[k, m]
    return normal, gradient, cost
