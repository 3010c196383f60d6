r"""Time simulation: a linear system marched exactly, block by block, with the same bits for any block size.

The system is split into independent blocks of two states: modes where damping does not couple them, pairs of
complex states where it does. Each is advanced by its exact matrix exponential, and the input between samples is the
polynomial through the nearest `order` samples, integrated exactly (Van Loan 1978). `order` 2 is the first-order
hold; with 8 and fourfold oversampling the error is below 1e-4 at 0.4 of the unraised rate, with eightfold below 1e-6.

References
----------
C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic Control 23, 1978.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse.csgraph import connected_components
from scipy.special import comb

from labnnum.errors import EstimationError, ModelError
from labnnum.system import System, massless, modal_basis

TERMS = 22
"""Of the exponential's series, over parts in which no mode turns by more than half a radian."""
COUPLED = 1e-9
"""Modal damping between two modes below this fraction of their own counts as none."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Independent pairs of states: x' = A x + B f, and what the outputs take of them.

    Parameters
    ----------
    A : ndarray, shape (m, 2, 2)
        In 1/s.
    B : ndarray, shape (m, 2, n_in)
    out : ndarray, shape (n_out, 2 m)
    feed : ndarray, shape (n_out, n_in)
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    out: NDArray[np.float64]
    feed: NDArray[np.float64]


def blocks(system: System) -> Blocks:
    """Split `system` into independent pairs of states.

    Raises
    ------
    ModelError
        If the system is unstable, or a group of coupled modes has no complete set of eigenvectors.
    """
    if massless(system.M).any():
        return _first_order_blocks(system)
    values, shape = modal_basis(system.M, system.K)
    gamma = shape.T @ system.C @ shape
    values = np.where(np.abs(values) < 1e-12 * np.abs(values).max(), 0.0, values)
    if values[0] < 0:
        raise ModelError("the structure is unstable: its stiffness matrix has a negative eigenvalue")
    _, group = connected_components(_coupling(gamma), directed=False)
    load, rows = shape.T @ system.load, [r @ shape for r in _rows(system)]
    parts = [_group(values[g], gamma[np.ix_(g, g)], load[g], [r[:, g] for r in rows]) for g in _members(group)]
    return Blocks(
        np.concatenate([p[0] for p in parts]),
        np.concatenate([p[1] for p in parts]),
        np.concatenate([p[2] for p in parts], axis=1),
        system.feed + rows[2] @ load,
    )


def _rows(system: System) -> tuple[NDArray, NDArray, NDArray]:
    return system.displacement, system.velocity, system.acceleration


def _coupling(gamma: NDArray) -> NDArray[np.bool_]:
    own = np.sqrt(np.abs(np.diag(gamma)))
    scale = np.outer(own, own)
    return np.abs(gamma) > np.where(scale > 0, COUPLED * scale, COUPLED * np.abs(gamma).max(initial=0.0))


def _members(group: NDArray) -> list[NDArray[np.intp]]:
    return [np.flatnonzero(group == g) for g in range(group.max() + 1)]


def _group(values: NDArray, gamma: NDArray, load: NDArray, rows: list[NDArray]) -> tuple[NDArray, NDArray, NDArray]:
    """A, B and output rows of modes that damping couples (or of one mode alone)."""
    n = len(values)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-np.diag(values), -gamma]])
    drive = np.vstack([np.zeros_like(load), load])
    out = np.hstack([rows[0] - rows[2] * values, rows[1] - rows[2] @ gamma])
    if n == 1:
        return state[None], drive[None], out
    return _pairs(state, drive, out)


def _pairs(state: NDArray, drive: NDArray, out: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Real 2 x 2 blocks of a general state matrix through its eigenvectors."""
    values, vectors = _eigen(state)
    if values.real.max() > 1e-9 * np.abs(values).max():
        raise ModelError("the structure is unstable: a pole grows with time")
    if np.linalg.cond(vectors) > 1e12:
        raise ModelError("the structure's poles coincide: change a damping or stiffness slightly to simulate it")
    modal = _complex(np.linalg.solve(vectors, drive))
    seen = _complex(out @ vectors)
    upper = np.flatnonzero(values.imag > 0)
    real = np.flatnonzero(values.imag == 0)
    lam, b, c = values[upper], modal[upper], seen[:, upper]
    A = [np.array([[v.real, -v.imag], [v.imag, v.real]]) for v in lam]
    B = [np.stack([r.real, r.imag]) for r in b]
    C = [np.stack([2 * k.real, -2 * k.imag], axis=1) for k in c.T]
    for pair in (real[i : i + 2] for i in range(0, len(real), 2)):
        two = [*pair, *([None] if len(pair) == 1 else [])]
        A.append(np.diag([-1.0 if i is None else values[i].real for i in two]))
        B.append(np.stack([np.zeros(drive.shape[1]) if i is None else modal[i].real for i in two]))
        C.append(np.stack([np.zeros(len(out)) if i is None else seen[:, i].real for i in two], axis=1))
    return np.array(A), np.array(B), np.hstack(C)


def _eigen(state: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    values, vectors = np.linalg.eig(state)
    return _complex(values), _complex(vectors)


def _complex(array: NDArray) -> NDArray[np.complex128]:
    return np.asarray(array, np.complex128)


def _first_order_blocks(system: System) -> Blocks:
    """Blocks of a system with massless coordinates: those with damping are states, the others follow statically."""
    light = massless(system.M)
    damped = light & np.any(system.C != 0, axis=1)
    static = light & ~damped
    if static.any():
        return blocks(_without(system, static))
    heavy = ~light
    order = np.concatenate([np.flatnonzero(heavy), np.flatnonzero(light)])
    nh, nl = int(heavy.sum()), int(light.sum())
    M, C, K = (a[np.ix_(order, order)] for a in (system.M, system.C, system.K))
    # unknown rates (v', w') of x = (u, v, w): M_hh v' + C_hl w' = ..., C_lh v + C_ll w' = ...
    left = np.block([[M[:nh, :nh], C[:nh, nh:]], [np.zeros((nl, nh)), C[nh:, nh:]]])
    right_u = -K[:, :nh]
    right_v = -np.vstack([C[:nh, :nh], C[nh:, :nh]])
    right_w = -K[:, nh:]
    try:
        factor = lu_factor(left)
        rates = lu_solve(factor, np.hstack([right_u, right_v, right_w]))
        drive_rates = lu_solve(factor, system.load[order])
    except (np.linalg.LinAlgError, ValueError):
        raise ModelError("the massless coordinates of the structure cannot be solved for") from None
    state = np.vstack([np.hstack([np.zeros((nh, nh)), np.eye(nh), np.zeros((nh, nl))]), rates])
    drive = np.vstack([np.zeros((nh, system.n_inputs)), drive_rates])
    pu, pv, pa = (r[:, order] for r in _rows(system))
    if pa[:, nh:].any():
        raise ModelError("the acceleration of a coordinate without mass cannot be sensed")
    out = np.hstack([pu[:, :nh], pv[:, :nh], pu[:, nh:]]) + pa[:, :nh] @ rates[:nh] + pv[:, nh:] @ rates[nh:]
    feed = system.feed + pa[:, :nh] @ drive_rates[:nh] + pv[:, nh:] @ drive_rates[nh:]
    return Blocks(*_pairs(state, drive, out), feed)


def _without(system: System, drop: NDArray[np.bool_]) -> System:
    """Condense coordinates that have stiffness only."""
    keep = ~drop
    if system.load[drop].any() or any(r[:, drop].any() for r in _rows(system)[1:]):
        raise ModelError("a coordinate without mass and damping is driven or sensed; give it a mass")
    tie = -np.linalg.solve(system.K[np.ix_(drop, drop)], system.K[np.ix_(drop, keep)])
    K = system.K[np.ix_(keep, keep)] + system.K[np.ix_(keep, drop)] @ tie
    pu = system.displacement[:, keep] + system.displacement[:, drop] @ tie
    square = np.ix_(keep, keep)
    return System(
        system.M[square], system.C[square], K, system.load[keep],
        pu, system.velocity[:, keep], system.acceleration[:, keep], system.feed,
    )  # fmt: skip


def hold_weights(A: NDArray, B: NDArray, step: float, order: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Exact step of x' = A x + B f for an input that is the polynomial through `order` samples.

    Parameters
    ----------
    A : ndarray, shape (m, 2, 2)
    B : ndarray, shape (m, 2, n_in)
    step : float
        s.
    order : int
        Even; the samples at step numbers -(order/2 - 1) ... order/2 about the step from 0 to 1.

    Returns
    -------
    transition : ndarray, shape (m, 2, 2)
    weight : ndarray, shape (m, 2, n_in, order)
    """
    transition, moments = hold_moments(A, step, order)
    weight = np.einsum("msik,ij,mkn->msnj", moments, samples_to_polynomial(order), B)
    return transition, weight


def samples_to_polynomial(order: int) -> NDArray[np.float64]:
    """Coefficients (row) of the polynomial in steps through `order` samples (column), which `hold_weights` holds."""
    nodes = np.arange(order) - (order // 2 - 1.0)
    return np.asarray(np.linalg.inv(np.vander(nodes, order, increasing=True)), float)


def hold_moments(A: NDArray, step: float, order: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Exact step of x' = A x + w for w = 1, s, s^2 ... up to `order` of them, s from 0 to 1 over the step.

    Parameters
    ----------
    A : ndarray, shape (m, 2, 2)
    step : float
        s.
    order : int

    Returns
    -------
    transition : ndarray, shape (m, 2, 2)
    moments : ndarray, shape (m, 2, order, 2)
        Of each state, by power and by the state that w drives; in s.
    """
    rate = np.abs(np.linalg.eigvals(A)).max(axis=1)
    halvings = np.ceil(np.log2(np.maximum(2.0 * rate * step, 1.0))).astype(int)
    part = step / 2.0**halvings
    powers = np.tile(np.eye(2), (len(A), 1, 1))
    transition, moments = powers.copy(), np.zeros((len(A), 2, order, 2))
    share = 1.0 / (np.arange(order) + 1.0)
    for q in range(1, TERMS):
        moments += powers[:, :, None, :] * share[None, None, :, None]
        share = share / (np.arange(order) + 1.0 + q)
        powers = powers @ (A * part[:, None, None])
        transition += powers / math.factorial(q)
    moments *= part[:, None, None, None]
    for done in range(halvings.max(initial=0)):
        more = halvings > done
        moments[more] = joined(transition[more], moments[more], moments[more], 1)
        transition[more] = transition[more] @ transition[more]
    return transition, moments


def joined(transition: NDArray, first: NDArray, one: NDArray, count: int) -> NDArray[np.float64]:
    """Moments as `hold_moments` has them over count + 1 equal parts, from those over `count` of them and over one.

    Parameters
    ----------
    transition : ndarray, shape (m, 2, 2)
        Over one part.
    first, one : ndarray, shape (m, 2, order, 2)
    count : int
    """
    j = np.arange(first.shape[2])
    chosen = comb(j[:, None], j[None, :]) * float(count) ** np.maximum(j[:, None] - j[None, :], 0)
    last = np.einsum("mst,mtjk->msjk", transition, first) * float(count) ** j[:, None]
    return (last + np.einsum("jq,msqk->msjk", chosen, one)) / (count + 1.0) ** j[:, None]


@njit(cache=True)
def _march(T, W, x, f, states):  # pragma: no cover - compiled
    """Advance all blocks; T (4, m), W (n_in, order, 2, m), x (2, m), f (n_in, n + order - 1), states (n, 2, m)."""
    n_in, order, _, m = W.shape
    g = np.empty((2, m))
    for k in range(states.shape[0]):
        for b in range(m):
            states[k, 0, b] = x[0, b]
            states[k, 1, b] = x[1, b]
            g[0, b] = T[0, b] * x[0, b] + T[1, b] * x[1, b]
            g[1, b] = T[2, b] * x[0, b] + T[3, b] * x[1, b]
        for i in range(n_in):
            for j in range(order):
                v = f[i, k + j]
                if v != 0.0:
                    for b in range(m):
                        g[0, b] += W[i, j, 0, b] * v
                        g[1, b] += W[i, j, 1, b] * v
        x[:, :] = g


@dataclass(eq=False)
class Simulation:
    """March a linear system through time in pieces.

    Parameters
    ----------
    system : System
    step : float
        s between samples of the inputs.
    order : int
        Samples that the input polynomial passes through (even).

    Examples
    --------
    A unit mass pushed by 1 N from rest moves by t^2/2:

    >>> one = np.ones((1, 1))
    >>> free = System(one, 0 * one, 0 * one, one, one, 0 * one, 0 * one, 0 * one)
    >>> round(float(simulate(free, np.ones((1, 101)), 0.01, order=2)[0, 100]), 12)
    0.5
    """

    system: System
    step: float
    order: int = 8
    _state: dict[str, Any] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.order < 2 or self.order % 2:
            raise EstimationError(f"the order of the input hold must be even and at least 2, not {self.order}")
        made = blocks(self.system)
        transition, weight = hold_weights(made.A, made.B, self.step, self.order)
        m = len(made.A)
        self._T = np.ascontiguousarray(transition.reshape(m, 4).T)
        self._W = np.ascontiguousarray(weight.transpose(2, 3, 1, 0))
        # states come as (2, m) rows; the output matrix is put into that order
        self._out = np.ascontiguousarray(made.out.reshape(-1, m, 2).transpose(0, 2, 1).reshape(-1, 2 * m))
        self._feed = made.feed
        self.reset()

    def reset(self) -> None:
        """Back to rest at time 0, with no input before it."""
        self._x = np.zeros((2, self._T.shape[1]))
        self._ahead = np.zeros((self.system.n_inputs, self.order // 2 - 1))

    @property
    def delay(self) -> int:
        """Samples by which outputs lag behind the inputs that were handed over: the hold looks ahead."""
        return self.order // 2

    def run(self, inputs: NDArray) -> NDArray[np.float64]:
        """Outputs that can be computed so far, shape (n_out, n): `delay` samples fewer in total than the inputs.

        Parameters
        ----------
        inputs : ndarray, shape (n_in, n)
            What follows the inputs of the call before.
        """
        f = np.hstack([self._ahead, np.asarray(inputs, float)])
        n = f.shape[1] - self.order + 1
        if n <= 0:
            self._ahead = f
            return np.zeros((self.system.n_outputs, 0))
        states = np.empty((n, 2, self._T.shape[1]))
        _march(self._T, self._W, self._x, f, states)
        at = self.order // 2 - 1
        out = self._out @ states.reshape(n, -1).T
        out += self._feed @ f[:, at : at + n]
        self._ahead = f[:, n:]
        return out


def simulate(system: System, inputs: NDArray, step: float, order: int = 8) -> NDArray[np.float64]:
    """Outputs from rest for given inputs, shape (n_out, n).

    Parameters
    ----------
    system : System
    inputs : array_like, shape (n_in, n)
        Samples `step` seconds apart; taken as 0 before the first and held at 0 after the last.
    step : float
    order : int
        See `Simulation`.
    """
    march = Simulation(system, step, order)
    inputs = np.atleast_2d(np.asarray(inputs, float))
    return march.run(np.hstack([inputs, np.zeros((inputs.shape[0], march.delay))]))
