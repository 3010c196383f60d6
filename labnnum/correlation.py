"""Comparing measured and modelled modes and FRFs, and making them comparable: chapter 2 of the dissertation.

Mode shapes are columns. Equation numbers are those of Atalla (1996) unless another source is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ModelError

# ------------------------------------------------------------------ comparing


def mac(measured: ArrayLike, modelled: ArrayLike) -> NDArray[np.float64]:
    """Modal assurance criterion, shape (n_measured, n_modelled): 1 where two shapes are proportional (eq. 2.1).

    Parameters
    ----------
    measured, modelled : array_like, shape (n, n_measured) and (n, n_modelled)
        Real or complex shapes at the same degrees of freedom.

    Examples
    --------
    >>> mac([[1.0], [1.0]], [[2.0, 1.0], [2.0, -1.0]])
    array([[1., 0.]])
    """
    return mass_mac(measured, modelled, None)


def mass_mac(measured: ArrayLike, modelled: ArrayLike, mass: ArrayLike | None) -> NDArray[np.float64]:
    """Modal assurance criterion in the norm of a mass matrix, shape (n_measured, n_modelled) (eq. 2.2).

    The numerator is |u^H M v|^2, with the denominator (u^H M u)(v^H M v).
    """
    u, v = _columns(measured), _columns(modelled)
    if u.shape[0] != v.shape[0]:
        raise ModelError(f"shapes of {u.shape[0]} and {v.shape[0]} degrees of freedom cannot be compared")
    m = np.eye(u.shape[0]) if mass is None else np.asarray(mass, float)
    across = np.abs(u.conj().T @ m @ v) ** 2
    own = np.outer(_energies(u, m), _energies(v, m))
    return np.divide(across, own, out=np.zeros(across.shape), where=own > 0)


def pairs(criterion: ArrayLike, threshold: float = 0.0) -> tuple[tuple[int, int], ...]:
    """Measured and modelled mode numbers, paired one to one so that the sum of MAC is largest; weak pairs left out."""
    from scipy.optimize import linear_sum_assignment

    c = np.asarray(criterion, float)
    rows, columns = linear_sum_assignment(-c)
    return tuple((int(i), int(j)) for i, j in zip(rows, columns, strict=True) if c[i, j] >= threshold)


def modal_scale_factor(measured: ArrayLike, modelled: ArrayLike) -> NDArray:
    """Factors, shape (n_modes,), that scale the measured shapes to the modelled ones in size and sign (eq. 2.21).

    Complex shapes use the conjugate transpose, for which the formula is the least-squares factor.
    """
    e, a = _columns(measured), _columns(modelled)
    return np.einsum("ij,ij->j", e.conj(), a) / np.einsum("ij,ij->j", e.conj(), e)


def frac(measured: ArrayLike, modelled: ArrayLike) -> NDArray[np.float64]:
    """Frequency response assurance criterion over the last axis: 1 where two FRFs are proportional.

    |sum H_a^* H_x|^2 / (sum |H_a|^2 sum |H_x|^2), Heylen and Lammens (1996).
    """
    x, a = np.asarray(measured), np.asarray(modelled)
    across = np.abs((a.conj() * x).sum(axis=-1)) ** 2
    own = (np.abs(a) ** 2).sum(axis=-1) * (np.abs(x) ** 2).sum(axis=-1)
    return np.divide(across, own, out=np.zeros(np.shape(across)), where=own > 0)


def real_modes(shapes: ArrayLike) -> NDArray[np.float64]:
    """Real shapes nearest to complex ones, shape (n, n_modes) (eq. 2.3, 2.4).

    Each shape is first turned by the phase that makes its imaginary part smallest; the equation assumes a real part
    that dominates.
    """
    turned = _columns(shapes) * np.exp(-0.5j * np.angle((_columns(shapes) ** 2).sum(axis=0)))
    re, im = np.real(turned), np.imag(turned)
    return re + im @ np.linalg.lstsq(re, im, rcond=None)[0]


# ------------------------------------------------------------------ expansion and reduction


def expand_by_matrices(
    shapes: ArrayLike, omega: ArrayLike, mass: ArrayLike, stiffness: ArrayLike, masters: Sequence[int]
) -> NDArray:
    """Shapes on all coordinates, (n, n_modes), from those on the masters, (n_masters, n_modes) (eq. 2.5, 2.6).

    Parameters
    ----------
    omega : array_like, shape (n_modes,)
        Measured natural frequencies, rad/s.
    """
    m, k = np.asarray(mass, float), np.asarray(stiffness, float)
    held = _columns(shapes)
    inner, master = _slaves(m.shape[0], masters), np.asarray(masters)
    out = np.zeros((m.shape[0], held.shape[1]), held.dtype)
    out[master] = held
    for i, w in enumerate(np.asarray(omega, float)):
        z = k - w**2 * m
        out[inner, i] = -np.linalg.solve(z[np.ix_(inner, inner)], z[np.ix_(inner, master)] @ held[:, i])
    return out


@dataclass(frozen=True, eq=False)
class Expansion:
    """Shapes expanded by the model's own.

    Parameters
    ----------
    shapes : ndarray, shape (n, n_modes)
        On all coordinates; at the masters the smoothed ones (eq. 2.10).
    weights : ndarray, shape (n_modelled, n_modes)
        Share of each modelled shape (eq. 2.8).
    """

    shapes: NDArray
    weights: NDArray


def expand_by_modes(shapes: ArrayLike, modelled: ArrayLike, masters: Sequence[int]) -> Expansion:
    """Measured shapes on all coordinates as sums of modelled shapes, (n, n_modelled) (eq. 2.7 to 2.10)."""
    all_modes, master = _columns(modelled), np.asarray(masters)
    weights = np.linalg.lstsq(all_modes[master], _columns(shapes), rcond=None)[0]
    return Expansion(all_modes @ weights, weights)


@dataclass(frozen=True, eq=False)
class Reduction:
    """A model on fewer coordinates: x = T x_masters, with M and K reduced by T (eq. 2.14)."""

    transformation: NDArray[np.float64]
    mass: NDArray[np.float64]
    stiffness: NDArray[np.float64]


def guyan(mass: ArrayLike, stiffness: ArrayLike, masters: Sequence[int]) -> Reduction:
    """Static reduction to the masters, exact at zero frequency (eq. 2.11 to 2.14)."""
    m, k = np.asarray(mass, float), np.asarray(stiffness, float)
    inner, master = _slaves(k.shape[0], masters), np.asarray(masters)
    t = np.zeros((k.shape[0], master.size))
    t[master] = np.eye(master.size)
    try:
        t[inner] = -np.linalg.solve(k[np.ix_(inner, inner)], k[np.ix_(inner, master)])
    except np.linalg.LinAlgError:
        raise ModelError("the coordinates to be reduced move freely among themselves: choose more masters") from None
    return Reduction(t, t.T @ m @ t, t.T @ k @ t)


def serep(mass: ArrayLike, stiffness: ArrayLike, shapes: ArrayLike, masters: Sequence[int]) -> Reduction:
    """System equivalent reduction: keeps the given modes exactly (eq. 2.15).

    Parameters
    ----------
    shapes : array_like, shape (n, n_modes)
        Modes to keep; not more than masters.

    Raises
    ------
    ModelError
        If the masters cannot tell the modes apart.
    """
    phi, master = np.asarray(shapes, float), np.asarray(masters)
    if np.linalg.matrix_rank(phi[master]) < phi.shape[1]:
        raise ModelError(f"{master.size} masters cannot tell {phi.shape[1]} modes apart: choose more, or others")
    t = phi @ np.linalg.pinv(phi[master])
    m, k = np.asarray(mass, float), np.asarray(stiffness, float)
    return Reduction(t, t.T @ m @ t, t.T @ k @ t)


# ------------------------------------------------------------------ where to place transducers


def place_by_guyan(
    mass: ArrayLike, stiffness: ArrayLike, count: int, candidates: Sequence[int] | None = None
) -> tuple[int, ...]:
    """Coordinates for `count` transducers: those with large k_ii/m_ii are reduced out one at a time (section 2.2.5).

    Parameters
    ----------
    candidates : sequence of int, optional
        Coordinates where a transducer can be mounted; the others are reduced first.
    """
    m, k = np.asarray(mass, float), np.asarray(stiffness, float)
    left = list(range(m.shape[0]))
    allowed = set(left if candidates is None else candidates)
    _require_count(count, len(allowed))
    while len(left) > count:
        outside = [i for i, c in enumerate(left) if c not in allowed]
        with np.errstate(divide="ignore"):
            ratio = np.diag(k) / np.diag(m)
        removed = max(outside or range(len(left)), key=lambda i: ratio[i])
        keep = [i for i in range(len(left)) if i != removed]
        reduced = guyan(m, k, keep)
        m, k = reduced.mass, reduced.stiffness
        left.pop(removed)
    return tuple(left)


def effective_independence(
    shapes: ArrayLike, count: int, candidates: Sequence[int] | None = None
) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    """Coordinates for `count` transducers that keep the shapes as independent as possible (eq. 2.16, 2.17).

    Returns
    -------
    chosen : tuple of int
        Ascending.
    share : ndarray, shape (count,)
        Diagonal of the idempotent matrix E at the chosen coordinates: each one's contribution to the rank.
    """
    phi = np.asarray(shapes, float)
    left = list(range(phi.shape[0]) if candidates is None else candidates)
    _require_count(count, len(left))
    if count < phi.shape[1]:
        raise ModelError(f"{count} transducers cannot tell {phi.shape[1]} modes apart: ask for at least that many")
    while True:
        basis = np.linalg.qr(phi[left])[0]
        share = (basis**2).sum(axis=1)
        if len(left) == count:
            return tuple(sorted(left)), share[np.argsort(left)]
        left.pop(int(np.argmin(share)))


# ------------------------------------------------------------------ where the error is


@dataclass(frozen=True, eq=False)
class Subspace:
    """Best sub-basis of one size: the columns chosen, their coefficients, and the error e^P (eq. 2.19)."""

    columns: tuple[int, ...]
    coefficients: NDArray[np.float64]
    error: float


def best_subspaces(sensitivity: ArrayLike, observed: ArrayLike, largest: int | None = None) -> tuple[Subspace, ...]:
    """Best one, two, ... columns of S that represent b in S theta = b (eq. 2.18, 2.19).

    One column is added at a time, the one that leaves the smallest distance; substructures whose columns come first
    are likely to hold the errors of the model.

    Parameters
    ----------
    sensitivity : array_like, shape (n, n_parameters)
    observed : array_like, shape (n,)
    largest : int, optional
        Size of the largest sub-basis.

    References
    ----------
    Lallement and Piranda (1990); Atalla (1996), section 2.3.
    """
    s, b = _stacked(sensitivity), _stacked(observed)
    size = float(np.linalg.norm(b))
    if size == 0:
        raise ModelError("the observations are all zero: there is no error to locate")
    chosen: list[int] = []
    found = []
    for _ in range(min(largest or s.shape[1], s.shape[1], s.shape[0])):
        trials = [(_distance(s[:, [*chosen, j]], b), j) for j in range(s.shape[1]) if j not in chosen]
        chosen.append(min(trials)[1])
        coefficients = np.asarray(np.linalg.lstsq(s[:, chosen], b, rcond=None)[0], float)
        found.append(
            Subspace(tuple(chosen), coefficients, float(np.linalg.norm(b - s[:, chosen] @ coefficients)) / size)
        )
    return tuple(found)


def _distance(basis: NDArray, b: NDArray) -> float:
    return float(np.linalg.norm(b - basis @ np.linalg.lstsq(basis, b, rcond=None)[0]))


def _stacked(a: ArrayLike) -> NDArray[np.float64]:
    """Real and imaginary part one over the other; real parameters see both."""
    a = np.asarray(a)
    return np.concatenate([np.real(a), np.imag(a)]) if np.iscomplexobj(a) else np.asarray(a, float)


def _columns(shapes: ArrayLike) -> NDArray:
    a = np.asarray(shapes)
    return a[:, None] if a.ndim == 1 else a


def _energies(u: NDArray, m: NDArray) -> NDArray[np.float64]:
    return np.real(np.einsum("ij,ij->j", u.conj(), m @ u))


def _slaves(n: int, masters: Sequence[int]) -> NDArray[np.intp]:
    bad = [i for i in masters if not 0 <= i < n]
    if bad or len(set(masters)) < len(masters) or not len(masters):
        raise ModelError(f"masters {list(masters)} must be different coordinates from 0 to {n - 1}")
    return np.setdiff1d(np.arange(n), masters)


def _require_count(count: int, available: int) -> None:
    if not 1 <= count <= available:
        raise ModelError(f"{count} transducers were asked for, {available} coordinates can carry one")
