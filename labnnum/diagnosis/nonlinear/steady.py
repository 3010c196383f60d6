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

from labnnum.diagnosis.nonlinear.march import N_P, march
from labnnum.diagnosis.nonlinear.receptance import Receptance
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.simulation import hold_weights


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


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the force spectrum, (k, n_lines, n): to the base model's vector, then to the laws' parameters."""

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

    # ---------------------------------------------------------------- the march of one receptance

    def prepare(self, r: Receptance) -> _Prepared:
        """Transition, weights and discrete transfers of a receptance's modes."""
        omega, zeta = r.omega.copy(), r.zeta.copy()
        low = np.abs(r.s[1])
        free = omega < 0.05 * low
        omega[free], zeta[free] = 0.3 * low, 0.3  # a rigid body is tied loosely; the source takes it back
        m = omega.size
        A = np.zeros((m, 2, 2))
        A[:, 0, 1] = 1.0
        A[:, 1, 0], A[:, 1, 1] = -(omega**2), -2 * zeta * omega
        B = np.zeros((m, 2, 1))
        B[:, 1, 0] = 1.0
        T, W = hold_weights(A, B, self.step, 2)
        W0, W1 = W[:, :, 0, 0].T, W[:, :, 0, 1].T
        turn = np.exp(r.s * self.step)
        a, b, c, d = (T.reshape(m, 4).T)[:, :, None]
        det = (turn - a) * (turn - d) - b * c
        drive0 = W0[0][:, None] + turn * W1[0][:, None]
        drive1 = W0[1][:, None] + turn * W1[1][:, None]
        xq = ((turn - d) * drive0 + b * drive1) / det
        xv = (c * drive0 + (turn - a) * drive1) / det
        gz = np.einsum("km,lm,mf->klf", r.w, r.w, xq, optimize=True) + r.rest[:, :, None]
        gv = np.einsum("km,lm,mf->klf", r.w, r.w, xv, optimize=True)
        inner = (r.w * W1[0]) @ r.w.T + r.rest
        rate = (r.w * W1[1]) @ r.w.T
        return _Prepared(
            np.ascontiguousarray(T.reshape(m, 4).T), np.ascontiguousarray(W0), np.ascontiguousarray(W1),
            np.ascontiguousarray(r.w), inner, rate, r.g - gz, r.s * r.g - gv, xq, xv,
        )  # fmt: skip

    def to_time(self, spectrum: NDArray) -> NDArray[np.float64]:
        """Spectrum (..., n_lines) to n fine samples (..., n)."""
        full = np.zeros((*spectrum.shape[:-1], self.n // 2 + 1), complex)
        full[..., : self.lines] = spectrum
        if self.fine > 1 and self.run.period % 2 == 0:
            full[..., self.lines - 1] *= 0.5
        return np.fft.irfft(full * (self.n / 2), self.n, axis=-1)

    def to_lines(self, time: NDArray) -> NDArray[np.complex128]:
        """Fine samples (n, ...) to spectra (..., n_lines)."""
        return np.moveaxis(np.fft.rfft(time, axis=0)[: self.lines] * (2 / self.n), 0, -1)

    def source(self, r: Receptance, made: _Prepared, force: NDArray) -> NDArray[np.float64]:
        """Motion (n, k, 2) at the places that the march does not produce itself."""
        drive = r.gain * self.run.u
        z = r.z * drive + np.einsum("klf,lf->kf", made.miss_z, force)
        v = r.s * r.z * drive + np.einsum("klf,lf->kf", made.miss_v, force)
        return np.ascontiguousarray(np.moveaxis(self.to_time(np.stack([z, v], axis=1)), -1, 0))

    def state_of(self, r: Receptance, made: _Prepared, force: NDArray) -> NDArray[np.float64]:
        """Modal state (2, m) just before time 0 of a force spectrum."""
        push = r.w.T @ force * np.exp(-r.s * self.step)
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

    def settle(self, r: Receptance, p: NDArray, orbit: Orbit, steps: int, tolerance: float = 1e-5) -> Orbit:
        """Newton's method from `orbit` to the steady state with laws' parameters p (k, N_P)."""
        made = self.prepare(r)
        m = r.omega.size
        for _ in range(steps):
            before = orbit
            memory = orbit.memory.copy()
            source = self.source(r, made, orbit.force)
            one = self._march(r, made, source, p, orbit.x, orbit.f, memory, homogeneous=True)
            phi = one.end
            change = np.linalg.lstsq(np.eye(phi.shape[0]) - phi, one.state - _state(orbit), rcond=1e-12)[0]
            start = _state(orbit) + change
            time = one.time + one.slopes @ change
            scale = np.linalg.norm(one.time) + 1e-300
            if not np.isfinite(change).all() or np.linalg.norm(time - one.time) > 3 * scale:
                start, time = one.state, one.time  # too far for Newton: march on
            x, f, memory = _parts(start, m, self.k)
            force = self.to_lines(time)
            closing = float(np.linalg.norm(time - before.time) / scale)
            orbit = Orbit(x, f, memory, force, time, one.motion, closing, one.bad, phi)
            if closing < tolerance:
                break
        return orbit

    def slopes(
        self, r: Receptance, p: NDArray, orbit: Orbit, base: tuple[NDArray, NDArray], vary: NDArray
    ) -> tuple[Orbit, Slopes]:
        """The orbit marched once more, and the derivatives of its forces.

        Parameters
        ----------
        base : (dz, dg)
            Derivatives of `Receptance.z` and `.g` to the base model's vector, (n_b, k, f) and (n_b, k, k, f).
        vary : ndarray, shape (n_law, k, N_P)
            Directions of the laws' parameters.
        """
        made = self.prepare(r)
        drive = r.gain * self.run.u
        dz, dg = base
        push = dz * drive + np.einsum("nklf,lf->nkf", dg, orbit.force)
        ds = np.moveaxis(self.to_time(np.stack([push, r.s * push], axis=2)), (0, 3), (3, 0))
        source = self.source(r, made, orbit.force)
        memory = orbit.memory.copy()
        one = self._march(
            r, made, source, p, orbit.x, orbit.f, memory, homogeneous=True, ds=np.ascontiguousarray(ds), vary=vary
        )
        n = dz.shape[0] + vary.shape[0]
        phi, part = one.end[:, n:], one.end[:, :n]
        gap = (one.state - _state(orbit))[:, None]
        closing = np.linalg.lstsq(np.eye(phi.shape[0]) - phi, np.hstack([part, gap]), rcond=1e-12)[0]
        whole = one.slopes[:, :, :n] + one.slopes[:, :, n:] @ closing[:, :-1]
        time = one.time + one.slopes[:, :, n:] @ closing[:, -1]
        x, f, memory = _parts(_state(orbit) + closing[:, -1], r.omega.size, self.k)
        rel = float(np.linalg.norm(time - orbit.time) / (np.linalg.norm(time) + 1e-300))
        new = replace(
            orbit, force=self.to_lines(time), time=time, motion=one.motion, closing=rel, x=x, f=f, memory=memory,
            floquet=phi,
        )  # fmt: skip
        return new, Slopes(np.moveaxis(self.to_lines(whole), 1, 2))

    def _march(
        self, r: Receptance, made: _Prepared, source: NDArray, p: NDArray, x: NDArray, f: NDArray, memory: NDArray, *,
        homogeneous: bool = False, ds: NDArray | None = None, vary: NDArray | None = None,
    ) -> _Marched:  # fmt: skip
        m, k = r.omega.size, self.k
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
        x, f = x.copy(), f.copy()
        bad = march(
            made.T, made.W0, made.W1, made.w, made.inner, made.rate, source, self.codes, np.ascontiguousarray(p), x, f,
            memory, forces, motion, X, df, dmem, dp, ds, slopes,
        )  # fmt: skip
        end = np.concatenate([X.reshape(2 * m, nt), df, dmem.reshape(2 * k, nt)])
        return _Marched(np.concatenate([x.reshape(-1), f, memory.reshape(-1)]), forces, motion, end, slopes, bad)


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
