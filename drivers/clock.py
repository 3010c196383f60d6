"""Clock: a device's own rate, measured against this computer's clock from when its deliveries came."""

from __future__ import annotations

import math
from typing import final

import numpy as np

BIN = 1.0
"""s over which the earliest delivery stands for all: late ones tell about the computer, not about the device."""
NOTICED_PPM = 50.0
"""Drift that is worth a note, if it is certain."""
ENOUGH = 8
"""Bins from which a rate may be called wrong: both halves of them must say so."""
KEPT = 3600
"""Bins that are remembered."""


@final
class Clock:
    r"""Measures how fast frames really come.

    Parameters
    ----------
    rate : float
        Frames per second as promised.

    Notes
    -----
    A delivery that ends with frame :math:`n` comes at :math:`t = t_0 + n/f + \delta`, where the delay
    :math:`\delta \ge 0` is the computer's. Of each second the smallest :math:`t - n/f_0` is kept; the slope of a
    straight line through these is :math:`1 - f/f_0`, and what is left gives its standard error.

    Examples
    --------
    >>> clock = Clock(1000.0)
    >>> for n in range(0, 30000, 100):
    ...     clock.add(n, n / 1000.1)
    >>> round(clock.drift_ppm), clock.error_ppm < 1
    (100, True)
    """

    def __init__(self, rate: float) -> None:
        self.nominal = float(rate)
        self._bins: list[tuple[float, float]] = []
        self._begin = math.nan

    def add(self, frame: int, time: float) -> None:
        """A delivery ended with `frame` frames in all, at `time` in s."""
        if math.isnan(self._begin):
            self._begin = time
        late = time - frame / self.nominal
        number = math.floor((time - self._begin) / BIN)
        if number < len(self._bins):
            if late < self._bins[-1][1]:
                self._bins[-1] = (time, late)
        elif len(self._bins) < KEPT:
            self._bins += [(time, late)] * (number + 1 - len(self._bins))

    def restart(self) -> None:
        """An unknown number of frames is missing: begin anew."""
        self._bins.clear()
        self._begin = math.nan

    @property
    def seconds(self) -> float:
        """How long it has been measured."""
        return self._bins[-1][0] - self._begin if self._bins else 0.0

    @property
    def drift_ppm(self) -> float:
        """How much faster than promised frames come, in parts per million; NaN until a few seconds are known."""
        return self._fit()[0]

    @property
    def error_ppm(self) -> float:
        """Standard error of `drift_ppm`; infinite until a few seconds are known."""
        return self._fit()[1]

    @property
    def rate(self) -> float:
        """Frames per second as measured; as promised while nothing is known."""
        drift = self.drift_ppm
        return self.nominal * (1 + 1e-6 * (0.0 if math.isnan(drift) else drift))

    def is_wrong(self, least: float) -> bool:
        """Whether frames come faster, or slower, by more than `least` ppm throughout.

        A computer that was too busy delivers late and then catches up, which looks like a fast clock for a while; so
        both halves of the time must agree with the whole within a quarter, and a fast clock must be early against
        the first second too.
        """
        points = self._bins[1:-1]
        if len(points) < ENOUGH:
            return False
        half = len(points) // 2
        drift, error = self._fit()
        parts = [_line(p)[0] for p in (points[:half], points[half:])]
        early = self._bins[0][1] - points[-1][1]
        caught_up = drift > 0 and early < 0.5e-6 * drift * (points[-1][0] - self._begin)
        agree = all(abs(p - drift) < 0.25 * abs(drift) for p in parts)
        return certain(drift, error, least) and agree and not caught_up

    def time_of(self, frame: int) -> float:
        """When `frame` was digitised, in s of the clock that deliveries are timed by."""
        return frame / self.nominal + min((late for _, late in self._bins[-10:]), default=math.nan)

    def frame_at(self, time: float) -> int:
        """The frame that is digitised at `time`."""
        return round((time - self.time_of(0)) * self.nominal)

    def _fit(self) -> tuple[float, float]:
        """Drift and its standard error, in ppm; the first and the last bin are left out, being incomplete."""
        points = self._bins[1:-1]
        return _line(points) if len(points) >= 4 else (math.nan, math.inf)


def _line(points: list[tuple[float, float]]) -> tuple[float, float]:
    """Drift and its standard error in ppm, from times and delays."""
    time, late = np.array(points).T
    time = time - time.mean()
    slope = float(time @ late / (time @ time))
    left = late - late.mean() - slope * time
    error = math.sqrt(float(left @ left) / (len(points) - 2) / float(time @ time))
    return -1e6 * slope, 1e6 * error


def drift_note(name: str, clock: Clock) -> tuple[str, ...]:
    """A line that says by how much the clock of the device `name` is off, if that is certain; else none."""
    drift, error = clock.drift_ppm, clock.error_ppm
    if not certain(drift, error):
        return ()
    way = "fast" if drift > 0 else "slow"
    return (f"{name}: its clock runs {abs(drift):.0f} ± {error:.0f} ppm {way} against this computer's",)


def drift_between(one: Clock, other: Clock) -> tuple[float, float]:
    """How much faster `one` runs than `other` in ppm, and its standard error: two devices without a common clock."""
    return one.drift_ppm - other.drift_ppm, math.hypot(one.error_ppm, other.error_ppm)


def certain(drift: float, error: float, least: float = NOTICED_PPM) -> bool:
    """Whether a drift in ppm is more than `least` and more than five times its error; not so while it is unknown."""
    return abs(drift) > least and abs(drift) > 5 * error
