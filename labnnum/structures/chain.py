"""Lumped masses joined by springs and dashpots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter
from labnnum.structures.base import Matrices, Structure
from labnnum.structures.quantities import Damping, Quantity, Values, check_names, modal_basis

GROUND = "ground"
"""Name of the fixed (or, under base excitation, moving) support."""


@dataclass(frozen=True, slots=True)
class Link:
    """A spring and a dashpot side by side between two nodes, or a node and "ground".

    Parameters
    ----------
    a, b : str
        Node names; one of them may be "ground".
    stiffness : float or str
        N/m, or the name of a parameter.
    damping : float or str
        N s/m, or the name of a parameter.
    """

    a: str
    b: str
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0


@final
@dataclass(frozen=True, eq=False)
class Chain(Structure):
    """Masses that move along one axis, in any topology.

    Parameters
    ----------
    masses : mapping
        Node name -> mass in kg, or the name of a parameter.
    links : sequence of Link
    parameters : sequence of Parameter
        Those that masses, links and damping name.
    damping : Damping
        In addition to the dashpots.
    direction : str
        Axis of all motions.
    base : str
        The same axis where the ground is driven; empty where it is fixed.
    positions : mapping
        Node name -> x, y, z in m, for drawings; optional.

    Examples
    --------
    >>> one = Chain({"1": "m"}, (Link("1", "ground", 100.0, 0.5),), (Parameter("m", 2.0, 1.0, 3.0, "kg"),))
    >>> one.matrices(np.array([2.5])).M
    array([[2.5]])
    """

    masses: Mapping[str, Quantity]
    links: tuple[Link, ...]
    parameters: tuple[Parameter, ...] = ()
    damping: Damping = field(default_factory=Damping)
    direction: str = "x"
    base: str = ""
    positions: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "links", tuple(self.links))
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if not self.masses:
            raise ConfigError("a chain needs at least one mass")
        if self.base not in ("", self.direction):
            raise ConfigError(f"base = {self.base!r}: the chain moves along {self.direction}")
        for link in self.links:
            self._check_link(link)
        check_names("chain", self.parameters, [*self.masses.values(), *self._link_quantities, *self.damping.quantities])

    def _check_link(self, link: Link) -> None:
        for node in (link.a, link.b):
            if node != GROUND and node not in self.masses:
                known = ", ".join(self.masses)
                raise ConfigError(f"link {link.a!r} - {link.b!r}: there is no mass {node!r}; there are {known}, ground")
        if link.a == link.b:
            raise ConfigError(f"link {link.a!r} - {link.b!r} joins a node with itself")

    @property
    def _link_quantities(self) -> list[Quantity]:
        return [q for link in self.links for q in (link.stiffness, link.damping)]

    @property
    def dofs(self) -> tuple[str, ...]:
        """One a mass."""
        return tuple(f"{name}:{self.direction}" for name in self.masses)

    @property
    def nodes(self) -> Mapping[str, tuple[float, float, float]]:
        """Positions if they were given."""
        return self.positions

    @property
    def elements(self) -> tuple[tuple[str, str], ...]:
        """Pairs of masses that a link joins."""
        pairs = dict.fromkeys((link.a, link.b) for link in self.links if GROUND not in (link.a, link.b))
        return tuple(pairs)

    @property
    def supports(self) -> tuple[str, ...]:
        """Masses that a link joins to the ground."""
        held = (link.b if link.a == GROUND else link.a for link in self.links if GROUND in (link.a, link.b))
        return tuple(dict.fromkeys(held))

    @cached_property
    def _incidence(self) -> NDArray[np.float64]:
        """Elongation of each link by each coordinate, shape (n_links, n)."""
        row = {name: i for i, name in enumerate(self.masses)}
        out = np.zeros((len(self.links), len(self.masses)))
        for k, link in enumerate(self.links):
            if link.a != GROUND:
                out[k, row[link.a]] = -1.0
            if link.b != GROUND:
                out[k, row[link.b]] = 1.0
        return out

    @cached_property
    def _basis(self) -> NDArray[np.float64] | None:
        if self.damping.kind != "modal":
            return None
        values = Values(self.parameters, self.nominal)
        return modal_basis(*self._mass_and_stiffness(values))

    def _mass_and_stiffness(self, values: Values) -> tuple[NDArray, NDArray]:
        b = self._incidence
        mass = np.diag(values.array(tuple(self.masses.values())))
        return mass, (b.T * values.array([link.stiffness for link in self.links])) @ b

    def matrices(self, theta: NDArray) -> Matrices:
        """M, C, K, D at theta."""
        values = Values(self.parameters, theta)
        mass, stiffness = self._mass_and_stiffness(values)
        b = self._incidence
        dashpots = (b.T * values.array([link.damping for link in self.links])) @ b
        viscous = dashpots + self.damping.viscous(values, mass, stiffness, self._basis)
        return Matrices(mass, viscous, stiffness, self.damping.loss(values, stiffness))

    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """Unit row of the mass."""
        row = np.zeros(len(self.masses))
        row[self.require_dof(dof)] = 1.0
        return row

    def rigid(self, theta: NDArray) -> NDArray:
        """Ones: all masses follow the ground."""
        if not self.base:
            raise ModelError("the chain's ground does not move: set base to its direction")
        return np.ones(len(self.masses))
