"""Scalar laws: the dynamic stiffness g(s) between a motion and the force that opposes it.

Each is exact at any complex s = i omega + sigma, nests (all parameters zero: g = 0), and realises itself as
second-order matrices with internal coordinates, so that the response in the frequency domain and the extended
structure are the same physics.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import final

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


@final
@dataclass(frozen=True, eq=False)
class CompliancePair(Law):
    """Two compliances of one clamp, c1 and c2, in series with what the model has rigid: G = -C (I + K_ss C)^-1.

    `stiffness`, (2, 2), is K_ss; the columns that it acts on are the loads K_fs per unit motion of the clamp.
    """

    stiffness: NDArray[np.float64]
    names: tuple[str, ...] = ("compliance_1", "compliance_2")
    units: tuple[str, ...] = ("m/N", "rad/(N*m)")

    def matrix(self, p: NDArray) -> NDArray:
        """G, shape (2, 2)."""
        c = np.diag(p)
        return -c @ np.linalg.inv(np.eye(2) + self.stiffness @ c)

    def value(self, s: NDArray, p: NDArray) -> NDArray:
        """G at every line, shape (2, 2, n_f)."""
        return np.broadcast_to(self.matrix(p)[:, :, None], (2, 2, s.size)).astype(complex)

    def derivative(self, s: NDArray, p: NDArray) -> NDArray:
        """dG/dc1, dG/dc2, shape (2, 2, 2, n_f)."""
        left = np.linalg.inv(np.eye(2) + np.diag(p) @ self.stiffness)
        out = np.stack([-np.outer(left[:, i], left[:, i]) for i in range(2)])
        return np.broadcast_to(out[..., None], (2, 2, 2, s.size)).astype(complex)

    def local(self, p: NDArray) -> Local:
        """K = G over the two columns."""
        zero = np.zeros((2, 2))
        return zero, zero, self.matrix(p), zero
