"""Plane finite elements of the concealed truth: rods and beams with shear, rotary inertia, preload and loss.

Every node has three coordinates (along x, along y, rotation about z). A chain keeps the first, a straight
beam the last two, a frame all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

DOFS_PER_NODE = 3


@dataclass(frozen=True)
class Bar:
    """One straight element between two nodes, with its section; `home` is the element of the nominal mesh around it.

    Parameters
    ----------
    ends : (int, int)
        Numbers of its nodes.
    home : (str, str)
        Names of the nominal nodes between which it lies.
    axial, bending : float
        EA in N and EI in N m^2.
    mass : float
        Mass per length, kg/m.
    shear : float
        kGA in N; infinite for a beam without shear.
    rotary : float
        Rotary inertia per length, kg m.
    loss : float
        Loss factor of its stiffness.
    """

    ends: tuple[int, int]
    home: tuple[str, str]
    axial: float
    bending: float
    mass: float
    shear: float = np.inf
    rotary: float = 0.0
    loss: float = 0.0
    zone: int = 0


@dataclass(frozen=True, eq=False)
class Mesh:
    """Nodes, elements, lumps and supports of one structure.

    Parameters
    ----------
    xy : ndarray, shape (n_nodes, 2)
    bars : tuple of Bar
    named : mapping
        Name of a nominal node -> its number here.
    kept : tuple of int
        Coordinates of a node that exist (0 x, 1 y, 2 rotation).
    held : frozenset of int
        Numbers of the degrees of freedom that the support holds.
    lumps : tuple of (dof, mass)
    springs : tuple of (dof, other dof or -1, stiffness, loss)
        Discrete springs; -1 is ground.
    tension : float
        Axial force in every bar, N.
    """

    xy: NDArray[np.float64]
    bars: tuple[Bar, ...]
    named: Mapping[str, int]
    kept: tuple[int, ...]
    held: frozenset[int] = frozenset()
    lumps: tuple[tuple[int, float], ...] = ()
    springs: tuple[tuple[int, int, float, float], ...] = ()
    tension: float = 0.0

    @property
    def size(self) -> int:
        """Degrees of freedom before any is struck out."""
        return DOFS_PER_NODE * len(self.xy)

    @property
    def active(self) -> NDArray[np.int_]:
        """Numbers of the degrees of freedom that exist and are not held."""
        return np.array([d for d in range(self.size) if d % DOFS_PER_NODE in self.kept and d not in self.held], int)

    def dof(self, name: str, axis: int) -> int:
        """Number of coordinate `axis` (0 x, 1 y, 2 rotation) of the nominal node `name`."""
        return DOFS_PER_NODE * self.named[name] + axis


def bar_matrices(bar: Bar, length: float, tension: float = 0.0) -> tuple[NDArray, NDArray]:
    """Stiffness and consistent mass of one bar in its own axes, each (6, 6); w, theta with theta = w' - shear.

    References
    ----------
    Przemieniecki (1968), Theory of Matrix Structural Analysis, sections 5.6 and 11.8 (shear, rotary inertia).
    """
    k, m = np.zeros((6, 6)), np.zeros((6, 6))
    k[np.ix_([0, 3], [0, 3])] = bar.axial / length * np.array([[1, -1], [-1, 1]])
    m[np.ix_([0, 3], [0, 3])] = bar.mass * length / 6 * np.array([[2, 1], [1, 2]])
    bend = np.ix_([1, 2, 4, 5], [1, 2, 4, 5])
    ratio = 0.0 if np.isinf(bar.shear) else 12 * bar.bending / (bar.shear * length**2)
    k[bend] = _bending_stiffness(bar.bending, length, ratio) + tension * _string(length, ratio)
    m[bend] = _shape_integral(bar.mass, bar.rotary, length, ratio)
    return k, m


def _bending_stiffness(ei: float, length: float, ratio: float) -> NDArray:
    a, b = 4 + ratio, 2 - ratio
    h = length
    shape = [[12, 6 * h, -12, 6 * h], [6 * h, a * h**2, -6 * h, b * h**2]]
    shape += [[-12, -6 * h, 12, -6 * h], [6 * h, b * h**2, -6 * h, a * h**2]]
    return ei / (h**3 * (1 + ratio)) * np.array(shape)


@cache
def _gauss() -> tuple[NDArray, NDArray]:
    point, weight = np.polynomial.legendre.leggauss(5)
    return (point + 1) / 2, weight / 2


def _shapes(s: NDArray, h: float, ratio: float) -> tuple[NDArray, NDArray, NDArray]:
    """Deflection, section rotation and slope at s in [0, 1], each (4, n): exact for a static shear-flexible beam."""
    p, one = ratio, 1 + ratio
    w = np.array(
        [
            1 - 3 * s**2 + 2 * s**3 + (1 - s) * p,
            (s - 2 * s**2 + s**3 + (s - s**2) * p / 2) * h,
            3 * s**2 - 2 * s**3 + s * p,
            (-(s**2) + s**3 - (s - s**2) * p / 2) * h,
        ]
    )
    slope = np.array(
        [
            (-6 * s + 6 * s**2 - p) / h,
            1 - 4 * s + 3 * s**2 + (1 - 2 * s) * p / 2,
            (6 * s - 6 * s**2 + p) / h,
            -2 * s + 3 * s**2 - (1 - 2 * s) * p / 2,
        ]
    )
    turn = np.array(
        [
            (-6 * s + 6 * s**2) / h,
            1 - 4 * s + 3 * s**2 + (1 - s) * p,
            (6 * s - 6 * s**2) / h,
            -2 * s + 3 * s**2 + s * p,
        ]
    )
    return w / one, turn / one, slope / one


def _shape_integral(mass: float, rotary: float, length: float, ratio: float) -> NDArray:
    s, weight = _gauss()
    w, turn, _ = _shapes(s, length, ratio)
    return length * ((w * mass * weight) @ w.T + (turn * rotary * weight) @ turn.T)


def _string(length: float, ratio: float) -> NDArray:
    s, weight = _gauss()
    _, _, slope = _shapes(s, length, ratio)
    return length * (slope * weight) @ slope.T


def _turned(matrix: NDArray, direction: NDArray) -> NDArray:
    c, s = direction
    block = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    turn = np.kron(np.eye(2), block)
    return turn.T @ matrix @ turn


def assemble(mesh: Mesh) -> tuple[NDArray, NDArray, NDArray]:
    """Mass, stiffness and loss matrices over all degrees of freedom, each (size, size)."""
    n = mesh.size
    M, K, D = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    for bar in mesh.bars:
        at = [DOFS_PER_NODE * e + i for e in bar.ends for i in range(DOFS_PER_NODE)]
        step = mesh.xy[bar.ends[1]] - mesh.xy[bar.ends[0]]
        length = float(np.hypot(*step))
        k, m = (_turned(a, step / length) for a in bar_matrices(bar, length, mesh.tension))
        where = np.ix_(at, at)
        K[where] += k
        M[where] += m
        D[where] += bar.loss * k
    for dof, mass in mesh.lumps:
        M[dof, dof] += mass
    for a, b, stiffness, loss in mesh.springs:
        row = difference(n, a, b)
        K += stiffness * np.outer(row, row)
        D += loss * stiffness * np.outer(row, row)
    return M, K, D


def difference(n: int, a: int, b: int) -> NDArray[np.float64]:
    """Row, shape (n,), that takes the motion of a against b, or against ground if b is -1."""
    row = np.zeros(n)
    row[a] += 1.0
    if b >= 0:
        row[b] -= 1.0
    return row


def refine(mesh: Mesh, parts: int) -> Mesh:
    """Every bar cut into `parts`; lumps, springs, supports and names stay with their nodes."""
    xy, bars = list(mesh.xy), []
    for bar in mesh.bars:
        a, b = bar.ends
        inner = [mesh.xy[a] + (mesh.xy[b] - mesh.xy[a]) * i / parts for i in range(1, parts)]
        line = [a, *range(len(xy), len(xy) + len(inner)), b]
        xy += inner
        bars += [replace(bar, ends=(p, q)) for p, q in pairwise(line)]
    return replace(mesh, xy=np.array(xy), bars=tuple(bars))


def point_row(mesh: Mesh, home: tuple[str, str], offset: float, axis: int) -> NDArray[np.float64]:
    """Row, shape (size,), that takes the motion along `axis` at `offset` metres from home[0] towards home[1]."""
    start, stop = (mesh.xy[mesh.named[name]] for name in home)
    direction = (stop - start) / np.hypot(*(stop - start))
    for bar in mesh.bars:
        if set(bar.home) != set(home):
            continue
        a, b = (float((mesh.xy[e] - start) @ direction) for e in bar.ends)
        if min(a, b) - 1e-12 <= offset <= max(a, b) + 1e-12:
            return _inside(mesh, bar, (offset - a) / (b - a), axis)
    raise ValueError(f"no bar of {home} holds the point {offset}")


def _inside(mesh: Mesh, bar: Bar, s: float, axis: int) -> NDArray[np.float64]:
    step = mesh.xy[bar.ends[1]] - mesh.xy[bar.ends[0]]
    length = float(np.hypot(*step))
    c, sn = step / length
    ratio = 0.0 if np.isinf(bar.shear) else 12 * bar.bending / (bar.shear * length**2)
    w, turn, _ = _shapes(np.array([s]), length, ratio)
    local = np.zeros((3, 6))
    local[0, [0, 3]] = [1 - s, s]
    local[1, [1, 2, 4, 5]] = w[:, 0]
    local[2, [1, 2, 4, 5]] = turn[:, 0]
    block = np.array([[c, sn, 0], [-sn, c, 0], [0, 0, 1]])
    world = block.T @ local @ np.kron(np.eye(2), block)
    row = np.zeros(mesh.size)
    at = [DOFS_PER_NODE * e + i for e in bar.ends for i in range(DOFS_PER_NODE)]
    row[at] = world[axis]
    return row


def line_mesh(
    positions: NDArray,
    names: Sequence[str],
    bar: Bar,
    kept: tuple[int, ...],
    along: tuple[float, float] = (1, 0),
) -> Mesh:
    """Straight row of nodes joined by copies of `bar`, one between each two neighbours."""
    xy = np.outer(np.asarray(positions, float), np.asarray(along, float))
    bars = tuple(replace(bar, ends=(i, i + 1), home=(names[i], names[i + 1])) for i in range(len(names) - 1))
    return Mesh(xy, bars, {name: i for i, name in enumerate(names)}, kept)


def zone_only(mesh: Mesh, zone: int) -> Mesh:
    """The mesh with the bars of one zone only."""
    return replace(mesh, bars=tuple(b for b in mesh.bars if b.zone == zone), springs=(), lumps=())
