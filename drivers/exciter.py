"""Exciter: what a plan asks of whatever plays, a sound card's output or a generator on a serial line."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from numpy.typing import ArrayLike

from labnnum.errors import SafetyError


class Exciter(ABC):
    """Plays at a level in RMS volts, and can always be switched off; as a context manager it leaves itself off."""

    @property
    @abstractmethod
    def max_volts(self) -> float:
        """Peak volts that it will not pass."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What the driver noticed and a person should know."""
        return ()

    @abstractmethod
    def arm(self, samples: ArrayLike, repeat: bool) -> int | None:
        """Begin to play samples of unit RMS, at level 0.

        Returns the digitiser's frame at which the first sample sounds; None where the two share no clock.
        ConfigError if it cannot play samples.
        """

    @abstractmethod
    def tone(self, frequency: float) -> None:
        """Go on as a sine of `frequency` in Hz, at the level as it is."""

    @abstractmethod
    def set_volts(self, rms: float, ramp: float = 0.0) -> None:
        """Reach `rms` volts within `ramp` seconds. SafetyError (and off) where its peaks would pass `max_volts`."""

    @abstractmethod
    def off(self) -> None:
        """Silence at once; does no harm at any time, any number of times, from any thread.

        Until the next `arm` or `tone` nothing sounds, so that whoever was raising the level cannot switch on again.
        """

    def close(self) -> None:
        """Off, and let the device go."""
        self.off()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def require_within(self, rms: float, crest: float) -> None:
        """Switch off and raise SafetyError if peaks of `crest` times `rms` would pass `max_volts`."""
        if not rms * crest <= self.max_volts * (1 + 1e-9):
            self.off()
            raise SafetyError(
                f"the generator would need {rms * crest:.3g} V peak ({rms:.3g} V RMS), more than max_volts"
                f" {self.max_volts:g}: lower the level, raise the amplifier's gain or max_volts"
            )
