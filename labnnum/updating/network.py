"""The radial basis function network: what it is, and what it answers. How it is trained: fitting.py.

The answer to a feature vector x is

    y = shift + scale * (W phi(|z - c_j|) + V p(z)),    z = (x - x0) A

with centres c_j, kernel phi and a polynomial tail p. The dissertation's network is the special case
phi = exp(-d) with no tail. A network trained on many samples has a second stage, gains.py.
Source: Atalla (1996), equations 3.2, 3.21, 4.2 and 4.37.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.recording import readonly
from labnnum.updating.gains import second_answer, second_jacobian

Profile = Callable[[NDArray], tuple[NDArray, NDArray]]


def _exponential(s: NDArray) -> tuple[NDArray, NDArray]:
    r = np.sqrt(s)
    value = np.exp(-r)
    return value, -value / (2 * np.maximum(r, 1e-12))


def _gaussian(s: NDArray) -> tuple[NDArray, NDArray]:
    value = np.exp(-s / 2)
    return value, -value / 2


def _matern52(s: NDArray) -> tuple[NDArray, NDArray]:
    r = np.sqrt(5 * s)
    decay = np.exp(-r)
    return (1 + r + r**2 / 3) * decay, -(5 / 6) * (1 + r) * decay


def _inverse_multiquadric(s: NDArray) -> tuple[NDArray, NDArray]:
    value = 1 / np.sqrt(1 + s)
    return value, -(value**3) / 2


KERNELS: dict[str, Profile] = {
    "exponential": _exponential,
    "gaussian": _gaussian,
    "matern52": _matern52,
    "inverse_multiquadric": _inverse_multiquadric,
}
"""Kernel name -> function of the squared distance s that gives phi(s) and dphi/ds."""


_ROWS = 256
"""Feature vectors that are answered together: their distances stay in the processor's cache."""


def kernel_values(kernel: str, s: NDArray) -> NDArray[np.float64]:
    """phi(s) of a kernel, without its derivative; s may be written over."""
    if kernel == "gaussian":
        s *= -0.5
        return np.exp(s, out=s)
    return KERNELS[kernel](s)[0]


def squared_distances(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Squared Euclidean distances between rows, shape (len(a), len(b))."""
    s = a @ (-2.0 * b.T)
    s += np.einsum("ij,ij->i", a, a)[:, None]
    s += np.einsum("ij,ij->i", b, b)
    return np.maximum(s, 0.0, out=s)


def tail_terms(z: NDArray, degree: int) -> NDArray[np.float64]:
    """Monomials of z up to `degree` (-1: none, 0, 1 or 2), shape (n, n_terms)."""
    n, k = z.shape
    columns = [np.ones((n, 1))] if degree >= 0 else [np.empty((n, 0))]
    if degree >= 1:
        columns.append(z)
    if degree >= 2:
        i, j = np.triu_indices(k)
        columns.append(z[:, i] * z[:, j])
    return np.hstack(columns)


def _tail_gradient(z: NDArray, degree: int) -> NDArray[np.float64]:
    """Derivatives of the tail terms at one point z, shape (n_terms, k)."""
    k = z.size
    rows = [np.zeros((1, k))] if degree >= 0 else [np.empty((0, k))]
    if degree >= 1:
        rows.append(np.eye(k))
    if degree >= 2:
        i, j = np.triu_indices(k)
        unit = np.eye(k)
        rows.append(unit[i] * z[j, None] + unit[j] * z[i, None])
    return np.vstack(rows)


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
        rows = np.atleast_2d(z)
        y = np.empty((len(rows), self.n_outputs))
        for start in range(0, len(rows), _ROWS):
            part = slice(start, start + _ROWS)
            y[part] = self._first(rows[part])
            if self.gains.size:
                y[part] = second_answer(y[part], rows[part], self.gains, self.reach)
        return (self.shift + self.scale * y).reshape(*z.shape[:-1], -1)

    def _first(self, rows: NDArray) -> NDArray[np.float64]:
        """Normalised answers of the kernels and the tail, shape (n, n_outputs)."""
        y = kernel_values(self.kernel, squared_distances(rows, self.centres)) @ self.weights
        return y + tail_terms(rows, self.degree) @ self.tail if self.degree >= 0 else y

    def jacobian(self, features: NDArray) -> NDArray[np.float64]:
        """Derivative of the parameters to the features at one feature vector, shape (n_outputs, n_features).

        Source: Atalla (1996), equation 4.43, for any kernel and with the tail.
        """
        z = self.inputs(features)
        offset = z - self.centres
        slope = KERNELS[self.kernel](np.einsum("ij,ij->i", offset, offset))[1]
        by_input = (self.weights * (2 * slope)[:, None]).T @ offset
        if self.degree >= 1:
            by_input += self.tail.T @ _tail_gradient(z, self.degree)
        if self.gains.size:
            by_input = second_jacobian(self._first(z[None])[0], by_input, z, self.gains, self.reach)
        return self.scale[:, None] * (by_input @ self.projection.T)

    def arrays(self) -> dict[str, Any]:
        """Everything that recreates the network with `RbfNetwork(**arrays)`."""
        return {one.name: getattr(self, one.name) for one in fields(self)}
