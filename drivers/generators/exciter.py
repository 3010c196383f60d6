"""A generator on a line as an exciter: tones at a level, raised and lowered in steps."""

from __future__ import annotations

import math
import threading
import time
from typing import final

from numpy.typing import ArrayLike

from drivers.exciter import Exciter
from drivers.generators.base import Generator
from labnnum.errors import ConfigError


@final
class GeneratorExciter(Exciter):
    """Plays sines at a level in RMS volts.

    Parameters
    ----------
    generator : Generator
        Identified; its `max_volts` holds.

    Notes
    -----
    After `off` nothing sounds until the next `tone`, so that whoever was raising the level when another thread
    switched off cannot switch on again by accident.
    """

    def __init__(self, generator: Generator) -> None:
        self.generator = generator
        self._lock = threading.RLock()
        self._ready = self._plain = self._closed = False
        self._volts = 0.0

    @property
    def max_volts(self) -> float:
        """Peak volts that it will not pass."""
        return min(self.generator.max_volts, self.generator.limits.amplitude[1])

    def arm(self, samples: ArrayLike, repeat: bool) -> None:
        """Refuse: this generator has a clock of its own, so that samples would drift against the digitiser's."""
        raise ConfigError(
            'generator.kind: a generator on a line plays sines only; use excitation.kind "stepped sine",'
            ' or generator.kind "audio" for waveforms that keep step with the digitiser'
        )

    def tone(self, frequency: float) -> None:
        """A sine from now on; its level stays as it is."""
        with self._lock:
            if not self._plain:
                self.generator.set_waveform("sine")
                self.generator.set_offset(0.0)
                self._plain = True
            self.generator.set_frequency(frequency)
            self._ready = True

    def set_volts(self, rms: float, ramp: float = 0.0) -> None:
        """Reach `rms` volts in steps that take `ramp` seconds together; returns when they are done."""
        self.require_within(rms, math.sqrt(2))
        target, began = rms * math.sqrt(2), time.monotonic()
        start = self._volts * math.sqrt(2)
        share = 0.0
        while share < 1.0:
            share = 1.0 if ramp <= 0 else min((time.monotonic() - began) / ramp, 1.0)
            if not self._play(start + share * (target - start), last=share == 1.0):
                return
            time.sleep(0.0 if share == 1.0 else min(0.02, ramp))

    def _play(self, amplitude: float, last: bool) -> bool:
        """One step in V peak; False once somebody switched off."""
        with self._lock:
            if not self._ready:
                return False
            smallest = self.generator.limits.amplitude[0]
            if amplitude < smallest:
                self._too_small(amplitude, smallest, last)
                return True
            self.generator.set_amplitude(amplitude)
            if self._volts == 0.0:
                self.generator.output(True)
            self._volts = amplitude / math.sqrt(2)
            return True

    def _too_small(self, amplitude: float, smallest: float, last: bool) -> None:
        """Below what the generator can play it is off on the way; a level there cannot be asked for."""
        if self._volts:
            self.generator.off()
            self._volts = 0.0
        if last and amplitude > 0:
            raise ConfigError(
                f"generator: {amplitude / math.sqrt(2):.3g} V RMS is less than it can play,"
                f" {smallest / math.sqrt(2):.3g} V: raise generator.start_volts and lower the amplifier's gain"
            )

    def off(self) -> None:
        """Silence, confirmed by the generator; nothing once the line was let go. SafetyError if it did not confirm."""
        self._ready = False
        with self._lock:
            self._ready, self._volts = False, 0.0
            if not self._closed:
                self.generator.off()

    def close(self) -> None:
        """Off, and let the line go: from then on somebody else may hold it."""
        self._ready = False
        with self._lock:
            if not self._closed:
                self._closed = True
                self.generator.close()
