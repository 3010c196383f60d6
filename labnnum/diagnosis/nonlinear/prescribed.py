"""Forces of laws along a motion that is given, sample by sample: laws with memory, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from labnnum.compiled import up_to_date
from labnnum.diagnosis.nonlinear.force import HELD, count_of, law, odds_of
from labnnum.diagnosis.nonlinear.yielding import yielded


@njit(cache=True, nogil=True)
def _loop(z, p, turns):  # pragma: no cover - compiled
    """Opposing force of hysteresis along a prescribed motion (n,), by the rule of the march: it keeps to its limit."""
    n = z.size
    out = np.empty(n)
    limit, power, share = p[1], p[2], p[3]
    h, last = 0.0, z[0]
    if limit <= 0.0:
        out[:] = 0.0
        return out
    for _ in range(turns):
        for i in range(n):
            h = yielded(z[i] - last, 0.0, h, limit, power, share)
            last = z[i]
            out[i] = p[0] * h
    return out


@njit(cache=True, nogil=True)
def _slid(z, p, turns):  # pragma: no cover - compiled
    """Opposing force of a spring in series with a slider along a prescribed motion (n,)."""
    n = z.size
    out = np.empty(n)
    held, reach = z[0], p[1] / p[0] if p[0] > 0.0 else np.inf
    for _ in range(turns):
        for i in range(n):
            away = z[i] - held
            if away > reach:
                away = reach
                held = z[i] - reach
            elif away < -reach:
                away = -reach
                held = z[i] + reach
            out[i] = p[0] * away
    return out


@up_to_date
@njit(cache=True, nogil=True)
def along(code, z, v, p, turns):  # pragma: no cover - compiled
    """Opposing force of a law along a prescribed motion (n,), passed through `turns` times; that of the last pass."""
    if code == 7:
        return _loop(z, p, turns) - p[HELD] * p[0] * z
    if code == 6:
        return _slid(z, p, turns) - p[HELD] * p[0] * z
    if code == 9:
        out = np.zeros(z.size)
        one = np.empty(2)
        n = count_of(p)
        for i in range(n):
            one[0] = p[0] / n
            one[1] = p[1] / n * odds_of(i, p)
            out += _slid(z, one, turns)
        return out - p[HELD] * p[0] * z
    n = z.size
    out = np.empty(n)
    memory = np.zeros(2)
    memory[0] = z[0]
    lp = np.empty(10)
    d = np.empty(5)
    for _ in range(turns):
        for i in range(n):
            if code == 4:
                out[i] = p[0] * np.sign(v[i])
                continue
            value, _, _ = law(code, z[i], v[i], p, memory, lp, d)
            out[i] = value
    return out
