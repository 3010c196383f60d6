r"""Steady response to a periodic input with nonlinear forces, by shooting with exact tangents.

The linear response to the input is taken line by line from the exact receptances. What the nonlinear forces cause is
marched over one period, and the state at its start is corrected by Newton's method until the period closes. How the
march differs from the exact receptances, line by line, is put into its source, so that the hold between steps costs
nothing:

.. math:: z(\omega) = z_0 U + (G - G_d) F + G_d F, \quad F = -\mathcal{F}\{\mathrm{law}(z, \dot z)\}

The eigenvalues of the closing tangents are the Floquet multipliers of the orbit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft
from scipy.linalg import matrix_balance

from labnnum.diagnosis.nonlinear.march import N_P, march
from labnnum.diagnosis.nonlinear.receptance import RIGID, Receptance
from labnnum.diagnosis.nonlinear.run import Run, precise
from labnnum.errors import EstimationError

PASSES = (4, 2)
"""Marches over a run that does not close, at most, from nothing and from a neighbour: each corrects the one before."""


SINGULAR = 1e-9
"""Singular value of the closing gap, of the largest, below which a motion is one that no force brings back."""


STALLED, ON = 0.6, 2
"""Part of the gap that a step of Newton's method must not leave open, or so many periods are marched after it."""


@dataclass(frozen=True, eq=False)
class Orbit:
    """A steady state: modal state (2, m), forces (k,) and memory (k, 2) just before time 0, and over the period.

    `force` (k, n_lines) spectrum of the forces on the structure, `time` (n, k) the same in time, `motion` (n, k, 2).
    `closing` relative change of the state over the period; `bad` steps whose forces did not settle.
    """

    x: NDArray
    f: NDArray
    memory: NDArray
    force: NDArray
    time: NDArray
    motion: NDArray
    closing: float = np.inf
    bad: int = 0
    floquet: NDArray | None = None
    inverse: NDArray | None = None


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the force spectrum, (n, k, lines): to the base model's vector, then to the laws' parameters."""

    force: NDArray


class Steady:
    """Steady responses to the input of `run`, with nonlinear forces of the laws `codes` (k,).

    Parameters
    ----------
    run : Run
    codes : sequence of int
        See `labnnum.diagnosis.nonlinear.march.CODES`.
    fine : int
        Steps of the march to a sample.
    """

    def __init__(self, run: Run, codes: NDArray, fine: int) -> None:
        self.run, self.codes = run, np.asarray(codes, np.int64)
        self.k = self.codes.size
        self.fine = fine
        self.n = run.period * fine
        self.step = 1.0 / (run.rate * fine)
        self.lines = run.u.size
        self.top = int(np.flatnonzero(run.excited)[-1])
        self.growth = np.exp(run.decay * self.step * np.arange(self.n)) if run.decay else None
        """What undoes the window of a hit, sample by sample."""

    # ---------------------------------------------------------------- the march of one receptance

    def prepare(self, r: Receptance) -> _Prepared:
        """Transition, weights and discrete transfers of a receptance's modes (remembered with it)."""
        if self.step not in r.marches:
            r.marches[self.step] = self._prepare(r)
        return r.marches[self.step]

    def _prepare(self, r: Receptance) -> _Prepared:
        slow = np.flatnonzero(r.omega < r.reach * np.abs(r.s[self.top]))  # faster ones follow at once, exactly by lines
        fast = np.setdiff1d(np.arange(r.omega.size), slow)
        omega, zeta, w = r.omega[slow], r.zeta[slow], np.ascontiguousarray(r.w[:, slow])
        rest = r.rest + (r.w[:, fast] / r.omega[fast] ** 2) @ r.w[:, fast].T
        low = np.abs(r.s[1].imag)
        omega[omega < RIGID * low] = 0.0  # rigid bodies, held by the forces alone
        T, W0, W1 = _held(omega, zeta, self.step)
        turn = np.exp(r.s * self.step)
        a, b, c, d = T[:, :, None]
        det = (turn - a) * (turn - d) - b * c
        nowhere = det == 0.0  # the mean of a force on a rigid body, which a period that closes has not
        det[nowhere] = 1.0
        drive0 = W0[0][:, None] + turn * W1[0][:, None]
        drive1 = W0[1][:, None] + turn * W1[1][:, None]
        xq = ((turn - d) * drive0 + b * drive1) / det
        xv = (c * drive0 + (turn - a) * drive1) / det
        xq[nowhere] = xv[nowhere] = 0.0
        k = w.shape[0]
        pairs = (w[:, None] * w[None]).reshape(k * k, omega.size)
        gz = (pairs @ xq).reshape(k, k, r.s.size) + rest[:, :, None]
        gv = (pairs @ xv).reshape(k, k, r.s.size)
        inner = (w * W1[0]) @ w.T + rest
        back = rest / self.step  # what follows at once has a speed as well
        gv += back[:, :, None] * (1 - 1 / turn)
        rate = (w * W1[1]) @ w.T + back
        return _Prepared(
            T, W0, W1,
            w, inner, rate, back, r.g - gz, r.s * r.g - gv, xq, xv,
        )  # fmt: skip

    def to_time(self, spectrum: NDArray) -> NDArray[np.float64]:
        """Spectrum (..., n_lines) to n fine samples (..., n)."""
        full = np.zeros((*spectrum.shape[:-1], self.n // 2 + 1), complex)
        full[..., : self.lines] = spectrum
        if self.fine > 1 and self.run.period % 2 == 0:
            full[..., self.lines - 1] *= 0.5
        time = np.fft.irfft(full * (self.n / 2), self.n, axis=-1)
        return time if self.growth is None else time * self.growth

    def to_lines(self, time: NDArray) -> NDArray[np.complex128]:
        """Fine samples (n, ...) to spectra (..., n_lines)."""
        if self.growth is not None:
            time = time / self.growth.reshape(-1, *(1,) * (time.ndim - 1))
        return np.moveaxis(np.fft.rfft(time, axis=0)[: self.lines] * (2 / self.n), 0, -1)

    def tangents(self, time: NDArray) -> NDArray[np.complex128]:
        """Tangents (n, k, t) to spectra (t, k, n_lines), in single precision."""
        if self.growth is not None:
            time = time / self.growth[:, None, None]
        rows = np.ascontiguousarray(np.moveaxis(time, 0, -1).swapaxes(0, 1), np.float32)
        return np.asarray(rfft(rows)[..., : self.lines], complex) * (2 / self.n)

    def pushed(self, push: NDArray, s: NDArray) -> NDArray[np.float64]:
        """Sources (n, k, 2, t) of tangents whose motions' spectra are (t, k, n_lines)."""
        full = np.zeros((*push.shape[:2], 2, self.n // 2 + 1), precise(self.run))
        full[:, :, 0, : self.lines], full[:, :, 1, : self.lines] = push, s * push
        time = irfft(full) * full.real.dtype.type(self.n / 2)
        if self.growth is not None:
            time = time * self.growth
        return np.ascontiguousarray(np.moveaxis(np.asarray(time), (0, 3), (3, 0)), float)

    def source(self, r: Receptance, made: _Prepared, force: NDArray) -> NDArray[np.float64]:
        """Motion (n, k, 2) at the places that the march does not produce itself."""
        drive = r.gain * self.run.u
        z = r.z * drive + (made.miss_z * force).sum(axis=1)
        v = r.s * r.z * drive + (made.miss_v * force).sum(axis=1)
        return np.ascontiguousarray(np.moveaxis(self.to_time(np.stack([z, v], axis=1)), -1, 0))

    def state_of(self, r: Receptance, made: _Prepared, force: NDArray) -> NDArray[np.float64]:
        """Modal state (2, m) just before time 0 of a force spectrum."""
        push = made.w.T @ force * np.exp(-r.s * self.step)
        push[:, 0] *= 0.5
        return np.stack([np.real((made.xq * push).sum(axis=1)), np.real((made.xv * push).sum(axis=1))])

    def guess(self, r: Receptance, time: NDArray) -> Orbit:
        """The orbit to start from when the forces (n, k) on the structure are roughly known."""
        force = self.to_lines(time)
        made = self.prepare(r)
        x = self.state_of(r, made, force)
        motion = np.zeros((self.n, self.k, 2))
        memory = np.zeros((self.k, 2))
        return Orbit(x, time[-1].copy(), memory, force, time, motion)

    def settle(
        self, r: Receptance, p: NDArray, orbit: Orbit, steps: int, tolerance: float = 3e-4, warm: int = 0
    ) -> Orbit:
        """Newton's method from `orbit` to the steady state with laws' parameters p (k, N_P), after `warm` periods."""
        orbit = self._own_steps(r, orbit)
        if not self.run.lasting:
            return self._passes(r, p, orbit, tolerance)
        made = self.prepare(r)
        m = made.w.shape[1]
        last = np.inf
        for _ in range(steps):
            if warm > 0:
                warm -= 1
                one = self._march(made, self.source(r, made, orbit.force), p, orbit)
                if not np.isfinite(one.state).all():
                    return replace(orbit, closing=np.inf)
                x, f, memory = _parts(one.state, m, self.k)
                orbit = Orbit(x, f, memory, self.to_lines(one.time), one.time, one.motion, 1.0, one.bad)
                continue
            chord = orbit.inverse is not None and orbit.inverse.shape[0] == 2 * m + 3 * self.k and orbit.closing < 0.02
            source = self.source(r, made, orbit.force)
            one = self._march(made, source, p, orbit, homogeneous=not chord)
            if not np.isfinite(one.state).all():
                return replace(orbit, closing=np.inf)
            if chord:
                inverse = orbit.inverse
                assert inverse is not None
                start = _state(orbit) + inverse @ (one.state - _state(orbit))
                time = one.time
            else:
                inverse = _closing(one.end)
                change = inverse @ (one.state - _state(orbit))
                start = _state(orbit) + change
                time = one.time + one.slopes @ change
                scale = np.linalg.norm(one.time) + 1e-300
                if not np.isfinite(change).all() or np.linalg.norm(time - one.time) > 3 * scale:
                    start, time, inverse = one.state, one.time, None  # too far for Newton: march on
            closing = _relative(time - orbit.time, time)
            if chord and closing > 0.3 * orbit.closing:
                inverse = None  # the chord has worn out
            x, f, memory = _parts(start, m, self.k)
            orbit = Orbit(
                x, f, memory, self.to_lines(time), time, one.motion, closing, one.bad,
                orbit.floquet if chord else one.end, inverse,
            )  # fmt: skip
            if closing < tolerance:
                break
            if not chord and closing > STALLED * last:
                warm, closing = ON, np.inf  # jumps of the force lead Newton's method in circles
            last = closing
        return orbit

    def _own_steps(self, r: Receptance, orbit: Orbit) -> Orbit:
        """The orbit on this march's steps and modes, where it came from one with others."""
        made = self.prepare(r)
        if orbit.x.shape[1] != made.w.shape[1]:  # a mode has moved out of those that are marched, or into them
            orbit = replace(orbit, x=self.state_of(r, made, orbit.force), closing=np.inf, inverse=None, floquet=None)
        if orbit.time.shape[0] == self.n:
            return orbit
        time = np.ascontiguousarray(np.moveaxis(self.to_time(orbit.force), -1, 0))
        motion = np.zeros((self.n, self.k, 2))
        return replace(orbit, time=time, motion=motion, closing=np.inf, inverse=None, floquet=None)

    def _passes(self, r: Receptance, p: NDArray, orbit: Orbit, tolerance: float) -> Orbit:
        """The march from rest (a hit), or from where the stretch ends (an open run), until its correction stands."""
        made = self.prepare(r)
        m = made.w.shape[1]
        rest = np.zeros((2, m)), np.zeros(self.k), np.zeros((self.k, 2))
        for _ in range(PASSES[int(np.isfinite(orbit.closing))]):
            if self.run.decay:
                orbit = replace(orbit, x=rest[0], f=rest[1], memory=rest[2])
            one = self._march(made, self.source(r, made, orbit.force), p, orbit)
            if not np.isfinite(one.state).all():
                return replace(orbit, closing=np.inf)
            x, f, memory = _parts(one.state, m, self.k)
            change, size = one.time - orbit.time, np.linalg.norm(one.time) + 1e-300
            closing = float(np.linalg.norm(change) / size)
            orbit = Orbit(x, f, memory, self.to_lines(one.time), one.time, one.motion, closing, one.bad)
            if closing < tolerance:
                break
        return orbit

    def slopes(
        self,
        r: Receptance,
        p: NDArray,
        orbit: Orbit,
        base: tuple[NDArray, NDArray],
        vary: NDArray,
        *,
        exact: bool = True,
    ) -> tuple[Orbit, Slopes]:
        """The orbit marched once more, and the derivatives of its forces on the sensors' lines.

        Parameters
        ----------
        base : (dz, dg)
            Derivatives of `Receptance.z` and `.g` to the base model's vector, (n_b, k, f) and (n_b, k, k, f); on the
            sensors' lines only if not `exact`.
        vary : ndarray, shape (n_law, k, N_P)
            Directions of the laws' parameters.
        exact : bool
            Whether the tangents to the base model's vector are marched, or taken by describing functions.
        """
        made = self.prepare(r)
        source = self.source(r, made, orbit.force)
        ds = None
        if exact:
            dz, dg = base
            push = dz * (r.gain * self.run.u)
            for c in range(self.k):
                push = push + dg[:, :, c] * orbit.force[c]
            ds = self.pushed(push, r.s)
        if not self.run.lasting:
            return self._open_slopes(r, p, orbit, base, vary, ds)
        one = self._march(made, source, p, orbit, homogeneous=True, vary=vary, ds=ds)
        if not np.isfinite(one.end).all():
            raise EstimationError("the steady response does not settle")
        n = vary.shape[0] + (0 if ds is None else ds.shape[3])
        phi, part = one.end[:, n:], one.end[:, :n]
        gap = (one.state - _state(orbit))[:, None]
        inverse = _closing(phi)
        closing = inverse @ np.hstack([part, gap])
        whole = one.slopes[:, :, :n] + one.slopes[:, :, n:] @ closing[:, :-1]
        time = one.time + one.slopes[:, :, n:] @ closing[:, -1]
        x, f, memory = _parts(_state(orbit) + closing[:, -1], made.w.shape[1], self.k)
        rel = _relative(time - orbit.time, time)
        new = replace(
            orbit, force=self.to_lines(time), time=time, motion=one.motion, closing=rel, x=x, f=f, memory=memory,
            floquet=phi, inverse=inverse,
        )  # fmt: skip
        moved = self.tangents(whole)[..., r.lines]
        if not exact:
            moved = np.concatenate([self._base_slopes(r, orbit, base), moved])
        return new, Slopes(moved)

    def _open_slopes(
        self, r: Receptance, p: NDArray, orbit: Orbit, base: tuple[NDArray, NDArray], vary: NDArray, ds: NDArray | None
    ) -> tuple[Orbit, Slopes]:
        """The same where no period closes: the tangents begin at rest too, and what they forget does not count."""
        made = self.prepare(r)
        m = made.w.shape[1]
        begin = replace(orbit, x=np.zeros((2, m)), f=np.zeros(self.k), memory=np.zeros((self.k, 2)))
        begin = begin if self.run.decay else orbit
        one = self._march(made, self.source(r, made, orbit.force), p, begin, vary=vary, ds=ds)
        if not (np.isfinite(one.slopes).all() and np.isfinite(one.time).all()):
            raise EstimationError("the response does not settle")
        x, f, memory = _parts(one.state, m, self.k)
        change = _relative(one.time - orbit.time, one.time)
        new = Orbit(x, f, memory, self.to_lines(one.time), one.time, one.motion, float(change), one.bad)
        moved = self.tangents(one.slopes)[..., r.lines]
        if ds is None:
            moved = np.concatenate([self._base_slopes(r, new, base), moved])
        return new, Slopes(moved)

    def _base_slopes(self, r: Receptance, orbit: Orbit, base: tuple[NDArray, NDArray]) -> NDArray[np.complex128]:
        """Derivatives of the forces (n_b, k, f) to the base model's vector, each law taken by its describing function.

        The spring and dashpot that best stand for a force along its motion answer to a change of the model; what a
        change at one line does to the others is left out.
        """
        here = r.lines
        drive = (r.gain * self.run.u)[here]
        dz, dg = base
        push = dz * drive
        for c in range(self.k):
            push = push + dg[:, :, c] * orbit.force[c, here]
        s, g = r.s[here], r.g[..., here]
        law = np.zeros((self.k, s.size), complex)
        for e in range(self.k):
            z, v, f = orbit.motion[:, e, 0], orbit.motion[:, e, 1], orbit.time[:, e]
            z, v = z - z.mean(), v - v.mean()
            law[e] = -(z @ f) / max(z @ z, 1e-300) - s * (v @ f) / max(v @ v, 1e-300)
        if self.k == 1:
            return -law * push / (1 + law * g[0])
        loop = np.moveaxis(law[:, None] * g, 2, 0) + np.eye(self.k)
        right = -np.moveaxis(law * push, (0, 1, 2), (2, 1, 0))
        return np.asarray(np.moveaxis(np.linalg.solve(loop, right), (0, 1, 2), (2, 1, 0)), complex)

    def _march(
        self, made: _Prepared, source: NDArray, p: NDArray, orbit: Orbit, *, homogeneous: bool = False,
        ds: NDArray | None = None, vary: NDArray | None = None,
    ) -> _Marched:  # fmt: skip
        m, k = made.w.shape[1], self.k
        n_s = 0 if ds is None else ds.shape[3]
        n_v = 0 if vary is None else vary.shape[0]
        n_h = 2 * m + 3 * k if homogeneous else 0
        nt = n_s + n_v + n_h
        X = np.zeros((2, m, nt))
        if homogeneous:
            X.reshape(2 * m, nt)[np.arange(2 * m), n_s + n_v + np.arange(2 * m)] = 1.0
        df, dmem = np.zeros((k, nt)), np.zeros((k, 2, nt))
        if homogeneous:
            df[np.arange(k), n_s + n_v + 2 * m + np.arange(k)] = 1.0
            dmem.reshape(2 * k, nt)[np.arange(2 * k), n_s + n_v + 2 * m + k + np.arange(2 * k)] = 1.0
        dp = np.zeros((k, N_P, nt))
        if vary is not None:
            dp[:, :, n_s : n_s + n_v] = np.moveaxis(vary, 0, -1)
        if ds is None:
            ds = np.zeros((self.n, k, 2, 0))
        forces, motion = np.empty((self.n, k)), np.empty((self.n, k, 2))
        slopes = np.empty((self.n, k, nt))
        x, f, memory = orbit.x.copy(), orbit.f.copy(), orbit.memory.copy()
        bad = march(
            made.T, made.W0, made.W1, made.w, made.inner, made.rate, made.back, source, self.codes,
            np.ascontiguousarray(p), x, f, memory, forces, motion, X, df, dmem, dp, ds, slopes,
        )  # fmt: skip
        end = np.concatenate([X.reshape(2 * m, nt), df, dmem.reshape(2 * k, nt)])
        return _Marched(np.concatenate([x.reshape(-1), f, memory.reshape(-1)]), forces, motion, end, slopes, bad)


def _held(omega: NDArray, zeta: NDArray, step: float) -> tuple[NDArray, NDArray, NDArray]:
    """Transition (4, m) of each mode over a step, and weights (2, m) of a force straight between its ends.

    A mode of frequency zero is a rigid body.
    """
    free = omega == 0.0
    omega = np.where(free, 1.0, omega)
    rate = zeta * omega
    turn = omega * np.sqrt((1 - zeta**2).astype(complex))
    decay = np.exp(-rate * step)
    c = np.real(np.cos(turn * step))
    s = np.real(np.sin(turn * step) / turn)
    T = decay * np.array([c + rate * s, s, -(omega**2) * s, c - rate * s])
    square = omega**2
    whole = np.array([(1 - T[0]) / square, T[1]])  # A^-1 (T - I) B, with A^-1 = [[-2 rate, -1], [w^2, 0]] / w^2
    slope0, slope1 = whole[0] / step, whole[1] / step - 1.0
    W1 = np.array([(-2 * rate * slope0 - slope1) / square, slope0])
    T[:, free] = np.array([1.0, step, 0.0, 1.0])[:, None]
    whole[:, free] = np.array([step**2 / 2, step])[:, None]
    W1[:, free] = np.array([step**2 / 6, step / 2])[:, None]
    return T, whole - W1, W1


def _closing(phi: NDArray) -> NDArray[np.float64]:
    """(I - phi)^-1: from the gap at the end of the period to the change of its start; what nothing holds stays."""
    gap = np.eye(phi.shape[0]) - phi
    if not np.isfinite(gap).all():
        return np.full(gap.shape, np.nan)
    even, (scale, _) = matrix_balance(gap, permute=False, separate=True)  # metres beside newtons
    return scale[:, None] * np.linalg.pinv(even, rcond=SINGULAR) / scale


def _state(orbit: Orbit) -> NDArray[np.float64]:
    return np.concatenate([orbit.x.reshape(-1), orbit.f, orbit.memory.reshape(-1)])


def _parts(state: NDArray, m: int, k: int) -> tuple[NDArray, NDArray, NDArray]:
    return state[: 2 * m].reshape(2, m).copy(), state[2 * m : 2 * m + k].copy(), state[2 * m + k :].reshape(k, 2).copy()


@dataclass(frozen=True, eq=False)
class _Prepared:
    T: NDArray
    W0: NDArray
    W1: NDArray
    w: NDArray
    inner: NDArray
    rate: NDArray
    back: NDArray
    miss_z: NDArray
    miss_v: NDArray
    xq: NDArray
    xv: NDArray


@dataclass(frozen=True, eq=False)
class _Marched:
    state: NDArray
    time: NDArray
    motion: NDArray
    end: NDArray
    slopes: NDArray
    bad: int


def _relative(change: NDArray, whole: NDArray) -> float:
    """Norm of a change over that of the whole; infinite where there is no whole to speak of."""
    part, size = float(np.linalg.norm(change)), float(np.linalg.norm(whole))
    if part == 0.0:
        return 0.0
    return part / size if size > 1e-12 * part else float("inf")
