"""Frequency bands and the integrals of the FRF over them, which feed the network.

Source: Atalla (1996), section 4.5 (integrals of the real and imaginary part instead of points of the
FRF) and equation 4.48 (weights).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import BandError
from labnnum.frf import Frf


@dataclass(frozen=True, slots=True)
class Band:
    """A frequency band, in Hz, with the weight of each part of the FRF in it (0 leaves the part out)."""

    low: float
    high: float
    real: float = 1.0
    imag: float = 1.0

    def __post_init__(self) -> None:
        if not 0 <= self.low < self.high:
            raise BandError(f"band [{self.low:g}, {self.high:g}] Hz is empty: it needs 0 <= low < high")
        if self.real < 0 or self.imag < 0 or self.real + self.imag == 0:
            raise BandError(f"band [{self.low:g}, {self.high:g}] Hz: weights must be >= 0 and not both 0")

    def __contains__(self, frequency: float) -> bool:
        return self.low <= frequency <= self.high


def check_bands(bands: Sequence[Band], frequency: NDArray | None = None) -> tuple[Band, ...]:
    """Bands sorted by frequency; BandError if two overlap, or one holds fewer than two lines of `frequency`."""
    ordered = tuple(sorted(bands, key=lambda b: b.low))
    if not ordered:
        raise BandError("no frequency band is given")
    for a, b in itertools.pairwise(ordered):
        if b.low < a.high:
            raise BandError(f"bands [{a.low:g}, {a.high:g}] and [{b.low:g}, {b.high:g}] Hz overlap")
    if frequency is not None:
        for band in ordered:
            n = int(np.count_nonzero((frequency >= band.low) & (frequency <= band.high)))
            if n < 2:
                raise BandError(
                    f"band [{band.low:g}, {band.high:g}] Hz holds {n} of the data's lines"
                    f" ({frequency[0]:g} to {frequency[-1]:g} Hz): it needs at least two"
                )
    return ordered


def band_mask(bands: Sequence[Band], frequency: NDArray) -> NDArray[np.bool_]:
    """Lines that lie in any band, shape (n_f,)."""
    mask = np.zeros(frequency.shape, bool)
    for band in bands:
        mask |= (frequency >= band.low) & (frequency <= band.high)
    return mask


def integrals(frequency: NDArray, value: NDArray, bands: Sequence[Band]) -> NDArray[np.float64]:
    r"""Integrals of Re and Im of FRFs over bands, by the trapezoidal rule with the ends interpolated.

    Parameters
    ----------
    frequency : ndarray, shape (n_f,)
        Hz.
    value : ndarray, shape (..., n_f)
        Complex FRFs; leading axes are kept.
    bands : sequence of Band

    Returns
    -------
    ndarray, shape (..., n_features)
        For each band the integral of the real part, then of the imaginary part, times its weight;
        parts of weight 0 are left out. Unit of the FRF times Hz.

    Notes
    -----
    .. math:: R_b = \int_{f_l}^{f_u} \mathrm{Re}\, H \,df,\quad I_b = \int_{f_l}^{f_u} \mathrm{Im}\, H \,df

    References
    ----------
    Atalla (1996), section 4.5; weights, equation 4.48.
    """
    columns = []
    for band in bands:
        weights = trapezoid_weights(frequency, band.low, band.high)
        total = value @ weights
        if band.real:
            columns.append(band.real * total.real)
        if band.imag:
            columns.append(band.imag * total.imag)
    return np.stack(columns, axis=-1)


def trapezoid_weights(frequency: NDArray, low: float, high: float) -> NDArray[np.float64]:
    """Weights w, shape (n_f,), such that w @ y integrates the piecewise linear y(f) from low to high."""
    if frequency[0] > low or frequency[-1] < high:
        raise BandError(
            f"band [{low:g}, {high:g}] Hz reaches outside the data ({frequency[0]:g} to {frequency[-1]:g} Hz)"
        )
    weights = np.zeros(frequency.size)
    inside = np.flatnonzero((frequency > low) & (frequency < high))
    knots = np.concatenate([[low], frequency[inside], [high]])
    share = np.zeros(knots.size)
    step = np.diff(knots)
    share[:-1] += step / 2
    share[1:] += step / 2
    left = np.clip(np.searchsorted(frequency, knots, side="right") - 1, 0, frequency.size - 2)
    fraction = (knots - frequency[left]) / (frequency[left + 1] - frequency[left])
    np.add.at(weights, left, share * (1 - fraction))
    np.add.at(weights, left + 1, share * fraction)
    return weights


def integrate(frf: Frf, bands: Sequence[Band]) -> NDArray[np.float64]:
    """Feature vector of an Frf, shape (n_out * n_in * n_features,): `integrals` of every pair, outputs slowest."""
    ordered = check_bands(bands, frf.frequency)
    return integrals(frf.frequency, frf.value, ordered).reshape(-1)
