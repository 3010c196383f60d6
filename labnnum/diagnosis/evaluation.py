"""One evaluation of an engine: responses with terms coupled in, and their derivatives, sharing what they compute."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis import sums
from labnnum.diagnosis.point import Point, Response
from labnnum.mechanisms.base import ChannelMechanism, Term

if TYPE_CHECKING:
    from labnnum.diagnosis.engine import Engine
    from labnnum.diagnosis.irregular import Bent


class Evaluation:
    """One evaluation: the steps share what they compute, and keep it, so that derivatives at a point where the value
    was asked for take up where that ended.
    """

    def __init__(self, engine: Engine, point: Point, terms: Sequence[Term], s: NDArray) -> None:
        self.e, self.point, self.s = engine, point, s
        terms = terms if engine.coupling is None else (engine.coupling.term, *terms)
        slices = _slices(terms)
        self.acting = [(t, c) for t, c in zip(terms, slices, strict=True) if t.groups]
        self.others = [(t, c) for t, c in zip(terms, slices, strict=True) if not t.groups]
        self.n_terms = point.terms.size
        self.changes = [(t.whole, c) for t, c in self.others if t.whole is not None]
        self.state = engine.state(point.theta, [(w, point.terms[c]) for w, c in self.changes])
        self.change = point.theta - engine.theta0
        self.soft = engine.remainder.at(point.theta)
        self.rises: NDArray | None = None
        self._modes()
        self._points()

    def _modes(self) -> None:
        e, st, point = self.e, self.state, self.point
        self.outside = e.outside_modes
        cords = float(point.law[1]) * e.elastic if e.n_law == 2 else 0.0  # what holds a free body has some loss
        self.omega, self.zeta = sums.placed(st.omega, e.zeta0, e.band_modes, self.outside, point.shift, point.log_zeta)
        self.d = sums.receptances(self.omega, self.zeta, float(point.law[0]), cords, e.rigid_modes, self.s)
        self.load = st.load.copy()
        self.load[e.band_modes] += (point.size * e.load_typical)[:, None]
        self.modes, self.shared = np.zeros(0, int), None
        if e.coupling is not None:
            self.modes = e.coupling.modes
            self.shared = e.coupling.at(e, st, self.change, self.omega, self.zeta)

    def _points(self) -> None:
        """Attachment motions of all acting terms."""
        e, st, s = self.e, self.state, self.s
        self.w = np.zeros((0, 0))
        if not self.acting:
            return
        self.there = e.attached([t for t, _ in self.acting])
        self.w = self.there.columns.T @ st.shape  # (k, m)
        self.g = np.zeros((len(self.w), len(self.w), s.size), complex)
        for t, c, first, last in self._acting_columns():
            self.g[first:last, first:last] = t.stiffness(s, self.point.terms[c], self.change)
        if self.shared is not None:
            k = len(self.shared.damping)
            self.g[:k, :k] = self.shared.damping[..., None] * s
            self.w[:k] = np.eye(st.omega.size)[self.modes]
        if self.there.carrying.any():
            self.rises = np.where(self.there.carrying[:, None], s**2, 1.0)
            self.out_carried = st.sensors @ self.there.static  # (o, k)
            self.in_carried = -self.there.own_load[:, None] if e.is_base else (st.drives @ self.there.static).T

    def joined(self, term: Term) -> Evaluation:
        """The same with one more acting term, its parameters zero, for `ingredients`."""
        assert self._bare is not None  # which the two then share
        made = copy(self)
        made.point = replace(self.point, terms=np.concatenate([self.point.terms, np.zeros(term.n)]))
        made.acting = [*self.acting, (term, slice(self.n_terms, self.n_terms + term.n))]
        made.n_terms += term.n
        made._points()
        return made

    def _summed(self, left: NDArray, right: NDArray, high_left: NDArray, high_right: NDArray) -> NDArray:
        """Displacements (l, r, n_f) by participations (m, l) and (m, r) of the modes, those above the basis, whose
        shares are (l, h) and (r, h), as their quasi-static remainder.
        """
        static = self.soft.between(high_left, high_right)
        slope = (high_left * self.e.high_softness) @ high_right.T
        out = sums.summed(left, right, self.d, static, slope, self.s)
        for part, factor in zip(self.e.high_losses, self._losses, strict=True):
            out -= ((high_left * part) @ high_right.T)[..., None] * factor
        return out

    @cached_property
    def _losses(self) -> tuple[NDArray, NDArray]:
        """What viscous and hysteretic damping take of the flexibility of a mode above the basis, (n_f,) each, of its
        damping ratio over its frequency and of its damping ratio: it follows that of the others.
        """
        share, twice = float(self.point.law[0]), 2.0 * self.e.followed(self.point.log_zeta)
        return twice * (1.0 - share) * self.s, twice * share * 1j * np.ones(self.s.size)

    def run(
        self, jacobian: bool, modal: bool, common: NDArray | None = None, parts: NDArray | None = None
    ) -> Response:  # fmt: skip
        """The FRFs, with what else is asked for; `common` are directions of the structure's own irregularity, and
        `parts` (n_parts,) what its parts differ by where values and derivatives are to hold that.
        """
        e, st = self.e, self.state
        x = self._refined_value if e.finer else self._coupled[1]
        if e.is_base:
            x = x + (st.rigid_out[:, None] / self.s**2)[:, None, :]
        q, p_out = self._refined if e.finer else (self._coupled[0], self._coupled[2])
        bent = None
        if parts is not None:
            bent = e.irregular.bent(self, q, p_out, parts)
            q, p_out, x = bent.q, bent.p_out, x + bent.added
        x = x.copy()
        extra = self._extra(x)
        factor = self._factor
        value, swap = self._swap(x * factor)
        if not (jacobian or modal):
            return Response(value)
        jac = own = moved = None
        if jacobian:
            jac = self._jacobian(q, p_out, extra, bent)
            jac *= factor
            self._chain_jacobian(jac, x)
            jac = jac if swap is None else np.stack([swap(j) for j in jac])
        if not modal:
            return Response(value, jac)
        b, outside, n = e.band_modes, self.outside, e.rigid_modes
        others = sums.spread(self.load[outside], self.d[outside])
        rest = self._of_modes(outside)
        rigid = self._of_modes(np.arange(n)) if n else None
        others *= np.abs(st.out[outside]).max(axis=1)[:, None, None]
        if common is not None:
            own, moved = e.irregular.columns(self, q, p_out, common)
            own = own * factor
            own = own if swap is None else np.stack([swap(c) for c in own])
        return Response(value, jac, q[b], p_out[b], factor, rest, rigid, others, own, moved)

    def _of_modes(self, which: NDArray) -> NDArray:
        """Displacements (o, i, f) that some of the modes contribute, without terms."""
        zero = np.zeros((self.state.out.shape[1], self.load.shape[1]))
        return sums.summed(self.state.out[which], self.load[which], self.d[which], zero, zero, self.s)

    # With what a finer mesh lets bend, to first order but for the modes beside the band; frequencies of band modes stay
    # where they are, since their offsets hold what the mesh moves them by.

    @cached_property
    def _pushed(self) -> NDArray:
        """Modal forces (m, i, f) of what the inside takes off the dynamic stiffness."""
        e, q = self.e, self._coupled[0]
        w = e.in_basis(self.state)
        met = sums.turned(w, q)  # motions of the basis
        if e.is_base:
            met[-1] += 1.0 / self.s**2
        return sums.turned(w.T, sums.across(e.inside_taken(self.s), met)) - self._own_all * q

    @cached_property
    def _refined_value(self) -> NDArray:
        """Displacements (o, i, f)."""
        _, x, p_out, _, _ = self._coupled
        return x + sums.paired(p_out, self._pushed[None])[0]

    @cached_property
    def _refined(self) -> tuple[NDArray, NDArray]:
        """Motions of the modes by the inputs (m, i, f) and by which the outputs follow them (m, o, f)."""
        q, _, p_out, _, _ = self._coupled
        w, d = self.e.in_basis(self.state), self.d[:, None]
        taken = sums.across(self.e.inside_taken(self.s), sums.turned(w, p_out))
        pulled = sums.turned(w.T, taken) - self._own_all * p_out
        return q + d * self._pushed, p_out + d * pulled

    @cached_property
    def _own_all(self) -> NDArray[np.float64]:
        """So much of what the inside takes off each mode's dynamic stiffness moves its frequency, (m, 1, 1); nothing of
        modes beside the band.
        """
        own = np.zeros((self.omega.size, 1, 1))
        if self.e.finer:
            own[self.e.band_modes, 0, 0] = self.e.inside_own * self.omega[self.e.band_modes] ** 4
        return own

    def ingredients(self, own: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """For the last `own` columns of motion, with the columns before them coupled: x (o, i, f), and the
        receptances h (o, k, f), z (k, i, f), G (k, k, f) through which those last columns couple.
        """
        x, _ = self._bare
        h0, z0, gw, _ = self._receptances()
        held = gw.shape[0] - own
        if held:
            g = np.ascontiguousarray(self.g[:held, :held])
            inner = across(gw[:held, :held], g)
            a = _solve(inner, z0[:held])  # motions with what is held
            b = _solve(inner, gw[:held, held:])
            ga, gb = across(g, a), across(g, b)
            x = x - across(h0[:, :held], ga)
            z = z0[held:] - across(gw[held:, :held], ga)
            h = h0[:, held:] - across(h0[:, :held], gb)
            gw = gw[held:, held:] - across(gw[held:, :held], gb)
        else:
            z, h = z0, h0
        if self.e.is_base:
            x = x + (self.state.rigid_out[:, None] / self.s**2)[:, None, :]
        x = x.copy()
        self._extra(x)
        return x, h, z, gw

    def to_channels(self, x: NDArray) -> NDArray:
        """Displacements (n, o, i, f) to what the channels read."""
        value = x * self._factor[None]
        _, swap = self._swap(value[0])
        return value if swap is None else np.stack([swap(v) for v in value])

    @cached_property
    def _bare(self) -> tuple[NDArray, NDArray]:
        """Displacements x (o, i, f) and modal motions q (m, i, f) without terms."""
        st = self.state
        return self._summed(st.out, self.load, st.high_out, st.high_in), sums.spread(self.load, self.d)

    @cached_property
    def lift(self) -> NDArray:
        """Factor from displacement per force (or per base acceleration) to what the channels read, (o, i, f)."""
        return self.e.lift(self.s)

    @cached_property
    def _factor(self) -> NDArray:
        """The same with the channels' own faults."""
        return self.lift * self._chain if self._faulty else self.lift

    @property
    def _faulty(self) -> list[tuple[Term, slice]]:
        """Terms of a channel, by a factor."""
        return [(t, c) for t, c in self.others if isinstance(t.mechanism, ChannelMechanism)]

    def _receptances(self) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """h0 (o, k, f), z0 (k, i, f), G (k, k, f) at the terms' motions, and D wᵀ (m, k, f)."""
        w, st, there = np.ascontiguousarray(self.w.T), self.state, self.there
        dw = sums.spread(w, self.d)
        gw = self._summed(w, w, there.high, there.high)
        z0 = self._summed(w, self.load, there.high, st.high_in)
        h0 = self._summed(st.out, w, st.high_out, there.high)
        if self.e.is_base:
            z0 += ((there.columns.T @ st.rigid * there.inertial)[:, None] / self.s**2)[:, None, :]
        if self.rises is not None:
            r = self.rises
            gw = r[:, None] * gw * r[None] - there.tied[:, :, None]
            z0 = r[:, None] * z0 - self.in_carried[:, :, None]
            h0 = h0 * r[None] - self.out_carried[:, :, None]
            dw = dw * r[None]
        return h0, z0, gw, dw

    @cached_property
    def _coupled(self) -> tuple[NDArray, NDArray, NDArray, NDArray | None, NDArray | None]:
        """Modal motions q (m, i, f), displacements x (o, i, f), modal motions p (m, o, f) by which the outputs follow,
        and the acting terms' motions by the inputs (k, i, f) and by which the outputs follow.

        Terms act by motion z there, which solves (I + G g) z = z0, and the force -g z.
        """
        x, q = self._bare
        p_out = sums.spread(self.state.out, self.d)
        if not self.acting:
            return q, x, p_out, None, None
        h0, z0, gw, dw = self._receptances()
        z_in, z_out = sums.solved(sums.across(gw, self.g), z0, h0)
        q, x = q.copy(), x.copy()
        sums.coupled(self.g, z_in, z_out, h0, dw, q, x, p_out)
        return q, x, p_out, z_in, z_out

    def following(self, pushed: NDArray) -> NDArray:
        """Motions (m, r, f) of the modes by modal forces (m, r, f), acting terms coupled in."""
        moved = self.d[:, None] * pushed
        if not self.acting:
            return moved
        _, _, gw, dw = self._receptances()
        met = np.einsum("mkf,mrf->krf", dw, pushed)
        held = sums.across(self.g, _solve(sums.across(gw, self.g), met))
        return moved - np.einsum("mkf,krf->mrf", dw, held)

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

    @cached_property
    def _chain(self) -> NDArray:
        """Factor of the channels' own faults, (o, i, f)."""
        e = self.e
        out = np.ones((len(e.outputs), len(e.inputs), self.s.size), complex)
        for term, c in self._faulty:
            assert isinstance(term.mechanism, ChannelMechanism)
            f = term.mechanism.factor(self.s, self.point.terms[c])
            i = term.data["channel"]
            if i < len(e.outputs):
                out[i] *= f
            else:
                out[:, i - len(e.outputs)] /= f
        return out

    def _chain_jacobian(self, jac: NDArray, x: NDArray) -> None:
        """Channel terms: y f, so dy = y f' (an input's factor divides)."""
        e, n_t = self.e, self.point.theta.size
        for term, c in self._faulty:
            assert isinstance(term.mechanism, ChannelMechanism)
            p, value = self.point.terms[c], x * self.lift
            ratio = term.mechanism.factor_derivative(self.s, p) / term.mechanism.factor(self.s, p)
            i = term.data["channel"]
            rows = slice(n_t + c.start, n_t + c.stop)
            if i < len(e.outputs):
                jac[rows, i] = value[i] * self._chain[i] * ratio[:, None, :]
            else:
                j = i - len(e.outputs)
                jac[rows, :, j] = -(value[:, j] * self._chain[:, j])[None] * ratio[:, None, :]

    # ---------------------------------------------------------------- derivatives

    def _acting_columns(self) -> Iterator[tuple[Term, slice, int, int]]:
        """Each acting term with its parameters and the range of its columns."""
        first = 0
        for term, c in self.acting:
            yield term, c, first, first + term.width
            first += term.width

    def _jacobian(
        self, q: NDArray, p_out: NDArray, extra: list[tuple[slice, NDArray, NDArray, NDArray]], bent: Bent | None
    ) -> NDArray:  # fmt: skip
        e, n_t, m_b = self.e, self.point.theta.size, self.e.band_modes.size
        n_o, n_i, n_f = len(e.outputs), len(e.inputs), self.s.size
        jac = np.zeros((n_t + self.n_terms + 3 * m_b + e.n_law, n_o, n_i, n_f), complex)
        self._structure_slopes(jac, q, p_out, bent)
        _, _, _, z_in, z_out = self._coupled
        for term, c, first, last in self._acting_columns():
            assert z_in is not None
            assert z_out is not None
            d = term.stiffness_derivative(self.s, self.point.terms[c], self.change)
            pulled = np.ascontiguousarray(np.swapaxes(z_out[first:last], 0, 1))
            for k in range(term.n):
                jac[n_t + c.start + k] = -sums.across(pulled, sums.across(d[k], z_in[first:last]))
        for c, p, d, s in extra:
            w, at = 2 * np.pi * p[0], n_t + c.start
            shape = p[2:, None]
            jac[at] += (-shape * d**2 * (2 * w + 2 * p[1] * s) * 2 * np.pi)[:, None, :]
            jac[at + 1] += (-shape * d**2 * 2 * w * s)[:, None, :]
            for o in range(n_o):
                jac[at + 2 + o, o] += d
        self._mode_slopes(jac[n_t + self.n_terms :], q, p_out)
        return jac

    @cached_property
    def _rates(self) -> tuple[NDArray, NDArray, NDArray]:
        """What a relative change of its damping ratio, one of its frequency and a larger share of hysteretic damping
        add to each mode's dynamic stiffness, (m, f).
        """
        follows = 4 * self._own_all[:, 0, 0]  # what the inside takes moves with the frequency
        return sums.rates(self.omega, self.zeta, float(self.point.law[0]), follows, self.s)

    def _structure_slopes(self, jac: NDArray, q: NDArray, p_out: NDArray, bent: Bent | None) -> None:
        """Derivatives to the structure's parameters and to those of changes of the whole structure."""
        st, n_t = self.state, self.point.theta.size
        slots = [*range(n_t), *(n_t + i for _, c in self.changes for i in range(c.start, c.stop))]
        if not slots:
            return
        n = len(slots)
        jac[slots] = sums.state_slopes(self._rates[1], q, p_out, st.d_log[:n], st.d_load[:n], st.d_out[:n])
        if bent is not None:
            for slot, mix in zip(slots, st.mix[:n], strict=True):
                jac[slot] -= sums.paired(sums.turned(mix, p_out), bent.pushed[None])[0]
                jac[slot] -= sums.paired(bent.pulled, sums.turned(mix, q)[None])[0]
        _, _, _, z_in, z_out = self._coupled
        if z_in is None or z_out is None:
            jac[:n_t] += self.soft.changes(*self._shares)[..., None]
            return
        force, back = self._through
        pulled = np.ascontiguousarray(np.swapaxes(z_out, 0, 1))
        k = len(self.w)
        turned = self.w @ st.mix[:n]  # derivatives of the terms' motions
        turned[:, : self.modes.size] = 0.0  # modes are themselves
        turned = turned.reshape(n * k, -1)
        if turned.any():
            follow, moved = sums.turned(turned, p_out), sums.turned(turned, q)
            for j, slot in enumerate(slots):
                own = slice(j * k, (j + 1) * k)
                jac[slot] -= sums.paired(follow[own], force[None])[0] + sums.paired(back, moved[None, own])[0]
        for j, rest in enumerate(self.soft.changes(*self._shares)):
            jac[j] += self._felt(rest)
            for term, c, first, last in self._acting_columns():
                slope = term.stiffness_slope(self.s, self.point.terms[c], self.change, j)
                if slope is not None:
                    own = np.ascontiguousarray(pulled[:, first:last])
                    jac[j] -= sums.across(own, sums.across(slope, z_in[first:last]))
        if self.shared is not None:
            for j, slot in enumerate(slots):
                jac[slot] -= self._passed(self.shared.slopes[j], z_in, pulled)
                more = st.d_log[j, self.modes] - self.shared.own_rates[j]
                jac[slot] += np.tensordot(more, self._eased, 1)

    def _passed(self, damping: NDArray, z_in: NDArray, pulled: NDArray) -> NDArray:
        """What damping (k, k) between coupled modes takes off the displacements, (o, i, f)."""
        k = self.modes.size
        force = sums.across(damping[..., None] * self.s, np.ascontiguousarray(z_in[:k]))
        return sums.across(np.ascontiguousarray(pulled[:, :k]), force)

    @cached_property
    def _eased(self) -> NDArray:
        """Derivatives of the displacements by the logarithm of each coupled mode's own damping, as far as what it
        shares with the others follows that, (k, o, i, f).
        """
        assert self.shared is not None
        _, _, _, z_in, z_out = self._coupled
        assert z_in is not None
        assert z_out is not None
        k = self.modes.size
        out = np.zeros((k, len(self.e.outputs), len(self.e.inputs), self.s.size), complex)
        pulled = np.ascontiguousarray(np.swapaxes(z_out, 0, 1))
        for j in range(k):
            half = 0.5 * self.shared.damping * ((np.arange(k) == j)[:, None] + (np.arange(k) == j))
            out[j] = -self._passed(half, z_in, pulled)
        return out

    @cached_property
    def _through(self) -> tuple[NDArray, NDArray]:
        """Forces that the acting terms hold against at their motions, by the inputs (k, i, f) and, what they pass on to
        the outputs, by the outputs (k, o, f).
        """
        _, _, _, z_in, z_out = self._coupled
        assert z_in is not None
        assert z_out is not None
        rises = 1.0 if self.rises is None else self.rises[:, None]
        pulled = np.ascontiguousarray(np.swapaxes(z_out, 0, 1))
        return rises * sums.across(self.g, z_in), rises * np.swapaxes(sums.across(pulled, self.g), 0, 1)

    @property
    def _shares(self) -> tuple[NDArray, NDArray]:
        """Shares of the modes above the basis in outputs and acting motions (o + k, h), and in inputs and these."""
        out, load = self.state.high_out, self.state.high_in
        if not self.acting:
            return out, load
        return np.vstack([out, self.there.high]), np.vstack([load, self.there.high])

    def _felt(self, rest: NDArray) -> NDArray:
        """What a change of the flexibility (o + k, i + k) above the basis does to the displacements, (o, i, f)."""
        o, i = self.state.high_out.shape[0], self.state.high_in.shape[0]
        if not self.acting:
            return np.broadcast_to(rest[..., None], (o, i, self.s.size))
        force, back = self._through
        one = np.ones(self.s.size, complex)
        inner = rest[o:, :i, None] - across(rest[o:, i:, None] * one, force)
        direct = rest[:o, :i, None] - across(rest[:o, i:, None] * one, force)
        return direct - np.einsum("kof,kif->oif", back, inner)

    def _mode_slopes(self, out: NDArray, q: NDArray, p_out: NDArray) -> None:
        """Derivatives to the modes' frequency offsets, damping and loads, and to the law of damping."""
        e, b, m_b = self.e, self.e.band_modes, self.e.band_modes.size
        damped, stiffer, swing = self._rates
        sums.mode_slopes(stiffer, damped, q, p_out, b, self.outside, 1 + self.point.shift, e.load_typical, out)
        sums.weighed(swing, q, p_out, out[3 * m_b])
        out[3 * m_b] *= -1.0
        left, right = self._shares
        if self.shared is not None:
            self._eased_slopes(out)
        viscous, firm = (self._felt((left * part) @ right.T) for part in e.high_losses)
        out[m_b : 2 * m_b] -= (viscous * self._losses[0] + firm * self._losses[1]) / m_b
        out[3 * m_b] += 2.0 * e.followed(self.point.log_zeta) * (self.s * viscous - 1j * firm)
        if e.n_law == 2:
            n = e.rigid_modes
            lost = np.broadcast_to(-e.elastic * self.s, (n, self.s.size)).copy()
            sums.weighed(lost, q[:n], p_out[:n], out[-1])

    def _eased_slopes(self, out: NDArray) -> None:
        """Into out (n, o, i, f): what modes share follows their frequencies and damping."""
        m_b, place = self.e.band_modes.size, {int(r): i for i, r in enumerate(self.e.band_modes)}
        for r, one in zip(self.modes, self._eased, strict=True):
            i = place.get(int(r))
            if i is not None:
                out[i] += one / (1 + self.point.shift[i])
                out[m_b + i] += one
            elif self.zeta[r] < 0.95:
                out[m_b : 2 * m_b] += one / m_b


def _slices(terms: Sequence[Term]) -> list[slice]:
    """Where each term's parameters stand."""
    ends = list(accumulate(t.n for t in terms))
    return [slice(end - t.n, end) for t, end in zip(terms, ends, strict=True)]


def across(a: NDArray, b: NDArray) -> NDArray:
    """Sum over k of a (r, k, f) and b (k, c, f): (r, c, f), of arrays that need not be contiguous."""
    return sums.across(np.ascontiguousarray(a), np.ascontiguousarray(b))


def _solve(a: NDArray, rhs: NDArray) -> NDArray:
    """(I + a) x = rhs for each line: a (k, k, n_f), rhs (k, r, n_f)."""
    none = np.zeros((0, a.shape[0], a.shape[2]), complex)
    return sums.solved(np.ascontiguousarray(a), np.ascontiguousarray(rhs), none)[0]
