"""Real modes of M and K, with the precision of the low ones kept, and roots of the quadratic pencil."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, eigvals

from labnnum.errors import ModelError

_ROUNDING = 1e-11


def natural_modes(mass: NDArray, stiffness: NDArray, n: int | None = None) -> tuple[NDArray, NDArray]:
    """Squared frequencies, (m,), rad^2/s^2, ascending, and shapes with shape^T M shape = 1, (n_coordinates, m).

    Motions without mass are left out; those whose strain energy is nothing but rounding have frequency 0 exactly.

    Raises
    ------
    ModelError
        If a coordinate has neither mass nor stiffness, or nothing has mass.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.diag(stiffness) / np.diag(mass)
    ratios = ratios[np.isfinite(ratios) & (ratios > 0)]
    shift = 1e-3 * float(ratios.min()) if ratios.size else 1.0
    size = mass.shape[0]
    low = 0 if n is None else max(0, size - n)
    try:
        inverse, psi = eigh(mass, stiffness + shift * mass, subset_by_index=(low, size - 1))
    except np.linalg.LinAlgError:
        raise ModelError("the structure is singular: a coordinate has neither mass nor stiffness") from None
    kept = inverse > 1e-14 * max(float(inverse.max()), 0.0)
    if not kept.any():
        raise ModelError("the structure has no mass, so it has no modes")
    psi = psi[:, kept]
    shape = psi / np.sqrt(np.einsum("ij,ij->j", psi, mass @ psi))
    energy = np.einsum("ij,ij->j", shape, stiffness @ shape)
    gross = np.einsum("ij,ij->j", np.abs(shape), np.abs(stiffness) @ np.abs(shape))
    omega2 = np.where(energy > _ROUNDING * gross, energy, 0.0)
    order = np.argsort(omega2, kind="stable")
    return omega2[order], shape[:, order]


def moves_freely(stiffness: NDArray) -> bool:
    """Whether a motion exists whose strain energy is nothing but rounding."""
    diagonal = np.abs(np.diag(stiffness))
    if (diagonal == 0).any():
        return True
    scale = 1 / np.sqrt(diagonal)
    scaled = scale[:, None] * ((stiffness + stiffness.T) / 2) * scale
    _, vectors = np.linalg.eigh(scaled)
    softest = vectors[:, 0]
    energy = softest @ scaled @ softest
    return bool(abs(energy) < _ROUNDING * (np.abs(softest) @ np.abs(scaled) @ np.abs(softest)))


def pencil_poles(mass: NDArray, damping: NDArray, stiffness: NDArray) -> NDArray[np.complex128]:
    """Finite roots of det(K + s C + s^2 M), unsorted; of a complex K those with positive imaginary part only."""
    n = mass.shape[0]
    left = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    right = np.block([[np.eye(n), np.zeros((n, n))], [np.zeros((n, n)), mass]])
    top, bottom = np.asarray(eigvals(left, right, homogeneous_eigvals=True))
    finite = np.abs(bottom) > 1e-13 * np.abs(top)
    found = np.asarray(top[finite] / bottom[finite], complex)
    return found[np.imag(found) > 0] if np.iscomplexobj(stiffness) else found


def coupled_poles(omega2: NDArray, damping: NDArray, loss: NDArray) -> NDArray[np.complex128]:
    """Poles from modal stiffness (m,), damping (m, m) and loss (m, m); velocities scaled by each mode's frequency."""
    omega = np.sqrt(np.maximum(omega2, 1e-12 * omega2.max(initial=1.0)))
    n = omega.size
    elastic = (np.diag(omega2) + 1j * loss) / omega if loss.any() else np.diag(omega2) / omega
    state = np.block([[np.zeros((n, n)), np.diag(omega)], [-elastic, -damping]])
    return np.linalg.eigvals(state).astype(complex)


def couples(a: NDArray) -> bool:
    """Whether a modal matrix has off-diagonal terms beyond rounding."""
    size = np.sqrt(np.abs(np.diag(a)))
    off = np.abs(a - np.diag(np.diag(a)))
    return bool((off > 1e-10 * np.outer(size, size) + 1e-12 * np.abs(a).max(initial=0.0)).any())


def sorted_poles(found: NDArray, structural: bool) -> NDArray[np.complex128]:
    """Poles of a stable structure, ascending in magnitude, conjugates side by side; rounding to the right is removed.

    With structural damping each upper one gets its mirror.
    """
    if structural:
        upper = found[np.imag(found) > 0]
        found = np.concatenate([upper, np.conj(upper)])
    found = np.minimum(np.real(found), 0.0) + 1j * np.imag(found)
    top = max(float(np.abs(found).max(initial=0.0)), 1e-300)
    size = np.round(np.abs(found) / top, 11)
    return found[np.lexsort((-np.imag(found), np.round(np.real(found) / top, 11), size))]
