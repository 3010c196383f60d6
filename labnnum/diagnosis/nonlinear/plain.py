"""The march without tangents, which most of a search is: the same steps as `march`, with nothing else in them."""

from __future__ import annotations

import numpy as np
from numba import njit

from labnnum.compiled import up_to_date
from labnnum.diagnosis.nonlinear.force import HELD, SLIDERS
from labnnum.diagnosis.nonlinear.within import seat, solved

BEYOND = 1e60
"""N; a force that is no number any more that could be squared."""


@njit(cache=True, inline="always")
def remember(code, e, z, v, gv, seated, new, last, p, memory, stride):  # pragma: no cover - compiled
    """The memory (k, M) of law e after a step that ended at the motion z and the speed v with the force `new`."""
    k = p[e, 0]
    if code == 4:
        if seated:
            slid = last if abs(last) >= k else 0.0
            place = seat(v - gv * new, gv, slid, memory[e, 0], memory[e, 1], stride)
            memory[e, 0] = place if abs(new) < k else z
            memory[e, 1] = v
        else:
            memory[e, 0] = v
    elif code == 6:
        if k > 0.0:
            trial = k * (z - memory[e, 0])
            if trial > p[e, 1]:
                memory[e, 0] = z - p[e, 1] / k
            elif trial < -p[e, 1]:
                memory[e, 0] = z + p[e, 1] / k
    elif code == 7:
        memory[e, 0] = z
        memory[e, 1] = p[e, HELD] * z - new / k if k > 0.0 else 0.0
    elif code == 9 and k > 0.0:
        n = int(p[e, 3]) if p[e, 3] > 0.0 else SLIDERS
        for i in range(n):
            limit = p[e, 1] * (1.0 + p[e, 2] * (2.0 * i + 1.0 - n) / n) / k
            if z - memory[e, i] > limit:
                memory[e, i] = z - limit
            elif z - memory[e, i] < -limit:
                memory[e, i] = z + limit


@up_to_date
@njit(cache=True, fastmath={"contract", "reassoc"}, error_model="numpy", nogil=True)
def plain_march(
    T, V0, w, gz, gv, before, seated, stride, source, codes, p, x, f, memory, forces, motion
):  # fmt: skip # pragma: no cover - compiled
    """Advance over all steps as `march.march` does, states x held without what the last force did within its step.

    Arguments as there. Returns the number of steps whose forces did not settle, and whether a law that pushes has gone
    too far.
    """
    n, k = forces.shape
    m = w.shape[1]
    bad = 0
    if k == 1:
        t0, t1, t2, t3, w0 = T[0], T[1], T[2], T[3], w[0]
        c0, c1 = V0[0] * w0, V0[1] * w0
        q, u = x[0].copy(), x[1].copy()
        code, held, last = codes[0], seated[0], f[0]
        own_z, own_v, back = gz[0, 0], gv[0, 0], before[0, 0]
        for step in range(n):
            z, v = source[step, 0, 0], source[step, 0, 1] - back * last
            for r in range(m):
                a = t0[r] * q[r] + t1[r] * u[r] + c0[r] * last
                b = t2[r] * q[r] + t3[r] * u[r] + c1[r] * last
                q[r] = a
                u[r] = b
                z += w0[r] * a
                v += w0[r] * b
            new = solved(code, 0, z, v, own_z, own_v, held, p, memory, last, last, stride)
            z += own_z * new
            v += own_v * new
            motion[step, 0, 0] = z
            motion[step, 0, 1] = v
            forces[step, 0] = new
            if not abs(new) < BEYOND:
                motion[step:], forces[step:] = np.nan, np.nan
                return bad, True
            remember(code, 0, z, v, own_v, held, new, last, p, memory, stride)
            last = new
        f[0] = last
        x[0] = q
        x[1] = u
        return bad, False
    new = np.empty(k)
    see = np.empty((k, 2))
    for step in range(n):
        for e in range(k):
            see[e, 0] = source[step, e, 0]
            see[e, 1] = source[step, e, 1]
            for o in range(k):
                see[e, 1] -= before[e, o] * f[o]
        for r in range(m):
            push = 0.0
            for e in range(k):
                push += w[e, r] * f[e]
            a = T[0, r] * x[0, r] + T[1, r] * x[1, r] + V0[0, r] * push
            b = T[2, r] * x[0, r] + T[3, r] * x[1, r] + V0[1, r] * push
            x[0, r] = a
            x[1, r] = b
        for e in range(k):
            z, v = see[e, 0], see[e, 1]
            for r in range(m):
                z += w[e, r] * x[0, r]
                v += w[e, r] * x[1, r]
            see[e, 0] = z
            see[e, 1] = v
            new[e] = f[e]
        settled = False
        for _ in range(80):
            change, size = 0.0, 0.0
            for e in range(k):
                z, v = see[e, 0], see[e, 1]
                for o in range(k):
                    if o != e:
                        z += gz[e, o] * new[o]
                        v += gv[e, o] * new[o]
                one = solved(
                    codes[e], e, z, v, gz[e, e], gv[e, e], seated[e], p, memory, f[e], new[e], stride
                )  # fmt: skip
                change = max(change, abs(one - new[e]))
                size = max(size, abs(one))
                new[e] = one
            if change <= 1e-10 * size:
                settled = True
                break
        if not settled:
            bad += 1
        for e in range(k):
            z, v = see[e, 0], see[e, 1]
            for o in range(k):
                z += gz[e, o] * new[o]
                v += gv[e, o] * new[o]
            motion[step, e, 0] = z
            motion[step, e, 1] = v
            forces[step, e] = new[e]
            if not abs(new[e]) < BEYOND:
                motion[step:], forces[step:] = np.nan, np.nan
                motion[step:], forces[step:] = np.nan, np.nan
                return bad, True
            remember(codes[e], e, z, v, gv[e, e], seated[e], new[e], f[e], p, memory, stride)
        for e in range(k):
            f[e] = new[e]
    return bad, False
