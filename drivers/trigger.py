"""Trigger: finds hits in a stream, whatever the size of its blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ConfigError

Slope = Literal["rising", "falling", "either"]


@dataclass(frozen=True, slots=True)
class Event:
    """One hit: the level was crossed at sample `at`; the hit is [start, stop). Samples count from the first fed."""

    at: int
    start: int
    stop: int


@dataclass(frozen=True, slots=True)
class Missed:
    """A crossing at sample `at` that gave no hit, and why."""

    at: int
    reason: str


@final
@dataclass(frozen=True, slots=True)
class Trigger:
    """Edge trigger with hysteresis and pre-trigger.

    Parameters
    ----------
    level : float
        In the unit of what is fed; positive.
    pre : int
        Samples kept from before the crossing.
    length : int
        Samples of a hit, `pre` included.
    hysteresis : float
        After a hit the signal must have been below (1 - hysteresis) level before the next can begin.
    slope : {"rising", "falling", "either"}
        "either" watches the magnitude.

    Examples
    --------
    >>> detector = Trigger(level=5.0, pre=2, length=6).start()
    >>> detector.feed([0, 1, 0, 2, 9]), detector.feed([7, 1, 0, 0])
    ([], [Event(at=4, start=2, stop=8)])
    """

    level: float
    pre: int
    length: int
    hysteresis: float = 0.5
    slope: Slope = "rising"

    def __post_init__(self) -> None:
        if not self.level > 0:
            raise ConfigError(f"trigger level {self.level:g} must be positive")
        if not 0 <= self.pre < self.length:
            raise ConfigError(f"trigger: pre-trigger {self.pre} must be shorter than the hit of {self.length} samples")
        if not 0 < self.hysteresis <= 1:
            raise ConfigError(f"trigger hysteresis {self.hysteresis:g} must be in (0, 1]")

    def start(self) -> Detector:
        """A detector at the beginning of a stream."""
        return Detector(self)


@final
class Detector:
    """Where a trigger is in its stream."""

    def __init__(self, trigger: Trigger) -> None:
        self.trigger = trigger
        self.position = 0
        self.missed: list[Missed] = []
        self._span = 0
        self._armed = False
        self._open: Event | None = None

    @property
    def busy(self) -> bool:
        """Whether a hit has begun that is not complete."""
        return self._open is not None

    def feed(self, samples: ArrayLike) -> list[Event]:
        """Hits that are complete now."""
        x = self._seen(np.asarray(samples, float))
        high = x >= self.trigger.level
        low = x < (1 - self.trigger.hysteresis) * self.trigger.level
        begin, end = self.position, self.position + x.size
        self.position = end
        out, k = [], begin
        while True:
            if self._open is not None:
                if self._open.stop > end:
                    return out
                out.append(self._open)
                k, self._open, self._armed = max(self._open.stop, begin), None, False
            if not self._armed:
                k = _next(low, k - begin) + begin
                self._armed = k < end
            k = _next(high, k - begin) + begin
            if k >= end:
                return out
            self._begin(k)
            k += 1

    def gap(self) -> None:
        """What comes next does not continue what came before: no hit spans it."""
        if self._open is not None:
            self.missed.append(Missed(self._open.at, "samples were lost during the hit"))
        self._open, self._armed, self._span = None, False, self.position

    def jump(self, position: int) -> None:
        """Samples up to number `position` were not fed: a gap."""
        self.gap()
        self.position = self._span = position

    def finish(self) -> None:
        """The stream ends: a hit that is not complete is missed."""
        if self._open is not None:
            self.missed.append(Missed(self._open.at, "the run ended during the hit"))
            self._open = None

    def _seen(self, x: NDArray) -> NDArray[np.float64]:
        return {"rising": x, "falling": -x, "either": np.abs(x)}[self.trigger.slope]

    def _begin(self, at: int) -> None:
        start = at - self.trigger.pre
        self._armed = False
        if start < self._span:
            self.missed.append(Missed(at, "the pre-trigger reaches before the start of the record"))
            return
        self._open = Event(at, start, start + self.trigger.length)


def _next(flags: NDArray[np.bool_], start: int) -> int:
    """First true flag from `start` on; the length where there is none."""
    if start >= flags.size:
        return flags.size
    k = int(np.argmax(flags[start:]))
    return start + k if flags[start + k] else flags.size
