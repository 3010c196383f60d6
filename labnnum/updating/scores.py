"""Features that keep what an FRF says about the parameters: scores at reference parameter sets.

Where band integrals average noise and signal alike, a score weighs every line by how much it tells: at a reference it
is the step that least squares on log H would take from there. Scores at many references, spread over the bounds, are
alike; the few directions that they span hold almost all that any set of parameters near them says, and a network
answers from these close to the Cramer-Rao bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from labnnum.bands import Band, band_mask
from labnnum.errors import ConfigError
from labnnum.parameters import Parameter, bounds
from labnnum.recording import readonly
from labnnum.updating.features import TINY, Features

REFERENCES = 64
"""Parameter sets at which scores are taken."""

INPUTS = 36
"""Directions kept, at most."""

KEPT = 0.99
"""Share of the scores' length, as a mean over references and parameters, with which fewer directions suffice."""


@final
@dataclass(frozen=True, eq=False)
class ScoreBands(Features):
    r"""Scores of log \|H\| and of the phasor u = H/\|H\| at reference parameter sets.

    Parameters
    ----------
    bands : sequence of Band
        Lines outside count nothing; a band whose `imag` weight is 0 gives its magnitude only.
    weights : ndarray, shape (n_features, 3 n_out n_in n_f)
        Of log \|H\|, Re u and Im u of every pair and line, orthonormal rows after `spanned`; empty until
        `at_references`.

    Notes
    -----
    With s = d log H / d theta at reference r and the information G = Re s s^H, the scores are

    .. math:: G^{-1} \left[\Re s\,\log|H| + \Im s\,\Im(\bar u_r u)\right]

    linear in the three numbers of a line, bounded in the phase, and near r the parameters themselves. An error of
    the same relative size on every line reaches orthonormal directions with the same size, too.
    """

    bands: tuple[Band, ...]
    weights: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 0)))
    kind: ClassVar[str] = "score"
    components: ClassVar[int] = 48

    def __post_init__(self) -> None:
        object.__setattr__(self, "weights", readonly(np.atleast_2d(np.asarray(self.weights, float))))

    @classmethod
    def at_references(
        cls, bands: Sequence[Band], frequency: NDArray, value: NDArray, slope: NDArray, spread: NDArray
    ) -> ScoreBands:
        """Scores at the references whose FRFs are `value` (r, n_out, n_in, n_f) and slopes (r, n_par, ...).

        Parameters
        ----------
        spread : ndarray, shape (n_par,)
            Natural size of each parameter; scores come in its units.
        """
        inside = band_mask(bands, frequency)
        phased = band_mask([b for b in bands if b.imag], frequency) if any(b.imag for b in bands) else inside & False
        rows = []
        for h, one in zip(value, slope, strict=True):
            s = one * spread[:, None, None, None] / h * inside
            s = np.where(phased, s, np.real(s)).reshape(len(spread), -1)
            u = (h / np.abs(h)).reshape(-1)
            phase = np.imag(s)
            plain = np.hstack([np.real(s), -phase * np.imag(u), phase * np.real(u)])
            information = np.real(s @ s.conj().T)
            information[np.diag_indices_from(information)] *= 1 + 1e-9
            rows.append(np.linalg.solve(information, plain))
        return cls(tuple(bands), np.vstack(rows))

    def spanned(self, most: int = INPUTS, kept: float = KEPT) -> ScoreBands:
        """The leading directions of all scores, each scaled to unit length: orthonormal rows.

        Parameters
        ----------
        most : int
            Directions, at most.
        kept : float
            Fewer are taken where they hold this share of the squared length of a score, as a mean.
        """
        unit = self.weights / np.linalg.norm(self.weights, axis=1)[:, None]
        power, vectors = np.linalg.eigh(unit @ unit.T)
        power, vectors = power[::-1], vectors[:, ::-1]
        held = np.cumsum(power) / power.sum()
        count = min(most, int(np.searchsorted(held, kept)) + 1, int((power > 1e-10 * power[0]).sum()))
        return replace(self, weights=(unit.T @ (vectors[:, :count] / np.sqrt(power[:count]))).T)

    def __call__(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Scores, shape (..., n_features), of FRFs on the lines of the references."""
        del frequency
        flat = np.asarray(value).reshape(*np.shape(value)[:-3], -1)
        if self.weights.shape[1] != 3 * flat.shape[-1]:
            raise ConfigError("features: scores were made for other lines or channels; call at_references() for these")
        size = np.maximum(np.abs(flat), TINY)
        u = flat / size
        return np.concatenate([np.log(size), np.real(u), np.imag(u)], axis=-1) @ self.weights.T

    def settings(self) -> dict[str, Any]:
        """The weights."""
        return {"weights": self.weights}


def references(parameters: Sequence[Parameter], count: int = REFERENCES) -> NDArray[np.float64]:
    """Parameter sets at which scores are taken: Sobol points that fill the bounds, shape (count, n_parameters)."""
    low, high = bounds(parameters)
    sobol = qmc.Sobol(len(parameters), seed=3)
    return low + (high - low) * sobol.random_base2(int(np.ceil(np.log2(count))))[:count]
