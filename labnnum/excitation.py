"""Excitation signals: random, burst random, periodic random, multisines, chirps and stepped sines, all seeded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError

Shape = Callable[[NDArray], NDArray]
"""Relative amplitude at frequencies in Hz."""


@dataclass(frozen=True, eq=False)
class Drive:
    """Samples to play, in the unit of `rms`, and what an estimator must know about them.

    Parameters
    ----------
    samples : ndarray, shape (n,)
    rate : float
        Samples per second.
    kind : str
        "random", "burst random", "periodic random", "multisine", "chirp" or "stepped sine".
    period : int
        Samples in a period, 0 if the signal has none.
    lines : ndarray of int
        Excited lines, multiples of rate / period; empty if the signal has no period.
    detection : ndarray of int
        Lines inside the band that are left out on purpose, where only distortion can appear.
    seed : int
    """

    samples: NDArray[np.float64]
    rate: float
    kind: str
    period: int = 0
    lines: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, int))
    detection: NDArray[np.intp] = field(default_factory=lambda: np.empty(0, int))
    seed: int = 0

    @property
    def rms(self) -> float:
        """Root mean square over the whole signal."""
        return float(np.sqrt(np.mean(self.samples**2)))

    @property
    def crest_factor(self) -> float:
        """Largest magnitude over RMS."""
        return float(np.abs(self.samples).max() / self.rms)

    @property
    def duration(self) -> float:
        """Length in s."""
        return self.samples.size / self.rate

    @property
    def frequency(self) -> NDArray[np.float64]:
        """Excited lines in Hz."""
        return np.asarray(self.lines * (self.rate / max(1, self.period)), float)


def random(rate: float, n: int, band: tuple[float, float], rms: float = 1.0, seed: int = 0) -> Drive:
    """Gaussian noise with a flat spectrum inside the band and none outside, n samples.

    Parameters
    ----------
    rate : float
        Samples per second.
    n : int
        Samples.
    band : (low, high)
        Hz, 0 <= low < high <= rate / 2.
    rms : float
        Root mean square of the samples, exact.
    seed : int
        The same seed gives the same samples.

    Raises
    ------
    EstimationError
        The band does not fit the sample rate, or holds no line.

    Examples
    --------
    >>> d = random(1000.0, 4096, (5.0, 400.0), rms=0.4, seed=1)
    >>> round(d.rms, 12)
    0.4
    """
    lines = _lines_in(rate, n, band)
    return Drive(_scaled(_noise(lines, n, np.random.default_rng(seed)), rms), rate, "random", seed=seed)


def burst_random(
    rate: float,
    period: int,
    band: tuple[float, float],
    rms: float = 1.0,
    seed: int = 0,
    burst: float = 0.6,
    n_bursts: int = 1,
) -> Drive:
    """Bursts of fresh noise, each followed by silence in which the structure comes to rest.

    With segments of `period` samples, no overlap and a boxcar window nothing leaks, if the response has decayed.

    Parameters
    ----------
    rate, band, seed
        As for `random`.
    period : int
        Samples of a burst with its silence: the n_segment of the estimate.
    rms : float
        Over the whole signal, silences included.
    burst : float
        Share of the period that is noise, 0 < burst < 1.
    n_bursts : int
    """
    if not 0 < burst < 1:
        raise EstimationError(f"burst is {burst}: it must lie between 0 and 1")
    _require_count("n_bursts", n_bursts)
    lines = _lines_in(rate, period, band)
    length = max(2, round(burst * period))
    rng = np.random.default_rng(seed)
    flanks = _fade(length, max(1, length // 50))
    samples = np.zeros((n_bursts, period))
    for row in samples:
        row[:length] = _noise(lines, period, rng)[:length] * flanks
    return Drive(_scaled(samples.reshape(-1), rms), rate, "burst random", seed=seed)


def periodic_random(
    rate: float, period: int, band: tuple[float, float], rms: float = 1.0, seed: int = 0, n_periods: int = 1
) -> Drive:
    """One period of Gaussian noise, random in amplitude and phase, repeated n_periods times.

    For another realisation take another seed.
    """
    lines = _lines_in(rate, period, band)
    _require_count("n_periods", n_periods)
    one = _scaled(_noise(lines, period, np.random.default_rng(seed)), rms)
    return Drive(np.tile(one, n_periods), rate, "periodic random", period, lines, seed=seed)


def multisine(
    rate: float,
    period: int,
    band: tuple[float, float],
    rms: float = 1.0,
    seed: int = 0,
    *,
    odd: bool = True,
    detection: int = 4,
    n_periods: int = 1,
    phase: Literal["random", "schroeder"] = "random",
    shape: Shape | None = None,
    grid_seed: int | None = None,
) -> Drive:
    r"""Multisine with detection lines, n_periods periods.

    Parameters
    ----------
    rate, band, seed
        As for `random`.
    period : int
        Samples in a period; lines are rate / period apart.
    odd : bool
        Excite odd lines only, so that even distortion falls between them.
    detection : int
        Of each group of this many consecutive candidate lines one, at random, is left out; 0 leaves none out.
    n_periods : int
    phase : {"random", "schroeder"}
        Random phases suit linearisation; Schroeder's give a low crest factor.
    shape : callable, optional
        Relative amplitude at frequencies in Hz; flat if not given.
    grid_seed : int, optional
        Which lines are left out; as `seed` if not given. Realisations that shall be averaged need the same lines.

    Notes
    -----
    .. math:: u(t) = \sum_{k \in \text{lines}} A_k \cos(2\pi k t r / N + \varphi_k)

    References
    ----------
    Pintelon and Schoukens (2012), sections 4.3 and 5.3 (detection lines); Schroeder (1970), Synthesis of
    low-peak-factor signals.

    Examples
    --------
    >>> d = multisine(1024.0, 1024, (10.0, 100.0), rms=2.0, seed=3)
    >>> round(d.rms, 12), bool((d.lines % 2 == 1).all()), d.lines.size, d.detection.size
    (2.0, True, 34, 11)
    """
    candidates = _lines_in(rate, period, band)
    if odd:
        candidates = candidates[candidates % 2 == 1]
    candidates = candidates[(candidates > 0) & (2 * candidates < period)]
    _require_count("n_periods", n_periods)
    if detection < 0 or detection == 1:
        raise EstimationError(f"detection is {detection}: give 0, or 2 or more lines to a group")
    rng = np.random.default_rng(seed)
    lines, withheld = _withhold(candidates, detection, rng if grid_seed is None else np.random.default_rng(grid_seed))
    if not lines.size:
        raise EstimationError(f"band {band[0]:g} to {band[1]:g} Hz holds no line to excite; lengthen the period")
    amplitude = np.ones(lines.size) if shape is None else np.asarray(shape(lines * rate / period), float)
    if amplitude.shape != lines.shape or (amplitude < 0).any() or not amplitude.any():
        raise EstimationError("shape must give one amplitude >= 0 for each frequency, not all 0")
    angle = rng.uniform(0, 2 * np.pi, lines.size) if phase == "random" else _schroeder(amplitude)
    spectrum = np.zeros(period // 2 + 1, complex)
    spectrum[lines] = amplitude * np.exp(1j * angle)
    one = _scaled(np.fft.irfft(spectrum, period), rms)
    return Drive(np.tile(one, n_periods), rate, "multisine", period, lines, withheld, seed)


def chirp(
    rate: float,
    n: int,
    band: tuple[float, float],
    rms: float = 1.0,
    *,
    law: Literal["linear", "log"] = "linear",
    down: bool = False,
    fade: float = 0.02,
    n_periods: int = 1,
) -> Drive:
    r"""Sine that sweeps the band once in n samples, faded in and out, n_periods times.

    Parameters
    ----------
    rate, band
        As for `random`.
    n : int
        Samples of one sweep, which is the period.
    rms : float
    law : {"linear", "log"}
        Same time for each Hz, or for each octave.
    down : bool
        From high to low.
    fade : float
        Share of the sweep over which each end is faded, 0 to 0.5.

    Notes
    -----
    .. math:: \varphi(t) = 2\pi (f_1 t + (f_2 - f_1) t^2 / 2T), \quad
              \varphi(t) = 2\pi f_1 T \frac{(f_2/f_1)^{t/T} - 1}{\ln(f_2/f_1)}
    """
    low, high = _require_band(rate, band)
    if not 0 <= fade <= 0.5:
        raise EstimationError(f"fade is {fade}: it must lie between 0 and 0.5")
    if law == "log" and low <= 0:
        raise EstimationError("a logarithmic chirp cannot start at 0 Hz: raise the band's lower end")
    _require_count("n_periods", n_periods)
    _require_count("n", n)
    share = np.arange(n) / n
    span = n / rate
    if law == "linear":
        turns = span * (low * share + (high - low) * share**2 / 2)
    else:
        ratio = np.log(high / low)
        turns = span * low * np.expm1(ratio * share) / ratio
    one = np.sin(2 * np.pi * turns) * _fade(n, round(fade * n))
    one = _scaled(one[::-1] if down else one, rms)
    return Drive(np.tile(one, n_periods), rate, "chirp", n, _lines_in(rate, n, band))


@dataclass(frozen=True, eq=False)
class SteppedSine:
    """A plan of tones, one after the other with continuous phase, for stepped-sine tests up and down.

    Parameters
    ----------
    frequency : ndarray, shape (n_steps,)
        Hz, in the order they are played.
    amplitude : ndarray, shape (n_steps,)
        Of each tone.
    settle : ndarray of int, shape (n_steps,)
        Samples of each tone before it is measured.
    measure : ndarray of int, shape (n_steps,)
        Samples that are measured: as close to whole cycles as the sample rate allows.
    rate : float
    """

    frequency: NDArray[np.float64]
    amplitude: NDArray[np.float64]
    settle: NDArray[np.intp]
    measure: NDArray[np.intp]
    rate: float

    @property
    def start(self) -> NDArray[np.intp]:
        """First sample of each tone, shape (n_steps,)."""
        return np.concatenate([[0], np.cumsum(self.settle + self.measure)[:-1]])

    @property
    def windows(self) -> list[tuple[int, int]]:
        """Sample range (start, stop) in which each tone is measured."""
        first = self.start + self.settle
        return [(int(a), int(a + k)) for a, k in zip(first, self.measure, strict=True)]

    @property
    def duration(self) -> float:
        """Length in s."""
        return float(np.sum(self.settle + self.measure)) / self.rate

    def drive(self) -> Drive:
        """The whole plan as samples."""
        counts = self.settle + self.measure
        step = np.repeat(self.frequency / self.rate, counts)
        turns = np.concatenate([[0.0], np.cumsum(step)[:-1]])
        return Drive(np.repeat(self.amplitude, counts) * np.sin(2 * np.pi * turns), self.rate, "stepped sine")


def stepped_sine(
    rate: float,
    band: tuple[float, float],
    n_steps: int,
    rms: float = 1.0,
    *,
    law: Literal["linear", "log"] = "linear",
    direction: Literal["up", "down", "up-down"] = "up",
    settle: float = 0.5,
    cycles: int = 20,
) -> SteppedSine:
    """Plan of a stepped-sine test.

    Parameters
    ----------
    rate, band
        As for `random`.
    n_steps : int
        Frequencies in one direction.
    rms : float
        Of each tone.
    law : {"linear", "log"}
        Even steps in Hz or in octaves.
    direction : {"up", "down", "up-down"}
        Both ways show jumps and hysteresis of a nonlinear structure.
    settle : float
        Seconds each tone runs before it is measured.
    cycles : int
        Cycles measured.
    """
    low, high = _require_band(rate, band)
    _require_count("n_steps", n_steps)
    _require_count("cycles", cycles)
    if low <= 0:
        raise EstimationError("a stepped sine cannot start at 0 Hz: raise the band's lower end")
    if settle < 0:
        raise EstimationError(f"settle is {settle} s: it must be 0 or more")
    up = np.linspace(low, high, n_steps) if law == "linear" else np.geomspace(low, high, n_steps)
    frequency = {"up": up, "down": up[::-1], "up-down": np.concatenate([up, up[::-1]])}[direction]
    wait = np.full(frequency.size, round(settle * rate))
    measure = np.maximum(1, np.round(cycles * rate / frequency)).astype(int)
    return SteppedSine(frequency, np.full(frequency.size, rms * np.sqrt(2)), wait, measure, rate)


def _require_band(rate: float, band: tuple[float, float]) -> tuple[float, float]:
    low, high = band
    if not rate > 0:
        raise EstimationError(f"sample rate {rate} must be positive")
    if not 0 <= low < high <= rate / 2:
        raise EstimationError(
            f"band {low:g} to {high:g} Hz: it needs 0 <= low < high <= half the sample rate, {rate / 2:g} Hz"
        )
    return float(low), float(high)


def _require_count(name: str, value: int) -> None:
    if value < 1:
        raise EstimationError(f"{name} is {value}: it must be 1 or more")


def _lines_in(rate: float, n: int, band: tuple[float, float]) -> NDArray[np.intp]:
    low, high = _require_band(rate, band)
    _require_count("samples", n)
    lines = np.arange(n // 2 + 1)
    frequency = lines * rate / n
    chosen = lines[(frequency >= low * (1 - 1e-12)) & (frequency <= high * (1 + 1e-12)) & (lines > 0)]
    if not chosen.size:
        raise EstimationError(
            f"band {low:g} to {high:g} Hz holds no line: {n} samples at {rate:g} Hz give lines {rate / n:g} Hz apart"
        )
    return chosen


def _noise(lines: NDArray, n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    spectrum = np.zeros(n // 2 + 1, complex)
    spectrum[lines] = rng.standard_normal(lines.size) + 1j * rng.standard_normal(lines.size)
    return np.fft.irfft(spectrum, n)


def _withhold(candidates: NDArray, group: int, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Excited and withheld lines: of each whole group one is withheld."""
    if not group:
        return candidates, candidates[:0]
    whole = candidates.size // group
    places = np.arange(whole) * group + rng.integers(0, group, whole)
    withheld = np.zeros(candidates.size, bool)
    withheld[places] = True
    return candidates[~withheld], candidates[withheld]


def _schroeder(amplitude: NDArray) -> NDArray[np.float64]:
    power = amplitude**2 / np.sum(amplitude**2)
    return -2 * np.pi * np.concatenate([[0.0], np.cumsum(np.cumsum(power))[:-1]])


def _fade(n: int, flank: int) -> NDArray[np.float64]:
    shape = np.ones(n)
    if flank > 0:
        rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(flank) + 0.5) / flank)
        shape[:flank] *= rise
        shape[n - flank :] *= rise[::-1]
    return shape


def _scaled(samples: NDArray, rms: float) -> NDArray[np.float64]:
    if not (np.isfinite(rms) and rms >= 0):
        raise EstimationError(f"rms is {rms}: it must be 0 or a positive number")
    return samples * (rms / np.sqrt(np.mean(samples**2)))
