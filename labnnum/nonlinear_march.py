r"""The march of `labnnum.nonlinear`, compiled: whole steps, and steps that are taken in parts where a law changes.

The force of each element is a cubic over a step, by its values and rates at both ends (Hermite); `el` holds one row an
element, as `labnnum.nonlinear_laws` has it. Parts of a step are whole numbers of 2^-20 of it, made up of sixteenths of
sixteenths, whose exact transitions are kept.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from labnnum.compiled import up_to_date
from labnnum.nonlinear_laws import (
    FORCE,
    HELD,
    MODE,
    PLACE,
    RATE,
    SIGN,
    TURNED,
    V,
    W,
    Z,
    changes,
    cubic,
    dips,
    law,
    past,
    put,
    turn,
)

FULL = 1 << 20
"""Units of a step."""
LEVELS = 5
"""Of sixteenths of sixteenths: FULL is 16 to this power."""
COARSE = 256
"""Units to which an event is located where the force has a kink and no jump: what is left is of its square."""
MOST = 40
"""Events within one step, beyond which laws change at the ends of its parts only."""
NEAR = 1e-13
"""Change of a force, of its size, with which the search for it ends."""


@njit(cache=True, inline="always", error_model="numpy")
def _newton(code, e, sz, sv, sw, G, ell, p, el, hold):  # pragma: no cover - compiled
    """Force and rate at the end of a step, of a law without jumps; whether they were found."""
    last = G.shape[0] - 1
    zf, zd, vf, vd = G[0, e, e, 2], G[0, e, e, 3], G[1, e, e, 2], G[1, e, e, 3]
    wf, wd = G[last, e, e, 2], G[last, e, e, 3]
    f, d = hold[e, 2], hold[e, 3]
    linear = code == 2 or code == 3 or code == 6
    for _ in range(50):
        z = sz + zf * f + zd * d
        if code == 5:
            v = sv + vf * f + vd * d
            bends = 6.0 * (el[e, Z] - z) / ell + 2.0 * el[e, V] + 4.0 * v
            size, sense = abs(v), 1.0 if v > 0.0 else -1.0
            c = p[e, 0]
            r1, r2 = f + c * v * size, d + 2.0 * c * size * bends
            a, b = 1.0 + 2.0 * c * size * vf, 2.0 * c * size * vd
            to_f = 2.0 * c * (size * (4.0 * vf - 6.0 * zf / ell) + sense * bends * vf)
            to_d = 1.0 + 2.0 * c * (size * (4.0 * vd - 6.0 * zd / ell) + sense * bends * vd)
        else:
            w = sw + wf * f + wd * d
            value, slope, bent = law(code, z, e, p, el)
            r1, r2 = f + value, d + ell * slope * w
            a, b = 1.0 + slope * zf, slope * zd
            to_f = ell * (slope * wf + bent * w * zf)
            to_d = 1.0 + ell * (slope * wd + bent * w * zd)
        det = a * to_d - b * to_f
        if det == 0.0:
            return False
        df, dd = (b * r2 - to_d * r1) / det, (to_f * r1 - a * r2) / det
        f += df
        d += dd
        if linear or abs(df) + abs(dd) <= NEAR * (abs(f) + abs(d)):
            hold[e, 2], hold[e, 3] = f, d
            return True
    hold[e, 2], hold[e, 3] = f, d
    return abs(df) + abs(dd) <= 1e-9 * (abs(f) + abs(d))


@njit(cache=True, inline="always", error_model="numpy")
def _stick(e, sz, sv, G, place, hold):  # pragma: no cover - compiled
    """The force, straight over the step, that ends it at `place` and at rest."""
    za = G[0, e, e, 0] - G[0, e, e, 1] - G[0, e, e, 3]
    zb = G[0, e, e, 2] + G[0, e, e, 1] + G[0, e, e, 3]
    va = G[1, e, e, 0] - G[1, e, e, 1] - G[1, e, e, 3]
    vb = G[1, e, e, 2] + G[1, e, e, 1] + G[1, e, e, 3]
    det = za * vb - zb * va
    a, b = 0.0, 0.0
    if det != 0.0:
        a = ((place - sz) * vb + sv * zb) / det
        b = (-sv * za - (place - sz) * va) / det
    hold[e, 0], hold[e, 1], hold[e, 2], hold[e, 3] = a, b - a, b, b - a


@njit(cache=True, error_model="numpy")
def _trial(seen, G, ell, codes, p, el, hold):  # pragma: no cover - compiled
    """Forces over a step in which no law changes its mode: `hold` (k, 4) of values and rates, times the step."""
    k, last = codes.size, G.shape[0] - 1
    for e in range(k):
        f, d = el[e, FORCE], el[e, RATE] * ell
        hold[e, 0], hold[e, 1], hold[e, 2], hold[e, 3] = f, d, f + d, d
    largest, change = 0.0, 0.0
    for _ in range(60):
        largest, change = 0.0, 0.0
        for e in range(k):
            code, mode = codes[e], el[e, MODE]
            if p[e, 0] == 0.0 or (mode == 0.0 and (code == 2 or code == 3)):
                hold[e, 2] = hold[e, 3] = 0.0
                continue
            if mode != 0.0 and (code == 4 or code == 6):
                hold[e, 0] = hold[e, 2] = el[e, FORCE]
                hold[e, 1] = hold[e, 3] = 0.0
                continue
            sz, sv, sw = seen[0, e], seen[1, e], seen[last, e]
            for o in range(k):
                if o != e:
                    for c in range(4):
                        sz += G[0, e, o, c] * hold[o, c]
                        sv += G[1, e, o, c] * hold[o, c]
                        sw += G[last, e, o, c] * hold[o, c]
            before = hold[e, 2]
            if code == 4:
                _stick(e, sz, sv, G, el[e, PLACE], hold)
            else:
                for c in range(2):
                    sz += G[0, e, e, c] * hold[e, c]
                    sv += G[1, e, e, c] * hold[e, c]
                    sw += G[last, e, e, c] * hold[e, c]
                if not _newton(code, e, sz, sv, sw, G, ell, p, el, hold):
                    return False
            change = max(change, abs(hold[e, 2] - before))
            largest = max(largest, abs(hold[e, 2]))
        if k == 1 or change <= 1e-12 * largest:
            return True
    return change <= 1e-8 * largest


@njit(cache=True, inline="always", error_model="numpy")
def _accept(x, g, seen, G, H, ell, codes, p, el, hold):  # pragma: no cover - compiled
    """Take the step that was tried."""
    k, last = codes.size, G.shape[0] - 1
    for e in range(k):
        z, v, w = seen[0, e], seen[1, e], seen[last, e]
        for o in range(k):
            for c in range(4):
                z += G[0, e, o, c] * hold[o, c]
                v += G[1, e, o, c] * hold[o, c]
                w += G[last, e, o, c] * hold[o, c]
        el[e, FORCE], el[e, RATE] = hold[e, 2], hold[e, 3] / ell
        el[e, Z], el[e, V], el[e, W] = z, v, w
        if codes[e] == 7 and p[e, 0] != 0.0:
            el[e, PLACE], el[e, HELD] = z, -hold[e, 2] / p[e, 0]
    for b in range(g.size):
        x[b] = g[b]
    for e in range(k):
        for c in range(4):
            value = hold[e, c]
            if value != 0.0:
                for b in range(g.size):
                    x[b] += H[c, e, b] * value


@njit(cache=True, error_model="numpy")
def _along(code, e, at, ell, z1, v1, p, el, hold):  # pragma: no cover - compiled
    """`_past` within the step that was tried, from its ends."""
    z0, d0, d1 = el[e, Z], el[e, V] * ell, v1 * ell
    z = cubic(z0, d0, z1, d1, at)
    v = (
        6.0 * (at - at * at) * (z1 - z0) + (1.0 - 4.0 * at + 3.0 * at * at) * d0 + (3.0 * at * at - 2.0 * at) * d1
    ) / ell
    f = cubic(hold[e, 0], hold[e, 1], hold[e, 2], hold[e, 3], at)
    return past(code, e, z, v, f, p, el)


@njit(cache=True, inline="always", error_model="numpy")
def _within(code, e, z, v, ell, p, el, hold):  # pragma: no cover - compiled
    """Whether an element that ends a step within its mode leaves it on the way."""
    mode, before = el[e, MODE], el[e, V]
    if code == TURNED:
        return False
    if code == 4 and mode == 0.0:
        return past(code, e, z, v, hold[e, 0], p, el) > 0.0
    if code == 4 or code == 7 or (code == 6 and mode != 0.0):
        return dips(before, v, el[e, Z], z, ell, mode)
    return before * v < 0.0 and _along(code, e, before / (before - v), ell, z, v, p, el, hold) > 0.0


@njit(cache=True, error_model="numpy")
def _root(code, e, z, v, ell, p, el, hold):  # pragma: no cover - compiled
    """Where within the step element e first leaves its mode, 0 to 1."""
    low = high = 0.0
    for i in range(1, 9):
        high = 0.125 * i
        if i == 8 or _along(code, e, high, ell, z, v, p, el, hold) > 0.0:
            break
        low = high
    if low == 0.0 and _along(code, e, 1e-9, ell, z, v, p, el, hold) > 0.0:
        return 0.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if _along(code, e, middle, ell, z, v, p, el, hold) > 0.0:
            high = middle
        else:
            low = middle
    return high


@njit(cache=True, error_model="numpy")
def _event(seen, G, ell, whole, codes, p, el, hold):  # pragma: no cover - compiled
    """The first event within the step that was tried: its kind, a code, the element or -1, and where, 0 to 1.

    Dry friction that sticks is looked at in a `whole` step only; shorter parts do not tell its force.
    """
    kind, first, where = 0, -1, 2.0
    for e in range(codes.size):
        code = codes[e]
        if not changes(code, e, p, el) or (code == 4 and el[e, MODE] == 0.0 and not whole):
            continue
        z, v = seen[0, e], seen[1, e]
        for o in range(codes.size):
            for c in range(4):
                z += G[0, e, o, c] * hold[o, c]
                v += G[1, e, o, c] * hold[o, c]
        for one in range(2 if code == 7 else 1):
            now = TURNED if one == 1 else code
            if past(now, e, z, v, hold[e, 2], p, el) > 0.0 or _within(now, e, z, v, ell, p, el, hold):
                root = _root(now, e, z, v, ell, p, el, hold)
                if root < where:
                    kind, first, where = now, e, root
    return kind, first, where


@njit(cache=True, inline="always", error_model="numpy")
def _sticks(codes, p, el):  # pragma: no cover - compiled
    """Whether any dry friction holds."""
    found = False
    for e in range(codes.size):
        found |= codes[e] == 4 and el[e, MODE] == 0.0 and p[e, 0] != 0.0
    return found


@njit(cache=True, error_model="numpy")
def _slip(share, codes, p, el, hold):  # pragma: no cover - compiled
    """The first dry friction that lets go within a share of a whole step that was tried: element or -1, where in it."""
    first, where = -1, share
    for e in range(codes.size):
        if codes[e] != 4 or el[e, MODE] != 0.0 or p[e, 0] == 0.0:
            continue
        a, b = hold[e, 0], hold[e, 2]
        if abs(a) > p[e, 0]:
            return e, 0.0
        if abs(a + share * (b - a)) > p[e, 0]:
            at = (np.sign(b - a) * p[e, 0] - a) / (b - a)
            if at < where:
                first, where = e, at
    return first, where / share


@njit(cache=True, error_model="numpy")
def _part(entry, now, length, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step):
    # pragma: no cover - compiled
    """Try a part of a step from `now` on, both in units: its end without the elements in g and seen, forces in hold."""
    T, moved, G, _ = tables
    n_in, order = coefficients.shape
    m = T.shape[2]
    t = T[entry]
    for b in range(m):
        g[b] = t[0, b] * x[b] + t[1, b] * x[m + b]
        g[m + b] = t[2, b] * x[b] + t[3, b] * x[m + b]
    start, scale = now / FULL, length / FULL
    for i in range(n_in):
        for j in range(order):
            shifted[j] = coefficients[i, j]
        for j in range(order - 1):  # Taylor's shift of the polynomial
            for q in range(order - 2, j - 1, -1):
                shifted[q] += start * shifted[q + 1]
        power = 1.0
        for j in range(order):
            value = shifted[j] * power
            power *= scale
            for b in range(m):
                g[b] += moved[entry, i, j, 0, b] * value
                g[m + b] += moved[entry, i, j, 1, b] * value
    _look(see, g, seen)
    return _trial(seen, G[entry], scale * step, codes, p, el, hold)


@njit(cache=True, inline="always", error_model="numpy")
def _look(see, g, seen):  # pragma: no cover - compiled
    """What the elements see of the state g."""
    rows, k, size = see.shape
    for r in range(rows):
        for e in range(k):
            total = 0.0
            for b in range(size):
                total += see[r, e, b] * g[b]
            seen[r, e] = total


@njit(cache=True, inline="always", error_model="numpy")
def _entry(length):  # pragma: no cover - compiled
    """The table's row of a part of `length` units, one digit of sixteenths of sixteenths; 0 for the whole step."""
    if length >= FULL:
        return 0
    level, unit = 1, FULL >> 4
    while length < unit:
        level += 1
        unit >>= 4
    return 1 + 15 * (level - 1) + length // unit - 1


@njit(cache=True, error_model="numpy")
def _advance(q, now, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step):
    # pragma: no cover - compiled
    """March q units on, in as many parts as q has digits; whether all forces settled."""
    unit = FULL
    while q > 0:
        length = (q // unit) * unit
        if length > 0:
            entry = _entry(length)
            if not _part(entry, now, length, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step):
                return False
            _accept(x, g, seen, tables[2][entry], tables[3][entry], length / FULL * step, codes, p, el, hold)
            now += length
            q -= length
        unit >>= 4
    return True


@njit(cache=True, error_model="numpy")
def _locate(code, e, where, length, now, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step):
    # pragma: no cover - compiled
    """March to where element e changes, within `length` units from `now`; units that were gone, -1 for a failure."""
    stuck = code == 4 and el[e, MODE] == 0.0
    unit = 1 if code == 4 else min(COARSE, length)
    a, b, last = 0, length, -1
    low, high = past(code, e, el[e, Z], el[e, V], el[e, FORCE], p, el), np.inf
    q = min(max(int(np.ceil(where * length / unit)) * unit, 0), length)
    old_x, old = x.copy(), el.copy()
    for _ in range(16):
        x[:] = old_x
        el[:, :] = old
        if not _advance(q, now, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step):
            return -1
        last = q
        if stuck or q == 0:
            break
        beyond = past(code, e, el[e, Z], el[e, V], el[e, FORCE], p, el)
        slope = (beyond - low) / (q - a) if q > a else (high - beyond) / (b - q) if high < np.inf else 0.0
        if beyond >= 0.0:
            b, high = q, beyond
        else:
            a, low = q, beyond
        if b - a <= unit:
            q = b
        else:
            if slope > 0.0:
                if 0.0 <= beyond <= slope * unit:
                    break
                q += int(np.ceil(-beyond / slope / unit)) * unit
            if not a < q < b:
                q = (a + b) // (2 * unit) * unit
            if not a < q < b:
                q = b
        if q == last:
            break
    return last


@njit(cache=True, error_model="numpy")
def _through(kind, e, where, x, f, into, tables, see, codes, p, el, g, seen, hold, step):
    # pragma: no cover - compiled
    """A step in parts, from event to event; f (n_in, order) are the samples around it. Whether all forces settled."""
    n_in, order = f.shape
    coefficients, shifted = np.zeros((n_in, order)), np.empty(order)
    for i in range(n_in):
        for j in range(order):
            for q in range(order):
                coefficients[i, j] += into[j, q] * f[i, q]
    now, length, events = 0, FULL, 0
    push = np.copy(hold)
    G, H = tables[2], tables[3]
    while True:
        if e >= 0:
            events += 1
            slid = el[e, MODE]
            q = _locate(
                kind, e, where, length, now, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step
            )  # fmt: skip
            if q < 0:
                return False
            now += q
            needed = 0.0
            if kind == 4 and slid == 0.0:
                needed = np.inf * np.sign(push[e, 0] if abs(push[e, 0]) > p[e, 0] else push[e, 2] - push[e, 0])
                if q > 0:  # as far as could be foreseen: does it let go here, or later?
                    if not _part(
                        0, now, FULL, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step
                    ):
                        return False
                    if abs(hold[e, 0]) < p[e, 0]:
                        needed = hold[e, 0]
            elif kind == 4:  # would it stick for a whole step?
                el[e, MODE], el[e, PLACE] = 0.0, el[e, Z]
                if not _part(0, now, FULL, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step):
                    return False
                el[e, MODE], needed = slid, hold[e, 0]
            turn(kind, e, needed, p, el)
        if now >= FULL:
            return True
        rest, unit = FULL - now, 1
        while rest % (16 * unit) == 0 and unit < FULL:
            unit *= 16
        length = rest if unit >= FULL else rest % (16 * unit)
        entry = _entry(length)
        ell = length / FULL * step
        slips, at = -1, 1.0
        if events < MOST and _sticks(codes, p, el):
            if not _part(0, now, FULL, x, tables, coefficients, see, codes, p, el, g, seen, push, shifted, step):
                return False
            slips, at = _slip(length / FULL, codes, p, el, push)
        if not _part(entry, now, length, x, tables, coefficients, see, codes, p, el, g, seen, hold, shifted, step):
            return False
        e = -1
        if events < MOST:
            kind, e, where = _event(seen, G[entry], ell, False, codes, p, el, hold)
            if slips >= 0 and (e < 0 or at <= where):
                kind, e, where = 4, slips, at
        if e < 0:
            _accept(x, g, seen, G[entry], H[entry], ell, codes, p, el, hold)
            now += length


@up_to_date
@njit(cache=True, error_model="numpy")
def begin(codes, p, el):  # pragma: no cover - compiled
    """Elements at rest, sliders unstrained."""
    el[:, :] = 0.0
    for e in range(codes.size):
        if codes[e] == 2:
            el[e, MODE] = 1.0 if p[e, 1] < 0.0 else 0.0
        elif codes[e] == 3:
            el[e, MODE] = 2.0 if p[e, 1] <= 0.0 else 0.0
        elif codes[e] == 7:
            el[e, MODE] = el[e, SIGN] = 1.0
        if p[e, 0] != 0.0 and codes[e] != 4:
            put(codes[e], e, p, el)


@njit(cache=True, inline="always", error_model="numpy")
def _alone(code, mode, z0, v0, fa, da, sz, sv, sw, gz, gv, gw, step, k, level, place):  # pragma: no cover - compiled
    """A step of one element whose force is a power or straight in its mode, by numbers alone.

    Whether it ends, and surely stays, within the mode; forces and rates times the step at its beginning and end, motion
    and speed at its end. From forces to what is seen gz, gv and gw (4,).
    """
    if code == 4 and mode == 0.0:
        za, zb, va, vb = gz[0] - gz[1] - gz[3], gz[2] + gz[1] + gz[3], gv[0] - gv[1] - gv[3], gv[2] + gv[1] + gv[3]
        det = za * vb - zb * va
        if det == 0.0:
            return False, fa, da, fa, da, z0, v0
        a, b = ((place - sz) * vb + sv * zb) / det, (-sv * za - (place - sz) * va) / det
        z, v = sz + za * a + zb * b, sv + va * a + vb * b
        return abs(a) < k and abs(b) < k, a, b - a, b, b - a, z, v
    sz += gz[0] * fa + gz[1] * da
    sv += gv[0] * fa + gv[1] * da
    f, d = 0.0, 0.0
    if code == 0:
        sw += gw[0] * fa + gw[1] * da
        f, d, close = fa + da, da, False
        for _ in range(20):
            z, w = sz + gz[2] * f + gz[3] * d, sw + gw[2] * f + gw[3] * d
            slope, bent = 3.0 * k * z * z, 6.0 * k * z
            r1, r2 = f + k * z * z * z, d + step * slope * w
            a, b = 1.0 + slope * gz[2], slope * gz[3]
            to_f = step * (slope * gw[2] + bent * w * gz[2])
            to_d = 1.0 + step * (slope * gw[3] + bent * w * gz[3])
            det = a * to_d - b * to_f
            df, dd = (b * r2 - to_d * r1) / det, (to_f * r1 - a * r2) / det
            f += df
            d += dd
            close = abs(df) + abs(dd) <= NEAR * (abs(f) + abs(d))
            if close:
                break
        return close, fa, da, f, d, sz + gz[2] * f + gz[3] * d, sv + gv[2] * f + gv[3] * d
    if mode != 0.0 and (code == 4 or code == 6):
        f = fa
    elif code == 6 or mode != 0.0:
        sw += gw[0] * fa + gw[1] * da
        at = place if code == 6 else (mode * level if mode < 2.0 else 0.0)
        a, b, to_f, to_d = 1.0 + k * gz[2], k * gz[3], step * k * gw[2], 1.0 + step * k * gw[3]
        r1, r2, det = -k * (sz - at), -step * k * sw, a * to_d - b * to_f
        f, d = (to_d * r1 - b * r2) / det, (a * r2 - to_f * r1) / det
    z, v = sz + gz[2] * f + gz[3] * d, sv + gv[2] * f + gv[3] * d
    if code == 2:
        stays = z < level if mode == 0.0 else z > level
    elif code == 3:
        stays = abs(z) < level if mode == 0.0 else mode == 2.0 or mode * z > level
    elif mode == 0.0:
        stays = code == 6 and abs(k * (z - place)) < level
    else:
        stays = mode * v > 0.0
    same = v0 * v > 0.0 and (mode == 0.0 or code < 4 or mode * (1.5 * (z - z0) - 0.25 * step * (v0 + v)) > 0.0)
    return stays and (same or mode == 2.0), fa, da, f, d, z, v


@up_to_date
@njit(cache=True, error_model="numpy")
def march(
    T, U, H, G, see, x, f, states, forces, codes, p, el, into, tables, step
):  # fmt: skip # pragma: no cover - compiled
    """Advance; x (2 m,) holds first states, then second ones. Returns the first step that did not settle, or 0."""
    n_in, m, _, order = U.shape
    k = codes.size
    g, seen, hold = np.empty(2 * m), np.empty((see.shape[0], k)), np.empty((k, 4))
    last = see.shape[0] - 1
    alone = k == 1 and p[0, 0] != 0.0 and codes[0] != 1 and codes[0] != 5 and codes[0] != 7
    for n in range(states.shape[0]):
        for b in range(2 * m):
            states[n, b] = x[b]
        for e in range(k):
            forces[n, e] = el[e, FORCE]
        for b in range(m):
            one = T[0, b] * x[b] + T[1, b] * x[m + b]
            two = T[2, b] * x[b] + T[3, b] * x[m + b]
            for i in range(n_in):
                for j in range(order):
                    one += U[i, b, 0, j] * f[i, n + j]
                    two += U[i, b, 1, j] * f[i, n + j]
            g[b] = one
            g[m + b] = two
        _look(see, g, seen)
        if alone:
            code, mode, fa, da = codes[0], el[0, MODE], el[0, FORCE], el[0, RATE] * step
            quiet, fa, da, force, rate, z, v = _alone(
                code, mode, el[0, Z], el[0, V], fa, da, seen[0, 0], seen[1, 0], seen[last, 0], G[0, 0, 0],
                G[1, 0, 0], G[last, 0, 0], step, p[0, 0], p[0, 1], el[0, PLACE],
            )  # fmt: skip
            if quiet:
                el[0, W] = seen[last, 0]
                if fa != 0.0 or force != 0.0:
                    w = G[last, 0, 0]
                    el[0, W] += w[0] * fa + w[1] * da + w[2] * force + w[3] * rate
                    for b in range(2 * m):
                        g[b] += H[0, 0, b] * fa + H[1, 0, b] * da + H[2, 0, b] * force + H[3, 0, b] * rate
                el[0, FORCE], el[0, RATE], el[0, Z], el[0, V] = force, rate / step, z, v
                for b in range(2 * m):
                    x[b] = g[b]
                continue
        if not _trial(seen, G, step, codes, p, el, hold):
            return n + 1
        kind, e, where = _event(seen, G, step, True, codes, p, el, hold)
        if e < 0:
            _accept(x, g, seen, G, H, step, codes, p, el, hold)
        elif not _through(kind, e, where, x, f[:, n : n + order], into, tables, see, codes, p, el, g, seen, hold, step):
            return n + 1
    return 0
