"""The dissertation's own structures with the effects that its models left out, as concealed truths.

The cantilevered beam on a shaker is that of Atalla (1996), section 5.6: its dimensions, its accelerometer, its base
excitation. The flexible frame of section 5.7 is given by a figure only; here stands a plane frame of its tubes and
joints with the same number of active degrees of freedom, 96, which is comparable and not the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.random import Generator, default_rng

from sessions.prove.truth import fe
from sessions.prove.truth.bench import Bench, Sensor
from sessions.prove.truth.physics import WHOLE, attach, constant, found, joint, node_row, quantity
from sessions.prove.truth.respond import Extra
from sessions.prove.truth.state import Fault, State, sound

INCH, PSI, POUND = 0.0254, 6894.757, 0.45359237
STATIONS = (0.0, 2.0, 4.0, 5.5, 7.0, 8.5, 10.0)
"""Nodes of the beam in inches: the figure is lost; these put all four modes inside the bands that the text gives."""
ACCELEROMETER = (10.44e-3, 1.5e-6)
"""Mass in kg and rotary inertia in kg m^2 of the beam's accelerometer (section 5.6)."""
CLAIMED = 12.80e-3
"""Mass in kg that the dissertation's network first gave it, before some of its inputs were weighted down."""
JOINT, PIN = 9.7e-3, 3.2e-3
TUBE = (69e9, 2710.0, 3.2e-3, 2.54e-3)
SPAN = 0.27
STOREYS, PARTS = 4, 3


def beam(rng: Generator, sensors: tuple[str, ...] = ("3",)) -> Bench:
    """The cantilevered beam: six elements, base excitation, accelerometers at the given nodes."""
    length, width, thick = 10 * INCH, 1.5 * INCH, 0.0625 * INCH
    modulus, density = 1e7 * PSI, 0.1 * POUND / INCH**3
    bar = fe.Bar((0, 1), ("1", "2"), modulus * width * thick, modulus * width * thick**3 / 12, density * width * thick)
    names = [str(i + 1) for i in range(7)]
    coarse = replace(fe.line_mesh(INCH * np.array(STATIONS), names, bar, (1, 2)), held=frozenset((1, 2)))
    mass, inertia = ACCELEROMETER
    lumps = ((coarse.dof("3", 1), mass), (coarse.dof("3", 2), inertia))
    lumps += tuple((coarse.dof(n, 1), 0.5e-3) for n in sensors if n != "3")
    coarse = replace(coarse, lumps=lumps)
    again = partial(_realise, coarse=coarse, theta={"E": _near(rng)}, zones={"E": 0}, parts=5)
    truth = again(rng)
    picked = tuple(Sensor(f"a{n}", n, 1, offset=0.001 * length * abs(rng.standard_normal())) for n in sensors)
    theta = {"E": truth.bars[0].bending / bar.bending}
    return Bench("base-beam", truth, coarse, {"E": 0}, theta, picked, None, 1, ("1",), "z", 4, 0.007, again)


def frame(rng: Generator) -> Bench:
    """A plane frame of four storeys from the tubes and joints of section 5.7, hit at one of them."""
    points = [(x, SPAN * level) for level in range(STOREYS + 1) for x in (0.0, SPAN)]
    members = [(2 * i + side, 2 * i + 2 + side, 0) for i in range(STOREYS) for side in (0, 1)]
    members += [(2 * i, 2 * i + 1, 1) for i in range(1, STOREYS + 1)]
    modulus, density, outer, inner = TUBE
    area, second = np.pi * (outer**2 - inner**2), np.pi / 4 * (outer**4 - inner**4)
    bar = fe.Bar((0, 1), ("", ""), modulus * area, modulus * second, density * area)
    bars = tuple(replace(bar, ends=(a, b), zone=zone) for a, b, zone in members)
    mesh = fe.refine(fe.Mesh(np.array(points), bars, {}, (0, 1, 2)), PARTS)
    names = [str(i + 1) for i in range(len(mesh.xy))]
    bars = tuple(replace(b, home=(names[b.ends[0]], names[b.ends[1]])) for b in mesh.bars)
    lumps = tuple((fe.DOFS_PER_NODE * i + a, JOINT + PIN) for i in range(2, len(points)) for a in (0, 1))
    held = frozenset(range(2 * fe.DOFS_PER_NODE))
    named = {name: i for i, name in enumerate(names)}
    coarse = replace(mesh, bars=bars, named=named, held=held, lumps=lumps)
    zones = {"E_columns": 0, "E_beams": 1}
    theta = {name: _near(rng) for name in zones}
    again = partial(_realise, coarse=coarse, theta=theta, zones=zones, parts=3)
    truth = again(rng)
    where = (("4", 0), ("6", 0), ("8", 0), ("9", 0), ("10", 0))
    sensors = tuple(Sensor(f"a{n}", n, axis) for n, axis in where)
    return Bench("frame", truth, coarse, zones, theta, sensors, ("6", 0), None, ("1", "2"), "z", 5, 0.008, again)


def _near(rng: Generator) -> float:
    return float(1 + 0.02 * rng.standard_normal())


def _realise(rng: Generator, coarse: fe.Mesh, theta: dict[str, float], zones: dict[str, int], parts: int) -> fe.Mesh:
    """Finer, each bar a little its own; lumps are weighed."""
    number = {zone: theta[name] for name, zone in zones.items()}
    bars = []
    for bar in coarse.bars:
        stiff, heavy = number[bar.zone] * (1 + 0.003 * rng.standard_normal()), 1 + 0.003 * rng.standard_normal()
        bars.append(replace(bar, axial=bar.axial * stiff, bending=bar.bending * stiff, mass=bar.mass * heavy))
    return fe.refine(replace(coarse, bars=tuple(bars)), parts)


def _nothing(state: State) -> State:
    """No effect."""
    return state


def cable(state: State) -> State:
    """The accelerometer's cable pulls sideways and excites the first torsion mode, near 160 Hz."""
    residue = np.array([0.12 * (-1) ** i for i in range(len(state.bench.sensors))])
    fault = Fault("out-of-plane-mode", True, WHOLE, 1.0, 0.12, "residue at the sensor")
    fault = replace(fault, parameters={"f": quantity(160.0, "Hz"), "zeta": quantity(0.006, "1")})
    return found(state, fault, extras=(Extra(residue, 2 * np.pi * 160.0, 0.006),))


def accelerometer(state: State) -> State:
    """The accelerometer is heavier than the model holds it to be: 12.80 g instead of 10.44 g."""
    missing = CLAIMED - ACCELEROMETER[0]
    place = {"kind": "node", "id": "3", "to": None}
    fault = Fault("added-mass", True, place, 1.0, missing, "kg", {"m": quantity(missing, "kg")})
    return found(state, fault, **attach(state, node_row(state, "3", 1), constant(missing, 2), True))


def clamp(state: State) -> State:
    """The clamp turns: the plate on the armature is no rigid wall."""
    bar, mesh = state.bench.coarse.bars[0], state.mesh
    turn = bar.bending / (0.02 * float(np.max(mesh.xy[:, 0])))
    dof = mesh.dof("1", 2)
    place = {"kind": "support", "id": "1", "to": None}
    fault = Fault("support-compliance", True, place, 1.0, 0.02, "flexibility over that of the beam, EI/(k L)")
    parameters = {"k_theta": quantity(turn, "N*m/rad"), "compliance_turn": quantity(1 / turn, "rad/(N*m)")}
    fault = replace(fault, parameters=parameters)
    new = replace(mesh, held=mesh.held - {dof}, springs=((dof, -1, turn, 0.02),))
    return found(state, fault, mesh=new)


def heavy_joint(state: State) -> State:
    """One joint carries a fitting: mass, and the rotary inertia that a point mass does not have."""
    mass, radius = 20e-3, 0.03
    rows = np.vstack([node_row(state, "7", a) for a in (0, 1, 2)])
    size = np.diag([mass, mass, mass * radius**2])
    place = {"kind": "node", "id": "7", "to": None}
    fault = Fault("added-mass", True, place, 1.0, mass, "kg", {"m": quantity(mass, "kg")})
    return found(state, fault, **attach(state, rows, lambda s: (s**2)[:, None, None] * size, True))


def all_joints_turn(state: State) -> State:
    """Every joint has rotary inertia, which the dissertation's model neglects: many places at once."""
    inertia = 2e-6
    for i in range(2, 2 + 2 * STOREYS):
        state = replace(state, **attach(state, node_row(state, str(i + 1), 2), constant(inertia, 2), True))
    fault = Fault("rotary-inertia-everywhere", False, WHOLE, 1.0, inertia, "kg m^2 a joint")
    return found(state, fault)


def _hinge(state: State, home: tuple[str, str], share: float) -> State:
    """The end of a member turns against its joint: a hinge in the first true bar beside it."""
    inside = [i for i, b in enumerate(state.mesh.bars) if b.home == home]
    bars = list(state.mesh.bars)
    near = inside[0]
    bars[near] = replace(bars[near], bending=bars[near].bending * share)
    return replace(state, mesh=replace(state.mesh, bars=tuple(bars)))


def loose_joint(state: State) -> State:
    """One bolted joint gives: the end of a beam turns against it."""
    home = _beam_end(state, 1)
    share = 0.25
    fault = Fault("joint-stiffness", True, joint(home), 1.0, 1 - share, "part of the bar's stiffness that is lost")
    return found(_hinge(state, home, share), replace(fault, sense="loss"))


def all_joints_give(state: State) -> State:
    """Every beam turns a little against both joints: many places at once."""
    for level in range(STOREYS):
        state = _hinge(state, _beam_end(state, level), 0.5)
    fault = Fault("joint-flexibility-everywhere", False, WHOLE, 1.0, 0.5, "part of each end's stiffness that is lost")
    return found(state, fault)


def _beam_end(state: State, level: int) -> tuple[str, str]:
    """The element of a storey's beam beside its left joint."""
    left = str(2 * level + 3)
    return next(b.home for b in state.bench.coarse.bars if b.home[0] == left and b.zone == 1)


@dataclass(frozen=True)
class Effect:
    """One concealed effect: its name, where it acts, the sensors, what does it, and the seed of the ordinary errors."""

    name: str
    structure: str
    sensors: tuple[str, ...]
    make: Callable[[State], State]
    seed: int

    def state(self) -> State:
        """The truth."""
        rng = default_rng([5, self.seed])
        bench = beam(rng, self.sensors) if self.structure == "beam" else frame(rng)
        return self.make(sound(rng, bench, self.structure == "beam", viscous=True))


AS_THERE, MORE = ("3",), ("3", "5", "7")
EFFECTS = (
    Effect("beam-sound", "beam", AS_THERE, _nothing, 1),
    Effect("beam-cable", "beam", AS_THERE, cable, 2),
    Effect("beam-accelerometer", "beam", AS_THERE, accelerometer, 3),
    Effect("beam-clamp", "beam", AS_THERE, clamp, 4),
    Effect("beam-sound-three-sensors", "beam", MORE, _nothing, 5),
    Effect("beam-cable-three-sensors", "beam", MORE, cable, 6),
    Effect("beam-accelerometer-three-sensors", "beam", MORE, accelerometer, 7),
    Effect("beam-clamp-three-sensors", "beam", MORE, clamp, 8),
    Effect("frame-sound", "frame", (), _nothing, 9),
    Effect("frame-heavy-joint", "frame", (), heavy_joint, 10),
    Effect("frame-all-joints-turn", "frame", (), all_joints_turn, 11),
    Effect("frame-loose-joint", "frame", (), loose_joint, 12),
    Effect("frame-all-joints-give", "frame", (), all_joints_give, 13),
)
"""What is concealed, one after the other; the beam once with the dissertation's one accelerometer, once with three."""
