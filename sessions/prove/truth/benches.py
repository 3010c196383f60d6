"""The structures that a concealed case may stand on, drawn at random: chains, beams on a shaker, free beams, frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.random import Generator

from sessions.prove.truth import fe
from sessions.prove.truth.bench import ALUMINIUM, STEEL, Bench, Sensor, first_modes


def _realise(rng: Generator, coarse: fe.Mesh, theta: dict[str, float], zones: dict[str, int], parts: int) -> fe.Mesh:
    """The structure as it really is: finer, stiffness by zone, mass about 2 % off, each bar a little its own."""
    number = {zone: theta[name] for name, zone in zones.items()}
    density = 1 + 0.015 * rng.standard_normal()
    bars = []
    for bar in coarse.bars:
        stiff = number[bar.zone] * (1 + 0.003 * rng.standard_normal())
        heavy = density * (1 + 0.003 * rng.standard_normal())
        bars.append(
            replace(
                bar,
                axial=bar.axial * stiff,
                bending=bar.bending * stiff,
                shear=bar.shear * stiff,
                mass=bar.mass * heavy,
                rotary=bar.rotary * heavy,
            )
        )
    lumps: list[tuple[int, float]] = []
    for dof, mass in coarse.lumps:
        node = dof // fe.DOFS_PER_NODE
        if lumps and lumps[-1][0] // fe.DOFS_PER_NODE == node:
            lumps.append((dof, lumps[-1][1]))
        else:
            lumps.append((dof, mass * density * (1 + 0.005 * rng.standard_normal())))
    return fe.refine(replace(coarse, bars=tuple(bars), lumps=tuple(lumps)), parts)


def _theta(rng: Generator, names: tuple[str, ...]) -> dict[str, float]:
    return {name: float(1 + np.clip(0.035 * rng.standard_normal(), -0.1, 0.1)) for name in names}


def _pick(rng: Generator, spots: list[tuple[str, int]], count: int, first: tuple[str, int] | None) -> list:
    """`count` places of `spots`, in their order, with `first` among them if given."""
    others = [s for s in spots if s != first]
    chosen = [others[i] for i in rng.permutation(len(others))[: count - (first is not None)]]
    chosen += [first] if first is not None else []
    return sorted(chosen, key=spots.index)


def _sensors(rng: Generator, spots: list[tuple[str, int]], slack: float) -> tuple[Sensor, ...]:
    out = []
    for i, (node, axis) in enumerate(spots):
        sign = -1 if rng.random() < 0.12 else 1
        order = 2 if rng.random() < 0.9 else 1
        out.append(Sensor(f"a{i + 1}", node, axis, sign, order, slack * float(np.abs(rng.standard_normal()) + 0.1)))
    return tuple(out)


def chain(rng: Generator, n_sensors: int | None = None) -> Bench:
    """Five to eight masses in a row between springs, one wall or two; a force at one of them."""
    n = int(rng.integers(5, 9))
    walls = 1 + int(rng.random() < 0.4)
    base = float(np.exp(rng.uniform(np.log(0.4), np.log(2.5))))
    mass = base * rng.uniform(0.7, 1.4, n)
    pitch = 0.1
    first = rng.uniform(6.0, 14.0)
    stiff = (2 * np.pi * first) ** 2 * base * (2 * n / np.pi) ** 2 / walls**2
    names = [str(i) for i in range(n + walls)]
    bar = fe.Bar((0, 1), ("0", "1"), 1.0, 0.0, 0.0)
    coarse = fe.line_mesh(pitch * np.arange(len(names)), names, bar, (0,))
    cut = int(rng.integers(2, len(coarse.bars) - 1))
    zones = {"k_left": 0, "k_right": 1}
    bars = tuple(
        replace(b, axial=stiff * pitch * rng.uniform(0.75, 1.35), zone=int(i >= cut)) for i, b in enumerate(coarse.bars)
    )
    feet = ("0",) if walls == 1 else ("0", names[-1])
    held = frozenset(fe.DOFS_PER_NODE * names.index(f) for f in feet)
    lumps = tuple((fe.DOFS_PER_NODE * (i + 1), float(m)) for i, m in enumerate(mass))
    coarse = replace(coarse, bars=bars, lumps=lumps, held=held)
    theta = _theta(rng, tuple(zones))
    springy = 0.006 * base / pitch
    whole = replace(coarse, bars=tuple(replace(b, mass=springy) for b in bars))
    whole = replace(whole, lumps=_without_bars(lumps, springy * pitch))
    again = partial(_realise, coarse=whole, theta=theta, zones=zones, parts=3)
    truth = again(rng)
    spots = [(str(i), 0) for i in range(1, n + 1)]
    drive = spots[int(rng.integers(n))]
    count = min(n_sensors or int(rng.integers(2, n + 1)), n)
    picked = _pick(rng, spots, count, drive if rng.random() < 0.7 else None)
    sensors = _sensors(rng, picked, 0.0)
    ratio = _ratio(rng)
    return Bench("chain", truth, coarse, zones, theta, sensors, drive, None, feet, "y", n, ratio, again)


def _without_bars(lumps: tuple[tuple[int, float], ...], bar_mass: float) -> tuple[tuple[int, float], ...]:
    return tuple((dof, mass - bar_mass) for dof, mass in lumps)


def _ratio(rng: Generator) -> float:
    return float(np.exp(rng.uniform(np.log(0.004), np.log(0.018))))


def base_beam(rng: Generator, n_sensors: int | None = None, thick: float | None = None) -> Bench:
    """A cantilever whose clamp is shaken across it, with accelerometers along it and one on the clamp."""
    coarse, zones, names = _beam(rng, int(rng.integers(8, 12)), rng.uniform(9, 20), 3.516, thick)
    coarse = replace(coarse, held=frozenset((1, 2)))
    theta = _theta(rng, tuple(zones))
    coarse, spots = _beam_sensors(rng, coarse, names[1:], n_sensors)
    again = partial(_realise, coarse=coarse, theta=theta, zones=zones, parts=4 if thick is None else 7)
    truth = again(rng)
    sensors = _sensors(rng, spots, 0.001 * float(coarse.xy[-1, 0]))
    swing = "z" if rng.random() < 0.5 else "y"
    n_modes = int(rng.integers(3, 5))
    ratio = _ratio(rng)
    return Bench("base-beam", truth, coarse, zones, theta, sensors, None, 1, ("1",), swing, n_modes, ratio, again)


def free_beam(rng: Generator, n_sensors: int | None = None, thick: float | None = None) -> Bench:
    """A beam on soft cords, driven by a force at one point; the user's model of it floats freely."""
    coarse, zones, names = _beam(rng, int(rng.integers(10, 14)), rng.uniform(22, 45), 22.37, thick)
    theta = _theta(rng, tuple(zones))
    coarse, spots = _beam_sensors(rng, coarse, names, n_sensors)
    end = (names[0], 1) if rng.random() < 0.5 else spots[int(rng.integers(len(spots)))]
    again = partial(_hung, coarse=coarse, theta=theta, zones=zones, parts=4 if thick is None else 7)
    truth = again(rng)
    sensors = _sensors(rng, spots, 0.001 * float(coarse.xy[-1, 0]))
    swing = "z" if rng.random() < 0.5 else "y"
    n_modes = 2 + int(rng.integers(3, 5))
    ratio = _ratio(rng)
    return Bench("free-beam", truth, coarse, zones, theta, sensors, end, None, (), swing, n_modes, ratio, again)


def _hung(rng: Generator, coarse: fe.Mesh, theta: dict[str, float], zones: dict[str, int], parts: int) -> fe.Mesh:
    """A beam as it really is, on its cords."""
    real = _realise(rng, coarse, theta, zones, parts)
    return replace(real, springs=_cords(rng, real, list(coarse.named), first_modes(real, 3)[2]))


def _cords(rng: Generator, mesh: fe.Mesh, names: list[str], elastic: float) -> tuple:
    """Two soft cords whose bounce lies far below the first bending mode at `elastic` Hz."""
    span = float(mesh.xy[mesh.named[names[-1]], 0])
    mass = sum(b.mass for b in mesh.bars) / len(mesh.bars) * span + sum(m for _, m in mesh.lumps)
    bounce = 2 * np.pi * elastic / rng.uniform(18, 30)
    near = max(1, round(0.22 * (len(names) - 1)))
    where = (names[near], names[-1 - near])
    return tuple((mesh.dof(name, 1), -1, 0.5 * mass * bounce**2, 0.05) for name in where)


def _beam(rng: Generator, n: int, first: float, constant: float, thick: float | None) -> tuple:
    """Nominal Euler-Bernoulli beam of n elements whose lowest bending mode lies at `first` Hz; two zones or one.

    The length follows from the thickness; `thick` is thickness over length where shear matters.
    """
    modulus, density, _ = STEEL if rng.random() < 0.5 else ALUMINIUM
    width = rng.uniform(0.02, 0.05)
    height = rng.uniform(0.003, 0.006)
    speed = np.sqrt(modulus / density / 12) * height
    length = float(np.sqrt(constant * speed / (2 * np.pi * first)))
    if thick is not None:
        height = thick * length
    area, inertia = width * height, width * height**3 / 12
    bar = fe.Bar((0, 1), ("1", "2"), modulus * area, modulus * inertia, density * area)
    names = [str(i + 1) for i in range(n + 1)]
    mesh = fe.line_mesh(np.linspace(0, length, n + 1), names, bar, (1, 2))
    if rng.random() < 0.5:
        return mesh, {"E": 0}, names
    cut = int(rng.integers(2, n - 1))
    bars = tuple(replace(b, zone=int(i >= cut)) for i, b in enumerate(mesh.bars))
    return replace(mesh, bars=bars), {"E_inner": 0, "E_outer": 1}, names


def _beam_sensors(rng: Generator, mesh: fe.Mesh, names: list[str], n_sensors: int | None) -> tuple:
    """The mesh with the accelerometers' masses on it, and where they sit."""
    spots = [(name, 1) for name in names]
    count = min(n_sensors or int(rng.integers(2, 8)), len(spots))
    picked = _pick(rng, spots, count, spots[-1] if rng.random() < 0.6 else None)
    total = sum(b.mass for b in mesh.bars) * float(mesh.xy[-1, 0]) / len(mesh.bars)
    each = total * rng.uniform(0.002, 0.015)
    return replace(mesh, lumps=tuple((mesh.dof(name, 1), each) for name, _ in picked)), picked


def frame(rng: Generator, n_sensors: int | None = None) -> Bench:
    """A plane portal of one or two storeys with clamped feet, three or four nominal elements a member."""
    modulus, density, _ = STEEL if rng.random() < 0.6 else ALUMINIUM
    storeys = 1 + int(rng.random() < 0.6)
    span, height = rng.uniform(0.35, 0.6), rng.uniform(0.25, 0.45)
    width, thick = rng.uniform(0.025, 0.05), rng.uniform(0.004, 0.007)
    area, inertia = width * thick, width * thick**3 / 12
    points, members = _portal(storeys, span, height)
    bar = fe.Bar((0, 1), ("", ""), modulus * area, modulus * inertia, density * area)
    mesh = fe.refine(_members(points, members, bar), 4 - int(storeys > 1))
    names = [str(i + 1) for i in range(len(mesh.xy))]
    bars = tuple(replace(b, home=(names[b.ends[0]], names[b.ends[1]])) for b in mesh.bars)
    coarse = replace(mesh, bars=bars, named={name: i for i, name in enumerate(names)})
    held = frozenset(range(2 * fe.DOFS_PER_NODE))
    joint = 0.03 * density * area * (span + 2 * height)
    lumps = tuple((fe.DOFS_PER_NODE * i + a, joint) for i in range(2, len(points)) for a in (0, 1))
    coarse = replace(coarse, held=held, lumps=lumps)
    zones = {"E_columns": 0, "E_beams": 1}
    theta = _theta(rng, tuple(zones))
    again = partial(_realise, coarse=coarse, theta=theta, zones=zones, parts=3)
    truth = again(rng)
    spots = _frame_spots(coarse, len(points))
    drive = spots[int(rng.integers(len(spots)))]
    count = min(n_sensors or int(rng.integers(3, 9)), len(spots))
    picked = _pick(rng, spots, count, drive if rng.random() < 0.7 else None)
    sensors = _sensors(rng, picked, 0.001 * height)
    swing = "z" if rng.random() < 0.5 else "y"
    n_modes = int(rng.integers(4, 7))
    ratio = _ratio(rng)
    return Bench("frame", truth, coarse, zones, theta, sensors, drive, None, ("1", "2"), swing, n_modes, ratio, again)


def _portal(storeys: int, span: float, height: float) -> tuple[list[tuple[float, float]], list[tuple[int, int, int]]]:
    points = [(x, level * height) for level in range(storeys + 1) for x in (0.0, span)]
    members = []
    for level in range(storeys):
        low, high = 2 * level, 2 * level + 2
        members += [(low, high, 0), (low + 1, high + 1, 0), (high, high + 1, 1)]
    return points, members


def _members(points: list, members: list, bar: fe.Bar) -> fe.Mesh:
    bars = tuple(replace(bar, ends=(a, b), zone=zone) for a, b, zone in members)
    return fe.Mesh(np.array(points, float), bars, {}, (0, 1, 2))


def _frame_spots(mesh: fe.Mesh, n_joints: int) -> list[tuple[str, int]]:
    """Joints along both axes, and middles of members across them: where one would put a sensor or a hammer."""
    spots = []
    for name, i in mesh.named.items():
        if i < 2:
            continue
        if i < n_joints:
            spots += [(name, 0)] + ([(name, 1)] if i % 2 else [])
            continue
        bar = next(b for b in mesh.bars if i in b.ends)
        along = np.abs(mesh.xy[bar.ends[1]] - mesh.xy[bar.ends[0]])
        spots.append((name, 1 if along[0] > along[1] else 0))
    return spots


BENCHES: dict[str, Callable[..., Bench]] = {
    "chain": chain,
    "base-beam": base_beam,
    "free-beam": free_beam,
    "frame": frame,
}
