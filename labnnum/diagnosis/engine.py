"""Fast, exact responses of a structure with terms added to it, and their derivatives.

The structure is taken to the modes of its nominal matrices; at each parameter value a small eigenproblem gives the
modes there. Modal damping is free, one ratio a mode. A term that acts on few motions enters through the receptances
at those motions (Sherman-Morrison-Woodbury), so that a trial costs no factorisation. Everything is evaluated at
complex s, so that exponential windows and broadened resonances need no code of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis import sums
from labnnum.diagnosis.affine import affine
from labnnum.diagnosis.attached import Attached
from labnnum.diagnosis.changed import Changed, changed, eigen
from labnnum.diagnosis.coupling import Coupling
from labnnum.diagnosis.evaluation import Evaluation
from labnnum.diagnosis.irregular import Irregular
from labnnum.diagnosis.mesh import FINE, Inside
from labnnum.diagnosis.point import Point, Response, State
from labnnum.diagnosis.remainder import Remainder
from labnnum.errors import ChannelError, ModelError
from labnnum.frf import MOTION_ORDER
from labnnum.mechanisms.base import Site, Term
from labnnum.mechanisms.changes import Change, Freed
from labnnum.mechanisms.geometry import held_motions, touching
from labnnum.mechanisms.let_go import LetGo
from labnnum.recording import Channel
from labnnum.structures.base import Structure
from labnnum.structures.modal import ModalStructure

REACH = 2.5
"""Modes up to so many times the band are kept; those above enter quasi-statically (`remainder`)."""

NEAR = 1.6
"""Modes up to so many times the band have errors of their own: their flanks still reach into it."""


ABOVE = 2
"""Modes next above those whose motions at the sensors have errors of their own too: where a row all but vanishes by
symmetry, a share of what they contribute to it says nothing."""


def _massless(mass: NDArray) -> bool:
    """Whether some motion has no mass but what rounding leaves of it, such as that of a massless support let go."""
    size = np.sqrt(np.maximum(np.diag(mass), 1e-300))
    return float(np.diag(np.linalg.cholesky(mass / np.outer(size, size))).min()) < 1e-7


class Engine:
    """Responses of `structure` at `outputs` to `inputs` up to `omega_max`, with any terms added."""

    def __init__(
        self, structure: Structure, outputs: Sequence[Channel], inputs: Sequence[Channel], band: tuple[float, float]
    ) -> None:
        self.structure = structure
        self.outputs, self.inputs = tuple(outputs), tuple(inputs)
        self.band = band
        self.is_base = any(c.role == "base" for c in self.inputs)
        self.theta0 = structure.nominal
        m = structure.matrices(self.theta0)
        self._basis(np.real(m.M), np.real(m.K))
        self.held = held_motions(structure)
        self.held_load = self._load_of_supports(np.real(m.M))
        if self.is_base and len(self.inputs) > 1:
            raise ModelError("base motion and force at the same time are not supported: import them as separate runs")
        dofs = [c.dof for c in (*self.outputs, *self.inputs) if c.role != "base"]
        self._affine = affine(structure, dofs, self.basis, self.is_base)
        self.remainder = Remainder(structure, self.high, self._affine)
        self._cache: dict[tuple, State] = {}
        self._gone: dict[tuple[int, ...], LetGo | None] = {}
        self._seen: dict[bytes, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
        self._share: tuple[tuple, NDArray[np.complex128]] | None = None
        self._evaluated: tuple[tuple, Evaluation, tuple[Term, ...]] | None = None
        self._taken: dict[bytes, NDArray[np.complex128]] = {}
        self._lifts: dict[bytes, NDArray[np.complex128]] = {}
        self._attached: dict[tuple[int, ...], tuple[Attached, tuple[Term, ...]]] = {}
        self._grids: dict[tuple[int, int, int], tuple] = {}
        self._turns: dict[tuple[float, float], NDArray[np.float64]] = {}
        odd = next((c for c in self.outputs if c.quantity not in MOTION_ORDER), None)
        if odd is not None:
            raise ChannelError(f"channel {odd.name!r} measures {odd.quantity}: a response of a model is a motion")
        self.rise = np.array([MOTION_ORDER[c.quantity] for c in self.outputs])
        self.sign_out = np.array([c.sign for c in self.outputs])
        self.sign_in = np.array([c.sign for c in self.inputs])
        self._nominal_shape: NDArray[np.float64] | None = None
        first = self.state(self.theta0)
        self._nominal_shape = first.shape.T @ np.real(m.M)
        low, high = band
        self.keep = first.omega.size
        self.rigid_modes = int(np.count_nonzero(first.omega < 1e-6 * max(first.omega.max(), 1e-300)))
        self.n_law = 2 if 0 < self.rigid_modes < first.omega.size else 1
        self.elastic = float(first.omega[self.rigid_modes]) if self.n_law == 2 else 0.0
        inside = (first.omega > 0.6 * low) & (first.omega < NEAR * high)
        inside[: self.rigid_modes] = False
        if not inside.any():
            inside[self.rigid_modes : self.rigid_modes + 1] = True
        self.band_modes = np.flatnonzero(inside)
        self.seen_modes = self.band_modes[
            first.omega[self.band_modes] < max(1.1 * high, first.omega[self.band_modes[0]])
        ]
        if not self.seen_modes.size:
            self.seen_modes = self.band_modes[:1]
        self.outside_modes = np.setdiff1d(np.arange(first.omega.size), self.band_modes)
        higher = self.outside_modes[first.omega[self.outside_modes] > first.omega[self.band_modes].max()]
        identified = isinstance(structure, ModalStructure)  # its mode above the band stands for all that lie there
        self.modes_above = higher[np.argsort(first.omega[higher])][: 0 if identified else ABOVE]
        self.zeta0 = self._damping(first)
        self.high_zeta = self._damping_above()
        self._sizes(first)
        self.finer: bool | None = None
        self.coupling: Coupling | None = None

    def _load_of_supports(self, mass: NDArray) -> NDArray[np.float64]:
        """Mass (n,) by which base motion loads the coordinates besides what they carry along: that of supports that
        hold, and of those that the structure itself lets go.
        """
        if not self.is_base or type(self.structure).base_load is Structure.base_load:
            return sum((h.free_load for h in self.held.values()), np.zeros(len(mass)))
        whole = np.real(self.structure.base_load(self.theta0))
        return whole - mass @ np.real(self.structure.rigid(self.theta0))

    def _sizes(self, first: State) -> None:
        """Typical motion of each band mode, (m_b,), and of its load: what errors are relative to."""
        b = self.band_modes
        kinds = {c.dof.split(":")[1][0] == "r" for c in self.outputs}
        rows = [d for d in self.structure.dofs if (d.split(":")[1][0] == "r") in kinds]
        moved = np.array([self.participation(d, self.theta0) for d in rows]) @ first.shape[:, b]
        self.typical = np.sqrt(np.mean(moved**2, axis=0))
        if self.is_base:
            total = float(np.sqrt(np.mean(first.load[b] ** 2)))
            self.load_typical = np.maximum(np.abs(first.load[b]).max(axis=1), 0.3 * total)
        else:
            self.load_typical = np.maximum(self.typical, np.abs(first.load[b]).max(axis=1))

    def _basis(self, mass: NDArray, stiffness: NDArray) -> None:
        from scipy.linalg import LinAlgError, eigh

        n = mass.shape[0]
        try:
            value, vector = eigh(stiffness, mass)
            if _massless(mass):
                raise LinAlgError
        except LinAlgError:
            raise ModelError("the model's mass matrix is not positive definite at the nominal parameters") from None
        if value.min() < -1e-6 * value.max():
            raise ModelError("the model's stiffness matrix is not positive semidefinite at the nominal parameters")
        omega = np.sqrt(np.maximum(value, 0))
        inside = int(np.count_nonzero(omega < REACH * self.band[1]))
        use = min(n, max(inside + 3, 12))
        self.basis = vector[:, :use]
        high = vector[:, use:] / np.where(omega[use:] > 0, omega[use:], np.inf)
        self.high = high  # columns phi / omega: the static remainder is high @ high.T at the nominal parameters
        self.high_omega = omega[use:]
        self.high_softness = np.where(omega[use:] > 0, 1.0 / np.maximum(omega[use:], 1e-300), 0.0) ** 2
        self._onto_basis = np.vstack([self.basis.T @ mass, np.zeros(n)])

    def _damping(self, first: State) -> NDArray[np.float64]:
        m = self.structure.matrices(self.theta0)
        c = np.einsum("nm,nk,km->m", first.shape, np.real(m.C), first.shape)
        d = np.einsum("nm,nk,km->m", first.shape, np.real(m.D), first.shape)
        w = np.where(first.omega > 0, first.omega, np.inf)
        return np.clip(c / (2 * w) + d / (2 * w**2), 1e-5, 0.9)

    def _damping_above(self) -> NDArray[np.float64]:
        """Damping ratios (h,) of the modes above the basis at the nominal parameters."""
        m, high = self.structure.matrices(self.theta0), self.high
        c, d = (np.einsum("nh,nh->h", np.real(a) @ high, high) for a in (m.C, m.D))
        return np.clip(0.5 * (c * self.high_omega + d), 1e-5, 0.9)

    def followed(self, log_zeta: NDArray) -> float:
        """Factor by which the damping of modes beside the band follows that of those in it, `log_zeta` (m_b,)."""
        return float(np.exp(np.mean(log_zeta - np.log(self.zeta0[self.band_modes]))))

    @property
    def high_losses(self) -> tuple[NDArray, NDArray]:
        """Of the modes above the basis, (h,) each: damping ratio over frequency, and damping ratio."""
        return self.high_zeta / self.high_omega, self.high_zeta

    # ---------------------------------------------------------------- states

    def state(self, theta: NDArray, changes: Sequence[tuple[Change, NDArray]] = ()) -> State:
        """Modes and projections at `theta`, with changes of the whole structure at their parameters.

        The last few are remembered. Derivatives to the changes' parameters follow those to theta.
        """
        theta = np.asarray(theta, float)
        key = (theta.tobytes(), *((id(c), np.asarray(p, float).tobytes()) for c, p in changes))
        if key not in self._cache:
            if len(self._cache) > 24:
                self._cache.pop(next(iter(self._cache)))
            self._cache[key] = self._state(theta, changes)
        return self._cache[key]

    def _changed(self, theta: NDArray, changes: Sequence[tuple[Change, NDArray]]) -> Changed:
        """The matrices, coordinates of supports that were let go appended, and their derivatives."""
        if self._affine is not None:
            mass, stiffness = self._affine.at(theta)
            slopes = list(self._affine.slopes)
        else:
            m = self.structure.matrices(theta)
            mass, stiffness = np.real(m.M), np.real(m.K)
            slopes = [(np.real(d.M), np.real(d.K)) for d in self.structure.derivatives(theta)]
        gone = self._let_go(tuple(c for c, _ in changes if isinstance(c, Freed)))
        return changed(mass, stiffness, slopes, changes, theta - self.theta0, self._nominal_mass, gone)

    def _let_go(self, freed: tuple[Freed, ...]) -> LetGo | None:
        """The structure with these supports let go; remembered."""
        key = tuple(id(c) for c in freed)
        if key not in self._gone:
            self._gone[key] = LetGo.of(self.structure, freed)
        return self._gone[key]

    @cached_property
    def _nominal_mass(self) -> NDArray[np.float64]:
        return np.real(self.structure.matrices(self.theta0).M)

    def _state(self, theta: NDArray, changes: Sequence[tuple[Change, NDArray]]) -> State:
        v, n = self.basis, len(self.basis)
        quick = self._affine if not changes else None
        made = None if quick and not self.is_base else self._changed(theta, changes)
        if quick:
            value, own = eigen(*quick.reduced(theta), theta)
            shape = v @ own
        elif changes:  # they bend the elements themselves, which the nominal low modes do not span
            assert made is not None
            value, own = eigen(made.mass, made.stiffness, theta, v.shape[1])
            shape = own[:n] + made.static @ own[n:]
        else:
            assert made is not None
            value, own = eigen(v.T @ made.mass @ v, v.T @ made.stiffness @ v, theta)
            shape = v @ own
        turned = self._turned(shape)
        own, shape = own * turned, shape * turned
        whole = own if changes else shape
        sensors, drives = self._rows(theta)
        out = shape.T @ sensors.T
        omega = np.sqrt(np.maximum(value, 0))
        if quick:
            around, (heavy, firm) = own, quick.small_slopes
        else:
            assert made is not None
            around = whole
            every = np.array(made.slopes).reshape(-1, 2, *made.mass.shape)
            heavy, firm = np.ascontiguousarray(every[:, 0]), np.ascontiguousarray(every[:, 1])
        n_par = len(heavy)
        d_log, mix = sums.mode_derivatives(heavy, firm, np.ascontiguousarray(around), value)
        if self.is_base:
            assert made is not None
            r = np.real(self.structure.rigid(theta))
            moved = np.pad(r, (0, len(made.mass) - n))
            pushed = made.mass @ moved + np.concatenate([self.held_load, made.own_load])
            load = -(whole.T @ pushed)[:, None]
            high_in = -(pushed[:n] @ self.high)[None]
            d_load = np.array([-(whole.T @ (dm @ moved))[:, None] for dm, _ in made.slopes])
            d_load = d_load.reshape(n_par, whole.shape[1], 1)
        else:
            r = np.zeros(n)
            load = shape.T @ drives.T
            high_in = drives @ self.high
            d_load = self._moved(self.inputs, theta, shape, n_par)
        d_out = self._moved(self.outputs, theta, shape, n_par)
        turn = np.swapaxes(mix, 1, 2)  # (n_par, r, s): shape r changes by the sum over s
        return State(
            theta, omega, shape, out, load, d_log, mix, d_load + turn @ load, d_out + turn @ out,
            sensors @ self.high, high_in, r, sensors @ r, sensors, drives,
        )  # fmt: skip

    def _turned(self, shape: NDArray) -> NDArray[np.float64]:
        """Sign (m,) with which each mode is the nominal one that it is most like, and not its opposite: errors of loads
        and motions are added to modes, and the largest entry is at one end of a symmetric mode or at the other.
        """
        like = shape if self._nominal_shape is None else self._nominal_shape @ shape
        return np.where(like[np.abs(like).argmax(axis=0), np.arange(shape.shape[1])] < 0, -1.0, 1.0)

    def _rows(self, theta: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Participations of the outputs (n_out, n) and of the inputs (n_in, n), none under base motion."""
        if self._affine is not None:
            theta = self.theta0
        key = theta.tobytes()
        if key not in self._seen:
            drive = () if self.is_base else self.inputs
            rows = [np.array([self.participation(c.dof, theta) for c in part]) for part in (self.outputs, drive)]
            self._seen = {key: (rows[0], rows[1].reshape(len(drive), -1) if drive else np.zeros((0, rows[0].shape[1])))}
        return self._seen[key]

    def _moved(self, channels: Sequence[Channel], theta: NDArray, shape: NDArray, n_par: int) -> NDArray[np.float64]:
        """Derivatives of the channels' modal participations, (n_par, m, n_channels); changes move no channel."""
        if self._affine is not None:
            return np.zeros((n_par, shape.shape[1], len(channels)))
        rows = [self.structure.participation_derivatives(c.dof, theta) @ shape for c in channels]
        return np.pad(np.moveaxis(np.array(rows), 0, 2), ((0, n_par - len(rows[0])), (0, 0), (0, 0)))

    def participation(self, dof: str, theta: NDArray) -> NDArray[np.float64]:
        """Row of the structure's participation, real."""
        return np.real(self.structure.participation(dof, theta))

    def grid(self, term: Term, starts: NDArray, s: NDArray) -> NDArray[np.complex128]:
        """Dynamic stiffness of `term` at each of `starts`, shape (n_starts, k, k, n_f); remembered."""
        key = (id(term), id(s), starts.tobytes().__hash__())
        if key not in self._grids:
            made = np.array([term.stiffness(s, p) for p in starts])
            self._grids[key] = (made, term, s)  # holding both keeps their identities from being used again
        return self._grids[key][0]

    def start(self, terms: Sequence[Term] = (), p: Sequence[float] | NDArray = ()) -> Point:
        """The nominal point, with the terms' parameters `p` (zero where not given)."""
        n = sum(t.n for t in terms)
        p = np.asarray(p, float) if len(p) else np.zeros(n)
        m = self.band_modes.size
        shift = self.mesh_shift if self.finer else np.zeros(m)
        return Point(
            self.theta0.copy(), p, shift.copy(), np.log(self.zeta0[self.band_modes]), np.zeros(m), np.zeros(self.n_law)
        )

    def site(self, free_nodes: Sequence[str], elements: Sequence[tuple[str, str]], supports: Sequence[str]) -> Site:
        """What mechanisms need to know, at the nominal parameters."""
        m = self.structure.matrices(self.theta0)
        first = self.state(self.theta0)
        rigid = np.real(self.structure.rigid(self.theta0)) if self.is_base else None
        dofs = {d: self.participation(d, self.theta0) for d in self.structure.dofs}
        drive = () if self.is_base else tuple(dict.fromkeys(c.dof for c in self.inputs))
        for dof in drive:
            dofs.setdefault(dof, self.participation(dof, self.theta0))
        site = Site(
            np.real(m.M), np.real(m.K), dofs, dict(self.structure.nodes), tuple(free_nodes), tuple(elements),
            tuple(supports), self.outputs + self.inputs, len(self.outputs), first.omega[self.seen_modes],
            first.shape[:, self.seen_modes], rigid, drive,
            tuple(np.real(d.K) for d in self.structure.derivatives(self.theta0)), self.held,
        )  # fmt: skip
        return replace(site, mesh=self.structure.elements or touching(site))

    @cached_property
    def irregular(self) -> Irregular:
        """The structure's parts, each of which may differ a little from the model's."""
        return Irregular.of(self)

    def shape_spread(self, rows: NDArray, stiffness: float, mass: float) -> NDArray[np.float64]:
        """Standard deviation (k, m_b) of the band modes' motions `rows` (k, n) @ shape where elements' stiffness and
        nodes' masses differ by such relative ones.
        """
        key = stiffness, mass
        if key not in self._turns:
            self._turns[key] = self.irregular.turns(self, stiffness, mass)
        motion = rows @ self.state(self.theta0).shape
        return np.sqrt(np.square(motion @ self._turns[key]).sum(axis=0))

    # ---------------------------------------------------------------- the mesh

    @cached_property
    def inside(self) -> Inside:
        """What a finer mesh would let bend."""
        return Inside.of(self.site((), (), self.structure.supports))

    @cached_property
    def mesh_shift(self) -> NDArray[np.float64]:
        """Relative frequency changes (m_b,) of the band modes by a finer mesh; nothing where it is fine enough."""
        first, b = self.state(self.theta0), self.band_modes
        shift = self.inside.shift(self.site((), (), ()), first.omega[b], first.shape[:, b])
        return shift if np.abs(shift).max() > FINE else np.zeros(b.size)

    def refine(self, finer: bool | None) -> None:
        """Answer as a finer mesh does, or as the model itself; None, as at first, where that is not settled."""
        self.finer = finer and bool(self.mesh_shift.any())

    def in_basis(self, state: State) -> NDArray[np.float64]:
        """The modes of a state as motions of the nominal basis, (n_basis + 1, m); the last is that of the base."""
        return self._onto_basis @ state.shape

    def inside_taken(self, s: NDArray) -> NDArray[np.complex128]:
        """`Inside.taken` between motions of the basis and the base, (n_basis + 1, n_basis + 1, n_s), modes beside the
        band following as the nominal ones; the last few are remembered.
        """
        key = s.tobytes()
        if key not in self._taken:
            if len(self._taken) > 12:
                self._taken.pop(next(iter(self._taken)))
            one = Evaluation(self, self.start(), (), s)
            out, motions = self.outside_modes, np.column_stack([self.basis, one.state.rigid])
            taken = self.inside.taken(s, motions, self.in_basis(one.state)[:, out], one.d[out])
            self._taken[key] = np.ascontiguousarray(np.moveaxis(taken, 0, 2))
        return self._taken[key]

    def mesh_share(self, point: Point, held: Sequence[Term], s: NDArray, plain: NDArray) -> NDArray[np.complex128]:
        """What a finer mesh adds to the FRFs `plain`; that of the last point is remembered."""
        key = (point.vector().tobytes(), tuple(id(t) for t in held), s.tobytes())
        if self._share is None or self._share[0] != key:
            self._share = (key, self.response(point, held, s).value - plain)
        return self._share[1]

    @cached_property
    def inside_own(self) -> NDArray[np.float64]:
        """What each band mode's own dynamic stiffness loses to the inside at its frequency, over that to the fourth
        power, (m_b,).
        """
        first, b = self.state(self.theta0), self.band_modes
        omega = first.omega[b] * (1 + self.mesh_shift)
        w = self.in_basis(first)[:, b]
        return np.einsum("em,egm,gm->m", w, self.inside_taken(1j * omega), w).real / omega**4

    def couple(self) -> None:
        """Let modes act on each other by the damping that the model gives them, from here on."""
        self.coupling = Coupling.of(self)
        self._evaluated = self._share = None

    # ---------------------------------------------------------------- responses

    def imposed(self, support: str, axis: int, point: Point, s: NDArray) -> NDArray[np.complex128]:
        """Displacements (n_out, n_f) over base acceleration while a held motion follows the base; terms left out."""
        held = self.held[support]
        one = Evaluation(self, replace(point, terms=np.zeros(0)), [], s)
        modal = -(s**2) * one.d * (one.state.shape.T @ held.load[:, axis])[:, None]
        return ((one.state.sensors @ held.static[:, axis])[:, None] + one.state.out.T @ modal) / s**2

    def lift(self, s: NDArray) -> NDArray[np.complex128]:
        """Factor (n_out, n_in, n_f) from displacement per force (or per base acceleration) to what the channels read;
        those of the last few lines are remembered.
        """
        key = s.tobytes()
        if key not in self._lifts:
            if len(self._lifts) > 12:
                self._lifts.pop(next(iter(self._lifts)))
            made = (self.sign_out[:, None, None] * s[None, None, :] ** self.rise[:, None, None]) / self.sign_in[:, None]
            more = s ** (2 - MOTION_ORDER[self.inputs[0].quantity]) if self.is_base else 1.0
            self._lifts[key] = np.asarray(made * more, complex)
        return self._lifts[key]

    def attached(self, terms: Sequence[Term]) -> Attached:
        """Where these terms act together, remembered."""
        key = tuple(id(t) for t in terms)
        if key not in self._attached:
            if len(self._attached) > 50:
                self._attached.pop(next(iter(self._attached)))
            self._attached[key] = (Attached.of(terms, self.high), tuple(terms))  # held, so that no identity is reused
        return self._attached[key][0]

    def evaluation(self, point: Point, terms: Sequence[Term], s: NDArray) -> Evaluation:
        """What responses at a point are made of; that of the last point is remembered."""
        key = (point.vector().tobytes(), tuple(id(t) for t in terms), s.tobytes())
        if self._evaluated is None or self._evaluated[0] != key:
            self._evaluated = (key, Evaluation(self, point, terms, s), tuple(terms))
        return self._evaluated[1]

    def response(
        self, point: Point, terms: Sequence[Term], s: NDArray, *, jacobian: bool = False, modal: bool = False,
        common: NDArray | None = None,
    ) -> Response:  # fmt: skip
        """FRFs at complex frequencies `s` (n_f,), in each channel's quantity and sign."""
        return Evaluation(self, point, terms, s).run(jacobian, modal or jacobian, common)
