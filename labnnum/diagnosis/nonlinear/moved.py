"""Whether peaks of an FRF move from one level to another, against chance."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks
from scipy.stats import f as f_distribution

CHANCE = 0.01
"""Probability of a false sign of change, over all channels: the k-th smallest of n p-values is below k times this over
n in fewer cases than this, however they depend on each other (Markov's inequality on the number of them)."""
PEAK = 4.0
"""Factor by which the power of all responses must rise above the lowest on either side for a peak of its own."""
RELATED = 0.05
"""Correlation of neighbouring lines' errors below which they count as independent."""


def moved(frequency: NDArray, a: NDArray, b: NDArray, variance: NDArray) -> NDArray[np.float64]:
    """Probability, channel by channel, that chance makes the peaks of two FRFs differ as they do, in place and width.

    A structure that changes with level moves its poles. To first order that changes an FRF around a peak by its own
    slope along frequency, times a real number (frequency) or an imaginary one (damping). What of the whitened change
    two such terms a peak explain is compared with what they leave: an F statistic, so that the variances need be right
    up to a factor only. Degrees of freedom are divided by the correlation length of what is left.

    Parameters
    ----------
    frequency : ndarray, shape (n_f,)
    a, b : ndarray, shape (n_out, n_f)
        FRFs at two levels.
    variance : ndarray, shape (n_out, n_f)
        Of their difference.

    Returns
    -------
    ndarray, shape (n_out,)
        1 where there are too few lines.
    """
    n = frequency.size
    mean, sigma = (a + b) / 2, np.sqrt(variance)
    slope = np.gradient(mean, frequency, axis=1)
    power = np.mean(np.abs(mean) ** 2 / np.mean(np.abs(mean) ** 2, axis=1, keepdims=True), axis=0)
    peaks, _ = find_peaks(np.log(np.maximum(power, 1e-300)), prominence=np.log(PEAK), distance=3)
    cuts = [0, *(int(p + np.argmin(power[p:q])) for p, q in pairwise(peaks)), n]
    parts = [(p, q) for p, q in pairwise(cuts) if q - p >= 4]
    out = np.ones(a.shape[0])
    for row in range(a.shape[0]):
        columns = np.zeros((2 * len(parts), n), complex)
        for i, (p, q) in enumerate(parts):
            columns[2 * i, p:q] = slope[row, p:q] / sigma[row, p:q]
            columns[2 * i + 1, p:q] = 1j * columns[2 * i, p:q]
        change = (b - a)[row] / sigma[row]
        basis, _ = np.linalg.qr(np.concatenate([np.real(columns), np.imag(columns)], axis=1).T)
        whole = np.concatenate([np.real(change), np.imag(change)])
        along = basis.T @ whole
        left = whole - basis @ along
        length = _related(left[:n] + 1j * left[n:])
        k = along.size
        rest = (2 * n - k) / length
        if rest > k:
            value = np.sum(along**2) / k / (np.sum(left**2) / (2 * n - k)) / length
            out[row] = float(f_distribution.sf(value, k, rest))
    return out


def _related(x: NDArray) -> float:
    """Lines over which errors (n,) are correlated."""
    size, power = 1.0, float(np.sum(np.abs(x) ** 2))
    for lag in range(1, x.size // 8):
        rho = float(np.real(np.sum(x[lag:] * np.conj(x[:-lag])))) / power if power > 0 else 0.0
        if rho < RELATED:
            break
        size += 2 * rho
    return size
