"""Block: what a digitiser hands over, and all that must be known to trust it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Consecutive frames of all channels, as volts at the device's inputs.

    Parameters
    ----------
    data : ndarray, shape (n_channels, n_frames)
        Volts.
    start : int
        Number of the first frame since the run began, lost frames counted.
    time : float
        When the first frame was digitised, in s since the epoch (the device's clock mapped to the host's).
    lost : int
        Frames known to be missing between the block before and this one.
    overflow : bool
        The device reported an input overflow during this block.
    overload : ndarray of bool, shape (n_channels,)
        Channels that reached the end of their range in this block.
    """

    data: NDArray[np.float64]
    start: int
    time: float
    lost: int = 0
    overflow: bool = False
    overload: NDArray[np.bool_] | None = None

    @property
    def n_frames(self) -> int:
        """Frames in this block."""
        return self.data.shape[1]
