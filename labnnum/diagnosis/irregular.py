"""What a sound structure's parts differ by from its model: each element, mass and loss a little its own.

The differences are common to all sensors, so that they have columns of their own beside those of each row
(`objective.Problem`). A fault is an element that differs by more than elements do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis import sums
from labnnum.mechanisms.base import TRANSLATIONS
from labnnum.mechanisms.geometry import element_stiffness, factors

if TYPE_CHECKING:
    from labnnum.diagnosis.engine import Engine
    from labnnum.diagnosis.evaluation import Evaluation


@dataclass(frozen=True, eq=False)
class Bent:
    """Responses of a structure whose parts differ by something.

    `added` (o, i, f): displacements more than without; `q` (m, i, f) and `p_out` (m, o, f): the modes' motions by the
    inputs and by which the outputs follow; `pushed` and `pulled`, shaped like those: the modal forces that the parts
    take by them.
    """

    added: NDArray[np.complex128]
    q: NDArray[np.complex128]
    p_out: NDArray[np.complex128]
    pushed: NDArray[np.complex128]
    pulled: NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Irregular:
    """Elements (columns whose squares are their stiffness), masses of nodes, and the parts that parameters scale."""

    elements: NDArray[np.float64]
    """Columns (n, k) side by side."""
    starts: NDArray[np.intp]
    """First column of each element."""
    masses: NDArray[np.float64]
    """(n, k): motion of each node, times the root of its mass."""
    first: NDArray[np.intp]
    """First column of each node."""
    zones: tuple[NDArray[np.float64], ...]
    """Stiffness (n, n) that each parameter scales alone."""

    @classmethod
    def of(cls, engine: Engine) -> Irregular:
        """Those of the structure at its nominal parameters."""
        site = engine.site((), (), engine.structure.supports)
        n = len(site.mass)
        found = [element_stiffness(site, a, b) for a, b in site.mesh]
        columns, starts, at = [], [], 0
        for one in found:
            if one is None:
                continue
            own = factors(one[1])
            if not own.size:
                continue
            whole = np.zeros((n, own.shape[1]))
            whole[one[0]] = own
            columns.append(whole)
            starts.append(at)
            at += own.shape[1]
        masses, first, at = [], [], 0
        for node in dict.fromkeys(d.split(":")[0] for d in site.dofs):
            moved = site.rows(node, TRANSLATIONS)
            weight = np.sqrt(np.maximum(np.einsum("nk,nm,mk->k", moved, site.mass, moved), 0.0))
            if weight.any():
                masses.append(moved * weight)
                first.append(at)
                at += moved.shape[1]
        zones = []
        for p, d in zip(engine.theta0, engine.structure.derivatives(engine.theta0), strict=True):
            part = p * np.real(d.K)
            share = np.einsum("nm,nk,km->m", site.shape, part, site.shape) / site.omega**2
            if not np.any(np.real(d.M)) and share.min() > -1e-6 and share.max() < 1 + 1e-6 and share.max() > 0.02:
                zones.append(part)
        empty = np.zeros((n, 0))
        return cls(
            np.hstack([empty, *columns]), np.array(starts, int), np.hstack([empty, *masses]), np.array(first, int),
            tuple(zones) if len(zones) > 1 else (),
        )  # fmt: skip

    @property
    def kinds(self) -> list[str]:
        """Kind of each part, in the order of `columns`: "stiffness", "loss", "mass", "zone"."""
        counts = {"stiffness": self.starts.size, "loss": self.starts.size, "mass": self.first.size}
        return [k for k, n in counts.items() for _ in range(n)] + ["zone"] * len(self.zones)

    def couplings(self, one: Evaluation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What each part's size couples of the modes, (n_parts, m, m) in units of the dynamic stiffness (loss factor
        one for losses, s^2 one for masses), band modes with themselves left out, and how it moves the frequencies of
        those, relative, (n_parts, m_b): fits hold them as such, since a peak moves further than a line follows it.
        """
        st, b = one.state, one.e.band_modes
        stiff = _squares(self.elements.T @ st.shape, self.starts)
        heavy = _squares(self.masses.T @ st.shape, self.first)
        zones = np.array([st.shape.T @ part @ st.shape for part in self.zones]).reshape(-1, *heavy.shape[1:])
        moved = np.zeros((len(self.kinds), b.size))
        n = self.starts.size
        moved[:n] = stiff[:, b, b] / np.where(st.omega[b] > 0, 2 * st.omega[b] ** 2, np.inf)
        moved[2 * n : 2 * n + self.first.size] = -heavy[:, b, b] / 2
        every = np.concatenate([stiff, stiff, heavy, zones])
        every[:, b, b] = 0.0
        return every, moved

    def turns(self, engine: Engine, stiffness: float, mass: float) -> NDArray[np.float64]:
        """What each band mode takes in of every mode, (n_parts, m, m_b), for such relative changes of each element's
        stiffness and each node's mass: the angle by which two modes turn (Fox and Kapoor 1968, equation 15, beyond
        small angles as of two modes alone).
        """
        first, b = engine.state(engine.theta0), engine.band_modes
        square = first.omega**2
        gap = square[b] - square[:, None]
        stiff = stiffness * _squares(self.elements.T @ first.shape, self.starts)
        heavy = -mass * _squares(self.masses.T @ first.shape, self.first)
        mixed = np.concatenate([stiff[:, :, b], heavy[:, :, b] * square[b]])
        out = 0.5 * np.arctan2(2 * mixed, np.abs(gap)) * np.where(gap < 0, -1.0, 1.0)
        own = np.arange(b.size)
        out[:, b, own] = 0.0
        out[len(stiff) :, b, own] = heavy[:, b, b] / 2
        return out

    def columns(
        self, one: Evaluation, q: NDArray, p_out: NDArray, common: NDArray
    ) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """Displacements (k, o, i, f) that parts add which differ by the directions `common` (n_parts, k), and relative
        frequency changes (k, m_b) of band modes, which the displacements leave out.
        """
        every, moved = self.couplings(one)
        pushed = self._pushed(one, every, q, common)
        if self.first.size and one.e.is_base:
            pushed += self._carried(one, common)[:, :, None, None]
        seen = np.ascontiguousarray(np.swapaxes(p_out, 0, 1))  # (o, m, f)
        m, k = pushed.shape[:2]
        added = sums.across(seen, pushed.reshape(m, -1, one.s.size)).reshape(len(seen), k, -1, one.s.size)
        return -np.swapaxes(added, 0, 1), common.T @ moved

    def bent(self, one: Evaluation, q: NDArray, p_out: NDArray, parts: NDArray) -> Bent:
        """The modes' motions by the inputs q (m, i, f) and by which the outputs follow p_out (m, o, f), where parts
        differ by `parts` (n_parts,), frequencies of band modes left where they are; exactly.
        """
        every, _ = self.couplings(one)
        common, m = parts[:, None], len(q)
        eye = np.repeat(np.eye(m, dtype=complex)[..., None], one.s.size, axis=2)
        coupled = self._pushed(one, every, eye, common)[:, 0]  # (m, m, f)
        carried = np.zeros((m, 1, 1))
        if self.first.size and one.e.is_base:
            carried = self._carried(one, common)[:, :, None]
            q = q - one.following(carried * np.ones(one.s.size, complex))
        loop = np.moveaxis(one.following(coupled), 2, 0) + np.eye(m)
        both = np.linalg.solve(loop, np.moveaxis(np.concatenate([q, p_out], axis=1), 2, 0))
        both = np.ascontiguousarray(np.moveaxis(both, 0, 2))
        met = sums.across(coupled, both)
        n = q.shape[1]
        pushed = np.ascontiguousarray(met[:, :n] + carried)
        more = -sums.paired(p_out, pushed[None])[0]
        q, p_out, pulled = (np.ascontiguousarray(part, complex) for part in (both[:, :n], both[:, n:], met[:, n:]))
        return Bent(more, q, p_out, pushed, pulled)

    def _pushed(
        self, one: Evaluation, every: NDArray, motions: NDArray, common: NDArray
    ) -> NDArray[np.complex128]:  # fmt: skip
        """Modal forces (m, k, r, f) that parts take by motions (m, r, f) of the modes; `every` as of `couplings`."""
        s, e, h = one.s, one.e, float(one.point.law[0])
        middle = float(np.exp(np.mean(np.log(np.maximum(one.omega[e.band_modes], 1e-300)))))
        loss = 2 * float(np.exp(np.mean(one.point.log_zeta))) * ((1 - h) * s / middle + 1j * h)
        kinds, m, k = np.array(self.kinds), len(motions), common.shape[1]
        out = np.zeros((m, k, motions.shape[1], s.size), complex)
        for pick, factor in (
            (kinds == "stiffness", np.ones_like(s)),
            ((kinds == "loss") | (kinds == "zone"), loss),
            (kinds == "mass", s**2),
        ):
            if pick.any():
                mixed = (common[pick].T @ every[pick].reshape(-1, m * m)).reshape(k, m, m)
                mixed = np.swapaxes(mixed, 0, 1).reshape(m * k, m)
                for i, motion in enumerate(np.ascontiguousarray(np.swapaxes(motions, 0, 1))):
                    out[:, :, i] += sums.turned(mixed, motion[:, None] * factor).reshape(m, k, s.size)
        return out

    def _carried(self, one: Evaluation, common: NDArray) -> NDArray[np.float64]:
        """Modal forces (m, k) by base acceleration on masses that differ."""
        st, heavier = one.state, common[np.array(self.kinds) == "mass"]
        w = self.masses.T @ st.shape
        carried = np.add.reduceat(w * (self.masses.T @ st.rigid)[:, None], self.first, axis=0)
        return carried.T @ heavier


def _squares(w: NDArray, starts: NDArray) -> NDArray[np.float64]:
    """Sum over each part's columns of the squares of w (k, m): (n_parts, m, m)."""
    if not starts.size:
        return np.zeros((0, w.shape[1], w.shape[1]))
    return np.add.reduceat(w[:, :, None] * w[:, None, :], starts, axis=0)
