"""Modal superposition for many parameter sets at once, on a reduced basis where the structure is large."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.updating.family import MatrixFamily

_DIAGONAL = 1e-9


@dataclass(frozen=True, eq=False)
class Reduction:
    """A family projected onto a fixed basis: V^T A V for each term of M, C, K and D.

    Parameters
    ----------
    basis : ndarray, shape (size, n)
    terms : tuple of ndarray, each (n_terms, n, n)
        Of M, C, K and D.
    """

    basis: NDArray[np.float64]
    terms: tuple[NDArray[np.float64], ...]

    @classmethod
    def of(cls, family: MatrixFamily, basis: NDArray) -> Reduction:
        """The projected terms."""
        projected = tuple(
            np.array([basis.T @ family.filled(kind, row) @ basis for row in c]).reshape(
                len(family.powers), basis.shape[1], basis.shape[1]
            )
            for kind, c in enumerate(family.coefficients)
        )
        return cls(basis, projected)

    def at(self, values: NDArray) -> tuple[NDArray[np.float64], ...]:
        """Reduced M, C, K and D, each (n_sets, n, n), for values of the terms (n_sets, n_terms)."""
        return tuple(np.tensordot(values, t, axes=(1, 0)) for t in self.terms)


@dataclass(frozen=True, eq=False)
class BatchModes:
    """Modes of many parameter sets, scaled to unit modal mass.

    Parameters
    ----------
    shape : ndarray, shape (n_sets, n, n)
        Columns, in reduced coordinates.
    stiffness, damping, loss : ndarray, shape (n_sets, n)
        Diagonals of shape^T A shape with A = K, C, D.
    coupling : float
        Largest off-diagonal damping, as a share of the diagonal: 0 where superposition is exact.
    """

    shape: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]
    loss: NDArray[np.float64]
    coupling: float

    @classmethod
    def of(cls, m: NDArray, c: NDArray, k: NDArray, d: NDArray) -> BatchModes:
        """Modes of the pencils (K, M) by Cholesky and the symmetric eigenproblem."""
        half = np.linalg.inv(np.linalg.cholesky(m))
        turned = half @ k @ half.swapaxes(-1, -2)
        stiffness, vectors = np.linalg.eigh((turned + turned.swapaxes(-1, -2)) / 2)
        shape = half.swapaxes(-1, -2) @ vectors
        damping, first = _diagonal(shape, c)
        loss, second = _diagonal(shape, d)
        return cls(np.asarray(shape, float), np.asarray(stiffness, float), damping, loss, max(first, second))

    @property
    def superposes(self) -> bool:
        """Whether damping leaves the modes uncoupled."""
        return self.coupling < _DIAGONAL

    def responses(self, omega: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Real and imaginary part of 1 / (k + i d + i omega c - omega^2) of each mode, each (n_sets, n, n_lines)."""
        real = self.stiffness[..., None] - omega**2
        imaginary = -self.damping[..., None] * omega
        if self.loss.any():
            imaginary -= self.loss[..., None]
        size = real * real
        size += imaginary * imaginary
        np.divide(1.0, size, out=size)
        real *= size
        imaginary *= size
        return real, imaginary


def _diagonal(shape: NDArray, a: NDArray) -> tuple[NDArray, float]:
    if not a.any():
        return np.zeros(shape.shape[::2]), 0.0
    turned = shape.swapaxes(-1, -2) @ a @ shape
    diagonal = np.einsum("sii->si", turned)
    size = np.sqrt(np.abs(diagonal))
    off = np.abs(turned - diagonal[:, None, :] * np.eye(shape.shape[-1]))
    scale = size[:, :, None] * size[:, None, :] + 1e-12 * size.max(axis=1)[:, None, None] ** 2
    return diagonal, float((off / np.maximum(scale, 1e-300)).max())


def snapshot_basis(
    family: MatrixFamily, theta: NDArray, columns: NDArray, omega: NDArray, tolerance: float = 1e-10
) -> NDArray[np.float64]:
    """Orthonormal basis of the responses to `columns` at the parameter sets and frequencies, shape (size, n).

    Parameters
    ----------
    theta : ndarray, shape (n_sets, n_parameters)
    columns : ndarray, shape (size, n_columns)
        Loads and rows whose responses must be reproduced.
    omega : ndarray, shape (n_lines,)
        rad/s; undamped responses are taken at these, slightly off the axis.
    tolerance : float
        Relative size of the directions that are left out.
    """
    m, _, k, _ = family.dense(theta)
    found = []
    for mass, stiffness in zip(m, k, strict=True):
        for w in omega:
            z = stiffness - (w * (1 + 0.02j)) ** 2 * mass
            x = np.linalg.solve(z, columns)
            x = x / np.linalg.norm(x, axis=0)
            found += [np.real(x), np.imag(x)]
    rows = np.hstack(found)
    weight = np.sqrt(np.abs(np.diagonal(m.mean(axis=0))))
    weight = np.where(weight > 0, weight, weight.max())
    left, singular, _ = np.linalg.svd(rows * weight[:, None], full_matrices=False)
    keep = int((singular > tolerance * singular[0]).sum())
    return np.linalg.qr(left[:, :keep] / weight[:, None])[0]
