"""The nominal model of a case in its own words: a beam or a frame as model.toml describes one, not its matrices."""

from __future__ import annotations

from typing import Any

from sessions.prove.truth import fe
from sessions.prove.truth.bench import Bench


def axis_name(bench: Bench, axis: int) -> str:
    """The user's name of a coordinate."""
    return ("x", bench.swing, "rz" if bench.swing == "y" else "ry")[axis]


def strings(items: Any) -> str:
    """A list of texts in TOML."""
    return "[" + ", ".join(f'"{i}"' for i in items) + "]"


def own_words(bench: Bench) -> list[str]:
    """Lines of [structure] of a beam of one zone, or of a frame."""
    return _frame(bench) if bench.kind == "frame" else _beam(bench)


def _beam(bench: Bench) -> list[str]:
    """The nominal beam in its own words: an Euler-Bernoulli beam whose modulus is the parameter E."""
    mesh, bar = bench.coarse, bench.coarse.bars[0]
    numbers = {
        "length": float(mesh.xy[-1, 0]),
        "A": bar.axial / bench.modulus,
        "I": bar.bending / bench.modulus,
        "rho": bar.mass * bench.modulus / bar.axial,
    }
    lines = ["[structure]", 'kind = "beam"', 'theory = "euler-bernoulli"', f"elements = {len(mesh.bars)}"]
    lines += [
        f'direction = "{bench.swing}"',
        'E = "E"',
        *(f"{key} = {float(value)!r}" for key, value in numbers.items()),
    ]
    if bench.base is not None:
        lines += [f'base = "{bench.swing}"']
    for foot in bench.feet:
        lines += ["[[structure.support]]", f'node = "{foot}"', 'kind = "clamped"']
    name_of = {i: name for name, i in mesh.named.items()}
    for dof, mass in mesh.lumps:
        lines += ["[[structure.lump]]", f'node = "{name_of[dof // fe.DOFS_PER_NODE]}"', f"mass = {float(mass)!r}"]
    return lines


def _frame(bench: Bench) -> list[str]:
    """The nominal frame: every node and every element by name, a profile for each zone with its modulus."""
    mesh = bench.coarse
    up = 1 if bench.swing == "y" else 2
    lines = ["[structure]", 'kind = "frame"', f'plane = "x{bench.swing}"']
    for name, i in mesh.named.items():
        xyz = [float(mesh.xy[i, 0]), 0.0, 0.0]
        xyz[up] = float(mesh.xy[i, 1])
        lines += ["[[structure.node]]", f'node = "{name}"', f"xyz = {xyz}"]
    for parameter, zone in bench.zones.items():
        bar = next(b for b in mesh.bars if b.zone == zone)
        second = bar.bending / bench.modulus
        numbers = {"rho": bar.mass * bench.modulus / bar.axial, "A": bar.axial / bench.modulus}
        numbers |= {"Iy": second, "Iz": second, "J": 2 * second}
        lines += ["[[structure.profile]]", f'name = "{parameter}"', f'E = "{parameter}"']
        lines += [f"{key} = {float(value)!r}" for key, value in numbers.items()]
    of_zone = {zone: name for name, zone in bench.zones.items()}
    for bar in mesh.bars:
        lines += ["[[structure.member]]", f"between = {strings(bar.home)}", f'profile = "{of_zone[bar.zone]}"']
    lines += [line for foot in bench.feet for line in ("[[structure.support]]", f'node = "{foot}"')]
    name_of = {i: name for name, i in mesh.named.items()}
    lumps = {name_of[dof // fe.DOFS_PER_NODE]: float(mass) for dof, mass in mesh.lumps}
    for name, mass in lumps.items():
        lines += ["[[structure.lump]]", f'node = "{name}"', f"mass = {mass!r}"]
    return lines
