"""Hysteresis (Bouc 1967, Wen 1976) over one step of a march, solved together with the force that it causes.

With h the yielding part of the motion z, dh/dz = 1 - (b sign(dz h) + 1 - b) |h / limit|^n up to b = 1, beyond which the
sign has 2 - b: the two factors have opposite signs there and are one together, loading stiffens from b = 1.5 on, and
the limit is where the way back is twice as stiff (the classes of Ismail, Ikhouane and Rodellar 2009). Within a step h
is taken at `lean` of the way: the middle where the step is short, its end where it is many limits long. In the middle
of such a step the rule would overshoot the limit by as much as it had been below it, and ring from step to step.
"""

from __future__ import annotations

import numpy as np
from numba import njit

ROUNDS = 60
"""Steps of the search for h, which is kept between bounds that close in."""
RUNAWAY = 1e3
"""Limits beyond which h is not followed where it stiffens without end."""
CLOSE, NEWTON = 1e-13, 1e-9
"""Change of h, of its size, with which the search ends; by Newton's method, whose next step would be its square."""


@njit(cache=True, inline="always")
def _lean(q):  # pragma: no cover - compiled
    """Where in the step h is taken, and the slope of that to q, the step in limits times n."""
    if q <= 1.0:
        return 0.5, 0.0
    return 1.0 - 0.5 / (q * q), 1.0 / (q * q * q)


@njit(cache=True, inline="always")
def _rate(step, h0, h, limit, n, share):  # pragma: no cover - compiled
    """dh/dz within the step, and its slopes to h0, h, step, limit, n and share; that to n without what the power itself
    makes of it, which `yields` alone asks for.
    """
    q = abs(step) * n / limit
    lean, grows = _lean(q)
    at = lean * h + (1.0 - lean) * h0
    s = 1.0 if step * at > 0 else -1.0
    turned = share > 1.0
    a = (2.0 - share if turned else share) * s + 1.0 - share
    size = abs(at) / limit
    power = size**n
    slope = (-a * n * power / size / limit) * (1.0 if at > 0 else -1.0) if size > 1e-300 else 0.0
    turn = slope * (h - h0) * grows
    to_step = turn * n / limit * (1.0 if step > 0 else -1.0)
    to_limit = a * n * power / limit - turn * q / limit
    to_share = (s + 1.0) * power if turned else (1.0 - s) * power
    return 1.0 - a * power, slope * (1.0 - lean), slope * lean, to_step, to_limit, turn * abs(step) / limit, to_share


@njit(cache=True)
def yielded(step, give, h0, limit, n, share):  # pragma: no cover - compiled
    """H at the end of a step of `step - give h`: `give` is what the force of h takes back of the motion, per h."""
    if not limit > 0.0:
        return 0.0
    high = 3.0 * max(limit, abs(h0))
    if share > 1.0:  # what stiffens may run away within a step, and from step to step
        high = min(max(high, 3.0 * abs(step)), RUNAWAY * limit)
    low, h = -high, h0
    for _ in range(ROUNDS):
        moved = step - give * h
        rate, _, to_h, to_step, _, _, _ = _rate(moved, h0, h, limit, n, share)
        gap = h - h0 - moved * rate
        if gap > 0.0:
            high = h
        else:
            low = h
        slope = 1.0 + give * (rate + moved * to_step) - moved * to_h
        new = h - gap / slope if slope > 0.0 else low
        close = slope > 0.0 and abs(new - h) <= NEWTON * (abs(h) + abs(h0))  # such a step may end on a bound
        if not (close or low < new < high):
            new = 0.5 * (low + high)
            close = abs(new - h) <= CLOSE * (abs(h) + abs(h0))
        h = new
        if close:
            break
    return h


@njit(cache=True)
def yields(step, h0, h, limit, n, share, d):  # pragma: no cover - compiled
    """Slopes of h at the end of a step to z, h0, limit, n and share, in d."""
    if not limit > 0.0:
        d[:] = 0.0
        return
    rate, to_h0, to_h, to_step, to_limit, to_n, to_share = _rate(step, h0, h, limit, n, share)
    lean, _ = _lean(abs(step) * n / limit)
    size = abs(lean * h + (1.0 - lean) * h0) / limit
    if size > 1e-12:
        to_n -= (1.0 - rate) * np.log(size)
    down = 1.0 / max(1.0 - step * to_h, 0.2)
    d[0] = (rate + step * to_step) * down
    d[1] = (1.0 + step * to_h0) * down
    d[2] = step * to_limit * down
    d[3] = step * to_n * down
    d[4] = step * to_share * down
