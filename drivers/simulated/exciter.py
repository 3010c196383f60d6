"""The generator of the simulated bench."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.exciter import Exciter
from drivers.simulated.sources import FunctionWave, Player, Source
from labnnum.errors import ConfigError


@final
class SimulatedExciter(Exciter, Source):
    """The generator of the simulated bench: plays samples in step with the digitiser, or tones.

    It is also the source that the bench renders.
    """

    def __init__(self, rate: float, max_volts: float = 10.0) -> None:
        self._rate, self._max = rate, max_volts
        self._player, self._wave = Player(), FunctionWave()
        self._tone = self._ready = False
        self._crest = 1.0
        self.volts = 0.0
        self.log: list[str] = []

    @property
    def max_volts(self) -> float:
        """Peak volts that it will not pass."""
        return self._max

    def arm(self, samples: ArrayLike, repeat: bool) -> int:
        """Ready, silent; the frame at which the first sample sounds."""
        samples = np.asarray(samples, float)
        self._crest = float(np.abs(samples).max(initial=0.0))
        self._tone, self._wave.on, self.volts, self._ready = False, False, 0.0, True
        self.log.append("arm")
        return self._player.play(samples, repeat, gain=0.0)

    def tone(self, frequency: float) -> None:
        """A sine from now on."""
        if not 0 < frequency < self._rate / 2:
            raise ConfigError(f"a tone of {frequency:g} Hz is not below half the rate, {self._rate / 2:g} Hz")
        if not self._tone:
            self._player.set_gain(0.0)
            self._wave.amplitude, self.volts = 0.0, 0.0
        self._tone, self._wave.on, self._crest, self._ready = True, True, np.sqrt(2), True
        self._wave.frequency = frequency

    def set_volts(self, rms: float, ramp: float = 0.0) -> None:
        """Within `ramp` seconds of the simulated time (tones at once)."""
        if not self._ready:
            return
        self.require_within(rms, self._crest)
        self.volts = rms
        self.log.append(f"volts {rms:.6g}")
        if self._tone:
            self._wave.amplitude = rms * np.sqrt(2)
        else:
            self._player.set_gain(rms, round(ramp * self._rate))

    def off(self) -> None:
        """Silence at once."""
        self._ready = False
        self._player.set_gain(0.0)
        self._wave.on, self._wave.amplitude, self.volts = False, 0.0, 0.0
        self.log.append("off")

    def restart(self) -> None:
        """A new run of the digitiser begins."""
        self._player.restart()
        self._wave.restart()

    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """Volts."""
        played = self._player.render(first, frames, oversample, rate)
        return played + self._wave.render(first, frames, oversample, rate)
