"""FRFs and sensitivities of one structure at many parameter sets: the algebra of training sets, done all at once.

Three ways, chosen by what the structure is and checked against `labnnum.response` before use: elimination
vectorised over sets and lines (small structures), modal superposition (damping that does not couple modes; on a
reduced basis where there are many coordinates), and one set after the other (everything else).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ModelError
from labnnum.parameters import Parameter, bounds
from labnnum.recording import Channel
from labnnum.response import ChannelView, frf, frf_sensitivity
from labnnum.structures.base import Structure
from labnnum.updating.elimination import Elimination
from labnnum.updating.family import MatrixFamily
from labnnum.updating.modal_batch import BatchModes, Reduction, snapshot_basis

_CELLS = 32768
"""Sets times lines that are worked on at once: what a processor's cache holds."""

_SMALL = 24
_LARGE = 40
_ACCURATE = 1e-7
_REDUCED = 2e-5


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


@final
@dataclass(frozen=True, eq=False)
class FrfBatch:
    """A structure, its channels and lines, ready for many parameter sets.

    Parameters
    ----------
    structure : Structure
    frequency : ndarray, shape (n_f,)
        Hz.
    outputs, inputs : sequence of Channel
    engine : Engine or None
        None computes one set after the other.
    power : ndarray of int, shape (n_out, n_in)
        Power of i omega between the engine's kernel and the FRF.
    carried : ndarray, shape (n_out, n_in)
        Part of the response that is the base's own motion.
    error : float
        Largest relative difference from `labnnum.response.frf` at the sets where they were compared.
    """

    structure: Structure
    frequency: NDArray[np.float64]
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    engine: Engine | None = None
    power: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))
    carried: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 0)))
    error: float = 0.0

    @classmethod
    def of(
        cls, structure: Structure, frequency: ArrayLike, outputs: Sequence[Channel], inputs: Sequence[Channel]
    ) -> FrfBatch:
        """The fastest way that agrees with `labnnum.response.frf` on these lines (Hz) and channels."""
        lines = np.asarray(frequency, float)
        plain = cls(structure, lines, tuple(outputs), tuple(inputs))
        setting, view = _setting(structure, lines, outputs, inputs)
        if setting is None or not structure.parameters:
            return plain
        for engine, allowed in _engines(setting):
            made = cls(structure, lines, tuple(outputs), tuple(inputs), engine, view.power, view.carried)
            error = made._difference()
            if error <= allowed:
                return cls(structure, lines, tuple(outputs), tuple(inputs), engine, view.power, view.carried, error)
        return plain

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free parameters of the structure."""
        return tuple(self.structure.parameters)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of one FRF: (n_out, n_in, n_f)."""
        return len(self.outputs), len(self.inputs), self.frequency.size

    def frf(self, theta: ArrayLike) -> NDArray[np.complex128]:
        """FRFs, shape (n, n_out, n_in, n_f), of parameter sets (n, n_parameters)."""
        rows = np.atleast_2d(np.asarray(theta, float))
        if self.engine is None:
            return np.array([frf(self.structure, t, self.frequency, self.outputs, self.inputs) for t in rows])
        return self._assembled(self.engine.kernel(rows))

    def sensitivity(self, theta: ArrayLike) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """FRFs and their derivatives, shape (n, n_parameters, n_out, n_in, n_f)."""
        rows = np.atleast_2d(np.asarray(theta, float))
        if self.engine is None:
            one = [frf_sensitivity(self.structure, t, self.frequency, self.outputs, self.inputs) for t in rows]
            return np.array([a for a, _ in one]), np.array([b for _, b in one])
        kernel, slope = self.engine.kernel_slope(rows)
        factor = self._factor()
        return self._assembled(kernel), slope if factor is None else slope * factor

    def _factor(self) -> NDArray | None:
        if not self.power.any():
            return None
        return (2j * np.pi * self.frequency) ** self.power[:, :, None]

    def _assembled(self, kernel: NDArray) -> NDArray[np.complex128]:
        factor = self._factor()
        out = kernel if factor is None else kernel * factor
        held = self.carried != 0
        if held.any():
            s = 2j * np.pi * self.frequency
            out[:, held] += self.carried[held][:, None] * s ** (self.power[held][:, None] - 2)
        return out

    def _difference(self, sets: int = 4, seed: int = 3) -> float:
        """Largest error relative to |H|, or to a thousandth of its largest value where |H| is smaller."""
        low, high = bounds(self.structure.parameters)
        theta = low + (high - low) * np.random.default_rng(seed).random((sets, low.size))
        with np.errstate(all="ignore"):
            found = self.frf(theta)
        worst = 0.0
        for t, h in zip(theta, found, strict=True):
            exact = frf(self.structure, t, self.frequency, self.outputs, self.inputs)
            size = np.maximum(np.abs(exact), 1e-3 * np.abs(exact).max(axis=-1, keepdims=True))
            gap = np.abs(h - exact) / np.where(size > 0, size, 1.0)
            worst = max(worst, float(np.where(np.isfinite(gap), gap, np.inf).max()))
        return worst


def _setting(
    structure: Structure, lines: NDArray, outputs: Sequence[Channel], inputs: Sequence[Channel]
) -> tuple[Setting | None, ChannelView]:
    """The family with rows and loads; None where polynomials or fixed places do not describe the structure."""
    view = ChannelView(structure, structure.nominal, lines, outputs, inputs)
    plain = type(structure).chain is Structure.chain and type(structure).base_load is Structure.base_load
    if not plain or not structure.parameters:
        return None, view
    other = structure.nominal + 0.3 * (bounds(structure.parameters)[1] - structure.nominal) + 1e-3
    places = [c.dof for c in (*outputs, *inputs) if c.role != "base"]
    fixed = all(np.array_equal(structure.participation(d, structure.nominal), structure.participation(d, other))
                for d in places)  # fmt: skip
    family = MatrixFamily.of(structure) if fixed else None
    if family is None:
        return None, view
    loads = np.zeros((len(family.powers), family.size, len(inputs)))
    for i, channel in enumerate(inputs):
        if channel.role != "base":
            loads[0, :, i] = view.loads[:, i]
            continue
        rigid = structure.rigid(structure.nominal)
        if not np.array_equal(rigid, structure.rigid(other)):
            return None, view
        for t, row in enumerate(family.coefficients[0]):
            loads[t, :, i] = -channel.sign * (family.filled(0, row) @ rigid)
    return Setting(family, view.omega, view.rows, loads), view


def _engines(setting: Setting):
    """Engines worth trying, each with the error that it may show."""
    size = setting.family.size
    if size <= _SMALL:
        yield EliminationEngine.of(setting), _ACCURATE
    modal = _modal(setting, np.eye(size))
    if modal is None:
        return
    if size > _LARGE:
        for tolerance in (1e-5, 1e-6, 1e-7, 1e-9, 1e-11):
            basis = _reduced_basis(setting, tolerance)
            if basis.shape[1] < size:
                yield ModalEngine(setting, Reduction.of(setting.family, basis)), _REDUCED
    yield modal, _ACCURATE


def _modal(setting: Setting, basis: NDArray) -> ModalEngine | None:
    """Superposition, where damping leaves the modes uncoupled at some parameter sets."""
    engine = ModalEngine(setting, Reduction.of(setting.family, basis))
    family = setting.family
    theta = family.centre + family.half * np.random.default_rng(1).uniform(-0.8, 0.8, (3, family.centre.size))
    try:
        return engine if engine.modes(theta).superposes else None
    except (np.linalg.LinAlgError, ModelError):  # no positive mass matrix: superposition does not apply
        return None


def _reduced_basis(setting: Setting, tolerance: float) -> NDArray[np.float64]:
    family, omega = setting.family, setting.omega
    share = np.random.default_rng(2).uniform(-0.9, 0.9, (12, family.centre.size))
    columns = np.hstack([setting.rows.T, *setting.loads])
    columns = columns[:, columns.any(axis=0)]
    return snapshot_basis(
        family, family.centre + family.half * share, columns, np.linspace(omega[0], omega[-1], 24), tolerance
    )
