"""Signals that drive the concealed truth: odd multisine with withheld lines, band-limited noise, hammer pulses."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray


def odd_multisine(
    rng: Generator, n: int, rate: float, band: tuple[float, float], group: int = 4
) -> NDArray[np.float64]:
    """One period, shape (n,), of unit RMS: odd lines of `band` with random phase, one of each `group` left out."""
    number = np.arange(1, n // 2, 2)
    frequency = number * rate / n
    number = number[(frequency >= band[0]) & (frequency <= band[1])]
    keep = np.ones(number.size, bool)
    for start in range(0, number.size - group + 1, group):
        keep[start + rng.integers(group)] = False
    number = number[keep]
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[number] = np.exp(2j * np.pi * rng.random(number.size))
    signal = np.fft.irfft(spectrum, n)
    return signal / np.std(signal)


def noise(rng: Generator, n: int, rate: float, band: tuple[float, float]) -> NDArray[np.float64]:
    """Gaussian noise, shape (n,), of unit RMS, flat over `band` with cosine flanks of a tenth of its ends."""
    frequency = np.fft.rfftfreq(n, 1 / rate)
    rise = np.clip((frequency - 0.9 * band[0]) / (0.1 * band[0]), 0, 1)
    fall = np.clip((band[1] - frequency) / (0.05 * band[1]), 0, 1)
    shape = np.sin(np.pi / 2 * rise) * np.sin(np.pi / 2 * fall)
    spectrum = shape * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size))
    signal = np.fft.irfft(spectrum, n)
    return signal / np.std(signal)


def pulse(rng: Generator, n: int, rate: float, start: float, reach: float) -> NDArray[np.float64]:
    """A hammer blow of unit peak, shape (n,), centred `start` seconds in, whose spectrum is 20 dB down at `reach` Hz.

    The flanks differ a little from blow to blow, as tips and hands do; the spectrum is far down at half the rate.
    """
    width = np.sqrt(np.log(10.0)) / (np.pi * reach)
    width *= 1 + 0.08 * rng.standard_normal()
    lean = np.clip(0.15 * rng.standard_normal(), -0.3, 0.3)
    time = np.arange(n) / rate - start
    body = np.exp(-((time / width) ** 2))
    tail = np.exp(-(((time - 0.9 * width) / (0.9 * width)) ** 2))
    blow = body + lean * tail
    return blow / np.max(blow)


def chirp(n: int, rate: float, band: tuple[float, float], down: bool = False) -> NDArray[np.float64]:
    """A sine that sweeps linearly through the band, up or down, shape (n,), of unit RMS."""
    time, last = np.arange(n) / rate, n / rate
    start, stop = (band[1], band[0]) if down else band
    phase = 2 * np.pi * (start * time + (stop - start) * time**2 / (2 * last))
    return np.sqrt(2.0) * np.sin(phase)
