"""Whether a structure answers the same signal at two levels alike: line by line, whatever leaks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.floor import floor_of
from labnnum.recording import Recording

WITHIN = 2.0
"""Power of what two inputs differ by, of that of their noise, up to which they are one signal."""
DRIVEN = 1e-4
"""Power of the input, of that of its strongest line, above which a line counts."""
BLOCKS, LEAST = 200, 100
"""Stretches of lines that are judged one by one, and how many lines each has at least."""
APART, ALSO = 4.0, 2.0
"""Power of what two responses differ by, of that of their noise, above which chance does not make them differ in a
stretch of lines; and above which a second channel bears that out."""
SENSORS = 1e-3
"""Size of what they differ by, of the response there, below which it is no more than what sensors and amplifiers do."""


def answers_apart(low: Recording, high: Recording, need: int) -> bool:
    """Whether `need` responses at least are not as many times larger as the signal is, one of them surely."""
    largest = differences(low, high)
    if largest is None:
        return False
    return bool(np.max(largest) > APART and np.count_nonzero(largest > ALSO) >= need)


def differences(low: Recording, high: Recording) -> NDArray[np.float64] | None:
    """By how much the responses (n_out,) to one signal at two levels differ: power over noise, the largest of all
    stretches of lines.

    Of a linear structure the response to a signal `a` times as large is `a` times as large, with all that leaks, rings
    on from before and is wrong with any FRF. Nothing but noise is left in the difference, and that is known from
    stretches of the spectra in which nothing is driven. It sees what no two FRFs show, whose estimates leak.

    None where the inputs are not one signal at two levels, but for noise.
    """
    n = min(low.data.shape[1], high.data.shape[1])
    i = low.inputs[0]
    if low.rate != high.rate or list(low.outputs) != list(high.outputs) or high.inputs[0] != i or n < 4 * LEAST:
        return None
    window = np.hanning(n + 1)[:-1]
    one, other = (np.fft.rfft(_centred(r.data[:, :n], window) * window, axis=1) for r in (low, high))
    power = np.abs(one[i]) ** 2
    on = np.flatnonzero(power > DRIVEN * power.max())
    if on.size < 2 * LEAST:
        return None
    factor = np.vdot(one[i, on], other[i, on]) / power[on].sum()
    left = np.abs(other[:, on] - factor * one[:, on]) ** 2
    noise = floor_of(other) + abs(factor) ** 2 * floor_of(one)
    if left[i].mean() > WITHIN * noise[i]:
        return None
    size = max(on.size // BLOCKS, LEAST)
    m = on.size // size * size
    outputs = list(low.outputs)

    def mean(power: NDArray) -> NDArray[np.float64]:
        return power[:, :m].reshape(len(outputs), -1, size).mean(axis=2)

    apart, there = mean(left[outputs]), mean(np.abs(other[outputs][:, on]) ** 2)
    ratio = np.where(apart > SENSORS**2 * there, apart / np.maximum(noise[outputs, None], 1e-300), 0.0)
    return np.max(ratio, axis=1)


def _centred(x: NDArray, window: NDArray) -> NDArray[np.float64]:
    return x - np.average(x, axis=1, weights=window)[:, None]
