"""[structure] of every kind, and the structures that it describes; docs/models.md explains every key."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from labnnum.errors import ConfigError
from labnnum.recording import DIRECTIONS
from labnnum.structures import Beam, Chain, Frame, ModalStructure, Structure
from labnnum.structures.beam import Lump, Spring
from labnnum.structures.chain import Link
from labnnum.structures.frame import JointMass, JointSpring, Member, Profile
from labnnum.structures.modal import Mode
from labnnum.structures.section import Section
from sessions.model_common import Axis, Base, Common, Point3, Quantity, StructureTable, Text, once
from sessions.model_matrices import MatrixTable
from sessions.toml import Table


class ChainMass(Table):
    """One [[structure.mass]] of a chain."""

    node: Text
    mass: Quantity
    position: Point3 | None = None


class ChainLink(Table):
    """One [[structure.link]] of a chain."""

    between: tuple[Text, Text]
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0


class ChainTable(StructureTable):
    """[structure] of kind chain."""

    kind: Literal["chain"]
    direction: Axis = "x"
    base: Base = ""
    mass: tuple[ChainMass, ...]
    link: tuple[ChainLink, ...]

    def build(self, common: Common, folder: Path) -> Structure:
        """The chain."""
        once("structure.mass", [m.node for m in self.mass])
        return Chain(
            masses={m.node: m.mass for m in self.mass},
            links=tuple(Link(*k.between, k.stiffness, k.damping) for k in self.link),
            parameters=common.parameters,
            damping=common.damping_model,
            direction=self.direction,
            base=self.base,
            positions={m.node: m.position for m in self.mass if m.position is not None},
        )


class BeamSupport(Table):
    """One [[structure.support]] of a beam."""

    node: Text
    kind: Literal["clamped", "pinned", "guided"] = "clamped"


class BeamPoint(Table):
    """One [[structure.point]] of a beam: a place in m from its start."""

    node: Text
    x: float


class LumpTable(Table):
    """One [[structure.lump]]: a mass with rotary inertia."""

    node: Text
    mass: Quantity = 0.0
    inertia: Quantity = 0.0


class BeamSpring(Table):
    """One [[structure.spring]] of a beam."""

    node: Text
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    rotational: Quantity = 0.0
    rotational_damping: Quantity = 0.0


class BeamTable(StructureTable):
    """[structure] of kind beam."""

    kind: Literal["beam"]
    length: Quantity
    elements: int = 20
    spacing: tuple[float, ...] = ()
    theory: Literal["euler-bernoulli", "timoshenko"] = "euler-bernoulli"
    interior: int | None = None
    axis: Axis = "x"
    direction: Axis = "z"
    base: Base = ""
    mesh: str = ""
    E: Quantity | None = None
    G: Quantity | None = None
    nu: Quantity | None = None
    rho: Quantity | None = None
    width: Quantity | None = None
    height: Quantity | None = None
    diameter: Quantity | None = None
    bore: Quantity | None = None
    A: Quantity | None = None
    I: Quantity | None = None  # noqa: E741
    EI: Quantity | None = None
    rhoA: Quantity | None = None
    kGA: Quantity | None = None
    rhoI: Quantity | None = None
    wave: Quantity | None = None
    mass: Quantity | None = None
    kappa: Quantity | None = None
    support: tuple[BeamSupport, ...] = ()
    point: tuple[BeamPoint, ...] = ()
    lump: tuple[LumpTable, ...] = ()
    spring: tuple[BeamSpring, ...] = ()

    def build(self, common: Common, folder: Path) -> Structure:
        """The beam; "start" and "end" stand for its first and last mesh node."""
        ends = {"start": f"{self.mesh}1", "end": f"{self.mesh}{self.elements + 1}"}
        once("structure.point", [p.node for p in self.point])
        once("structure.support", [s.node for s in self.support])
        return Beam(
            length=self.length,
            section=Section(**{k: getattr(self, k) for k in Section.__dataclass_fields__}),
            n_elements=self.elements,
            theory=self.theory,
            interior=self.interior,
            supports_at={ends.get(s.node, s.node): s.kind for s in self.support},
            points={p.node: p.x for p in self.point},
            lumps=tuple(Lump(ends.get(b.node, b.node), b.mass, b.inertia) for b in self.lump),
            springs=tuple(
                Spring(ends.get(s.node, s.node), s.stiffness, s.damping, s.rotational, s.rotational_damping)
                for s in self.spring
            ),
            parameters=common.parameters,
            damping=common.damping_model,
            axis=self.axis,
            direction=self.direction,
            base=self.base,
            mesh=self.mesh,
            spacing=self.spacing,
        )


class NodeTable(Table):
    """One [[structure.node]]."""

    node: Text
    xyz: Point3


class ProfileTable(Table):
    """One [[structure.profile]] of a frame."""

    name: str
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


class MemberTable(Table):
    """One [[structure.member]] of a frame."""

    between: tuple[Text, Text]
    profile: str
    divide: int = Field(default=1, ge=1)
    up: Point3 = (0.0, 0.0, 0.0)


class FrameSupport(Table):
    """One [[structure.support]] of a frame."""

    node: Text
    fixed: tuple[Literal["x", "y", "z", "rx", "ry", "rz"], ...] = DIRECTIONS


class FrameSpring(Table):
    """One [[structure.spring]] of a frame."""

    node: Text
    direction: Literal["x", "y", "z", "rx", "ry", "rz"]
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    to: Text = ""


class FrameTable(StructureTable):
    """[structure] of kind frame."""

    kind: Literal["frame"]
    plane: Literal["", "xy", "xz", "yz"] = ""
    base: Base = ""
    node: tuple[NodeTable, ...]
    profile: tuple[ProfileTable, ...]
    member: tuple[MemberTable, ...]
    support: tuple[FrameSupport, ...] = ()
    lump: tuple[LumpTable, ...] = ()
    spring: tuple[FrameSpring, ...] = ()

    def build(self, common: Common, folder: Path) -> Structure:
        """The frame; the inner nodes of a divided member are called "a-b.1" and so on."""
        once("structure.node", [n.node for n in self.node])
        once("structure.profile", [p.name for p in self.profile])
        positions: dict[str, Point3] = {n.node: n.xyz for n in self.node}
        members = [part for m in self.member for part in _divided(m, positions)]
        return Frame(
            positions=positions,
            profiles={
                p.name: Profile(**{k: getattr(p, k) for k in Profile.__dataclass_fields__}) for p in self.profile
            },
            members=tuple(members),
            fixed={s.node: s.fixed for s in self.support},
            masses=tuple(JointMass(b.node, b.mass, b.inertia) for b in self.lump),
            springs=tuple(JointSpring(s.node, s.direction, s.stiffness, s.damping, s.to) for s in self.spring),
            plane=self.plane,
            parameters=common.parameters,
            damping=common.damping_model,
            base=self.base,
        )


def _divided(member: MemberTable, positions: dict[str, Point3]) -> list[Member]:
    """Parts of a member; the positions of its inner nodes are added to `positions`."""
    a, b = member.between
    for end in (a, b):
        if end not in positions:
            raise ConfigError(f"structure.member {a!r} - {b!r}: there is no node {end!r}")
    start, stop = np.array(positions[a]), np.array(positions[b])
    names = [a, *(f"{a}-{b}.{i}" for i in range(1, member.divide)), b]
    for i, name in enumerate(names[1:-1], 1):
        x, y, z = start + (stop - start) * i / member.divide
        positions[name] = (float(x), float(y), float(z))
    return [Member(names[i], names[i + 1], member.profile, member.up) for i in range(member.divide)]


class ModeTable(Table):
    """One [[structure.mode]]."""

    frequency: Quantity
    damping_ratio: Quantity
    shape: dict[str, Quantity]


class ModalTable(StructureTable):
    """[structure] of kind modal."""

    kind: Literal["modal"]
    mode: tuple[ModeTable, ...]
    flexibility: dict[str, Quantity] = Field(default_factory=dict)
    node: tuple[NodeTable, ...] = ()
    error: float = Field(default=0.0, ge=0.0, lt=1.0)

    def build(self, common: Common, folder: Path) -> Structure:
        """The modal structure."""
        if common.damping is not None:
            raise ConfigError("damping: a modal structure has its damping in structure.mode; leave [damping] out")
        return ModalStructure(
            modes=tuple(Mode(m.frequency, m.damping_ratio, m.shape) for m in self.mode),
            flexibility=self.flexibility,
            parameters=common.parameters,
            positions={n.node: n.xyz for n in self.node},
            error=self.error,
        )


class ChainModel(Common):
    """model.toml of a chain."""

    structure: ChainTable


class BeamModel(Common):
    """model.toml of a beam."""

    structure: BeamTable


class FrameModel(Common):
    """model.toml of a frame."""

    structure: FrameTable


class MatrixModel(Common):
    """model.toml of matrices in a file."""

    structure: MatrixTable


class ModalModel(Common):
    """model.toml of modes."""

    structure: ModalTable


KINDS: dict[str, type[Common]] = {
    "chain": ChainModel,
    "beam": BeamModel,
    "frame": FrameModel,
    "matrices": MatrixModel,
    "modal": ModalModel,
}
"""kind of [structure] -> the table of the whole file."""
