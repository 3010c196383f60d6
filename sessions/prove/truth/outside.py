"""Faults that no entry of the catalogue describes: a tool should say that something is missing here, and no name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from sessions.prove.truth.channels import channel_place
from sessions.prove.truth.physics import (
    Maker,
    any_element,
    any_node,
    attach,
    band,
    constant,
    found,
    ground,
    joint,
    node_row,
    quantity,
    scale,
    strain_row,
    yardstick,
)
from sessions.prove.truth.respond import Law
from sessions.prove.truth.state import ChannelFault, Fault, State


def fractional(rng: Generator, state: State, severity: float) -> State:
    """A rubber whose force is a fractional derivative of its stretch, from a node to the fixture."""
    node, axis = any_node(rng, state)
    unit, omega, _ = yardstick(state)
    order = rng.uniform(0.4, 0.6)
    share = scale(0.02, 3.0, severity)
    size = share * unit * omega**2 / omega**order
    law: Law = lambda s: (size * s**order)[:, None, None]  # noqa: E731
    fault = Fault("fractional-damping", False, ground(node), severity, share, "|force| over m1 w1^2 at the first mode")
    return found(
        state,
        replace(fault, parameters={"order": quantity(order, "1")}),
        **attach(state, node_row(state, node, axis), law),
    )


def inerter(rng: Generator, state: State, severity: float) -> State:
    """A flywheel between two nodes: force by their relative acceleration."""
    home = any_element(rng, state, free=True)
    unit, _, top = yardstick(state)
    row, stiffness = strain_row(state, home)
    share = scale(0.002, 3.0, severity)
    b = share * (unit if state.bench.kind == "chain" else stiffness / top**2 * 20)
    fault = Fault("inerter", False, joint(home), severity, share, "relative size", {"b": quantity(b, "SI")})
    return found(state, fault, **attach(state, row, constant(b, 2)))


def gyroscopic(rng: Generator, state: State, severity: float) -> State:
    """A spinning part that couples two neighbouring nodes by their speeds, without loss and without reciprocity."""
    home = any_element(rng, state, free=True)
    unit, omega, _ = yardstick(state)
    axis = {"chain": 0, "frame": 2}.get(state.bench.kind, 1)
    rows = np.vstack([node_row(state, n, axis) for n in home])
    share = scale(0.02, 3.0, severity)
    g = share * unit * omega
    if axis == 2:
        g *= 0.02 * float(np.max(state.mesh.xy)) ** 2
    skew = np.array([[0.0, g], [-g, 0.0]])
    law: Law = lambda s: s[:, None, None] * skew  # noqa: E731
    fault = Fault("gyroscopic-coupling", False, joint(home), severity, share, "g over m1 w1", {"g": quantity(g, "SI")})
    near = tuple({"kind": "node", "id": n, "to": None} for n in home)
    return found(state, replace(fault, places=near), **attach(state, rows, law))


def lever(rng: Generator, state: State, severity: float) -> State:
    """A spring through a lever: strained by the sum of two motions, not by their difference."""
    home = any_element(rng, state, free=True)
    unit, omega, _ = yardstick(state)
    axis = {"chain": 0, "frame": 2}.get(state.bench.kind, 1)
    row = node_row(state, home[0], axis) + node_row(state, home[1], axis)
    share = scale(0.005, 2.0, severity)
    k = share * unit * omega**2
    if axis == 2:
        k *= 0.02 * float(np.max(state.mesh.xy)) ** 2
    fault = Fault(
        "lever-spring", False, joint(home), severity, share, "stiffness over m1 w1^2", {"k": quantity(k, "SI")}
    )
    near = tuple({"kind": "node", "id": n, "to": None} for n in home)
    return found(state, replace(fault, places=near), **attach(state, row, constant(k, 0)))


def rocking(rng: Generator, state: State, severity: float) -> State:
    """A shaker table that rocks while it moves."""
    share = scale(0.02, 1.5, severity)
    value = share / float(np.max(state.mesh.xy[:, 0])) * (1 if rng.random() < 0.5 else -1)
    place = {"kind": "support", "id": state.bench.feet[0], "to": None}
    fault = Fault("rocking-base", False, place, severity, share, "tip motion by rocking over that of the base")
    return found(state, replace(fault, parameters={"kappa": quantity(value, "rad/m")}), rocking=value)


def _spoilt(state: State, fault: Fault, spoilt: ChannelFault) -> State:
    return replace(state, faults=(*state.faults, fault), channels=(*state.channels, spoilt))


def sensor_resonance(rng: Generator, state: State, severity: float) -> State:
    """A sensor on a soft mount whose resonance reaches into the band."""
    sensor = state.bench.sensors[int(rng.integers(len(state.bench.sensors)))].name
    ratio = scale(5.0, 0.7, severity)
    tuned = ratio * band(state)[1]
    fault = Fault("sensor-resonance", False, channel_place(sensor), severity, 1 / ratio, "band top over the resonance")
    fault = replace(fault, parameters={"f": quantity(tuned, "Hz")})
    return _spoilt(state, fault, ChannelFault("resonance", sensor, tuned))


def crosstalk(rng: Generator, state: State, severity: float) -> State:
    """One channel picks up part of another."""
    sensors = state.bench.sensors
    one, other = (sensors[i] for i in rng.permutation(len(sensors))[:2])
    share = scale(0.01, 0.8, severity)
    low, high = band(state)
    volts = share * float(2 * np.pi * np.sqrt(low * high)) ** (one.order - other.order)
    fault = Fault("crosstalk", False, channel_place(one.name), severity, share, "part of the other channel")
    fault = replace(fault, sense=other.name)
    return _spoilt(state, fault, ChannelFault("crosstalk", one.name, volts, other.name))


def misplaced(rng: Generator, state: State, severity: float) -> State:
    """A sensor that sits on another node than the notebook says."""
    taken = {s.node for s in state.bench.sensors} | set(state.bench.feet)
    moves = [
        (sensor, to)
        for sensor in state.bench.sensors
        for home in state.bench.elements
        if sensor.node in home
        for to in home
        if to not in taken
    ]
    if not moves:
        return crosstalk(rng, state, severity)
    sensor, to = moves[int(rng.integers(len(moves)))]
    fault = Fault("misplaced-sensor", False, channel_place(sensor.name), severity, 1.0, "one element away", sense=to)
    return replace(state, faults=(*state.faults, fault), moved={**state.moved, sensor.name: to})


OUTSIDE: dict[str, Maker] = {
    "fractional-damping": fractional,
    "inerter": inerter,
    "gyroscopic-coupling": gyroscopic,
    "lever-spring": lever,
    "rocking-base": rocking,
    "sensor-resonance": sensor_resonance,
    "crosstalk": crosstalk,
    "misplaced-sensor": misplaced,
}


def outside_possible(mechanism: str, kind: str) -> bool:
    """Whether a fault outside the catalogue makes sense on a kind of bench."""
    return kind == "base-beam" if mechanism == "rocking-base" else True
