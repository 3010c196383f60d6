r"""Floquet multipliers of a periodic response: the linearised motion, memories of laws included, over one period.

A disturbance moves freely from sample to sample, exactly, in the modal coordinates of the structure; at each sample it
gets the impulse that the laws' linearised forces exert over a step (Strang's splitting). Impulses of springs are
symplectic and free motion damps as the structure does, so that the product of all multipliers is exact and no error of
phase is taken for damping. Beside displacements and speeds a disturbance has the memories of the laws:

- where a slider slips its spring's force does not change, and where it slid to follows; where it sticks, that stays;
- a hysteretic variable follows by the slopes of its own equation;
- where dry friction slides its force does not change; where it sticks no disturbance of the speed remains; and where
  the motion passes through rest, a disturbance of the speed changes as the acceleration does there, by the ratio of
  that after to that before (the saltation of a jump in the force; Aizerman and Gantmakher 1958).

Forces of sliders, stops and hysteresis are continuous, so that nothing jumps where they set in. Modes whose frequency
the samples do not resolve follow at rest. Structural damping is that of the time simulation: viscous, with the same
losses at each natural frequency.

References
----------
M. A. Aizerman, F. R. Gantmakher, "On the stability of periodic motions", J. Applied Mathematics and Mechanics 22, 1958.
G. Strang, "On the construction and comparison of difference schemes", SIAM J. Numerical Analysis 5, 1968.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import expm

from labnnum.compiled import up_to_date
from labnnum.errors import ModelError
from labnnum.harmonic.laws import MEMORY, RATE, Stretch, bent, closed, instant, slipping
from labnnum.simulation import Blocks, blocks
from labnnum.system import System, massless

RESOLVED = 16
"""Samples a period of the fastest mode that moves by itself."""


@final
class Stability:
    """Stability of periodic responses of a structure with laws at the motions of `laws`.

    Parameters
    ----------
    system : System
        Its M, C and K count.
    laws : sequence of Stretch

    Raises
    ------
    ModelError
        If a law of the speed acts on a motion without mass, or poles of the structure coincide.
    """

    def __init__(self, system: System, laws: Sequence[Stretch]) -> None:
        self.laws = tuple(laws)
        g = len(self.laws)
        columns = np.array([s.column for s in self.laws]).reshape(g, len(system.M))
        made, loose = _split(system, columns)
        self.made = made
        self.see, self.speed = made.out[:g], made.out[g:]
        self.loose = loose + made.feed[:g]
        rates = np.array([any(e.law in RATE for e in s.elements) for s in self.laws], bool)
        if made.feed[g:][rates].any() or (rates & (np.diag(self.loose) > 0)).any():
            raise ModelError("a nonlinear law of the speed acts on a coordinate without mass; give it a mass")
        self.memories = [
            (i, e) for i, s in enumerate(self.laws) for e in s.elements if e.law in MEMORY and e.parameters[0] > 0
        ]
        self.fastest = np.abs(np.linalg.eigvals(made.A)).max(axis=1)

    def multiplier(self, shape: NDArray, rate: NDArray, omega: float, motion: NDArray, time: NDArray) -> float:
        """Largest modulus of the multipliers of the response with harmonics `motion` (g, m) at omega in rad/s.

        `shape` and `rate` (n, m) are those of the balance, `time` (g, n) the forces.
        """
        if not self.laws:
            return float(np.exp(np.real(np.linalg.eigvals(self.made.A)).max() * 2 * np.pi / omega))
        return float(np.abs(np.linalg.eigvals(self.monodromy(shape, rate, omega, motion, time))).max(initial=0.0))

    def monodromy(
        self, shape: NDArray, rate: NDArray, omega: float, motion: NDArray, time: NDArray
    ) -> NDArray[np.float64]:
        """What a disturbance of the states, and of the memories after them, has become after a period."""
        n, g = len(shape), len(self.laws)
        step = 2 * np.pi / omega / n
        kept = self.fastest * step <= 2 * np.pi / RESOLVED
        if not kept.any():
            kept = self.fastest == self.fastest.min()
        A, B = self.made.A[kept], self.made.B[kept]
        states = np.repeat(kept, 2)
        see, speed = (np.ascontiguousarray(a[:, states]) for a in (self.see, self.speed))
        soft = self.loose.copy()
        for a, b, i in zip(self.made.A[~kept], self.made.B[~kept], np.flatnonzero(~kept), strict=True):
            soft -= self.see[:, 2 * i : 2 * i + 2] @ np.linalg.solve(a, b)
        load = np.ascontiguousarray(B.reshape(-1, g))
        z, v = motion @ shape.T, omega * (motion @ rate.T)
        stiff, loss = self._slopes(z, v, motion, shape, omega, rate)
        mass = speed @ load
        less = self._dry(v, time, mass, step)
        slip, forward, keep = self._led(z)
        where = np.array([i for i, _ in self.memories], np.int64)
        kind = np.array([MEMORY.index(e.law) for _, e in self.memories], np.int64)
        k = np.array([e.parameters[0] for _, e in self.memories])
        spring = stiff.copy()
        for j, i in enumerate(where[kind == 0]):
            spring[i] += k[kind == 0][j] * ~slip[kind == 0][j]
        one = np.eye(len(self.laws))
        first = np.linalg.inv(one + soft * spring[:, -1])
        for j, i in enumerate(where):
            spring[i] += k[j] * kind[j] * forward[j]
        give = np.linalg.inv(one + soft * spring.T[:, None, :])
        drag = np.linalg.inv(one + 0.5 * step * loss.T[:, :, None] * mass)
        free = np.asarray(expm(A * step), float).reshape(-1, 4)
        return _carry(
            free, load, see, speed, mass, first, give, drag, spring, loss, less, where, kind, k, slip, forward, keep,
            soft, step,
        )  # fmt: skip

    def _slopes(
        self, z: NDArray, v: NDArray, motion: NDArray, shape: NDArray, omega: float, rate: NDArray
    ) -> tuple[NDArray, NDArray]:
        """Slopes (g, n) of the forces of laws without memory to z, in the mean over each step, and to v."""
        n = z.shape[1]
        stiff, loss = np.zeros_like(z), np.zeros_like(z)
        middle = 0.5 * (z + np.roll(z, -1, axis=1))
        for i, s in enumerate(self.laws):
            after, before = middle[i], np.roll(middle[i], 1)
            across = after - before
            far = np.abs(across) > 1e-6 * np.abs(z[i]).max(initial=0.0)
            for e in s.elements:
                if e.law in MEMORY or e.law == "coulomb":
                    continue
                _, to_z, to_v = instant(e.law, e.parameters, z[i], v[i])
                if e.law not in RATE:
                    up, down = (instant(e.law, e.parameters, at, np.zeros(n))[0] for at in (after, before))
                    to_z = np.where(far, (up - down) / np.where(far, across, 1.0), to_z)
                stiff[i] += to_z
                loss[i] += to_v
        return stiff, loss

    def _dry(self, v: NDArray, time: NDArray, mass: NDArray, step: float) -> NDArray[np.float64]:
        """Part of a disturbance of the speeds v (g, n) that dry friction takes: all where it holds; where the motion
        turns without holding, what the jump of the acceleration says.
        """
        less = np.zeros(v.shape)
        n = v.shape[1]
        wide = max(n // 128, 2)
        for i, s in enumerate(self.laws):
            if not s.dry or s.friction == 0.0:
                continue
            inside = np.abs(time[i]) < s.friction * (1 - 1e-9)
            if inside.all():
                less[i] = 1.0
                continue
            jump = s.friction * mass[i, i]
            slope = np.abs(np.roll(v[i], -wide) - np.roll(v[i], wide)) / (2 * wide * step)
            passing = (v[i] * np.roll(v[i], -1) < 0) & (slope > jump)
            less[i, passing] = 2 * jump / (slope[passing] + jump)
            for first, length in _runs(inside):
                index = (first - wide + np.arange(length + 2 * wide)) % n
                if not passing[index].any():
                    less[i, index[wide:-wide]] = 1.0
        return less

    def _led(self, z: NDArray) -> tuple[NDArray[np.bool_], NDArray, NDArray]:
        """Of each memory at each sample: whether a slider slips; a hysteretic variable's slopes to step and past."""
        count, n = len(self.memories), z.shape[1]
        slip, forward, keep = np.zeros((count, n), bool), np.zeros((count, n)), np.zeros((count, n))
        for j, (i, e) in enumerate(self.memories):
            if e.law == "jenkins":
                slip[j] = slipping(z[i], *e.parameters)
            else:
                _bends(z[i], np.array(e.parameters), forward[j], keep[j])
        return slip, forward, keep


def _split(system: System, columns: NDArray) -> tuple[Blocks, NDArray[np.float64]]:
    """The structure with the laws' forces as inputs, their motions and speeds as outputs, in independent pairs of
    states; and the flexibility (g, g) of coordinates that have stiffness only, which follow at once.
    """
    M, C, K = system.M, system.C, system.K
    light = massless(M)
    static = light & ~np.any(C != 0, axis=1)
    loose = np.zeros((len(columns), len(columns)))
    if static.any():
        keep = ~static
        inner = K[np.ix_(static, static)]
        try:
            tie = -np.linalg.solve(inner, K[np.ix_(static, keep)])
            loose = columns[:, static] @ np.linalg.solve(inner, columns[:, static].T)
        except np.linalg.LinAlgError:
            raise ModelError("a coordinate without mass is held by nothing; fix or remove it") from None
        K = K[np.ix_(keep, keep)] + K[np.ix_(keep, static)] @ tie
        M, C = M[np.ix_(keep, keep)], C[np.ix_(keep, keep)]
        columns = columns[:, keep] + columns[:, static] @ tie
    none = np.zeros_like(columns)
    rows = np.vstack([columns, none]), np.vstack([none, columns])
    feed = np.zeros((2 * len(columns), len(columns)))
    return blocks(System(M, C, K, columns.T, *rows, np.zeros_like(rows[0]), feed)), loose


def _runs(inside: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First sample and length of each run of a periodic sequence that is not all of it."""
    first = np.flatnonzero(inside & ~np.roll(inside, 1))
    ends = np.flatnonzero(~inside & np.roll(inside, 1))
    n = inside.size
    return [(int(a), int(min((b - a) % n for b in ends))) for a in first]


@up_to_date
@njit(cache=True)
def _bends(z, p, forward, keep):  # pragma: no cover - compiled
    """Slopes of a hysteretic variable, step by step, around its closed loop."""
    h, _ = closed(z, p)
    last = z[-1]
    d = np.empty(2)
    for i in range(z.size):
        h = bent(z[i] - last, h, p, d)
        last = z[i]
        forward[i], keep[i] = d[0], d[1]


@njit(cache=True)
def _times(a, x, out):  # pragma: no cover - compiled
    """The product of a (r, k) and x (k, q), in out."""
    for i in range(a.shape[0]):
        for q in range(x.shape[1]):
            out[i, q] = 0.0
        for k in range(a.shape[1]):
            one = a[i, k]
            if one != 0.0:
                for q in range(x.shape[1]):
                    out[i, q] += one * x[k, q]


@njit(cache=True)
def _carry(
    free, load, see, speed, mass, first, give, drag, spring, loss, less, where, kind, k, slip, forward, keep, soft, step
):  # pragma: no cover - compiled
    """The monodromy matrix over states (2 b), then memories (c).

    `spring`, `loss`, `less` (g, n) are the slopes of the forces to motion and speed, and the part of the speed that dry
    friction takes; `give` (n, g, g), of the beginning `first`, solves for motions that
    the forces change at once, and `drag` for speeds.
    """
    blocks, g, n, c = free.shape[0], spring.shape[0], spring.shape[1], where.size
    states = 2 * blocks
    size = states + c
    x, memory = np.zeros((states, size)), np.zeros((c, size))
    for i in range(states):
        x[i, i] = 1.0
    for j in range(c):
        memory[j, states + j] = 1.0
    moved, given, now, raw = np.zeros((g, size)), np.zeros((g, size)), np.zeros((g, size)), np.zeros((g, size))
    rates, force = np.zeros((g, size)), np.zeros((g, size))
    for i in range(-1, n):
        at = i if i >= 0 else n - 1
        if i >= 0:
            for b in range(blocks):
                for q in range(size):
                    one, two = x[2 * b, q], x[2 * b + 1, q]
                    x[2 * b, q] = free[b, 0] * one + free[b, 1] * two
                    x[2 * b + 1, q] = free[b, 2] * one + free[b, 3] * two
        for e in range(g):  # force = spring * motion + given, with what the memories were
            for q in range(size):
                given[e, q] = 0.0
        for j in range(c):
            e = where[j]
            for q in range(size):
                if kind[j] == 0:
                    if not slip[j, at]:
                        given[e, q] -= k[j] * memory[j, q]
                elif i < 0:  # the variable is one of the states that the period begins with
                    given[e, q] += k[j] * memory[j, q]
                else:
                    given[e, q] += k[j] * (keep[j, at] * memory[j, q] - forward[j, at] * moved[e, q])
        _times(see, x, raw)
        if soft.any():
            _times(soft, given, force)
            for e in range(g):
                for q in range(size):
                    raw[e, q] -= force[e, q]
        _times(first if i < 0 else give[at], raw, now)
        for j in range(c):
            e = where[j]
            for q in range(size):
                if kind[j] == 0:
                    if slip[j, at]:
                        memory[j, q] = now[e, q]
                elif i >= 0:
                    memory[j, q] = keep[j, at] * memory[j, q] + forward[j, at] * (now[e, q] - moved[e, q])
        for e in range(g):
            for q in range(size):
                moved[e, q] = now[e, q]
        if i < 0:
            continue
        _times(speed, x, rates)
        for e in range(g):
            for q in range(size):
                raw[e, q] = given[e, q] + spring[e, at] * now[e, q] + loss[e, at] * rates[e, q]
        _times(drag[at], raw, force)
        for a in range(states):
            for e in range(g):
                one = step * load[a, e]
                if one != 0.0:
                    for q in range(size):
                        x[a, q] -= one * force[e, q]
        for e in range(g):
            if less[e, at] != 0.0 and mass[e, e] > 0.0:
                _times(speed, x, rates)
                for a in range(states):
                    one = load[a, e] * less[e, at] / mass[e, e]
                    for q in range(size):
                        x[a, q] -= one * rates[e, q]
    out = np.empty((size, size))
    out[:states] = x
    out[states:] = memory
    return out
