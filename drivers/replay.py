"""Replay: a stored run as a digitiser, block for block as it came, with its gaps and flags."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import final

import numpy as np
from numpy.typing import NDArray

from drivers.block import Block
from drivers.digitiser import Digitiser
from labnnum.errors import DriverError


@final
class Replay(Digitiser):
    """Plays blocks again.

    Parameters
    ----------
    blocks : callable
        Gives the blocks from the beginning, such as the `replay` of a stored run.
    rate : float
        Samples per second.
    n_channels : int
    full_scale : ndarray, shape (n_channels,), or None
        Volts at the end of each range.
    speed : float
        1 plays at the pace at which it was recorded, 2 twice as fast; infinite without waiting.
    """

    def __init__(
        self,
        blocks: Callable[[], Iterable[Block]],
        rate: float,
        n_channels: int,
        full_scale: NDArray | None = None,
        speed: float = float("inf"),
    ) -> None:
        self._blocks, self._rate, self._n, self._speed = blocks, float(rate), int(n_channels), float(speed)
        self._full_scale = np.full(self._n, np.inf) if full_scale is None else np.asarray(full_scale, float)
        self._playing: Iterator[Block] | None = None

    @property
    def n_channels(self) -> int:
        """Channels of the run."""
        return self._n

    @property
    def rate(self) -> float:
        """Samples per second."""
        return self._rate

    @property
    def full_scale(self) -> NDArray[np.float64]:
        """Volts at the end of each range."""
        return self._full_scale

    @property
    def paced(self) -> bool:
        """Whether blocks come at a pace of their own."""
        return self._speed < float("inf")

    def open(self) -> None:
        """Nothing to claim."""
        return None

    def start(self) -> None:
        """From the first block."""
        self._playing = iter(self._blocks())
        self._began = time.monotonic()
        self._frames = 0

    def read(self, timeout: float = 5.0) -> Block | None:
        """The next block; None after the last."""
        if self._playing is None:
            raise DriverError("the replay is not running: start it first")
        block = next(self._playing, None)
        if block is None:
            return None
        if block.data.shape[0] != self._n:
            raise DriverError(f"the replay has {self._n} channels, but a block of {block.data.shape[0]}")
        self._frames += block.n_frames + block.lost
        if self.paced:
            due = self._began + self._frames / self._rate / self._speed
            time.sleep(max(0.0, due - time.monotonic()))
        return block

    def stop(self) -> None:
        """End the run."""
        self._playing = None
