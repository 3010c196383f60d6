"""Radial functions of a network, distances between its inputs and centres, and the polynomial tail.

Source: Atalla (1996), equations 3.2 and 4.37; Wendland, *Scattered data approximation*, 2005, for the smooth ones.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

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


def tail_gradient(z: NDArray, degree: int) -> NDArray[np.float64]:
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


def tail_forms(tail: NDArray, degree: int, k: int) -> NDArray[np.float64]:
    """The tail of each output as matrices F with (1, z)' F (1, z), shape (n_outputs, 1 + k, 1 + k)."""
    out = np.zeros((tail.shape[1], 1 + k, 1 + k))
    if degree >= 0:
        out[:, 0, 0] = tail[0]
    if degree >= 1:
        out[:, 1:, 0] = tail[1 : 1 + k].T
    if degree >= 2:
        i, j = np.triu_indices(k)
        out[:, 1 + i, 1 + j] = tail[1 + k :].T
    return out
