"""A structure on its bench: what is really there, and the coarser model that a user has of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sessions.prove.truth import fe
from sessions.prove.truth.respond import complex_modes

STEEL = (210e9, 7850.0, 80e9)
ALUMINIUM = (70e9, 2700.0, 26.5e9)


@dataclass(frozen=True)
class Sensor:
    """A transducer: where the user says it is, and how far off its mount sits (m along its element)."""

    name: str
    node: str
    axis: int
    sign: int = 1
    order: int = 2
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Bench:
    """A structure on its bench: truth, nominal model, sensors and excitation.

    Parameters
    ----------
    kind : str
        "chain", "base-beam", "free-beam" or "frame".
    truth : Mesh
        The fine mesh with its true properties.
    coarse : Mesh
        The user's mesh with the user's properties.
    zones : mapping
        Parameter name -> number of the zone of bars whose stiffness it scales.
    theta : mapping
        Parameter name -> its true value (nominal 1).
    sensors : tuple of Sensor
    drive : (node, axis) or None
        Where the force acts; None when the base moves.
    base : int or None
        Axis along which the base moves.
    feet : tuple of str
        Supported nodes.
    swing : str
        "y" or "z": the user's name of axis 1; the rotation is then "rz" or "ry" (of the other sense).
    n_modes : int
        Modes in the measured band.
    ratio : float
        Typical damping ratio.
    again : callable
        Another structure of the same make: generator -> fine mesh with other ordinary errors.
    """

    kind: str
    truth: fe.Mesh
    coarse: fe.Mesh
    zones: dict[str, int]
    theta: dict[str, float]
    sensors: tuple[Sensor, ...]
    drive: tuple[str, int] | None
    base: int | None
    feet: tuple[str, ...]
    swing: str
    n_modes: int
    ratio: float
    again: Callable[[Generator], fe.Mesh]

    @property
    def elements(self) -> tuple[tuple[str, str], ...]:
        """Elements of the nominal mesh, as pairs of node names."""
        return tuple(bar.home for bar in self.coarse.bars)

    @cached_property
    def band(self) -> tuple[float, float]:
        """Excited band in Hz: from half the first elastic mode to midway past the last that is meant to be seen."""
        modes = first_modes(self.coarse, self.n_modes + 1)
        floating = 2 if self.kind == "free-beam" else 0
        top = modes[-1] if len(modes) > self.n_modes else 1.35 * modes[-1]
        return 0.5 * float(modes[floating]), float(0.45 * modes[self.n_modes - 1] + 0.55 * top)

    @property
    def modulus(self) -> float:
        """Modulus that the user takes for the material of a beam or frame, Pa: that of steel or of aluminium."""
        bar = self.coarse.bars[0]
        return min((STEEL, ALUMINIUM), key=lambda m: abs(m[0] / m[1] - bar.axial / bar.mass))[0]

    def total_mass(self) -> float:
        """Mass of the whole true structure, kg."""
        lengths = [np.hypot(*(self.truth.xy[b.ends[1]] - self.truth.xy[b.ends[0]])) for b in self.truth.bars]
        bars = sum(b.mass * length for b, length in zip(self.truth.bars, lengths, strict=True))
        axes = len(set(self.truth.kept) & {0, 1})
        return float(bars + sum(m for _, m in self.truth.lumps) / axes)


def sensor_row(mesh: fe.Mesh, sensor: Sensor) -> NDArray[np.float64]:
    """Row over all degrees of freedom, shape (size,): what the sensor really picks up, sign included."""
    if sensor.offset == 0.0:
        row = np.zeros(mesh.size)
        row[mesh.dof(sensor.node, sensor.axis)] = 1.0
        return sensor.sign * row
    for home in dict.fromkeys(bar.home for bar in mesh.bars):
        if sensor.node not in home:
            continue
        way = home if home[0] == sensor.node else (home[1], home[0])
        return sensor.sign * fe.point_row(mesh, way, abs(sensor.offset), sensor.axis)
    raise ValueError(f"no element at node {sensor.node}")


def first_modes(mesh: fe.Mesh, count: int) -> NDArray[np.float64]:
    """Lowest natural frequencies of a mesh, Hz."""
    M, K, D = fe.assemble(mesh)
    a = mesh.active
    square, _ = complex_modes(M[np.ix_(a, a)], K[np.ix_(a, a)], 0 * D[np.ix_(a, a)])
    return np.sqrt(np.maximum(np.real(square[:count]), 0)) / (2 * np.pi)
