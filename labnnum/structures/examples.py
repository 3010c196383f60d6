"""The structures of the dissertation, with its parameters and bounds; `EXAMPLES` adds channels and bands.

Source: Atalla (1996), sections 4.7 (truck), 5.2 (Kabe), 5.3 (Yang and Brown), 5.6 (beam), 5.7 (frame). Topologies that
only figures showed are reconstructed and checked against the natural frequencies and bands of its text. What it
calls variances are used as standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from labnnum.bands import Band
from labnnum.errors import ConfigError
from labnnum.parameters import Parameter
from labnnum.recording import DIRECTIONS, Channel
from labnnum.structures.base import Structure
from labnnum.structures.beam import Beam, Lump
from labnnum.structures.chain import GROUND, Chain, Link
from labnnum.structures.frame import Frame, JointMass, Member, Profile
from labnnum.structures.quantities import Quantity, proportional
from labnnum.structures.section import Section

TRUCK_PARAMETERS = (
    Parameter("m3", 130.0, 100.0, 160.0, "kg", 15.0),
    Parameter("k2", 5e5, 2e5, 8e5, "N/m", 1.6e5),
    Parameter("k3", 23.5e3, 12e3, 35e3, "N/m", 7e3),
    Parameter("b2", 1050.0, 900.0, 1200.0, "N*s/m", 100.0),
    Parameter("b3", 600.0, 500.0, 700.0, "N*s/m", 70.0),
)


@dataclass(frozen=True, eq=False)
class Example:
    """A structure with the channels and bands that its updating uses.

    Parameters
    ----------
    structure : Structure
    outputs, inputs : sequence of Channel
    bands : sequence of Band
        In Hz; the dissertation prints rad/s.
    samples : int
        Training samples that the dissertation used.
    """

    structure: Structure
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    bands: tuple[Band, ...]
    samples: int


def truck(updated: Sequence[str] = ("m3", "k2", "k3", "b2", "b3")) -> Chain:
    """Truck suspension of section 4.7: wheel, axle, and driver with seat; `updated` names the free parameters."""
    known = {p.name: p for p in TRUCK_PARAMETERS}
    for name in updated:
        if name not in known:
            raise ConfigError(f"the truck has no parameter {name!r}; it has {', '.join(known)}")
    held: dict[str, Quantity] = {n: n if n in updated else p.nominal for n, p in known.items()}
    return Chain(
        masses={"1": 3728.0, "2": 657.0, "3": held["m3"]},
        links=(
            Link("1", GROUND, 21e5),
            Link("1", "2", held["k2"], held["b2"]),
            Link("2", "3", held["k3"], held["b3"]),
        ),
        parameters=tuple(known[n] for n in updated),
    )


def kabe(damped: bool = False) -> Chain:
    """Kabe's eight close modes (section 5.2), k1 and k5 free; `damped` puts 0.01 N s/m beside each spring."""
    k2, k3, k4, k6 = 10.0, 900.0, 100.0, 2.0
    springs: tuple[tuple[str, str, Quantity], ...] = (
        ("1", "2", "k5"), ("2", "3", k2), ("2", GROUND, "k1"), ("3", GROUND, "k1"), ("3", "5", k4),
        ("5", GROUND, k3), ("4", "5", k4), ("4", GROUND, k3), ("4", "6", k4), ("6", GROUND, "k1"),
        ("6", "7", k2), ("7", GROUND, "k1"), ("6", "8", k6),
    )  # fmt: skip
    masses = {"1": 0.001, **{str(i): 1.0 for i in range(2, 8)}, "8": 0.002}
    return Chain(
        masses=masses,
        links=tuple(Link(a, b, k, 0.01 if damped else 0.0) for a, b, k in springs),
        parameters=(
            Parameter("k1", 1000.0, 800.0, 1200.0, "N/m", 180.0),
            Parameter("k5", 1.5, 1.2, 1.8, "N/m", 0.25),
        ),
    )


def yang_brown(high: bool = False) -> Chain:
    """Yang and Brown's ladder of fifteen masses (section 5.3), five rung masses and two springs free.

    Units are the consistent ones printed there (lb, in, s); `high` multiplies all dashpots by seven.
    """
    more = 7.0 if high else 1.0
    special: dict[int, Quantity] = {1: "k1", 6: "k6", 19: 1100.0, 20: 900.0, 21: 1200.0, 22: 800.0}
    masses: dict[str, Quantity] = {str(i): 0.0259 for i in range(1, 11)}
    masses |= {str(i): f"m{i}" for i in range(11, 16)}
    side = [GROUND, "1", "2", "3", "4", "5", GROUND]
    other = [GROUND, "6", "7", "8", "9", "10", GROUND]
    joins = [*pairwise(side), *pairwise(other)]
    for i in range(1, 6):
        joins += [(str(i), str(10 + i)), (str(10 + i), str(5 + i))]
    return Chain(
        masses=masses,
        links=tuple(
            Link(a, b, special.get(n, 1000.0), more * (0.1 if n <= 12 else 0.01)) for n, (a, b) in enumerate(joins, 1)
        ),
        parameters=(
            *(Parameter(f"m{i}", 1.295e-3, 0.8 * 1.295e-3, 1.2 * 1.295e-3, "lb", 1.5e-4) for i in range(11, 16)),
            Parameter("k1", 1000.0, 700.0, 1300.0, "lb/in", 300.0),
            Parameter("k6", 1000.0, 700.0, 1300.0, "lb/in", 300.0),
        ),
    )


PSI, INCH, POUND = 6894.757293168, 0.0254, 0.45359237


def dissertation_beam() -> Beam:
    """Cantilevered beam on a shaker (section 5.6): six elements, an accelerometer at node 3, base motion along z.

    Where node 3 lies is only in a figure. It stands at 4 of the 10 inches here, because then all four resonances lie in
    the printed bands; at a third of the length, as six equal elements would have it, the third one lies 3 % below.
    """
    return Beam(
        length=10 * INCH,
        section=Section(E=1e7 * PSI, rho=0.1 * POUND / INCH**3, width=1.5 * INCH, height=0.0625 * INCH),
        n_elements=6,
        spacing=(2.0, 2.0, 1.5, 1.5, 1.5, 1.5),
        supports_at={"1": "clamped"},
        lumps=(Lump("3", "m_acc", "I_acc"),),
        parameters=(
            Parameter("m_acc", 10e-3, 7e-3, 13e-3, "kg", 2e-3),
            Parameter("I_acc", 1.5e-6, 0.75e-6, 2.25e-6, "kg*m^2", 3.5e-7),
            Parameter("alpha", 1.5, 0.5, 2.5, "1/s", 0.70),
            Parameter("beta", 2e-5, 0.5e-5, 3.5e-5, "s", 9e-6),
        ),
        damping=proportional("alpha", "beta"),
        base="z",
    )


def dissertation_frame() -> Frame:
    """Tower of 96 active degrees of freedom, comparable to the frame of section 5.7.

    Members, masses and parameters are those printed there. Its mesh is only in a figure, so this one is ours: four
    columns of five nodes (1, 6, 11 and 16 clamped), square in plan, bays of the nominal 27 cm, a diagonal in plan in
    each storey, two flat beams among the columns of the lowest storey.
    """
    bay = 0.27
    corners = ((0.0, 0.0), (bay, 0.0), (bay, bay), (0.0, bay))
    positions = {str(5 * c + i + 1): (*corners[c], bay * i) for c in range(4) for i in range(5)}
    members = _tower_members()
    ends = [n for m in members for n in (m.a, m.b)]
    free = [n for n in positions if n not in ("1", "6", "11", "16")]
    joints = [JointMass(n, 9.7e-3) for n in free] + [JointMass(n, "m_bp") for n in ends if n in free]
    sensors = [JointMass(n, 10.20e-3, 1.08e-6) for n in ("3", "20")]
    tube = Profile(E=69e9, rho=2710.0, diameter=6.4e-3, bore=5.08e-3, equivalent="L", reference=bay)
    flat = Profile(E=69e9, rho=2710.0, width=28.6e-3, height=3.2e-3, equivalent="L", reference=bay)
    return Frame(
        positions=positions,
        profiles={"tube": tube, "flat": flat},
        members=members,
        fixed=dict.fromkeys(("1", "6", "11", "16"), DIRECTIONS),
        masses=(*joints, *sensors),
        parameters=(
            Parameter("L", 0.27, 0.25, 0.29, "m", 0.013),
            Parameter("m_bp", 3.2e-3, 2.0e-3, 4.4e-3, "kg", 0.9e-3),
            Parameter("alpha", 1.0, 0.2, 1.8, "1/s", 0.55),
            Parameter("beta", 8e-6, 2e-6, 14e-6, "s", 4e-6),
        ),
        damping=proportional("alpha", "beta"),
    )


def _tower_members() -> tuple[Member, ...]:
    def node(column: int, storey: int) -> str:
        return str(5 * (column % 4) + storey + 1)

    columns = [
        Member(node(c, s), node(c, s + 1), "flat" if s == 0 and c in (0, 2) else "tube")
        for c in range(4)
        for s in range(4)
    ]
    rings = [Member(node(c, s), node(c + 1, s), "tube") for s in range(1, 5) for c in range(4)]
    diagonals = [Member(node(0, s), node(2, s), "tube") for s in range(1, 5)]
    return (*columns, *rings, *diagonals)


def hertz(*ranges: tuple[float, float]) -> tuple[Band, ...]:
    """Bands from ranges in rad/s."""
    return tuple(Band(low / (2 * np.pi), high / (2 * np.pi)) for low, high in ranges)


def force_at(node: str, direction: str = "x") -> Channel:
    """Force channel called f<node> at a node."""
    return Channel(f"f{node}", "force", "reference", node, direction)


def motion_of(node: str, quantity: str = "displacement", direction: str = "x") -> Channel:
    """Response channel at a node, named after the quantity's first letter (x for displacement) and the node."""
    return Channel(f"{quantity[0] if quantity != 'displacement' else 'x'}{node}", quantity, "response", node, direction)


def _truck() -> Example:
    """The bands are ours: the dissertation does not print them."""
    bands = hertz((8.0, 17.0), (17.0, 26.0), (26.0, 42.0))
    return Example(truck(), tuple(motion_of(n) for n in "321"), (force_at("1"),), bands, 800)


def _kabe(damped: bool) -> Example:
    bands = hertz((27.9, 29.8), (30.1, 32.3), (32.3, 34.5), (34.5, 36.4), (36.7, 37.6))
    return Example(kabe(damped), (motion_of("1"), motion_of("8")), (force_at("5"),), bands, 1500)


def _yang_brown(high: bool) -> Example:
    bands = hertz((82.1, 138.9), (189.4, 227.3), (233.6, 328.4), (328.4, 524.1))
    outputs = tuple(motion_of(n) for n in ("1", "6", "11", "12", "13", "14", "15"))
    return Example(yang_brown(high), outputs, (force_at("1"), force_at("2")), bands, 828)


def _beam() -> Example:
    """Only the real part in the first and fourth band; the third weighted 0.4, as in the weighted run there."""
    first, second, third, fourth = hertz((86.4, 141.0), (636.0, 699.0), (1932.0, 2058.0), (3770.0, 4131.0))
    bands = (
        Band(first.low, first.high, 1.0, 0.0),
        second,
        Band(third.low, third.high, 0.4, 0.4),
        Band(fourth.low, fourth.high, 1.0, 0.0),
    )
    base = Channel("base", "acceleration", "base", "1", "z")
    return Example(dissertation_beam(), (motion_of("3", "acceleration", "z"),), (base,), bands, 1000)


def _frame() -> Example:
    """Imaginary parts weighted 0.7 as printed; the directions of hammer and accelerometers are ours."""
    bands = tuple(Band(b.low, b.high, 1.0, 0.7) for b in hertz((65.0, 86.0), (86.0, 114.0), (190.0, 260.0)))
    outputs = tuple(motion_of(n, "acceleration", "x") for n in ("3", "20"))
    return Example(dissertation_frame(), outputs, (force_at("12", "x"),), bands, 1200)


EXAMPLES: dict[str, Callable[[], Example]] = {
    "truck": _truck,
    "kabe": lambda: _kabe(False),
    "kabe-damped": lambda: _kabe(True),
    "yang-brown-low": lambda: _yang_brown(False),
    "yang-brown-high": lambda: _yang_brown(True),
    "beam": _beam,
    "frame": _frame,
}
"""Example name -> function that makes it."""
