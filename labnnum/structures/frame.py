"""Planar and space frames of slender beams with axial force, torsion and bending in two planes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter
from labnnum.recording import DIRECTIONS
from labnnum.structures.base import Matrices, Structure
from labnnum.structures.beam import element_matrices
from labnnum.structures.quantities import Damping, Quantity, Values, check_names, modal_basis
from labnnum.structures.section import Constants

Plane = Literal["", "xy", "xz", "yz"]
PLANES: dict[str, tuple[str, ...]] = {
    "": DIRECTIONS, "xy": ("x", "y", "rz"), "xz": ("x", "z", "ry"), "yz": ("y", "z", "rx"),
}  # fmt: skip
"""Plane of a frame -> the directions in which its nodes move."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Cross-section and material of frame elements.

    Parameters
    ----------
    E, rho : float or str
        Young's modulus, Pa, and density, kg/m^3.
    G : float or str
        Shear modulus for torsion, Pa; E / 2.6 (nu = 0.3) unless given.
    diameter, bore : float or str
        Of a round bar or tube, m.
    width, height : float or str
        Of a rectangle along the element's local y and z, m.
    A, Iy, Iz, J : float or str
        Of any other shape: area m^2, second moments for bending along local z and y, and torsion constant, m^4.
    equivalent, reference : float or str, float
        With both given, masses are multiplied by equivalent / reference and stiffnesses by its inverse cubed
        (Atalla 1996, section 5.7): an equivalent length of beams that meet in joints of finite size.
    """

    E: Quantity
    rho: Quantity
    G: Quantity | None = None
    diameter: Quantity | None = None
    bore: Quantity = 0.0
    width: Quantity | None = None
    height: Quantity | None = None
    A: Quantity | None = None
    Iy: Quantity | None = None
    Iz: Quantity | None = None
    J: Quantity | None = None
    equivalent: Quantity | None = None
    reference: float | None = None

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Quantities that are given."""
        named = (self.E, self.rho, self.G, self.diameter, self.bore, self.width, self.height)
        rest = (self.A, self.Iy, self.Iz, self.J, self.equivalent)
        return tuple(q for q in (*named, *rest) if q is not None)

    def shape(self, values: Values) -> tuple[Any, Any, Any, Any]:
        """A, Iy, Iz, J at these values; ConfigError where the profile is not fully described."""
        if self.diameter is not None:
            d, b = values.at(self.diameter), values.at(self.bore)
            second = np.pi / 64 * (d**4 - b**4)
            return np.pi / 4 * (d**2 - b**2), second, second, 2 * second
        if self.width is not None and self.height is not None:
            w, h = values.at(self.width), values.at(self.height)
            return w * h, w * h**3 / 12, h * w**3 / 12, torsion_constant(w, h)
        general = (self.A, self.Iy, self.Iz, self.J)
        if any(q is None for q in general):
            raise ConfigError("a profile needs diameter (and bore), or width and height, or A, Iy, Iz and J")
        a, iy, iz, j = (values.at(q) for q in general if q is not None)
        return a, iy, iz, j

    def rigidities(self, values: Values) -> dict[str, Any]:
        """Axial EA, torsion GJ, bending EIy and EIz, mass rhoA and polar inertia rhoIp per length."""
        area, iy, iz, j = self.shape(values)
        E, rho = values.at(self.E), values.at(self.rho)
        G = values.at(self.G) if self.G is not None else E / 2.6
        heavier, stiffer = self._factors(values)
        stiff = {"EA": E * area, "GJ": G * j, "EIy": E * iy, "EIz": E * iz}
        mass = {"rhoA": rho * area, "rhoIp": rho * (iy + iz)}
        return {k: v * stiffer for k, v in stiff.items()} | {k: v * heavier for k, v in mass.items()}

    def _factors(self, values: Values) -> tuple[Any, Any]:
        if (self.equivalent is None) != (self.reference is None):
            raise ConfigError("a profile's equivalent and reference lengths belong together: give both")
        if self.equivalent is None:
            return 1.0, 1.0
        ratio = values.at(self.equivalent) / self.reference
        return ratio, ratio**-3


def torsion_constant(width: Any, height: Any) -> Any:
    """Saint-Venant's torsion constant of a rectangle, m^4, to 4 digits (Timoshenko and Goodier 1970, section 109)."""
    long, short = (width, height) if np.real(width) >= np.real(height) else (height, width)
    n = np.array([1, 3, 5, 7, 9])
    series = (np.tanh(n * np.pi * long / (2 * short)) / n**5).sum()
    return long * short**3 / 3 * (1 - 192 / np.pi**5 * short / long * series)


@dataclass(frozen=True, slots=True)
class Member:
    """A beam element between two nodes.

    Parameters
    ----------
    a, b : str
    profile : str
        Name of its profile.
    up : tuple of float
        A direction in the plane of local x (a to b) and local z; (0, 0, 0) means z, or y for members along z.
    """

    a: str
    b: str
    profile: str
    up: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class JointMass:
    """A mass with rotary inertia (the same about all axes) at a node: kg, kg m^2, or names of parameters."""

    node: str
    mass: Quantity = 0.0
    inertia: Quantity = 0.0


@dataclass(frozen=True, slots=True)
class JointSpring:
    """A spring and dashpot in one direction of a node, against the ground or the same direction of another node.

    Stiffness in N/m or N m/rad and damping in N s/m or N m s/rad, or names of parameters.
    """

    node: str
    direction: str
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    to: str = ""


@final
@dataclass(frozen=True, eq=False)
class Frame(Structure):
    """Euler-Bernoulli members between nodes, rigidly joined.

    Parameters
    ----------
    positions : mapping
        Node -> x, y, z in m.
    profiles : mapping
        Name -> Profile.
    members : sequence of Member
    fixed : mapping
        Node -> directions that are held, such as ("x", "y", "z", "rx", "ry", "rz").
    masses : sequence of JointMass
    springs : sequence of JointSpring
    plane : {"", "xy", "xz", "yz"}
        Plane in which all nodes move; "" for a space frame.
    parameters : sequence of Parameter
    damping : Damping
    base : str
        x, y or z where all supports are driven together; else empty.

    Examples
    --------
    >>> bar = Profile(E=2e11, rho=7800.0, width=0.005, height=0.005)
    >>> nodes = {str(i): (0.05 * i, 0.0, 0.0) for i in range(11)}
    >>> rod = Frame(nodes, {"bar": bar}, tuple(Member(str(i), str(i + 1), "bar") for i in range(10)),
    ...             fixed={"0": ("x", "y", "rz")}, plane="xy")
    >>> from labnnum.response import modes
    >>> modes(rod, [], 1).frequency.round(2)
    array([16.36])
    """

    positions: Mapping[str, tuple[float, float, float]]
    profiles: Mapping[str, Profile]
    members: tuple[Member, ...]
    fixed: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    masses: tuple[JointMass, ...] = ()
    springs: tuple[JointSpring, ...] = ()
    plane: Plane = ""
    parameters: tuple[Parameter, ...] = ()
    damping: Damping = field(default_factory=Damping)
    base: str = ""

    def __post_init__(self) -> None:
        for name in ("members", "masses", "springs", "parameters"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if self.plane not in PLANES:
            raise ConfigError(f'frame plane {self.plane!r} is not one of "", xy, xz, yz')
        if self.base and self.base not in self._ways[: 2 if self.plane else 3]:
            raise ConfigError(f"base = {self.base!r}: the frame's nodes move along {', '.join(self._ways)}")
        self._check_topology()
        check_names("frame", self.parameters, self._quantities)
        for profile in self.profiles.values():
            profile.rigidities(Values(self.parameters, self.nominal))

    def _check_topology(self) -> None:
        named = [(m.a, "member") for m in self.members] + [(m.b, "member") for m in self.members]
        named += [(n, "support") for n in self.fixed] + [(j.node, "mass") for j in self.masses]
        named += [(s.node, "spring") for s in self.springs] + [(s.to, "spring") for s in self.springs if s.to]
        for node, what in named:
            if node not in self.positions:
                raise ConfigError(f"{what} at {node!r}: the frame has no such node")
        for member in self.members:
            if member.profile not in self.profiles:
                raise ConfigError(f"member {member.a!r} - {member.b!r}: there is no profile {member.profile!r}")
            if not self._span(member)[0] > 0:
                raise ConfigError(f"member {member.a!r} - {member.b!r} has no length")
        for what, way in [("support", w) for ways in self.fixed.values() for w in ways] + [
            ("spring", s.direction) for s in self.springs
        ]:
            if way not in DIRECTIONS:
                raise ConfigError(f"{what} direction {way!r} is not one of {', '.join(DIRECTIONS)}")

    @property
    def _quantities(self) -> list[Quantity]:
        found = [q for p in self.profiles.values() for q in p.quantities]
        found += [q for m in self.masses for q in (m.mass, m.inertia)]
        found += [q for s in self.springs for q in (s.stiffness, s.damping)]
        return [*found, *self.damping.quantities]

    @property
    def _ways(self) -> tuple[str, ...]:
        return PLANES[self.plane]

    @cached_property
    def _all(self) -> tuple[str, ...]:
        return tuple(f"{node}:{way}" for node in self.positions for way in DIRECTIONS)

    @cached_property
    def _kept(self) -> NDArray[np.intp]:
        """Coordinates, six a node, that neither the plane nor a support holds."""
        held = {f"{node}:{way}" for node, ways in self.fixed.items() for way in ways}
        joined = {n for m in self.members for n in (m.a, m.b)}
        free = (d.split(":")[0] in joined and d.split(":")[1] in self._ways and d not in held for d in self._all)
        return np.flatnonzero(list(free))

    @cached_property
    def _numbers(self) -> dict[str, int]:
        return {dof: i for i, dof in enumerate(self.dofs)}

    @property
    def dofs(self) -> tuple[str, ...]:
        """Motions of the nodes that nothing holds."""
        return tuple(self._all[i] for i in self._kept)

    @property
    def nodes(self) -> Mapping[str, tuple[float, float, float]]:
        """Positions of all nodes."""
        return self.positions

    @property
    def elements(self) -> tuple[tuple[str, str], ...]:
        """Members by their nodes."""
        return tuple((m.a, m.b) for m in self.members)

    @property
    def supports(self) -> tuple[str, ...]:
        """Nodes that are held, or carried by springs to the ground."""
        return tuple(dict.fromkeys([*self.fixed, *(s.node for s in self.springs if not s.to)]))

    def released(self, node: str) -> Structure | None:
        """The frame with this node free."""
        if node not in self.fixed:
            return None
        return replace(self, fixed={n: ways for n, ways in self.fixed.items() if n != node})

    def _span(self, member: Member) -> tuple[float, NDArray[np.float64]]:
        """Length of a member and the rotation from global to local axes, (3, 3)."""
        arm = np.array(self.positions[member.b], float) - np.array(self.positions[member.a], float)
        length = float(np.linalg.norm(arm))
        if length == 0:
            return 0.0, np.eye(3)
        x = arm / length
        up = np.array(member.up, float)
        if not up.any():
            up = np.array([0.0, 1.0, 0.0]) if abs(x[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
        y = np.cross(up, x)
        if np.linalg.norm(y) < 1e-6 * np.linalg.norm(up):
            raise ConfigError(f"member {member.a!r} - {member.b!r}: up must not point along the member")
        y /= np.linalg.norm(y)
        return length, np.array([x, y, np.cross(x, y)])

    @cached_property
    def _patterns(self) -> dict[tuple[str, str], NDArray[np.float64]]:
        """(Profile, rigidity) -> the matrix that a unit of this rigidity contributes."""
        out: dict[tuple[str, str], NDArray] = {}
        size = 6 * len(self.positions)
        first = {node: 6 * i for i, node in enumerate(self.positions)}
        for member in self.members:
            length, turn = self._span(member)
            whole = np.kron(np.eye(4), turn)
            at = np.r_[first[member.a] : first[member.a] + 6, first[member.b] : first[member.b] + 6]
            for name, local in unit_matrices(length).items():
                total = out.setdefault((member.profile, name), np.zeros((size, size)))
                total[np.ix_(at, at)] += whole.T @ local @ whole
        keep = np.ix_(self._kept, self._kept)
        return {key: total[keep] for key, total in out.items()}

    @cached_property
    def _lumped(self) -> dict[Quantity, NDArray[np.float64]]:
        """Mass or inertia of joints -> how many times it sits on each coordinate."""
        out: dict[Quantity, NDArray] = {}
        for joint in self.masses:
            for i, turning in self._coordinates(joint.node):
                quantity = joint.inertia if turning else joint.mass
                out.setdefault(quantity, np.zeros(self._kept.size))[i] += 1.0
        return out

    @cached_property
    def _free(self) -> Frame:
        return replace(self, fixed={})

    def held_load(self, theta: NDArray) -> NDArray:
        """What the supports push the nodes by as they move with the base, through the mass of the members between."""
        every = self._free._kept
        held = np.flatnonzero(~np.isin(every, self._kept))
        free = np.flatnonzero(np.isin(every, self._kept))
        return self._free._assembled(theta)[0][np.ix_(free, held)] @ self._free.rigid(theta)[held]

    @cached_property
    def _basis(self) -> NDArray[np.float64] | None:
        if self.damping.kind != "modal":
            return None
        mass, stiffness, _ = self._assembled(self.nominal)
        return modal_basis(mass, stiffness)

    def matrices(self, theta: NDArray) -> Matrices:
        """M, C, K, D at theta."""
        values = Values(self.parameters, theta)
        mass, stiffness, dashpots = self._assembled(theta)
        viscous = dashpots + self.damping.viscous(values, mass, stiffness, self._basis)
        return Matrices(mass, viscous, stiffness, self.damping.loss(values, stiffness))

    def _assembled(self, theta: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        values = Values(self.parameters, theta)
        n = self._kept.size
        mass, stiffness, dashpots = (np.zeros((n, n), np.result_type(theta, float)) for _ in range(3))
        rigidities = {name: p.rigidities(values) for name, p in self.profiles.items()}
        for (profile, name), pattern in self._patterns.items():
            target = mass if name.startswith("rho") else stiffness
            target += rigidities[profile][name] * pattern
        for quantity, count in self._lumped.items():
            mass[np.diag_indices(n)] += values.at(quantity) * count
        for spring in self.springs:
            row = self._elongation(spring)
            stiffness += values.at(spring.stiffness) * np.outer(row, row)
            dashpots += values.at(spring.damping) * np.outer(row, row)
        return mass, stiffness, dashpots

    def _coordinates(self, node: str) -> Iterator[tuple[int, bool]]:
        for way in DIRECTIONS:
            i = self._numbers.get(f"{node}:{way}")
            if i is not None:
                yield i, way.startswith("r")

    def _elongation(self, spring: JointSpring) -> NDArray[np.float64]:
        row = np.zeros(self._kept.size)
        for node, sign in ((spring.node, 1.0), (spring.to, -1.0)):
            i = self._numbers.get(f"{node}:{spring.direction}")
            if i is not None:
                row[i] += sign
        return row

    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """Unit row; zeros where a support holds that motion and the base may drive it."""
        row = np.zeros(self._kept.size)
        node, _, way = dof.partition(":")
        if way == self.base and way in self.fixed.get(node, ()):
            return row
        row[self.require_dof(dof)] = 1.0
        return row

    def rigid(self, theta: NDArray) -> NDArray:
        """Unit translations along the base's direction."""
        if not self.base:
            raise ModelError("the frame's supports do not move: set base to x, y or z")
        return np.array([float(d.split(":")[1] == self.base) for d in self.dofs])


def unit_matrices(length: float) -> dict[str, NDArray[np.float64]]:
    """Local (12, 12) matrices of an element for unit EA, GJ, EIy, EIz, rhoA and rhoIp; three motions, three turns."""
    out = {name: np.zeros((12, 12)) for name in ("EA", "GJ", "EIy", "EIz", "rhoA", "rhoIp")}
    rod = np.array([[1.0, -1.0], [-1.0, 1.0]]) / length
    lump = length / 6 * np.array([[2.0, 1.0], [1.0, 2.0]])
    along, twist = np.ix_((0, 6), (0, 6)), np.ix_((3, 9), (3, 9))
    out["EA"][along], out["rhoA"][along] = rod, lump
    out["GJ"][twist], out["rhoIp"][twist] = rod, lump
    mass, stiffness = (a[:4, :4] for a in element_matrices(Constants(1.0, 1.0, np.inf, 0.0), length))
    for name, at, sign in (("EIz", (1, 5, 7, 11), 1.0), ("EIy", (2, 4, 8, 10), -1.0)):
        signs = np.outer((1.0, sign, 1.0, sign), (1.0, sign, 1.0, sign))
        out[name][np.ix_(at, at)] = signs * stiffness
        out["rhoA"][np.ix_(at, at)] += signs * mass
    return out
