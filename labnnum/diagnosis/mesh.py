"""What a coarse mesh is too stiff by: the inside of its beam elements, which may bend too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS, Site
from labnnum.mechanisms.geometry import dof_rows, element_stiffness
from labnnum.structures.beam import element_matrices
from labnnum.structures.section import Constants

ALIKE = 0.2
"""Relative difference from a slender beam's stiffness beyond which an element is taken for something else."""

FINE = 5e-4
"""Relative change of every frequency below which a mesh is fine enough."""

SPANNED = 0.02
"""Part of a deflection's mass below which the structure's own coordinates hold it already."""


@dataclass(frozen=True, eq=False)
class _Bending:
    """An element in one plane: its end motions (4, n), length, EI, and mass per length, nothing where it is unknown."""

    ends: NDArray[np.float64]
    length: float
    stiffness: float
    mass: float


@dataclass(frozen=True, eq=False)
class Inside:
    """The deflection inside each slender beam element under an even load between held ends, the first that cubics lack.

    Its coordinate z obeys (k + s^2 m) z = -s^2 L u beside the structure's coordinates u, so that it takes
    s^4 L'L / (k + s^2 m) off their dynamic stiffness.
    """

    rows: NDArray[np.float64]
    """L, (n_e, n): mass that couples it to the structure's coordinates."""
    stiffness: NDArray[np.float64]
    """k, (n_e,)."""
    mass: NDArray[np.float64]
    """m, (n_e,)."""

    @classmethod
    def of(cls, site: Site) -> Inside:
        """Of each element that is a slender beam with its consistent mass, told by the coupling blocks of K and M.

        Elements to supports, whose coordinates are gone, weigh as much beside their stiffness as the others do.
        """
        found = [one for a, b in site.mesh for one in _bendings(site, a, b)]
        known = [one.mass / one.stiffness for one in found if one.mass > 0]
        rows, own = [], []
        for one in found if known else ():
            heavy = one.mass if one.mass > 0 else one.stiffness * float(np.median(known))
            mass, stiffness = element_matrices(Constants(one.stiffness, heavy, np.inf, 0.0), one.length)
            rows.append(mass[4, :4] @ one.ends)
            own.append((stiffness[4, 4], mass[4, 4]))
        rows, own = np.array(rows).reshape(-1, len(site.mass)), np.array(own, float).reshape(-1, 2)
        left = own[:, 1] - np.einsum("en,ne->e", rows, np.linalg.solve(site.mass, rows.T))
        new = left > SPANNED * own[:, 1]
        return cls(rows[new], *own[new].T)

    def taken(self, s: NDArray, motions: NDArray, modes: NDArray, d: NDArray) -> NDArray[np.complex128]:
        """What is taken off the dynamic stiffness between `motions` (n, k), (n_s, k, k), where the modes that `modes`
        (k, m) makes of them, with receptances `d` (m, n_s), follow.
        """
        own = s**4 / (self.stiffness[:, None] + s**2 * self.mass[:, None])
        w = self.rows @ motions
        plain = np.einsum("ef,ek,el->fkl", own, w, w, optimize=True)
        met = plain @ modes
        inner = -modes.T @ met
        inner[:, np.arange(len(d)), np.arange(len(d))] += 1.0 / d.T
        return plain + met @ np.linalg.solve(inner, np.swapaxes(met, 1, 2))

    def shift(self, site: Site, omega: NDArray, shape: NDArray) -> NDArray[np.float64]:
        """Relative frequency changes (m,) of modes `omega` (m,), rad/s, with mass-normalised `shape` (n, m)."""
        n, n_e = len(site.mass), len(self.rows)
        if not n_e:
            return np.zeros(omega.size)
        mass = np.block([[site.mass, self.rows.T], [self.rows, np.diag(self.mass)]])
        stiffness = np.zeros_like(mass)
        stiffness[:n, :n] = site.stiffness
        stiffness[np.arange(n, n + n_e), np.arange(n, n + n_e)] = self.stiffness
        value, vector = eigh(stiffness, mass)
        like = np.argmax(np.abs(shape.T @ mass[:n] @ vector), axis=1)
        safe = np.where(omega > 0, omega, 1.0)
        return np.where(omega > 0, np.sqrt(np.maximum(value[like], 0.0)) / safe - 1, 0.0)


def _bendings(site: Site, a: str, b: str) -> list[_Bending]:
    """The planes in which an element bends as a slender beam does."""
    found = element_stiffness(site, a, b)
    rows = [dof_rows(site, node) for node in (a, b)]
    if found is None or a not in site.nodes or b not in site.nodes or not any(rows):
        return []
    if not rows[0]:
        a, b, rows = b, a, rows[::-1]
    arm = np.array(site.nodes[b], float) - np.array(site.nodes[a], float)
    h = float(np.linalg.norm(arm))
    moves, turns = ([t for t in names if t in rows[0]] for names in (TRANSLATIONS, ROTATIONS))
    if h == 0 or not moves or not turns:
        return []
    whole = np.zeros_like(site.mass)
    whole[np.ix_(found[0], found[0])] = found[1]
    out = []
    for across in _transverse(arm / h, moves):
        turn = np.cross(arm / h, across)
        if np.linalg.norm([turn[ROTATIONS.index(t)] for t in turns]) < 0.999:
            continue
        ends = np.zeros((4, len(site.mass)))
        for i, q in enumerate(rows):
            for name in (*moves, *turns):
                if name in q:
                    ends[2 * i + (name in turns), q[name]] = (
                        turn[ROTATIONS.index(name)] if name in turns else across[TRANSLATIONS.index(name)]
                    )
        k = ends @ whole @ ends.T
        stiff = float(k[0, 0]) * h**3 / 12
        if stiff <= 0 or abs(k[1, 1] * h / (4 * stiff) - 1) > ALIKE:
            continue
        heavy = float(ends[0] @ site.mass @ ends[2]) * 70 / (9 * h)
        if heavy > 0 or not rows[1]:
            out.append(_Bending(ends, h, stiff, heavy))
    return out


def _transverse(along: NDArray, names: list[str]) -> NDArray[np.float64]:
    """Orthonormal directions (k, 3) across `along` within the translations that a model has."""
    basis = np.array([[float(t == name) for t in TRANSLATIONS] for name in names])
    _, size, turned = np.linalg.svd((basis @ along)[None])
    return turned[int(size[0] > 1e-9) :] @ basis
