r"""Steady response to a periodic input with nonlinear forces, by shooting with exact tangents.

The linear response to the input is taken line by line from the exact receptances. What the nonlinear forces cause is
marched over one period, and the state at its start is corrected by Newton's method until the period closes. How the
march differs from the exact receptances, line by line, is put into its source, so that the hold between steps costs
nothing:

.. math:: z(\omega) = z_0 U + (G - G_d) F + G_d F, \quad F = -\mathcal{F}\{\mathrm{law}(z, \dot z)\}

The eigenvalues of the closing tangents are the Floquet multipliers of the orbit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft

from labnnum.diagnosis.nonlinear.discrete import Discrete, described, discrete, feedback
from labnnum.diagnosis.nonlinear.effort import marched, transformed
from labnnum.diagnosis.nonlinear.force import CODES, N_P, remembered
from labnnum.diagnosis.nonlinear.march import march
from labnnum.diagnosis.nonlinear.orbit import CLOSED, Marched, Orbit, Slopes, closed, parts_of, relative, state_of
from labnnum.diagnosis.nonlinear.receptance import Receptance
from labnnum.diagnosis.nonlinear.run import Run, precise
from labnnum.diagnosis.nonlinear.tie import resampled, tied_march
from labnnum.errors import EstimationError

PASSES = (4, 2)
"""Marches over a run that does not close, at most, from nothing and from a neighbour: each corrects the one before."""


SPEEDS = [CODES[law] for law in ("coulomb", "quadratic-damping", "general")]
"""Laws that feel the speed at their place."""
FREE = np.zeros((0, 0))
"""No tie (see `march`)."""

STALLED, ON = 0.6, 2
"""Part of the gap that a step of Newton's method must not leave open, or so many periods are marched after it."""


class Steady:
    """Steady responses to the input of `run`, with nonlinear forces of the laws `codes` (k,).

    Parameters
    ----------
    run : Run
    codes : sequence of int
        See `labnnum.diagnosis.nonlinear.force.CODES`.
    fine : int
        Steps of the march to a sample.
    """

    def __init__(self, run: Run, codes: NDArray, fine: int) -> None:
        self.run, self.codes = run, np.asarray(codes, np.int64)
        self.k = self.codes.size
        self.room = remembered(self.codes.tolist())
        self.fine = fine
        self.n = run.period * fine
        self.step = 1.0 / (run.rate * fine)
        self.lines = run.u.size
        self.top = int(np.flatnonzero(run.excited)[-1])
        self.growth = np.exp(run.decay * self.step * np.arange(self.n)) if run.decay else None
        """What undoes the window of a hit, sample by sample."""

    # ---------------------------------------------------------------- the march of one receptance

    def prepare(self, r: Receptance) -> Discrete:
        """Transition, weights and discrete transfers of a receptance's modes (remembered with it)."""
        if self.step not in r.marches:
            r.marches[self.step] = discrete(r, self.step, self.top, self.codes == CODES["coulomb"])
        return r.marches[self.step]

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
        transformed(self.n, time.shape[1] * time.shape[2])
        rows = np.ascontiguousarray(np.moveaxis(time, 0, -1).swapaxes(0, 1), np.float32)
        return np.asarray(np.asarray(rfft(rows))[..., : self.lines] * np.float32(2 / self.n), np.complex128)

    def pushed(self, push: NDArray, s: NDArray, speeds: bool = True) -> NDArray[np.float32]:
        """Sources (n, k, 2, t) of tangents whose motions' spectra are (t, k, n_lines), in single precision; without the
        speeds where nothing feels them.
        """
        n_t, k, _ = push.shape
        full = np.zeros((self.n // 2 + 1, k, 2 if speeds else 1, n_t), precise(self.run))
        scaled = np.asarray(push.transpose(2, 1, 0) * (self.n / 2), full.dtype)
        full[: self.lines, :, 0] = scaled
        if speeds:
            full[: self.lines, :, 1] = np.asarray(s, full.dtype)[:, None, None] * scaled
        time = np.asarray(irfft(full, self.n, axis=0, overwrite_x=True))
        if self.growth is not None:
            time = time * self.growth[:, None, None, None]
        transformed(self.n, full.shape[1] * full.shape[2] * n_t)
        if speeds:
            return np.ascontiguousarray(time, np.float32)
        out = np.zeros((self.n, k, 2, n_t), np.float32)
        out[:, :, 0] = time[:, :, 0]
        return out

    def source(self, r: Receptance, made: Discrete, force: NDArray) -> NDArray[np.float64]:
        """Motion (n, k, 2) at the places that the march does not produce itself."""
        drive = r.gain * self.run.u
        z = r.z * drive + (made.miss_z * force).sum(axis=1)
        v = r.s * r.z * drive + (made.miss_v * force).sum(axis=1)
        return np.ascontiguousarray(np.moveaxis(self.to_time(np.stack([z, v], axis=1)), -1, 0))

    def fed(
        self, r: Receptance, made: Discrete, orbit: Orbit, motion: NDArray, time: NDArray, force: NDArray
    ) -> NDArray[np.complex128] | None:  # fmt: skip
        """What the next march is corrected by, after one from `orbit` that gave `force`; None for `force` itself."""
        loop = feedback(made, r, motion, time) if np.isfinite(time).all() else None
        if loop is None:
            return None
        return orbit.source + (loop * (force - orbit.source)).sum(axis=1)

    def fed_on(self, r: Receptance, made: Discrete, orbit: Orbit, moved: NDArray) -> NDArray[np.complex128]:
        """Derivatives of the forces (t, k, f), the march's own, with what they do to its correction."""
        loop = feedback(made, r, orbit.motion, orbit.time) if orbit.fed is not None else None
        return moved if loop is None else (loop[:, :, r.lines] * moved[:, None]).sum(axis=2)

    def begun(self, r: Receptance, made: Discrete, force: NDArray) -> NDArray[np.float64]:
        """Modal state (2, m) just before time 0 of a force spectrum."""
        push = made.w.T @ force * np.exp(-r.s * self.step)
        push[:, 0] *= 0.5
        return np.stack([np.real((made.xq * push).sum(axis=1)), np.real((made.xv * push).sum(axis=1))])

    def guess(self, r: Receptance, time: NDArray) -> Orbit:
        """The orbit to start from when the forces (n, k) on the structure are roughly known."""
        force = self.to_lines(time)
        made = self.prepare(r)
        x = self.begun(r, made, force)
        motion = np.zeros((self.n, self.k, 2))
        memory = np.zeros((self.k, self.room))
        return Orbit(x, time[-1].copy(), memory, force, time, motion)

    @np.errstate(over="ignore", invalid="ignore")  # a law that pushes may go beyond all numbers
    def settle(
        self, r: Receptance, p: NDArray, orbit: Orbit, steps: int, tolerance: float = CLOSED, warm: int = 0
    ) -> Orbit:
        """Newton's method from `orbit` to the steady state with laws' parameters p (k, N_P), after `warm` periods; the
        period closes to `tolerance`, relative.
        """
        orbit = self._own_steps(r, orbit)
        if not self.run.lasting:
            return self._passes(r, p, orbit, tolerance)
        made = self.prepare(r)
        m = made.w.shape[1]
        last = np.inf
        for _ in range(steps):
            if warm > 0:
                warm -= 1
                one = self._march(made, self.source(r, made, orbit.source), p, orbit)
                if not np.isfinite(one.state).all():
                    return replace(orbit, closing=np.inf)
                x, f, memory = parts_of(one.state, m, self.k)
                force = self.to_lines(one.time)
                fed = self.fed(r, made, orbit, one.motion, one.time, force)
                orbit = Orbit(x, f, memory, force, one.time, one.motion, 1.0, one.bad, fed=fed)
                continue
            chord = (
                orbit.inverse is not None
                and orbit.inverse.shape[0] == 2 * m + (1 + self.room) * self.k
                and orbit.closing < 0.02
            )
            source = self.source(r, made, orbit.source)
            one = self._march(made, source, p, orbit, homogeneous=not chord)
            if not np.isfinite(one.state).all():
                return replace(orbit, closing=np.inf)
            if chord:
                inverse = orbit.inverse
                assert inverse is not None
                start = state_of(orbit) + inverse @ (one.state - state_of(orbit))
                time = one.time
            else:
                inverse = closed(one.end)
                change = inverse @ (one.state - state_of(orbit))
                start = state_of(orbit) + change
                time = one.time + one.slopes @ np.asarray(change, np.float32)
                scale = np.linalg.norm(one.time) + 1e-300
                if not np.isfinite(change).all() or np.linalg.norm(time - one.time) > 3 * scale:
                    start, time, inverse = one.state, one.time, None  # too far for Newton: march on
            closing = relative(time - orbit.time, time)
            if chord and closing > 0.3 * orbit.closing:
                inverse = None  # the chord has worn out
            x, f, memory = parts_of(start, m, self.k)
            force = self.to_lines(time)
            fed = self.fed(r, made, orbit, one.motion, time, force)
            orbit = Orbit(
                x, f, memory, force, time, one.motion, closing, one.bad, orbit.floquet if chord else one.end, inverse,
                fed,
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
            orbit = replace(orbit, x=self.begun(r, made, orbit.force), closing=np.inf, inverse=None, floquet=None)
        if orbit.memory.shape[1] != self.room:  # a law with more to remember has come or gone
            memory = np.zeros((self.k, self.room))
            n = min(self.room, orbit.memory.shape[1])
            memory[:, :n] = orbit.memory[:, :n]
            orbit = replace(orbit, memory=memory, inverse=None, floquet=None)
        if orbit.time.shape[0] == self.n:
            return orbit
        time = np.ascontiguousarray(np.moveaxis(self.to_time(orbit.force), -1, 0))
        motion, tie = np.zeros((self.n, self.k, 2)), None if orbit.tie is None else resampled(orbit.tie, self.n)
        return replace(orbit, time=time, motion=motion, closing=np.inf, inverse=None, floquet=None, tie=tie)

    def _passes(self, r: Receptance, p: NDArray, orbit: Orbit, tolerance: float) -> Orbit:
        """The march from rest (a hit), or from where the stretch ends (an open run), until its correction stands."""
        made = self.prepare(r)
        m = made.w.shape[1]
        rest = np.zeros((2, m)), np.zeros(self.k), np.zeros((self.k, self.room))
        for _ in range(PASSES[int(np.isfinite(orbit.closing))]):
            if self.run.decay:
                orbit = replace(orbit, x=rest[0], f=rest[1], memory=rest[2])
            one = self._march(made, self.source(r, made, orbit.source), p, orbit)
            if not np.isfinite(one.state).all():
                return replace(orbit, closing=np.inf)
            x, f, memory = parts_of(one.state, m, self.k)
            change, size = one.time - orbit.time, np.linalg.norm(one.time) + 1e-300
            closing = float(np.linalg.norm(change) / size)
            force = self.to_lines(one.time)
            fed = self.fed(r, made, orbit, one.motion, one.time, force)
            orbit = Orbit(x, f, memory, force, one.time, one.motion, closing, one.bad, fed=fed, tie=orbit.tie)
            if closing < tolerance:
                break
        return orbit

    @np.errstate(over="ignore", invalid="ignore")
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
        source = self.source(r, made, orbit.source)
        ds = None
        if exact:
            dz, dg = base
            push = dz * (r.gain * self.run.u)
            for c in range(self.k):
                push = push + dg[:, :, c] * orbit.force[c]
            ds = self.pushed(push, r.s, orbit.tie is not None or bool(np.isin(self.codes, SPEEDS).any()))
        if not self.run.lasting:
            return self._open_slopes(r, p, orbit, base, vary, ds)
        one = self._march(made, source, p, orbit, homogeneous=True, vary=vary, ds=ds)
        if not np.isfinite(one.end).all():
            raise EstimationError("the steady response does not settle")
        n = vary.shape[0] + (0 if ds is None else ds.shape[3])
        phi, part = one.end[:, n:], one.end[:, :n]
        gap = (one.state - state_of(orbit))[:, None]
        inverse = closed(phi)
        closing = inverse @ np.hstack([part, gap])
        own, start = one.slopes[:, :, :n], one.slopes[:, :, n:]
        whole = own + start @ np.asarray(closing[:, :-1], np.float32)
        time = one.time + start @ np.asarray(closing[:, -1], np.float32)
        x, f, memory = parts_of(state_of(orbit) + closing[:, -1], made.w.shape[1], self.k)
        rel = relative(time - orbit.time, time)
        force = self.to_lines(time)
        fed = self.fed(r, made, orbit, one.motion, time, force)
        new = replace(
            orbit, force=force, time=time, motion=one.motion, closing=rel, x=x, f=f, memory=memory, floquet=phi,
            inverse=inverse, fed=fed,
        )  # fmt: skip
        moved = self.fed_on(r, made, new, self.tangents(whole)[..., r.lines])
        if not exact:
            moved = np.concatenate([described(r, self.run, orbit, base), moved])
        return new, Slopes(moved)

    def _open_slopes(
        self, r: Receptance, p: NDArray, orbit: Orbit, base: tuple[NDArray, NDArray], vary: NDArray, ds: NDArray | None
    ) -> tuple[Orbit, Slopes]:
        """The same where no period closes: the tangents begin at rest too, and what they forget does not count."""
        made = self.prepare(r)
        m = made.w.shape[1]
        begin = replace(orbit, x=np.zeros((2, m)), f=np.zeros(self.k), memory=np.zeros((self.k, self.room)))
        begin = begin if self.run.decay else orbit
        one = self._march(made, self.source(r, made, orbit.source), p, begin, vary=vary, ds=ds)
        if not (np.isfinite(one.slopes).all() and np.isfinite(one.time).all()):
            raise EstimationError("the response does not settle")
        x, f, memory = parts_of(one.state, m, self.k)
        change = relative(one.time - orbit.time, one.time)
        force = self.to_lines(one.time)
        fed = self.fed(r, made, orbit, one.motion, one.time, force)
        new = Orbit(x, f, memory, force, one.time, one.motion, float(change), one.bad, fed=fed, tie=orbit.tie)
        moved = self.fed_on(r, made, new, self.tangents(one.slopes)[..., r.lines])
        if ds is None:
            moved = np.concatenate([described(r, self.run, new, base), moved])
        return new, Slopes(moved)

    def _march(
        self, made: Discrete, source: NDArray, p: NDArray, orbit: Orbit, *, homogeneous: bool = False,
        ds: NDArray | None = None, vary: NDArray | None = None,
    ) -> Marched:  # fmt: skip
        m, k = made.w.shape[1], self.k
        if orbit.tie is not None and self.run.open:
            return tied_march(made, self.codes, self.step, source, p, orbit, ds, vary)
        n_s = 0 if ds is None else ds.shape[3]
        n_v = 0 if vary is None else vary.shape[0]
        n_h = 2 * m + (1 + self.room) * k if homogeneous else 0
        nt = n_s + n_v + n_h
        X = np.zeros((2, m, nt))
        if homogeneous:
            X.reshape(2 * m, nt)[np.arange(2 * m), n_s + n_v + np.arange(2 * m)] = 1.0
        df, dmem = np.zeros((k, nt)), np.zeros((k, self.room, nt))
        if homogeneous:
            df[np.arange(k), n_s + n_v + 2 * m + np.arange(k)] = 1.0
            held = np.arange(self.room * k)
            dmem.reshape(held.size, nt)[held, n_s + n_v + 2 * m + k + held] = 1.0
        dp = np.zeros((k, N_P, nt))
        if vary is not None:
            dp[:, :, n_s : n_s + n_v] = np.moveaxis(vary, 0, -1)
        if ds is None:
            ds = np.zeros((self.n, k, 2, 0), np.float32)
        forces, motion = np.empty((self.n, k)), np.empty((self.n, k, 2))
        slopes = np.empty((self.n, k, nt), np.float32)
        x, f, memory = orbit.x.copy(), orbit.f.copy(), orbit.memory.copy()
        marched(self.n, m, k, nt)
        bad = march(
            made.T, made.W0, made.W1, made.w, made.inner, made.rate, made.back, made.seated, self.step, source,
            self.codes, np.ascontiguousarray(p), x, f, memory, forces, motion, X, df, dmem, dp, ds, slopes, f,
            df, FREE, FREE,
        )  # fmt: skip
        end = np.concatenate([X.reshape(2 * m, nt), df, dmem.reshape(self.room * k, nt)])
        return Marched(np.concatenate([x.reshape(-1), f, memory.reshape(-1)]), forces, motion, end, slopes, bad)
