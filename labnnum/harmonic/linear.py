"""What the linear structure gives to a harmonic balance: its dynamic flexibility at every harmonic of the drive."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.eigen import moves_freely, natural_modes
from labnnum.errors import ModelError
from labnnum.solvers import ModalSolver, modal_solver, require_sound
from labnnum.structures.base import Matrices

SOFT = 1e-3
"""A structure that nothing holds has no mean position of its own: for the mean alone it hangs on springs that make its
rigid motions this fraction of its lowest elastic frequency."""
SINGULAR = 1e-13
"""Dynamic stiffness of a mode, of its elastic and inertial parts, below which it counts as none."""


@final
class Flexibility:
    """T_n = rows Z(n omega)^-1 loads, n = 0 to `harmonics`, and its derivative to omega.

    Parameters
    ----------
    matrices : Matrices
    rows : ndarray, shape (r, n)
        Motions that are asked for.
    loads : ndarray, shape (n, c)
        Where forces act.
    harmonics : int
    """

    def __init__(self, matrices: Matrices, rows: NDArray, loads: NDArray, harmonics: int) -> None:
        require_sound(matrices)
        self.matrices, self.rows, self.loads, self.harmonics = matrices, rows, loads, harmonics
        self.static = self._static()
        self._modal: ModalSolver | None = None
        self._range = (np.inf, 0.0)

    def _static(self) -> NDArray[np.float64]:
        m = self.matrices
        stiffness = np.array(m.K, float)
        if moves_freely(stiffness):
            squares, _ = natural_modes(np.asarray(m.M, float), stiffness)
            elastic = squares[squares > 0]
            stiffness = stiffness + SOFT**2 * (elastic.min() if elastic.size else 1.0) * m.M
        try:
            return self.rows @ np.linalg.solve(stiffness, self.loads)
        except np.linalg.LinAlgError:
            raise ModelError("a coordinate of the structure has neither mass nor stiffness") from None

    def _covers(self, omega: float) -> None:
        """See to it that the modes, if there are any, are known to be uncoupled at all harmonics of omega."""
        low, high = self._range
        if low <= omega and omega * self.harmonics <= high:
            return
        self._range = (min(low, 0.5 * omega), max(high, 2.0 * omega * self.harmonics))
        self._modal = modal_solver(self.matrices, np.array(self._range))

    def at(self, omega: float, first: int = 1, last: int = 0) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """T_n and dT_n / d omega at omega in rad/s, each (n, r, c); n from `first` to `last` or to `harmonics`.

        Raises
        ------
        ModelError
            If an undamped mode lies on one of these harmonics.
        """
        self._covers(omega)
        n = np.arange(first, (last or self.harmonics) + 1)
        w = n * omega
        modal = self._modal
        if modal is not None:
            elastic, inertia = modal.stiffness, w[:, None] ** 2 * modal.mass
            z = elastic - inertia + 1j * (modal.loss + w[:, None] * modal.damping)
            self._require_regular(np.abs(z) <= SINGULAR * (np.abs(elastic) + inertia), w)
            slope = n[:, None] * (1j * modal.damping - 2 * w[:, None] * modal.mass)
            left, right = self.rows @ modal.psi, modal.psi.T @ self.loads
            return (left / z[:, None, :]) @ right, -(left * (slope / z**2)[:, None, :]) @ right
        m = self.matrices
        z = m.dynamic_stiffness(w)
        slope = n[:, None, None] * (1j * m.C - 2 * w[:, None, None] * m.M)
        try:
            moved = np.linalg.solve(z, self.loads.astype(complex))
            back = np.linalg.solve(z.transpose(0, 2, 1), self.rows.T.astype(complex)).transpose(0, 2, 1)
        except np.linalg.LinAlgError:
            raise ModelError(f"the dynamic stiffness is singular at a harmonic of {omega / (2 * np.pi):g} Hz") from None
        return self.rows @ moved, -back @ slope @ moved

    @staticmethod
    def _require_regular(singular: NDArray[np.bool_], w: NDArray) -> None:
        if singular.any():
            here = w[int(np.flatnonzero(singular.any(axis=1))[0])] / (2 * np.pi)
            raise ModelError(f"an undamped mode lies at {here:.6g} Hz, a harmonic of the drive: add damping")


def real_blocks(transfer: NDArray[np.complex128], static: NDArray[np.float64]) -> NDArray[np.float64]:
    """T_0 (r, c) and T_n (h, r, c) as one real matrix, shape (r, 2 h + 1, c, 2 h + 1), on mean, cosines and sines.

    The coefficients of cos and sin of a harmonic, a and b, stand for the complex amplitude a - i b.
    """
    h, r, c = transfer.shape
    out = np.zeros((r, 2 * h + 1, c, 2 * h + 1))
    out[:, 0, :, 0] = static
    for n, t in enumerate(transfer):
        i = 2 * n + 1
        out[:, i, :, i] = out[:, i + 1, :, i + 1] = t.real
        out[:, i, :, i + 1] = t.imag
        out[:, i + 1, :, i] = -t.imag
    return out


def packed(amplitude: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Complex amplitudes (..., h + 1), the mean first, as mean, cosines and sines (..., 2 h + 1)."""
    h = amplitude.shape[-1] - 1
    out = np.empty((*amplitude.shape[:-1], 2 * h + 1))
    out[..., 0] = amplitude[..., 0].real
    out[..., 1::2], out[..., 2::2] = amplitude[..., 1:].real, -amplitude[..., 1:].imag
    return out


def unpacked(real: NDArray[np.float64]) -> NDArray[np.complex128]:
    """The inverse of `packed`."""
    return np.concatenate([real[..., :1].astype(complex), real[..., 1::2] - 1j * real[..., 2::2]], axis=-1)
