"""Windows, periodic as spectra want them, with what each does to noise and to damping."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError

_COSINES: dict[str, tuple[float, ...]] = {
    "boxcar": (1.0,),
    "hann": (0.5, 0.5),
    "hamming": (0.54, 0.46),
    "blackman": (0.42, 0.5, 0.08),
    "blackmanharris": (0.35875, 0.48829, 0.14128, 0.01168),
    "flattop": (0.21557895, 0.41663158, 0.277263158, 0.083578947, 0.006947368),
}

WINDOWS: tuple[str, ...] = (*_COSINES, "kaiser")
"""Names that `window` knows; "kaiser" may carry its shape, as in "kaiser:12"."""

KAISER_SHAPE = 9.0
"""Shape parameter of "kaiser" where none is given: side lobes below -66 dB."""


def window(name: str, n: int) -> NDArray[np.float64]:
    r"""Periodic window of n samples, largest value 1 (flattop: 1 within 1e-8), shape (n,).

    Parameters
    ----------
    name : str
        One of `WINDOWS`; "kaiser:12" is a Kaiser window of shape 12.
    n : int
        Samples; the window has period n, so sample n would repeat sample 0.

    Raises
    ------
    EstimationError
        The name is unknown, or n is not positive.

    Notes
    -----
    .. math:: w_i = \sum_k (-1)^k a_k \cos(2\pi k i/n)

    References
    ----------
    Harris (1978), On the use of windows for harmonic analysis with the discrete Fourier transform.

    Examples
    --------
    >>> window("hann", 4)
    array([0. , 0.5, 1. , 0.5])
    """
    if n < 1:
        raise EstimationError(f"a window needs at least one sample, not {n}")
    kind, _, shape = name.partition(":")
    if kind == "kaiser":
        return _kaiser(n, name, shape)
    if shape or kind not in _COSINES:
        raise EstimationError(f"window {name!r} is not one of {', '.join(WINDOWS)} (or kaiser:SHAPE)")
    angle = 2 * np.pi * np.arange(n) / n
    terms = [(-1) ** k * a * np.cos(k * angle) for k, a in enumerate(_COSINES[kind])]
    return np.sum(terms, axis=0)


def _kaiser(n: int, name: str, shape: str) -> NDArray[np.float64]:
    try:
        beta = float(shape) if shape else KAISER_SHAPE
    except ValueError:
        beta = -1.0
    if not 0 <= beta <= 500:
        raise EstimationError(f"window {name!r}: the shape after 'kaiser:' must be a number from 0 to 500")
    return np.kaiser(n + 1, beta)[:-1]


def lag_window(name: str, n: int) -> NDArray[np.float64]:
    r"""Autocorrelation of a window over its power, lags 0 to n - 1, shape (n,).

    The correlation of two signals estimated from windowed segments is, in expectation, the true one times this.

    Notes
    -----
    .. math:: v_k = \sum_i w_i w_{i+k} / \sum_i w_i^2

    Examples
    --------
    >>> lag_window("boxcar", 4)
    array([1.  , 0.75, 0.5 , 0.25])
    """
    shape = window(name, n)
    power = np.abs(np.fft.rfft(shape, 2 * n)) ** 2
    correlation = np.fft.irfft(power, 2 * n)[:n]
    return np.round(correlation / np.sum(shape**2), 15)


def noise_bandwidth(shape: ArrayLike) -> float:
    """Equivalent noise bandwidth of a window, in lines (1 for boxcar, 1.5 for Hann).

    References
    ----------
    Harris (1978), equation 11.

    Examples
    --------
    >>> round(noise_bandwidth(window("hann", 64)), 12)
    1.5
    """
    w = np.asarray(shape, float)
    return float(w.size * np.sum(w**2) / np.sum(w) ** 2)


def overlap_correlation(shape: ArrayLike, hop: int) -> NDArray[np.float64]:
    r"""Correlation of the periodograms of white noise in segments 0, 1, 2, ... hops apart.

    Returns
    -------
    ndarray, shape (n_overlapping,)
        Entry 0 is 1; the array ends where segments no longer overlap.

    Notes
    -----
    .. math:: \rho_d = \Bigl(\sum_i w_i w_{i+dh} / \sum_i w_i^2\Bigr)^2

    References
    ----------
    Welch (1967), The use of fast Fourier transform for the estimation of power spectra.
    """
    w = np.asarray(shape, float)
    shifts = range(0, w.size, hop)
    return np.array([(w[: w.size - d] @ w[d:]) ** 2 for d in shifts]) / np.sum(w**2) ** 2


def effective_averages(shape: ArrayLike, hop: int, counts: ArrayLike) -> float:
    """Number of independent averages that overlapped segments are worth.

    Parameters
    ----------
    shape : array_like, shape (n_segment,)
        The window.
    hop : int
        Samples from the start of one segment to the next.
    counts : array_like of int
        Segments in each contiguous run; segments of different runs are independent.

    References
    ----------
    Welch (1967).

    Examples
    --------
    >>> round(effective_averages(window("boxcar", 8), 8, [5, 3]), 9)
    8.0
    >>> round(effective_averages(window("hann", 1024), 512, [100]), 2)
    94.79
    """
    rho = overlap_correlation(shape, hop)
    runs = np.asarray(counts, float).reshape(-1, 1)
    lag = np.arange(1, rho.size)
    spread = runs[:, 0] + 2 * np.sum(np.clip(runs - lag, 0, None) * rho[1:], axis=1)
    return float(runs.sum() ** 2 / spread.sum()) if runs.sum() else 0.0


def exponential_window(n: int, rate: float, decay: float) -> NDArray[np.float64]:
    r"""Exponential window exp(-decay t), shape (n,), for force and response of a hit alike.

    Multiplying both signals moves every pole by -decay and nothing else, as long as both decay within the
    record: the window adds decay/|pole| to each damping ratio, which `added_damping` gives.

    Parameters
    ----------
    n : int
        Samples.
    rate : float
        Samples per second.
    decay : float
        1/s; 0 leaves the signals as they are.

    Notes
    -----
    .. math:: (h * f) e^{-\sigma t} = (h e^{-\sigma t}) * (f e^{-\sigma t})
    """
    if not (np.isfinite(decay) and decay >= 0):
        raise EstimationError(f"the decay of the exponential window is {decay}: it must be 0 or more, in 1/s")
    return np.exp(-decay * np.arange(n) / rate)


def added_damping(decay: float, frequency: ArrayLike) -> NDArray[np.float64]:
    """Damping ratio that an exponential window of `decay` (1/s) adds to modes of natural frequency (Hz).

    Subtract it from a damping ratio read off a windowed FRF.

    Examples
    --------
    >>> added_damping(6.283185307179586, [100.0, 1000.0])
    array([0.01 , 0.001])
    """
    return decay / (2 * np.pi * np.asarray(frequency, float))


def force_window(n: int, start: int, stop: int, taper: int = 0) -> NDArray[np.float64]:
    """Window that is 1 on samples start to stop - 1 and 0 elsewhere, with half-cosine flanks outside, shape (n,).

    Parameters
    ----------
    n, start, stop : int
        Length, and the samples that hold the pulse.
    taper : int
        Samples of each flank.

    Examples
    --------
    >>> force_window(6, 2, 4)
    array([0., 0., 1., 1., 0., 0.])
    """
    if not 0 <= start < stop <= n:
        raise EstimationError(f"force window from sample {start} to {stop} does not lie within the hit's {n} samples")
    index = np.arange(n)
    distance = np.maximum(start - index, index - (stop - 1)).clip(0)
    if taper <= 0:
        return (distance == 0).astype(float)
    return np.where(distance <= taper, 0.5 + 0.5 * np.cos(np.pi * np.minimum(distance / (taper + 1), 1)), 0.0)
