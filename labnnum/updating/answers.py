"""A network's arithmetic for many feature vectors: everything a matrix product, in blocks that stay in the cache.

Inputs stand in columns. The exponents of a Gaussian kernel are one product of (-|c|^2/2, c, 1) with (1, z, -|z|^2/2);
the polynomial tail is the form (1, z)' F (1, z), so that no monomial is ever written out; the second stage's
coefficients are one product with (1, z).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.updating.gains import powers_of, second_answer
from labnnum.updating.kernels import KERNELS, tail_forms

COLUMNS = 256
"""Feature vectors that are answered together."""


@final
@dataclass(frozen=True, eq=False)
class Answers:
    """What `RbfNetwork` computes with, prepared once.

    Parameters
    ----------
    kernel : str
        A key of `KERNELS`.
    exponents : ndarray, shape (n_centres, n_inputs + 2)
        (-|c|^2/2, c, 1): minus half the squared distance, as factors of (1, z, -|z|^2/2).
    weights : ndarray, shape (n_outputs, n_centres)
    forms : ndarray, shape (n_outputs (1 + n_inputs), 1 + n_inputs)
        The tail as quadratic forms; empty where there is none.
    gains : ndarray, shape (n_outputs n_polynomials, 1 + n_inputs)
        The second stage; empty where there is none.
    reach : ndarray, shape (n_outputs,)
    powers : int
        Degree of the second stage.
    """

    kernel: str
    exponents: NDArray[np.float64]
    weights: NDArray[np.float64]
    forms: NDArray[np.float64]
    gains: NDArray[np.float64]
    reach: NDArray[np.float64]
    powers: int

    @classmethod
    def of(
        cls, kernel: str, centres: NDArray, weights: NDArray, tail: NDArray, degree: int, gains: NDArray, reach: NDArray
    ) -> Answers:
        """From the arrays of a network, see `RbfNetwork`."""
        n, k = centres.shape
        half = -0.5 * np.einsum("ij,ij->i", centres, centres)
        forms = tail_forms(tail, degree, k).reshape(-1, 1 + k) if degree >= 0 else np.empty((0, 1 + k))
        return cls(
            kernel,
            np.hstack([half[:, None], centres, np.ones((n, 1))]),
            np.ascontiguousarray(weights.T),
            forms,
            np.ascontiguousarray(gains.transpose(2, 0, 1)).reshape(-1, 1 + k) if gains.size else np.empty((0, 1 + k)),
            reach,
            powers_of(gains, reach.size) if gains.size else 0,
        )

    def __call__(self, z: NDArray) -> NDArray[np.float64]:
        """Normalised answers, shape (n, n_outputs), to inputs z (n, n_inputs)."""
        out = np.empty((len(z), len(self.weights)))
        for start in range(0, len(z), COLUMNS):
            part = slice(start, start + COLUMNS)
            columns = _columns(z[part])
            y = self._first(columns)
            if self.gains.size:
                y = second_answer(y, columns[:-1], self.gains, self.reach, self.powers)
            out[part] = y.T
        return out

    def first(self, z: NDArray) -> NDArray[np.float64]:
        """Normalised answer of kernels and tail, shape (n_outputs,), to one input z (n_inputs,)."""
        return self._first(_columns(z[None]))[:, 0]

    def _first(self, columns: NDArray) -> NDArray[np.float64]:
        s = self.exponents @ columns
        phi = np.exp(s, out=s) if self.kernel == "gaussian" else KERNELS[self.kernel](np.maximum(-2.0 * s, 0.0))[0]
        y = self.weights @ phi
        if self.forms.size:
            affine = columns[:-1]
            y += np.einsum("okn,kn->on", (self.forms @ affine).reshape(len(y), *affine.shape), affine)
        return y


def _columns(z: NDArray) -> NDArray[np.float64]:
    """(1, z, -|z|^2/2) in columns, shape (n_inputs + 2, n)."""
    out = np.empty((z.shape[1] + 2, len(z)))
    out[0], out[1:-1] = 1.0, z.T
    out[-1] = -0.5 * np.einsum("ij,ij->i", z, z)
    return out
