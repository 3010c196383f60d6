"""Solutions of (K + iD + i omega C - omega^2 M) x = b at many frequencies: by modes where damping allows.

Where it does not, by elimination. Both are exact; `solver` chooses. The modal way expands in the vectors psi of
(K + sigma M, M), which keeps full precision for the low modes, for rigid-body modes and for coordinates without mass.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from labnnum.eigen import moves_freely, pencil_poles
from labnnum.errors import ModelError
from labnnum.structures.base import Matrices

MODAL_LIMIT = 600
"""Largest number of coordinates for which all modes are computed."""

SPARSE_FROM = 120
"""Fewest coordinates for which a sparse factorisation is considered."""

_SINGULAR = 1e-14


class Solver(ABC):
    """Solves Z(omega) x = b."""

    @abstractmethod
    def solve(self, omega: NDArray, load: NDArray) -> NDArray[np.complex128]:
        """Responses, shape (n_f, n, m), to the loads, shape (n, m). ModelError where Z is singular."""

    def transfer(self, omega: NDArray, left: NDArray, load: NDArray) -> NDArray[np.complex128]:
        """The products left Z^-1 load, shape (n_f, a, m), with left of shape (a, n)."""
        return left @ self.solve(omega, load)


@final
@dataclass(frozen=True, eq=False)
class ModalSolver(Solver):
    """Real modes; exact where psi^T C psi and psi^T D psi are diagonal.

    Parameters
    ----------
    psi : ndarray, shape (n, n)
        Columns with psi^T (K + sigma M) psi = 1.
    stiffness, loss, damping, mass : ndarray, shape (n,)
        Diagonals of psi^T A psi with A = K, D, C, M.
    free : bool
        Whether K lets the structure move as a rigid body.
    """

    psi: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    loss: NDArray[np.float64]
    damping: NDArray[np.float64]
    mass: NDArray[np.float64]
    free: bool

    def _flexibility(self, omega: NDArray) -> NDArray[np.complex128]:
        w = omega[:, None]
        elastic, inertia = self.stiffness, w**2 * self.mass
        z = elastic - inertia + 1j * (self.loss + w * self.damping)
        singular = np.abs(z) <= _SINGULAR * (np.abs(elastic) + inertia)
        if self.free:
            singular |= w == 0
        if singular.any():
            raise _singular(omega[int(np.flatnonzero(singular.any(axis=1))[0])])
        return 1.0 / z

    def solve(self, omega: NDArray, load: NDArray) -> NDArray[np.complex128]:
        """Responses, shape (n_f, n, m)."""
        return self.psi @ (self._flexibility(omega)[:, :, None] * (self.psi.T @ load))

    def transfer(self, omega: NDArray, left: NDArray, load: NDArray) -> NDArray[np.complex128]:
        """Products left Z^-1 load, shape (n_f, a, m)."""
        weights = np.einsum("an,nm->nam", left @ self.psi, self.psi.T @ load)
        out = self._flexibility(omega) @ weights.reshape(weights.shape[0], -1)
        return out.reshape(omega.size, left.shape[0], load.shape[1])


@final
@dataclass(frozen=True, eq=False)
class DenseSolver(Solver):
    """Gaussian elimination at every frequency, in blocks of frequencies."""

    matrices: Matrices
    free: bool

    def solve(self, omega: NDArray, load: NDArray) -> NDArray[np.complex128]:
        """Responses, shape (n_f, n, m)."""
        if self.free and (omega == 0).any():
            raise _singular(0.0)
        n = load.shape[0]
        both = np.column_stack([load, _probe(n)])
        out = np.empty((omega.size, n, load.shape[1]), complex)
        step = max(1, 2_000_000 // max(1, n * n))
        for start in range(0, omega.size, step):
            part = omega[start : start + step]
            z = self.matrices.dynamic_stiffness(part)
            scale = _scales(np.abs(np.diagonal(z, axis1=1, axis2=2)), np.abs(z).max(axis=2))
            scaled = scale[:, :, None] * z * scale[:, None, :]
            try:
                x = np.linalg.solve(scaled, scale[:, :, None] * both)
            except np.linalg.LinAlgError:
                raise _singular(part[int(np.argmin(np.linalg.svd(scaled, compute_uv=False)[:, -1]))]) from None
            _require_moderate(x[:, :, -1], scale * both[:, -1], part)
            out[start : start + step] = scale[:, :, None] * x[:, :, :-1]
        return out


@final
@dataclass(frozen=True, eq=False)
class SparseSolver(Solver):
    """Sparse LU at every frequency."""

    matrices: Matrices

    def solve(self, omega: NDArray, load: NDArray) -> NDArray[np.complex128]:
        """Responses, shape (n_f, n, m)."""
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu

        m = self.matrices
        stiffness, damping, mass = csc_array(m.K + 1j * m.D), csc_array(m.C + 0j), csc_array(m.M + 0j)
        both = np.column_stack([load, _probe(load.shape[0])]).astype(complex)
        out = np.empty((omega.size, *load.shape), complex)
        for i, w in enumerate(omega):
            z: Any = csc_array(stiffness + 1j * w * damping - w**2 * mass)
            try:
                x = splu(z).solve(both)
            except RuntimeError:
                raise _singular(w) from None
            diagonal = np.abs(z.diagonal())
            scale = _scales(diagonal, diagonal)
            _require_moderate((x[:, -1] / scale)[None], (scale * both[:, -1])[None], omega[i : i + 1])
            out[i] = x[:, :-1]
        return out


def solver(matrices: Matrices, omega: NDArray) -> Solver:
    """The solver that suits the matrices: modal where damping allows, else dense or sparse elimination.

    Raises
    ------
    ModelError
        If a matrix is not finite or the structure is unstable.
    """
    require_sound(matrices)
    n = matrices.M.shape[0]
    if n <= MODAL_LIMIT:
        modal = modal_solver(matrices, omega)
        if modal is not None:
            return modal
    filled = sum(np.count_nonzero(a) for a in (matrices.M, matrices.C, matrices.K, matrices.D)) / n**2
    if n >= SPARSE_FROM and filled < 0.2:
        return SparseSolver(matrices)
    return DenseSolver(matrices, moves_freely(matrices.K) if (omega == 0).any() else False)


def modal_solver(matrices: Matrices, omega: NDArray) -> ModalSolver | None:
    """Modal solver of the matrices, or None where their damping couples the real modes."""
    m = matrices
    if not all(_symmetric(a) for a in (m.M, m.C, m.K, m.D)):
        return None
    positive = omega[omega > 0]
    shift = float(positive.min() * positive.max()) if positive.size else 1.0
    try:
        _, psi = eigh(m.M, m.K + shift * m.M)
    except np.linalg.LinAlgError:
        return None
    stiffness = np.einsum("ij,ij->j", psi, m.K @ psi)
    mass = np.einsum("ij,ij->j", psi, m.M @ psi)
    damping, loss = psi.T @ m.C @ psi, psi.T @ m.D @ psi
    if _couples(stiffness, mass, damping, loss, positive):
        return None
    free = bool((omega == 0).any()) and moves_freely(m.K)
    return ModalSolver(psi, stiffness, np.diag(loss), np.diag(damping), mass, free)


def _couples(stiffness: NDArray, mass: NDArray, damping: NDArray, loss: NDArray, omega: NDArray) -> bool:
    """Whether off-diagonal damping changes a response by more than 1e-10 anywhere between the extremes of omega."""
    ends = np.array([omega.min(), omega.max()]) if omega.size else np.ones(2)
    apart = stiffness / ends[:, None] - ends[:, None] * mass
    away = np.where(np.sign(apart[0]) == np.sign(apart[1]), np.abs(apart).min(axis=0), 0.0)
    size = np.sqrt(np.hypot(away, np.abs(np.diag(damping) + np.diag(loss) / ends[1])))
    off = np.abs(damping) + np.abs(loss) / ends[0]
    np.fill_diagonal(off, 0.0)
    return bool((off > 1e-10 * np.outer(size, size)).any())


def require_sound(matrices: Matrices) -> None:
    """Return if all matrices are finite and the structure is stable; ModelError otherwise."""
    for name in ("M", "C", "K", "D"):
        if not np.isfinite(getattr(matrices, name)).all():
            raise ModelError(f"matrix {name} of the model is not finite: check the parameter values")
    named = (("M", matrices.M), ("K", matrices.K), ("C", matrices.C), ("D", matrices.D))
    suspects = [name for name, a in named if not _semidefinite(a)]
    if "M" in suspects:
        raise ModelError("the mass matrix is not positive: check masses and parameter values for a negative one")
    if "K" in suspects:
        raise ModelError(
            "the model is unstable: its stiffness matrix has a negative eigenvalue; check the signs of stiffnesses"
            " and parameter values"
        )
    if suspects:
        _require_decay(pencil_poles(matrices.M, matrices.C, _complex_stiffness(matrices)), " and ".join(suspects))


def _complex_stiffness(m: Matrices) -> NDArray:
    return m.K + 1j * m.D if m.D.any() else m.K


def _require_decay(found: NDArray, suspects: str) -> None:
    size = np.abs(found)
    growing = (np.real(found) > 1e-8 * size) & (size > 1e-7 * size.max(initial=0.0))
    if growing.any():
        raise ModelError(
            f"the model is unstable: a pole lies at +{np.real(found[growing]).max():.3g} 1/s because {suspects} is not"
            " positive; check the signs of damping and parameter values"
        )


def _semidefinite(a: NDArray) -> bool:
    if not a.any():
        return True
    a = (a + a.T) / 2
    diagonal = np.diag(a)
    if (diagonal < 0).any():
        return False
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    scaled = scale[:, None] * a * scale
    if a[scale == 0].any():
        return False
    try:
        np.linalg.cholesky(scaled + 1e-9 * np.eye(a.shape[0]))
    except np.linalg.LinAlgError:
        return False
    return True


def _symmetric(a: NDArray) -> bool:
    return bool(np.abs(a - a.T).max(initial=0.0) <= 1e-12 * np.abs(a).max(initial=0.0))


def _probe(n: int) -> NDArray[np.float64]:
    return 1.0 + 0.5 * np.cos(1.7 * np.arange(n) ** 1.3)


def _scales(diagonal: NDArray, fallback: NDArray) -> NDArray[np.float64]:
    size = np.where(diagonal > 1e-8 * fallback, diagonal, fallback)
    return 1 / np.sqrt(np.where(size > 0, size, 1.0))


def _require_moderate(x: NDArray, b: NDArray, omega: NDArray) -> None:
    gain = np.linalg.norm(x, axis=1) / np.linalg.norm(b, axis=1)
    bad = ~(gain < 1e14)
    if bad.any():
        raise _singular(omega[int(np.flatnonzero(bad)[0])])


def _singular(omega: float) -> ModelError:
    if omega == 0:
        return ModelError("the structure moves freely at 0 Hz: leave out the line at 0 Hz, or support the structure")
    return ModelError(
        f"the dynamic stiffness is singular at {omega / (2 * np.pi):.6g} Hz: an undamped mode lies on this line;"
        " add damping or leave the line out"
    )
