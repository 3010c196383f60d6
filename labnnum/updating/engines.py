"""How rows Z^-1 loads are computed for many parameter sets at once: elimination, or superposition of modes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.updating.elimination import Elimination
from labnnum.updating.family import MatrixFamily
from labnnum.updating.modal_batch import BatchModes, Reduction

_CELLS = 32768
"""Sets times lines that are worked on at once: what a processor's cache holds."""


@dataclass(frozen=True, eq=False)
class Setting:
    """A family with the rows and loads of its channels.

    Parameters
    ----------
    family : MatrixFamily
    omega : ndarray, shape (n_lines,)
        rad/s.
    rows : ndarray, shape (n_out, size)
    loads : ndarray, shape (n_terms, size, n_in)
        Loads as polynomials of the parameters: constant forces, or -M r under base excitation.
    """

    family: MatrixFamily
    omega: NDArray[np.float64]
    rows: NDArray[np.float64]
    loads: NDArray[np.float64]


class Engine(ABC):
    """A way to compute rows Z^-1 loads for many parameter sets."""

    @abstractmethod
    def kernel(self, theta: NDArray) -> NDArray[np.complex128]:
        """Shape (n_sets, n_out, n_in, n_lines)."""

    @abstractmethod
    def kernel_slope(self, theta: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """The kernel and its derivatives, shape (n_sets, n_parameters, n_out, n_in, n_lines)."""


@final
@dataclass(frozen=True, eq=False)
class EliminationEngine(Engine):
    """Symmetric elimination, all sets and lines at once."""

    setting: Setting
    plan: Elimination
    varies: tuple[NDArray[np.bool_], ...]
    where: tuple[dict[tuple[int, int], int], ...]

    @classmethod
    def of(cls, setting: Setting) -> EliminationEngine:
        """With the coordinates that parameters or channels touch eliminated last."""
        family = setting.family
        entries = {(int(i), int(j)) for places in family.places for i, j in places}
        touched = {int(c) for c in np.flatnonzero(setting.rows.any(axis=0) | setting.loads.any(axis=(0, 2)))}
        for places, varies in zip(family.places, family.varies(), strict=True):
            touched.update(int(c) for c in places[varies].ravel())
        plan = Elimination.of(family.size, frozenset(entries), frozenset(touched))
        where = tuple({(int(i), int(j)): n for n, (i, j) in enumerate(p)} for p in family.places)
        return cls(setting, plan, family.varies(), where)

    def kernel(self, theta: NDArray) -> NDArray[np.complex128]:
        """By one factorisation for all inputs."""
        return np.concatenate([self._block(part)[0] for part in self._parts(theta)])

    def kernel_slope(self, theta: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """By responses to inputs and to rows, from one factorisation."""
        both = [self._block(part, slopes=True) for part in self._parts(theta)]
        return np.concatenate([a for a, _ in both]), np.concatenate([b for _, b in both if b is not None])

    def _parts(self, theta: NDArray) -> list[NDArray]:
        step = max(1, _CELLS // self.setting.omega.size)
        return [theta[i : i + step] for i in range(0, len(theta), step)]

    def _block(self, theta: NDArray, slopes: bool = False) -> tuple[NDArray, NDArray | None]:
        s, family = self.setting, self.setting.family
        terms = family.terms(theta)
        factors = self.plan.factor(self._cells(family.entries(theta)))
        touched = self._touched() if slopes else frozenset()
        loads = np.einsum("st,tci->sci", terms, s.loads)
        ins = [
            factors.solve(_columns(loads[:, :, i]), touched | frozenset(np.flatnonzero(s.rows.any(axis=0)).tolist()))
            for i in range(loads.shape[2])
        ]
        shape = (len(theta), len(s.rows), len(ins), s.omega.size)
        kernel = np.zeros(shape, complex)
        for o, row in enumerate(s.rows):
            for i, x in enumerate(ins):
                for c in np.flatnonzero(row):
                    kernel[:, o, i] += row[c] * x[int(c)]
        if not slopes:
            return kernel, None
        outs = [
            factors.solve(_columns(row[None]), touched | frozenset(np.flatnonzero(s.loads.any(axis=(0, 2))).tolist()))
            for row in s.rows
        ]
        return kernel, self._slopes(theta, ins, outs, shape)

    def _cells(self, entries: tuple[NDArray, ...]):
        omega = self.setting.omega
        factor = (-(omega**2), 1j * omega, np.ones_like(omega), np.full_like(omega, 1j, complex))
        varies, where = self.varies, self.where

        def cell(i: int, j: int) -> NDArray:
            total: NDArray = np.zeros((1, 1))
            for kind in range(4):
                n = where[kind].get((i, j))
                if n is not None:
                    column = entries[kind][:, n] if varies[kind][n] else entries[kind][:1, n]
                    total = total + column[:, None] * factor[kind]
            return total

        return cell

    def _touched(self) -> frozenset[int]:
        """Coordinates that any derivative of the matrices touches."""
        out: set[int] = set()
        for places, varies in zip(self.setting.family.places, self.setting.family.varies(), strict=True):
            out.update(int(c) for c in places[varies].ravel())
        return frozenset(out)

    def _slopes(self, theta: NDArray, ins: list, outs: list, shape: tuple[int, ...]) -> NDArray[np.complex128]:
        s, family = self.setting, self.setting.family
        omega = s.omega
        factor = (-(omega**2), 1j * omega, np.ones_like(omega), np.full_like(omega, 1j, complex))
        slopes = family.term_slopes(theta)
        out = np.zeros((shape[0], len(slopes), *shape[1:]), complex)
        for j, terms in enumerate(slopes):
            cells: dict[tuple[int, int], NDArray] = {}
            for kind, (places, c) in enumerate(zip(family.places, family.coefficients, strict=True)):
                entries = terms @ c
                for n in np.flatnonzero(entries.any(axis=0)):
                    key = (int(places[n, 0]), int(places[n, 1]))
                    cells[key] = cells.get(key, 0.0) + entries[:, n, None] * factor[kind]
            loads = np.einsum("st,tci->sci", terms, s.loads)
            for o, y in enumerate(outs):
                for i, x in enumerate(ins):
                    out[:, j, o, i] = _between(y, cells, x) + _along(y, loads[:, :, i])
        return out


def _columns(load: NDArray) -> dict[int, NDArray | float]:
    """Loads (n_sets or 1, size) by coordinate, without those that are zero."""
    out: dict[int, NDArray | float] = {}
    for c in np.flatnonzero(load.any(axis=0)):
        column = load[:, c, None]
        out[int(c)] = column[:1] if (column == column[0]).all() else column
    return out


def _between(y: dict[int, NDArray], cells: dict[tuple[int, int], NDArray], x: dict[int, NDArray]) -> NDArray | float:
    total: NDArray | float = 0.0
    for (i, j), cell in cells.items():
        pair = y[i] * x[j] if i == j else y[i] * x[j] + y[j] * x[i]
        total = total - cell * pair
    return total


def _along(y: dict[int, NDArray], load: NDArray) -> NDArray | float:
    total: NDArray | float = 0.0
    for c in np.flatnonzero(load.any(axis=0)):
        total = total + y[int(c)] * load[:, c, None]
    return total


@final
@dataclass(frozen=True, eq=False)
class ModalEngine(Engine):
    """Superposition of the modes of each set, on a basis that may be smaller than the structure."""

    setting: Setting
    reduction: Reduction

    def kernel(self, theta: NDArray) -> NDArray[np.complex128]:
        """Sum over modes."""
        return np.concatenate([self._block(part)[0] for part in self._parts(theta)])

    def kernel_slope(self, theta: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Sums over pairs of modes."""
        both = [self._block(part, slopes=True) for part in self._parts(theta)]
        return np.concatenate([a for a, _ in both]), np.concatenate([b for _, b in both if b is not None])

    def modes(self, theta: NDArray) -> BatchModes:
        """Modes of the sets."""
        return BatchModes.of(*self.reduction.at(self.setting.family.terms(theta)))

    def _parts(self, theta: NDArray) -> list[NDArray]:
        step = max(1, 6 * _CELLS // (self.setting.omega.size * self.reduction.basis.shape[1]))
        return [theta[i : i + step] for i in range(0, len(theta), step)]

    def _block(self, theta: NDArray, slopes: bool = False) -> tuple[NDArray, NDArray | None]:
        s, basis = self.setting, self.reduction.basis
        terms = s.family.terms(theta)
        modes = BatchModes.of(*self.reduction.at(terms))
        left = (s.rows @ basis) @ modes.shape
        loads = np.einsum("st,tni->sni", terms, np.einsum("cn,tci->tni", basis, s.loads))
        right = modes.shape.swapaxes(-1, -2) @ loads
        real, imaginary = modes.responses(s.omega)
        pairs = (left[:, :, None, :] * right.swapaxes(-1, -2)[:, None]).reshape(len(theta), -1, real.shape[1])
        kernel = np.empty((len(theta), pairs.shape[1], s.omega.size), complex)
        kernel.real, kernel.imag = pairs @ real, pairs @ imaginary
        kernel = kernel.reshape(len(theta), len(s.rows), -1, s.omega.size)
        return kernel, self._slopes(theta, modes, left, right, real + 1j * imaginary) if slopes else None

    def _slopes(
        self, theta: NDArray, modes: BatchModes, left: NDArray, right: NDArray, response: NDArray
    ) -> NDArray[np.complex128]:
        s, basis = self.setting, self.reduction.basis
        omega = s.omega
        factor = (-(omega**2), 1j * omega, 1.0, 1j)
        x = right.swapaxes(-1, -2)[..., None] * response[:, None]
        y = left[..., None] * response[:, None]
        reduced_loads = np.einsum("cn,tci->tni", basis, s.loads)
        slopes = s.family.term_slopes(theta)
        shape = (len(theta), len(slopes), y.shape[1], x.shape[1], omega.size)
        out = np.zeros(shape, complex)
        for j, terms in enumerate(slopes):
            for kind, projected in enumerate(self.reduction.terms):
                if not projected.any() or not terms.any():
                    continue
                turned = modes.shape.swapaxes(-1, -2) @ np.tensordot(terms, projected, axes=(1, 0)) @ modes.shape
                if turned.any():
                    moved = turned[:, None] @ np.real(x) + 1j * (turned[:, None] @ np.imag(x))
                    out[:, j] -= factor[kind] * np.einsum("sonf,sinf->soif", y, moved)
            load = modes.shape.swapaxes(-1, -2) @ np.einsum("st,tni->sni", terms, reduced_loads)
            if load.any():
                out[:, j] += np.einsum("sonf,sni->soif", y, load)
        return out
