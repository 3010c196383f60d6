"""Element and support stiffness recovered from a structure's own matrices and geometry.

A finite element program exports K and the nodes, not its elements. Between two nodes the coupling block of K is the
element's; what the block lacks follows from the element exerting nothing in a rigid motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS, Held, Place, Site
from labnnum.structures.base import Structure

AXES = TRANSLATIONS + ROTATIONS


def dof_rows(site: Site, node: str) -> dict[str, int]:
    """Direction -> coordinate number, for the node's degrees of freedom that are single coordinates."""
    out = {}
    for axis in AXES:
        row = site.dofs.get(f"{node}:{axis}")
        if row is not None and np.count_nonzero(row) == 1 and row.max() == 1:
            out[axis] = int(np.argmax(row))
    return out


def rigid_transfer(from_xyz: NDArray, to_xyz: NDArray, rows: list[str], columns: list[str]) -> NDArray[np.float64]:
    """Motion in `rows` directions at one point when a rigid body moves by each of `columns` at another."""
    arm = np.asarray(to_xyz, float) - np.asarray(from_xyz, float)
    full = np.eye(6)
    for j in range(3):
        turn = np.zeros(3)
        turn[j] = 1.0
        full[:3, 3 + j] = np.cross(turn, arm)
    pick = [AXES.index(r) for r in rows]
    return full[np.ix_(pick, [AXES.index(c) for c in columns])]


def with_support(
    nodes: Mapping[str, tuple[float, float, float]], rows: Mapping[str, int], place: Place, columns: NDArray,
    support: str, axis: str,
) -> NDArray[np.float64]:  # fmt: skip
    """What columns (n, k) between a node and `support` have at the support's own motion along `axis`, (k,).

    `rows` are the coordinates of the other node. A column of one motion is the difference of the two nodes along it;
    any other is of strain, which a motion as a body does not give.
    """
    other = place.id if support == place.to else place.to
    assert other is not None
    here, there = (np.array(nodes.get(node, (0.0, 0.0, 0.0)), float) for node in (support, other))
    body = rigid_transfer(here, there, list(rows), [axis])[:, 0]
    out = np.zeros(columns.shape[1])
    for k, column in enumerate(columns.T):
        at = column[list(rows.values())]
        alone = np.count_nonzero(column) == 1
        out[k] = -sum(at[j] for j, a in enumerate(rows) if a == axis) if alone else -float(at @ body)
    return out


def meets(place: Place, support: str) -> bool:
    """Whether something at `place` joins a node to `support`."""
    return place.to is not None and support in (place.id, place.to)


def _xyz(site: Site, node: str) -> NDArray[np.float64]:
    return np.array(site.nodes.get(node, (0.0, 0.0, 0.0)), float)


def coupling(site: Site, a: str, b: str) -> tuple[list[int], list[int], NDArray] | None:
    """Coordinates of a, of b, and the block K_ab; None where the nodes do not touch."""
    ra, rb = dof_rows(site, a), dof_rows(site, b)
    if not ra or not rb:
        return None
    ia, ib = list(ra.values()), list(rb.values())
    block = site.stiffness[np.ix_(ia, ib)]
    top = np.abs(site.stiffness).max()
    return (ia, ib, block) if np.abs(block).max() > 1e-9 * top else None


def touching(site: Site) -> tuple[tuple[str, str], ...]:
    """Pairs of nodes that K couples, in the order of the nodes, supports included where they are next in line."""
    names = list(dict.fromkeys(d.split(":")[0] for d in site.dofs))
    rows = {name: list(dof_rows(site, name).values()) for name in names}
    couples = np.abs(site.stiffness) > 1e-9 * np.abs(site.stiffness).max()
    held = [name for name in names if rows[name]]
    pairs = [(a, b) for i, a in enumerate(held) for b in held[i + 1 :] if couples[np.ix_(rows[a], rows[b])].any()]
    return tuple(pairs)


def element_stiffness(site: Site, a: str, b: str) -> tuple[list[int], NDArray[np.float64], list[str]] | None:
    """Coordinates, stiffness matrix and directions of the element between a and b.

    The diagonal blocks follow from K_e R = 0 for the rigid motions R of its two nodes. For an element to a
    support, whose coordinates are gone, the free end's block is what its other elements leave.
    """
    found = _element(site, a, b)
    return None if found is None else (found[0], _semidefinite(found[1]), found[2])


def _element(
    site: Site, a: str, b: str, pairs: tuple[tuple[str, str], ...] | None = None
) -> tuple[list[int], NDArray[np.float64], list[str]] | None:
    """As `element_stiffness`, for any matrix that has the pattern of a stiffness; `pairs` are the nodes it couples."""
    both = coupling(site, a, b)
    if both is None:
        return _support_element(site, a, b, pairs or touching(site))
    ia, ib, kab = both
    da, db = list(dof_rows(site, a)), list(dof_rows(site, b))
    if da != db:
        return None
    transfer = rigid_transfer(_xyz(site, a), _xyz(site, b), db, da)
    kaa = -kab @ transfer
    kbb = -kab.T @ np.linalg.inv(transfer)
    k = np.block([[kaa, kab], [kab.T, kbb]])
    return ia + ib, (k + k.T) / 2, da + db


def _support_element(
    site: Site, a: str, b: str, pairs: tuple[tuple[str, str], ...]
) -> tuple[list[int], NDArray[np.float64], list[str]] | None:
    if b in site.supports and dof_rows(site, a):
        a, b = b, a
    rows = dof_rows(site, b)
    if a not in site.supports or not rows or dof_rows(site, a):
        return None
    index = list(rows.values())
    left = site.stiffness[np.ix_(index, index)].copy()
    for one, other in pairs:
        if b in (one, other):
            found = _element(site, one, other, pairs)
            if found is None:
                continue
            at = [found[0].index(i) for i in index]
            left -= found[1][np.ix_(at, at)]
    return index, left, list(rows)


def _semidefinite(k: NDArray) -> NDArray[np.float64]:
    """Nearest matrix without negative eigenvalues: what rounding or a neighbour's share left is dropped."""
    value, vector = np.linalg.eigh(k)
    value = np.where(value > 1e-9 * max(value.max(initial=0.0), 0.0), value, 0.0)
    return (vector * value) @ vector.T


def factors(k: NDArray) -> NDArray[np.float64]:
    """Columns w with sum w wᵀ = k, shape (n, rank)."""
    value, vector = np.linalg.eigh(k)
    keep = value > 1e-9 * max(value.max(initial=0.0), 1e-300)
    return vector[:, keep] * np.sqrt(value[keep])


def held_motions(structure: Structure) -> dict[str, Held]:
    """Support -> the motions that it holds, from the structure with that support let go, at nominal parameters."""
    out: dict[str, Held] = {}
    theta = structure.nominal
    n = len(structure.matrices(theta).M)
    for support in structure.supports:
        free = structure.released(support)
        if free is None:
            continue
        extra = [d for d in free.dofs if d.partition(":")[0] == support and d not in structure.dofs]
        rows = np.array([int(np.argmax(np.abs(np.real(free.participation(d, theta))))) for d in extra], int)
        m = free.matrices(theta)
        mass, stiffness = np.real(m.M), np.real(m.K)
        rest = np.setdiff1d(np.arange(len(mass)), rows)
        if not rows.size or rest.size != n:
            continue
        shape = np.zeros((len(mass), rows.size))
        shape[rows] = np.eye(rows.size)
        shape[rest] = -np.linalg.solve(stiffness[np.ix_(rest, rest)], stiffness[np.ix_(rest, rows)])
        own = shape.T @ stiffness @ shape
        own[np.abs(own) < 1e-7 * np.abs(stiffness[np.ix_(rows, rows)])] = 0.0  # free of others, it moves as a body
        size = float(np.sum(own * own))
        gain = [float(np.sum((shape.T @ np.real(d.K) @ shape) * own)) / size if size else 0.0
                for d in free.derivatives(theta)]  # fmt: skip
        axes = tuple(d.partition(":")[2] for d in extra)
        moved = np.real(free.rigid(theta)) if structure.base else np.zeros(len(mass))
        pushed = mass @ moved
        load = (mass @ shape)[rest]
        free_load = mass[np.ix_(rest, rows)] @ moved[rows]
        own_load = shape.T @ pushed - load.T @ moved[rest]
        whole = shape.T @ mass @ shape
        out[support] = Held(axes, shape[rest], load, own, whole, np.array(gain), free_load, own_load)
    return out


def element_gain(site: Site, a: str, b: str) -> NDArray[np.float64]:
    """Relative change of the stiffness of the element a-b with each parameter of the structure, (n_theta,)."""
    found = _element(site, a, b)
    if found is None:
        return np.zeros(len(site.slopes))
    k = found[1]
    pairs = touching(site)
    out = []
    for slope in site.slopes:
        changed = _element(replace(site, stiffness=slope), a, b, pairs)
        out.append(0.0 if changed is None else float(np.sum(changed[1] * k) / np.sum(k * k)))
    return np.array(out)
