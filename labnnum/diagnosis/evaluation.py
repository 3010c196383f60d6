"""One evaluation of an engine: responses with terms coupled in, and their derivatives, sharing what they compute."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.point import Point, Response
from labnnum.errors import ModelError
from labnnum.frf import MOTION_ORDER
from labnnum.mechanisms.base import ChannelMechanism, Term

if TYPE_CHECKING:
    from labnnum.diagnosis.engine import Engine


class Evaluation:
    """One evaluation: the steps share what they compute."""

    def __init__(self, engine: Engine, point: Point, terms: Sequence[Term], s: NDArray) -> None:
        self.e, self.point, self.s = engine, point, s
        self.acting = [(t, self._slice(terms, i)) for i, t in enumerate(terms) if t.groups]
        self.others = [(t, self._slice(terms, i)) for i, t in enumerate(terms) if not t.groups]
        self.n_terms = point.terms.size
        self.changes = [(t.whole, c) for t, c in self.others if t.whole is not None]
        self.state = engine.state(point.theta, [(w, point.terms[c]) for w, c in self.changes])
        self.change = point.theta - engine.theta0
        self._modes()
        self._points()

    @staticmethod
    def _slice(terms: Sequence[Term], i: int) -> slice:
        first = sum(t.n for t in terms[:i])
        return slice(first, first + terms[i].n)

    def _modes(self) -> None:
        e, st, b = self.e, self.state, self.e.band_modes
        omega = st.omega.copy()
        omega[b] = omega[b] * (1 + self.point.shift)
        zeta = e.zeta0[: omega.size].copy()
        common = np.mean(self.point.log_zeta - np.log(zeta[b]))
        self.outside = e.outside_modes
        zeta[self.outside] = np.minimum(zeta[self.outside] * np.exp(common), 0.95)  # a guess follows the fitted ones
        zeta[b] = np.exp(self.point.log_zeta)
        self.omega, self.zeta = omega, zeta
        s = self.s
        h = float(self.point.law[0])
        rate = (1 - h) * s + 1j * h * omega[
            :, None
        ]  # what the damping acts on: velocity, or displacement at a right angle
        self.rate = rate
        stiff = omega[:, None] ** 2 + 2 * (zeta * omega)[:, None] * rate
        if e.n_law == 2:  # what holds a free body, cords or a spring, has some loss
            stiff[: e.rigid_modes] += float(self.point.law[1]) * e.elastic * s
        self.d = 1.0 / (stiff + s**2)
        self.load = st.load.copy()
        self.load[b] += (self.point.size * e.load_typical)[:, None]

    def _points(self) -> None:
        """Attachment motions of all acting terms."""
        e, st, s = self.e, self.state, self.s
        self.w = self.w_high = np.zeros((0, 0))
        if not self.acting:
            return
        columns = np.hstack([t.columns for t, _ in self.acting])
        self.w = columns.T @ st.shape  # (k, m)
        self.w_high = columns.T @ e.high  # (k, h)
        self.g = np.zeros((columns.shape[1], columns.shape[1], s.size), complex)
        at = 0
        for t, c in self.acting:
            self.g[at : at + t.width, at : at + t.width] = t.stiffness(s, self.point.terms[c], self.change)
            at += t.width
        self.inertial = np.concatenate([t.inertial for t, _ in self.acting])
        self.rigid = columns.T @ st.rigid
        self._carried(columns)

    def _own_loads(self, k: int) -> NDArray[np.float64]:
        """Loads of base motion on the terms' own coordinates, (k,)."""
        groups = [g for t, _ in self.acting for g in t.groups]
        return np.concatenate([np.zeros(g.columns.shape[1]) if g.load is None else g.load for g in groups])

    def _carried(self, columns: NDArray) -> None:
        """What columns that carry the structure along move besides: sensors, inputs and each other's columns."""
        e, st = self.e, self.state
        n, k = columns.shape
        static = np.zeros((n, k))
        mass = np.zeros(k, bool)
        at = 0
        for t, _ in self.acting:
            for g in t.groups:
                width = g.columns.shape[1]
                if g.carried is not None:
                    static[:, at : at + width] = g.carried
                    mass[at : at + width] = True
                at += width
        self.rises = None
        if mass.any():
            self.rises = np.where(mass[:, None], self.s**2, 1.0)
            self.out_carried = st.sensors @ static  # (o, k)
            self.in_carried = -self._own_loads(k)[:, None] if e.is_base else (st.drives @ static).T
            tied = columns.T @ static
            self.tied = np.where(mass[None, :] & ~mass[:, None], tied, 0.0)
            self.tied = self.tied + self.tied.T

    def _remainder(self, left: NDArray, right: NDArray) -> NDArray:
        """Quasi-static share of the modes above the basis: (l, h) x (r, h) -> (l, r, n_f)."""
        static = left @ right.T
        slope = (left / np.where(self.e.high_omega > 0, self.e.high_omega, np.inf) ** 2) @ right.T
        return static[:, :, None] - slope[:, :, None] * self.s**2

    def run(self, jacobian: bool, modal: bool, common: NDArray | None = None) -> Response:
        """The FRFs, with what else is asked for; `common` are directions of the structure's own irregularity."""
        e, st, s = self.e, self.state, self.s
        x, q = self._bare()
        p_out = st.out[:, :, None] * self.d[:, None, :]  # (m, o, f)
        z_in = z_out = None
        if self.acting:
            q, x, p_out, z_in, z_out = self._couple(q, x, p_out)
        if e.finer:
            q, x, p_out = self._refined(q, x, p_out, jacobian or modal)
        if e.is_base:
            x = x + (st.rigid_out[:, None] / s**2)[:, None, :]
        extra = self._extra(x)
        lift = self._lift()
        chain = self._chain()
        value = x * lift * chain
        value, swap = self._swap(value)
        jac = None
        if jacobian:
            jac = self._jacobian(q, p_out, z_in, z_out, extra) * (lift * chain)[None]
            self._chain_jacobian(jac, x * lift)
            jac = jac if swap is None else np.stack([swap(j) for j in jac])
        if not modal:
            return Response(value, jac)
        b = e.band_modes
        outside = self.outside
        others = self.d[outside][:, None] * self.load[outside][:, :, None]
        rest = _dot(st.out[outside].T, others)
        n = e.rigid_modes
        rigid = _dot(st.out[:n].T, self.d[:n][:, None] * self.load[:n][:, :, None]) if n else None
        others = others * np.abs(st.out[outside]).max(axis=1)[:, None, None]
        own = moved = None
        if common is not None:
            own, moved = e.irregular.columns(self, q, p_out, common)
            own = own * (lift * chain)[None]
            own = own if swap is None else np.stack([swap(c) for c in own])
        return Response(value, jac, q[b], p_out[b], lift * chain, rest, rigid, others, own, moved)

    def _refined(self, q: NDArray, x: NDArray, p_out: NDArray, both: bool) -> tuple[NDArray, NDArray, NDArray]:
        """With what a finer mesh lets bend, to first order but for the modes beside the band; frequencies of band modes
        stay where they are, since their offsets hold what the mesh moves them by. Modal motions where asked for.
        """
        e, st, s, b = self.e, self.state, self.s, self.e.band_modes
        w, taken = e.in_basis(st), e.inside_taken(s)
        met, seen = _dot(w, q), _dot(w, p_out)  # motions of the basis, (k, i, f) and (k, o, f)
        if e.is_base:
            met[-1] += 1.0 / s**2
        met = np.einsum("klf,lif->kif", taken, met)
        own = self._own()
        whole = np.einsum("kof,kif->oif", seen, met)
        whole -= np.einsum("mof,mif->oif", p_out[b], own[:, None, None] * q[b])
        if not both:
            return q, x + whole, p_out
        pushed, pulled = _dot(w.T, met), _dot(w.T, np.einsum("klf,lof->kof", taken, seen))
        pushed[b] -= own[:, None, None] * q[b]
        pulled[b] -= own[:, None, None] * p_out[b]
        return q + self.d[:, None] * pushed, x + whole, p_out + self.d[:, None] * pulled

    def _own(self) -> NDArray[np.float64]:
        """So much of what the inside takes off each band mode's dynamic stiffness moves its frequency, (m_b,)."""
        b = self.e.band_modes
        return self.e.inside_own * self.omega[b] ** 4 if self.e.finer else np.zeros(b.size)

    def ingredients(self, own: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """For the last `own` columns of motion, with the columns before them coupled: x (o, i, f), and the
        receptances h (o, k, f), z (k, i, f), G (k, k, f) through which those last columns couple.
        """
        x, q = self._bare()
        h0, z0, gw, _ = self._receptances(q)
        held = gw.shape[0] - own
        if held:
            g = self.g[:held, :held]
            inner = _across(gw[:held, :held], g)
            a = _solve(inner, z0[:held])  # motions with what is held
            b = _solve(inner, gw[:held, held:])
            ga, gb = _across(g, a), _across(g, b)
            x = x - _across(h0[:, :held], ga)
            z = z0[held:] - _across(gw[held:, :held], ga)
            h = h0[:, held:] - _across(h0[:, :held], gb)
            gw = gw[held:, held:] - _across(gw[held:, :held], gb)
        else:
            z, h = z0, h0
        if self.e.is_base:
            x = x + (self.state.rigid_out[:, None] / self.s**2)[:, None, :]
        self._extra(x)
        return x, h, z, gw

    def to_channels(self, x: NDArray) -> NDArray:
        """Displacements (n, o, i, f) to what the channels read."""
        value = x * (self._lift() * self._chain())[None]
        _, swap = self._swap(value[0])
        return value if swap is None else np.stack([swap(v) for v in value])

    def _bare(self) -> tuple[NDArray, NDArray]:
        """Displacements x (o, i, f) and modal motions q (m, i, f)."""
        e = self.e
        q = self.d[:, None, :] * self.load[:, :, None]
        x = _dot(self.state.out.T, q)
        if e.high.shape[1]:
            x = x + self._remainder(self.state.high_out, self.state.high_in)
        return x, q

    def _lift(self) -> NDArray:
        """Factor from displacement per force (or per base acceleration) to what the channels read, (o, i, f)."""
        e, s = self.e, self.s
        lift = (e.sign_out[:, None, None] * s[None, None, :] ** e.rise[:, None, None]) / e.sign_in[None, :, None]
        return lift * s ** (2 - MOTION_ORDER[e.inputs[0].quantity]) if e.is_base else lift

    def _receptances(self, q: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """h0 (o, k, f), z0 (k, i, f), G (k, k, f) at the terms' motions, and D wᵀ (m, k, f)."""
        dw = self.w.T[:, :, None] * self.d[:, None, :]
        gw, z0, h0 = _dot(self.w, dw), _dot(self.w, q), _dot(self.state.out.T, dw)
        if self.e.high.shape[1]:
            gw = gw + self._remainder(self.w_high, self.w_high)
            h0 = h0 + self._remainder(self.state.high_out, self.w_high)
            z0 = z0 + self._remainder(self.w_high, self.state.high_in)
        if self.e.is_base:
            z0 = z0 + ((self.rigid * self.inertial)[:, None] / self.s**2)[:, None, :]
        if self.rises is not None:
            r = self.rises
            gw = r[:, None] * gw * r[None] - self.tied[:, :, None]
            z0 = r[:, None] * z0 - self.in_carried[:, :, None]
            h0 = h0 * r[None] - self.out_carried[:, :, None]
            dw = dw * r[None]
        return h0, z0, gw, dw

    def _couple(self, q: NDArray, x: NDArray, p_out: NDArray) -> tuple[NDArray, ...]:
        """Add the acting terms: motion z there solves (I + G g) z = z0, the force is -g z."""
        h0, z0, gw, dw = self._receptances(q)
        loop = _across(gw, self.g)
        a = _solve(loop, z0)  # (k, i, f)
        force = -_across(self.g, a)
        x = x + _across(h0, force)
        q = q + _across(dw, force)
        z_out = _solve(loop, np.moveaxis(h0, 0, 1))  # (k, o, f)
        p_out = p_out - _across(dw, _across(self.g, z_out))
        return q, x, p_out, a, z_out

    # ---------------------------------------------------------------- modal terms

    def _extra(self, x: NDArray) -> list[tuple[slice, NDArray, NDArray, NDArray]]:
        """Add modes that the structure lacks; returns what their derivatives need."""
        out = []
        for term, c in self.others:
            if not term.data.get("extra_mode"):
                continue
            p = self.point.terms[c]
            w = 2 * np.pi * p[0]
            d = 1.0 / (w**2 + 2 * p[1] * w * self.s + self.s**2)
            x += (p[2:, None] * d)[:, None, :]
            out.append((c, p, d, self.s))
        return out

    def _swap(self, value: NDArray):
        """Value with rows exchanged or inverted, and the function that does it (None if nothing is)."""
        if not any(t.data.keys() & {"swap", "invert"} for t, _ in self.others):
            return value, None
        order = np.arange(value.shape[0])
        sign = np.ones(value.shape[0])
        whole = 1.0
        for term, _ in self.others:
            if "swap" in term.data:
                a, b = term.data["swap"]
                order[[a, b]] = order[[b, a]]
            elif "invert" in term.data:
                i = term.data["invert"]
                if i < value.shape[0]:
                    sign[i] = -sign[i]
                else:
                    whole = -whole

        def swap(v: NDArray) -> NDArray:
            return whole * sign[:, None, None] * v[order]

        return swap(value), swap

    def _chain(self) -> NDArray:
        e = self.e
        out = np.ones((len(e.outputs), len(e.inputs), self.s.size), complex)
        for term, c in self.others:
            if isinstance(term.mechanism, ChannelMechanism):
                f = term.mechanism.factor(self.s, self.point.terms[c])
                i = term.data["channel"]
                if i < len(e.outputs):
                    out[i] *= f
                else:
                    out[:, i - len(e.outputs)] /= f
        return out

    def _chain_jacobian(self, jac: NDArray, value: NDArray) -> None:
        """Channel terms: y f, so dy = y f' (an input's factor divides)."""
        e, n_t = self.e, self.point.theta.size
        chain = self._chain()
        for term, c in self.others:
            if not isinstance(term.mechanism, ChannelMechanism):
                continue
            p = self.point.terms[c]
            ratio = term.mechanism.factor_derivative(self.s, p) / term.mechanism.factor(self.s, p)
            i = term.data["channel"]
            rows = slice(n_t + c.start, n_t + c.stop)
            if i < len(e.outputs):
                jac[rows, i] = value[i] * chain[i] * ratio[:, None, :]
            else:
                j = i - len(e.outputs)
                jac[rows, :, j] = -(value[:, j] * chain[:, j])[None] * ratio[:, None, :]

    # ---------------------------------------------------------------- derivatives

    def _acting_columns(self) -> Iterator[tuple[Term, slice, int, int]]:
        """Each acting term with its parameters and the range of its columns."""
        first = 0
        for term, c in self.acting:
            yield term, c, first, first + term.width
            first += term.width

    def _jacobian(
        self, q: NDArray, p_out: NDArray, z_in: NDArray | None, z_out: NDArray | None,
        extra: list[tuple[slice, NDArray, NDArray, NDArray]],
    ) -> NDArray:  # fmt: skip
        e, st, s, b = self.e, self.state, self.s, self.e.band_modes
        n_t, m_b = self.point.theta.size, b.size
        n_o, n_i, n_f = len(e.outputs), len(e.inputs), s.size
        jac = np.zeros((n_t + self.n_terms + 3 * m_b + e.n_law, n_o, n_i, n_f), complex)
        moved = np.zeros((self.omega.size, 1))
        moved[b, 0] = 4 * self._own()  # what the inside takes moves with the frequency
        slots = [*range(n_t), *(n_t + i for _, c in self.changes for i in range(c.start, c.stop))]
        for j, slot in enumerate(slots):
            slope = st.d_log[j]
            w, z = self.omega, self.zeta
            h = float(self.point.law[0])
            stiffer = (2 * w**2)[:, None] + (2 * z * w)[:, None] * (self.rate + 1j * h * w[:, None])
            stiffer = slope[:, None] * (stiffer + moved)
            push = st.d_load[j][:, :, None] - stiffer[:, None] * q
            if z_in is not None and z_out is not None:
                turned = self.w @ st.mix[j]  # derivative of the terms' motions, (k, m)
                rises = 1.0 if self.rises is None else self.rises[:, None]
                push = push - _dot(turned.T, rises * _across(self.g, z_in))
            jac[slot] = np.einsum("mof,mif->oif", p_out, push) + _dot(st.d_out[j].T, q)
            if z_in is not None and z_out is not None:
                jac[slot] -= _across(np.moveaxis(z_out, 0, 1), _across(self.g, rises * _dot(turned, q)))
                for term, c, first, last in self._acting_columns() if j < n_t else ():
                    slope = term.stiffness_slope(s, self.point.terms[c], self.change, j)
                    if slope is not None:
                        jac[slot] -= _across(np.moveaxis(z_out[first:last], 0, 1), _across(slope, z_in[first:last]))
        for term, c, first, last in self._acting_columns():
            d = term.stiffness_derivative(s, self.point.terms[c], self.change)
            for k in range(term.n):
                assert z_in is not None
                assert z_out is not None
                pushed = _across(d[k], z_in[first:last])
                jac[n_t + c.start + k] = -_across(np.moveaxis(z_out[first:last], 0, 1), pushed)
        for c, p, d, sx in extra:
            w, at = 2 * np.pi * p[0], n_t + c.start
            shape = p[2:, None]
            jac[at] += (-shape * d**2 * (2 * w + 2 * p[1] * sx) * 2 * np.pi)[:, None, :]
            jac[at + 1] += (-shape * d**2 * 2 * w * sx)[:, None, :]
            for o in range(n_o):
                jac[at + 2 + o, o] += d
        pair = p_out[b][:, :, None, :] * q[b][:, None, :, :]  # (m_b, o, i, f)
        w, z = self.omega[b], self.zeta[b]
        at = n_t + self.n_terms
        h = float(self.point.law[0])
        slope = (2 * w**2)[:, None] + (2 * z * w)[:, None] * (self.rate[b] + 1j * h * w[:, None]) + moved[b]
        jac[at : at + m_b] = -pair * (slope / (1 + self.point.shift)[:, None])[:, None, None, :]
        jac[at + m_b : at + 2 * m_b] = -pair * ((2 * z * w)[:, None] * self.rate[b])[:, None, None, :]
        o = self.outside
        follow = (2 * self.zeta[o] * self.omega[o])[:, None] * self.rate[o]
        jac[at + m_b : at + 2 * m_b] -= np.einsum("mof,mif->oif", p_out[o], follow[:, None] * q[o]) / m_b
        jac[at + 2 * m_b : at + 3 * m_b] = p_out[b][:, :, None, :] * e.load_typical[:, None, None, None]
        swing = 2 * (self.zeta * self.omega)[:, None] * (1j * self.omega[:, None] - s)
        jac[at + 3 * m_b] = -np.einsum("mof,mif->oif", p_out, swing[:, None] * q)
        if e.n_law == 2:
            free = slice(e.rigid_modes)
            jac[-1] = -e.elastic * np.einsum("mof,mif->oif", p_out[free], s * q[free])
        return jac


def _dot(a: NDArray, b: NDArray) -> NDArray:
    """Sum over m of a (r, m) and b (m, ...): (r, ...), by one matrix product."""
    return (a @ b.reshape(b.shape[0], int(np.prod(b.shape[1:])))).reshape(a.shape[0], *b.shape[1:])


def _across(a: NDArray, b: NDArray) -> NDArray:
    """Sum over k of a (r, k, f) and b (k, c, f): (r, c, f); k is small."""
    out = a[:, 0, None] * b[0]
    for k in range(1, b.shape[0]):
        out += a[:, k, None] * b[k]
    return out


def _solve(a: NDArray, rhs: NDArray) -> NDArray:
    """(I + a) x = rhs for each line: a (k, k, n_f), rhs (k, r, n_f)."""
    k = a.shape[0]
    if k == 1:
        return rhs / (1 + a[0, 0])
    if k == 2:
        p, q, r, t = 1 + a[0, 0], a[0, 1], a[1, 0], 1 + a[1, 1]
        det = p * t - q * r
        return np.stack([(t * rhs[0] - q * rhs[1]) / det, (p * rhs[1] - r * rhs[0]) / det])
    full = np.moveaxis(a, 2, 0) + np.eye(k)
    return np.moveaxis(np.linalg.solve(full, np.moveaxis(rhs, 2, 0)), 0, 2)


def _or_nothing(engine: Engine, point: Point, terms: Sequence[Term], s: NDArray) -> NDArray[np.complex128]:
    """FRFs with `terms`, or without the last where its size is beyond what the model can hold."""
    try:
        return engine.response(point, terms, s).value
    except ModelError:
        held = point.terms[: point.terms.size - terms[-1].n]
        return engine.response(replace(point, terms=held), terms[:-1], s).value


def sweep(
    engine: Engine, point: Point, term: Term, starts: NDArray, s: NDArray, held: Sequence[Term] = ()
) -> NDArray[np.complex128]:
    """FRFs with `term` at each of `starts` (n_starts, n_parameters) added: shape (n_starts, n_out, n_in, n_f).

    `point` is of the model with the terms `held`. What does not depend on the new term is computed once.
    """
    terms = [*held, term]

    def at(p: NDArray) -> Point:
        both = np.concatenate([point.terms, np.asarray(p, float)])
        return replace(point, terms=both)

    k = term.columns.shape[1] if term.groups else 0
    if k == 0:
        return np.stack([_or_nothing(engine, at(p), terms, s) for p in starts])
    one = Evaluation(engine, at(np.zeros(term.n)), terms, s)
    x, h, z, gw = one.ingredients(k)
    g = engine.grid(term, starts, s)  # (n, k, k, f)
    if k == 1:
        factor = -g[:, 0, 0] / (1 + gw[0, 0] * g[:, 0, 0])
        change = factor[:, None, None, :] * (h[:, 0][:, None, :] * z[0][None])[None]
    else:
        loop = np.matmul(np.moveaxis(gw, 2, 0), np.moveaxis(g, 3, 1)) + np.eye(k)  # (n, f, k, k)
        motion = np.linalg.solve(loop, np.broadcast_to(np.moveaxis(z, 2, 0), (*loop.shape[:3], z.shape[1])))
        force = np.moveaxis(np.matmul(np.moveaxis(g, 3, 1), motion), 1, 3)  # (n, k, i, f)
        change = -sum(h[:, c][None, :, None] * force[:, c][:, None] for c in range(k))
    value = one.to_channels(x[None] + change)
    return value + engine.mesh_share(point, held, s, one.to_channels(x[None])[0]) if engine.finer else value
