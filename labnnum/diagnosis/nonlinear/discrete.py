"""A receptance's modes as they are marched: transitions over a step, and what the march is, line by line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.receptance import RIGID, Receptance
from labnnum.diagnosis.nonlinear.run import Run


@dataclass(frozen=True, eq=False)
class Discrete:
    """Transitions T (4, m) and weights W0, W1 (2, m) of modes w (k, m) over one step, and the march's transfers.

    `inner`, `rate` (k, k): motion and speed that a force causes within its own step; `back` what of the speed the force
    of the step before takes away; `seated` (k,) whether dry friction holds a place there. `gz`, `gv` (k, k, n_lines):
    motion and speed of the places to forces as they are marched; `miss_z`, `miss_v` what the exact receptances have
    beyond; `xq`, `xv` (m, n_lines) states of the modes.
    """

    T: NDArray
    W0: NDArray
    W1: NDArray
    w: NDArray
    inner: NDArray
    rate: NDArray
    back: NDArray
    seated: NDArray
    gz: NDArray
    gv: NDArray
    miss_z: NDArray
    miss_v: NDArray
    xq: NDArray
    xv: NDArray


SEATED = 1.5
"""How much more than within a step by its own inertia a place must give way by what follows at once, for dry friction
to hold the place and not the speed: a stiffer seat rings from step to step, and a softer one has a speed of its own."""
RINGS = 1e-4
"""Growth from step to step of what rings while places are held, above which they are not: a hit's friction holds for
thousands of steps."""


def discrete(r: Receptance, step: float, top: int, dry: NDArray) -> Discrete:
    """The modes of a receptance marched with this step; `top` is the highest excited line, and `dry` (k,) says which
    laws are dry friction.
    """
    slow = np.flatnonzero(r.omega < r.reach * np.abs(r.s[top]))  # faster ones follow at once, exactly by lines
    fast = np.setdiff1d(np.arange(r.omega.size), slow)
    omega, zeta, w = r.omega[slow], r.zeta[slow], np.ascontiguousarray(r.w[:, slow])
    rest = r.rest + (r.w[:, fast] / r.omega[fast] ** 2) @ r.w[:, fast].T
    low = np.abs(r.s[1].imag)
    omega[omega < RIGID * low] = 0.0  # rigid bodies, held by the forces alone
    T, W0, W1 = held(omega, zeta, step)
    turn = np.exp(r.s * step)
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
    inner = (w * W1[0]) @ w.T
    seated = dry & (np.diag(rest) > SEATED * np.diag(inner))
    own = np.diag(rest) / np.diag(inner) if seated.any() else np.zeros(k)
    inner = inner + rest
    while seated.any() and growth(T, W0, W1, w[seated], inner[np.ix_(seated, seated)]) > 1.0 + RINGS:
        seated[np.flatnonzero(seated)[np.argmin(own[seated])]] = False
    back = rest / step  # what follows at once has a speed as well
    gv += back[:, :, None] * (1 - 1 / turn)
    rate = (w * W1[1]) @ w.T + back
    return Discrete(
        T, W0, W1, w, inner, rate, back, seated, gz, gv, r.g - gz, r.s * r.g - gv, xq, xv,
    )  # fmt: skip


def growth(T: NDArray, W0: NDArray, W1: NDArray, w: NDArray, inner: NDArray) -> float:
    """Largest factor by which anything grows from one step to the next while forces hold the places w (k, m) still.

    The forces that hold them are straight between steps: they undo at the end of a step what those at its beginning
    did, and where modes turn by nearly half a circle in a step more than that, from step to step.
    """
    k, m = w.shape
    on = np.zeros((2 * m + k, 2 * m + k))
    at = np.arange(m)
    on[at, at], on[at, m + at], on[m + at, at], on[m + at, m + at] = T
    on[:m, 2 * m :], on[m : 2 * m, 2 * m :] = (W0[:, None] * w).transpose(0, 2, 1)
    end = np.vstack([*(W1[:, None] * w).transpose(0, 2, 1), np.eye(k)])
    try:
        on -= end @ np.linalg.solve(inner, w @ on[:m])
    except np.linalg.LinAlgError:  # two forces at one place
        return np.inf
    return float(np.max(np.abs(np.linalg.eigvals(on))))


def held(omega: NDArray, zeta: NDArray, step: float) -> tuple[NDArray, NDArray, NDArray]:
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


LOOP = 0.5
"""Gain of the loop from what the march has wrong back to itself, above which its correction is fed by Newton's method:
a law stiffer than the structure, whose correction would grow from one march to the next."""


def describing(motion: NDArray, time: NDArray) -> tuple[NDArray, NDArray]:
    """Spring and dashpot (k,) each that best stand for the forces `time` (n, k) along the `motion` (n, k, 2)."""
    rows = np.ascontiguousarray(np.moveaxis(motion, 0, 2))  # (k, 2, n): sums along rows are quick
    rows = rows - rows.mean(axis=2, keepdims=True)
    done = np.einsum("kcn,kn->kc", rows, np.ascontiguousarray(time.T))
    size = np.einsum("kcn,kcn->kc", rows, rows)
    stiff, loss = (-done / np.maximum(size, 1e-300)).T
    return stiff, loss


def described(
    r: Receptance, run: Run, orbit: Orbit, base: tuple[NDArray, NDArray]
) -> NDArray[np.complex128]:  # fmt: skip
    """Derivatives of the forces (n_b, k, f) to the base model's vector, each law taken by its describing function.

    The spring and dashpot answer to a change of the model; what a change at one line does to the others is left out.
    `base` are the derivatives of the receptances among the places, as `Steady.slopes` takes them.
    """
    here, k = r.lines, orbit.time.shape[1]
    drive = (r.gain * run.u)[here]
    dz, dg = base
    push = dz * drive
    for c in range(k):
        push = push + dg[:, :, c] * orbit.force[c, here]
    s, g = r.s[here], r.g[..., here]
    stiff, loss = describing(orbit.motion, orbit.time)
    law = stiff[:, None] + s * loss[:, None]
    if k == 1:
        return -law * push / (1 + law * g[0])
    loop = np.moveaxis(law[:, None] * g, 2, 0) + np.eye(k)
    right = -np.moveaxis(law * push, (0, 1, 2), (2, 1, 0))
    return np.asarray(np.moveaxis(np.linalg.solve(loop, right), (0, 1, 2), (2, 1, 0)), complex)


def feedback(
    made: Discrete, r: Receptance, motion: NDArray, time: NDArray
) -> NDArray[np.complex128] | None:  # fmt: skip
    r"""What a change of the forces from one march to the next is multiplied with, (k, k, n_lines); None for one.

    Each law is taken by its describing function, the spring and dashpot that best stand for its force `time` (n, k)
    along its `motion` (n, k, 2). With them the march answers to its correction, and is right where

    .. math:: F = F_0 + (1 + \kappa G)^{-1} (1 + \kappa G_d) (M(F_0) - F_0)
    """
    k = time.shape[1]
    stiff, loss = describing(motion, time)
    wrong = stiff[:, None, None] * made.miss_z + loss[:, None, None] * made.miss_v
    own = np.eye(k)[:, :, None] + stiff[:, None, None] * made.gz + loss[:, None, None] * made.gv
    if k == 1:
        gain = np.abs(wrong / own)
        if not np.max(gain[..., 1:], initial=0.0) > LOOP:
            return None
        out = own / (own + wrong)
    else:
        own, wrong = np.moveaxis(own, 2, 0), np.moveaxis(wrong, 2, 0)
        gain = np.linalg.solve(own, wrong)
        if not np.max(np.abs(gain[1:]), initial=0.0) > LOOP:
            return None
        out = np.moveaxis(np.linalg.solve(own + wrong, own), 0, 2)
    good = np.isfinite(out).all(axis=(0, 1))
    return np.where(good, out, np.eye(k)[:, :, None])
