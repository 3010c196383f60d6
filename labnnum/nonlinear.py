r"""Nonlinear elements in time simulation: few springs, gaps, dampers and sliders on an otherwise linear structure.

The linear structure keeps its exact march (see `labnnum.simulation`); each element's force enters as one more input
that is straight between steps and solved for at the end of each step, element by element until none changes
(Gauss and Seidel). Laws with memory carry a state. Dry friction is solved as what it is, a force within bounds that
holds the velocity at zero if it can (Moreau 1988), not smoothed; a jump within a step counts where it comes. With
its parameters at zero an element exerts exactly nothing.

References
----------
J. J. Moreau, "Unilateral contact and dry friction in finite freedom dynamics", CISM 302, 1988.
W. D. Iwan, "A distributed-element model for hysteresis", J. Applied Mechanics 33, 1966.
Y. K. Wen, "Method for random vibration of hysteretic systems", J. Engineering Mechanics 102, 1976.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError, ModelError
from labnnum.simulation import Blocks, blocks, hold_weights
from labnnum.system import System

LAWS: dict[str, tuple[str, ...]] = {
    "cubic": ("k3",),
    "quadratic": ("k2",),
    "one-sided-gap": ("k", "gap"),
    "clearance": ("k", "gap"),
    "coulomb": ("force",),
    "quadratic-damping": ("c2",),
    "jenkins": ("k", "force"),
    "bouc-wen": ("k", "beta", "gamma", "n"),
}
"""Laws and their parameters, SI units; z is the relative displacement, v its rate:

- cubic: k3 z^3; quadratic: k2 z^2; one-sided-gap: k max(z - gap, 0); clearance: k beyond +-gap
- coulomb: force sign(v); quadratic-damping: c2 v |v|
- jenkins: a spring k in series with a slider that yields at `force`
- bouc-wen: k h, with dh/dz = 1 - (beta sign(v h) + gamma) |h|^n
"""

_CODES = {name: code for code, name in enumerate(LAWS)}


@dataclass(frozen=True, eq=False)
class Element:
    """One nonlinear force on the motion `column` @ u, opposing it.

    Parameters
    ----------
    law : str
        A key of `LAWS`.
    column : ndarray, shape (n,)
        In the structure's coordinates.
    parameters : sequence of float
        In the order of `LAWS`.
    """

    law: str
    column: NDArray[np.float64]
    parameters: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            raise ModelError(f"nonlinear law {self.law!r} is not one of {', '.join(LAWS)}")
        names = LAWS[self.law]
        if len(self.parameters) != len(names):
            raise ModelError(f"nonlinear law {self.law!r} has the parameters {', '.join(names)}")


@final
class NonlinearSimulation:
    """March a structure with nonlinear elements through time in pieces, like `labnnum.simulation.Simulation`.

    Parameters
    ----------
    system : System
    elements : sequence of Element
        Columns may be shorter than the system's coordinates: those that exciters add come last.
    step : float
        s between samples of the inputs; short against what the elements do, for their kinks are not searched for.
    order : int
        Samples that the polynomial of the inputs passes through (even).

    Examples
    --------
    A mass on a cubic spring alone, pushed by a constant force, comes to swing about where the spring holds it:

    >>> one, zero = np.ones((1, 1)), np.zeros((1, 1))
    >>> mass = System(one, 2.0 * one, zero, one, one, zero, zero, zero)
    >>> march = NonlinearSimulation(mass, [Element("cubic", np.ones(1), (1.0,))], 0.01)
    >>> round(float(march.run(np.full((1, 8000), 8.0))[0, -1]), 6)
    2.0
    """

    def __init__(self, system: System, elements: Sequence[Element], step: float, order: int = 8) -> None:
        if order < 2 or order % 2:
            raise EstimationError(f"the order of the input hold must be even and at least 2, not {order}")
        self.system, self.elements, self.step, self.order = system, tuple(elements), step, order
        made = blocks(_with_elements(system, self.elements))
        n_in, n_out, k = system.n_inputs, system.n_outputs, len(self.elements)
        self._require_held(made, n_in, n_out)
        m = len(made.A)
        transition, weight = hold_weights(made.A, made.B[:, :, :n_in], step, order)
        _, straight = hold_weights(made.A, made.B[:, :, n_in:], step, 2)
        self._T = np.ascontiguousarray(transition.reshape(m, 4).T)
        self._W = np.ascontiguousarray(weight.transpose(2, 3, 1, 0))
        out = made.out.reshape(-1, m, 2).transpose(0, 2, 1).reshape(-1, 2 * m)
        self._out, self._feed = np.ascontiguousarray(out[:n_out]), made.feed[:n_out]
        self._see = np.ascontiguousarray(out[n_out:])
        before, after = (straight[..., j].transpose(1, 0, 2).reshape(2 * m, k) for j in (0, 1))
        self._before, self._after = np.ascontiguousarray(before), np.ascontiguousarray(after)
        self._gain = np.ascontiguousarray(self._see @ after)
        self._codes = np.array([_CODES[e.law] for e in self.elements], np.int64)
        self._parameters = np.zeros((k, 4))
        for row, e in zip(self._parameters, self.elements, strict=True):
            row[: len(e.parameters)] = e.parameters
        self.reset()

    def _require_held(self, made: Blocks, n_in: int, n_out: int) -> None:
        if made.feed[n_out:, n_in:].any():
            raise ModelError("a nonlinear element acts on a coordinate without mass; give it a mass")

    def reset(self) -> None:
        """Back to rest at time 0, sliders unstrained."""
        self._x = np.zeros(self._out.shape[1])
        self._force = np.zeros(len(self.elements))
        self._memory = np.zeros((len(self.elements), 2))
        self._ahead = np.zeros((self.system.n_inputs, self.order // 2 - 1))

    @property
    def delay(self) -> int:
        """Samples by which outputs lag behind the inputs that were handed over."""
        return self.order // 2

    def run(self, inputs: ArrayLike) -> NDArray[np.float64]:
        """Outputs that can be computed so far, shape (n_out, n).

        Raises
        ------
        ModelError
            If the elements' forces do not settle within a step: shorten it.
        """
        f = np.hstack([self._ahead, np.asarray(inputs, float)])
        n = f.shape[1] - self.order + 1
        if n <= 0:
            self._ahead = f
            return np.zeros((self.system.n_outputs, 0))
        states, forces = np.empty((n, self._x.size)), np.empty((n, self._force.size))
        bad = _march(
            self._T, self._W, self._x, f, states, forces, self._see, self._before, self._after, self._gain,
            self._codes, self._parameters, self._memory, self._force,
        )  # fmt: skip
        if bad:
            raise ModelError(
                f"the nonlinear forces do not settle within a step of {self.step:.3g} s: raise the oversampling"
            )
        at, n_in = self.order // 2 - 1, self.system.n_inputs
        out = self._out @ states.T
        out += self._feed[:, :n_in] @ f[:, at : at + n]
        out += self._feed[:, n_in:] @ forces.T
        self._ahead = f[:, n:]
        return out


def _with_elements(system: System, elements: Sequence[Element]) -> System:
    """One more input and two more outputs (displacement, rate) for each element."""
    n = len(system.M)
    columns = np.zeros((len(elements), n))
    for row, e in zip(columns, elements, strict=True):
        row[: e.column.size] = e.column
    none = np.zeros_like(columns)
    feed = np.zeros((system.n_outputs + 2 * len(elements), system.n_inputs + len(elements)))
    feed[: system.n_outputs, : system.n_inputs] = system.feed
    return replace(
        system,
        load=np.hstack([system.load, columns.T]),
        displacement=np.vstack([system.displacement, columns, none]),
        velocity=np.vstack([system.velocity, none, columns]),
        acceleration=np.vstack([system.acceleration, none, none]),
        feed=feed,
    )


@njit(cache=True)
def _law(code, z, v, p, memory):  # pragma: no cover - compiled
    """Force against the motion, and its slopes to z and v."""
    if code == 0:
        return p[0] * z**3, 3 * p[0] * z**2, 0.0
    if code == 1:
        return p[0] * z**2, 2 * p[0] * z, 0.0
    if code == 2:
        return (p[0] * (z - p[1]), p[0], 0.0) if z > p[1] else (0.0, 0.0, 0.0)
    if code == 3:
        if z > p[1]:
            return p[0] * (z - p[1]), p[0], 0.0
        return (p[0] * (z + p[1]), p[0], 0.0) if z < -p[1] else (0.0, 0.0, 0.0)
    if code == 5:
        return p[0] * v * abs(v), 0.0, 2 * p[0] * abs(v)
    if code == 6:
        trial = p[0] * (z - memory[0])
        if abs(trial) > p[1]:
            return np.sign(trial) * p[1], 0.0, 0.0
        return trial, p[0], 0.0
    h = _wen(z, p, memory)
    middle = 0.5 * (h + memory[1])
    slope = 1 - (p[1] * np.sign((z - memory[0]) * middle) + p[2]) * abs(middle) ** p[3]
    return p[0] * h, p[0] * max(slope, 0.0), 0.0


@njit(cache=True)
def _wen(z, p, memory):  # pragma: no cover - compiled
    """The hysteretic variable at z, by the trapezoidal rule in z."""
    dz, before = z - memory[0], memory[1]
    h = before + dz
    for _ in range(30):
        middle = 0.5 * (h + before)
        new = before + dz * (1 - (p[1] * np.sign(dz * middle) + p[2]) * abs(middle) ** p[3])
        if abs(new - h) <= 1e-14 * (abs(new) + abs(before)):
            return new
        h = new
    return h


@njit(cache=True)
def _remember(code, z, v, p, memory):  # pragma: no cover - compiled
    """The memory after a step that ended at z with the speed v."""
    if code == 4:
        memory[0] = v
    elif code == 6:
        if p[0] > 0.0 and abs(p[0] * (z - memory[0])) > p[1]:
            memory[0] = z - np.sign(z - memory[0]) * p[1] / p[0]
    elif code == 7:
        memory[1] = _wen(z, p, memory)
        memory[0] = z


@njit(cache=True)
def part_of_limit(v, c, before):  # pragma: no cover - compiled
    """Part of its limit that dry friction reaches at the end of a step: v there without it, c what the whole limit
    takes off v, `before` v at the end of the step before.

    A jump within a step is taken as its mean over the steps on either side, straight in v: 2 v' / |v' - before| within
    -1 and 1 with v' = v - c part, that is c part^2 + (before - v + 2 c) part - 2 v = 0 for what moved forwards. Where
    nothing moved that is v / c: what holds.
    """
    s = 1.0
    if before < 0.0:
        s, v, before = -1.0, -v, -before
    b = before - v + 2.0 * c
    below = b + np.sqrt(max(b * b + 8.0 * c * v, 0.0))
    if below <= 4.0 * abs(v):
        return s if v > 0.0 else -s
    return s * 4.0 * v / below


@njit(cache=True)
def _solve(code, z, v, gz, gv, p, memory, guess):  # pragma: no cover - compiled
    """Force f on the structure with f = -law(z + gz f, v + gv f)."""
    if code == 4:
        if p[0] == 0.0:
            return 0.0
        return -p[0] * part_of_limit(v, max(gv, 0.0) * p[0], memory[0])
    f = guess
    for _ in range(50):
        value, dz, dv = _law(code, z + gz * f, v + gv * f, p, memory)
        slope = 1 + dz * gz + dv * gv
        change = -(f + value) / slope
        f += change
        if abs(change) <= 1e-14 * abs(f):
            break
    return f


@njit(cache=True)
def _march(T, W, x, f, states, forces, see, before, after, gain, codes, p, memory, force):  # pragma: no cover
    """Advance; x (2 m,) holds first states, then second ones. Returns the first step that did not settle, or 0."""
    n_in, order, _, m = W.shape
    k = codes.size
    g = np.empty(2 * m)
    new = np.empty(k)
    seen = np.empty(2 * k)
    for step in range(states.shape[0]):
        states[step] = x
        forces[step] = force
        for b in range(m):
            g[b] = T[0, b] * x[b] + T[1, b] * x[m + b]
            g[m + b] = T[2, b] * x[b] + T[3, b] * x[m + b]
        for i in range(n_in):
            for j in range(order):
                value = f[i, step + j]
                if value != 0.0:
                    for b in range(m):
                        g[b] += W[i, j, 0, b] * value
                        g[m + b] += W[i, j, 1, b] * value
        for e in range(k):
            if force[e] != 0.0:
                for b in range(2 * m):
                    g[b] += before[b, e] * force[e]
        for r in range(2 * k):
            total = 0.0
            for b in range(2 * m):
                total += see[r, b] * g[b]
            seen[r] = total
        new[:] = force
        settled = False
        for _ in range(60):
            largest, change = 0.0, 0.0
            for e in range(k):
                z, v = seen[e], seen[k + e]
                for other in range(k):
                    if other != e:
                        z += gain[e, other] * new[other]
                        v += gain[k + e, other] * new[other]
                one = _solve(codes[e], z, v, gain[e, e], gain[k + e, e], p[e], memory[e], new[e])
                change = max(change, abs(one - new[e]))
                largest = max(largest, abs(one))
                new[e] = one
            if change <= 1e-12 * largest:
                settled = True
                break
        if not settled and change > 1e-8 * largest:
            return step + 1
        for e in range(k):
            z, v = seen[e], seen[k + e]
            for other in range(k):
                z += gain[e, other] * new[other]
                v += gain[k + e, other] * new[other]
            _remember(codes[e], z, v, p[e], memory[e])
            force[e] = new[e]
            if new[e] != 0.0:
                for b in range(2 * m):
                    g[b] += after[b, e] * new[e]
        x[:] = g
    return 0
