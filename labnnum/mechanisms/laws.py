"""Scalar laws: the dynamic stiffness g(s) between a motion and the force that opposes it.

Each is exact at any complex s = i omega + sigma, nests (all parameters zero: g = 0), and realises itself as
second-order matrices with internal coordinates, so that the response in the frequency domain and the extended
structure are the same physics.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

Local = tuple[NDArray, NDArray, NDArray, NDArray]
"""M, C, K, D over (attachment, internal...) coordinates, each (1 + n_internal, 1 + n_internal)."""


class Law(ABC):
    """A scalar dynamic stiffness with its parameters."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    inertial: bool = False
    """Acts on absolute motion (under base excitation others act relative to the base)."""

    @abstractmethod
    def value(self, s: NDArray, p: NDArray) -> NDArray:
        """g(s), shape (n_f,), of force over displacement."""

    @abstractmethod
    def derivative(self, s: NDArray, p: NDArray) -> NDArray:
        """dg/dp, shape (n_parameters, n_f)."""

    @abstractmethod
    def local(self, p: NDArray) -> Local:
        """Matrices whose condensed dynamic stiffness at the attachment is g."""

    @property
    def n_internal(self) -> int:
        """Internal coordinates that `local` adds."""
        return 0

    @property
    def joint(self) -> bool:
        """Whether the law couples its columns (a matrix law), rather than acting on each alike."""
        return False

    def at(self, factor: Any) -> Law:
        """The law in a model whose stiffness there is `factor` times the nominal one, which the columns hold."""
        return Scaled(self, factor)


@dataclass(frozen=True)
class Scaled(Law):
    """`factor` times a law."""

    law: Law
    factor: Any

    @property
    def names(self) -> tuple[str, ...]:  # ty: ignore[incompatible-property-override]
        """The law's."""
        return self.law.names

    @property
    def units(self) -> tuple[str, ...]:  # ty: ignore[incompatible-property-override]
        """The law's."""
        return self.law.units

    @property
    def inertial(self) -> bool:  # ty: ignore[incompatible-property-override]
        """The law's."""
        return self.law.inertial

    def value(self, s, p):
        """Factor times g(s)."""
        return self.factor * self.law.value(s, p)

    def derivative(self, s, p):
        """Factor times dg/dp."""
        return self.factor * self.law.derivative(s, p)

    def local(self, p):
        """Factor times the law's matrices."""
        m, c, k, d = self.law.local(p)
        return self.factor * m, self.factor * c, self.factor * k, self.factor * d

    @property
    def n_internal(self) -> int:
        """The law's."""
        return self.law.n_internal


def _single(kind: int, value: complex) -> Local:
    out = [np.zeros((1, 1), type(value) if isinstance(value, complex) else float) for _ in range(4)]
    out[kind] = np.array([[value]])
    return out[0], out[1], out[2], out[3]


@final
@dataclass(frozen=True)
class Mass(Law):
    """g = m s^2."""

    names = ("mass",)
    units = ("kg",)
    inertial = True

    def value(self, s, p):
        """g(s)."""
        return p[0] * s**2

    def derivative(self, s, p):
        """dg/dm."""
        return (s**2)[None]

    def local(self, p):
        """M = [m]."""
        return _single(0, p[0])


@final
@dataclass(frozen=True)
class Inertia(Law):
    """g = J s^2 on a rotation."""

    names = ("inertia",)
    units = ("kg*m^2",)
    inertial = True

    def value(self, s, p):
        """g(s)."""
        return p[0] * s**2

    def derivative(self, s, p):
        """dg/dJ."""
        return (s**2)[None]

    def local(self, p):
        """M = [J]."""
        return _single(0, p[0])


@final
@dataclass(frozen=True)
class Spring(Law):
    """g = k."""

    names: tuple[str, ...] = ("stiffness",)
    units: tuple[str, ...] = ("N/m",)

    def value(self, s, p):
        """g(s)."""
        return p[0] + 0 * s

    def derivative(self, s, p):
        """dg/dk."""
        return np.ones((1, s.size), complex)

    def local(self, p):
        """K = [k]."""
        return _single(2, p[0])


@final
@dataclass(frozen=True)
class Dashpot(Law):
    """g = c s."""

    names: tuple[str, ...] = ("damping",)
    units: tuple[str, ...] = ("N*s/m",)

    def value(self, s, p):
        """g(s)."""
        return p[0] * s

    def derivative(self, s, p):
        """dg/dc."""
        return s[None].astype(complex)

    def local(self, p):
        """C = [c]."""
        return _single(1, p[0])


@final
@dataclass(frozen=True)
class LossySpring(Law):
    """g = i h, the loss of a spring whose own stiffness the model already holds (h = k eta, positive frequencies)."""

    names: tuple[str, ...] = ("loss",)
    units: tuple[str, ...] = ("N/m",)

    def value(self, s, p):
        """g(s)."""
        return 1j * p[0] + 0 * s

    def derivative(self, s, p):
        """dg/dh."""
        return np.full((1, s.size), 1j)

    def local(self, p):
        """D = [h]."""
        return _single(3, p[0])


@final
@dataclass(frozen=True)
class Maxwell(Law):
    """g = k1 s tau / (1 + s tau): the branch that makes a spring a Zener solid. Zener (1948)."""

    names: tuple[str, ...] = ("k1", "tau")
    units: tuple[str, ...] = ("N/m", "s")

    def value(self, s, p):
        """g(s)."""
        x = s * p[1]
        return p[0] * x / (1 + x)

    def derivative(self, s, p):
        """dg/dk1, dg/dtau."""
        x = s * p[1]
        return np.stack([x / (1 + x), p[0] * s / (1 + x) ** 2])

    def local(self, p):
        """Spring k1 to an internal coordinate, which a dashpot k1 tau ties to ground."""
        zero = np.zeros((2, 2), np.result_type(p))
        stiffness = p[0] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        damping = np.array([[0, 0], [0, 1.0]]) * p[0] * p[1]
        return zero, damping, stiffness, zero

    @property
    def n_internal(self) -> int:
        """One."""
        return 1


@final
@dataclass(frozen=True)
class Oscillator(Law):
    """g = m s^2 (w^2 + 2 zeta w s) / (s^2 + 2 zeta w s + w^2), w = 2 pi f: a mass on a damped spring."""

    names = ("mass", "frequency", "damping_ratio")
    units = ("kg", "Hz", "1")
    inertial = True

    def value(self, s, p):
        """g(s)."""
        w = 2 * np.pi * p[1]
        a = w**2 + 2 * p[2] * w * s
        return p[0] * s**2 * a / (s**2 + a)

    def derivative(self, s, p):
        """dg/dm, dg/df, dg/dzeta."""
        w = 2 * np.pi * p[1]
        a = w**2 + 2 * p[2] * w * s
        d = s**2 + a
        slope = p[0] * s**4 / d**2  # dg/da
        return np.stack([s**2 * a / d, slope * (2 * w + 2 * p[2] * s) * 2 * np.pi, slope * 2 * w * s])

    def local(self, p):
        """The moving mass as an internal coordinate."""
        w = 2 * np.pi * p[1]
        tie = np.array([[1.0, -1.0], [-1.0, 1.0]])
        kind = np.result_type(p)
        mass = np.array([[0, 0], [0, p[0]]], kind)
        return mass, 2 * p[2] * w * p[0] * tie, p[0] * w**2 * tie, np.zeros((2, 2))

    @property
    def n_internal(self) -> int:
        """One."""
        return 1


@final
@dataclass(frozen=True)
class Compliance(Law):
    """g = -c kappa^2 / (1 + c kappa): a compliance c put in series with a stiffness kappa that the model has rigid."""

    stiffness: float = 1.0
    names: tuple[str, ...] = ("compliance",)
    units: tuple[str, ...] = ("m/N",)

    def value(self, s, p):
        """g(s)."""
        k = self.stiffness
        return -p[0] * k**2 / (1 + p[0] * k) + 0 * s

    def derivative(self, s, p):
        """dg/dc."""
        k = self.stiffness
        return np.full((1, s.size), -(k**2) / (1 + p[0] * k) ** 2, complex)

    def local(self, p):
        """K = [g]."""
        k = self.stiffness
        return _single(2, -p[0] * k**2 / (1 + p[0] * k))

    def at(self, factor):
        """The series stiffness scales."""
        return replace(self, stiffness=self.stiffness * factor)


@final
@dataclass(frozen=True, eq=False)
class Release(Law):
    """Held motions q of a support given compliances c: between q and the base stands a spring 1 / c.

    With u = y + R q, R the static shape of q, the free coordinates y and q are coupled by mass alone (Craig and
    Bampton, 1968): columns L = M_ff R + M_fs, (n, d), act on y with s^2 L q, and q has K_red = K_ss + K_sf R and
    M_red = R' M_ff R + R' M_fs + M_sf R + M_ss, (d, d). Condensed on the columns' motion s^2 L' y the law is
    -E, E = C (I + (K_red + s^2 M_red) C)^-1, C = diag(c). `factor` scales K_red. What the clamp loses is modal damping.
    """

    stiffness: NDArray[np.float64]
    mass: NDArray[np.float64]
    names: tuple[str, ...] = ("compliance",)
    units: tuple[str, ...] = ("m/N",)
    factor: Any = 1.0
    inertial: bool = True

    def _left(self, s: NDArray, p: NDArray) -> NDArray:
        """(I + C Z)^-1, (n_f, d, d)."""
        z = self.factor * self.stiffness + (s**2)[:, None, None] * self.mass
        return np.linalg.inv(np.eye(len(self.mass)) + np.diag(np.asarray(p)) @ z)

    def value(self, s: NDArray, p: NDArray) -> NDArray:
        """-E at every line, shape (d, d, n_f)."""
        return -np.moveaxis(self._left(s, p) @ np.diag(np.asarray(p)), 0, 2)

    def derivative(self, s: NDArray, p: NDArray) -> NDArray:
        """-dE/dc_i, shape (d, d, d, n_f)."""
        left = self._left(s, p)
        return np.stack([-np.einsum("fa,fb->abf", left[:, :, i], left[:, :, i]) for i in range(len(self.mass))])

    def held(self, p: NDArray) -> tuple[NDArray, NDArray]:
        """Springs 1 / c, (d,), and their derivatives to c; a compliance of zero is a spring stiff beyond doubt."""
        least = 1.0 / (1e6 * np.abs(np.diag(self.stiffness)) + STIFF**2 * np.diag(self.mass))
        c = np.where(np.abs(p) > least, np.asarray(p), least)
        return 1.0 / c, -1.0 / c**2

    def local(self, p: NDArray) -> Local:
        """The columns of y, and q."""
        d = len(self.mass)
        mass, stiffness = np.zeros((2, 2 * d, 2 * d), np.result_type(p, self.factor, float))
        mass[:d, d:] = mass[d:, :d] = np.eye(d)
        mass[d:, d:] = self.mass
        stiffness[d:, d:] = self.factor * self.stiffness + np.diag(self.held(p)[0])
        return mass, np.zeros_like(mass), stiffness, np.zeros_like(mass)

    @property
    def n_internal(self) -> int:
        """The released motions."""
        return len(self.mass)

    @property
    def joint(self) -> bool:
        """It couples its columns."""
        return True

    def at(self, factor: Any) -> Law:
        """The stiffness scales, the mass does not."""
        return replace(self, factor=self.factor * factor)


STIFF = 1e6
"""Natural frequency in rad/s of what a clamp holds, on the stiffest spring that a clamp is taken for."""
