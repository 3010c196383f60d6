"""Whether a measurement is of the kind that the network was trained on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.frf import Frf
from labnnum.recording import readonly
from labnnum.updating.features import Features
from labnnum.updating.noise import noise_of

_COPIES = 64
_MARGIN = 1.5


@dataclass(frozen=True, eq=False)
class Novelty:
    """Distance between measured features and those of the model at the network's answer.

    A measurement of the trained kind comes back to itself through network and model; one from another structure,
    with a wrong channel or with parameters outside the range does not.

    Parameters
    ----------
    differences : ndarray, shape (n_validation, n_features)
        The same differences on validation sets.
    box : ndarray, shape (2, n_parameters)
        Range of the training parameters.
    """

    differences: NDArray[np.float64]
    box: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "differences", readonly(self.differences))
        object.__setattr__(self, "box", readonly(self.box))

    def distance(self, difference: NDArray, scatter: NDArray) -> tuple[float, float]:
        """Mean squared difference in units of its expected scatter, and the limit beyond which it is novel.

        Parameters
        ----------
        difference : ndarray, shape (n_features,)
        scatter : ndarray, shape (n_copies, n_features)
            What the measurement's random error does to the features.

        Notes
        -----
        The limit is 1.5 times the largest of the distances that validation differences plus random errors show:
        no distribution is assumed.
        """
        known = self.differences
        variance = (known**2).mean(axis=0) + (scatter**2).mean(axis=0) + 1e-24
        value = float((difference**2 / variance).mean())
        reference = known + scatter[np.arange(len(known)) % len(scatter)]
        return value, _MARGIN * float((reference**2 / variance).mean(axis=1).max())

    def verdict(self, difference: NDArray, scatter: NDArray) -> tuple[str, ...]:
        """Empty, or the warning that the measurement is not of the trained kind."""
        value, limit = self.distance(difference, scatter)
        if value <= limit:
            return ()
        return (
            f"outside the training range: no parameters in range give such an FRF (distance {value:.3g}, limit"
            f" {limit:.3g}); check channels and structure, or widen the bounds and retrain",
        )


def feature_noise(
    frf: Frf, features: Features, variance: NDArray | None = None, copies: int = _COPIES, seed: int = 5
) -> NDArray[np.float64]:
    """Changes of the features under random errors of an FRF, shape (copies, n_features).

    Parameters
    ----------
    frf : Frf
    features : Features
    variance : ndarray, shape (n_out, n_in, n_f), optional
        E|dH|^2 of errors that are independent from line to line; by default the FRF's own errors. Neighbouring lines
        share those, which integrals feel: they are enlarged by the root of the integrated correlation.
    """
    if variance is None:
        noise = noise_of(frf)
        variance = noise.variance * noise.memory
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((2, copies, *frf.value.shape))
    error = (normal[0] + 1j * normal[1]) * np.sqrt(variance / 2)
    centre = features(frf.frequency, frf.value)
    return features(frf.frequency, frf.value + error) - centre
