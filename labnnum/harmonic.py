r"""Harmonic balance of one degree of freedom with any law of `labnnum.diagnosis.nonlinear.force`, with continuation.

.. math:: m \ddot u + c \dot u + k u + f(u, \dot u) = F \cos \Omega t

The motion is a sum of harmonics; the force of the law is taken in time and brought back (alternating frequency and
time, Cameron and Griffin 1989). The curve of responses is followed by its arc length (Keller 1977) around its folds, so
that both stable branches and the unstable one between them are found; stability follows from the Floquet multipliers
of the motion.

References
----------
T. M. Cameron, J. H. Griffin, "An alternating frequency/time domain method", J. Applied Mechanics 56, 1989.
H. B. Keller, "Numerical solution of bifurcation and nonlinear eigenvalue problems", 1977.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.force import CODES, LAWS, law
from labnnum.diagnosis.nonlinear.prescribed import along
from labnnum.errors import EstimationError, ModelError

SAMPLES = 256
"""Samples of a period in which a law's force is taken."""


@dataclass(frozen=True)
class Oscillator:
    """m u'' + c u' + k u + f = F cos(Omega t), f a law with its parameters in the order of its names, SI units."""

    mass: float
    damping: float
    stiffness: float
    force: float
    law: str
    parameters: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.law not in LAWS or self.law == "general":
            raise ModelError(
                f"harmonic balance knows no law {self.law!r}: {', '.join(n for n in LAWS if n != 'general')}"
            )
        if len(self.parameters) != len(LAWS[self.law]):
            raise ModelError(f"law {self.law!r} has the parameters {', '.join(LAWS[self.law])}")


@dataclass(frozen=True, eq=False)
class Branch:
    """Points along the curve of responses: `omega` (n,) rad/s, harmonics (n, 2 h + 1), `stable` (n,), amplitudes."""

    omega: NDArray[np.float64]
    harmonics: NDArray[np.float64]
    stable: NDArray[np.bool_]

    @property
    def amplitude(self) -> NDArray[np.float64]:
        """Amplitude of the first harmonic, (n,)."""
        return np.hypot(self.harmonics[:, 1], self.harmonics[:, 2])

    def swept(self, omega: Sequence[float] | NDArray, direction: Literal["forward", "backward"]) -> NDArray[np.float64]:
        """Amplitude that a slow sweep finds at `omega` (n,): it stays on its branch until that ends, then jumps."""
        asked = np.asarray(omega, float)
        order = np.argsort(asked) if direction == "forward" else np.argsort(-asked)
        out = np.empty(asked.size)
        last = np.nan
        for i in order:
            found = self._at(float(asked[i]))
            if not found:
                raise EstimationError(f"the curve of responses does not reach {asked[i]:g} rad/s")
            out[i] = found[0] if np.isnan(last) else min(found, key=lambda a, at=last: abs(a - at))
            last = float(out[i])
        return out

    def _at(self, omega: float) -> list[float]:
        """Stable amplitudes at one frequency (all of them where none is stable)."""
        w, a, s = self.omega, self.amplitude, self.stable
        cross = np.flatnonzero((w[:-1] - omega) * (w[1:] - omega) <= 0)
        rows = []
        for i in cross:
            span = w[i + 1] - w[i]
            t = (omega - w[i]) / span if span else 0.0
            rows.append((a[i] + t * (a[i + 1] - a[i]), bool(s[i] and s[i + 1])))
        kept = [x for x, good in rows if good]
        return kept or [x for x, _ in rows]


class HarmonicBalance:
    """Harmonic balance of an oscillator with `harmonics` harmonics and the mean.

    Examples
    --------
    >>> linear = Oscillator(1.0, 0.1, 1.0, 1.0, "cubic", (0.0,))
    >>> curve = HarmonicBalance(linear, 3).curve(0.5, 1.5)
    >>> bool(abs(curve.amplitude.max() - 1 / (0.1 * (1 - 0.1**2 / 4) ** 0.5)) < 0.01)
    True
    """

    def __init__(self, oscillator: Oscillator, harmonics: int = 7) -> None:
        self.o, self.h = oscillator, harmonics
        turn = 2 * np.pi * np.arange(SAMPLES) / SAMPLES
        n = np.arange(1, harmonics + 1)
        cosine, sine = np.cos(np.outer(turn, n)), np.sin(np.outer(turn, n))
        self.shape = np.concatenate(
            [np.ones((SAMPLES, 1)), np.stack([cosine, sine], axis=2).reshape(SAMPLES, -1)], axis=1
        )
        self.rate = np.concatenate(
            [np.zeros((SAMPLES, 1)), np.stack([-sine * n, cosine * n], axis=2).reshape(SAMPLES, -1)], axis=1
        )
        self.back = self.shape.T * (2 / SAMPLES)
        self.back[0] *= 0.5
        self.p = np.zeros(10)
        self.p[: len(oscillator.parameters)] = oscillator.parameters

    def residual(self, x: NDArray, omega: float) -> NDArray[np.float64]:
        """What the equation leaves of each harmonic, (2 h + 1,)."""
        u = self.shape @ x
        v = omega * (self.rate @ x)
        turns = 2 if self.o.law in ("stick-slip", "sliders", "hysteresis") else 1
        f = along(CODES[self.o.law], u, v, self.p, turns)
        out = self.back @ f
        out[0] += self.o.stiffness * x[0]
        for n in range(1, self.h + 1):
            c, s = x[2 * n - 1], x[2 * n]
            own = self.o.stiffness - self.o.mass * (n * omega) ** 2
            loss = self.o.damping * n * omega
            out[2 * n - 1] += own * c + loss * s
            out[2 * n] += own * s - loss * c
        out[1] -= self.o.force
        return out

    def jacobian(self, x: NDArray, omega: float) -> NDArray[np.float64]:
        """Derivative of the residual to the harmonics and to omega, (2 h + 1, 2 h + 2), by central differences."""
        y = np.append(x, omega)
        size = max(float(np.abs(x).max()), 1e-9)
        out = np.empty((x.size, y.size))
        for j in range(y.size):
            step = 1e-6 * (size if j < x.size else omega)
            up, down = y.copy(), y.copy()
            up[j] += step
            down[j] -= step
            out[:, j] = (self.residual(up[:-1], up[-1]) - self.residual(down[:-1], down[-1])) / (2 * step)
        return out

    def solve(self, omega: float, x: NDArray | None = None) -> NDArray[np.float64]:
        """Harmonics (2 h + 1,) at one frequency, by Newton's method from `x` or from the linear response."""
        if x is None:
            x = np.zeros(2 * self.h + 1)
            z = self.o.stiffness - self.o.mass * omega**2 + 1j * self.o.damping * omega
            x[1], x[2] = np.real(self.o.force / z), -np.imag(self.o.force / z)
        for _ in range(60):
            r = self.residual(x, omega)
            if np.linalg.norm(r) < 1e-10 * max(self.o.force, 1e-300):
                return x
            x = x - np.linalg.solve(self.jacobian(x, omega)[:, :-1], r)
        raise EstimationError(f"harmonic balance does not converge at {omega:g} rad/s")

    def curve(self, low: float, high: float, step: float = 0.02, most: int = 4000) -> Branch:
        """The curve of responses from `low` to `high` rad/s, followed by its arc length around folds.

        Parameters
        ----------
        step : float
            Length of a step, relative to the range of frequencies and to the largest amplitude so far.
        """
        x = self.solve(low)
        scale_w, scale_x = high - low, float(np.abs(x).max())
        points, rates = [np.append(x, low)], [self._stable(x, low)]
        before = np.append(np.zeros(x.size), 1.0)
        length = step
        while points[-1][-1] < high and len(points) < most:
            scale_x = max(scale_x, float(np.abs(points[-1][:-1]).max()))
            scale = np.append(np.full(x.size, scale_x), scale_w)
            tangent = self._tangent(points[-1], scale, before)
            found = self._corrected(points[-1] + length * tangent * scale, tangent, scale)
            if found is None:
                length /= 2
                if length < 1e-6:
                    raise EstimationError(f"the curve of responses cannot be followed beyond {points[-1][-1]:g} rad/s")
                continue
            points.append(found)
            rates.append(self._stable(found[:-1], found[-1]))
            before, length = tangent, min(length * 1.3, step)
        every = np.array(points)
        return Branch(every[:, -1], every[:, :-1], np.array(rates))

    def _tangent(self, y: NDArray, scale: NDArray, before: NDArray) -> NDArray[np.float64]:
        _, _, v = np.linalg.svd(self.jacobian(y[:-1], y[-1]) * scale)
        return v[-1] * (1.0 if v[-1] @ before > 0 else -1.0)

    def _corrected(self, y: NDArray, tangent: NDArray, scale: NDArray) -> NDArray[np.float64] | None:
        start = y.copy()
        for _ in range(12):
            r = self.residual(y[:-1], y[-1])
            off = float(tangent @ ((y - start) / scale))
            if np.linalg.norm(r) < 1e-9 * self.o.force and abs(off) < 1e-9:
                return y
            j = np.vstack([self.jacobian(y[:-1], y[-1]) * scale, tangent])
            y = y - np.linalg.solve(j, np.append(r, off)) * scale
            if not np.isfinite(y).all() or y[-1] <= 0:
                return None
        return None

    def _stable(self, x: NDArray, omega: float) -> bool:
        """Whether every Floquet multiplier lies inside the unit circle, from the tangent motion over a period.

        Laws with memory or dry friction have no tangent of this kind; they are called stable.
        """
        if self.o.law in ("coulomb", "stick-slip", "sliders", "hysteresis"):
            return True
        u, v = self.shape @ x, omega * (self.rate @ x)
        step = 2 * np.pi / omega / u.size
        spare, memory, d = np.empty(10), np.zeros(2), np.empty(5)
        slopes = [law(CODES[self.o.law], a, b, self.p, memory, spare, d)[1:] for a, b in zip(u, v, strict=True)]
        slopes.append(slopes[0])
        mean = np.array([[(a + b) / 2 for a, b in zip(*pair, strict=True)] for pair in itertools.pairwise(slopes)])
        k, c = (self.o.stiffness + mean[:, 0]) / self.o.mass, (self.o.damping + mean[:, 1]) / self.o.mass
        phi = np.eye(2)
        for part in _exponentials(k, c, step):
            phi = part @ phi
        return bool(np.abs(np.linalg.eigvals(phi)).max() < 1 + 1e-9)


def _exponentials(k: NDArray, c: NDArray, step: float) -> NDArray[np.float64]:
    """exp(A step), shape (n, 2, 2), of A = [[0, 1], [-k, -c]] for each k, c (n,).

    Exact where nothing changes within a step, so that no error of phase is taken for damping.
    """
    half = -c * step / 2
    root = np.sqrt((half**2 - k * step**2).astype(complex))
    small = np.abs(root) < 1e-8
    ratio = np.real(np.where(small, 1.0, np.sinh(root) / np.where(small, 1.0, root)))
    off = step * np.array([[np.zeros_like(k), np.ones_like(k)], [-k, -c]])
    off[0, 0] -= half
    off[1, 1] -= half
    whole = np.real(np.cosh(root)) * np.eye(2)[:, :, None] + ratio * off
    return np.moveaxis(np.exp(half) * whole, -1, 0)
