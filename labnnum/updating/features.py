"""Features: the few numbers that stand for an FRF when a network looks at it.

Four kinds, each a frozen dataclass with the bands it covers, three of them here:

- `BandIntegrals`: integrals of the real and imaginary part (the dissertation's own);
- `LogBands`: means of log |H| and of the phasor over sub-bands, with energy and centroid of each band;
- `SphereBands`: means of the FRF on the Riemann sphere, bounded even where an undamped FRF is not;
- `labnnum.updating.scores.ScoreBands`: every line weighed by what it says about the parameters, for noisy data.

All are smooth functions of the FRF, batch over leading axes, and know nothing of networks.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from labnnum.bands import Band, check_bands, integrals, trapezoid_weights
from labnnum.errors import ConfigError
from labnnum.frf import Frf

TINY = 1e-300
"""Floor of |H| before a logarithm; far below any measured response."""


class Features(ABC):
    """A map from FRFs to feature vectors."""

    kind: ClassVar[str]
    components: ClassVar[int] = 24
    """Principal components, at most, that a network is given."""
    bands: tuple[Band, ...]

    @abstractmethod
    def __call__(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Feature vectors, shape (..., n_features), of FRFs of shape (..., n_out, n_in, n_f)."""

    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """Numbers beside the bands that recreate this object, for storage."""

    def fitted(self, frequency: NDArray, value: NDArray) -> Features:
        """The same features with scales taken from sample FRFs, shape (n, n_out, n_in, n_f)."""
        del frequency, value
        return self

    def of(self, frf: Frf) -> NDArray[np.float64]:
        """Feature vector of one Frf, shape (n_features,); BandError where it does not cover the bands."""
        check_bands(self.bands, frf.frequency)
        return self(frf.frequency, frf.value)


class PairFeatures(Features):
    """Features that every output-input pair has of its own."""

    @abstractmethod
    def blocks(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Features of each output-input pair, shape (..., n_out, n_in, n_per_pair)."""

    def __call__(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Feature vectors, shape (..., n_features), of FRFs of shape (..., n_out, n_in, n_f)."""
        blocks = self.blocks(np.asarray(frequency, float), np.asarray(value))
        return blocks.reshape(*blocks.shape[:-3], -1)


@final
@dataclass(frozen=True)
class BandIntegrals(PairFeatures):
    """Integrals of Re H and Im H over each band, times the band's weights.

    Source: Atalla (1996), section 4.5 and equation 4.48 (a part of weight 0 is left out).

    Examples
    --------
    >>> import numpy as np
    >>> f = np.linspace(0.0, 2.0, 3)
    >>> BandIntegrals((Band(0.0, 2.0),))(f, (2 + 1j) * np.ones((1, 1, 3)))
    array([4., 2.])
    """

    bands: tuple[Band, ...]
    kind: ClassVar[str] = "integrals"

    def blocks(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Integrals of each pair, shape (..., n_out, n_in, n_parts)."""
        return integrals(frequency, value, self.bands)

    def settings(self) -> dict[str, Any]:
        """Nothing beside the bands."""
        return {}

    def weights(self, n_pairs: int) -> NDArray[np.float64]:
        """The bands' weights in the order of the features, for normalised inputs (equation 4.48)."""
        parts = [w for b in self.bands for w in (b.real, b.imag) if w]
        return np.tile(parts, n_pairs)


@final
@dataclass(frozen=True)
class LogBands(PairFeatures):
    r"""Means of log \|H\| and of the phasor over sub-bands; energy, centroid and spread of each band.

    Parameters
    ----------
    bands : sequence of Band
        A band whose `imag` weight is 0 gives no phasor features.
    parts : int
        Sub-bands of equal width per band.
    moments : bool
        Adds, per band, the log of the mean of \|H\|^2, its centroid and its spread in frequency.
    """

    bands: tuple[Band, ...]
    parts: int = 3
    moments: bool = True
    kind: ClassVar[str] = "log"

    def __post_init__(self) -> None:
        if self.parts < 1:
            raise ConfigError(f"features: parts = {self.parts} must be at least 1")

    def blocks(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Features of each pair, shape (..., n_out, n_in, n_per_pair)."""
        size = np.maximum(np.abs(value), TINY)
        log_size = np.log(size)
        columns: list[NDArray] = []
        for band in self.bands:
            for low, high in _split(band, self.parts):
                weights = trapezoid_weights(frequency, low, high)
                columns.append(log_size @ weights / (high - low))
                phasor = (value @ weights) / (size @ weights)
                columns += [phasor.real, phasor.imag] if band.imag else []
            columns += _moments(frequency, size, band) if self.moments else []
        return np.stack(columns, axis=-1)

    def settings(self) -> dict[str, Any]:
        """Sub-bands and whether moments are included."""
        return {"parts": self.parts, "moments": self.moments}


@final
@dataclass(frozen=True)
class SphereBands(PairFeatures):
    """Means over sub-bands of the FRF's image on the Riemann sphere: bounded for undamped structures.

    h = H / scale maps to (2 Re h, 2 Im h, |h|^2 - 1) / (|h|^2 + 1); a pole becomes the north pole of the
    sphere, reached smoothly from both sides.

    Parameters
    ----------
    bands : sequence of Band
        A band whose `imag` weight is 0 leaves the second coordinate out.
    parts : int
        Sub-bands of equal width per band.
    scale : tuple of float
        Typical |H|, one number for each output-input pair (outputs slowest) and band (fastest); empty until
        `fitted`.
    """

    bands: tuple[Band, ...]
    parts: int = 4
    scale: tuple[float, ...] = ()
    kind: ClassVar[str] = "sphere"

    def __post_init__(self) -> None:
        if self.parts < 1:
            raise ConfigError(f"features: parts = {self.parts} must be at least 1")

    def fitted(self, frequency: NDArray, value: NDArray) -> SphereBands:
        """Scales set to the geometric mean of |H| in each band."""
        log_size = np.log(np.maximum(np.abs(value), TINY))
        means = [log_size @ trapezoid_weights(frequency, b.low, b.high) / (b.high - b.low) for b in self.bands]
        typical = np.exp(np.median(np.stack(means, axis=-1), axis=0))
        return replace(self, scale=tuple(float(s) for s in typical.reshape(-1)))

    def blocks(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Features of each pair, shape (..., n_out, n_in, n_per_pair)."""
        n_out, n_in = value.shape[-3:-1]
        if len(self.scale) != n_out * n_in * len(self.bands):
            raise ConfigError("features: the sphere has no scale for these channels; call fitted() first")
        scale = np.reshape(self.scale, (n_out, n_in, len(self.bands)))
        columns: list[NDArray] = []
        for number, band in enumerate(self.bands):
            h = value / scale[:, :, number, None]
            bottom = np.abs(h) ** 2 + 1
            for low, high in _split(band, self.parts):
                weights = trapezoid_weights(frequency, low, high) / (high - low)
                columns += [(2 * h.real / bottom) @ weights, (1 - 2 / bottom) @ weights]
                columns += [(2 * h.imag / bottom) @ weights] if band.imag else []
        return np.stack(columns, axis=-1)

    def settings(self) -> dict[str, Any]:
        """Sub-bands and scales."""
        return {"parts": self.parts, "scale": list(self.scale)}


def _split(band: Band, parts: int) -> list[tuple[float, float]]:
    edges = np.linspace(band.low, band.high, parts + 1)
    return list(pairwise(edges))


def _moments(frequency: NDArray, size: NDArray, band: Band) -> list[NDArray]:
    weights = trapezoid_weights(frequency, band.low, band.high)
    power = size**2
    total = power @ weights
    width = band.high - band.low
    place = (frequency - band.low) / width
    centroid = (power @ (weights * place)) / total
    second = (power @ (weights * place**2)) / total - centroid**2
    return [np.log(total / width), centroid, np.log(np.maximum(second, 1e-12))]
