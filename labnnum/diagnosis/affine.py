"""Structures whose matrices are affine in their parameters: what a state needs of them, computed once."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labnnum.structures.base import Structure

SAME = 1e-12
"""Relative difference that rounding leaves."""


class Affine:
    """M, K = M_0 + sum_j d_j M_j, K_0 + sum_j d_j K_j with d = theta - theta_0, also in the coordinates of `basis`.

    Parameters
    ----------
    theta : ndarray, shape (n_theta,)
        theta_0.
    mass, stiffness : ndarray, shape (n, n)
        There.
    slopes : sequence of (dM, dK)
        One a parameter.
    basis : ndarray, shape (n, m)
    """

    def __init__(
        self, theta: NDArray, mass: NDArray, stiffness: NDArray, slopes: Sequence[tuple[NDArray, NDArray]],
        basis: NDArray,
    ) -> None:  # fmt: skip
        self.theta, self.slopes, self.basis = theta, list(slopes), basis
        self._first = (mass, stiffness)

    def at(self, theta: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """M and K at `theta`, (n, n) each."""
        return _sum(self._first, self.slopes, theta - self.theta)

    def reduced(self, theta: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """M and K at `theta` in the coordinates of the basis, (m, m) each."""
        off = theta - self.theta
        (mass, stiffness), (dm, dk) = self._small, self.small_slopes
        n, size = len(off), mass.size
        return (
            mass + (off @ dm.reshape(n, size)).reshape(mass.shape),
            stiffness + (off @ dk.reshape(n, size)).reshape(mass.shape),
        )

    @cached_property
    def _small(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self._onto(*self._first)

    @cached_property
    def small_slopes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The slopes of M and of K in the coordinates of the basis, (n_theta, m, m) each."""
        m = self.basis.shape[1]
        pairs = [self._onto(*pair) for pair in self.slopes]
        return np.array([a for a, _ in pairs]).reshape(-1, m, m), np.array([b for _, b in pairs]).reshape(-1, m, m)

    def _onto(self, mass: NDArray, stiffness: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        v = self.basis
        return v.T @ mass @ v, v.T @ stiffness @ v


def _sum(
    first: tuple[NDArray, NDArray], slopes: Sequence[tuple[NDArray, NDArray]], off: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    mass, stiffness = (a.copy() for a in first)
    for d, (dm, dk) in zip(off, slopes, strict=True):
        mass += d * dm
        stiffness += d * dk
    return mass, stiffness


def affine(structure: Structure, dofs: Sequence[str], basis: NDArray, on_base: bool) -> Affine | None:
    """`structure` as an affine one, or None where it is none, or the motions at `dofs` or of the base change with it.

    Told from three points about the nominal parameters, one to three spreads away.
    """
    nominal = structure.nominal
    m = structure.matrices(nominal)
    slopes = [(np.real(d.M), np.real(d.K)) for d in structure.derivatives(nominal)]
    made = Affine(nominal, np.real(m.M), np.real(m.K), slopes, basis)
    own = structure.parameters
    spread, low, high = (np.array([getattr(p, k) for p in own]) for k in ("spread", "lower", "upper"))
    signs = np.where(np.arange(len(own)) % 2, -1.0, 1.0)

    def motions(theta: NDArray) -> NDArray:
        rows = [structure.participation(d, theta) for d in dofs]
        return np.array([*rows, structure.rigid(theta)] if on_base else rows)

    for step in (2.0 * signs, -3.0 * signs, 1.0 + 0.0 * signs):
        theta = np.clip(nominal + step * spread, low, high)
        there = structure.matrices(theta)
        for straight, real in zip(made.at(theta), (there.M, there.K), strict=True):
            if np.abs(straight - real).max() > SAME * np.abs(straight).max():
                return None
        if not np.array_equal(motions(theta), motions(nominal)):
            return None
    return made
