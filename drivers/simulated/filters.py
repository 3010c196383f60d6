"""Reconstruction and anti-alias filters of the simulated converters: linear phase, flat to 0.43 of the rate."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import oaconvolve

HALF = 32
"""Frames that the filters reach to either side."""

_BETA = 13.0


def kernel(t: NDArray) -> NDArray[np.float64]:
    """Kaiser-windowed sinc at `t` in frames: half the rate passes with -6 dB, 0.57 of it with -120 dB."""
    t = np.asarray(t, float)
    inside = np.clip(1 - (t / HALF) ** 2, 0, None)
    window = np.where(np.abs(t) < HALF, np.i0(_BETA * np.sqrt(inside)) / np.i0(_BETA), 0.0)
    return np.sinc(t) * window


class Interpolator:
    """Values between the frames of a sampled waveform, `oversample` a frame."""

    def __init__(self, oversample: int) -> None:
        self.oversample = oversample
        fraction = np.arange(oversample) / oversample
        # frame n + r/os = sum over j of x[n + j] kernel(r/os - j), j = 1 - HALF ... HALF
        self._taps = kernel(fraction[:, None] - np.arange(1 - HALF, HALF + 1)[None, :])

    def run(self, samples: NDArray) -> NDArray[np.float64]:
        """Fine samples of frames HALF - 1 ... n - HALF - 1 of `samples` (n,): shape ((n - 2 HALF + 1) oversample,)."""
        if self.oversample == 1:
            return np.array(samples[HALF - 1 : samples.size - HALF], float)
        windows = np.lib.stride_tricks.sliding_window_view(np.asarray(samples, float), 2 * HALF)
        return (windows @ self._taps.T).ravel()


class Decimator:
    """Every frame's value from fine samples, each channel with its own delay; streaming.

    Parameters
    ----------
    oversample : int
        Fine samples a frame.
    delay : array_like, shape (n_channels,)
        Frames (fractions too) by which each channel comes late; not negative.
    """

    def __init__(self, oversample: int, delay: NDArray) -> None:
        delay = np.asarray(delay, float)
        self.oversample = oversample
        self.back = HALF + int(np.ceil(delay.max(initial=0.0)))
        j = np.arange(-self.back, HALF + 1)
        fine = j[:, None] + np.arange(oversample)[None, :] / oversample
        taps = kernel(-delay[:, None, None] - fine[None])
        taps = taps / taps.sum(axis=(1, 2), keepdims=True)
        self._taps = np.ascontiguousarray(taps.reshape(delay.size, -1))
        self._pick = oversample == 1 and not delay.any()
        self.reset()

    def reset(self) -> None:
        """Forget what came before: silence."""
        self._fine = np.zeros((len(self._taps), self.back * self.oversample))

    @property
    def latency(self) -> int:
        """Frames that must follow before a frame can be given."""
        return HALF

    def run(self, fine: NDArray) -> NDArray[np.float64]:
        """Frames that can be given now, shape (n_channels, n)."""
        over = self.oversample
        x = np.hstack([self._fine, fine])
        n = max(x.shape[1] // over - self.back - HALF, 0)
        self._fine = x[:, n * over :]
        if self._pick:
            return x[:, self.back : self.back + n].copy()
        return _filtered(x, self._taps, over, n)


@njit(cache=True, fastmath=True)
def _filtered(x, taps, over, n):  # pragma: no cover - compiled
    """Sum over k of x[c, i over + k] taps[c, k], i = 0 ... n - 1; fast because the order of the sum is free."""
    out = np.empty((x.shape[0], n))
    for c in range(x.shape[0]):
        for i in range(n):
            total = 0.0
            for k in range(taps.shape[1]):
                total += x[c, i * over + k] * taps[c, k]
            out[c, i] = total
    return out


class Shaper:
    """Any transfer function of each channel, as a filter of `LENGTH` frames; streaming.

    Parameters
    ----------
    factors : sequence of callable or None
        Frequencies in Hz -> complex factor, for each channel; None leaves the channel as it is.
    rate : float
        Frames per s.
    """

    def __init__(self, factors: Sequence[Callable[[NDArray], NDArray] | None], rate: float) -> None:
        self.latency = HALF if any(f is not None for f in factors) else 0
        self._taps = [None if f is None else _impulse_response(f, rate) for f in factors]
        self.reset()

    def reset(self) -> None:
        """Forget what came before: silence."""
        self._past = np.zeros((len(self._taps), LENGTH - 1 - HALF if self.latency else 0))

    def run(self, frames: NDArray) -> NDArray[np.float64]:
        """Frames that can be given now: `latency` fewer in all than came in."""
        if not self.latency:
            return frames
        x = np.hstack([self._past, frames])
        n = max(x.shape[1] - LENGTH + 1, 0)
        self._past = x[:, n:]
        late = x[:, LENGTH - 1 - HALF : LENGTH - 1 - HALF + n]
        rows = [late[i] if t is None else oaconvolve(x[i], t, "valid") for i, t in enumerate(self._taps)]
        return np.array(rows).reshape(len(self._taps), n) if n else np.zeros((len(self._taps), 0))


LENGTH = 16384
"""Frames of the impulse responses of `Shaper`."""


def _impulse_response(factor: Callable[[NDArray], NDArray], rate: float) -> NDArray[np.float64]:
    """Taps from HALF frames before to LENGTH - HALF - 1 after; near half the rate the factor becomes real."""
    frequency = np.fft.rfftfreq(LENGTH, 1 / rate)
    frequency[0] = 1e-6 * rate / LENGTH
    value = np.asarray(factor(frequency), complex)
    share = np.clip((frequency / rate - 0.44) / 0.06, 0, 1)
    value = value + share**2 * (3 - 2 * share) * (np.real(value) - value)
    return np.roll(np.fft.irfft(value, LENGTH), HALF)


@njit(cache=True)
def highpass(x, pole, state):  # pragma: no cover - compiled
    """First-order high-pass in place, exact for inputs that are straight between samples.

    Parameters
    ----------
    x : ndarray, shape (n_channels, n)
    pole : ndarray, shape (n_channels,)
        Corner times step, omega_c T; 0 passes all.
    state : ndarray, shape (2, n_channels)
        What the capacitor holds, and the sample before.
    """
    for c in range(x.shape[0]):
        a = pole[c]
        if a == 0.0:
            continue
        e = np.exp(-a)
        late = 1.0 - (1.0 - e) / a
        early = (1.0 - e) / a - e
        low, before = state[0, c], state[1, c]
        for k in range(x.shape[1]):
            now = x[c, k]
            low = e * low + early * before + late * now
            before = now
            x[c, k] = now - low
        state[0, c], state[1, c] = low, before
