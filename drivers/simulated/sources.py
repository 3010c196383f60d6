"""What plays into the simulated plant: a sampled waveform, a function generator, a hammer, or nothing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.simulated.filters import HALF, Interpolator
from labnnum.errors import InputError


class Source(ABC):
    """Gives its signal piece after piece, at any number of samples a frame."""

    @abstractmethod
    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """Samples of frames first ... first + frames - 1, shape (frames * oversample,). Called in order.

        `rate` is the true rate of the digitiser's clock, in frames per s.
        """

    def restart(self) -> None:
        """A new run begins: frames count from 0 again."""
        return None


@final
class Silence(Source):
    """Nothing."""

    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """Zeros."""
        return np.zeros(frames * oversample)


@final
class Player(Source):
    """A synchronous output: plays a waveform once or round and round, band-limited between its samples."""

    def __init__(self) -> None:
        self._wave = np.zeros(0)
        self._repeat = False
        self._begin = 0
        self._ramp = (0, 0, 1.0, 1.0)
        self._horizon = 0
        self._interpolator: Interpolator | None = None

    def restart(self) -> None:
        """Frames count from 0 again; the waveform begins anew at full gain."""
        self._begin, self._horizon = 0, 0
        self._ramp = (0, 0, self.gain, self.gain)

    @property
    def gain(self) -> float:
        """Factor on the waveform, after any ramp."""
        return self._ramp[3]

    def play(self, samples: ArrayLike, repeat: bool = False, gain: float = 1.0) -> int:
        """Begin a waveform in V; the frame at which its first sample sounds."""
        self._wave, self._repeat = np.asarray(samples, float).copy(), repeat
        self._begin = self._horizon
        self._ramp = (self._begin, self._begin, gain, gain)
        return self._begin

    def set_gain(self, gain: float, ramp: int = 0) -> int:
        """Move the factor on the waveform to `gain` within `ramp` frames; the frame at which it is reached."""
        start = self._horizon
        self._ramp = (start, start + ramp, float(self._gains(np.array([start]))[0]), float(gain))
        return start + ramp

    def _gains(self, frame: NDArray) -> NDArray[np.float64]:
        start, stop, before, after = self._ramp
        if stop <= start:
            return np.where(frame >= start, after, before)
        return before + (after - before) * np.clip((frame - start) / (stop - start), 0, 1)

    def _frames(self, first: int, stop: int) -> NDArray[np.float64]:
        frame = np.arange(first, stop)
        at = frame - self._begin
        n = self._wave.size
        if n == 0:
            return np.zeros(frame.size)
        inside = (at >= 0) & (self._repeat | (at < n))
        return np.where(inside, self._wave[at % n], 0.0) * self._gains(frame)

    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """The waveform between its samples."""
        if self._interpolator is None or self._interpolator.oversample != oversample:
            self._interpolator = Interpolator(oversample)
        self._horizon = first + frames + HALF
        return self._interpolator.run(self._frames(first - HALF + 1, self._horizon))


WAVES = ("sine", "square", "triangle", "noise")


@final
class FunctionWave(Source):
    """A function generator that runs on its own clock: phase goes on through every change of frequency."""

    def __init__(self, seed: int = 0) -> None:
        self.wave = "sine"
        self.frequency = 100.0
        self.amplitude = 0.0
        self.offset = 0.0
        self.on = False
        self._phase = 0.0
        self._seed = seed
        self._random = np.random.default_rng(seed)

    def restart(self) -> None:
        """Phase 0, noise from its beginning."""
        self._phase = 0.0
        self._random = np.random.default_rng(self._seed)

    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """Peak `amplitude` about `offset` while the output is on."""
        n = frames * oversample
        turns = self.frequency / (rate * oversample)
        phase = self._phase + turns * np.arange(n)
        self._phase = float((self._phase + turns * n) % 1.0)
        noise = self._random.uniform(-1, 1, n) if self.wave == "noise" else None
        if not self.on:
            return np.zeros(n)
        shapes = {
            "sine": lambda: np.sin(2 * np.pi * phase),
            "square": lambda: np.where(phase % 1.0 < 0.5, 1.0, -1.0),
            "triangle": lambda: 1 - 4 * np.abs((phase + 0.25) % 1.0 - 0.5),
            "noise": lambda: noise,
        }
        return self.offset + self.amplitude * np.asarray(shapes[self.wave](), float)


TIPS: dict[str, tuple[float, float]] = {
    "steel": (0.2e-3, 1.5),
    "aluminium": (0.3e-3, 1.5),
    "plastic": (0.7e-3, 1.6),
    "hard rubber": (1.6e-3, 1.8),
    "rubber": (3.5e-3, 2.0),
    "soft rubber": (5.0e-3, 2.0),
}
"""Hammer tips: duration of the pulse in s, and the power of the half-sine that is its shape."""


@dataclass(frozen=True, slots=True)
class Hit:
    """One blow.

    Parameters
    ----------
    time : float
        When contact begins, in s.
    peak : float
        N.
    duration : float
        Of the contact, in s.
    power : float
        Of the half-sine that is the pulse's shape: 1.5 for a Hertzian contact, more for softer tips.
    again : float
        Peak of a second contact, in parts of the first; 0 for none.
    after : float
        s from the first contact's beginning to the second's.
    """

    time: float
    peak: float
    duration: float
    power: float = 1.5
    again: float = 0.0
    after: float = 0.0

    @property
    def end(self) -> float:
        """When the last contact ends, in s."""
        return self.time + self.duration + (self.after if self.again else 0.0)

    def force(self, time: NDArray) -> NDArray[np.float64]:
        """N at `time` in s."""
        return self.peak * (self._pulse(time - self.time) + self.again * self._pulse(time - self.time - self.after))

    def _pulse(self, t: NDArray) -> NDArray[np.float64]:
        phase = np.clip(t / self.duration, 0.0, 1.0)
        return np.sin(np.pi * phase) ** self.power


def blow(tip: str, time: float, peak: float, again: float = 0.0, after: float = 0.0) -> Hit:
    """A blow with one of `TIPS`."""
    if tip not in TIPS:
        raise InputError(f"hammer tip {tip!r} is not one of {', '.join(TIPS)}")
    duration, power = TIPS[tip]
    return Hit(time, peak, duration, power, again, after)


@final
class Hammer(Source):
    """Strikes the given blows; further ones may be added while it runs."""

    def __init__(self, hits: Sequence[Hit] = ()) -> None:
        self.hits = list(hits)

    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """Force in N."""
        step = 1 / (rate * oversample)
        out = np.zeros(frames * oversample)
        start = first / rate
        for hit in self.hits:
            a = max(int(np.floor((hit.time - start) / step)), 0)
            b = min(int(np.ceil((hit.end - start) / step)) + 1, out.size)
            if a < b:
                out[a:b] += hit.force(start + step * np.arange(a, b))
        return out


@final
@dataclass(eq=False)
class Operator(Source):
    """A person with a hammer, who strikes again and again until told to stop, unevenly as people do. Seeded.

    Parameters
    ----------
    tip : str
        One of `TIPS`.
    interval : float
        s between blows, give or take a tenth.
    peak : float
        N, give or take a fifth.
    double : float
        Share of blows that bounce and strike twice.
    overload : float
        Share of blows three times as hard.
    lead : float
        s before the first blow.
    seed : int
    """

    tip: str = "plastic"
    interval: float = 2.0
    peak: float = 100.0
    double: float = 0.0
    overload: float = 0.0
    lead: float = 0.5
    seed: int = 0
    hits: list[Hit] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.tip not in TIPS:
            raise InputError(f"hammer tip {self.tip!r} is not one of {', '.join(TIPS)}")
        self.restart()

    def restart(self) -> None:
        """Begin again with the first blow."""
        self._random = np.random.default_rng(self.seed)
        self._next = self.lead
        self.hits.clear()

    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """Force in N."""
        while self._next < (first + frames) / rate:
            self.hits.append(self._strike(self._next))
            self._next += self.interval * (1 + 0.1 * self._random.uniform(-1, 1))
        near = [h for h in self.hits if h.end >= first / rate]
        return Hammer(near).render(first, frames, oversample, rate)

    def _strike(self, time: float) -> Hit:
        r = self._random
        duration, power = TIPS[self.tip]
        duration *= 1 + 0.1 * r.uniform(-1, 1)
        peak = self.peak * (1 + 0.2 * r.uniform(-1, 1)) * (3.0 if r.random() < self.overload else 1.0)
        bounce = r.random() < self.double
        again, after = r.uniform(0.2, 0.9), duration * r.uniform(2.0, 12.0)
        return Hit(time, peak, duration, power, again if bounce else 0.0, after if bounce else 0.0)
