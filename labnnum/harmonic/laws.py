"""Forces of laws along a periodic motion, with their slopes to its harmonics (alternating frequency and time).

Sliders are led round twice, from rest: a slider that slips at all has then forgotten where it began, and one that never
slips stays unstrained where the motion is zero. Of hysteresis the beginning is sought from which its loop closes, by
Newton's method with the slope of the loop's end to its beginning. Dry friction is in `labnnum.harmonic.dry`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from labnnum.nonlinear import Element

MEMORY = ("jenkins", "bouc-wen")
RATE = ("coulomb", "quadratic-damping")
"""Laws of the speed."""
OPEN = 1e-10
"""How far the end of a hysteretic loop must follow its beginning less than wholly, to be told from a spring's."""


@final
@dataclass(frozen=True, eq=False)
class Stretch:
    """A motion `column` @ u with the laws that act on it, in the words of `labnnum.nonlinear`; dry friction has one of
    its own, whose limit is `friction`.
    """

    column: NDArray[np.float64]
    elements: tuple[Element, ...]
    friction: float = 0.0

    @property
    def dry(self) -> bool:
        """Whether it is dry friction."""
        return self.elements[0].law == "coulomb"

    @property
    def name(self) -> str:
        """Its laws, each once."""
        return " + ".join(dict.fromkeys(e.law for e in self.elements))


def stretches(elements: Sequence[Element], size: int) -> tuple[Stretch, ...]:
    """The elements by the motions that they act on, columns over all `size` coordinates."""
    found: dict[bytes, list[Element]] = {}
    columns: dict[bytes, NDArray] = {}
    out = []
    for e in elements:
        column = np.zeros(size)
        column[: e.column.size] = e.column
        if e.law == "coulomb":
            out.append(Stretch(column, (e,), e.parameters[0]))
            continue
        key = (column + 0.0).tobytes()
        columns[key] = column
        found.setdefault(key, []).append(e)
    return (*(Stretch(columns[k], tuple(v)) for k, v in found.items()), *out)


def instant(law: str, p: Sequence[float], z: NDArray, v: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Opposing force of a law without memory, and its slopes to z and v, each of the shape of z."""
    none = np.zeros_like(z)
    if law == "cubic":
        return p[0] * z**3, 3 * p[0] * z**2, none
    if law == "quadratic":
        return p[0] * z**2, 2 * p[0] * z, none
    if law == "one-sided-gap":
        on = z > p[1]
        return np.where(on, p[0] * (z - p[1]), 0.0), np.where(on, p[0], 0.0), none
    if law == "clearance":
        on = np.abs(z) >= p[1]
        return np.where(on, p[0] * (z - np.sign(z) * p[1]), 0.0), np.where(on, p[0], 0.0), none
    assert law == "quadratic-damping"
    return p[0] * v * np.abs(v), none, 2 * p[0] * np.abs(v)


def force(
    s: Stretch, z: NDArray, v: NDArray, shape: NDArray, omega_rate: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Opposing force (n,) of the laws of a stretch along z, v (n,); d f / d harmonics (n, m); slope to v (n,).

    `shape` and `omega_rate`, (n, m), are the motion and its rate per harmonic. Not for dry friction.
    """
    f, to_z, to_v = np.zeros_like(z), np.zeros_like(z), np.zeros_like(z)
    led = np.zeros_like(shape)
    for e in s.elements:
        if e.law == "jenkins":
            slider(z, shape, e.parameters[0], e.parameters[1], f, led)
        elif e.law == "bouc-wen":
            loop(z, shape, np.array(e.parameters), f, led)
        else:
            one, a, b = instant(e.law, e.parameters, z, v)
            f, to_z, to_v = f + one, to_z + a, to_v + b
    led += to_z[:, None] * shape + to_v[:, None] * omega_rate
    return f, led, to_v


@njit(cache=True)
def slider(z, shape, k, limit, f, led):  # pragma: no cover - compiled
    """Add to f (n,) and led (n, m) the force of a slider behind a spring and its slopes to the harmonics."""
    if k <= 0.0:
        return
    n, m = shape.shape
    held, reach = 0.0, limit / k
    moved = np.zeros(m)
    for turn in range(2):
        for i in range(n):
            away = z[i] - held
            if abs(away) >= reach:
                away = reach if away > 0.0 else -reach
                held = z[i] - away
                moved[:] = shape[i]
            if turn == 1:
                f[i] += k * away
                for j in range(m):
                    led[i, j] += k * (shape[i, j] - moved[j])


@njit(cache=True)
def slipping(z, k, limit):  # pragma: no cover - compiled
    """Whether a slider slips at each sample (n,), once it has been led round."""
    out = np.zeros(z.size, np.bool_)
    if k <= 0.0:
        return out
    held, reach = 0.0, limit / k
    for _ in range(2):
        for i in range(z.size):
            away = z[i] - held
            out[i] = abs(away) >= reach
            if out[i]:
                held = z[i] - (reach if away > 0.0 else -reach)
    return out


@njit(cache=True)
def bent(dz, h, p, d):  # pragma: no cover - compiled
    """The hysteretic variable after a motion dz from h; in d its slopes to dz and h.

    dh/dz = 1 - (beta sign(dz h) + gamma) |h|^n, by the classical rule of Runge and Kutta, in as many parts as keep each
    short against the limit.
    """
    beta, gamma, n = p[1], p[2], p[3]
    d[0], d[1] = 0.0, 1.0
    if dz == 0.0:
        d[0] = 1.0 - gamma * abs(h) ** n if h != 0.0 else 1.0
        return h
    size = abs(beta + gamma)
    reach = size ** (1.0 / n) * n * abs(dz)
    parts = int(min(1.0 + 4.0 * reach, 1000.0))
    step, s = dz / parts, 1.0 if dz > 0.0 else -1.0
    weight = (1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6)
    ahead = (0.0, 0.5, 0.5, 1.0)
    for _ in range(parts):
        rate, to_h, to_step = 0.0, 0.0, 0.0
        total, total_h, total_step = 0.0, 0.0, 0.0
        for stage in range(4):
            a = ahead[stage] * step
            at = h + a * rate
            at_h, at_step = 1.0 + a * to_h, ahead[stage] * rate + a * to_step
            turn = 1.0 if at * s > 0.0 else -1.0
            rate, slope = 1.0, 0.0
            if at != 0.0:
                power = abs(at) ** n
                rate = 1.0 - (beta * turn + gamma) * power
                slope = -(beta * turn + gamma) * n * power / at
            to_h, to_step = slope * at_h, slope * at_step
            total += weight[stage] * rate
            total_h += weight[stage] * to_h
            total_step += weight[stage] * to_step
        h += step * total
        to_dz = total + step * total_step
        grown = 1.0 + step * total_h
        d[0] = grown * d[0] + to_dz / parts
        d[1] *= grown
    return h


@njit(cache=True)
def closed(z, p):  # pragma: no cover - compiled
    """Where a hysteretic loop that closes stands at the last sample of a motion (n,); its end's slope to that."""
    d = np.empty(2)
    h0 = bent(z[-1], 0.0, p, d)
    follows = 1.0
    for _ in range(60):
        h, last, follows = h0, z[-1], 1.0
        for i in range(z.size):
            h = bent(z[i] - last, h, p, d)
            last = z[i]
            follows *= d[1]
        gap = h - h0
        if not np.isfinite(h) or abs(1.0 - follows) < OPEN or abs(gap) <= 1e-13 * (abs(h) + abs(h0)):
            break
        h0 += gap / (1.0 - follows) if follows < 1.0 else gap
    return h0, follows


@njit(cache=True)
def loop(z, shape, p, f, led):  # pragma: no cover - compiled
    """Add to f (n,) and led (n, m) the force of hysteresis whose loop closes, and its slopes to the harmonics."""
    n, m = shape.shape
    h0, follows = closed(z, p)
    d, moved = np.empty(2), np.zeros(m)
    if abs(1.0 - follows) < OPEN:
        moved[:] = shape[n - 1]
    for turn in range(2):
        h, last = h0, n - 1
        for i in range(n):
            h = bent(z[i] - z[last], h, p, d)
            for j in range(m):
                moved[j] = d[1] * moved[j] + d[0] * (shape[i, j] - shape[last, j])
            last = i
            if turn == 1:
                f[i] += p[0] * h
                for j in range(m):
                    led[i, j] += p[0] * moved[j]
        if turn == 0 and abs(1.0 - follows) >= OPEN:
            moved /= 1.0 - follows
