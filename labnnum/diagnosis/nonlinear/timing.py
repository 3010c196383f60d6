"""Where distortion comes from, told by when it comes: its power over time against the motion at each place.

What a nonlinear force throws above the excited band follows the motion at its own place: stops are hit at one end of
the stroke, a slider lets go beyond one displacement. No model of the structure enters, so that a place whose
receptances were never measured (a joint with a sensor on either side, driven from elsewhere) can be told from its
neighbours. Both nodes of the place must carry sensors along one axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.locate import Spot
from labnnum.diagnosis.verdict import Limits
from labnnum.frf import MOTION_ORDER
from labnnum.recording import Recording

if TYPE_CHECKING:
    from labnnum.diagnosis.observe import Observation

CELLS = 12
"""Cells of the motion, and of its rate, of equal count each."""
GUARD = 1.3
"""Frequency, of the highest excited one, from which on a response counts as distortion."""
LEADS = 2.0
"""Share of the first place, of that of the second, from which the timing tells the place."""
HEARD = 4.0
"""Power of the distortion, of the noise that the periods show there, from which on it is looked at."""


@dataclass(frozen=True, slots=True)
class Timed:
    """A place, the share of the distortion's rise and fall that the motion there explains, and what that is worth.

    `gain` in units of chi-square: the number of independent values times -ln(1 - share), summed over the runs, each
    weighed by its distortion of the largest.
    """

    spot: Spot
    share: float
    gain: float


def timing(observations: Sequence[Observation], spots: Sequence[Spot]) -> list[Timed]:
    """Places by how well the motion there tells when the distortion comes, best first.

    Parameters
    ----------
    observations : sequence of Observation
        Periodic ones with their recordings; others are passed over.
    spots : sequence of Spot
        Places that lack a sensor are passed over.

    Returns
    -------
    list of Timed
        Empty where no run distorts above the excited band.
    """
    heard = [h for h in (_heard(o) for o in observations) if h is not None]
    if not heard:
        return []
    loudest = max(h.size for h in heard)
    out = []
    for spot in spots:
        gain = share = total = 0.0
        for h in heard:
            z = h.motion(spot)
            if z is None:
                break
            part = _explained(h.power, *z)
            weight = h.size / loudest
            gain += weight * h.count * -np.log1p(-max(part, 0.0))
            share += weight * part
            total += weight
        else:
            out.append(Timed(spot, share / total, float(gain)))
    return sorted(out, key=lambda t: -t.gain)


def told(timed: Sequence[Timed], limits: Limits) -> bool:
    """Whether the first place leads every other by what a name needs, and explains far more than the second.

    What a smooth law throws above the band comes through the structure's modes there, and follows no place for long.
    """
    if len(timed) < 2 or timed[0].share < LEADS * timed[1].share:
        return False
    return timed[0].gain > limits.alarm and timed[0].gain - timed[1].gain > limits.name


@dataclass(frozen=True, eq=False)
class _Heard:
    power: NDArray
    spectra: dict[str, NDArray]
    s: NDArray
    n: int
    count: float
    size: float

    def motion(self, spot: Spot) -> tuple[NDArray, NDArray] | None:
        axis = spot.axis.lstrip("-")
        ends = [f"{node}:{axis}" for node in (spot.place.id, spot.place.to) if node]
        if any(e not in self.spectra for e in ends):
            return None
        z = self.spectra[ends[0]] - (self.spectra[ends[1]] if len(ends) > 1 else 0.0)
        return np.fft.irfft(z, self.n), np.fft.irfft(self.s * z, self.n)


def _heard(o: Observation) -> _Heard | None:
    """Distortion above the band over one mean period, and the motions in the band; None where there is none."""
    if o.run is None or not o.recordings or not o.recordings[0].period:
        return None
    recording = o.recordings[0]
    n = recording.period
    x = np.fft.rfft(_periods(recording), axis=2)
    f = np.arange(x.shape[2]) * recording.rate / n
    on = o.run.frequency[o.run.excited]
    low, top = float(on[0]), float(on[-1])
    above = (f > GUARD * top) & (f < 0.45 * recording.rate)
    outputs = list(recording.outputs)
    if np.count_nonzero(above) < 64 or len(x) < 2:
        return None
    mean = x.mean(axis=0)
    noise = np.sum(np.abs(x[:, outputs] - mean[outputs])[:, :, above] ** 2, axis=(0, 2)) / (len(x) - 1) / len(x)
    loud = np.sum(np.abs(mean[outputs][:, above]) ** 2, axis=1)
    inside = (f >= 0.999 * low) & (f <= 1.001 * top)
    if np.median(loud / np.maximum(noise, 1e-300)) < HEARD:
        return None
    rest = np.fft.irfft(np.where(above, mean[outputs], 0.0) / np.sqrt(loud)[:, None], n, axis=1)
    power = np.sum(rest**2, axis=0)
    width = max(round(recording.rate / (GUARD * top) / 2), 1)
    power = np.convolve(np.concatenate([power[-width:], power, power[:width]]), np.ones(width) / width, "same")
    s = np.where(inside, 2j * np.pi * f, 1.0)
    spectra = {
        c.dof: np.where(inside, c.sign * mean[i] / s ** MOTION_ORDER[c.quantity], 0.0)
        for i, c in ((i, recording.channels[i]) for i in outputs)
    }
    signal = np.sum(np.abs(mean[outputs][:, inside]) ** 2, axis=1)
    return _Heard(
        np.log(power[width:-width] + 1e-300),
        spectra,
        s,
        n,
        2.0 * np.count_nonzero(inside),
        float(np.mean(loud / signal)),
    )


def _periods(recording: Recording) -> NDArray:
    n = recording.period
    out = []
    for start, stop in recording.spans():
        first = start + recording.drop_periods * n
        out += [recording.data[:, at : at + n] for at in range(first, stop - n + 1, n)]
    return np.array(out)


def _explained(power: NDArray, z: NDArray, v: NDArray) -> float:
    """Share of the variance of `power` (n,) that its means over cells of motion and rate explain, cells paid for."""
    n = power.size
    cell = [np.argsort(np.argsort(x)) * CELLS // n for x in (z, v)]
    key = cell[0] * CELLS + cell[1]
    count = np.bincount(key, minlength=CELLS**2)
    mean = np.bincount(key, power, CELLS**2) / np.maximum(count, 1)
    left = np.sum((power - mean[key]) ** 2) / (n - np.count_nonzero(count))
    return float(1.0 - left / np.var(power))
