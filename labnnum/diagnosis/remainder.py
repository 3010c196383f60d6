"""What the modes above the basis give way by, at other parameters than the nominal ones.

They enter by their flexibility, what damping takes of it and its slope to frequency. Where sensors and drive move along
members, as on a column that is shaken from above, that flexibility is all there is to see, and it goes with the
parameters as the stiffness does.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.affine import Affine
from labnnum.structures.base import Structure

MOST = 300
"""Modes above the basis, the lowest first, whose flexibility follows the parameters."""


@dataclass(frozen=True, eq=False)
class Soft:
    """Flexibility (h, h) of the modes above the basis, in units of what each has at the nominal parameters, and its
    derivatives (n_par, h, h).
    """

    value: NDArray[np.float64]
    slopes: NDArray[np.float64]

    def between(self, left: NDArray, right: NDArray) -> NDArray[np.float64]:
        """Displacements (l, r) that shares left (l, h), right (r, h) of these modes contribute at rest."""
        n = len(self.value)
        return left[:, :n] @ self.value @ right[:, :n].T + left[:, n:] @ right[:, n:].T

    def changes(self, left: NDArray, right: NDArray) -> NDArray[np.float64]:
        """Derivatives of the same to the parameters, (n_par, l, r)."""
        n = len(self.value)
        return left[:, :n] @ self.slopes @ right[:, :n].T


class Remainder:
    """The flexibility of the modes above the basis, by parameters.

    To first order in the change of the stiffness seen by these modes among themselves, inverted: exact where all
    stiffness is scaled alike. What a change couples of them to the modes of the basis is left out.

    Parameters
    ----------
    structure : Structure
    high : ndarray, shape (n, h)
        Shapes over frequencies of these modes at the nominal parameters.
    affine : Affine or None
        The structure's matrices where they are affine.
    """

    def __init__(self, structure: Structure, high: NDArray, affine: Affine | None) -> None:
        self.structure, self.high, self._affine = structure, high[:, :MOST], affine
        self._made: dict[bytes, Soft] = {}

    def at(self, theta: NDArray) -> Soft:
        """The flexibility at `theta`; the last few are remembered."""
        key = np.asarray(theta, float).tobytes()
        if key not in self._made:
            if len(self._made) > 24:
                self._made.pop(next(iter(self._made)))
            self._made[key] = self._at(np.asarray(theta, float))
        return self._made[key]

    def _at(self, theta: NDArray) -> Soft:
        off = theta - self.structure.nominal
        if self._affine is not None:
            slopes = self._slopes
            grown = np.tensordot(off, slopes, axes=1)
        else:
            slopes = self._onto([np.real(d.K) for d in self.structure.derivatives(theta)])
            now = np.real(self.structure.matrices(theta).K)
            grown = self._onto([now - self._nominal])[0]
        value = np.asarray(np.linalg.inv(np.eye(len(grown)) + grown), np.float64)
        return Soft(value, -value @ slopes @ value)

    @cached_property
    def _slopes(self) -> NDArray[np.float64]:
        assert self._affine is not None
        return self._onto([dk for _, dk in self._affine.slopes])

    @cached_property
    def _nominal(self) -> NDArray[np.float64]:
        return np.real(self.structure.matrices(self.structure.nominal).K)

    def _onto(self, stiffness: list[NDArray]) -> NDArray[np.float64]:
        h = self.high.shape[1]
        return np.array([self.high.T @ k @ self.high for k in stiffness]).reshape(len(stiffness), h, h)
