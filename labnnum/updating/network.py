"""The radial basis function network: what it is, and what it answers. How it is trained: fitting.py.

The answer to a feature vector x is

    y = shift + scale * (W phi(|z - c_j|) + V p(z)),    z = (x - x0) A

with centres c_j, kernel phi and a polynomial tail p (kernels.py, answers.py). The dissertation's network is the
special case phi = exp(-d) with no tail. A network trained on many samples has a second stage, gains.py.
Source: Atalla (1996), equations 3.2, 3.21, 4.2 and 4.37.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.recording import readonly
from labnnum.updating.answers import Answers
from labnnum.updating.gains import second_jacobian
from labnnum.updating.kernels import KERNELS, tail_gradient


@final
@dataclass(frozen=True, eq=False)
class RbfNetwork:
    """A trained network: features in, parameters out.

    Parameters
    ----------
    origin : ndarray, shape (n_features,)
        x0: what is taken from a feature vector first.
    projection : ndarray, shape (n_features, n_inputs)
        A: normalisation, rotation to principal components and kernel scales in one matrix.
    centres : ndarray, shape (n_centres, n_inputs)
    weights : ndarray, shape (n_centres, n_outputs)
    tail : ndarray, shape (n_terms, n_outputs)
        Weights of the polynomial.
    degree : int
        Of the polynomial; -1 for none.
    kernel : str
        A key of `KERNELS`.
    shift, scale : ndarray, shape (n_outputs,)
        Of the outputs.
    residual : ndarray, shape (n_outputs, n_outputs)
        Covariance of the leave-one-out (or validation) error, in parameter units.
    kind : str
        "printed" or "tuned".
    gamma : float
        The printed network's scale of spread constants; NaN otherwise.
    gains : ndarray, shape (n_polynomials, 1 + n_inputs, n_outputs)
        The second stage, `labnnum.updating.gains`; empty where there is none.
    reach : ndarray, shape (n_outputs,)
        Largest normalised first answer over the training set.
    """

    origin: NDArray[np.float64]
    projection: NDArray[np.float64]
    centres: NDArray[np.float64]
    weights: NDArray[np.float64]
    tail: NDArray[np.float64]
    degree: int
    kernel: str
    shift: NDArray[np.float64]
    scale: NDArray[np.float64]
    residual: NDArray[np.float64]
    kind: str = "tuned"
    gamma: float = float("nan")
    gains: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 0, 0)))
    reach: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        if self.kernel not in KERNELS:
            raise EstimationError(f"network: kernel {self.kernel!r} is not one of {', '.join(KERNELS)}")
        for one in fields(self):
            value = getattr(self, one.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, one.name, readonly(value))

    @property
    def n_features(self) -> int:
        """Length of the feature vectors that it accepts."""
        return self.origin.size

    @property
    def n_outputs(self) -> int:
        """Number of parameters that it answers with."""
        return self.shift.size

    def inputs(self, features: NDArray) -> NDArray[np.float64]:
        """Scaled inputs z of feature vectors, shape (n, n_inputs)."""
        x = np.asarray(features, float)
        if x.shape[-1] != self.n_features:
            raise EstimationError(f"the network takes {self.n_features} features, not {x.shape[-1]}")
        return (x - self.origin) @ self.projection

    def __call__(self, features: NDArray) -> NDArray[np.float64]:
        """Parameters for one feature vector (n_features,) or for many (n, n_features)."""
        z = self.inputs(features)
        y = self._answers(np.atleast_2d(z))
        return (self.shift + self.scale * y).reshape(*z.shape[:-1], -1)

    @cached_property
    def _answers(self) -> Answers:
        return Answers.of(self.kernel, self.centres, self.weights, self.tail, self.degree, self.gains, self.reach)

    def jacobian(self, features: NDArray) -> NDArray[np.float64]:
        """Derivative of the parameters to the features at one feature vector, shape (n_outputs, n_features).

        Source: Atalla (1996), equation 4.43, for any kernel and with the tail.
        """
        z = self.inputs(features)
        offset = z - self.centres
        slope = KERNELS[self.kernel](np.einsum("ij,ij->i", offset, offset))[1]
        by_input = (self.weights * (2 * slope)[:, None]).T @ offset
        if self.degree >= 1:
            by_input += self.tail.T @ tail_gradient(z, self.degree)
        if self.gains.size:
            by_input = second_jacobian(self._answers.first(z), by_input, z, self.gains, self.reach)
        return self.scale[:, None] * (by_input @ self.projection.T)

    def arrays(self) -> dict[str, Any]:
        """Everything that recreates the network with `RbfNetwork(**arrays)`."""
        return {one.name: getattr(self, one.name) for one in fields(self)}
