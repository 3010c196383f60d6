"""Records of single hits: their offsets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LEAST_QUIET = 8
"""Samples before the blow that are needed to tell an offset."""


def without_offset(x: NDArray, force: int) -> NDArray[np.float64]:
    """One hit `x` (n_channels, n) without its channels' constant offsets; `force` is the row of the hammer.

    The offset is the mean, smoothly weighted, before the blow or over the last tenth, whichever end of the record is
    quieter: a structure on soft cords, or one that rings on, is still moving at the end, and what is taken off there
    would stand as a step in all that came before. What a filter lets ring before the blow alternates from sample to
    sample; a median takes one of its sides, a mean without weights what is left of an odd number of them.
    """
    n = x.shape[1]
    late = x[:, -max(n // 10, 1) :]
    level = _level(late)
    blow = np.abs(x[force] - level[force])
    quiet = 3 * (int(np.argmax(blow > 0.01 * blow.max())) - 1) // 4
    if quiet < LEAST_QUIET:
        return x - level[:, None]
    early = x[:, :quiet]
    before = _level(early)
    still = _spread(early, before) <= _spread(late, level)
    return x - np.where(still, before, level)[:, None]


def _level(x: NDArray) -> NDArray[np.float64]:
    """Mean of each row under a Hann window."""
    n = x.shape[1]
    return x @ (np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2 * (2 / n if n > 1 else 1.0))


def _spread(x: NDArray, level: NDArray) -> NDArray[np.float64]:
    return np.median(np.abs(x - level[:, None]), axis=1)
