"""Noise of a spectrum, from where it is quietest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def floor_of(spectra: NDArray) -> NDArray[np.float64]:
    """Power per line (rows,) of the quietest stretch of each spectrum (rows, n_lines), taken as that of white noise."""
    block = max(spectra.shape[1] // 40, 16)
    n = spectra.shape[1] // block * block
    power = np.abs(spectra[:, :n]) ** 2
    return np.median(power.reshape(spectra.shape[0], -1, block), axis=2).min(axis=1) / np.log(2)
