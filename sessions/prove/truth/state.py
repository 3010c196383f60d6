"""What is concealed in one case: the true structure, its damping, what was added to it, and how the run is spoilt."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sessions.prove.truth import fe
from sessions.prove.truth.bench import Bench, sensor_row
from sessions.prove.truth.respond import Added, Extra, Plant, complex_modes

MOST_MODES = 400
FOAM = 0.12
"""Damping ratio of a free beam's bounce on its soft supports."""


@dataclass(frozen=True)
class ChannelFault:
    """Something wrong with one channel: kind, name of the channel, its number, and the other channel if any."""

    kind: str
    channel: str
    value: float
    other: str = ""


@dataclass(frozen=True)
class Fault:
    """One concealed fault, as the sealed file holds it.

    Parameters
    ----------
    mechanism : str
        Catalogue id, or a name of its own where it lies outside the catalogue.
    inside : bool
        Whether the catalogue holds it.
    place : dict
        kind, id, to.
    severity : float
        0 invisible to 1 gross.
    measure : float
        The severity in the fault's own relative measure.
    measure_of : str
        What that measure is.
    parameters : dict
        Name -> value, unit.
    sense : str
    places, accept : tuple
        Further places that count as the same, and further (mechanism, place) answers that no measurement
        of the band could tell from this one.
    """

    mechanism: str
    inside: bool
    place: dict[str, Any]
    severity: float
    measure: float
    measure_of: str
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    sense: str = ""
    places: tuple[dict[str, Any], ...] = ()
    accept: tuple[tuple[str, dict[str, Any]], ...] = ()


@dataclass(frozen=True, eq=False)
class LawTerm:
    """A nonlinear law on one stretch: kind and constants as `march` has them, and its row, shape (size,)."""

    kind: int
    constants: tuple[float, ...]
    row: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class State:
    """Everything true of one case before a sample is taken.

    Parameters
    ----------
    bench : Bench
    mesh : Mesh
        The true mesh, faults of stiffness and support included.
    ratios : ndarray, shape (MOST_MODES,)
        Viscous damping ratios by number of the mode.
    added : tuple of Added
        Rows over all degrees of freedom of `mesh`.
    rocking : float
        Rotation of the base, rad/s^2 per m/s^2 of its motion.
    shaken : bool
        The drive is a shaker (not a hammer).
    swept : bool
        It sweeps a sine, which dwells in each resonance.
    """

    bench: Bench
    mesh: fe.Mesh
    ratios: NDArray[np.float64]
    added: tuple[Added, ...] = ()
    extras: tuple[Extra, ...] = ()
    channels: tuple[ChannelFault, ...] = ()
    laws: tuple[LawTerm, ...] = ()
    drift: float = 0.0
    rocking: float = 0.0
    shaken: bool = True
    swept: bool = False
    moved: dict[str, str] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()

    def channel_names(self) -> tuple[str, ...]:
        """Input first, then the sensors."""
        return ("base" if self.bench.base is not None else "force", *(s.name for s in self.bench.sensors))


def sound(rng: Generator, bench: Bench, shaken: bool = True, viscous: bool = False) -> State:
    """State without fault, with a damping of its own: losses zone by zone, or scattered modal viscous damping.

    `viscous` allows the second only: time marching knows no hysteretic loss.
    """
    scatter = np.exp(0.3 * rng.standard_normal(MOST_MODES))
    if bench.kind == "free-beam":
        scatter[:2] = FOAM / bench.ratio
    free = 2 if bench.kind == "free-beam" else 0
    loss = 2 * bench.ratio * np.exp(0.3 * rng.standard_normal() + 0.12 * rng.standard_normal(4))
    if rng.random() < 0.5 and not viscous:
        bars = tuple(replace(b, loss=float(loss[b.zone])) for b in bench.truth.bars)
        return State(
            bench,
            replace(bench.truth, bars=bars),
            np.where(np.arange(MOST_MODES) < free, 1.0, 0.15) * bench.ratio * scatter,
            shaken=shaken,
        )
    return State(bench, bench.truth, bench.ratio * scatter, shaken=shaken)


def plant(state: State, stiffness: float = 1.0) -> Plant:
    """The true structure in modes, its stiffness multiplied by `stiffness` (a drift).

    Beside a law what is lost is lost viscously, mode by mode, as much at every resonance: its march knows nothing else.
    """
    bench, mesh = state.bench, state.mesh
    M, K, D = fe.assemble(mesh)
    a = mesh.active
    block = np.ix_(a, a)
    lost = stiffness * D[block]
    square, shape = complex_modes(M[block], stiffness * K[block], 0 * lost if state.laws else lost)
    omega = np.sqrt(np.maximum(np.real(square), 0))
    viscous = 2 * state.ratios[np.minimum(np.arange(a.size), MOST_MODES - 1)] * omega
    if state.laws:
        viscous = viscous + np.real(np.sum(shape * (lost @ shape), axis=0)) / np.maximum(omega, 1e-300)
    sensors = np.array([sensor_row(mesh, _where(state, s)) for s in bench.sensors])
    carried = _carried(state)
    load = -(M @ carried)[a] if bench.base is not None else _drive(state)[a]
    return Plant(
        square,
        shape,
        viscous,
        sensors[:, a],
        load,
        carried[a],
        sensors @ carried,
        np.array([s.order for s in bench.sensors]),
        tuple(Added(x.rows[:, a], x.law, x.inertial) for x in state.added),
        state.extras,
    )


def _where(state: State, sensor: Any) -> Any:
    """The sensor where it really is, which is elsewhere if it was put on the wrong node."""
    return replace(sensor, node=state.moved[sensor.name]) if sensor.name in state.moved else sensor


def _drive(state: State) -> NDArray[np.float64]:
    assert state.bench.drive is not None
    node, axis = state.bench.drive
    row = np.zeros(state.mesh.size)
    row[state.mesh.dof(state.moved.get("force", node), axis)] = 1.0
    return row


def _carried(state: State) -> NDArray[np.float64]:
    """Motion of every degree of freedom when the structure follows the base, shape (size,)."""
    out = np.zeros(state.mesh.size)
    axis = state.bench.base
    if axis is None:
        return out
    out[axis :: fe.DOFS_PER_NODE] = 1.0
    if state.rocking:
        out[1 :: fe.DOFS_PER_NODE] += state.rocking * state.mesh.xy[:, 0]
        out[2 :: fe.DOFS_PER_NODE] += state.rocking
    return out
