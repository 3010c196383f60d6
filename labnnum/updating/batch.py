"""FRFs and sensitivities of one structure at many parameter sets: the algebra of training sets, done all at once.

Three ways, chosen by what the structure is and checked against `labnnum.response` before use: elimination
vectorised over sets and lines (small structures), modal superposition (damping that does not couple modes; on a
reduced basis where there are many coordinates), and one set after the other (everything else).
"""

from __future__ import annotations

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
from labnnum.updating.engines import EliminationEngine, Engine, ModalEngine, Setting
from labnnum.updating.family import MatrixFamily
from labnnum.updating.modal_batch import Reduction, snapshot_basis

_SMALL = 24
_LARGE = 40
_ACCURATE = 1e-7
_REDUCED = 2e-5
_REPRODUCED = 1e-10


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
        held = _held_terms(structure, family)
        if held is None:
            return None, view
        for t, row in enumerate(family.coefficients[0]):
            loads[t, :, i] = -channel.sign * (family.filled(0, row) @ rigid + held[t])
    return Setting(family, view.omega, view.rows, loads), view


def _held_terms(structure: Structure, family: MatrixFamily) -> NDArray[np.float64] | None:
    """`Structure.held_load` in the family's terms, (n_terms, size); None where they do not reproduce it."""
    low, high = bounds(structure.parameters)
    some = np.random.default_rng(0).random((2 * len(family.powers) + 2, len(low)))
    theta = low + (high - low) * some
    held = np.array([structure.held_load(t) for t in theta])
    if not held.any():
        return np.zeros((len(family.powers), family.size))
    terms = family.terms(theta)
    made = np.linalg.lstsq(terms, held, rcond=None)[0]
    return made if np.abs(terms @ made - held).max() <= _REPRODUCED * np.abs(held).max() else None


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
