"""Forces of a few nonlinear laws on a linear structure, marched in time together with their exact derivatives.

Only the motion that the forces themselves cause is marched, mode by mode with its exact transition; what the
excitation causes comes in as a source. Each force is straight between steps and solved for at the end of each. Beside
the motion any number of tangents is carried: derivatives of the force to initial states, to the laws' parameters and
to anything that moves the source.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from labnnum.compiled import up_to_date
from labnnum.diagnosis.nonlinear.force import (
    HELD,
    count_of,
    hysteretic,
    law,
    odds_of,
    part_of,
    place_held,
    slips,
)
from labnnum.diagnosis.nonlinear.plain import BEYOND, plain_march
from labnnum.diagnosis.nonlinear.tangents import slopes_of, tangent_march
from labnnum.diagnosis.nonlinear.within import solved
from labnnum.diagnosis.nonlinear.yielding import yields
from labnnum.diagnosis.sums import eliminate


@njit(cache=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def _states_on(x, f, T, V0, w, see):  # pragma: no cover - compiled
    """The modes' states x (2, m) one step on with the forces f (k,); what they add to the motions see (k, 2)."""
    k, m = w.shape
    if k == 1:
        z, v, f0 = see[0, 0], see[0, 1], f[0]
        for r in range(m):
            push = w[0, r] * f0
            q = T[0, r] * x[0, r] + T[1, r] * x[1, r] + V0[0, r] * push
            u = T[2, r] * x[0, r] + T[3, r] * x[1, r] + V0[1, r] * push
            x[0, r] = q
            x[1, r] = u
            z += w[0, r] * q
            v += w[0, r] * u
        see[0, 0], see[0, 1] = z, v
        return
    for r in range(m):
        push = 0.0
        for e in range(k):
            push += w[e, r] * f[e]
        q = T[0, r] * x[0, r] + T[1, r] * x[1, r] + V0[0, r] * push
        u = T[2, r] * x[0, r] + T[3, r] * x[1, r] + V0[1, r] * push
        x[0, r] = q
        x[1, r] = u
    for e in range(k):
        z, v = see[e, 0], see[e, 1]
        for r in range(m):
            z += w[e, r] * x[0, r]
            v += w[e, r] * x[1, r]
        see[e, 0], see[e, 1] = z, v


@njit(cache=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def _tangents_on(X, df, T, V0, w, dsee):  # pragma: no cover - compiled
    """The same of the tangents X (2, m, t) with df (k, t), added to dsee (k, 2, t)."""
    k, m = w.shape
    nt = X.shape[2]
    if k == 1:
        for r in range(m):
            t0, t1, t2, t3, w0 = T[0, r], T[1, r], T[2, r], T[3, r], w[0, r]
            c0, c1 = V0[0, r] * w0, V0[1, r] * w0
            for t in range(nt):
                a, b, push = X[0, r, t], X[1, r, t], df[0, t]
                q = t0 * a + t1 * b + c0 * push
                u = t2 * a + t3 * b + c1 * push
                X[0, r, t] = q
                X[1, r, t] = u
                dsee[0, 0, t] += w0 * q
                dsee[0, 1, t] += w0 * u
    elif k == 2:
        for r in range(m):
            t0, t1, t2, t3, w0, w1 = T[0, r], T[1, r], T[2, r], T[3, r], w[0, r], w[1, r]
            c0, c1 = V0[0, r], V0[1, r]
            for t in range(nt):
                a, b, push = X[0, r, t], X[1, r, t], w0 * df[0, t] + w1 * df[1, t]
                q = t0 * a + t1 * b + c0 * push
                u = t2 * a + t3 * b + c1 * push
                X[0, r, t] = q
                X[1, r, t] = u
                dsee[0, 0, t] += w0 * q
                dsee[0, 1, t] += w0 * u
                dsee[1, 0, t] += w1 * q
                dsee[1, 1, t] += w1 * u
    else:
        for r in range(m):
            for t in range(nt):
                push = 0.0
                for e in range(k):
                    push += w[e, r] * df[e, t]
                q = T[0, r] * X[0, r, t] + T[1, r] * X[1, r, t] + V0[0, r] * push
                u = T[2, r] * X[0, r, t] + T[3, r] * X[1, r, t] + V0[1, r] * push
                X[0, r, t] = q
                X[1, r, t] = u
            for e in range(k):
                for t in range(nt):
                    dsee[e, 0, t] += w[e, r] * X[0, r, t]
                    dsee[e, 1, t] += w[e, r] * X[1, r, t]


@njit(cache=True)
def _given_way(gz, gv, pull):  # pragma: no cover - compiled
    """What a law's force does within its own step where dashpots give way to it as well, motion and speed (k, k), and
    how much of it they take (k, k).
    """
    k = gz.shape[0]
    z, v, taken = gz.copy(), gv.copy(), np.zeros((k, k))
    for i in range(k):
        for o in range(k):
            for j in range(k):
                taken[i, o] += pull[i, j] * gv[j, o]
            for e in range(k):
                z[e, o] -= gz[e, i] * taken[i, o]
                v[e, o] -= gv[e, i] * taken[i, o]
    return z, v, taken


@up_to_date
@njit(cache=True, error_model="numpy", nogil=True)
def march(
    T, W0, W1, w, gz, gv, before, seated, stride, source, codes, p, x, f, memory, forces, motion, X, df, dmem, dp, ds,
    dforces, push, dpush, pull, toward,
):  # fmt: skip # pragma: no cover - compiled
    """Advance over all steps of `source` (n, k, 2); forces (n, k) and motion (n, k, 2) at the ends of the steps.

    T (4, m), W0 and W1 (2, m) transition and weights of each mode; w (k, m) motions; gz, gv (k, k) what a force
    does within its own step, `before` (k, k) what of the speed the force of the step before takes away, `seated` (k,)
    whether dry friction there holds a place; `stride` the step in time; x (2, m),
    f (k,), memory (k, M) state, changed in place. Tangents: X (2, m, t), df
    (k, t), dmem (k, M, t) their states; dp (k, P, t) which parameter each varies; ds (n, k, 2, s) their sources, those
    of the first s tangents; dforces (n, k, t). Returns the number of steps whose forces did not settle.

    Where a march is tied, dashpots at the places push beside the laws, `pull` (k, k) times what the speed is above
    `toward` (n, k) before any force of the step; `push` (k,) and dpush (k, t) are then the whole of the force and its
    tangents, changed in place, and f and df the laws' own. Else `toward` is empty, and `push` is f, dpush df.
    """
    n, k = forces.shape
    m = W0.shape[1]
    nt, ns = X.shape[2], ds.shape[3]
    lp = np.empty((k, 10))
    d = np.empty((k, 6))
    new = np.empty(k)
    see = np.empty((k, 2))
    fz = np.empty(k)
    fv = np.empty(k)
    dsee = np.empty((k, 2, nt))
    rhs = np.empty((k, nt))
    a = np.empty((k, k))
    bad, lost = 0, False
    low, high = nt, 0  # tangents to parameters
    for t in range(nt):
        for e in range(k):
            for i in range(dp.shape[1]):
                if dp[e, i, t] != 0.0:
                    low, high = min(low, t), t + 1
    tied = toward.shape[0] > 0
    wz, wv = gz, gv
    gz, gv, taken = _given_way(wz, wv, pull) if tied else (wz, wv, np.zeros((0, 0)))
    drawn, ddrawn = np.zeros(k), np.zeros((k, nt if tied else 0))
    # states are held without what the last force did within its step; that goes into the next one's weight
    V0 = np.empty((2, m))
    for r in range(m):
        V0[0, r] = W0[0, r] + T[0, r] * W1[0, r] + T[1, r] * W1[1, r]
        V0[1, r] = W0[1, r] + T[2, r] * W1[0, r] + T[3, r] * W1[1, r]
        for e in range(k):
            x[0, r] -= w[e, r] * W1[0, r] * push[e]
            x[1, r] -= w[e, r] * W1[1, r] * push[e]
            for t in range(nt):
                X[0, r, t] -= w[e, r] * W1[0, r] * dpush[e, t]
                X[1, r, t] -= w[e, r] * W1[1, r] * dpush[e, t]
    short = not tied and (nt == 0 or (k == 1 and codes[0] <= 7))
    if short and nt == 0:
        bad, lost = plain_march(
            T, V0, w, gz, gv, before, seated, stride, source, codes, p, x, f, memory, forces, motion
        )  # fmt: skip
    elif short:
        lost = tangent_march(
            T, V0, w, gz, gv, before, seated, stride, source, codes, p, x, f, memory, forces, motion, X, df, dmem, dp,
            ds, dforces,
        )  # fmt: skip
    if lost:
        x[:], X[:] = np.nan, np.nan
        return bad
    for step in range(0 if short else n):
        for e in range(k):
            see[e, 0] = source[step, e, 0]
            see[e, 1] = source[step, e, 1]
            for o in range(k):
                see[e, 1] -= before[e, o] * push[o]
        _states_on(x, push, T, V0, w, see)
        if tied:
            for e in range(k):
                drawn[e] = 0.0
                for o in range(k):
                    drawn[e] += pull[e, o] * (see[o, 1] - toward[step, o])
            for e in range(k):
                for o in range(k):
                    see[e, 0] -= wz[e, o] * drawn[o]
                    see[e, 1] -= wv[e, o] * drawn[o]
        for e in range(k):
            new[e] = f[e]
        settled = False
        for _ in range(80):
            change = 0.0
            size = 0.0
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
            lost = lost or not abs(new[e]) < BEYOND
        if lost:  # a law that pushes has gone too far
            x[:], X[:] = np.nan, np.nan
            motion[step:], forces[step:], dforces[step:] = np.nan, np.nan, np.nan
            return bad
        if nt > 0:
            for e in range(k):
                for c in range(2):
                    for t in range(ns):
                        dsee[e, c, t] = ds[step, e, c, t]
                    for t in range(ns, nt):
                        dsee[e, c, t] = 0.0
                for o in range(k):
                    for t in range(nt):
                        dsee[e, 1, t] -= before[e, o] * dpush[o, t]
            _tangents_on(X, dpush, T, V0, w, dsee)
            if tied:
                for e in range(k):
                    for t in range(nt):
                        ddrawn[e, t] = 0.0
                    for o in range(k):
                        for t in range(nt):
                            ddrawn[e, t] += pull[e, o] * dsee[o, 1, t]
                for e in range(k):
                    for o in range(k):
                        for t in range(nt):
                            dsee[e, 0, t] -= wz[e, o] * ddrawn[o, t]
                            dsee[e, 1, t] -= wv[e, o] * ddrawn[o, t]
            for e in range(k):
                code = codes[e]
                from_was = 0.0
                if code == 4 and seated[e]:
                    holds = abs(new[e]) < p[e, 0]
                    slid = abs(f[e]) >= p[e, 0]
                    v = motion[step, e, 1] - gv[e, e] * new[e]
                    place_held(v, gv[e, e], f[e] if slid else 0.0, memory[e], stride, d[e])
                    fz[e], fv[e] = 1e30 if holds else 0.0, 0.0
                    s = -1.0 if new[e] > 0 else 1.0
                    for t in range(nt):
                        if not holds:
                            rhs[e, t] = -s * dp[e, 0, t]
                            continue
                        rhs[e, t] = dmem[e, 0, t] - dsee[e, 0, t]
                        if d[e, 0] != 0.0:
                            after = dsee[e, 1, t] + gv[e, e] * df[e, t]
                            rhs[e, t] += d[e, 0] * dmem[e, 1, t] + d[e, 1] * after
                            dmem[e, 0, t] = rhs[e, t] + dsee[e, 0, t]
                    continue
                if code == 4:
                    v, earlier = motion[step, e, 1], memory[e, 0]
                    moved = (v - earlier) ** 2
                    if abs(new[e]) < p[e, 0] and p[e, 0] * abs(earlier) > 1e-29 * moved and moved > 0.0:
                        s = -new[e] / p[e, 0]
                        fz[e], fv[e] = 0.0, min(2.0 * p[e, 0] * abs(earlier) / moved, 1e29)
                        back = -v / earlier * fv[e]
                        for t in range(nt):
                            rhs[e, t] = -s * dp[e, 0, t] - back * dmem[e, 0, t]
                    elif abs(new[e]) < p[e, 0]:
                        fz[e], fv[e] = 0.0, 1e30
                        for t in range(nt):
                            rhs[e, t] = 0.0
                    else:
                        fz[e], fv[e] = 0.0, 0.0
                        s = -1.0 if new[e] > 0 else 1.0
                        for t in range(nt):
                            rhs[e, t] = -s * dp[e, 0, t]
                    continue
                if code == 7 and p[e, 0] > 0.0:
                    z = motion[step, e, 0]
                    h = p[e, HELD] * z - new[e] / p[e, 0]
                    yields(z - memory[e, 0], memory[e, 1], h, p[e, 1], p[e, 2], p[e, 3], d[e])
                    lp[e, 0] = h - p[e, HELD] * z
                    fz[e], fv[e] = p[e, 0] * (d[e, 0] - p[e, HELD]), 0.0
                    for i in range(3):
                        lp[e, i + 1] = p[e, 0] * d[e, i + 2]
                elif code < 7:
                    fz[e], fv[e], lp[e, 0], lp[e, 1], from_was = slopes_of(
                        code, motion[step, e, 0], motion[step, e, 1], p[e, 0], p[e, 1], memory[e, 0], p[e, HELD]
                    )  # fmt: skip
                    lp[e, 2], lp[e, 3] = 0.0, 0.0
                else:
                    _, fz[e], fv[e] = law(code, motion[step, e, 0], motion[step, e, 1], p[e], memory[e], lp[e], d[e])
                for t in range(nt):
                    rhs[e, t] = 0.0
                for i in range(4 if code != 8 else 10):
                    if lp[e, i] != 0.0:
                        for t in range(low, high):
                            rhs[e, t] -= lp[e, i] * dp[e, i, t]
                if from_was != 0.0:
                    for t in range(nt):
                        rhs[e, t] -= from_was * dmem[e, 0, t]
                if code == 7:
                    for t in range(nt):
                        rhs[e, t] -= p[e, 0] * (d[e, 1] * dmem[e, 1, t] - d[e, 0] * dmem[e, 0, t])
                if code == 9:
                    n = count_of(p[e])
                    for i in range(n):
                        if not slips(i, motion[step, e, 0], p[e], memory[e]):
                            for t in range(nt):
                                rhs[e, t] += p[e, 0] / n * dmem[e, i, t]
            for e in range(k):
                if fz[e] > 1e29:  # dry friction holds its place
                    for o in range(k):
                        a[e, o] = gz[e, o]
                elif fv[e] > 1e29:
                    for t in range(nt):
                        rhs[e, t] = -dsee[e, 1, t]
                    for o in range(k):
                        a[e, o] = gv[e, o]
                else:
                    for t in range(nt):
                        rhs[e, t] -= fz[e] * dsee[e, 0, t] + fv[e] * dsee[e, 1, t]
                    for o in range(k):
                        a[e, o] = (1.0 if o == e else 0.0) + fz[e] * gz[e, o] + fv[e] * gv[e, o]
            if k == 1:
                for t in range(nt):
                    df[0, t] = rhs[0, t] / a[0, 0]
            elif k == 2:
                over = 1.0 / (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0])
                for t in range(nt):
                    df[0, t] = over * (a[1, 1] * rhs[0, t] - a[0, 1] * rhs[1, t])
                    df[1, t] = over * (a[0, 0] * rhs[1, t] - a[1, 0] * rhs[0, t])
            else:
                eliminate(a, rhs)
                df[:] = rhs
            for e in range(k):
                for t in range(nt):
                    dforces[step, e, t] = df[e, t]
            if tied:
                for e in range(k):
                    for t in range(nt):
                        dpush[e, t] = df[e, t] - ddrawn[e, t]
                    for o in range(k):
                        for t in range(nt):
                            dpush[e, t] -= taken[e, o] * df[o, t]
            for e in range(k):
                code = codes[e]
                if code == 4:
                    if seated[e] and fz[e] == 0.0:
                        for t in range(nt):
                            dz = dsee[e, 0, t]
                            for o in range(k):
                                dz += gz[e, o] * df[o, t]
                            dmem[e, 0, t] = dz
                    for t in range(nt):
                        dv = dsee[e, 1, t]
                        for o in range(k):
                            dv += gv[e, o] * df[o, t]
                        dmem[e, 1 if seated[e] else 0, t] = dv
                elif code == 6 and p[e, 0] > 0.0 and abs(p[e, 0] * (motion[step, e, 0] - memory[e, 0])) > p[e, 1]:
                    s = 1.0 if motion[step, e, 0] > memory[e, 0] else -1.0
                    for t in range(nt):
                        dz = dsee[e, 0, t]
                        for o in range(k):
                            dz += gz[e, o] * df[o, t]
                        back = dp[e, 1, t] / p[e, 0] - p[e, 1] * dp[e, 0, t] / p[e, 0] ** 2
                        dmem[e, 0, t] = dz - s * back
                elif code == 7:
                    for t in range(nt):
                        dz = dsee[e, 0, t]
                        for o in range(k):
                            dz += gz[e, o] * df[o, t]
                        dmem[e, 1, t] = (
                            d[e, 0] * (dz - dmem[e, 0, t]) + d[e, 1] * dmem[e, 1, t]
                            + d[e, 2] * dp[e, 1, t] + d[e, 3] * dp[e, 2, t] + d[e, 4] * dp[e, 3, t]
                        )  # fmt: skip
                        dmem[e, 0, t] = dz
                elif code == 9 and p[e, 0] > 0.0:
                    for i in range(count_of(p[e])):
                        if not slips(i, motion[step, e, 0], p[e], memory[e]):
                            continue
                        s = 1.0 if motion[step, e, 0] > memory[e, i] else -1.0
                        odds = odds_of(i, p[e])
                        part = part_of(i, p[e])
                        for t in range(nt):
                            dz = dsee[e, 0, t]
                            for o in range(k):
                                dz += gz[e, o] * df[o, t]
                            back = dp[e, 1, t] * odds + p[e, 1] * part * dp[e, 2, t]
                            back -= p[e, 1] * odds * dp[e, 0, t] / p[e, 0]
                            dmem[e, i, t] = dz - s * back / p[e, 0]
        for e in range(k):
            code = codes[e]
            if code == 4 and seated[e]:
                z, v = motion[step, e, 0], motion[step, e, 1]
                slid = f[e] if abs(f[e]) >= p[e, 0] else 0.0
                place = place_held(v - gv[e, e] * new[e], gv[e, e], slid, memory[e], stride, d[e])
                memory[e, 0] = place if abs(new[e]) < p[e, 0] else z
                memory[e, 1] = v
            elif code == 4:
                memory[e, 0] = motion[step, e, 1]
            elif code == 6:
                z = motion[step, e, 0]
                if p[e, 0] > 0.0 and abs(p[e, 0] * (z - memory[e, 0])) > p[e, 1]:
                    memory[e, 0] = z - np.sign(z - memory[e, 0]) * p[e, 1] / p[e, 0]
            elif code == 7:
                z = motion[step, e, 0]
                h = p[e, HELD] * z - new[e] / p[e, 0] if p[e, 0] > 0.0 else hysteretic(z, p[e], memory[e], d[e])
                memory[e, 0] = z
                memory[e, 1] = h
            elif code == 9 and p[e, 0] > 0.0:
                z = motion[step, e, 0]
                for i in range(count_of(p[e])):
                    if slips(i, z, p[e], memory[e]):
                        memory[e, i] = z - np.sign(z - memory[e, i]) * p[e, 1] * odds_of(i, p[e]) / p[e, 0]
            f[e] = new[e]
        if tied:
            for e in range(k):
                push[e] = f[e] - drawn[e]
                for o in range(k):
                    push[e] -= taken[e, o] * f[o]
    for r in range(m):
        for e in range(k):
            x[0, r] += w[e, r] * W1[0, r] * push[e]
            x[1, r] += w[e, r] * W1[1, r] * push[e]
            for t in range(nt):
                X[0, r, t] += w[e, r] * W1[0, r] * dpush[e, t]
                X[1, r, t] += w[e, r] * W1[1, r] * dpush[e, t]
    return bad
