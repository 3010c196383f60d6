"""The concealed faults of structure: each takes a sound state and a severity and hands back the faulty one.

Severity runs from 0 (invisible) to 1 (gross) on a logarithmic scale of the fault's own relative measure,
which the sealed file holds beside the physical parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sessions.prove.truth import fe
from sessions.prove.truth.respond import Added, Extra, Law
from sessions.prove.truth.state import Fault, State

Maker = Callable[[Generator, State, float], State]
WHOLE = {"kind": "global", "id": "structure", "to": None}


def scale(low: float, high: float, severity: float) -> float:
    """Value between `low` and `high` on a logarithmic scale."""
    return float(low * (high / low) ** severity)


def ground(node: str) -> dict[str, Any]:
    """The place between a node and the ground."""
    return {"kind": "ground", "id": node, "to": None}


def joint(home: tuple[str, str]) -> dict[str, Any]:
    """The place between two nodes."""
    return {"kind": "joint", "id": home[0], "to": home[1]}


def yardstick(state: State) -> tuple[float, float, float]:
    """A quarter of the structure's mass in kg; the first elastic mode and the top of the band in rad/s."""
    low, high = band(state)
    return state.bench.total_mass() / 4, 2 * np.pi * 2 * low, 2 * np.pi * high


def band(state: State) -> tuple[float, float]:
    """Excited band in Hz: from half the first elastic mode to midway past the last mode that is meant to be seen."""
    return state.bench.band


def constant(value: float, power: int) -> Law:
    """Law value * s^power on a single row."""
    return lambda s: (value * s**power)[:, None, None]


def node_row(state: State, node: str, axis: int) -> NDArray[np.float64]:
    """Row, shape (1, size), of the motion of a nominal node along an axis."""
    row = np.zeros((1, state.mesh.size))
    row[0, state.mesh.dof(node, axis)] = 1.0
    return row


def any_node(rng: Generator, state: State) -> tuple[str, int]:
    """A node of the user's model that is free to move, and an axis that matters there."""
    bench = state.bench
    nodes = [n for n in bench.coarse.named if n not in bench.feet]
    node = nodes[int(rng.integers(len(nodes)))]
    if bench.kind == "chain":
        return node, 0
    return node, 1 if bench.kind != "frame" else across(bench.coarse, node)


def across(mesh: fe.Mesh, node: str) -> int:
    """Axis across the bars at a node; axis x at a joint of a portal, which sways."""
    number = mesh.named[node]
    steps = [np.abs(mesh.xy[b.ends[1]] - mesh.xy[b.ends[0]]) for b in mesh.bars if number in b.ends]
    return 1 if all(step[0] > step[1] for step in steps) else 0


def any_element(rng: Generator, state: State, free: bool = False) -> tuple[str, str]:
    """An element of the nominal mesh; off the supports if `free`."""
    homes = [h for h in state.bench.elements if not (free and set(h) & set(state.bench.feet))]
    return homes[int(rng.integers(len(homes)))]


def strain_row(state: State, home: tuple[str, str]) -> tuple[NDArray[np.float64], float]:
    """Row of what strains an element (stretch of a spring, rotation between its ends), and its stiffness."""
    bar = next(b for b in state.bench.coarse.bars if b.home == home)
    mesh = state.bench.coarse
    length = float(np.hypot(*(mesh.xy[bar.ends[1]] - mesh.xy[bar.ends[0]])))
    axis = 0 if state.bench.kind == "chain" else 2
    row = node_row(state, home[1], axis) - node_row(state, home[0], axis)
    return row, (bar.axial if axis == 0 else bar.bending) / length


def found(state: State, fault: Fault, **changes: Any) -> State:
    """The state with one more fault and what it changes."""
    return replace(state, faults=(*state.faults, fault), **changes)


def attach(state: State, row: NDArray, law: Law, inertial: bool = False) -> dict[str, Any]:
    """The change of a state that hangs a law on rows of motion."""
    return {"added": (*state.added, Added(row, law, inertial))}


def quantity(value: float, unit: str) -> dict[str, Any]:
    """A value with its unit, as the sealed file holds it."""
    return {"value": float(value), "unit": unit}


def added_mass(rng: Generator, state: State, severity: float) -> State:
    """A mass on a node, with its rotary inertia on a beam or frame."""
    node, _ = any_node(rng, state)
    unit, _, _ = yardstick(state)
    share = scale(0.004, 0.6, severity)
    mass = share * unit
    axes = [a for a in state.mesh.kept if a < 2]
    rows = np.vstack([node_row(state, node, a) for a in axes])
    law: Law = lambda s: mass * (s**2)[:, None, None] * np.eye(len(rows))  # noqa: E731
    place = {"kind": "node", "id": node, "to": None}
    fault = Fault("added-mass", True, place, severity, share, "mass over a quarter of the structure's")
    fault = replace(fault, parameters={"m": quantity(mass, "kg")})
    return found(state, fault, **attach(state, rows, law, True))


def ground_stiffness(rng: Generator, state: State, severity: float) -> State:
    """A spring from a node to the fixture."""
    node, axis = any_node(rng, state)
    unit, omega, _ = yardstick(state)
    share = scale(0.01, 3.0, severity)
    k = share * unit * omega**2
    fault = Fault("ground-stiffness", True, ground(node), severity, share, "stiffness over m1 w1^2 of the first mode")
    same = tuple(("joint-stiffness", place) for place in wall_joints(state, node))
    fault = replace(fault, parameters={"k": quantity(k, "N/m")}, accept=same)
    return found(state, fault, **attach(state, node_row(state, node, axis), constant(k, 0)))


def support_compliance(rng: Generator, state: State, severity: float) -> State:
    """A clamp that gives: rotation mostly, and a little sideways."""
    bench, mesh = state.bench, state.mesh
    foot = bench.feet[int(rng.integers(len(bench.feet)))]
    bar = next(b for b in bench.coarse.bars if foot in b.home)
    length = _member_length(state)
    share = scale(0.0004, 0.6, severity)
    turn, push = bar.bending / (share * length), 30 * bar.bending / (share * length**3)
    free = {mesh.dof(foot, 1 if bench.kind == "base-beam" else 0): push, mesh.dof(foot, 2): turn}
    springs = tuple((d, -1, k, 0.02) for d, k in free.items())
    place = {"kind": "support", "id": foot, "to": None}
    fault = Fault("support-compliance", True, place, severity, share, "flexibility over that of the member, EI/(k L)")
    parameters = {"k_theta": quantity(turn, "N*m/rad"), "compliance_turn": quantity(1 / turn, "rad/(N*m)")}
    fault = replace(fault, parameters={**parameters, "k_sideways": quantity(push, "N/m")})
    new = replace(mesh, held=mesh.held - set(free), springs=mesh.springs + springs)
    return found(state, fault, mesh=new)


def _member_length(state: State) -> float:
    mesh = state.bench.coarse
    return float(np.max(mesh.xy[:, 0] if state.bench.kind == "base-beam" else mesh.xy[:, 1]) / _storeys(state))


def _storeys(state: State) -> int:
    ys = state.bench.coarse.xy[:, 1]
    return len({round(float(y), 9) for y in ys if y > 0}) // 7 + 1 if state.bench.kind == "frame" else 1


def joint_stiffness(rng: Generator, state: State, severity: float) -> State:
    """A spring or element that lost (or gained) stiffness: all along it, or at a crack within."""
    home = any_element(rng, state)
    gain = rng.random() < 0.25
    crack = state.bench.kind != "chain" and not gain and rng.random() < 0.4
    inside = [i for i, b in enumerate(state.mesh.bars) if b.home == home]
    change = scale(0.02, 2.0, severity) if gain else -scale(0.02, 0.85, severity)
    chosen = [inside[int(rng.integers(1, len(inside) - 1))]] if crack else inside
    factor = 1 / (1 + len(inside) * (1 / (1 + change) - 1)) if crack else 1 + change
    bars = list(state.mesh.bars)
    for i in chosen:
        bars[i] = replace(bars[i], bending=bars[i].bending * factor, axial=bars[i].axial * factor)
    fault = Fault(
        "joint-stiffness", True, joint(home), severity, abs(change), "relative change of the element's stiffness"
    )
    if crack:
        soft = inside_length(state, chosen[0]) / state.mesh.bars[chosen[0]].bending * (1 / factor - 1)
        parameters = {"compliance_turn": quantity(soft, "rad/(N*m)")}
    else:
        parameters = {"relative_change": quantity(change, "1")}
    fault = replace(fault, sense="gain" if gain else "loss", parameters=parameters)
    fault = replace(fault, accept=at_the_wall(state, home, gain))
    return found(state, fault, mesh=replace(state.mesh, bars=tuple(bars)))


def inside_length(state: State, number: int) -> float:
    """Length of a bar of the true mesh, m."""
    a, b = state.mesh.bars[number].ends
    return float(np.hypot(*(state.mesh.xy[b] - state.mesh.xy[a])))


def at_the_wall(state: State, home: tuple[str, str], gain: bool) -> tuple[tuple[str, dict[str, Any]], ...]:
    """Names of the same thing where a chain's spring stands on a wall: a ground spring more, or a wall that gives."""
    feet = [n for n in home if n in state.bench.feet]
    if state.bench.kind != "chain" or not feet:
        return ()
    other = next(n for n in home if n not in feet)
    if gain:
        return (("ground-stiffness", ground(other)),)
    return (("support-compliance", {"kind": "support", "id": feet[0], "to": None}),)


def wall_joints(state: State, node: str) -> tuple[dict[str, Any], ...]:
    """Springs of a chain that join `node` to a wall: acting on one is acting from the node to the ground."""
    if state.bench.kind != "chain":
        return ()
    return tuple(joint(h) for h in state.bench.elements if node in h and set(h) & set(state.bench.feet))


def local_dashpot(rng: Generator, state: State, severity: float) -> State:
    """A viscous damper from a node to the fixture, or across an element."""
    unit, omega, _ = yardstick(state)
    also: tuple[dict[str, Any], ...] = ()
    if rng.random() < 0.65:
        node, axis = any_node(rng, state)
        row, place, share = node_row(state, node, axis), ground(node), scale(0.005, 1.0, severity)
        also = wall_joints(state, node)
        c, measure_of = 2 * share * unit * omega, "damping ratio that it gives a mode of m1, w1"
    else:
        home = any_element(rng, state, free=True)
        row, stiffness = strain_row(state, home)
        share = scale(0.01, 2.0, severity)
        place, c, measure_of = joint(home), share * stiffness / omega, "c w1 over the element's stiffness"
    fault = Fault("local-dashpot", True, place, severity, share, measure_of, {"c": quantity(c, "SI")}, places=also)
    return found(state, fault, **attach(state, row, constant(c, 1)))


def hysteretic_damping(rng: Generator, state: State, severity: float) -> State:
    """A loss factor of one element, now and then of the whole structure."""
    everywhere = rng.random() < 0.12
    home = any_element(rng, state)
    eta = scale(0.003, 0.06, severity) if everywhere else scale(0.03, 1.0, severity)
    bars = tuple(replace(b, loss=b.loss + eta) if everywhere or b.home == home else b for b in state.mesh.bars)
    place = WHOLE if everywhere else joint(home)
    fault = Fault("hysteretic-damping", True, place, severity, eta, "loss factor", {"eta": quantity(eta, "1")})
    return found(state, fault, mesh=replace(state.mesh, bars=bars))


def viscoelastic(rng: Generator, state: State, severity: float) -> State:
    """A Zener branch (spring behind a dashpot): the material of an element, a patch across it, or node to fixture."""
    unit, omega, top = yardstick(state)
    tau = 1 / float(np.exp(rng.uniform(np.log(1.2 * omega), np.log(0.5 * top))))
    form = rng.random()
    if form < 0.35:
        node, axis = any_node(rng, state)
        rows, place, stiffness = node_row(state, node, axis), ground(node), unit * omega**2
        share, measure_of = scale(0.02, 4.0, severity), "k1 over m1 w1^2 of the first mode"
        also = wall_joints(state, node)
    else:
        home = any_element(rng, state, free=True)
        rows, stiffness = (element_rows(state, home), 1.0) if form < 0.75 else strain_row(state, home)
        place, share, measure_of, also = joint(home), scale(0.02, 2.0, severity), "k1 over the element's stiffness", ()
    k = share * stiffness
    law: Law = lambda s: (k * s * tau / (1 + s * tau))[:, None, None] * np.eye(len(rows))  # noqa: E731
    name = "relative_k1" if 0.35 <= form < 0.75 else "k1"
    parameters = {name: quantity(k, "SI"), "tau": quantity(tau, "s")}
    fault = Fault("viscoelastic", True, place, severity, share, measure_of, parameters, places=also)
    return found(state, fault, **attach(state, rows, law))


def element_rows(state: State, home: tuple[str, str]) -> NDArray[np.float64]:
    """Rows R, shape (r, size), with R^T R the stiffness of all true bars within a nominal element."""
    inside = replace(state.mesh, bars=tuple(b for b in state.mesh.bars if b.home == home), springs=(), lumps=())
    K = fe.assemble(inside)[1]
    used = np.flatnonzero(np.abs(K).sum(axis=0) > 0)
    value, vector = np.linalg.eigh(K[np.ix_(used, used)])
    strained = value > 1e-9 * value[-1]
    rows = np.zeros((int(strained.sum()), state.mesh.size))
    rows[:, used] = (vector[:, strained] * np.sqrt(value[strained])).T
    return rows


def attached_oscillator(rng: Generator, state: State, severity: float) -> State:
    """A small mass on a spring and dashpot: tuned within the band, or above it where it is only a mass."""
    node, axis = any_node(rng, state)
    unit, omega, top = yardstick(state)
    stiff = rng.random() < 0.15
    tuned = rng.uniform(1.6, 3.0) * top if stiff else float(np.exp(rng.uniform(np.log(0.8 * omega), np.log(0.9 * top))))
    ratio = scale(0.005, 0.04, rng.random())
    share = scale(0.003, 0.25, severity)
    mass = share * unit
    c, k = 2 * ratio * tuned * mass, mass * tuned**2
    law: Law = lambda s: (mass * s**2 * (c * s + k) / (mass * s**2 + c * s + k))[:, None, None]  # noqa: E731
    place = {"kind": "node", "id": node, "to": None}
    parameters = {"m": quantity(mass, "kg"), "f": quantity(tuned / (2 * np.pi), "Hz"), "zeta": quantity(ratio, "1")}
    measure_of = "mass over a quarter of the structure's"
    accept = (("added-mass", place),) if stiff else ()
    fault = Fault("attached-oscillator", True, place, severity, share, measure_of, parameters, accept=accept)
    return found(state, fault, **attach(state, node_row(state, node, axis), law, True))


def out_of_plane_mode(rng: Generator, state: State, severity: float) -> State:
    """One more mode than the plane model has, picked up by sensors off the centre line with either sign."""
    unit, omega, top = yardstick(state)
    omega_m = float(np.exp(rng.uniform(np.log(1.1 * omega), np.log(0.85 * top))))
    ratio = state.bench.ratio * scale(0.5, 2.0, rng.random())
    share = scale(0.003, 0.5, severity)
    shape = rng.uniform(0.35, 1.0, len(state.bench.sensors)) * rng.choice([-1, 1], len(state.bench.sensors))
    size = share * (1.5 if state.bench.base is not None else 1 / unit)
    extra = Extra(size * shape, omega_m, ratio)
    parameters = {"f": quantity(omega_m / (2 * np.pi), "Hz"), "zeta": quantity(ratio, "1")}
    fault = Fault("out-of-plane-mode", True, WHOLE, severity, share, "residue over that of a plane mode", parameters)
    return found(state, fault, extras=(*state.extras, extra))


def axial_preload(rng: Generator, state: State, severity: float) -> State:
    """Tension or compression along a cantilever (a tendon, a guy), in parts of its buckling load."""
    bar, length = state.mesh.bars[0], float(np.max(state.mesh.xy[:, 0]))
    buckling = np.pi**2 * bar.bending / (4 * length**2)
    pull = rng.random() < 0.5
    share = scale(0.004, 3.0, severity) if pull else -scale(0.004, 0.6, severity)
    tension = share * buckling
    fault = Fault("axial-preload", True, WHOLE, severity, abs(share), "force over the buckling load")
    fault = replace(fault, sense="tension" if pull else "compression", parameters={"T": quantity(tension, "N")})
    return found(state, fault, mesh=replace(state.mesh, tension=tension))


def exciter_coupling(rng: Generator, state: State, severity: float) -> State:
    """A shaker whose armature sits behind the force that is recorded: its mass, suspension and damping."""
    assert state.bench.drive is not None
    node, axis = state.bench.drive
    unit, omega, _ = yardstick(state)
    share = scale(0.004, 0.6, severity)
    mass = share * unit
    own = rng.uniform(0.5, 1.5) * omega
    k, c = mass * own**2, 2 * rng.uniform(0.05, 0.3) * mass * own
    law: Law = lambda s: (mass * s**2 + c * s + k)[:, None, None]  # noqa: E731
    place = {"kind": "node", "id": node, "to": None}
    parameters = {"m": quantity(mass, "kg"), "k": quantity(k, "N/m"), "c": quantity(c, "N*s/m")}
    measure_of = "armature mass over a quarter of the structure's"
    fault = Fault("exciter-coupling", True, place, severity, share, measure_of, parameters)
    return found(state, fault, **attach(state, node_row(state, node, axis), law))


def shear_rotary(rng: Generator, state: State, severity: float) -> State:
    """A thick beam: shear flexibility and rotary inertia, which an Euler-Bernoulli model lacks."""
    bars, length = state.mesh.bars, float(np.max(state.mesh.xy[:, 0]))
    share = thickness(severity)
    height = share * length
    new = tuple(replace(b, shear=b.axial / 2.6 * 5 / 6, rotary=b.mass * height**2 / 12) for b in bars)
    fault = Fault("shear-rotary", True, WHOLE, severity, share, "thickness over length")
    waves = np.sqrt(bars[0].bending / bars[0].mass)
    time = height**2 / 12 * (1 + new[0].axial / new[0].shear) / (2 * waves)
    parameters = {"kGA": quantity(new[0].shear, "N"), "shear_time": quantity(time, "s")}
    fault = replace(fault, parameters=parameters)
    return found(state, fault, mesh=replace(state.mesh, bars=new))


def thickness(severity: float) -> float:
    """Thickness over length of a beam whose shear is missed with this severity."""
    return scale(1 / 80, 1 / 9, severity)


def drift(rng: Generator, state: State, severity: float) -> State:
    """Stiffness that creeps while the session lasts, as when a lamp warms the structure."""
    share = scale(0.0005, 0.05, severity)
    change = -2 * share if rng.random() < 0.7 else 2 * share
    fault = Fault("drift", True, WHOLE, severity, share, "relative change of frequencies over the session")
    fault = replace(fault, parameters={"dk": quantity(change, "1")})
    return found(state, fault, drift=change)


STRUCTURAL: dict[str, Maker] = {
    "added-mass": added_mass,
    "ground-stiffness": ground_stiffness,
    "support-compliance": support_compliance,
    "joint-stiffness": joint_stiffness,
    "local-dashpot": local_dashpot,
    "hysteretic-damping": hysteretic_damping,
    "viscoelastic": viscoelastic,
    "attached-oscillator": attached_oscillator,
    "out-of-plane-mode": out_of_plane_mode,
    "shear-rotary": shear_rotary,
    "axial-preload": axial_preload,
    "exciter-coupling": exciter_coupling,
}


def possible(mechanism: str, kind: str, shaken: bool) -> bool:
    """Whether a structural fault makes sense on a kind of bench."""
    where = {
        "support-compliance": kind in ("base-beam", "frame"),
        "shear-rotary": kind in ("base-beam", "free-beam"),
        "axial-preload": kind == "base-beam",
        "exciter-coupling": kind != "base-beam" and shaken,
    }
    return where.get(mechanism, True)
