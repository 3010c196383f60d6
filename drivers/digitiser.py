"""Digitiser: what every source of blocks offers, whether a sound card, a simulated bench or a stored session."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from drivers.block import Block


class Digitiser(ABC):
    """Hands over blocks of volts in order, each saying what went missing before it.

    The life of one run is ``open, start, read, read, ..., stop, close``; as a context manager it opens on entry
    and stops and closes on any exit.
    """

    @property
    @abstractmethod
    def n_channels(self) -> int:
        """Inputs that each block holds, in the order of the rig."""

    @property
    @abstractmethod
    def rate(self) -> float:
        """Samples per second and channel that the device promises."""

    @property
    def full_scale(self) -> NDArray[np.float64]:
        """Volts at the end of each input's range, shape (n_channels,); infinite where unknown."""
        return np.full(self.n_channels, np.inf)

    @property
    def paced(self) -> bool:
        """Whether blocks come at a pace of their own, so that nobody may keep the device waiting."""
        return True

    @property
    def notes(self) -> tuple[str, ...]:
        """What the driver noticed in this run and a person should know."""
        return ()

    @abstractmethod
    def open(self) -> None:
        """Claim the device. DeviceNotFoundError if there is none, ProtocolError if it refuses rate or channels."""

    @abstractmethod
    def start(self) -> None:
        """Begin a run: frames are numbered from 0 again."""

    @abstractmethod
    def read(self, timeout: float = 5.0) -> Block | None:
        """The next block; None once a source of finite length has come to its end.

        Parameters
        ----------
        timeout : float
            Seconds to wait for the device.

        Raises
        ------
        DeviceTimeoutError
            Nothing came in time.
        DeviceLostError
            The device went away; what it delivered before stays valid.
        """

    @abstractmethod
    def stop(self) -> None:
        """End the run; harmless when none is going."""

    def close(self) -> None:
        """Let the device go; harmless when it is closed."""
        return None

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.stop()
        finally:
            self.close()
