r"""Intervals of a component law's parameters: what chance leaves within a test, and what differs between tests.

Within tests the covariance is that of least squares, widened because what a law leaves is no white noise. It hangs
together from sample to sample, by the time :math:`\tau` of its autocorrelation :math:`\rho` up to where that first
falls to zero; and where it is what the law lacks and not noise it comes again in every cycle, so that m cycles tell
hardly more than one (the design effect of clustered samples, Kish 1965):

.. math:: \tau = \Big(1 + 2 \sum_{j} \rho_j\Big) \, \big(1 + (m - 1) \max(\rho_{\text{cycle}}, 0)\big)

Between tests the law is fitted to each test on its own; the standard error of the mean of n values takes Student's t
with n - 1 degrees of freedom. The wider of the two is told. With one test the scatter between tests is not known.

References
----------
L. Kish, Survey Sampling, Wiley, 1965.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import t as student

from labnnum.component_laws import DERIVED, ComponentTest, Vector, force, sensitivity

CONFIDENCE = 0.9
"""Of the intervals."""

Derived = tuple[str, str, float, float, float]


def intervals(
    law: str, value: Vector, tests: Sequence[ComponentTest], each: Vector
) -> tuple[Vector, Vector, tuple[Derived, ...]]:
    """Standard deviations and half widths of the 90 % intervals of parameters, and what is derived from them.

    Parameters
    ----------
    law : str
    value : ndarray, shape (n_parameters,)
        Fitted to all tests.
    tests : sequence of ComponentTest
        That were fitted to.
    each : ndarray, shape (n_tests, n_parameters)
        Fitted to each test alone.

    Returns
    -------
    std, half : ndarray, shape (n_parameters,)
        Infinite where the tests do not tell a parameter.
    derived : tuple of (name, unit, value, std, half)
    """
    covariance, freedom = within(law, value, tests)
    std, half = np.empty(value.size), np.empty(value.size)
    for i in range(value.size):
        std[i], half[i] = _wider(covariance[i, i], freedom, each[:, i])
    derived = []
    for name, unit, of in DERIVED.get(law, ()):
        slope = _gradient(of, value)
        variance = float(slope @ covariance @ slope) if np.isfinite(covariance).all() else np.inf
        spread = _wider(variance, freedom, np.array([of(p) for p in each]))
        derived.append((name, unit, float(of(value)), *spread))
    return std, half, tuple(derived)


def within(law: str, value: Vector, tests: Sequence[ComponentTest]) -> tuple[Vector, float]:
    """Covariance (n_parameters, n_parameters) of least squares with what is left as it hangs together, and its degrees
    of freedom; infinite and 0 where the tests do not tell every parameter.
    """
    rows = [sensitivity(law, value, t) for t in tests]
    left = [(t.f - force(law, value, t))[t.counted] for t in tests]
    return covariance_of(rows, left, tests)


def covariance_of(
    rows: Sequence[Vector], left: Sequence[Vector], tests: Sequence[ComponentTest]
) -> tuple[Vector, float]:
    """The same from derivatives (n, n_parameters) and residuals (n,) of each test."""
    n = rows[0].shape[1]
    unknown = np.full((n, n), np.inf), 0.0
    scale = np.sqrt(sum(np.sum(j**2, axis=0) for j in rows))
    if not np.all(scale > 0) or not np.all(np.isfinite(scale)):
        return unknown
    bread, filling, independent = np.zeros((n, n)), np.zeros((n, n)), 0.0
    for j, e, t in zip(rows, left, tests, strict=True):
        weight = 1.0 / np.sum(t.f[t.counted] ** 2)
        product = (j / scale).T @ (j / scale)
        together = correlation_time(e, t.cycle)
        bread += weight * product
        filling += weight**2 * float(np.mean(e**2)) * together * product
        independent += e.size / together
    freedom = independent - n
    if freedom <= 0 or np.linalg.cond(bread) > 1e12:
        return unknown
    inverse = np.linalg.inv(bread)
    found = inverse @ filling @ inverse * independent / freedom
    return found / np.outer(scale, scale), float(freedom)


def correlation_time(left: Vector, cycle: int = 0) -> float:
    """Samples that count as one, of a residual (n,) with `cycle` samples in a cycle; 1 for white noise."""
    n = left.size
    spectrum = np.abs(np.fft.rfft(left, 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[:n] / np.arange(n, 0, -1)
    if rho[0] <= 0:
        return 1.0
    rho = rho / rho[0]
    reach = min(n, cycle) if cycle else n
    fallen = np.flatnonzero(rho[:reach] <= 0)
    nearby = 1.0 + 2.0 * float(np.sum(rho[1 : fallen[0] if fallen.size else reach]))
    cycles = n / cycle if cycle else 1.0
    again = max(float(rho[cycle]), 0.0) if 0 < cycle < n else 0.0
    return min(nearby * (1.0 + max(cycles - 1.0, 0.0) * again), float(n))


def beside_viscous(law: str, value: Vector, tests: Sequence[ComponentTest]) -> tuple[float, float]:
    """Coefficient (N s/m) of a dashpot fitted beside a law, parameters of both together, and half of its 90 % interval.

    One step of Gauss and Newton from the law alone; NaN and infinite where the tests do not tell it.
    """
    rows = [np.column_stack([sensitivity(law, value, t), t.v[t.counted]]) for t in tests]
    left = [(t.f - force(law, value, t))[t.counted] for t in tests]
    size = [np.sqrt(np.sum(t.f[t.counted] ** 2)) for t in tests]
    basis = np.concatenate([j / s for j, s in zip(rows, size, strict=True)])
    scale = np.sqrt(np.sum(basis**2, axis=0))
    if not np.all(scale > 0):
        return np.nan, np.inf
    target = np.concatenate([e / s for e, s in zip(left, size, strict=True)])
    step = np.linalg.lstsq(basis / scale, target, rcond=None)[0] / scale
    covariance, freedom = covariance_of(rows, [e - j @ step for e, j in zip(left, rows, strict=True)], tests)
    return float(step[-1]), _wider(covariance[-1, -1], freedom, np.empty(0))[1]


def _wider(variance: float, freedom: float, each: Vector) -> tuple[float, float]:
    """Standard deviation and half width: within tests or between them, whichever is wider."""
    tail = 0.5 + CONFIDENCE / 2
    found = [(np.inf, np.inf)]
    if np.isfinite(variance) and freedom > 0:
        std = float(np.sqrt(max(variance, 0.0)))
        found = [(std, std * float(student.ppf(tail, freedom)))]
    if each.size > 1:
        std = float(np.std(each, ddof=1) / np.sqrt(each.size))
        found.append((std, std * float(student.ppf(tail, each.size - 1))))
    return max(found, key=lambda f: f[1])


def _gradient(of: Callable[[Vector], float], p: Vector) -> Vector:
    out = np.empty(p.size)
    for i in range(p.size):
        step = 1e-6 * abs(p[i]) or 1e-12
        up, down = p.copy(), p.copy()
        up[i], down[i] = p[i] + step, p[i] - step
        out[i] = (of(up) - of(down)) / (2 * step)
    return out
