"""Plant: a structure with exciters, sensors' masses and force sensors, as one equation of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.simulated.inputs import Input
from labnnum.errors import ChannelError, ModelError
from labnnum.frf import MOTION_ORDER
from labnnum.nonlinear import LAWS, Element
from labnnum.recording import DIRECTIONS, Channel
from labnnum.structures.base import Matrices, Structure
from labnnum.system import System, bordered, system


@dataclass(frozen=True)
class Shaker:
    """Moving part of an electrodynamic exciter, driven by a current amplifier.

    Parameters
    ----------
    mass : float
        Of armature and table, in kg.
    frequency : float
        Of the armature on its own suspension, in Hz.
    damping_ratio : float
        Of the same; a voltage amplifier's back electromotive force is added here.
    stinger : float
        Axial stiffness of the stinger that joins it to the structure, in N/m; a base needs none.
    stinger_loss : float
        Its damping in parts of critical, with the armature alone.
    """

    mass: float = 0.2
    frequency: float = 20.0
    damping_ratio: float = 0.3
    stinger: float = 1e7
    stinger_loss: float = 0.01


@dataclass(frozen=True)
class Drive:
    """One way in: where a source acts, and through what.

    Parameters
    ----------
    channel : Channel
        Force at a place (role "reference"), or acceleration of all supports (role "base").
    gain : float
        N (or m/s^2) per unit of the source: newtons per volt of a shaker's amplifier, 1 for a hammer.
    shaker : Shaker or None
        None applies force or motion as it is asked for. With a shaker the gain is N per volt on its armature.
    """

    channel: Channel
    gain: float = 1.0
    shaker: Shaker | None = None


def plant(structure: Structure, theta: ArrayLike, inputs: Sequence[Input], drives: Sequence[Drive]) -> System:
    """Equation of motion from the sources to what each sensor takes.

    Parameters
    ----------
    structure : Structure
    theta : array_like, shape (n_parameters,)
    inputs : sequence of Input
        Motions; forces where a drive acts; the base's acceleration; a monitor of quantity "voltage" sees the first
        source itself.
    drives : sequence of Drive
        Several at different places for several shakers or the points of a roving hammer.

    Raises
    ------
    ChannelError
        If a force is measured where nothing drives.
    """
    if not drives:
        raise ChannelError("nothing excites the structure: give a drive")
    theta = np.asarray(theta, float)
    loaded = _with_sensor_masses(structure, theta, inputs)
    motion = [i for i in inputs if i.channel.quantity in MOTION_ORDER]
    out = system(loaded, theta, [i.channel for i in motion], [d.channel for d in drives])
    out = _with_cross_axes(out, loaded, theta, motion)
    forces, shaken = [], out
    for number, drive in enumerate(drives):
        shaken, force = _driven(shaken, loaded, theta, drive, number)
        forces.append(force)
    return _ordered(shaken, inputs, motion, drives, forces)


def element(structure: Structure, theta: ArrayLike, law: str, at: str, to: str = "", **parameters: float) -> Element:
    """A nonlinear element at a degree of freedom "node:direction", against ground or another one.

    Raises
    ------
    ModelError
        If there is no such place or law, or the law has other parameters.

    Examples
    --------
    >>> from labnnum.structures.chain import Chain, Link
    >>> two = Chain(masses={"1": 1.0, "2": 1.0}, links=(Link("1", "ground", 1e4), Link("1", "2", 1e4)))
    >>> element(two, [], "cubic", "2:x", "1:x", k3=1e9).column
    array([-1.,  1.])
    """
    theta = np.asarray(theta, float)
    if law not in LAWS:
        raise ModelError(f"nonlinear law {law!r} is not one of {', '.join(LAWS)}")
    names = LAWS[law]
    if set(parameters) != set(names):
        raise ModelError(f"nonlinear law {law!r} at {at} needs the parameters {', '.join(names)}")
    column = np.asarray(structure.participation(at, theta), float)
    if to and to != "ground":
        column = column - np.asarray(structure.participation(to, theta), float)
    return Element(law, column, tuple(float(parameters[n]) for n in names))


def with_chain(structure: Structure, theta: ArrayLike, inputs: Sequence[Input]) -> list[Input]:
    """Inputs with the channel faults that the structure itself holds (see `Structure.chain`)."""
    theta, probe = np.asarray(theta, float), np.array([1.0, 37.0, 1e3])
    out = []
    for i in inputs:
        clean = np.allclose(structure.chain(i.channel, probe, theta), 1.0, rtol=0, atol=1e-12)
        out.append(i if clean else replace(i, factor=lambda f, c=i.channel: structure.chain(c, f, theta)))
    return out


@dataclass(frozen=True, eq=False)
class _Loaded(Structure):
    """A structure that carries its sensors."""

    bare: Structure
    masses: tuple[tuple[NDArray, float], ...]

    @property
    def parameters(self):
        return self.bare.parameters

    @property
    def dofs(self):
        return self.bare.dofs

    @property
    def base(self):
        return self.bare.base

    def matrices(self, theta: NDArray) -> Matrices:
        """Matrices with the sensors' masses."""
        m = self.bare.matrices(theta)
        return Matrices(m.M + sum(mass * np.outer(row, row) for row, mass in self.masses), m.C, m.K, m.D)

    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """As without sensors."""
        return self.bare.participation(dof, theta)

    def rigid(self, theta: NDArray) -> NDArray:
        """As without sensors."""
        return self.bare.rigid(theta)

    def held_load(self, theta: NDArray) -> NDArray:
        """As without sensors."""
        return self.bare.held_load(theta)


def _with_sensor_masses(structure: Structure, theta: NDArray, inputs: Sequence[Input]) -> Structure:
    masses = []
    for i in inputs:
        moving = [f"{i.channel.node}:{d}" for d in DIRECTIONS[:3]] if i.mass and i.channel.role != "base" else []
        rows = [np.asarray(structure.participation(d, theta), float) for d in moving if d in structure.dofs]
        if moving and not rows:
            raise ModelError(f"channel {i.channel.name!r} has a mass but its node {i.channel.node!r} does not move")
        masses += [(row, i.mass) for row in rows]
    return _Loaded(structure, tuple(masses)) if masses else structure


def _with_cross_axes(out: System, structure: Structure, theta: NDArray, motion: Sequence[Input]) -> System:
    rows = [np.array(r) for r in (out.displacement, out.velocity, out.acceleration)]
    for number, i in enumerate(motion):
        for direction, fraction in i.cross.items():
            across = np.asarray(structure.participation(f"{i.channel.node}:{direction}", theta), float)
            target = rows[MOTION_ORDER[i.channel.quantity]][number]
            target[: across.size] += fraction * across
    return replace(out, displacement=rows[0], velocity=rows[1], acceleration=rows[2])


@dataclass(frozen=True, eq=False)
class _Force:
    """Rows of the force that one drive really puts in, as far as its coordinates reach."""

    displacement: NDArray
    velocity: NDArray
    feed: float


def _driven(out: System, structure: Structure, theta: NDArray, drive: Drive, number: int) -> tuple[System, _Force]:
    gain = drive.gain
    if drive.shaker is None:
        load, feed = np.array(out.load), np.array(out.feed)
        load[:, number] *= gain
        feed[:, number] *= gain
        none = np.zeros(len(out.M))
        return replace(out, load=load, feed=feed), _Force(none, none, gain)
    if drive.channel.role == "base":
        return _on_table(out, structure, theta, drive.shaker, gain)
    row = np.zeros(len(out.M))
    own = drive.channel.sign * np.asarray(structure.participation(drive.channel.dof, theta), float)
    row[: own.size] = own
    return _on_stinger(out, row, drive.shaker, gain, number)


def _armature(shaker: Shaker) -> tuple[float, float]:
    """Damping and stiffness of the armature's suspension."""
    omega = 2 * np.pi * shaker.frequency
    return 2 * shaker.damping_ratio * omega * shaker.mass, shaker.mass * omega**2


def _wider(rows: NDArray, column: NDArray | float = 0.0) -> NDArray[np.float64]:
    return np.hstack([rows, np.broadcast_to(np.asarray(column, float), (len(rows),))[:, None]])


def _on_stinger(out: System, row: NDArray, shaker: Shaker, gain: float, number: int) -> tuple[System, _Force]:
    """Armature as one more coordinate, joined to the drive point by the stinger."""
    c, k = _armature(shaker)
    loss = 2 * shaker.stinger_loss * np.sqrt(shaker.stinger * shaker.mass)
    stretch = np.append(-row, 1.0)
    tie = np.outer(stretch, stretch)
    load = np.vstack([out.load, np.zeros(out.n_inputs)])
    load[:, number] = np.append(np.zeros(len(row)), gain)
    return System(
        bordered(out.M, shaker.mass), bordered(out.C, c) + loss * tie, bordered(out.K, k) + shaker.stinger * tie, load,
        _wider(out.displacement), _wider(out.velocity), _wider(out.acceleration), out.feed,
    ), _Force(shaker.stinger * stretch, loss * stretch, 0.0)  # fmt: skip


def _on_table(out: System, structure: Structure, theta: NDArray, shaker: Shaker, gain: float) -> tuple[System, _Force]:
    """The base's displacement as one more coordinate: the table that the structure's reaction pulls at.

    What supports hold of the structure's mass moves with the table and counts as its own.
    """
    if (out.displacement.any() or out.velocity.any()) or len(out.M) != len(structure.matrices(theta).M):
        raise ModelError("on a shaker table only accelerations can be simulated; measure accelerations")
    c, k = _armature(shaker)
    rigid = np.asarray(structure.rigid(theta), float)
    pushed = np.asarray(structure.base_load(theta), float)
    M = bordered(out.M, shaker.mass + float(rigid @ (2 * pushed - out.M @ rigid)))
    M[-1, :-1] = M[:-1, -1] = pushed
    load = np.zeros((len(M), 1))
    load[-1, 0] = gain
    zero = np.zeros(len(M))
    return System(
        M, bordered(out.C, c), bordered(out.K, k), load,
        _wider(out.displacement), _wider(out.velocity), _wider(out.acceleration, out.feed[:, 0]),
        np.zeros_like(out.feed),
    ), _Force(zero, zero, 0.0)  # fmt: skip


def _ordered(
    out: System, inputs: Sequence[Input], motion: Sequence[Input], drives: Sequence[Drive], forces: Sequence[_Force]
) -> System:
    """Rows of `out` and of the forces, in the order of the inputs."""
    n, shape = len(out.M), out.n_inputs
    places = {id(i): number for number, i in enumerate(motion)}
    rows = []
    for i in inputs:
        if id(i) in places:
            k = places[id(i)]
            rows.append((out.displacement[k], out.velocity[k], out.acceleration[k], out.feed[k]))
        elif i.channel.quantity == "voltage":
            rows.append((np.zeros(n), np.zeros(n), np.zeros(n), np.eye(shape)[0]))
        else:
            rows.append(_force_rows(i.channel, drives, forces, n))
    pu, pv, pa, feed = (np.array([r[j] for r in rows]) for j in range(4))
    return System(out.M, out.C, out.K, out.load, pu, pv, pa, feed)


def _force_rows(channel: Channel, drives: Sequence[Drive], forces: Sequence[_Force], n: int) -> tuple[NDArray, ...]:
    """A force sensor sits at the drive of its own place; one without a place moves with a roving hammer."""
    pu, pv, feed = np.zeros(n), np.zeros(n), np.zeros(len(drives))
    found = False
    for number, (drive, force) in enumerate(zip(drives, forces, strict=True)):
        if channel.quantity not in ("force", "moment") or drive.channel.role == "base":
            continue
        if channel.dof not in ("", drive.channel.dof):
            continue
        sign = channel.sign * drive.channel.sign if channel.dof else 1.0
        pu[: force.displacement.size] += sign * force.displacement
        pv[: force.velocity.size] += sign * force.velocity
        feed[number] = sign * force.feed
        found = True
    if not found:
        places = ", ".join(d.channel.dof or d.channel.name for d in drives)
        raise ChannelError(
            f"channel {channel.name!r} measures {channel.quantity} where nothing drives; drives are at {places}"
        )
    return pu, pv, np.zeros(n), feed
