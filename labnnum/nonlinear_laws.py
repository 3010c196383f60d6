"""Laws of `labnnum.nonlinear` in one mode at a time, compiled: forces, where a mode ends, and which comes next.

In `el`, one row
an element, stand: force and rate, motion z, speed v, speed w of the modes that the step resolves, the memory's two
numbers, the mode and the sign of a hysteretic variable. A mode is what a law does until its next event:

- one-sided-gap: 0 open, 1 closed; clearance: 0 open, 1 or -1 closed on that side, 2 a spring without play
- coulomb, jenkins: 0 sticking, 1 or -1 sliding that way; bouc-wen: 1 or -1 moving that way
"""

from __future__ import annotations

import numpy as np
from numba import njit

FORCE, RATE, Z, V, W, PLACE, HELD, MODE, SIGN = range(9)
COLUMNS = 9
TURNED = 8
"""Beside the codes of laws: a hysteretic variable that changes its sign."""


@njit(cache=True, inline="always", error_model="numpy")
def wen_slope(h, n, factor, sign):  # pragma: no cover - compiled
    """dh/dz = 1 - factor |h|^n, and the slope of that to h; beyond zero as it would go on."""
    size = sign * h
    if size == 0.0:
        return 1.0, -factor * sign if n == 1.0 else 0.0
    power = size if n == 1.0 else (size**n if size > 0.0 else -((-size) ** n))
    return 1.0 - factor * power, -factor * n * power / h


@njit(cache=True, error_model="numpy")
def wen(dz, h, n, factor, sign):  # pragma: no cover - compiled
    """H after a motion of dz in one sense: Runge-Kutta 4 in z, in parts that are short against where it yields."""
    parts = min(int(abs(dz) * abs(factor) ** (1.0 / max(n, 0.1)) * max(n, 1.0) / 0.1) + 1, 200)
    d = dz / parts
    for _ in range(parts):
        a, _ = wen_slope(h, n, factor, sign)
        b, _ = wen_slope(h + 0.5 * d * a, n, factor, sign)
        c, _ = wen_slope(h + 0.5 * d * b, n, factor, sign)
        f, _ = wen_slope(h + d * c, n, factor, sign)
        h += d * (a + 2.0 * b + 2.0 * c + f) / 6.0
    return h


@njit(cache=True, inline="always", error_model="numpy")
def law(code, z, e, p, el):  # pragma: no cover - compiled
    """Force against the motion in the element's mode, its slope to z, and the slope of that."""
    k, mode = p[e, 0], el[e, MODE]
    if code == 0:
        return k * z * z * z, 3.0 * k * z * z, 6.0 * k * z
    if code == 1:
        return k * z * z, 2.0 * k * z, 2.0 * k
    if code == 7:
        sign = el[e, SIGN]
        factor = p[e, 1] * mode * sign + p[e, 2]
        h = wen(z - el[e, PLACE], el[e, HELD], p[e, 3], factor, sign)
        slope, bent = wen_slope(h, p[e, 3], factor, sign)
        return k * h, k * slope, k * bent * slope
    if code == 6:
        return k * (z - el[e, PLACE]), k, 0.0
    if mode == 0.0:
        return 0.0, 0.0, 0.0
    return (k * (z - mode * p[e, 1]) if mode < 2.0 else k * z), k, 0.0


@njit(cache=True, inline="always", error_model="numpy")
def cubic(a, da, b, db, at):  # pragma: no cover - compiled
    """The cubic with these values and rates at 0 and 1."""
    s = at * at
    t = s * at
    return a * (1.0 - 3.0 * s + 2.0 * t) + da * (at - 2.0 * s + t) + b * (3.0 * s - 2.0 * t) + db * (t - s)


@njit(cache=True, inline="always", error_model="numpy")
def past(code, e, z, v, f, p, el):  # pragma: no cover - compiled
    """How far element e is beyond where its mode ends; negative within it. `f` is its force."""
    mode, level = el[e, MODE], p[e, 1]
    if code == TURNED:
        return el[e, SIGN] * f * np.sign(p[e, 0])
    if code == 2:
        return z - level if mode == 0.0 else level - z
    if code == 3:
        if mode == 0.0:
            return abs(z) - level
        return level - mode * z
    if mode != 0.0:
        return -mode * v
    if code == 4:
        return abs(f) - p[e, 0]
    return abs(p[e, 0] * (z - el[e, PLACE])) - level


@njit(cache=True, inline="always", error_model="numpy")
def changes(code, e, p, el):  # pragma: no cover - compiled
    """Whether element e has events at all."""
    if p[e, 0] == 0.0 or code < 2 or code == 5 or (code == 3 and el[e, MODE] == 2.0):
        return False
    return code != 6 or p[e, 1] > 0.0


@njit(cache=True, inline="always", error_model="numpy")
def dips(v0, v1, z0, z1, ell, way):  # pragma: no cover - compiled
    """Whether a speed that is `way` at both ends of a step turns within it."""
    a, b, middle = way * v0, way * v1, way * (1.5 * (z1 - z0) / ell - 0.25 * (v0 + v1))
    bend, slope = 2.0 * (a - 2.0 * middle + b), 4.0 * middle - 3.0 * a - b
    return bend > 0.0 and -2.0 * bend < slope < 0.0 and slope * slope > 4.0 * a * bend


@njit(cache=True, error_model="numpy")
def put(code, e, p, el):  # pragma: no cover - compiled
    """Force and rate of element e in its mode, at the motion where it is."""
    mode = el[e, MODE]
    if code == 4 or (code == 6 and mode != 0.0):
        el[e, FORCE], el[e, RATE] = -mode * p[e, code // 6], 0.0
        return
    if code == 5:
        el[e, FORCE] = -p[e, 0] * el[e, V] * abs(el[e, V])
        return
    value, slope, _ = law(code, el[e, Z], e, p, el)
    el[e, FORCE], el[e, RATE] = -value, -slope * el[e, W]


@njit(cache=True, error_model="numpy")
def turn(code, e, push, p, el):  # pragma: no cover - compiled
    """The next mode of element e; `push` is the force that would hold dry friction."""
    mode = el[e, MODE]
    if code == TURNED:
        el[e, SIGN] = -el[e, SIGN]
        return
    if code == 2:
        el[e, MODE] = 1.0 - mode
    elif code == 3:
        el[e, MODE] = 0.0 if mode != 0.0 else np.sign(el[e, Z])
    elif code == 4:
        if abs(push) <= p[e, 0]:
            el[e, MODE], el[e, PLACE] = 0.0, el[e, Z]
            return
        el[e, MODE] = -np.sign(push)
    elif code == 6:
        if mode == 0.0:
            el[e, MODE] = np.sign(p[e, 0] * (el[e, Z] - el[e, PLACE]))
        else:
            el[e, MODE], el[e, PLACE] = 0.0, el[e, Z] - mode * p[e, 1] / p[e, 0]
    else:
        el[e, MODE] = -mode
    put(code, e, p, el)
