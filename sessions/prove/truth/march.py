"""Time marching of a structure with local nonlinear laws: exact modes between steps, implicit laws at each step.

Every mode is carried over a step exactly (matrix exponential, load linear in the step). The laws' forces at the
end of the step are found implicitly, with set-valued friction and slip by return mapping. Dry friction is constant
within a step: a straight line from one limit to the other, or to what holds, would ring. A step in which a contact
closes or opens, or a slider lets go or sticks, is halved again and again until the event lies between two moments
that are `1 / 2**HALVED` of it apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import scipy.linalg
from numpy.typing import NDArray

HALVED = 8
STATES = 8
SWEEPS, SETTLED = 40, 1e-11

CUBIC, QUADRATIC, GAP, CLEARANCE, COULOMB, DRAG, SLIDERS, BOUC_WEN, VAN_DER_POL, SIGNED_SQUARE, DELAY = range(11)
SEATED = 11
"""Dry friction where the modes left out give way by more than the structure moves within a step: it holds a place, and
not a speed."""


@dataclass(frozen=True, eq=False)
class Coupling:
    """Modes and static remainder as the laws see them.

    Parameters
    ----------
    square, viscous : ndarray, shape (m,)
        Squared angular frequencies and 2 zeta omega.
    shape : ndarray, shape (n_laws, m)
        Motion of each law's stretch in each mode.
    load : ndarray, shape (m,)
        Modal load of a unit input.
    remainder : ndarray, shape (n_laws, n_laws)
        Static flexibility of the modes left out.
    remainder_load : ndarray, shape (n_laws,)
        Stretch that a unit input makes in the modes left out.
    """

    square: NDArray[np.float64]
    viscous: NDArray[np.float64]
    shape: NDArray[np.float64]
    load: NDArray[np.float64]
    remainder: NDArray[np.float64]
    remainder_load: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Laws:
    """Kinds of the laws and their constants, shapes (n_laws,) and (n_laws, 8)."""

    kind: NDArray[np.int_]
    constants: NDArray[np.float64]


def march(coupling: Coupling, laws: Laws, signal: NDArray, step: float) -> tuple[NDArray, NDArray, NDArray]:
    """Stretch, its speed and force of every law from rest, each (n_laws, n_samples), under samples of the input.

    The force of dry friction is its mean over the step before the sample (`averaged`), since it jumps within.
    """
    sizes = [steps(coupling, step / 2**j) for j in range(HALVED + 1)]
    A, start, end = (np.array([s[i] for s in sizes]) for i in range(3))
    within = np.square(coupling.shape) @ end[0, :, 0]  # what a force does to its own place within a step
    seated = (laws.kind == COULOMB) & (2 * np.diag(coupling.remainder) > within)
    return _march(
        A, start, end, np.ascontiguousarray(coupling.shape), coupling.load, coupling.remainder,
        coupling.remainder_load, np.where(seated, SEATED, laws.kind), laws.constants,
        np.ascontiguousarray(signal, float), step,
    )  # fmt: skip


def averaged(laws: Laws) -> NDArray[np.bool_]:
    """Whether `march` gives a law's force as its mean over steps, (n_laws,)."""
    return laws.kind == COULOMB


def steps(coupling: Coupling, step: float) -> tuple[NDArray, NDArray, NDArray]:
    """Transition (m, 2, 2) of a mode's motion and speed over a step, and what loads at its two ends add, (m, 2)."""
    m = coupling.square.size
    A, start, end = np.zeros((m, 2, 2)), np.zeros((m, 2)), np.zeros((m, 2))
    for r in range(m):
        big = np.zeros((4, 4))
        big[0, 1] = 1.0
        big[1] = [-coupling.square[r], -coupling.viscous[r], 1.0, 0.0]
        big[2, 3] = 1.0
        E = np.asarray(scipy.linalg.expm(big * step))
        A[r] = E[:2, :2]
        end[r] = E[:2, 3] / step
        start[r] = E[:2, 2] - end[r]
    return A, start, end


@numba.njit(cache=True)
def _sign(x):
    return 1.0 if x > 0 else (-1.0 if x < 0 else 0.0)


@numba.njit(cache=True)
def _smooth(kind, c, z, v):
    """Force of a law without memory, its slopes to stretch and speed, and the number of its branch."""
    if kind == CUBIC:
        if c[0] < 0 and abs(z) > c[1] > 0:  # it gives way no further
            slope = 3 * c[0] * c[1] * c[1]
            return np.sign(z) * c[0] * c[1] ** 3 + slope * (z - np.sign(z) * c[1]), slope, 0.0, 0
        return c[0] * z**3, 3 * c[0] * z * z, 0.0, 0
    if kind == QUADRATIC:
        if c[0] * z < 0 and abs(z) > c[1] > 0:
            slope = 2 * c[0] * np.sign(z) * c[1]
            return c[0] * c[1] * c[1] + slope * (z - np.sign(z) * c[1]), slope, 0.0, 0
        return c[0] * z * z, 2 * c[0] * z, 0.0, 0
    if kind == GAP:
        if z > c[1]:
            return c[0] * (z - c[1]), c[0], 0.0, 1
        return 0.0, 0.0, 0.0, 0
    if kind == CLEARANCE:
        if z > c[1]:
            return c[0] * (z - c[1]), c[0], 0.0, 1
        if z < -c[1]:
            return c[0] * (z + c[1]), c[0], 0.0, -1
        return 0.0, 0.0, 0.0, 0
    if kind == DRAG:
        return c[0] * v * abs(v), 0.0, 2 * c[0] * abs(v), 0
    if kind == VAN_DER_POL:
        return c[0] * z * z * v, 2 * c[0] * z * v, c[0] * z * z, 0
    return c[0] * z * abs(z), 2 * c[0] * abs(z), 0.0, 0


@numba.njit(cache=True)
def _memory(kind, c, dz, old, new):
    """Force of a law with memory after a further stretch dz, its slope, and the number of its branch."""
    if kind == SLIDERS:
        count = int(c[2])
        force, slope, branch = 0.0, 0.0, 0
        for i in range(count):
            limit = c[1] * 2 * (i + 1) / (count + 1) / count
            stiffness = c[0] / count
            trial = old[i] + stiffness * dz
            if trial > limit:
                new[i] = limit
                branch += 3**i
            elif trial < -limit:
                new[i] = -limit
                branch += 2 * 3**i
            else:
                new[i] = trial
                slope += stiffness
            force += new[i]
        return force, slope, branch
    w = old[0]
    parts = 2
    for _ in range(parts):
        half = w + 0.5 * dz / parts * _wen(c, w, dz)
        w += dz / parts * _wen(c, half, dz)
    new[0] = w
    return c[0] * w, c[0] * _wen(c, w, dz), 0


@numba.njit(cache=True)
def _wen(c, w, dz):
    """dw/dz of Bouc and Wen with limit c[1], power c[2] and share c[3] of the term that changes with direction."""
    size = (abs(w) / c[1]) ** c[2]
    return 1.0 - size * (c[3] * _sign(w * dz) + 1.0 - c[3])


@numba.njit(cache=True)
def _force(kind, c, z, v, dz0, az, av, late, old, new):
    """Force f = g(z - az f, v - av f) of one law, and the number of its branch."""
    if kind == COULOMB:
        stick = v / av
        if stick > c[0]:
            new[0] = 1.0
            return c[0], 1
        if stick < -c[0]:
            new[0] = -1.0
            return -c[0], -1
        return stick, 0
    if kind == SEATED:
        trial = (z - old[0]) / az
        f = min(max(trial, -c[0]), c[0])
        new[0] = old[0] if f == trial else z - az * f
        return f, 0 if f == trial else int(_sign(f))
    if kind == DELAY:
        return (c[0] * late + c[2] * v) / (1.0 + av * c[2]), 0
    f, branch = 0.0, 0
    if kind != SLIDERS and kind != BOUC_WEN:
        f = _smooth(kind, c, z, v)[0]
    low, high = min(0.0, f), max(0.0, f)
    for _ in range(60):
        if kind in (SLIDERS, BOUC_WEN):
            g, slope, branch = _memory(kind, c, dz0 - az * f, old, new)
            rate = 0.0
        else:
            g, slope, rate, branch = _smooth(kind, c, z - az * f, v - av * f)
        move = (g - f) / (1.0 + az * slope + av * rate)
        if kind in (VAN_DER_POL, DRAG):
            if g > f:
                low = f
            else:
                high = f
            if not low <= f + move <= high:
                move = 0.5 * (low + high) - f
        f += move
        if abs(move) <= 1e-11 * (abs(f) + 1e-30):
            break
    return f, branch


@numba.njit(cache=True)
def _advance(A, start, end, shape, load, rest, rest_load, kind, const, q, p, u, zs, f, old, new, late, h, out):
    """One step: motion q (m, 2) and modal loads p (m,) before it; fills out (q, p, z, v, f) and says the branches."""
    m, n = q.shape[0], shape.shape[0]
    qn, pn, zn, vn, fn, resid = out
    zp, vp = np.zeros(n), np.zeros(n)
    az, av = rest.copy(), rest / h
    for r in range(m):
        a0 = A[r, 0, 0] * q[r, 0] + A[r, 0, 1] * q[r, 1] + start[r, 0] * p[r] + end[r, 0] * load[r] * u
        a1 = A[r, 1, 0] * q[r, 0] + A[r, 1, 1] * q[r, 1] + start[r, 1] * p[r] + end[r, 1] * load[r] * u
        qn[r, 0], qn[r, 1] = a0, a1
        for e in range(n):
            zp[e] += shape[e, r] * a0
            vp[e] += shape[e, r] * a1
        for g in range(n):
            w0, w1 = _weights(kind[g], start[r], end[r])
            for e in range(n):
                az[e, g] += shape[e, r] * w0 * shape[g, r]
                av[e, g] += shape[e, r] * w1 * shape[g, r]
    for e in range(n):
        zp[e] += rest_load[e] * u
        fn[e] = f[e]
        if kind[e] == COULOMB:
            av[e] -= rest[e] / h
        else:
            vp[e] += (rest_load[e] * u - resid[e]) / h
    branches = 0
    for _ in range(1 if n == 1 else SWEEPS):
        branches = 0
        change, size = 0.0, 1e-300
        for e in range(n):
            z, v = zp[e], vp[e]
            for g in range(n):
                if g != e:
                    z -= az[e, g] * fn[g]
                    v -= av[e, g] * fn[g]
            before = fn[e]
            fn[e], branch = _force(kind[e], const[e], z, v, z - zs[e], az[e, e], av[e, e], late[e], old[e], new[e])
            zn[e], vn[e] = z - az[e, e] * fn[e], v - av[e, e] * fn[e]
            branches = branches * 100003 + branch
            change, size = max(change, abs(fn[e] - before)), max(size, abs(fn[e]))
        if change <= SETTLED * size:
            break
    for r in range(m):
        pn[r] = load[r] * u
        for e in range(n):
            push = shape[e, r] * fn[e]
            w0, w1 = _weights(kind[e], start[r], end[r])
            qn[r, 0] -= w0 * push
            qn[r, 1] -= w1 * push
            if kind[e] != COULOMB:
                pn[r] -= push
    for e in range(n):
        resid[e] = rest_load[e] * u
        for g in range(n):
            resid[e] -= rest[e, g] * fn[g]
    return branches


@numba.njit(cache=True)
def _weights(kind, start, end):
    """What a law's force at the end of a step does to a mode's motion and speed; dry friction acts all the step."""
    if kind == COULOMB:
        return start[0] + end[0], start[1] + end[1]
    return end[0], end[1]


@numba.njit(cache=True)
def _march(A, start, end, shape, load, rest, rest_load, kind, const, signal, h):
    n, m, total = shape.shape[0], shape.shape[1], signal.size
    z, v, f = np.zeros((n, total)), np.zeros((n, total)), np.zeros((n, total))
    q, p = np.zeros((m, 2)), np.zeros(m)
    qn, pn, resid, was = np.zeros((m, 2)), np.zeros(m), np.zeros(n), np.zeros(n)
    zn, vn, fn = np.zeros(n), np.zeros(n), np.zeros(n)
    z0, f0 = zn.copy(), fn.copy()
    old, new = np.zeros((n, STATES)), np.zeros((n, STATES))
    late = np.zeros(n)
    out = (qn, pn, zn, vn, fn, resid)
    whole = 2**HALVED
    last = 0
    for i in range(1, total):
        for e in range(n):
            if kind[e] == DELAY:
                back = i - const[e, 1] / h
                k = int(np.floor(back))
                late[e] = z[e, k] + (back - k) * (z[e, k + 1] - z[e, k]) if k >= 0 and k + 1 < i else 0.0
        at, size = 0, whole
        while at < whole:
            j = 0
            while whole >> j > size:
                j += 1
            was[:] = resid
            new[:] = old
            u = signal[i - 1] + (signal[i] - signal[i - 1]) * (at + size) / whole
            branches = _advance(
                A[j], start[j], end[j], shape, load, rest, rest_load, kind, const, q, p, u, z0, f0, old, new, late,
                h * size / whole, out,
            )  # fmt: skip
            if branches != last and size > 1:
                resid[:] = was
                size //= 2
                continue
            last = branches
            at += size
            q[:], p[:], z0[:] = qn, pn, zn
            for e in range(n):
                if kind[e] == COULOMB:
                    f[e, i] += fn[e] * size / whole
                elif kind[e] == SEATED:
                    f[e, i] += 0.5 * (f0[e] + fn[e]) * size / whole
            f0[:] = fn
            old[:] = new
            size = at & -at  # the largest that ends on a multiple of itself
            while at < whole and at + size > whole:
                size //= 2
        for e in range(n):
            z[e, i], v[e, i] = zn[e], vn[e]
            if kind[e] != COULOMB and kind[e] != SEATED:
                f[e, i] = fn[e]
    return z, v, f
