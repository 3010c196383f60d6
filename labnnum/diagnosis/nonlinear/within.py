"""The force of a law at the end of one step, from a formula where there is one.

A step leaves the motion z and the speed v at a place but for what the force of the step itself does: z + gz f and
v + gv f. Forces that are straight in pieces, or powers, are solved for at once; the others by Newton's method. Numbers
are handed on one by one: an array that is handed on in a step costs more than its force.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from labnnum.diagnosis.nonlinear.force import HELD, SLIDERS
from labnnum.diagnosis.nonlinear.yielding import yielded
from labnnum.nonlinear import part_of_limit

FLAT = 0.05
"""Slope of what a force leaves of its own motion below which Newton's method, which goes on with that, is asked."""
PLAIN = 12
"""Steps of Newton's method to a force, after which those that leave what it was found to lie between are replaced."""
ROUNDING = 1e-15
"""What numbers tell of motion and speed: of a stiff law most of both is taken back by its force."""
CLOSE, ROUNDS = 1e-12, 60
"""Change of a force, of its size, with which a search ends; and its steps at most."""


@njit(cache=True, inline="always")
def beyond(z, gz, k, gap):  # pragma: no cover - compiled
    """Force of a spring k beyond `gap` of the motion z, which gives way; z beyond it."""
    return -k * (z - gap) / (1.0 + k * gz)


@njit(cache=True)
def cubed(z, gz, k):  # pragma: no cover - compiled
    """Force of a hardening cubic spring: of y + gz k y^3 = |z| Newton's method comes down to the root from above."""
    size, g = abs(z), gz * k
    y = size
    if g * size * size > 1.0:
        y = np.cbrt(size / g)
    for _ in range(ROUNDS):
        step = (y + g * y * y * y - size) / (1.0 + 3.0 * g * y * y)
        y -= step
        if step <= 1e-15 * y:
            break
    f = k * y * y * y
    return -f if z > 0.0 else f


@njit(cache=True, inline="always")
def root(size, g):  # pragma: no cover - compiled
    """The y of y + g y^2 = size that is nearest to it; 1 + 4 g size is positive."""
    return 2.0 * size / (1.0 + np.sqrt(1.0 + 4.0 * g * size))


@njit(cache=True, inline="always")
def seat(v, gv, slid, place, before, stride):  # pragma: no cover - compiled
    """Where dry friction holds from a step on, as `force.place_held`."""
    after = v + gv * slid
    if before * slid < 0.0 and before * after < 0.0:
        place = place + 0.5 * stride * before * before / (before - after)
    return place


@njit(cache=True)
def many(z, gz, e, p, memory, guess):  # pragma: no cover - compiled
    """Force of sliders side by side: straight in pieces, of which Newton's method passes a few."""
    n = int(p[e, 3]) if p[e, 3] > 0.0 else SLIDERS
    spring, mean, spread, held = p[e, 0] / n, p[e, 1] / n, p[e, 2], p[e, HELD] * p[e, 0]
    f = guess
    for _ in range(ROUNDS):
        at = z + gz * f
        force, slope = -held * at, -held
        for i in range(n):
            trial, limit = spring * (at - memory[e, i]), mean * (1.0 + spread * (2.0 * i + 1.0 - n) / n)
            if trial > limit:
                force += limit
            elif trial < -limit:
                force -= limit
            else:
                force += trial
                slope += spring
        change = -(f + force) / max(1.0 + slope * gz, FLAT)
        f += change
        if abs(change) <= CLOSE * abs(f):
            break
    return f


@njit(cache=True, inline="always")
def _simple(code, z, v, k, gap, place, held):  # pragma: no cover - compiled
    """Force against the motion of a law that is straight in pieces or a power, and its slopes to z and v."""
    if code == 0:
        return k * z * z * z, 3.0 * k * z * z, 0.0
    if code == 1:
        return k * z * z, 2.0 * k * z, 0.0
    if code == 5:
        return k * v * abs(v), 0.0, 2.0 * k * abs(v)
    if code == 6:
        trial = k * (z - place)
        if abs(trial) > gap:
            return (gap if trial > 0.0 else -gap) - held * z, -held, 0.0
        return trial - held * z, k - held, 0.0
    if z > gap:
        return k * (z - gap), k, 0.0
    if code == 3 and z < -gap:
        return k * (z + gap), k, 0.0
    return 0.0, 0.0, 0.0


@njit(cache=True)
def sought(code, z, v, gz, gv, guess, k, gap, place, held):  # pragma: no cover - compiled
    """The force by Newton's method, between bounds once it goes in circles: of a law that pushes, mostly."""
    f, low, high = guess, -np.inf, np.inf
    for i in range(ROUNDS):
        value, dz, dv = _simple(code, z + gz * f, v + gv * f, k, gap, place, held)
        if abs(f + value) <= ROUNDING * (abs(dz * z) + abs(dv * v)):
            break
        change = -(f + value) / max(1.0 + dz * gz + dv * gv, FLAT)
        if change > 0.0:
            low = max(low, f)
        else:
            high = min(high, f)
        change = _bounded(change, f, low, high, i)
        f += change
        if abs(change) <= CLOSE * abs(f):
            break
    return f


@njit(cache=True, inline="always")
def _bounded(change, f, low, high, i):  # pragma: no cover - compiled
    if i > PLAIN and low < high:
        if not low < f + change < high and high - low < np.inf:
            return 0.5 * (low + high) - f
        return change
    return 0.5 * change if i > 20 else change


@njit(cache=True)
def general(z, v, gz, gv, guess, a, b, c, d, e, g, h, i, j, k):  # pragma: no cover - compiled
    """The same of the general law with its ten coefficients."""
    f, low, high = guess, -np.inf, np.inf
    for n in range(ROUNDS):
        x, y = z + gz * f, v + gv * f
        ax, ay, xx, yy = abs(x), abs(y), x * x, y * y
        value = a * x * ax + b * xx + c * xx * x + d * xx * xx * x + e * y * ay + g * yy * y
        value += h * xx * y + i * ax * y + j * x * y + k * yy * x
        dz = 2.0 * (a * ax + b * x) + 3.0 * c * xx + 5.0 * d * xx * xx + 2.0 * h * x * y + j * y + k * yy
        dz += i * (y if x > 0.0 else -y)
        dv = 2.0 * e * ay + 3.0 * g * yy + h * xx + i * ax + j * x + 2.0 * k * y * x
        if abs(f + value) <= ROUNDING * (abs(dz * z) + abs(dv * v)):
            break
        change = -(f + value) / max(1.0 + dz * gz + dv * gv, FLAT)
        if change > 0.0:
            low = max(low, f)
        else:
            high = min(high, f)
        change = _bounded(change, f, low, high, n)
        f += change
        if abs(change) <= CLOSE * abs(f):
            break
    return f


@njit(cache=True)
def _solved(code, z, v, gz, gv, seated, k, gap, n, share, held, place, before, last, guess, stride):
    # pragma: no cover - compiled
    """The same from the law's parameters and its memory, one by one."""
    if code == 2 or code == 3:
        if 1.0 + k * gz > FLAT:
            if z > gap:
                return beyond(z, gz, k, gap)
            return beyond(z, gz, k, -gap) if code == 3 and z < -gap else 0.0
    elif code == 6:
        taken = held * k
        if 1.0 - taken * gz > FLAT:
            rest = k - taken
            f = -(rest * z - k * place) / (1.0 + rest * gz)
            trial = k * (z + gz * f - place)
            if abs(trial) > gap:
                f = -((gap if trial > 0.0 else -gap) - taken * z) / (1.0 - taken * gz)
            return f
    elif code == 0:
        if k > 0.0 and gz >= 0.0:
            return cubed(z, gz, k)
    elif code == 1:
        if 1.0 + 4.0 * gz * k * z > FLAT * FLAT:
            y = root(z, gz * k)
            return -k * y * y
    elif code == 5:
        if 1.0 + 4.0 * gv * k * abs(v) > FLAT * FLAT:
            y = root(abs(v), gv * k)
            return -k * y * y if v > 0.0 else k * y * y
    elif code == 4:
        if not seated:
            return -k * part_of_limit(v, max(gv, 0.0) * k, place)
        slid = last if abs(last) >= k else 0.0
        return min(max((seat(v, gv, slid, place, before, stride) - z) / gz, -k), k)
    elif code == 7:
        more = 1.0 / max(1.0 - held * k * gz, 1e-9)  # what is taken off the spring moves the place on
        h = yielded(more * z - place, more * gz * k, before, gap, n, share)
        return -k * (h - held * more * (z - gz * k * h))
    return sought(code, z, v, gz, gv, guess, k, gap, place, held * k)


@njit(cache=True, inline="always")
def solved(code, e, z, v, gz, gv, seated, p, memory, last, guess, stride):  # pragma: no cover - compiled
    """Force f of law e on the structure at the end of a step, f = -law(z + gz f, v + gv f); p (k, N_P), memory (k, M).

    Dry friction that is `seated` holds a place, else it holds the speed. `last` is the force of the step before, and
    `guess` where a search begins; `stride` the step in time.
    """
    if code == 9:
        f = many(z, gz, e, p, memory, guess)
    elif code == 8:
        f = general(
            z, v, gz, gv, guess, p[e, 0], p[e, 1], p[e, 2], p[e, 3], p[e, 4], p[e, 5], p[e, 6], p[e, 7], p[e, 8],
            p[e, 9],
        )  # fmt: skip
    else:
        f = _solved(
            code, z, v, gz, gv, seated, p[e, 0], p[e, 1], p[e, 2], p[e, 3], p[e, HELD], memory[e, 0], memory[e, 1],
            last, guess, stride,
        )  # fmt: skip
    return f
