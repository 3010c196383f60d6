"""Straight uniform beams in bending, after Euler and Bernoulli or Timoshenko, with supports and attachments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter
from labnnum.structures.base import Matrices, Structure
from labnnum.structures.quantities import Damping, Quantity, Values, check_names, modal_basis
from labnnum.structures.section import Constants, Section, constants

Theory = Literal["euler-bernoulli", "timoshenko"]
Hold = Literal["clamped", "pinned", "guided"]
HELD: dict[str, tuple[bool, bool]] = {"clamped": (True, True), "pinned": (True, False), "guided": (False, True)}
"""Support -> whether deflection and rotation are held."""

_POINTS = 0.5 + 0.5 * np.polynomial.legendre.leggauss(5)[0]
_WEIGHTS = np.polynomial.legendre.leggauss(5)[1] / 2


@dataclass(frozen=True, slots=True)
class Lump:
    """A mass with rotary inertia on a beam, such as an accelerometer.

    Parameters
    ----------
    node : str
        Node or point.
    mass, inertia : float or str
        kg and kg m^2, or names of parameters.
    """

    node: str
    mass: Quantity = 0.0
    inertia: Quantity = 0.0


@dataclass(frozen=True, slots=True)
class Spring:
    """An elastic support: springs and dashpots between a point of the beam and the ground (or moving base).

    Parameters
    ----------
    node : str
        Node or point.
    stiffness, damping : float or str
        Against deflection: N/m and N s/m, or names of parameters.
    rotational, rotational_damping : float or str
        Against rotation: N m/rad and N m s/rad, or names of parameters.
    """

    node: str
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    rotational: Quantity = 0.0
    rotational_damping: Quantity = 0.0


@final
@dataclass(frozen=True, eq=False)
class Beam(Structure):
    """A uniform beam of `n_elements` elements along one axis, deflecting along another.

    Its mesh nodes are called "1" to str(n_elements + 1), after the prefix `mesh`, and move with the length; further
    `points` stay where they are, in m, when a length parameter moves, and are seen through the element's own shape
    functions (beyond a shortened end, through its rigid extension).

    Parameters
    ----------
    length : float or str
        m, or the name of a parameter.
    section : Section
    n_elements : int
    theory : {"euler-bernoulli", "timoshenko"}
    interior : {0, 1, 2} or None
        Coordinates inside each element, beside those of its ends: the deflection under an even load, then under an
        even moment. They give a Timoshenko element the fourth order that Euler and Bernoulli's has with none.
        None: 2 for Timoshenko, else 0; Euler and Bernoulli's takes at most 1.
    supports_at : mapping
        Mesh node -> "clamped", "pinned" or "guided"; ends that are not named are free.
    points : mapping
        Name -> distance from the start, m.
    lumps : sequence of Lump
    springs : sequence of Spring
    parameters : sequence of Parameter
        Those that the other arguments name.
    damping : Damping
    axis, direction : {"x", "y", "z"}
        Axis of the beam and of its deflection.
    base : str
        Equal to `direction` where all supports and springs are driven together; else empty.
    mesh : str
        Prefix of the mesh nodes' names, so that points can be called by numbers.
    spacing : tuple of float
        Lengths of the elements, in any unit; equal ones if empty.

    Examples
    --------
    >>> steel = Section(E=2e11, rho=7800.0, width=0.03, height=0.005)
    >>> rod = Beam(length=0.5, section=steel, n_elements=8, supports_at={"1": "clamped"})
    >>> from labnnum.response import modes
    >>> modes(rod, [], 2).frequency.round(2)
    array([ 16.36, 102.53])
    """

    length: Quantity
    section: Section
    n_elements: int = 20
    theory: Theory = "euler-bernoulli"
    interior: int | None = None
    supports_at: Mapping[str, Hold] = field(default_factory=dict)
    points: Mapping[str, float] = field(default_factory=dict)
    lumps: tuple[Lump, ...] = ()
    springs: tuple[Spring, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    damping: Damping = field(default_factory=Damping)
    axis: str = "x"
    direction: str = "z"
    base: str = ""
    mesh: str = ""
    spacing: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in ("lumps", "springs", "parameters", "spacing"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if self.theory not in ("euler-bernoulli", "timoshenko"):
            raise ConfigError(f"beam theory {self.theory!r} is not euler-bernoulli or timoshenko")
        if self.interior is None:
            object.__setattr__(self, "interior", 2 * int(self.theory == "timoshenko"))
        if self.interior not in (0, 1, 2)[: 3 if self.theory == "timoshenko" else 2]:
            raise ConfigError(f"interior = {self.interior!r}: expected 0 or 1 (2 for Timoshenko) in each element")
        if self.n_elements < 1:
            raise ConfigError(f"a beam needs at least one element, got {self.n_elements}")
        if self.spacing and (len(self.spacing) != self.n_elements or min(self.spacing) <= 0):
            raise ConfigError(
                f"spacing = {list(self.spacing)}: expected {self.n_elements} positive lengths, one an element"
            )
        if not {self.axis, self.direction} < {"x", "y", "z"} or self.axis == self.direction:
            raise ConfigError(f"beam axis {self.axis!r}, direction {self.direction!r}: two different ones of x, y, z")
        if self.base not in ("", self.direction):
            raise ConfigError(f"base = {self.base!r}: the beam deflects along {self.direction}")
        check_names("beam", self.parameters, self._quantities)
        self._check_places()
        constants(self.section, self._nominal_values, self._nominal_length, self.theory == "timoshenko")

    def _check_places(self) -> None:
        mesh = self.mesh_nodes
        for node, hold in self.supports_at.items():
            if node not in mesh:
                raise ConfigError(f"support at {node!r}: supports sit on mesh nodes {mesh[0]} to {mesh[-1]}")
            if hold not in HELD:
                raise ConfigError(f"support at node {node!r} is {hold!r}: expected one of {', '.join(HELD)}")
        for name, x in self.points.items():
            if name in mesh:
                raise ConfigError(
                    f"point {name!r} has the name of a mesh node ({mesh[0]} to {mesh[-1]}): call it otherwise, or set"
                    ' mesh to a prefix of the mesh nodes, such as "n"'
                )
            if not 0 <= x <= self._nominal_length * (1 + 1e-12):
                raise ConfigError(f"point {name!r} at {x:g} m lies off the beam of {self._nominal_length:g} m")
        for attached in (*self.lumps, *self.springs):
            if attached.node not in mesh and attached.node not in self.points:
                raise ConfigError(
                    f"{type(attached).__name__.lower()} on {attached.node!r}: there is no such mesh node or point"
                )

    @property
    def _quantities(self) -> list[Quantity]:
        attached = [q for lump in self.lumps for q in (lump.mass, lump.inertia)]
        for s in self.springs:
            attached += [s.stiffness, s.damping, s.rotational, s.rotational_damping]
        return [self.length, *self.section.quantities, *attached, *self.damping.quantities]

    @property
    def _nominal_values(self) -> Values:
        return Values(self.parameters, self.nominal)

    @property
    def _nominal_length(self) -> float:
        length = float(self._nominal_values.at(self.length))
        if not length > 0:
            raise ConfigError(f"beam length {length:g} m: expected a positive number")
        return length

    @cached_property
    def mesh_nodes(self) -> tuple[str, ...]:
        """Names of the element boundaries, in order."""
        return tuple(f"{self.mesh}{i + 1}" for i in range(self.n_elements + 1))

    @cached_property
    def _borders(self) -> NDArray[np.float64]:
        """Where the elements meet, as shares of the length, from 0 to 1."""
        if not self.spacing:
            return np.arange(self.n_elements + 1) / self.n_elements
        return np.r_[0.0, np.cumsum(self.spacing)] / np.sum(self.spacing)

    @property
    def rotation(self) -> str:
        """Axis about which the beam's sections turn: rx, ry or rz."""
        return "r" + next(a for a in "xyz" if a not in (self.axis, self.direction))

    @cached_property
    def _turn(self) -> float:
        """Slope of the deflection for a positive unit rotation: -1 where axis x direction is a negative axis."""
        return 1.0 if self.axis + self.direction in ("xy", "yz", "zx") else -1.0

    @cached_property
    def _kept(self) -> NDArray[np.intp]:
        """Coordinates (deflection and rotation of each mesh node in turn, then interior) that no support holds."""
        held = np.zeros(self._n_all, bool)
        for node, hold in self.supports_at.items():
            i = 2 * self.mesh_nodes.index(node)
            held[i : i + 2] = HELD[hold]
        return np.flatnonzero(~held)

    @property
    def _n_all(self) -> int:
        return 2 * (self.n_elements + 1) + self.n_elements * int(self.interior or 0)

    def _of_element(self, e: int) -> NDArray[np.intp]:
        """Coordinates of an element."""
        ends, inside = 2 * (self.n_elements + 1), int(self.interior or 0)
        return np.r_[2 * e : 2 * e + 4, ends + inside * e : ends + inside * (e + 1)]

    @cached_property
    def _signs(self) -> NDArray[np.float64]:
        return np.array([1.0, self._turn, 1.0, self._turn, 1.0, 1.0][: 4 + int(self.interior or 0)])

    @property
    def dofs(self) -> tuple[str, ...]:
        """Deflection and rotation of each mesh node that is not held, then of each point."""
        names = [f"{node}:{way}" for node in self.mesh_nodes for way in (self.direction, self.rotation)]
        mesh = [names[i] for i in self._kept if i < len(names)]
        return tuple(mesh + [f"{p}:{way}" for p in self.points for way in (self.direction, self.rotation)])

    @property
    def nodes(self) -> Mapping[str, tuple[float, float, float]]:
        """Positions at nominal length."""
        mesh = dict(zip(self.mesh_nodes, self._nominal_length * self._borders, strict=True))
        places = {name: float(x) for name, x in mesh.items()} | dict(self.points)
        unit = np.array([a == self.axis for a in "xyz"], float)
        return {name: (float(x * unit[0]), float(x * unit[1]), float(x * unit[2])) for name, x in places.items()}

    @property
    def elements(self) -> tuple[tuple[str, str], ...]:
        """Neighbouring mesh nodes."""
        mesh = self.mesh_nodes
        return tuple(pairwise(mesh))

    @property
    def supports(self) -> tuple[str, ...]:
        """Nodes that are held, or carried by springs."""
        return tuple(dict.fromkeys([*self.supports_at, *(s.node for s in self.springs)]))

    def released(self, node: str) -> Structure | None:
        """The beam with this end or node free."""
        if node not in self.supports_at:
            return None
        return replace(self, supports_at={n: h for n, h in self.supports_at.items() if n != node})

    @cached_property
    def _free(self) -> Beam:
        return replace(self, supports_at={})

    def held_load(self, theta: NDArray) -> NDArray:
        """What the ends that move with the base push the rest by, through the mass of the elements between."""
        held = np.setdiff1d(self._free._kept, self._kept)
        mass = self._free._assembled(theta)[0]
        return mass[np.ix_(self._kept, held)] @ self._free.rigid(theta)[held]

    @cached_property
    def _basis(self) -> NDArray[np.float64] | None:
        if self.damping.kind != "modal":
            return None
        mass, stiffness, _ = self._assembled(self.nominal)
        return modal_basis(mass, stiffness)

    def matrices(self, theta: NDArray) -> Matrices:
        """M, C, K, D at theta; coordinates are those of the mesh nodes that are not held."""
        values = Values(self.parameters, theta)
        mass, stiffness, dashpots = self._assembled(theta)
        viscous = dashpots + self.damping.viscous(values, mass, stiffness, self._basis)
        return Matrices(mass, viscous, stiffness, self.damping.loss(values, stiffness))

    def _assembled(self, theta: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        values = Values(self.parameters, theta)
        c, length = self._constants_at(theta)
        mass, stiffness = (a.astype(np.result_type(theta, float)) for a in self._bare(c, length))
        dashpots = np.zeros_like(stiffness)
        for lump in self.lumps:
            for way, amount in ((0, lump.mass), (1, lump.inertia)):
                _add(mass, self._full_row(lump.node, way, c, length), values.at(amount))
        for s in self.springs:
            for way, k, b in ((0, s.stiffness, s.damping), (1, s.rotational, s.rotational_damping)):
                row = self._full_row(s.node, way, c, length)
                _add(stiffness, row, values.at(k))
                _add(dashpots, row, values.at(b))
        keep = np.ix_(self._kept, self._kept)
        return mass[keep], stiffness[keep], dashpots[keep]

    def _bare(self, c: Constants, length: Any) -> tuple[NDArray, NDArray]:
        """Matrices of the beam alone on all mesh coordinates."""
        signs = np.outer(self._signs, self._signs)
        kind = np.result_type(length, c.EI, c.rhoA, c.kGA, c.rhoI, float)
        mass, stiffness = np.zeros((2, self._n_all, self._n_all), kind)
        made: dict[float, tuple[NDArray, NDArray]] = {}
        for e, share in enumerate(np.diff(self._borders)):
            size = round(float(share), 12)
            if size not in made:
                m, k = (a[: len(signs), : len(signs)] for a in element_matrices(c, length * share))
                made[size] = (signs * m, signs * k)
            at = np.ix_(self._of_element(e), self._of_element(e))
            mass[at] += made[size][0]
            stiffness[at] += made[size][1]
        return mass, stiffness

    def _full_row(self, node: str, way: int, c: Constants, length: Any) -> NDArray:
        """Deflection (way 0) or rotation (way 1) at a node or point, over all mesh coordinates."""
        row = np.zeros(self._n_all, np.result_type(length, c.EI, float))
        if node not in self.points:
            row[2 * self.mesh_nodes.index(node) + way] = 1.0
            return row
        x = self.points[node]
        e = int(np.searchsorted(self._borders[1:-1], np.real(x / length), side="right"))
        share = self._borders[e + 1] - self._borders[e]
        beyond = bool(np.real(x) > np.real(length))
        xi = 1.0 if beyond else (x / length - self._borders[e]) / share
        h = length * share
        deflection, slope = shape_functions(xi, _flexibility(c, h), h)
        shape = deflection + (slope * (x - length) if beyond else 0.0) if way == 0 else slope * self._turn
        row[self._of_element(e)] = shape[: len(self._signs)] * self._signs
        return row

    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """Row over the coordinates; zeros where a support holds that motion and the base may drive it."""
        node, _, way = dof.partition(":")
        if node in self.supports_at and way == self.base:
            return self._full_row(node, 0, *self._constants_at(theta))[self._kept]
        self.require_dof(dof)
        return self._full_row(node, int(way == self.rotation), *self._constants_at(theta))[self._kept]

    def _constants_at(self, theta: NDArray) -> tuple[Constants, Any]:
        values = Values(self.parameters, theta)
        length = values.at(self.length)
        return constants(self.section, values, length, self.theory == "timoshenko"), length

    def rigid(self, theta: NDArray) -> NDArray:
        """Unit deflections and no rotation: the beam follows its supports."""
        if not self.base:
            raise ModelError("the beam's supports do not move: set base to its direction")
        whole = np.zeros(self._n_all)
        whole[0 : 2 * (self.n_elements + 1) : 2] = 1.0
        return whole[self._kept]


def _flexibility(c: Constants, h: Any) -> Any:
    """Shear flexibility of an element, 12 EI / (kGA h^2); 0 after Euler and Bernoulli."""
    return 12 * c.EI / (c.kGA * h**2) if np.isfinite(np.real(c.kGA)) else 0.0 * h


def shape_functions(xi: Any, phi: Any, h: Any) -> tuple[NDArray, NDArray]:
    """Deflection and section rotation at xi = x/h for each coordinate of an element, both shape (6, ...).

    Unit end displacements and rotations: the static solutions of the Timoshenko beam, so that the element neither
    locks nor needs reduced integration (Friedman and Kosmatka 1993); Hermite's cubics at phi = 0. The others
    are the deflections between held ends under an even load (1 in the middle) and under an even moment; they store
    no energy with the first four, nor with each other.
    """
    xi = np.asarray(xi)
    deflection = [
        2 * xi**3 - 3 * xi**2 - phi * xi + 1 + phi,
        h * (xi**3 - (2 + phi / 2) * xi**2 + (1 + phi / 2) * xi),
        -(2 * xi**3 - 3 * xi**2 - phi * xi),
        h * (xi**3 - (1 - phi / 2) * xi**2 - phi / 2 * xi),
        16 * (1 + phi) / (1 + 4 * phi) * (xi**2 * (1 - xi) ** 2 + phi * xi * (1 - xi)),
        (1 + phi) * h * (xi**2 / 2 - xi**3 / 3 - xi / 6),
    ]
    rotation = [
        6 * (xi**2 - xi) / h,
        3 * xi**2 - (4 + phi) * xi + 1 + phi,
        -6 * (xi**2 - xi) / h,
        3 * xi**2 - (2 - phi) * xi,
        32 * (1 + phi) / (1 + 4 * phi) / h * (xi - 3 * xi**2 + 2 * xi**3),
        (1 + phi) * (xi - xi**2),
    ]
    return np.array(deflection) / (1 + phi), np.array(rotation) / (1 + phi)


def element_matrices(c: Constants, h: Any) -> tuple[NDArray, NDArray]:
    """Consistent mass and stiffness of an element of length h, both (6, 6).

    Coordinates are w1, slope1, w2, slope2 and the two interior ones (the last of Timoshenko's element only).
    """
    phi = _flexibility(c, h)
    even = 204.8 * (1 + phi) * (1 + 5 * phi) / (1 + 4 * phi) ** 2
    turn = (1 + phi) ** 2 * h**2 / (3 * phi) if np.isfinite(np.real(c.kGA)) else 1.0
    stiffness = c.EI / ((1 + phi) * h**3) * np.array([
        [12.0, 6 * h, -12.0, 6 * h, 0.0, 0.0],
        [6 * h, (4 + phi) * h**2, -6 * h, (2 - phi) * h**2, 0.0, 0.0],
        [-12.0, -6 * h, 12.0, -6 * h, 0.0, 0.0],
        [6 * h, (2 - phi) * h**2, -6 * h, (4 + phi) * h**2, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, even, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, turn],
    ])  # fmt: skip
    deflection, rotation = shape_functions(_POINTS, phi, h)
    mass = c.rhoA * h * (deflection * _WEIGHTS) @ deflection.T + c.rhoI * h * (rotation * _WEIGHTS) @ rotation.T
    return mass, stiffness


def _add(matrix: NDArray, row: NDArray, amount: Any) -> None:
    """Add amount row^T row."""
    at = np.flatnonzero(row)
    matrix[np.ix_(at, at)] += amount * np.outer(row[at], row[at])
