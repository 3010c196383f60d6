"""The march of one force with its tangents: the same steps as `march`, with the laws' slopes as numbers.

Of sliders side by side and of the general law `march` itself carries the tangents.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from labnnum.compiled import up_to_date
from labnnum.diagnosis.nonlinear.force import HELD, place_held
from labnnum.diagnosis.nonlinear.plain import BEYOND, remember
from labnnum.diagnosis.nonlinear.within import solved
from labnnum.diagnosis.nonlinear.yielding import yields

TAKEN = (0, 1, 2, 3, 4, 5, 6, 7)
"""Numbers of the laws whose tangents this march carries."""
HOLDS = 1e30
"""Slope of a force that holds a place or a speed, whatever it takes."""


@njit(cache=True, inline="always")
def slopes_of(code, z, v, k, gap, place, held):  # pragma: no cover - compiled
    """Slopes of the opposing force to z, v, the first and the second parameter, and to where a slider stood."""
    if code == 0:
        return 3.0 * k * z * z, 0.0, z * z * z, 0.0, 0.0
    if code == 1:
        return 2.0 * k * z, 0.0, z * z, 0.0, 0.0
    if code == 5:
        return 0.0, 2.0 * k * abs(v), v * abs(v), 0.0, 0.0
    if code == 6:
        trial = k * (z - place)
        if abs(trial) > gap:
            return -held * k, 0.0, -held * z, (1.0 if trial > 0.0 else -1.0), 0.0
        return k * (1.0 - held), 0.0, z - place - held * z, 0.0, -k
    if z > gap:
        return k, 0.0, z - gap, -k, 0.0
    if code == 3 and z < -gap:
        return k, 0.0, z + gap, k, 0.0
    return 0.0, 0.0, 0.0, 0.0, 0.0


@up_to_date
@njit(cache=True, fastmath={"contract", "reassoc"}, error_model="numpy", nogil=True)
def tangent_march(
    T, V0, w, gz, gv, before, seated, stride, source, codes, p, x, f, memory, forces, motion, X, df, dmem, dp, ds,
    dforces,
):  # fmt: skip # pragma: no cover - compiled
    """Advance over all steps as `march.march` does with one law of `TAKEN` and no tie.

    Arguments as there, states x and X held without what the last force did within its step. Returns whether a law that
    pushes has gone too far.
    """
    n, m, nt, ns = forces.shape[0], w.shape[1], X.shape[2], ds.shape[3]
    t0, t1, t2, t3, w0 = T[0], T[1], T[2], T[3], w[0]
    c0, c1 = V0[0] * w0, V0[1] * w0
    q, u, Q, U = x[0].copy(), x[1].copy(), X[0], X[1]
    code, sits, last = codes[0], seated[0], f[0]
    gz, gv, back = gz[0, 0], gv[0, 0], before[0, 0]
    k, gap, held = p[0, 0], p[0, 1], p[0, HELD]
    push, was, speed = df[0], dmem[0, 0], dmem[0, 1]
    p0, p1, p2, p3 = dp[0, 0], dp[0, 1], dp[0, 2], dp[0, 3]
    low, high = nt, 0  # tangents to parameters
    for t in range(nt):
        if p0[t] != 0.0 or p1[t] != 0.0 or p2[t] != 0.0 or p3[t] != 0.0:
            low, high = min(low, t), t + 1
    dz, dv, d = np.empty(nt), np.empty(nt), np.zeros(6)
    for step in range(n):
        z, v = source[step, 0, 0], source[step, 0, 1] - back * last
        for r in range(m):
            a = t0[r] * q[r] + t1[r] * u[r] + c0[r] * last
            b = t2[r] * q[r] + t3[r] * u[r] + c1[r] * last
            q[r] = a
            u[r] = b
            z += w0[r] * a
            v += w0[r] * b
        new = solved(code, 0, z, v, gz, gv, sits, p, memory, last, last, stride)
        free = v
        z += gz * new
        v += gv * new
        motion[step, 0, 0] = z
        motion[step, 0, 1] = v
        forces[step, 0] = new
        if not abs(new) < BEYOND:
            motion[step:], forces[step:], dforces[step:] = np.nan, np.nan, np.nan
            return True
        for t in range(ns):
            dz[t] = ds[step, 0, 0, t]
            dv[t] = ds[step, 0, 1, t] - back * push[t]
        for t in range(ns, nt):
            dz[t] = 0.0
            dv[t] = -back * push[t]
        for r in range(m):
            a0, a1, a2, a3, b0, b1, wr = t0[r], t1[r], t2[r], t3[r], c0[r], c1[r], w0[r]
            for t in range(nt):
                a, b, by = Q[r, t], U[r, t], push[t]
                one = a0 * a + a1 * b + b0 * by
                two = a2 * a + a3 * b + b1 * by
                Q[r, t] = one
                U[r, t] = two
                dz[t] += wr * one
                dv[t] += wr * two
        # the force opposes: of rhs and slopes follow its own tangents, a df = rhs
        fz, fv, l0, l1, l2, l3, from_was, from_speed = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        turned = False
        if code == 4 and sits:
            holds = abs(new) < k
            place_held(free, gv, last if abs(last) >= k else 0.0, memory[0], stride, d)
            fz = HOLDS if holds else 0.0
            l0 = 0.0 if holds else (-1.0 if new > 0.0 else 1.0)
            turned = holds and d[0] != 0.0
        elif code == 4:
            earlier = memory[0, 0]
            moved = (v - earlier) ** 2
            if abs(new) >= k:
                l0 = -1.0 if new > 0.0 else 1.0
            elif k * abs(earlier) > 1e-29 * moved and moved > 0.0:
                l0 = -new / k
                fv = min(2.0 * k * abs(earlier) / moved, 1e29)
                from_was = -v / earlier * fv
            else:
                fv = HOLDS
        elif code == 7:
            if k > 0.0:
                h = held * z - new / k
                yields(z - memory[0, 0], memory[0, 1], h, gap, p[0, 2], p[0, 3], d)
                l0 = h - held * z
                fz = k * (d[0] - held)
                l1, l2, l3 = k * d[2], k * d[3], k * d[4]
                from_was, from_speed = -k * d[0], k * d[1]
            else:
                l0, d[:] = 0.0, 0.0
        else:
            fz, fv, l0, l1, from_was = slopes_of(code, z, v, k, gap, memory[0, 0], held)
        if fz > 1e29:  # dry friction holds its place
            for t in range(nt):
                if turned:
                    was[t] += d[0] * speed[t] + d[1] * (dv[t] + gv * push[t])
                push[t] = (was[t] - dz[t]) / gz
        elif fv > 1e29:
            for t in range(nt):
                push[t] = -dv[t] / gv
        else:
            down = 1.0 / (1.0 + fz * gz + fv * gv)
            for t in range(nt):
                push[t] = -down * (fz * dz[t] + fv * dv[t] + from_was * was[t] + from_speed * speed[t])
            for t in range(low, high):
                push[t] -= down * (l0 * p0[t] + l1 * p1[t] + l2 * p2[t] + l3 * p3[t])
        for t in range(nt):
            dforces[step, 0, t] = push[t]
        if code == 4:
            if sits:
                for t in range(nt):
                    if fz == 0.0:
                        was[t] = dz[t] + gz * push[t]
                    speed[t] = dv[t] + gv * push[t]
            else:
                for t in range(nt):
                    was[t] = dv[t] + gv * push[t]
        elif code == 6 and k > 0.0 and l1 != 0.0:
            for t in range(nt):
                was[t] = dz[t] + gz * push[t]
            for t in range(low, high):
                was[t] -= l1 * (p1[t] / k - gap * p0[t] / (k * k))
        elif code == 7:
            for t in range(nt):
                here = dz[t] + gz * push[t]
                speed[t] = d[0] * (here - was[t]) + d[1] * speed[t]
                was[t] = here
            for t in range(low, high):
                speed[t] += d[2] * p1[t] + d[3] * p2[t] + d[4] * p3[t]
        remember(code, 0, z, v, gv, sits, new, last, p, memory, stride)
        last = new
    f[0] = last
    x[0] = q
    x[1] = u
    return False
