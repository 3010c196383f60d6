"""Damping by which the model's own modes act on each other: dashpots that stand where the model says.

Modal damping is free in a fit, one ratio a mode, and dashpots at some places, unlike damping that follows mass and
stiffness, couple the modes besides. What a model says of that is kept: without it, its own dashpots would be missing
physics.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import Group, Mechanism, Place, Site, Term
from labnnum.mechanisms.laws import Law, Local

if TYPE_CHECKING:
    from labnnum.diagnosis.engine import Engine
    from labnnum.diagnosis.point import State

LEAST = 1e-3
"""Share of a mode's response that another one adds to it, at the first one's resonance, from which they are coupled."""

MOST = 24
"""Modes that are coupled at most, the strongest ones."""


@dataclass(frozen=True, eq=False)
class _Off(Law):
    """Viscous damping s C between modes, (k, k), without what each has of its own."""

    viscous: NDArray[np.float64]
    names: ClassVar[tuple[str, ...]] = ()
    units: ClassVar[tuple[str, ...]] = ()

    def value(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """Shape (k, k, n_f)."""
        return self.viscous[..., None] * s

    def derivative(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """Nothing is varied: (0, k, k, n_f)."""
        return np.zeros((0, *self.viscous.shape, s.size), complex)

    def local(self, p: NDArray) -> Local:
        """Of the modal coordinates."""
        none = np.zeros_like(self.viscous)
        return none, self.viscous, none, none


class _Own(Mechanism):
    id = "modal-coupling"

    def terms(self, site: Site) -> Iterable[Term]:
        return ()


@dataclass(frozen=True, eq=False)
class Coupling:
    """The model's coupling as a term without parameters that acts on the motions of `modes` (k,).

    `damping` (b, b) is the model's in the nominal basis at its nominal parameters, `slopes` (n_par, b, b) what each
    parameter changes of it.
    """

    modes: NDArray[np.int64]
    term: Term
    damping: NDArray[np.float64]
    slopes: NDArray[np.float64]

    @classmethod
    def of(cls, engine: Engine) -> Coupling | None:
        """That of a model; None where damping leaves the modes within the band on their own."""
        structure, first = engine.structure, engine.state(engine.theta0)
        m, basis = structure.matrices(engine.theta0), engine.basis
        damping = basis.T @ np.real(m.C) @ basis
        own = engine.in_basis(first)[:-1]
        modes = _coupled(own.T @ damping @ own, first.omega, engine.seen_modes, engine.rigid_modes)
        if modes.size < 2:
            return None
        slopes = np.array([basis.T @ np.real(d.C) @ basis for d in structure.derivatives(engine.theta0)])
        some = own[:, modes]
        law = _Off(some.T @ damping @ some * _apart(modes.size))
        group = Group(law, np.real(m.M) @ first.shape[:, modes], 0)
        term = Term(_Own(), Place("global", "structure"), (), np.zeros((1, 0)), (group,))
        return cls(modes, term, damping, slopes.reshape(-1, *damping.shape))

    def at(self, engine: Engine, state: State, change: NDArray, omega: NDArray, zeta: NDArray) -> Coupled:
        """The coupling of the modes of `state`, the parameters `change` (n_par,) off, at `omega` and `zeta` (m,)."""
        own = engine.in_basis(state)[:-1]
        whole = own.T @ (self.damping + np.tensordot(change, self.slopes, 1)) @ own
        pick = np.ix_(self.modes, self.modes)
        mine = np.maximum(np.diag(whole)[self.modes], 1e-300)
        root = np.sqrt(2 * zeta[self.modes] * omega[self.modes] / mine)
        moved = np.swapaxes(state.mix, 1, 2) @ whole + whole @ state.mix
        moved[: change.size] += own.T @ self.slopes @ own
        some = moved[:, pick[0], pick[1]]
        eased, apart = np.outer(root, root), _apart(root.size)
        own_rates = np.diagonal(some, axis1=1, axis2=2) / mine
        return Coupled(whole[pick] * eased * apart, some * eased * apart, own_rates)


@dataclass(frozen=True, eq=False)
class Coupled:
    """Damping between modes, (k, k), where each has the damping of its own that a fit gives it, and as much of what the
    model lets two of them share: what damps less couples less.

    `slopes` (n_par, k, k) are its derivatives while factors by which modes damp more than the model says stay;
    `own_rates` (n_par, k) those of the logarithm of the model's own damping of each.
    """

    damping: NDArray[np.float64]
    slopes: NDArray[np.float64]
    own_rates: NDArray[np.float64]


def _apart(n: int) -> NDArray[np.bool_]:
    return ~np.eye(n, dtype=bool)


def _coupled(damping: NDArray, omega: NDArray, band: NDArray, rigid: int) -> NDArray[np.int64]:
    """Modes (k,) that `damping` (m, m) couples to those in `band`. The first `rigid` have no coupling: nothing holds
    their frequency.
    """
    w = np.where(np.arange(omega.size) < rigid, np.inf, omega)
    met = np.zeros_like(damping)  # of a response at b's resonance, what passes on to the other, over the response
    for b in band[band >= rigid]:
        own = damping * w[b]
        apart = np.hypot(w**2 - w[b] ** 2, np.diag(own))
        met[b] = np.abs(own[b]) / np.where(apart > 0, apart, np.inf)
        met[b, b] = 0.0
    strong = np.maximum(met.max(axis=0), met.max(axis=1))
    modes = np.sort(np.argsort(-strong, kind="stable")[:MOST])
    return modes[strong[modes] > LEAST]
