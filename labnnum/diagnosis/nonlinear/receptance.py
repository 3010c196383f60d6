"""Receptances of the updated base model between input, sensors and the places of nonlinear forces, and derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.coupling import Coupled
from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.nonlinear.between import Among, Between
from labnnum.diagnosis.nonlinear.kernels import combined, modal
from labnnum.diagnosis.remainder import Soft
from labnnum.frf import MOTION_ORDER
from labnnum.structures.modal import ModalStructure

RIGID = 0.05
"""Frequency, in units of the lowest line's, below which a mode is that of a rigid body."""
SUSPENDED, CORDS = 0.1, 0.1
"""Frequency of a rigid body on its cords, in units of the lowest compared one, and its damping ratio. Nothing that is
measured floats: without cords a force that has a mean, or a spring that softens, would carry a free body off, and no
steady state would close. A tenth changes its response at the lowest line by 1 %, less than a usual suspension. Both
are fitted: friction against the ground feels the slow motion of the whole body most, and after a hit that is large."""
HANGS = (0.5, 0.7)
"""Standard deviations of their logarithms."""
LOSSES = 1.0
"""Standard deviation of the share of the modal damping that is hysteretic, about the model's viscous one."""


@dataclass(frozen=True, eq=False)
class Receptance:
    """What the lines of one period need of the base model.

    Displacements per force: `plain` (o, f) to the input, `h` (o, k, f) sensors to a force at the places, `z` (k, f)
    places to the input, `g` (k, k, f) among the places; `lift` (o, f) from displacement to what the channels read,
    `gain` (f,) from what the input channel reads to the force (or base motion) that acts.
    `omega`, `zeta` (m,), `w` (k, m), `rest` (k, k) are the modes as they are marched. `plain`, `h` and `lift` stand
    on `lines` only.
    """

    s: NDArray
    plain: NDArray
    h: NDArray
    z: NDArray
    g: NDArray
    lift: NDArray
    gain: NDArray
    omega: NDArray
    zeta: NDArray
    w: NDArray
    rest: NDArray
    d: NDArray
    out: NDArray
    load: NDArray
    lines: NDArray
    reach: float
    """Modes up to this many times the highest excited line are marched; the others follow at once."""
    shared: Coupled | None = None
    """Damping between the modes, where the model couples them."""
    marches: dict[float, Any] = field(default_factory=dict)
    """What was prepared to march it, by the length of the step."""

    def index(self, lines: NDArray) -> NDArray[np.int64]:
        """Where given lines stand among those of the sensors."""
        return np.searchsorted(self.lines, lines)


MARCHED = 2.8
"""Of a model: twice the highest line that is kept, so that what the others do beyond their flexibility stays a small
correction there."""

JUMPING = 6.0
"""The same where a force jumps: what stops at once rings far above the band, and starts and stops again by it."""

IDENTIFIED = 1.4
"""Of a model that was identified: its mode above the band stands for all that lie there."""


def per_place(engine: Engine) -> int:
    """Entries of the vector for each place of a law: its motion in each band mode, and in all modes above together."""
    return engine.band_modes.size + 1


def cords(engine: Engine) -> int:
    """Entries of the vector for the cords on which a floating structure hangs: frequency and damping, as logarithms of
    what they are to `SUSPENDED` and `CORDS`; none where it does not float.
    """
    return len(HANGS) if engine.rigid_modes else 0


def of_all(engine: Engine) -> int:
    """Entries of the vector for what all modes share: the part of the damping that is hysteretic, and the cords."""
    return 1 + cords(engine)


class Base:
    """The base model at places `columns` (n, k), on lines s = decay + i omega (n_f,) of which the first may be zero.

    Where `lines` are given, what concerns sensors (`plain`, `h`, `lift`) is held on those lines only. `jumps`: whether
    a force acts that jumps, which modes farther above the band are marched for.

    The vector that may vary holds the structure's parameters, then for each band mode a frequency offset, the
    logarithm of its damping and an offset of its load, then the entries of `cords`, and, place by place, its motion
    there in each band mode, as in `labnnum.diagnosis.engine.Point`, and by how much more all modes above the band
    move there than they should: coarse elements have those wrong, and a place next to a law feels them as its own
    flexibility.
    """

    def __init__(
        self, engine: Engine, point: Point, columns: NDArray, omega: NDArray, decay: float = 0.0,
        lines: NDArray | None = None, jumps: bool = False,
    ) -> None:  # fmt: skip
        self.engine, self.point, self.columns, self.jumps = engine, point, columns, jumps
        self.decay, self.turn = float(decay), np.asarray(omega, float)
        self.s = decay + 1j * self.turn
        self.lines = np.arange(self.s.size) if lines is None else lines
        self.k = columns.shape[1]
        e = engine
        self.high_w = columns.T @ e.high
        rows = np.array([e.participation(c.dof, e.theta0) for c in e.outputs])
        self.high_out = rows @ e.high
        if e.is_base:
            self.high_load = (-np.real(e.structure.base_load(e.theta0)) @ e.high)[None]
            self.rigid_out = rows @ np.real(e.structure.rigid(e.theta0))
        else:
            self.high_load = np.array([e.participation(e.inputs[0].dof, e.theta0)]) @ e.high
        first = e.state(e.theta0)
        w = columns.T @ first.shape
        b = e.band_modes
        self.above = np.arange(int(b.max(initial=-1)) + 1, first.omega.size)
        self.w_typical = np.maximum(np.abs(w[:, b]), 0.1 * np.abs(w[:, b]).max(axis=1, keepdims=True, initial=0.0))
        some = np.abs(self.s) > 0
        safe = np.where(some, self.s, 1.0)
        rise = np.array([MOTION_ORDER[c.quantity] for c in e.outputs])
        lift = e.sign_out[:, None] * np.where(some | (rise[:, None] == 0), safe ** rise[:, None], 0.0)
        self.lift = lift[:, self.lines]
        order = MOTION_ORDER[e.inputs[0].quantity] if e.is_base else 2
        self.gain = np.where(some | (order == 2), safe ** (2 - order), 0.0) / e.sign_in[0]
        self.some, self.safe = some, safe

    # ---------------------------------------------------------------- the vector

    def start(self) -> NDArray[np.float64]:
        """The vector at the engine's point."""
        p = self.point
        more = cords(self.engine) + self.k * per_place(self.engine)
        return np.concatenate([p.theta, p.shift, p.log_zeta, p.size, p.law[:1], np.zeros(more)])

    @property
    def cuts(self) -> NDArray[np.int64]:
        """Where shift, log_zeta, size, the share of hysteretic damping, cords and motion begin."""
        n, m = self.point.theta.size, self.point.shift.size
        last = n + 3 * m + 1
        return np.array([n, n + m, n + 2 * m, n + 3 * m, last, last + cords(self.engine)])

    def _hysteretic(self, part: NDArray) -> float:
        """Share of the damping that is hysteretic, but of cords, which have none; and none at all where a record begins
        at rest: such damping answers before it is asked, and undoing the window of a hit would blow that up.
        """
        return 0.0 if self.decay else float(part[0])

    def _remainder(self, a: NDArray, b: NDArray, s: NDArray, soft: tuple[Soft, float, float]) -> NDArray:
        omega = np.where(self.engine.high_omega > 0, self.engine.high_omega, np.inf)
        zeta, h = soft[1] * self.engine.high_zeta, soft[2]
        square = np.real(s * s) if self.decay == 0.0 else s * s
        out = soft[0].between(a, b)[:, :, None] - ((a / omega**2) @ b.T)[:, :, None] * square
        out = out - ((a * (2.0 * zeta / omega)) @ b.T)[:, :, None] * s
        return out + h * self._lost(a, b, s, soft[1]) if h else out

    def _lost(self, a: NDArray, b: NDArray, s: NDArray, common: float) -> NDArray:
        """Derivative of the remainder to the share of hysteretic damping."""
        omega = np.where(self.engine.high_omega > 0, self.engine.high_omega, np.inf)
        zeta = common * self.engine.high_zeta
        return ((a * (2.0 * zeta / omega)) @ b.T)[:, :, None] * s - ((a * (2j * zeta)) @ b.T)[:, :, None]

    # ---------------------------------------------------------------- values

    def at(self, x: NDArray) -> Receptance:
        """Receptances at the vector `x`."""
        e = self.engine
        theta, shift, log_zeta, size, part, hung, motion = np.split(x, self.cuts)
        lost = self._hysteretic(part)
        st = e.state(theta)
        b = e.band_modes
        omega = st.omega.copy()
        omega[b] = omega[b] * (1 + shift)
        zeta = e.zeta0[: omega.size].copy()
        rigid = slice(0, e.rigid_modes)
        omega[rigid] = SUSPENDED * e.band[0] * np.exp(hung[:1])
        common = e.followed(log_zeta)
        outside = np.setdiff1d(np.arange(omega.size), b)
        zeta[outside] = np.minimum(zeta[outside] * common, 0.95)
        zeta[b] = np.exp(log_zeta)
        zeta[rigid] = CORDS * np.exp(hung[1:])
        # a lasting force on a rigid body has no response that lasts: of the mean it is left out
        least = RIGID * np.abs(self.s[1].imag)
        d = modal(omega, zeta, lost, self.decay, self.turn, least)
        d[rigid] = modal(omega[rigid], zeta[rigid], 0.0, self.decay, self.turn, least)
        load = st.load[:, 0].copy()
        load[b] += size * e.load_typical
        w = self.columns.T @ st.shape
        motion = motion.reshape(self.k, per_place(e))
        w[:, b] += motion[:, :-1] * self.w_typical
        w[:, self.above] *= 1.0 + motion[:, -1:]
        high_w, soft = self.high_w * (1.0 + motion[:, -1:]), (e.remainder.at(theta), common, lost)
        out, s = st.out, self.s[self.lines]
        here = d if self.lines.size == d.shape[1] else np.ascontiguousarray(d[:, self.lines])
        plain = combined(out.T * load, here)
        each = (out.T[:, None] * w[None]).reshape(-1, w.shape[1])
        h = combined(each, here).reshape(out.shape[1], self.k, s.size)
        z = combined(w * load, d)
        g = combined((w[:, None] * w[None]).reshape(-1, w.shape[1]), d).reshape(self.k, self.k, d.shape[1])
        if e.high.shape[1]:
            plain = plain + self._remainder(self.high_out, self.high_load, s, soft)[:, 0]
            h = h + self._remainder(self.high_out, high_w, s, soft)
            z = z + self._remainder(high_w, self.high_load, self.s, soft)[:, 0]
            g = g + self._remainder(high_w, high_w, self.s, soft)
        shared = None
        if e.coupling is not None:
            modes, shared = e.coupling.modes, e.coupling.at(e, st, theta - e.theta0, omega, zeta)
            driven = Between.of(modes, shared, here, s, np.hstack([load[:, None], w.T]))
            more = driven.added(out)
            plain, h = plain + more[:, 0], h + more[:, 1:]
            more = Between.of(modes, shared, d, self.s, np.hstack([load[:, None], w.T])).added(w.T)
            z, g = z + more[:, 0], g + more[:, 1:]
        if e.is_base:
            plain = plain + np.where(self.some, self.rigid_out[:, None] / self.safe**2, 0.0)[:, self.lines]
        rest = soft[0].between(high_w, high_w)
        reach = IDENTIFIED if isinstance(e.structure, ModalStructure) else JUMPING if self.jumps else MARCHED
        return Receptance(
            self.s, plain, h, z, g, self.lift, self.gain, omega, zeta, w, rest, d, out, load, self.lines, reach, shared
        )  # fmt: skip

    # ---------------------------------------------------------------- derivatives

    def derivatives(
        self, x: NDArray, r: Receptance, whole: bool = True
    ) -> tuple[NDArray, NDArray, NDArray, NDArray]:  # fmt: skip
        """Of plain (n, o, f), h (n, o, k, f), z (n, k, f) and g (n, k, k, f) to each entry of `x`.

        The first two stand on the sensors' lines, the others on all lines if `whole`, else on those lines too.
        """
        if not whole:
            return self._derivatives(x, r, r.d[:, self.lines], self.s[self.lines], (True, True))
        dp, dh = self.at_sensors(x, r)
        _, _, dz, dg = self._derivatives(x, r, r.d, self.s, (False, True))
        return dp, dh, dz, dg

    def at_sensors(self, x: NDArray, r: Receptance) -> tuple[NDArray, NDArray]:
        """Derivatives of plain (n, o, f) and h (n, o, k, f) alone."""
        dp, dh, _, _ = self._derivatives(x, r, r.d[:, self.lines], self.s[self.lines], (True, False))
        return dp, dh

    def _derivatives(
        self, x: NDArray, r: Receptance, d: NDArray, s: NDArray, wanted: tuple[bool, bool]
    ) -> tuple[NDArray, NDArray, NDArray, NDArray]:  # fmt: skip
        e, b = self.engine, self.engine.band_modes
        theta, shift, log_zeta, _, part, hung, motion = np.split(x, self.cuts)
        lost = self._hysteretic(part)
        st = e.state(theta)
        sensors, places = wanted
        n_t, m_b, k, n_f = theta.size, b.size, self.k, s.size
        grown = 1.0 + motion.reshape(self.k, m_b + 1)[:, -1]
        n_o = len(e.outputs) if sensors else 0
        last = n_t + 3 * m_b + 1 + hung.size
        n, kp = last + k * (m_b + 1), k if places else 0
        dp = np.zeros((n, n_o, n_f), complex)
        dh = np.zeros((n, n_o, k, n_f), complex)
        dz = np.zeros((n, kp, n_f), complex)
        dg = np.zeros((n, kp, kp, n_f), complex)
        share = np.full((r.omega.size, 1), lost)
        share[: e.rigid_modes] = 0.0
        rate = (1 - share) * s + 1j * share * r.omega[:, None]
        square = d**2
        own, zeta = r.omega[:, None], r.zeta[:, None]
        by_omega = -square * (2 * own + 2j * share * zeta * own + 2 * zeta * rate)
        by_zeta = -square * (2 * (r.omega * r.zeta)[:, None] * rate)
        common, high_w = e.followed(log_zeta), self.high_w * grown[:, None]
        soft = e.remainder.at(theta), common, lost
        rests = [
            soft[0].changes(one, other)
            for one, other in (
                (self.high_out, self.high_load), (self.high_out, high_w), (high_w, self.high_load), (high_w, high_w)
            )
        ]  # fmt: skip
        for j in range(n_t):
            if sensors:
                dp[j] += rests[0][j]
                dh[j] += rests[1][j][..., None]
            if places:
                dz[j] += rests[2][j]
                dg[j] += rests[3][j][..., None]
            dd = by_omega * (st.d_log[j] * r.omega)[:, None]
            dw = (self.columns.T @ st.shape) @ st.mix[j]
            dw[:, self.above] *= grown[:, None]
            do, dl = st.d_out[j], st.d_load[j][:, 0]
            if sensors:
                dp[j] += (do.T * r.load + r.out.T * dl) @ d + (r.out.T * r.load) @ dd
            for a in range(k):
                if sensors:
                    dh[j, :, a] += (do.T * r.w[a] + r.out.T * dw[a]) @ d + (r.out.T * r.w[a]) @ dd
                if not places:
                    continue
                dz[j, a] += (dw[a] * r.load + r.w[a] * dl) @ d + (r.w[a] * r.load) @ dd
                for c in range(k):
                    dg[j, a, c] += (dw[a] * r.w[c] + r.w[a] * dw[c]) @ d + (r.w[a] * r.w[c]) @ dd
        at = n_t
        for i, mode in enumerate(b):
            o, w, load = r.out[mode], r.w[:, mode], r.load[mode]
            for first, dd in ((at, by_omega[mode] * r.omega[mode] / (1 + shift[i])), (at + m_b, by_zeta[mode])):
                row = first + i
                if sensors:
                    dp[row] = (o * load)[:, None] * dd
                    dh[row] = np.outer(o, w)[:, :, None] * dd
                if places:
                    dz[row] = (w * load)[:, None] * dd
                    dg[row] = np.outer(w, w)[:, :, None] * dd
            row = at + 2 * m_b + i
            one = d[mode] * e.load_typical[i]
            if sensors:
                dp[row] = o[:, None] * one
            if places:
                dz[row] = w[:, None] * one
            for a in range(k):
                row = last + a * (m_b + 1) + i
                one = d[mode] * self.w_typical[a, i]
                if sensors:
                    dh[row, :, a] = o[:, None] * one
                if places:
                    dz[row, a] = load * one
                    dg[row, a] += w[:, None] * one
                    dg[row, :, a] += w[:, None] * one
        rigid = slice(0, e.rigid_modes)
        for row, dd in zip(range(at + 3 * m_b + 1, last), (by_omega * r.omega[:, None], by_zeta), strict=False):
            o, w, one = r.out[rigid].T, r.w[:, rigid], dd[rigid]
            if sensors:
                dp[row] = (o * r.load[rigid]) @ one
                dh[row] = np.einsum("or,kr,rf->okf", o, w, one)
            if places:
                dz[row] = (w * r.load[rigid]) @ one
                dg[row] = np.einsum("ar,cr,rf->acf", w, w, one)
        hi, high = self.above, bool(e.high.shape[1])
        if not self.decay:
            row, dd = at + 3 * m_b, -square * (2 * own * zeta * (1j * own - s))
            dd[rigid] = 0.0
            if sensors:
                dp[row] = (r.out.T * r.load) @ dd
                dh[row] = np.einsum("or,kr,rf->okf", r.out.T, r.w, dd)
                if high:
                    dp[row] += self._lost(self.high_out, self.high_load, s, common)[:, 0]
                    dh[row] += self._lost(self.high_out, high_w, s, common)
            if places:
                dz[row] = (r.w * r.load) @ dd
                dg[row] = np.einsum("ar,cr,rf->acf", r.w, r.w, dd)
                if high:
                    dz[row] += self._lost(high_w, self.high_load, s, common)[:, 0]
                    dg[row] += self._lost(high_w, high_w, s, common)
        for a in range(k):
            row = last + a * (m_b + 1) + m_b
            one = (r.w[a, hi] / grown[a])[:, None] * d[hi]
            if sensors:
                dh[row, :, a] = r.out[hi].T @ one
                if high:
                    dh[row, :, a] += self._remainder(self.high_out, self.high_w[[a]], s, soft)[:, 0]
            if not places:
                continue
            dz[row, a] = r.load[hi] @ one
            each = r.w[:, hi] @ one
            if high:
                dz[row, a] += self._remainder(self.high_w[[a]], self.high_load, s, soft)[0, 0]
                each = each + self._remainder(high_w, self.high_w[[a]], s, soft)[:, 0]
            dg[row, a] += each
            dg[row, :, a] += each
        if r.shared is not None:
            by_share = -square * (2 * own * zeta * (1j * own - s))
            by_share[rigid] = 0.0
            self._between(x, r, (d, s), (by_omega, by_zeta, by_share), wanted, (dp, dh, dz, dg))
        return dp, dh, dz, dg

    def _between(
        self, x: NDArray, r: Receptance, at: tuple[NDArray, NDArray], rates: tuple[NDArray, NDArray, NDArray],
        wanted: tuple[bool, bool], slopes: tuple[NDArray, NDArray, NDArray, NDArray],
    ) -> None:  # fmt: skip
        """Add to the derivatives `slopes` those of what modes share by damping, `at` modal receptances and lines, with
        derivatives `rates` of the former by frequency, by the logarithm of damping and by the hysteretic share.
        """
        e, b, k = self.engine, self.engine.band_modes, self.k
        assert e.coupling is not None
        assert r.shared is not None
        theta, shift, _, _, _, hung, motion = np.split(x, self.cuts)
        st, modes, (by_omega, by_zeta, by_share) = e.state(theta), e.coupling.modes, rates
        n_t, m_b, m = theta.size, b.size, r.omega.size
        last = n_t + 3 * m_b + 1 + hung.size
        grown = 1.0 + motion.reshape(k, m_b + 1)[:, -1]
        kinds = [i for i, w in enumerate((wanted[0], wanted[0], wanted[1], wanted[1])) if w]
        pairs = tuple(((0, 1), (0, 2), (2, 1), (2, 2))[i] for i in kinds)
        among = Among.of(modes, r.shared, *at, (r.out, r.load[:, None], np.ascontiguousarray(r.w.T)), pairs)

        def put(row: int, **change: Any) -> None:
            for i, one in zip(kinds, among.slopes(**change), strict=True):
                slopes[i][row] += one[:, 0] if i in (0, 2) else one

        for j in range(n_t):
            moved = (self.columns.T @ st.shape) @ st.mix[j]
            moved[:, self.above] *= grown[:, None]
            less = among.one.eased(st.d_log[j, modes] - r.shared.own_rates[j])
            dd = by_omega * (st.d_log[j] * r.omega)[:, None]
            put(j, moved=(st.d_out[j], st.d_load[j], moved.T), dd=dd, damping=r.shared.slopes[j] + less)
        for i, mode in enumerate(b):
            only = (np.arange(m) == mode).astype(float)
            over = 1.0 / (1.0 + shift[i])
            put(n_t + i, dd=by_omega * (only * r.omega * over)[:, None], damping=among.one.eased(only[modes] * over))
            put(n_t + m_b + i, dd=by_zeta * only[:, None], damping=among.one.eased(only[modes]))
            put(n_t + 2 * m_b + i, moved=(None, (only * e.load_typical[i])[:, None], None))
            for a in range(k):
                here = np.outer(only * self.w_typical[a, i], np.arange(k) == a)
                put(last + a * (m_b + 1) + i, moved=(None, None, here))
        if not self.decay:
            put(n_t + 3 * m_b, dd=by_share)
        for a in range(k):
            here = np.zeros((m, k))
            here[self.above, a] = r.w[a, self.above] / grown[a]
            put(last + a * (m_b + 1) + m_b, moved=(None, None, here))
