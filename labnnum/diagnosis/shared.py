r"""Noise that all responses of a run share: that of the measured input, in every FRF in the same proportion.

An input that was measured as u + n gives each response's FRF the error -H n / u. A fit that takes the rows for
independent sees one deviation as often as there are sensors, and finds physics in it. Rows are weighed one by one all
the same; so the variances are raised until the diagonal covers the whole covariance, in every direction:

.. math:: \mathrm{diag}(o_i + \kappa_i s |h_i|^2) \succeq \mathrm{diag}(o_i) + s\, h h^H
          \quad\text{where}\quad \sum_i 1 / \kappa_i = 1

with o_i a row's own variance and s that of the input over its power (Cauchy and Schwarz). Rows that their own noise
rules get a large share kappa_i, which costs them little, and leave the others close to one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

WIDTH = 31
"""Lines over which the input's noise is taken for even."""
OWN = 0.05
"""Least share of a row's variance that is its own."""


def input_noise(h: NDArray, residual: NDArray, variance: NDArray, power: NDArray) -> NDArray[np.float64]:
    """Variance (n_f,) of the input's noise over the input's power, from what the residuals of the rows have in common.

    Parameters
    ----------
    h, variance : ndarray, shape (n_out, n_f)
        FRFs to one input, and E|dH|^2.
    residual : ndarray, shape (n, n_out, n_f)
        Samples of the FRFs' error, each of that variance.
    power : ndarray, shape (n_f,)
        Of the input, any unit.
    """
    from scipy.ndimage import uniform_filter1d

    weight = 1.0 / np.maximum(variance, 1e-300)
    z = np.conj(h) * weight * residual
    size = np.abs(h) ** 2 * weight
    got = np.mean(np.abs(z.sum(axis=1)) ** 2 - np.sum(np.abs(z) ** 2, axis=1), axis=0)
    unit = (size.sum(axis=0) ** 2 - np.sum(size**2, axis=0)) / power
    width = min(WIDTH, max(power.size // 4, 1))
    level = uniform_filter1d(got, width, mode="nearest") / np.maximum(
        uniform_filter1d(unit, width, mode="nearest"), 1e-300
    )
    return np.clip(level, 0.0, None) / power


def covering(h: NDArray, variance: NDArray, noise: NDArray) -> NDArray[np.float64]:
    """Variances (n_out, n_f) that cover what the rows share: `noise` (n_f,) of the input over its power."""
    with np.errstate(over="ignore"):  # of lines without input, which no row is heard on
        common = noise * np.abs(h) ** 2
    own = np.maximum(variance - common, OWN * variance)
    common = np.minimum(common, variance)
    return own + _shares(common / np.maximum(own, 1e-300)) * common


def _shares(ratio: NDArray) -> NDArray[np.float64]:
    """Shares kappa (n_out, n_f), 1 / kappa adding up to one over the rows, with the least product of 1 + kappa ratio.

    Stationary where kappa^2 = lam (kappa + 1 / ratio); lam is found by bisection of its logarithm.
    """
    if ratio.shape[0] == 1:
        return np.ones_like(ratio)
    rest = 1.0 / np.maximum(ratio, 1e-12)

    def at(lam: NDArray) -> NDArray:
        return lam / 2 + np.sqrt(lam**2 / 4 + lam * rest)

    low = np.full(ratio.shape[1], -40.0)
    high = np.full(ratio.shape[1], np.log(float(ratio.shape[0])) + 1.0)
    for _ in range(50):
        middle = (low + high) / 2
        less = np.sum(1.0 / at(np.exp(middle)), axis=0) > 1.0
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return at(np.exp(high))
