"""Structures whose matrices come from elsewhere, such as a finite element program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter
from labnnum.recording import DIRECTIONS, readonly
from labnnum.structures.base import Matrices, Structure
from labnnum.structures.quantities import Damping, Values, check_names, modal_basis


@final
@dataclass(frozen=True, eq=False)
class MatrixStructure(Structure):
    """Matrices that are linear in the parameters about the nominal ones: M = M0 + sum (theta_j - nominal_j) dM_j.

    Parameters
    ----------
    M0, K0 : array_like, shape (n, n)
        Symmetric mass and stiffness at the nominal parameters, SI units.
    all_dofs : sequence of str
        "node:direction" of each row; directions x, y, z, rx, ry, rz.
    C0 : array_like, shape (n, n), or None
        Damping matrix; used where damping is of kind "matrix".
    dM, dK, dC : mapping
        Parameter name -> derivative, shape (n, n); absent means zero. dC counts with damping of kind "matrix" only.
    parameters : sequence of Parameter
        Each must have a derivative or be named by `damping`.
    damping : Damping
    base : str
        x, y or z where all supports are driven together in that direction; else empty.
    clamped : sequence of str
        Nodes whose rows, if there are any, are removed: they are held, or driven by the base.
    positions : mapping
        Node -> x, y, z in m; optional.
    pairs : sequence of (str, str)
        Nodes that an element joins; optional.
    carried : sequence of str
        Further nodes at which the structure is supported, elastically.

    References
    ----------
    Atalla (1996), equation 2.20.
    """

    M0: ArrayLike
    K0: ArrayLike
    all_dofs: tuple[str, ...]
    C0: ArrayLike | None = None
    dM: Mapping[str, ArrayLike] = field(default_factory=dict)
    dK: Mapping[str, ArrayLike] = field(default_factory=dict)
    dC: Mapping[str, ArrayLike] = field(default_factory=dict)
    parameters: tuple[Parameter, ...] = ()
    damping: Damping = field(default_factory=Damping)
    base: str = ""
    clamped: tuple[str, ...] = ()
    positions: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    pairs: tuple[tuple[str, str], ...] = ()
    carried: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("parameters", "clamped", "carried"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "all_dofs", tuple(str(d) for d in self.all_dofs))
        object.__setattr__(self, "pairs", tuple((str(a), str(b)) for a, b in self.pairs))
        if self.base not in ("", "x", "y", "z"):
            raise ConfigError(f"base = {self.base!r}: expected x, y, z or nothing")
        self._check_dofs()
        self._check_matrices()
        moved = [p.name for p in self.parameters if any(p.name in d for d in (self.dM, self.dK, self._dC))]
        check_names("model's matrices and damping", self.parameters, [*moved, *self.damping.quantities])

    def _check_dofs(self) -> None:
        for dof in self.all_dofs:
            if dof.partition(":")[2] not in DIRECTIONS or not dof.partition(":")[0]:
                raise ConfigError(f'dofs: {dof!r} is not "node:direction" with one of {", ".join(DIRECTIONS)}')
        if len(set(self.all_dofs)) < len(self.all_dofs):
            twice = next(d for d in self.all_dofs if self.all_dofs.count(d) > 1)
            raise ConfigError(f"dofs: {twice!r} stands there twice")
        if not self._kept.size:
            raise ConfigError("dofs: nothing is left once the clamped nodes are removed")

    def _check_matrices(self) -> None:
        n = len(self.all_dofs)
        groups = (("dM_", self.dM), ("dK_", self.dK), ("dC_", self.dC))
        named = {"M0": self.M0, "K0": self.K0} | {p + k: a for p, d in groups for k, a in d.items()}
        if self.C0 is not None:
            named["C0"] = self.C0
        for name, array in named.items():
            a = np.asarray(array)
            if a.shape != (n, n):
                raise ConfigError(f"matrix {name} has shape {a.shape}: expected {(n, n)}, a row for each of dofs")
            if not np.isfinite(a).all():
                raise ConfigError(f"matrix {name} is not finite")
            if "C" not in name and np.abs(a - a.T).max() > 1e-6 * np.abs(a).max():
                raise ConfigError(f"matrix {name} is not symmetric")

    @cached_property
    def _kept(self) -> NDArray[np.intp]:
        return np.flatnonzero([d.partition(":")[0] not in self.clamped for d in self.all_dofs])

    @property
    def _dC(self) -> Mapping[str, ArrayLike]:
        return self.dC if self.damping.kind == "matrix" else {}

    def _cut(self, a: ArrayLike | None, symmetric: bool = True) -> NDArray[np.float64]:
        if a is None:
            return readonly(np.zeros((self._kept.size, self._kept.size)))
        part = np.asarray(a, float)[np.ix_(self._kept, self._kept)]
        return readonly((part + part.T) / 2 if symmetric else part)

    @cached_property
    def _at_nominal(self) -> tuple[NDArray, NDArray, NDArray]:
        held = self.C0 if self.damping.kind == "matrix" else None
        return self._cut(self.M0), self._cut(self.K0), self._cut(held, symmetric=False)

    @cached_property
    def _slopes(self) -> tuple[tuple[NDArray | None, NDArray | None, NDArray | None], ...]:
        return tuple(
            (
                self._cut(self.dM[p.name]) if p.name in self.dM else None,
                self._cut(self.dK[p.name]) if p.name in self.dK else None,
                self._cut(self._dC[p.name], symmetric=False) if p.name in self._dC else None,
            )
            for p in self.parameters
        )

    @cached_property
    def dofs(self) -> tuple[str, ...]:
        """Rows that are left when the clamped nodes are removed."""
        return tuple(self.all_dofs[i] for i in self._kept)

    @property
    def nodes(self) -> Mapping[str, tuple[float, float, float]]:
        """Positions if they were given."""
        return self.positions

    @property
    def elements(self) -> tuple[tuple[str, str], ...]:
        """Pairs if they were given."""
        return self.pairs

    @property
    def supports(self) -> tuple[str, ...]:
        """Clamped nodes, then those that are carried elastically."""
        return tuple(dict.fromkeys([*self.clamped, *self.carried]))

    def released(self, node: str) -> Structure | None:
        """The structure with this node's rows kept."""
        if node not in self.clamped:
            return None
        return replace(self, clamped=tuple(n for n in self.clamped if n != node))

    def held_load(self, theta: NDArray) -> NDArray:
        """What the clamped nodes push the rest by as they move with the base, through the mass that joins them."""
        held = np.setdiff1d(np.arange(len(self.all_dofs)), self._kept)
        moved = np.array([float(self.all_dofs[i].partition(":")[2] == self.base) for i in held])
        change = dict(zip((p.name for p in self.parameters), np.asarray(theta) - self.nominal, strict=True))
        mass = sum((change[name] * np.asarray(dm, float) for name, dm in self.dM.items()), np.asarray(self.M0, float))
        return mass[np.ix_(self._kept, held)] @ moved

    @cached_property
    def _basis(self) -> NDArray[np.float64] | None:
        mass, stiffness, _ = self._at_nominal
        return modal_basis(mass, stiffness) if self.damping.kind == "modal" else None

    def matrices(self, theta: NDArray) -> Matrices:
        """M, C, K, D at theta."""
        values = Values(self.parameters, theta)
        change = np.asarray(theta) - self.nominal
        mass, stiffness, viscous = self._at_nominal
        for delta, (dm, dk, dc) in zip(change, self._slopes, strict=True):
            mass = mass if dm is None else mass + delta * dm
            stiffness = stiffness if dk is None else stiffness + delta * dk
            viscous = viscous if dc is None else viscous + delta * dc
        viscous = viscous + self.damping.viscous(values, mass, stiffness, self._basis)
        return Matrices(mass, viscous, stiffness, self.damping.loss(values, stiffness))

    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """Unit row; zeros at a support that moves with the base."""
        row = np.zeros(self._kept.size)
        node, _, way = dof.partition(":")
        if node in self.clamped and way == self.base:
            return row
        row[self.require_dof(dof)] = 1.0
        return row

    def rigid(self, theta: NDArray) -> NDArray:
        """Unit translation of every row in the base's direction."""
        if not self.base:
            raise ModelError("the model has no base excitation: set base to x, y or z in [structure]")
        return np.array([float(d.partition(":")[2] == self.base) for d in self.dofs])
