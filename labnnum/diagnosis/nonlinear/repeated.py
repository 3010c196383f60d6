"""Whether a structure answers the same signal at two levels alike: line by line, whatever leaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from labnnum.diagnosis.nonlinear.floor import floor_of
from labnnum.recording import Recording
from labnnum.rest import begins_at_rest

WITHIN = 2.0
"""Power of what two inputs differ by, of that of their noise, up to which they are one signal."""
DRIVEN = 1e-4
"""Power of the input, of that of its strongest line, above which a line counts."""
BLOCKS, LEAST = 200, 100
"""Stretches of lines that are judged one by one, and how many lines each has at least."""
APART, ALSO = 4.0, 2.0
"""Power of what two responses differ by, of that of their noise, above which chance does not make them differ in a
stretch of lines; and above which a second channel bears that out."""
AROUND = 15
"""Lines over which that is averaged around one."""
END = 64
"""Part of a record over which it ends."""
SENSORS = 1e-3
"""Size of what they differ by, of the response there, below which it is no more than what sensors and amplifiers do."""


@dataclass(frozen=True, eq=False)
class Difference:
    """What the responses to one signal differ by at two levels, the louder one less as many times the other as its
    signal is larger.

    `frequency` (n_lines,) of the lines that are driven, Hz; `apart` (n_out, n_lines), its power; `there`, that of the
    louder responses; `noise` (n_out,), what noise leaves in `apart`.
    """

    frequency: NDArray[np.float64]
    apart: NDArray[np.float64]
    there: NDArray[np.float64]
    noise: NDArray[np.float64]

    @property
    def largest(self) -> NDArray[np.float64]:
        """Power over noise (n_out,), the largest of all stretches of lines."""
        size = max(self.frequency.size // BLOCKS, LEAST)
        m = self.frequency.size // size * size

        def mean(power: NDArray) -> NDArray[np.float64]:
            return power[:, :m].reshape(power.shape[0], -1, size).mean(axis=2)

        return np.max(self._ratio(mean(self.apart), mean(self.there)), axis=1)

    def telling(self, frequency: NDArray) -> NDArray[np.bool_]:
        """Whether some response differs around each of other lines (n,), in Hz."""
        smooth = (uniform_filter1d(power, AROUND, axis=1, mode="nearest") for power in (self.apart, self.there))
        some = np.max(self._ratio(*smooth), axis=0) > APART
        near = np.clip(np.searchsorted(self.frequency, frequency), 0, some.size - 1)
        inside = (frequency >= self.frequency[0]) & (frequency <= self.frequency[-1])
        return some[near] & inside

    def _ratio(self, apart: NDArray, there: NDArray) -> NDArray[np.float64]:
        return np.where(apart > SENSORS**2 * there, apart / np.maximum(self.noise[:, None], 1e-300), 0.0)


def answers_apart(low: Recording, high: Recording, need: int) -> bool:
    """Whether `need` responses at least are not as many times larger as the signal is, one of them surely."""
    found = difference(low, high)
    if found is None:
        return False
    largest = found.largest
    return bool(np.max(largest) > APART and np.count_nonzero(largest > ALSO) >= need)


def difference(low: Recording, high: Recording) -> Difference | None:
    """What the responses to one signal at two levels differ by; None where the inputs are not one, but for noise.

    Of a linear structure the response to a signal `a` times as large is `a` times as large, with all that leaks, rings
    on from before and is wrong with any FRF. Nothing but noise is left in the difference, and that is known from
    stretches of the spectra in which nothing is driven. It sees what no two FRFs show, whose estimates leak: as nothing
    leaks out of noise, no window takes the ends of a sweep away from it, and with them the modes that it passes there.
    """
    n = min(low.data.shape[1], high.data.shape[1])
    i = low.inputs[0]
    if low.rate != high.rate or list(low.outputs) != list(high.outputs) or high.inputs[0] != i or n < 4 * LEAST:
        return None
    window = np.hanning(n + 1)[:-1]
    x, y = (r.data[:, :n] - np.average(r.data[:, :n], axis=1, weights=window)[:, None] for r in (low, high))
    one, other = (np.fft.rfft(z * window, axis=1) for z in (x, y))
    kept = _kept([low, high], window)
    power = np.abs(np.fft.rfft(x[i] * kept)) ** 2
    on = np.flatnonzero(power > DRIVEN * power.max())
    if on.size < 2 * LEAST:
        return None
    factor = float(np.vdot(one[i, on], other[i, on]).real / np.vdot(one[i, on], one[i, on]).real)
    noise = floor_of(other) + factor**2 * floor_of(one)
    noise *= np.sum(kept**2) / np.sum(window**2)
    left = np.abs(np.fft.rfft((y - factor * x) * kept, axis=1)[:, on]) ** 2
    if left[i].mean() > WITHIN * noise[i]:
        return None
    outputs = list(low.outputs)
    there = np.abs(np.fft.rfft(y[outputs] * kept, axis=1)[:, on]) ** 2
    return Difference(on * low.rate / n, left[outputs], there, noise[outputs])


def _kept(records: list[Recording], window: NDArray) -> NDArray[np.float64]:
    """What of a record (n,) counts in the difference: all of it, but for what may ring on from before its beginning,
    and a short end that closes softly, else what sensors do would count as larger everywhere.
    """
    n = window.size
    at_rest = all((0, n) in r.spans() and begins_at_rest(r.data[:, :n], r.inputs[0]) for r in records)
    kept = np.ones(n) if at_rest else np.where(np.arange(n) < n // 2, window, 1.0)
    end = n // END
    kept[n - end :] *= np.cos(np.pi / 2 * np.arange(1, end + 1) / end) ** 2
    return kept
