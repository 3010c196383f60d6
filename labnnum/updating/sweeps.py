"""Duffing's oscillator for the updating room: swept responses of many parameter sets, forward and backward.

What `FrfBatch` is for linear structures, the two classes here are for a weakly nonlinear one. Its response depends on
direction and level, so both stand where a linear structure has its outputs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ModelError
from labnnum.parameters import Parameter
from labnnum.structures.duffing import Duffing, Sweep

BOTH: tuple[Sweep, ...] = ("forward", "backward")


@final
@dataclass(frozen=True, eq=False)
class SweepBatch:
    """First harmonics of swept responses by harmonic balance, over the force, as a swept-sine test measures them.

    Parameters
    ----------
    oscillator : Duffing
    frequency : ndarray, shape (n_f,)
        Lines in Hz, ascending.
    sweeps : tuple of {"forward", "backward"}
    levels : tuple of float
        Force amplitudes F; the oscillator's own where empty.
    count : int
        Odd harmonics that are balanced.
    """

    oscillator: Duffing
    frequency: NDArray[np.float64]
    sweeps: tuple[Sweep, ...] = BOTH
    levels: tuple[float, ...] = ()
    count: int = 2

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Damping mu and cubic stiffness alpha."""
        return self.oscillator.parameters

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of one measurement: (sweeps times levels, 1, n_f)."""
        return len(self.sweeps) * max(1, len(self.levels)), 1, self.frequency.size

    def frf(self, theta: ArrayLike) -> NDArray[np.complex128]:
        """First harmonic over force, shape (n, n_out, 1, n_f); NaN for a set without a periodic solution."""
        return self.sensitivity(theta)[0]

    def sensitivity(self, theta: ArrayLike) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The same and its exact derivatives along the branches, shape (n, 2, n_out, 1, n_f)."""
        sets = np.atleast_2d(np.asarray(theta, float))
        try:
            return self._together(sets)
        except ModelError:  # some set has no solution: halve until it stands alone
            if len(sets) == 1:
                return np.full((1, *self.shape), np.nan + 0j), np.full((1, 2, *self.shape), np.nan + 0j)
        parts = [self.sensitivity(part) for part in np.array_split(sets, 2)]
        return np.concatenate([v for v, _ in parts]), np.concatenate([d for _, d in parts])

    def _together(self, sets: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        omega = 2 * np.pi * self.frequency
        rows = [d.sensitivity(sets, omega, s, self.count) for d, s in self._runs()]
        value = np.stack([v for v, _ in rows], axis=1)[:, :, None]
        slope = np.stack([np.moveaxis(d, 0, 1) for _, d in rows], axis=2)[:, :, :, None]
        return value, slope

    def _runs(self) -> list[tuple[Duffing, Sweep]]:
        levels = self.levels or (self.oscillator.force,)
        return [(replace(self.oscillator, force=f), s) for f in levels for s in self.sweeps]


@final
@dataclass(frozen=True, eq=False)
class ScalesBatch:
    """Components of the response by multiple scales, with which the dissertation trains its network.

    Parameters
    ----------
    oscillator : Duffing
    frequency : ndarray, shape (n_f,)
        Hz; the detuning is sigma = (2 pi f - omega0) / eps.

    References
    ----------
    Atalla (1996), equations 5.8 and 5.9.
    """

    oscillator: Duffing
    frequency: NDArray[np.float64]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Damping mu and cubic stiffness alpha."""
        return self.oscillator.parameters

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of one measurement: (forward and backward, 1, n_f)."""
        return 2, 1, self.frequency.size

    @property
    def detuning(self) -> NDArray[np.float64]:
        """Sigma of each line."""
        return (2 * np.pi * self.frequency - self.oscillator.omega0) / self.oscillator.epsilon

    def frf(self, theta: ArrayLike) -> NDArray[np.complex128]:
        """Components of equation 5.9, shape (n, 2, 1, n_f)."""
        sets = np.atleast_2d(np.asarray(theta, float))
        return np.stack([self.oscillator.components(sets, self.detuning, s) for s in BOTH], axis=1)[:, :, None]

    def sensitivity(self, theta: ArrayLike) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The same and its exact derivatives along the branches, shape (n, 2, 2, 1, n_f)."""
        sets = np.atleast_2d(np.asarray(theta, float))
        value, slope = [], []
        for sweep in BOTH:
            a = self.oscillator.amplitude(sets, self.detuning, sweep)
            v, d = self._along(sets, a)
            value.append(v)
            slope.append(d)
        return np.stack(value, axis=1)[:, :, None], np.stack(slope, axis=2)[:, :, :, None]

    def _along(self, theta: NDArray, a: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Components and their slopes, from the implicit derivative of equation 5.8 to y = a^2."""
        mu, alpha = theta[:, :1], theta[:, 1:]
        curve = 3 / (8 * self.oscillator.omega0)
        bend, y = curve * alpha, a**2
        shift = bend * y - self.detuning
        by_y = mu**2 + shift**2 + 2 * bend * y * shift
        dy = np.stack([-2 * mu * y / by_y, -2 * shift * curve * y * y / by_y], axis=1)
        da = dy / (2 * a[:, None])
        value = a * (shift + 1j * mu)
        slope = da * (shift + 1j * mu)[:, None] + a[:, None] * (bend[:, None] * dy)
        slope[:, 0] += 1j * a
        slope[:, 1] += a * curve * y
        return value, slope
