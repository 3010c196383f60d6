"""The networks of a case: the dissertation's as printed, ours of the same size, and ours trained with noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.bands import Band
from labnnum.updating.features import BandIntegrals, Features
from labnnum.updating.fitting import fit_printed, fit_tuned
from labnnum.updating.kinds import make_features
from labnnum.updating.many import ManyFrfs
from labnnum.updating.network import RbfNetwork
from labnnum.updating.scores import ScoreBands, references
from labnnum.updating.training import Disturbance, Sampling, draw
from sessions.reproduce.cases import Case

BLOCK = 256
MARGIN = 0.05
"""Share of the range by which our samples reach beyond the bounds."""

MANY = 40
"""Principal components of a network with many more samples than centres."""

Say = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Trained:
    """A network with the features that it sees.

    Parameters
    ----------
    features : Features
    network : RbfNetwork
    noise : float
        Noise of its training FRFs, as a share of |H|.
    """

    features: Features
    network: RbfNetwork
    noise: float = 0.0

    def __call__(self, frequency: NDArray, value: NDArray) -> NDArray[np.float64]:
        """Parameters, shape (n, n_parameters), of FRFs (n, n_out, n_in, n_f)."""
        return self.network(self.features(frequency, value))


@dataclass(frozen=True, eq=False)
class Training:
    """A case and what computes its FRFs, ready to train networks.

    Parameters
    ----------
    case : Case
    solver : ManyFrfs
    seed : int
    say : callable
        Progress: (what, done, total).
    """

    case: Case
    solver: ManyFrfs
    seed: int
    say: Say

    def printed(self) -> Trained:
        """The dissertation's: integrals, samples from the prior, exp(-d), gamma by descent."""
        features = BandIntegrals(self.case.bands)
        theta, rows = self._samples(features, self.case.samples, "prior", 0.0, "network as printed")
        weights = features.weights(self.solver.shape[0] * self.solver.shape[1])
        return Trained(features, fit_printed(rows, theta, gamma=None, weights=weights))

    def clean(self, samples: int, centres: int | None = None) -> Trained:
        """Ours, without noise."""
        features = self._features(self.case.features)
        theta, rows = self._samples(features, samples, "sobol", 0.0, f"{samples} clean samples")
        most = features.components if centres is None else MANY
        return Trained(features, fit_tuned(rows, theta, centres=centres, seed=self.seed, most=most))

    def noisy(self, samples: int, centres: int, noise: float) -> Trained:
        """Ours, trained with noise: fewer centres than samples."""
        features = self._features(self.case.noisy)
        what = f"{samples} samples with {100 * noise:g} % noise"
        theta, rows = self._samples(features, samples, "sobol", noise, what)
        network = fit_tuned(rows, theta, centres=min(centres, samples), seed=self.seed, most=features.components)
        return Trained(features, network, noise)

    def _features(self, kind: str) -> Features:
        bands = tuple(Band(b.low, b.high) for b in self.case.bands)
        free = self.solver.parameters
        if kind == "score":
            value, slope = self.solver.sensitivity(references(free))
            spread = np.array([p.spread for p in free])
            return ScoreBands.at_references(bands, self.case.frequency, value, slope, spread).spanned()
        first = draw(free, 64, "sobol", self.seed, MARGIN)
        return make_features(kind, bands).fitted(self.case.frequency, self.solver.frf(first))

    def _samples(
        self, features: Features, samples: int, sampling: Sampling, noise: float, what: str
    ) -> tuple[NDArray, NDArray]:
        """Parameters and features, computed in blocks of fixed size: the numbers do not depend on memory."""
        theta = draw(self.solver.parameters, samples, sampling, self.seed, MARGIN)
        rows = []
        for start in range(0, samples, BLOCK):
            value = Disturbance(noise).on(self.solver.frf(theta[start : start + BLOCK]), self.seed, start)
            rows.append(features(self.case.frequency, value))
            self.say(what, min(start + BLOCK, samples), samples)
        return theta, np.vstack(rows)
