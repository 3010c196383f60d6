"""Periodic responses one by one, and along a curve: amplitudes, energies, folds, and what a slow sweep finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError

MARGIN = 1e-6
"""By how much a Floquet multiplier may exceed one: what is neither stable nor unstable, such as a slider that never
slips, has multipliers of one."""


@final
@dataclass(frozen=True, eq=False)
class Orbit:
    """One periodic response; complex amplitudes X_n of Re(X_n exp(i n omega t)), n = 0 (the mean) to h.

    Attributes
    ----------
    frequency : float
        Of the drive, Hz.
    harmonics : ndarray, shape (n_out, h + 1)
        Motions of the outputs, m or rad.
    motion, force : ndarray, shape (n_laws, h + 1)
        Motions of the laws, m or rad, and the forces that oppose them, N or N m.
    multiplier : float
        Largest modulus of the Floquet multipliers.
    missed : float
        Motion that the forces' next h harmonics would make at the laws, relative.
    work : float
        Energy that the drive puts in, J in a period; of a base, as seen from it.
    unknowns : ndarray, shape (n_laws, 2 h + 1)
        Mean, cosines and sines of the forces, to begin from.
    """

    frequency: float
    harmonics: NDArray[np.complex128]
    motion: NDArray[np.complex128]
    force: NDArray[np.complex128]
    multiplier: float
    missed: float
    work: float
    unknowns: NDArray[np.float64]

    @property
    def stable(self) -> bool:
        """Whether small disturbances do not grow."""
        return self.multiplier < 1 + MARGIN

    @property
    def lost(self) -> NDArray[np.float64]:
        """Energy that each law takes in a period, J, (n_laws,)."""
        n = np.arange(self.force.shape[1])
        return -np.pi * np.imag(np.conj(self.force) * self.motion) @ n


@final
@dataclass(frozen=True, eq=False)
class Curve:
    """Responses along a curve, in the order in which it was followed; frequencies in Hz.

    Attributes
    ----------
    orbits : tuple of Orbit
    outputs, laws : tuple of str
        Their names.
    """

    orbits: tuple[Orbit, ...]
    outputs: tuple[str, ...]
    laws: tuple[str, ...]

    @cached_property
    def frequency(self) -> NDArray[np.float64]:
        """Of each point, Hz, (p,)."""
        return np.array([o.frequency for o in self.orbits])

    @cached_property
    def harmonics(self) -> NDArray[np.complex128]:
        """Complex amplitudes of the outputs, (p, n_out, h + 1), m or rad."""
        return np.array([o.harmonics for o in self.orbits])

    @cached_property
    def multiplier(self) -> NDArray[np.float64]:
        """Largest modulus of the Floquet multipliers, (p,)."""
        return np.array([o.multiplier for o in self.orbits])

    @cached_property
    def stable(self) -> NDArray[np.bool_]:
        """Whether small disturbances do not grow, (p,)."""
        return np.array([o.stable for o in self.orbits])

    @cached_property
    def missed(self) -> NDArray[np.float64]:
        """Motion that the next h harmonics of the laws' forces would make, relative, (p,)."""
        return np.array([o.missed for o in self.orbits])

    @cached_property
    def work(self) -> NDArray[np.float64]:
        """Energy that the drive puts in, J in a period, (p,)."""
        return np.array([o.work for o in self.orbits])

    @cached_property
    def lost(self) -> NDArray[np.float64]:
        """Energy that each law takes, J in a period, (p, n_laws)."""
        return np.array([o.lost for o in self.orbits])

    def amplitude(self, output: int = 0, harmonic: int = 1) -> NDArray[np.float64]:
        """Amplitude of one harmonic of one output, (p,), m or rad."""
        return np.abs(self.harmonics[:, output, harmonic])

    @cached_property
    def folds(self) -> tuple[int, ...]:
        """Points at which the curve turns back in frequency."""
        sign = np.sign(np.diff(self.frequency))
        return tuple(int(i) + 1 for i in np.flatnonzero(sign[1:] * sign[:-1] < 0))

    def swept(
        self,
        frequency: Sequence[float] | ArrayLike,
        direction: Literal["forward", "backward"],
        output: int = 0,
        harmonic: int = 1,
    ) -> NDArray[np.float64]:
        """Amplitudes of one harmonic of one output that a slow sweep over `frequency` finds, (n,); see `sweep`."""
        return np.abs(self.sweep(frequency, direction)[:, output, harmonic])

    def sweep(
        self, frequency: Sequence[float] | ArrayLike, direction: Literal["forward", "backward"]
    ) -> NDArray[np.complex128]:
        """Complex amplitudes that a slow sweep over `frequency` in Hz finds, (n, n_out, h + 1); NaN where no periodic
        response is stable.

        It stays on its branch until that ends or is no longer stable, and then jumps to the stable one whose motion is
        nearest.

        Raises
        ------
        EstimationError
            If the curve does not reach a frequency, or the direction is neither "forward" nor "backward".
        """
        if direction not in ("forward", "backward"):
            raise EstimationError(f"a sweep goes forward or backward, not {direction!r}")
        asked = np.asarray(frequency, float)
        out = np.full((asked.size, *self.harmonics.shape[1:]), complex(np.nan, np.nan))
        at: float | None = None
        for i in np.argsort(asked if direction == "forward" else -asked):
            at = self._next(float(asked[i]), at, direction)
            if at is not None:
                out[i] = self._between(at)
        return out

    def _next(self, frequency: float, at: float | None, direction: str) -> float | None:
        """Place along the curve of the response that is stable at `frequency`, coming from the place `at`."""
        found = self._places(frequency)
        if not found:
            raise EstimationError(f"the curve of responses does not reach {frequency:g} Hz")
        good = [p for p in found if self._steady(p)]
        if not good:
            return None
        if at is None:
            return good[0] if direction == "forward" else good[-1]
        joined = [p for p in good if self.stable[int(np.ceil(min(at, p))) : int(max(at, p)) + 1].all()]
        if joined:
            return min(joined, key=lambda p: abs(p - at))
        here = self._between(at)
        return min(good, key=lambda p: float(np.linalg.norm(self._between(p) - here)))

    def _places(self, frequency: float) -> list[float]:
        """Where along the curve, in points from the first, it has a frequency."""
        f = self.frequency
        if f.size == 1:
            return [0.0] if f[0] == frequency else []
        away = f - frequency
        cross = np.flatnonzero((away[:-1] * away[1:] < 0) | (away[:-1] == 0))
        places = [i + float(away[i] / (away[i] - away[i + 1])) if away[i] else float(i) for i in cross]
        return [*places, *([float(f.size - 1)] if away[-1] == 0 else [])]

    def _steady(self, place: float) -> bool:
        return bool(self.stable[int(place)] and self.stable[int(np.ceil(place))])

    def _between(self, place: float) -> NDArray[np.complex128]:
        """Amplitudes of the outputs between two points."""
        i = min(int(place), max(len(self.orbits) - 2, 0))
        if len(self.orbits) == 1:
            return self.harmonics[0]
        return self.harmonics[i] + (place - i) * (self.harmonics[i + 1] - self.harmonics[i])
