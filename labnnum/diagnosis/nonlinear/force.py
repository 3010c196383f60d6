"""Laws as they are marched: the force that each makes at the end of a step, and its slopes."""

from __future__ import annotations

from collections.abc import Iterable

from numba import njit

from labnnum.compiled import up_to_date
from labnnum.diagnosis.nonlinear.yielding import yielded, yields
from labnnum.mechanisms.stick_slip import SLIDERS

LAWS: dict[str, tuple[str, ...]] = {
    "cubic": ("k3",),
    "quadratic": ("k2",),
    "one-sided-gap": ("k", "g"),
    "clearance": ("k", "g"),
    "coulomb": ("F",),
    "quadratic-damping": ("c2",),
    "stick-slip": ("k_t", "F_s"),
    "hysteresis": ("k", "limit", "n", "beta_share"),
    "general": tuple(f"c{i}" for i in range(10)),
    "sliders": ("k_t", "F_s", "spread"),
}
"""Laws and their parameters; z is the motion, v its rate, the force opposes:

- cubic k3 z^3; quadratic k2 z^2; one-sided-gap k max(z - g, 0); clearance k beyond +-g; coulomb F sign(v);
  quadratic-damping c2 v |v|; stick-slip: a spring k_t in series with a slider that yields at F_s
- hysteresis: k h, dh/dz = 1 - (b sign(v h) + 1 - b) |h / limit|^n, with 2 - b at the sign where b is over 1
- general: a smooth law without memory; see `labnnum.diagnosis.nonlinear.laws.general_basis`
- sliders: sliders on equal springs side by side, k_t and F_s of all together, whose limits are spread evenly over the
  mean one times 1 - spread to 1 + spread (Iwan 1966); a fourth number, which no fit moves, says how many they are, and
  zero stands for `SLIDERS`
"""

CODES = {name: code for code, name in enumerate(LAWS)}
N_P = 10
"""Room for the parameters of any law."""
HELD = 4
"""Number that laws which yield have besides, and no fit moves: the part of their spring k or k_t that the structure
holds already, 0 or 1. With 1 they act as what they are less that spring: nothing while they stick."""
TOLD = 5
"""Whether a file says so, or that it holds none: then it is not asked what kind of structure it is."""
YIELDING = ("stick-slip", "hysteresis", "sliders")
"""Laws that have it, of which one contains another: a slider with a spring, many of them, its corners rounded. Dry
friction beside one of them is a second slider, that has no spring."""


def remembered(codes: Iterable[int]) -> int:
    """Numbers of memory that each of these laws has room for."""
    return max(2, SLIDERS if CODES["sliders"] in codes else 2)


@njit(cache=True, inline="always")
def count_of(p):  # pragma: no cover - compiled
    """How many sliders stand side by side."""
    return int(p[3]) if p[3] > 0.0 else SLIDERS


@njit(cache=True, inline="always")
def part_of(i, p):  # pragma: no cover - compiled
    """Where the limit of slider i lies in the spread, in the middle of its part of it, from -1 to 1."""
    n = count_of(p)
    return (2.0 * i + 1.0 - n) / n


@njit(cache=True, inline="always")
def odds_of(i, p):  # pragma: no cover - compiled
    """Limit of slider i, of the mean one."""
    return 1.0 + p[2] * part_of(i, p)


@njit(cache=True, inline="always")
def slips(i, z, p, memory):  # pragma: no cover - compiled
    """Whether slider i moves on the way to z."""
    return p[0] * abs(z - memory[i]) > p[1] * odds_of(i, p)


@njit(cache=True)
def _slide(z, p, memory, lp):  # pragma: no cover - compiled
    """Opposing force of sliders side by side that stood at `memory`, and its slope to z; `lp` as in `law`."""
    force, slope = 0.0, 0.0
    n = count_of(p)
    spring, mean = p[0] / n, p[1] / n
    rest = 1.0 - p[HELD]
    for i in range(n):
        odds = odds_of(i, p)
        trial, limit = spring * (z - memory[i]), mean * odds
        if abs(trial) > limit:
            s = 1.0 if trial > 0 else -1.0
            force += s * limit - p[HELD] * spring * z
            slope -= p[HELD] * spring
            lp[1] += s * odds / n
            lp[2] += s * mean * part_of(i, p)
        else:
            force += spring * (rest * z - memory[i])
            slope += spring * rest
            lp[0] += (z - memory[i]) / n
    lp[0] -= p[HELD] * z
    return force, slope


@njit(cache=True)
def hysteretic(z, p, memory, d):  # pragma: no cover - compiled
    """H at z from (z0, h0), and in d: dh/dz, dh/dh0, dh/dlimit, dh/dn, dh/dshare."""
    h = yielded(z - memory[0], 0.0, memory[1], p[1], p[2], p[3])
    yields(z - memory[0], memory[1], h, p[1], p[2], p[3], d)
    return h


@up_to_date
@njit(cache=True)
def law(code, z, v, p, memory, lp, d):  # pragma: no cover - compiled
    """Opposing force, its slopes to z and v; `lp` gets those to the parameters, `d` those that memory needs."""
    for i in range(4 if code != 8 else 10):
        lp[i] = 0.0
    if code == 0:
        lp[0] = z**3
        return p[0] * z**3, 3 * p[0] * z**2, 0.0
    if code == 1:
        lp[0] = z**2
        return p[0] * z**2, 2 * p[0] * z, 0.0
    if code == 2:
        if z > p[1]:
            lp[0] = z - p[1]
            lp[1] = -p[0]
            return p[0] * (z - p[1]), p[0], 0.0
        return 0.0, 0.0, 0.0
    if code == 3:
        if abs(z) > p[1]:
            s = 1.0 if z > 0 else -1.0
            lp[0] = z - s * p[1]
            lp[1] = -s * p[0]
            return p[0] * (z - s * p[1]), p[0], 0.0
        return 0.0, 0.0, 0.0
    if code == 5:
        lp[0] = v * abs(v)
        return p[0] * v * abs(v), 0.0, 2 * p[0] * abs(v)
    if code == 6:
        trial = p[0] * (z - memory[0])
        spring = p[HELD] * p[0]
        lp[0] = -p[HELD] * z
        if abs(trial) > p[1]:
            s = 1.0 if trial > 0 else -1.0
            lp[1] = s
            return s * p[1] - spring * z, -spring, 0.0
        lp[0] += z - memory[0]
        rest = 1.0 - p[HELD]
        return p[0] * (rest * z - memory[0]), p[0] * rest, 0.0
    if code == 7:
        h = hysteretic(z, p, memory, d)
        lp[0] = h - p[HELD] * z
        lp[1] = p[0] * d[2]
        lp[2] = p[0] * d[3]
        lp[3] = p[0] * d[4]
        return p[0] * lp[0], p[0] * (d[0] - p[HELD]), 0.0
    if code == 9:
        force, slope = _slide(z, p, memory, lp)
        return force, slope, 0.0
    az, av = abs(z), abs(v)
    lp[0] = z * az
    lp[1] = z * z
    lp[2] = z**3
    lp[3] = z**5
    lp[4] = v * av
    lp[5] = v**3
    lp[6] = z * z * v
    lp[7] = az * v
    lp[8] = z * v
    lp[9] = v * v * z
    f = 0.0
    for i in range(10):
        f += p[i] * lp[i]
    fz = (
        p[0] * 2 * az + p[1] * 2 * z + p[2] * 3 * z * z + p[3] * 5 * z**4
        + p[6] * 2 * z * v + p[7] * (v if z > 0 else -v) + p[8] * v + p[9] * v * v
    )  # fmt: skip
    fv = p[4] * 2 * av + p[5] * 3 * v * v + p[6] * z * z + p[7] * az + p[8] * z + p[9] * 2 * v * z
    return f, fz, fv


@njit(cache=True)
def place_held(v, gv, f, memory, step, d):  # pragma: no cover - compiled
    """Where dry friction holds from a step on: where it stood, or turned within the step if it slid with the force f
    and then at the speed `memory[1]`; v is the speed at the end without it. In d: slopes of that to both speeds.
    """
    before, after = memory[1], v + gv * f
    d[0] = d[1] = 0.0
    if before * f >= 0.0 or before * after >= 0.0:
        return memory[0]
    fall = before - after
    d[0] = 0.5 * step * before * (before - 2.0 * after) / fall**2
    d[1] = 0.5 * step * before**2 / fall**2
    return memory[0] + 0.5 * step * before**2 / fall
