"""The random error of an FRF: its size where nobody stated it, and how neighbouring lines share it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d

from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.updating.many import LARGEST
from labnnum.windows import window

_FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
_SMOOTH = 9
_ENOUGH = 40.0
_MEDIAN = 31
LAGS = 6
"""Lines to either side within which a window correlates errors."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Random error of the lines of an FRF.

    Parameters
    ----------
    variance : ndarray, shape (n_out, n_in, n_f)
        E|dH|^2, unbiased for each line.
    weight : ndarray, shape (n_out, n_in, n_f)
        2 / variance smoothed over neighbouring lines: weights that hardly depend on the sampling error of the
        variance itself.
    lags : ndarray, shape (n_lags,)
        Correlation of the errors of lines 0, 1, 2, ... apart, complex.
    position : ndarray of int, shape (n_f,)
        Place of each line on the even axis that `lags` counts on.
    estimated : bool
        The variance was estimated from the roughness of the FRF because none came with it.
    outputs : ndarray, shape (n_out, n_out, n_f), optional
        Complex correlation of the errors of the responses, where the estimator stated it.
    """

    variance: NDArray[np.float64]
    weight: NDArray[np.float64]
    lags: NDArray
    position: NDArray[np.int64]
    estimated: bool = False
    outputs: NDArray[np.complex128] | None = field(default=None)

    @property
    def memory(self) -> float:
        """Integrated correlation: how far the variance of a smooth sum over lines exceeds that of independent lines."""
        return max(1 + 2 * float(np.real(self.lags[1:]).sum()), 0.1)


def noise_of(frf: Frf, mask: NDArray[np.bool_] | None = None) -> Noise:
    """Noise of an Frf on the lines of `mask`, estimated from its roughness where it carries no variance."""
    chosen = np.ones(frf.frequency.size, bool) if mask is None else mask
    estimated = frf.variance is None
    value = np.where(np.abs(frf.value) <= LARGEST, frf.value, 0)  # lines that the bands leave out spoil no other
    variance = rough_variance(value) if frf.variance is None else np.asarray(frf.variance)
    if not np.isfinite(variance[..., chosen]).all() or (variance[..., chosen] < 0).any():
        raise EstimationError("the FRF's variance must be finite and not negative on every line of the bands")
    floor = _rounding(value)
    spoilt = ~(np.isfinite(variance) & (np.abs(frf.value) <= LARGEST))
    if spoilt.any():
        usual = np.median(variance[..., chosen], axis=-1, keepdims=True)
        variance = np.where(spoilt, usual, variance)
    smooth = np.maximum(smoothed(variance, _width(frf)), floor)
    step = _spacing(frf.frequency)
    position = np.round(frf.frequency[chosen] / step).astype(np.int64)
    return Noise(
        variance=np.maximum(variance, floor)[..., chosen],
        weight=2 / smooth[..., chosen],
        lags=np.ones(1, complex) if estimated else line_correlation(frf),
        position=position,
        estimated=estimated,
        outputs=_stated_correlation(frf, chosen),
    )


def _stated_correlation(frf: Frf, chosen: NDArray) -> NDArray[np.complex128] | None:
    stated = getattr(frf, "output_correlation", None)
    return None if stated is None else np.asarray(stated)[..., chosen]


def _rounding(value: NDArray) -> NDArray[np.float64]:
    """Least variance that arithmetic allows: (1e-12 of the largest |H| of each pair, and 1e-13 of |H|) squared."""
    size = np.abs(value)
    return (1e-13 * size) ** 2 + (1e-16 * size.max(axis=-1, keepdims=True)) ** 2 + 1e-280


def _spacing(frequency: NDArray) -> float:
    return float(np.min(np.diff(frequency))) if frequency.size > 1 else 1.0


def _width(frf: Frf) -> int:
    """Lines over which the variance is averaged before it becomes a weight: none where it is exact."""
    if not np.isfinite(frf.n_averages):
        return 1
    return int(np.clip(np.ceil(_ENOUGH / max(frf.n_averages, 1.0)), 1, _SMOOTH)) // 2 * 2 + 1


def smoothed(variance: NDArray, width: int = _SMOOTH) -> NDArray[np.float64]:
    """Running mean over `width` lines; the ends use what there is."""
    n = variance.shape[-1]
    if n < 3 or width <= 1:
        return np.array(variance, float)
    return uniform_filter1d(np.asarray(variance, float), min(width, n), axis=-1, mode="nearest")


def rough_variance(value: NDArray) -> NDArray[np.float64]:
    """Total variance of each line from fourth differences, shape of `value`; robust against resonances.

    A running median of |fourth difference|^2 is turned into a variance under complex Gaussian errors that are
    independent from line to line. Errors that an interpolation has smoothed pass unnoticed.
    """
    n = value.shape[-1]
    if n < 9:
        raise EstimationError(f"{n} lines are too few to estimate the FRF's noise: give its variance, or 9 lines")
    difference = sum(c * value[..., i : n - 4 + i] for i, c in enumerate(_FOURTH))
    power = np.abs(np.asarray(difference)) ** 2 / float((_FOURTH**2).sum())
    size = [1] * (value.ndim - 1) + [min(_MEDIAN, power.shape[-1])]
    middle = median_filter(power, size=size, mode="nearest") / np.log(2)
    return np.concatenate([middle[..., :1]] * 2 + [middle] + [middle[..., -1:]] * 2, axis=-1)


def line_correlation(frf: Frf) -> NDArray[np.complex128]:
    r"""Correlation E[e(f) conj(e(f + m))] of the errors of lines m = 0, 1, 2, ... apart, from the FRF's settings.

    Parameters
    ----------
    frf : Frf
        Its settings "window", "n_segment" and "overlap" are used, for hits "window_decay" and "pretrigger"; without
        a window the lines are taken as independent.

    Notes
    -----
    For random excitation an H1 error averages products of input and noise transforms, both correlated by the
    window: with segments d hops apart

    .. math:: r(m) \propto \sum_d |\rho_d(m)|^2,\quad
              \rho_d(m) = \sum_n w_n w_{n + d h} e^{-2\pi i m n/N} / \sum_n w_n^2

    A Hann window without overlap gives 1, 4/9, 1/36. The pulse of a hit is known at every line, so only the noise
    counts: r(m) is the transform of the squared exponential window, from the pulse on.
    """
    settings = frf.settings
    name, n_segment = settings.get("window"), settings.get("n_segment")
    if settings.get("periodic") or not isinstance(name, str) or not n_segment:
        return np.ones(1, complex)
    if settings.get("transient"):
        return _hit_correlation(settings)
    shape = np.asarray(window(name, min(int(n_segment), 1024)), float)
    return _window_correlation(shape, float(settings.get("overlap", 0.0) or 0.0)).astype(complex)


def _window_correlation(shape: NDArray, overlap: float) -> NDArray[np.float64]:
    n = shape.size
    hop = max(1, round(n * (1 - overlap)))
    total = np.zeros(LAGS + 1)
    for shift in range(0, n, hop):
        product = shape[: n - shift] * shape[shift:]
        transform = np.abs(np.fft.fft(product, n)[: LAGS + 1]) ** 2
        total += transform if shift == 0 else 2 * transform
    return _cut(total / total[0])


def _hit_correlation(settings: Mapping[str, Any]) -> NDArray[np.complex128]:
    n, decay = int(settings["n_segment"]), float(settings.get("window_decay", 0.0))
    after = np.arange(n) - int(settings.get("pretrigger", 0))
    power = np.exp(-2 * decay * np.maximum(after, 0) / float(settings["rate"]))
    turn = np.exp(2j * np.pi * np.arange(LAGS + 1)[:, None] * after / n)
    return _cut(turn @ power / power.sum())


def _cut(lags: NDArray) -> NDArray:
    return lags[: int(np.flatnonzero(np.abs(lags) > 1e-3)[-1]) + 1]
