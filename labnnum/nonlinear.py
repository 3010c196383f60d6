r"""Nonlinear elements in time simulation: few springs, gaps, dampers and sliders on an otherwise linear structure.

The linear structure keeps its exact march (see `labnnum.simulation`); each element's force enters as one more input,
a cubic over each step by its values and rates at both ends, solved for at the end of the step, element by element
until none changes (Gauss and Seidel). Laws with memory carry a state. Where a stop opens or closes, friction sticks,
slides or turns, a slider lets go or a loop turns back, the moment is sought within the step: the march goes there in
parts of the step whose exact transitions are kept, under the same polynomials of the inputs, and on from there
(`labnnum.nonlinear_march`). Dry friction that sticks is the force that keeps its place, straight over a step. The
error falls with the fourth power of the step, of quadratic damping with the third. With its parameters at zero an
element exerts exactly nothing.

Modes that turn by more than `RESOLVED` within a step take no part in the rates of forces. Where they are much of how
an element's place gives way (`FOLLOWS`, `MOVES`), forces are straight over each step and nothing is sought within it:
dry friction is then a force within bounds that holds the speed at zero if it can (Moreau 1988), and a jump counts
where it comes.

References
----------
J. J. Moreau, "Unilateral contact and dry friction in finite freedom dynamics", CISM 302, 1988.
W. D. Iwan, "A distributed-element model for hysteresis", J. Applied Mechanics 33, 1966.
Y. K. Wen, "Method for random vibration of hysteretic systems", J. Engineering Mechanics 102, 1976.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError, ModelError
from labnnum.nonlinear_laws import COLUMNS
from labnnum.nonlinear_march import LEVELS, begin, march
from labnnum.simulation import Blocks, blocks, hold_moments, hold_weights, joined, samples_to_polynomial
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
RESOLVED = 2.0
"""rad a step, beyond which a mode takes no part in the rates of forces: the step does not resolve it."""
FOLLOWS = 0.05
"""Share that such modes may have in how far an element's place gives way at rest; beyond, forces are straight over a
step."""
MOVES = 1.0 / 3.0
"""The same of how far it gives way within one step."""


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
        s between samples of the inputs; an element does not change more than a few times within it.
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
        if made.feed[n_out:, n_in:].any():
            raise ModelError("a nonlinear element acts on a coordinate without mass; give it a mass")
        m = len(made.A)
        transition, weight = hold_weights(made.A, made.B[:, :, :n_in], step, order)
        self._T = np.ascontiguousarray(transition.reshape(m, 4).T)
        self._W = np.ascontiguousarray(weight.transpose(2, 3, 1, 0))
        out = made.out.reshape(-1, m, 2).transpose(0, 2, 1).reshape(-1, 2 * m)
        self._out, self._feed = np.ascontiguousarray(out[:n_out]), made.feed[:n_out]
        fast = np.abs(np.linalg.eigvals(made.A)).max(axis=1) * step > RESOLVED
        load = made.B[:, :, n_in:]
        stays, grows = _followed(made, out[n_out : n_out + k], load, fast, step)
        self._coarse = stays > FOLLOWS or grows > MOVES
        self._see = _seen(out[n_out:], fast, k)
        self._codes = np.array([_CODES[e.law] for e in self.elements], np.int64)
        self._parameters = np.zeros((k, 4))
        for row, e in zip(self._parameters, self.elements, strict=True):
            row[: len(e.parameters)] = e.parameters
            if e.law == "jenkins" and row[1] <= 0.0:
                row[0] = 0.0  # what yields at no force exerts none
        if self._coarse:
            straight = hold_weights(made.A, load, step, 2)[1]
            before, after = (straight[..., j].transpose(1, 0, 2).reshape(2 * m, k) for j in (0, 1))
            self._before, self._after = np.ascontiguousarray(before), np.ascontiguousarray(after)
            self._rows = np.ascontiguousarray(out[n_out:])
            self._gain = np.ascontiguousarray(self._rows @ after)
        else:
            self._H, self._G = _held(hold_moments(made.A, step, 4)[1], load, self._see)
            self._U = np.ascontiguousarray(weight.transpose(2, 0, 1, 3))
            self._into = samples_to_polynomial(order)
            self._tables = _tables(made, n_in, step, order, self._see)
        self.reset()

    def reset(self) -> None:
        """Back to rest at time 0, sliders unstrained."""
        self._x = np.zeros(self._out.shape[1])
        if self._coarse:
            self._force, self._memory = np.zeros(len(self.elements)), np.zeros((len(self.elements), 2))
        else:
            self._elements = np.zeros((len(self.elements), COLUMNS))
            begin(self._codes, self._parameters, self._elements)
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
        states, forces = np.empty((n, self._x.size)), np.empty((n, len(self.elements)))
        if self._coarse:
            bad = _march(
                self._T, self._W, self._x, f, states, forces, self._rows, self._before, self._after, self._gain,
                self._codes, self._parameters, self._memory, self._force,
            )  # fmt: skip
        else:
            bad = march(
                self._T, self._U, self._H, self._G, self._see, self._x, f, states, forces, self._codes,
                self._parameters, self._elements, self._into, self._tables, self.step,
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


def _seen(rows: NDArray, fast: NDArray, k: int) -> NDArray[np.float64]:
    """Motion and speed of each element from the states, (2 or 3, k, 2 m).

    Where there are `fast` modes, third the speed without them.
    """
    seen = rows.reshape(2, k, rows.shape[1])
    if fast.any():
        seen = np.concatenate([seen, np.where(np.tile(fast, 2), 0.0, seen[1:])])
    return np.ascontiguousarray(seen)


def _followed(made: Blocks, rows: NDArray, load: NDArray, fast: NDArray, step: float) -> tuple[float, float]:
    """Largest shares, over the elements, that `fast` modes have in the motion under a force that stays, and in that of
    the first step under one that grows from nothing. `rows` (k, 2 m) give motions, `load` (m, 2, k) takes forces.
    """
    m, stays, grows = len(made.A), 0.0, 0.0
    if not fast.any():
        return stays, grows
    ramp = hold_weights(made.A, load, step, 2)[1][..., 1]
    rigid = np.abs(np.linalg.det(made.A)) == 0.0
    for e, row in enumerate(rows.reshape(-1, 2, m)):
        first = np.abs(np.einsum("sm,ms->m", row, ramp[..., e]))
        grows = max(grows, float(first[fast].sum() / max(first.sum(), 1e-300)))
        if not first[rigid].any():
            last = np.linalg.solve(np.where(rigid[:, None, None], np.eye(2), made.A), load[:, :, e, None])[..., 0]
            gives = np.abs(np.einsum("sm,ms->m", row, last))
            stays = max(stays, float(gives[fast].sum() / max(gives.sum(), 1e-300)))
    return stays, grows


def _held(moments: NDArray, B: NDArray, see: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What forces that are cubics over a step do in it, by values and rates (times the step) at its beginning and end:
    to the states, (4, k, 2 m), and to what the elements see, (rows, k, k, 4).
    """
    hermite = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-3.0, -2.0, 3.0, -1.0], [2.0, 1.0, -2.0, 1.0]])
    H = np.einsum("msik,ij,mkn->jnsm", moments[:, :, :4], hermite, B).reshape(4, B.shape[2], 2 * len(B))
    return np.ascontiguousarray(H), np.ascontiguousarray(np.einsum("reb,cob->reoc", see, H))


def _parts(A: NDArray, step: float, order: int) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """`hold_moments` of the whole step, then of its parts by the digits of `labnnum.nonlinear_march`."""
    yield hold_moments(A, step, order)
    for level in range(1, LEVELS + 1):
        unit, one = hold_moments(A, step / 16.0**level, order)
        transition, moments = unit, one
        yield transition, moments
        for count in range(1, 15):
            transition, moments = transition @ unit, joined(unit, moments, one, count)
            yield transition, moments


def _tables(
    made: Blocks, n_in: int, step: float, order: int, see: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Exact transitions over parts of a step, for inputs that are polynomials from 0 to 1 over each."""
    T, V, G, H = [], [], [], []
    for transition, moments in _parts(made.A, step, max(order, 4)):
        T.append(transition.reshape(-1, 4).T)
        V.append(np.einsum("msik,mkn->nism", moments[:, :, :order], made.B[:, :, :n_in]))
        held, seen = _held(moments, made.B[:, :, n_in:], see)
        H.append(held)
        G.append(seen)
    return np.array(T), np.array(V), np.array(G), np.array(H)


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
