"""One run as the nonlinear diagnosis sees it: spectra of input and responses, noise, what was excited."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.recording import Channel


@dataclass(frozen=True, eq=False)
class Run:
    """Response to a periodic input, to a hit, or a stretch of a record that is neither.

    Spectra are amplitudes: x(t) = Re sum_k X_k exp(s_k t), lines k = 0 ... n/2, with s = decay + i omega. Three kinds
    of run differ in what their ends do:

    - periodic (`decay` 0, not `open`): the state after n samples is that at the beginning
    - a hit (`decay` > 0): at rest before the first sample; the spectra are those of exp(-decay t) x(t)
    - open: neither; the beginning is forgotten on the way, and lines are compared through a Hann window over the
      stretch, that is by three neighbours each, so that what the ends have wrong does not count

    Parameters
    ----------
    rate : float
        Hz.
    period : int
        Samples, n.
    u : ndarray, shape (n_lines,)
        Input.
    y : ndarray, shape (n_out, n_lines)
    noise : ndarray, shape (n_out, n_lines)
        E|error|^2 of the responses that noise leaves in the mean over periods, that of the input included; NaN
        from a single period.
    excited : ndarray of bool, shape (n_lines,)
    level : float
        RMS of the input.
    """

    rate: float
    period: int
    u: NDArray[np.complex128]
    y: NDArray[np.complex128]
    noise: NDArray[np.float64]
    excited: NDArray[np.bool_]
    level: float
    label: str
    outputs: tuple[Channel, ...]
    input: Channel
    n_periods: int
    decay: float = 0.0
    open: bool = False
    use: NDArray[np.bool_] | None = None
    """Lines that may be compared, where they are fewer than those inside."""
    telling: NDArray[np.bool_] | None = None
    """Lines on which the response is known to differ from level to level, where they are few."""
    miss: float = 0.0
    """What the base model is known to miss, RMS over all lines of a response, relative."""

    @property
    def key(self) -> tuple[int, float, float]:
        """Samples, rate and decay: runs that share them share their lines s."""
        return self.period, self.rate, self.decay

    @property
    def lasting(self) -> bool:
        """Whether the steady state closes over the period."""
        return not (self.open or self.decay)

    @property
    def frequency(self) -> NDArray[np.float64]:
        """Hz, shape (n_lines,)."""
        return np.arange(self.u.size) * self.rate / self.period

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Lines from the first to the last that was excited."""
        at = np.flatnonzero(self.excited)
        out = np.zeros(self.excited.size, bool)
        out[at[0] : at[-1] + 1] = True
        return out

    @property
    def compared(self) -> NDArray[np.bool_]:
        """Lines on which model and measurement may be compared."""
        return self.inside if self.use is None else self.inside & self.use

    @property
    def quiet(self) -> NDArray[np.bool_]:
        """Detection lines: inside, not excited."""
        return self.inside & ~self.excited

    @property
    def unsure(self) -> NDArray[np.float64]:
        """Power of the noise over that of each response, (n_out,), on the lines compared; NaN from a single period."""
        at = self.compared
        power = np.sum(np.abs(self.seen(self.y)[:, at]) ** 2, axis=1)
        return np.sum(self.noise[:, at], axis=1) / np.maximum(power, 1e-300)

    def seen(self, spectra: NDArray) -> NDArray:
        """Spectra (..., n_lines) as they are compared: through a Hann window where the run is open."""
        return hann_of(spectra) if self.open else spectra


def precise(run: Run) -> type[np.complex64] | type[np.complex128]:
    """Precision that transforms from the run's lines to time need: single, but where a window is taken off at last."""
    return np.complex128 if run.decay else np.complex64


def hann_of(spectra: NDArray) -> NDArray:
    """Spectra (..., n_lines) of the same signals under a Hann window over the period."""
    out = 0.5 * spectra
    out[..., 1:] -= 0.25 * spectra[..., :-1]
    out[..., :-1] -= 0.25 * spectra[..., 1:]
    out[..., 0] -= 0.25 * np.conj(spectra[..., 1])  # the neighbour below zero
    return out


def run_of(
    spectra: NDArray, on: NDArray, inputs: list[int], outputs: list[int], rate: float, period: int, level: float,
    label: str, channels: tuple[Channel, ...],
) -> Run:  # fmt: skip
    """The run of period spectra (n_periods, n_channels, n_lines), each scaled by 2/n, with excited lines `on`."""
    from scipy.ndimage import uniform_filter1d

    lines = np.flatnonzero(on)
    spectra = spectra[settled(spectra[:, outputs, lines[0] : lines[-1] + 1])]
    mean = spectra.mean(axis=0)
    u, y = mean[inputs[0]].copy(), mean[outputs]
    u[: lines[0]] = 0.0  # noise alone, which a free structure would take far
    n_periods = spectra.shape[0]
    if n_periods > 1:
        h = y[:, on] / u[on]
        grid = np.arange(on.size)
        through = np.array([np.interp(grid, lines, r.real) + 1j * np.interp(grid, lines, r.imag) for r in h])
        each = spectra - mean
        between = (grid >= lines[0]) & (grid <= lines[-1])  # what is recorded as input there is noise too
        error = each[:, outputs] - np.where(between, through, 0.0) * each[:, inputs[0]][:, None]
        noise = np.mean(np.abs(error) ** 2, axis=0) / (n_periods - 1)
        noise = uniform_filter1d(noise, min(25, max(noise.shape[1] // 8, 1)), axis=1, mode="nearest")
    else:
        noise = _beyond(y, on)
    made = Run(
        rate, period, u, y, noise, on, level, label, tuple(channels[i] for i in outputs), channels[inputs[0]],
        n_periods,
    )  # fmt: skip
    return resampled(made)


STEADIER = 0.5
"""Part of the variance of the mean over all periods to which fewer of them must bring it to be taken instead."""
ROUNDING = 1e-9
"""Relative deviation of that mean below which the periods are one."""


def settled(spectra: NDArray) -> slice:
    """The periods of a run, one after the other and two at least, whose mean is the surest by what they differ by.

    Noise makes that all of them. A structure that still moves into its steady state at the beginning, or leaves one for
    another in the middle, differs there by far more than noise, and the mean over all is no steady state.

    Parameters
    ----------
    spectra : ndarray, shape (n_periods, n_out, n_lines)
    """
    n = spectra.shape[0]
    size = np.sum(np.abs(spectra) ** 2, axis=(0, 2)) + 1e-300

    def variance(a: int, b: int) -> float:
        apart = spectra[a:b] - spectra[a:b].mean(axis=0)
        return float(np.sum(np.sum(np.abs(apart) ** 2, axis=(0, 2)) / size)) / ((b - a) * (b - a - 1))

    if n < 3:
        return slice(0, n)
    windows = [(a, b) for a in range(n) for b in range(a + 2, n + 1)]
    a, b = min(windows, key=lambda w: variance(*w))
    every = variance(0, n)
    return slice(a, b) if every > ROUNDING**2 and variance(a, b) < STEADIER * every else slice(0, n)


ROOM = 2.8
"""Samples to a period of the highest excited line that a run keeps."""


def resampled(run: Run) -> Run:
    """The run on fewer samples where it was sampled far faster than it was excited: lines far above are dropped."""
    from scipy.fft import next_fast_len

    least = int(np.ceil(ROOM * np.flatnonzero(run.excited)[-1] / 2))
    n = 2 * int(next_fast_len(max(least, 32), real=True) or 0)
    if n >= run.period:
        return run
    keep = slice(0, n // 2 + 1)
    return replace(
        run, rate=run.rate * n / run.period, period=n, u=run.u[keep], y=run.y[:, keep], noise=run.noise[:, keep],
        excited=run.excited[keep], use=None if run.use is None else run.use[keep],
        telling=None if run.telling is None else run.telling[keep],
    )  # fmt: skip


EVENLY, BLOCKS = 0.1, 12
"""Power of the input in the middle of a stretch, of the whole one's, in each of some blocks of lines below which it is
a sweep, whose parts are of other bands."""


def shortened(run: Run, part: float) -> Run:
    """The middle `part` of a stretch of noise as a run of its own; the run itself where it is a sweep or no stretch."""
    from scipy.fft import next_fast_len

    n = 2 * int(next_fast_len(max(int(part * run.period) // 2, 32), real=True) or 0)
    if not run.open or n >= run.period:
        return run
    first = (run.period - n) // 2
    x = np.fft.irfft(np.vstack([run.u, run.y]), run.period, axis=1)[:, first : first + n] * (run.period / 2)
    x = x - np.average(x, axis=1, weights=np.hanning(n + 1)[:-1])[:, None]
    spectra = np.fft.rfft(x, axis=1) * (2 / n)
    at = np.minimum(np.round(np.arange(n // 2 + 1) * run.period / n).astype(int), run.u.size - 1)
    here, there = np.flatnonzero(run.excited[at]), np.flatnonzero(run.excited)
    if here.size < BLOCKS:
        return run
    blocks = zip(np.array_split(here, BLOCKS), np.array_split(there, BLOCKS), strict=True)
    powers = [[np.mean(np.abs(u[i]) ** 2) for u, i in zip((spectra[0], run.u), ij, strict=True)] for ij in blocks]
    if any(own * n < EVENLY * whole * run.period for own, whole in powers):
        return run
    return replace(
        run, period=n, u=spectra[0], y=spectra[1:], noise=run.noise[:, at] * (run.period / n), excited=run.excited[at],
        use=None if run.use is None else run.use[at], telling=None if run.telling is None else run.telling[at],
    )  # fmt: skip


def _beyond(y: NDArray, on: NDArray) -> NDArray[np.float64]:
    """Noise of a single period, taken as flat from the lines above the band; NaN where there are fewer than 20."""
    top = int(1.08 * np.flatnonzero(on)[-1])
    above = y[:, top : int(0.98 * y.shape[1])]
    if above.shape[1] < 20:
        return np.full(y.shape, np.nan)
    level = np.median(np.abs(above) ** 2, axis=1) / np.log(2)
    return np.repeat(level[:, None], y.shape[1], axis=1)
