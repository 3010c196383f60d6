"""Element and support stiffness recovered from a structure's own matrices and geometry.

A finite element program exports K and the nodes, not its elements. Between two nodes the coupling block of K is the
element's; what the block lacks follows from the element exerting nothing in a rigid motion.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS, Site

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
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :] if coupling(site, a, b) is not None]
    return tuple(pairs)


def element_stiffness(site: Site, a: str, b: str) -> tuple[list[int], NDArray[np.float64], list[str]] | None:
    """Coordinates, stiffness matrix and directions of the element between a and b.

    The diagonal blocks follow from K_e R = 0 for the rigid motions R of its two nodes. For an element to a
    support, whose coordinates are gone, the free end's block is what its other elements leave.
    """
    both = coupling(site, a, b)
    if both is None:
        return _support_element(site, a, b)
    ia, ib, kab = both
    da, db = list(dof_rows(site, a)), list(dof_rows(site, b))
    if da != db:
        return None
    transfer = rigid_transfer(_xyz(site, a), _xyz(site, b), db, da)
    kaa = -kab @ transfer
    kbb = -kab.T @ np.linalg.inv(transfer)
    k = np.block([[kaa, kab], [kab.T, kbb]])
    return ia + ib, _semidefinite((k + k.T) / 2), da + db


def _support_element(site: Site, a: str, b: str) -> tuple[list[int], NDArray[np.float64], list[str]] | None:
    if b in site.supports and dof_rows(site, a):
        a, b = b, a
    rows = dof_rows(site, b)
    if a not in site.supports or not rows or dof_rows(site, a):
        return None
    index = list(rows.values())
    left = site.stiffness[np.ix_(index, index)].copy()
    for one, other in touching(site):
        if b in (one, other):
            found = element_stiffness(site, one, other)
            if found is None:
                return None
            at = [found[0].index(i) for i in index]
            left -= found[1][np.ix_(at, at)]
    return index, _semidefinite(left), list(rows)


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


def support_columns(site: Site, support: str, axis: str) -> tuple[NDArray[np.float64], float] | None:
    """Force pattern K_fs, shape (n,), and stiffness K_ss of a unit motion of a clamped support along `axis`.

    K_fs is minus the rows of K R that do not vanish, R the rigid motion about the support; rows that belong to
    another support lie nearer to it and are left to it.
    """
    here = _xyz(site, support)
    n = site.stiffness.shape[0]
    rigid = np.zeros(n)
    owner = np.full(n, "", object)
    for dof in site.dofs:
        node, direction = dof.split(":")
        row = dof_rows(site, node).get(direction)
        if row is None:
            continue
        rigid[row] = rigid_transfer(here, _xyz(site, node), [direction], [axis])[0, 0]
        owner[row] = min(site.supports, key=lambda s: float(np.linalg.norm(_xyz(site, s) - _xyz(site, node))))
    load = site.stiffness @ rigid
    load[np.abs(load) < 1e-7 * np.abs(site.stiffness).dot(np.abs(rigid)).max(initial=1e-300)] = 0.0
    load[owner != support] = 0.0
    stiffness = float(load @ rigid)
    if stiffness <= 0:
        return None
    return load, stiffness


def cross_stiffness(site: Site, support: str, axis: str, load: NDArray) -> float:
    """Force along `axis` that the clamp needs to hold a unit of another of its motions, whose loads K_fs are `load`."""
    here = _xyz(site, support)
    turned = np.zeros(site.stiffness.shape[0])
    for dof in site.dofs:
        node, direction = dof.split(":")
        row = dof_rows(site, node).get(direction)
        if row is not None:
            turned[row] = rigid_transfer(here, _xyz(site, node), [direction], [axis])[0, 0]
    return float(load @ turned)
