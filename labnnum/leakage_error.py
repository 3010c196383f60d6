"""Random error of an H1 estimate that leakage alone makes, from the model: its size, and how lines share it.

Even without any noise, segments of finite length of a random excitation give an FRF that scatters, most of all near
lightly damped resonances. That part of the error is shared between lines and between overlapping segments in
another way than noise is: it largely cancels in a fit. A model of the structure predicts all of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError
from labnnum.windows import window as make_window

Model = Callable[[NDArray], NDArray]
"""FRFs of the responses, shape (n_out, n_f), at frequencies in Hz."""


@dataclass(frozen=True, eq=False)
class LeakageError:
    """What leakage adds to the random error of each line.

    Parameters
    ----------
    power : ndarray, shape (n_out, n_f)
        Leaked response power of one segment over the input's, per line: what leakage takes from the coherence.
    covariance, pseudo : ndarray, shape (n_lags, n_out, n_out, n_f)
        E[dH_o(f) conj(dH_p(f + m lines))] and E[dH_o(f) dH_p(f + m lines)] of the average, m = 0, 1, ...
    """

    power: NDArray[np.float64]
    covariance: NDArray[np.complex128]
    pseudo: NDArray[np.complex128]


def leakage_error(
    model: Model,
    lines: ArrayLike,
    *,
    window: str,
    n_segment: int,
    rate: float,
    overlap: float,
    n_averages: float,
    lags: int = 4,
    refine: int = 8,
    reach: int | None = None,
) -> LeakageError:
    r"""Covariance of the H1 error that leakage makes under one white random input.

    Parameters
    ----------
    model : callable
        FRFs of the responses to the one input, shape (n_out, n_f), at frequencies in Hz.
    lines : array_like, shape (n_f,)
        Lines of the estimate in Hz, multiples of rate / n_segment.
    window, n_segment, rate, overlap
        Of the Welch estimate.
    n_averages : float
        Its effective number of averages.
    lags : int
        Largest number of lines apart.
    refine : int
        Points of the fine grid for each line.
    reach : int, optional
        Lines to either side from which power leaks; 24 if not given, 96 under a boxcar, whose tails fall slowly.

    Notes
    -----
    With e_k = Y_k - \bar H X_k the leaked part of segment k, \bar H the model through the window, and Gaussian input,

    .. math:: E[\delta H(f)\, \overline{\delta H(g)}] = \frac{1}{(K P)^2} \sum_d (K - |d|)\,
              E[\overline{X_k(f)} X_{k+d}(g)] \; E[e_k(f) \overline{e_{k+d}(g)}]

    and likewise without the last bar, times n/(n - 1) for the scatter of the input's power. The expectations are
    integrals over the window's transform, the second
    \int W(f-\nu) \overline{W(g-\nu)} (H - \bar H(f)) \overline{(H - \bar H(g))} e^{-2\pi i \nu d h} d\nu.

    References
    ----------
    Antoni and Schoukens (2007), A comprehensive study of the bias and variance of frequency-response-function
    measurements.
    """
    reach = reach or (96 if window == "boxcar" else 24)
    grid = _Grid(window, int(n_segment), float(rate), int(refine), reach, lines, lags)
    hop = max(1, round(n_segment * (1 - overlap)))
    value, seen = grid.model(model)
    segments = _segments(grid.shape, hop, n_averages)
    reachable = (n_segment - 1) // hop
    shifts = [d for d in range(-reachable, reachable + 1) if abs(d) < segments]
    proper, improper = [], []
    for lag in range(lags + 1):
        pairs = [(segments - abs(d), grid.pair(value, seen, lag, d * hop)) for d in shifts]
        proper.append(np.sum([n * p.inputs * p.leaks for n, p in pairs], axis=0))
        improper.append(np.sum([n * p.backward[:, None] * p.forward[None] for n, p in pairs], axis=0))
    power = np.einsum("oof->of", grid.pair(value, seen, 0, 0).leaks).real / grid.total
    scale = n_averages / (n_averages - 1) / (segments * grid.total) ** 2
    return LeakageError(
        power, scale * np.asarray(proper, dtype=np.complex128), scale * np.asarray(improper, dtype=np.complex128)
    )


def _segments(shape: NDArray, hop: int, n_averages: float) -> float:
    """Number of segments that make so many effective averages."""
    power = float(shape @ shape)
    squares = [(float(shape[: -d * hop] @ shape[d * hop :]) / power) ** 2 for d in range(1, -(-shape.size // hop))]
    if not np.isfinite(n_averages) or n_averages < 2:
        raise EstimationError(f"the FRF has {n_averages:g} effective averages: its leakage cannot be judged")
    count = float(n_averages)
    for _ in range(50):
        lost = 1 + 2 * sum((1 - (d + 1) / count) * s for d, s in enumerate(squares) if d + 1 < count)
        count = float(n_averages) * lost
    return count


class _Grid:
    """Fine frequencies around each line, and the window's transform there."""

    def __init__(self, window: str, n: int, rate: float, refine: int, reach: int, lines: ArrayLike, lags: int) -> None:
        self.shape = np.asarray(make_window(window, n), float)
        self.refine, self.size, self.step = refine, n * refine, rate / n
        numbers = np.round(np.asarray(lines, float) / self.step).astype(int)
        self.every = np.unique(numbers[:, None] + np.arange(lags + 1))
        self.rows = np.stack([np.searchsorted(self.every, numbers + m) for m in range(lags + 1)])
        half = min(reach, n // 2 - 1) * refine
        self.offset = np.arange(-half, half + 1)
        self._whole = np.fft.fft(self.shape, self.size)
        self.total = float((np.abs(self.transform(0)) ** 2).sum())

    def transform(self, lag: int) -> NDArray[np.complex128]:
        """W(f + lag lines - nu) at each offset of nu from f, shape (n_offsets,)."""
        return self._whole[(lag * self.refine - self.offset) % self.size]

    def phase(self, shift: int) -> NDArray[np.complex128]:
        """exp(2 pi i nu shift) at each offset of nu."""
        return np.exp(2j * np.pi * ((self.offset * shift) % self.size) / self.size)

    def model(self, model: Model) -> tuple[NDArray, NDArray]:
        """The model around each line, shape (n_out, n_every, n_offsets), and through the window, (n_out, n_every)."""
        fine = self.every[:, None] * self.refine + self.offset
        wrapped = (fine + self.size // 2) % self.size - self.size // 2
        places, back = np.unique(np.maximum(np.abs(wrapped), 1), return_inverse=True)
        value = np.asarray(model(places * (self.step / self.refine)))[..., back.reshape(fine.shape)]
        value = np.where(wrapped < 0, value.conj(), value)
        return value, value @ np.abs(self.transform(0)) ** 2 / self.total

    def pair(self, value: NDArray, seen: NDArray, lag: int, shift: int) -> _Pair:
        """Expectations of line f with line g `lag` above it, and of segment k with l `shift` samples later."""
        first, second = self.rows[0], self.rows[lag]
        around = value[:, first]
        below, above = around - seen[:, first, None], around - seen[:, second, None]
        both = self.transform(0).conj() * self.transform(lag) * self.phase(shift)
        return _Pair(
            inputs=complex(both.sum()),
            leaks=np.einsum("ofx,pfx->opf", below * both.conj(), above.conj(), optimize=True),
            forward=above @ both,
            backward=below @ both.conj(),
        )


@dataclass(frozen=True, eq=False)
class _Pair:
    """E[conj X_k(f) X_l(g)], E[e_ok(f) conj e_pl(g)], E[conj X_k(f) e_l(g)], E[e_k(f) conj X_l(g)]; unit input."""

    inputs: complex
    leaks: NDArray[np.complex128]
    forward: NDArray[np.complex128]
    backward: NDArray[np.complex128]


def noise_share(
    variance: NDArray, leakage: LeakageError, n_averages: float, position: NDArray, width: int = 31, steps: int = 60
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    r"""What of a measured variance is noise, and which share of the predicted leakage is really there.

    Parameters
    ----------
    variance : ndarray, shape (n_out, n_f)
        E|dH|^2 as the coherence gives it.
    leakage : LeakageError
    n_averages : float
    position : ndarray of int, shape (n_f,)
        Numbers of the lines.
    width : int
        Neighbouring lines within which the noise is even, so that lines that leak little tell what the others hide.
    steps : int
        Of the iteration.

    Returns
    -------
    noise : ndarray, shape (n_out, n_f)
        Variance by noise.
    share : ndarray, shape (n_out, 1)
        1 where the excitation is random; less where it leaks less than that, as a burst does.

    Notes
    -----
    Each variance is taken as a gamma variate about (leaked power l + noise power s) / (n - 1). The s that is most
    likely within a window of lines is found by

    .. math:: s \leftarrow s\, \frac{\sum_i v_i / (l_i + s)^2}{\sum_i 1 / (l_i + s)}

    References
    ----------
    Fevotte, Bertin and Durrieu (2009), Nonnegative matrix factorization with the Itakura-Saito divergence.
    """
    near, real = _neighbours(position, width)
    leaked = np.maximum(leakage.power, 1e-300)
    power = variance * (n_averages - 1)
    measured, around = power[:, near], leaked[:, near]
    share = np.ones((len(variance), 1))
    noise = power.copy()
    for step in range(steps):
        expected = share[..., None] * around + noise[..., None]
        noise = noise * (real * measured / expected**2).sum(-1) / (real / expected).sum(-1)
        if step % 10 == 9:
            expected = share * leaked + noise
            weight = share * leaked / expected
            fit = (weight * power / expected).sum(-1, keepdims=True) / weight.sum(-1, keepdims=True)
            share = np.clip(share * fit, 1e-6, 1.0)
    return noise / (n_averages - 1), share


def _neighbours(position: NDArray, width: int) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """For each line the `width` lines nearest in order, and which of them lie within `width` line numbers."""
    n = position.size
    start = np.clip(np.arange(n) - width // 2, 0, max(n - width, 0))
    near = np.minimum(start[:, None] + np.arange(min(width, n)), n - 1)
    return near, np.abs(position[near] - position[:, None]) <= width
