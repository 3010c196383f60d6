"""Harmonics of one swept sine: power at orders 2, 3, ... of the response against the frequency that is played."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.signal import hilbert

from labnnum.errors import ChannelError, EstimationError
from labnnum.recording import Channel, Recording
from labnnum.rest import goes_up

__all__ = ["Orders", "is_sweep", "orders"]

CYCLES = 12.0
"""Cycles of the fundamental in a block, and samples of it for each value that is fitted, at least."""
SAMPLES = 6.0
DEGREE = 2
"""Degree of the polynomials of time by which an amplitude changes over a block."""
PHASE = 3
"""Degree of the polynomial of time that the phase of the input is over a block."""
EDGE = 1.0
"""Blocks at either end of a sweep that are left out, where it is faded and its phase is told badly."""
LOUD = 0.1
"""Amplitude of the input, of its median, below which a block is left out."""
TOP = 0.95
"""Part of half the sample rate up to which an order is told."""


@dataclass(frozen=True, eq=False)
class Orders:
    """Amplitudes at multiples of the frequency that a sweep is at.

    Parameters
    ----------
    frequency : ndarray, shape (n_blocks,)
        Hz, of the input in the middle of each block, ascending.
    order : tuple of int
        From 1.
    amplitude : ndarray, shape (n_ch, n_orders, n_blocks)
        Magnitude of the order, in the channel's unit; NaN above the rate's half.
    noise : ndarray, shape (n_ch, n_orders, n_blocks)
        Root of the mean square that what no order explains leaves in an amplitude: the floor under it.
    channels : tuple of Channel
        The input first, then the responses.
    """

    frequency: NDArray[np.float64]
    order: tuple[int, ...]
    amplitude: NDArray[np.float64]
    noise: NDArray[np.float64]
    channels: tuple[Channel, ...]

    def decibels(self, channel: int) -> NDArray[np.float64]:
        """Orders from 2 on in dB relative to the fundamental of the same block, shape (n_orders - 1, n_blocks)."""
        return 20 * np.log10(np.maximum(self.amplitude[channel, 1:], 1e-300) / self.amplitude[channel, 0])

    def floor(self, channel: int) -> NDArray[np.float64]:
        """The noise floor of the same, shape (n_orders - 1, n_blocks)."""
        return 20 * np.log10(np.maximum(self.noise[channel, 1:], 1e-300) / self.amplitude[channel, 0])

    def table(self) -> list[dict]:
        """A row for each channel and order from 2 on, ready for JSON: channel, order, the power over the sweep in dB of
        that of the fundamental there, noise taken out, and of the floor; the largest of single blocks in dB and the
        frequency that is played then, of those that stand `CLEAR` above their floor; None where nothing does.
        """
        rows = []
        for i, channel in enumerate(self.channels):
            for m, order in enumerate(self.order[1:], 1):
                known = np.isfinite(self.amplitude[i, m])
                if not known.any():
                    continue
                base = np.sum(self.amplitude[i, 0, known] ** 2)
                floor = np.sum(self.noise[i, m, known] ** 2)
                own = np.sum(self.amplitude[i, m, known] ** 2) - floor
                clear = self.amplitude[i, m] > CLEAR * self.noise[i, m]
                level = np.where(clear, self.decibels(i)[m - 1], -np.inf)
                at = int(np.argmax(level))
                rows.append(
                    {
                        "channel": channel.name,
                        "order": order,
                        "power_db": _db(own / base) if clear.any() else None,
                        "floor_db": _db(floor / base),
                        "largest_db": float(level[at]) if clear.any() else None,
                        "at_hz": float(self.frequency[at]) if clear.any() else None,
                    }
                )
        return rows


CLEAR = 4.0
"""Amplitude of an order, of what noise leaves in it, above which it is there: by chance one of e^16 is."""


def _db(power: float) -> float:
    return float(10 * np.log10(max(power, 1e-30)))


def is_sweep(u: NDArray) -> bool:
    """Whether a signal (n,) is one sine whose frequency rises, or falls, all the way."""
    return goes_up(u) or goes_up(u[::-1])


def orders(recording: Recording, highest: int = 5) -> Orders:
    r"""Harmonics of the responses to one sweep, and of the input itself.

    Parameters
    ----------
    recording : Recording
        One input, a sine that sweeps up or down by whatever law; with `period` set the mean of its steady periods is
        taken, each one sweep. The longest span without a gap is used.
    highest : int
        Order up to which is looked, 2 at least.

    Returns
    -------
    Orders

    Raises
    ------
    ChannelError
        There is not one input.
    EstimationError
        The input is no sweep, or has too few cycles.

    Notes
    -----
    Order tracking: over blocks of `CYCLES` cycles or more, under a Hann window, every channel is fitted by least
    squares with

    .. math:: x(t) = \sum_{m=0}^{M} p_m(t) \cos m\varphi(t) + q_m(t) \sin m\varphi(t)

    p and q polynomials of the time, and the phase that of the input's analytic signal, smoothed over the block. All
    orders are fitted at once, so that none leaks into another; what is left tells the noise. What still rings at a
    resonance that the sweep has passed is no order, and counts as noise where it is heard. An order of the response to
    a slow sweep is that of a steady sine; the input's own harmonics are told beside it, since a shaker makes some.

    References
    ----------
    Farina (2000), Simultaneous measurement of impulse response and distortion with a swept-sine technique (harmonics of
    a sweep apart); Vold and Leuridan (1993), High resolution order tracking (amplitudes along a known phase).
    """
    if len(recording.inputs) != 1:
        raise ChannelError(f"{recording.label}: harmonics of a sweep need one input, not {len(recording.inputs)}")
    if highest < 2:
        raise EstimationError(f"highest order is {highest}, expected 2 or more")
    rows = [recording.inputs[0], *recording.outputs]
    x = _swept(recording)[rows]
    x = x - x.mean(axis=1, keepdims=True)
    if not is_sweep(x[0]):
        raise EstimationError(f"{recording.label}: its input is no sine that sweeps up or down all the way")
    phase = _phase(x[0])
    turns = (phase - phase[0]) / (2 * np.pi)
    blocks = _blocks(turns, highest, recording.label)
    made = [_fitted(x, phase, a, b, recording.rate, highest) for a, b in blocks]
    found = [m for m in made if m is not None]
    loud = np.array([m[1][0, 0] for m in found])
    kept = [m for m, a in zip(found, loud, strict=True) if a > LOUD * np.median(loud)]
    if len(kept) < 2:
        raise EstimationError(f"{recording.label}: its sweep has too few cycles for harmonics")
    kept.sort(key=lambda m: m[0])
    return Orders(
        np.array([m[0] for m in kept]), tuple(range(1, highest + 1)), np.stack([m[1] for m in kept], axis=2),
        np.stack([m[2] for m in kept], axis=2), tuple(recording.channels[r] for r in rows),
    )  # fmt: skip


def _swept(recording: Recording) -> NDArray[np.float64]:
    """The samples (n_ch, n) of one sweep."""
    start, stop = max(recording.spans(), key=lambda span: span[1] - span[0])
    n, first = recording.period, start + recording.drop_periods * recording.period
    if n and stop - first >= n:
        count = (stop - first) // n
        return recording.data[:, first : first + count * n].reshape(-1, count, n).mean(axis=1)
    return recording.data[:, start:stop]


def _phase(u: NDArray) -> NDArray[np.float64]:
    """Phase (n,) of a sweep, ascending."""
    n = u.size
    return np.unwrap(np.angle(hilbert(u, next_fast_len(2 * n))[:n]))


def _blocks(turns: NDArray, highest: int, label: str) -> list[tuple[int, int]]:
    """Sample ranges of `CYCLES` cycles at least each, and enough samples, every one half over the next."""
    turns = np.maximum.accumulate(turns)
    least = int(SAMPLES * (2 * highest + 1) * (DEGREE + 1))
    at, last = (int(np.searchsorted(turns, edge)) for edge in (EDGE * CYCLES / 2, turns[-1] - EDGE * CYCLES / 2))
    out = []
    while True:
        stop = max(int(np.searchsorted(turns, turns[at] + CYCLES)), at + least)
        if stop > last:
            break
        out.append((at, stop))
        at = (at + stop) // 2
    if len(out) < 2:
        raise EstimationError(f"{label}: its sweep has {turns[-1]:.0f} cycles, too few for harmonics")
    return out


def _fitted(
    x: NDArray, phase: NDArray, a: int, b: int, rate: float, highest: int
) -> tuple[float, NDArray, NDArray] | None:
    """Frequency, amplitudes and noise (n_ch, n_orders) of one block; None where its frequency is not told."""
    t = np.linspace(-1, 1, b - a)
    smooth = np.polynomial.Polynomial.fit(t, phase[a:b], PHASE, domain=[-1, 1])
    per_block = (b - a - 1) / 2 / rate  # s to a unit of t
    frequency = float(smooth.deriv()(0.0)) / per_block / (2 * np.pi)
    if frequency <= 0:
        return None
    most = min(highest, int(TOP * rate / 2 / frequency))
    if most < 1:
        return None
    powers = t[:, None] ** np.arange(DEGREE + 1)
    waves = [np.ones(t.size)]
    for m in range(1, most + 1):
        waves += [np.cos(m * smooth(t)), np.sin(m * smooth(t))]
    columns = (np.array(waves).T[:, :, None] * powers[:, None, :]).reshape(t.size, -1)
    taper = np.hanning(t.size + 2)[1:-1]
    q, r = np.linalg.qr(columns * taper[:, None])
    y = x[:, a:b].T * taper[:, None]
    inner = q.T @ y
    left = y - q @ inner
    spread = np.sum(left**2, axis=0) / (np.sum(taper**2) - np.sum((q * taper[:, None]) ** 2))
    inverse = np.linalg.inv(r)
    value = (inverse @ inner)[:: DEGREE + 1]  # in the middle of the block, (2 most + 1, n_ch)
    # of noise as loud all over the block, and of what else is there
    covariance = np.sum((inverse[:: DEGREE + 1] @ (q * taper[:, None]).T) ** 2, axis=1)
    amplitude = np.full((x.shape[0], highest), np.nan)
    noise = amplitude.copy()
    amplitude[:, :most] = np.hypot(value[1::2], value[2::2]).T
    noise[:, :most] = np.sqrt(spread[:, None] * (covariance[1::2] + covariance[2::2]))
    return frequency, amplitude, noise
