"""Optimal control of an updated model: state space, regulator, observer, and how the closed loop does.

Loops are built from the model that the controller believes in and from the plant that is there; where the two differ,
stability has to be looked at, not assumed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from labnnum.errors import ModelError
from labnnum.structures.base import Structure


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x' = A x + B u + G w, y = C x, with x = (displacements, velocities).

    Parameters
    ----------
    A : ndarray, shape (n, n)
    B : ndarray, shape (n, n_u)
        Control forces, N.
    G : ndarray, shape (n, n_w)
        Disturbing forces, N.
    C : ndarray, shape (n_y, n)
        Measured displacements, m.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    G: NDArray[np.float64]
    C: NDArray[np.float64]


def state_space(
    structure: Structure, theta: ArrayLike, control: ArrayLike, disturbance: ArrayLike, measured: ArrayLike
) -> StateSpace:
    """State space of a structure at a parameter set.

    Parameters
    ----------
    theta : array_like, shape (n_parameters,)
    control, disturbance : array_like, shape (size, n_u) and (size, n_w)
        Where unit forces act on the structure's coordinates.
    measured : array_like, shape (n_y, size)
        Rows that pick the measured displacements.

    Raises
    ------
    ModelError
        If the structure has frequency-dependent (structural) damping, or a mass matrix without an inverse.
    """
    m = structure.matrices(np.asarray(theta, float))
    if np.any(m.D):
        raise ModelError("control needs viscous damping; this structure has structural damping")
    n = len(m.M)
    try:
        inverse = np.linalg.inv(m.M)
    except np.linalg.LinAlgError:
        raise ModelError("control needs a mass at every coordinate; this mass matrix has no inverse") from None
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ m.K, -inverse @ m.C]])
    rows = np.atleast_2d(np.asarray(measured, float))
    return StateSpace(
        a, _below(inverse @ _columns(control)), _below(inverse @ _columns(disturbance)),
        np.hstack([rows, np.zeros_like(rows)]),
    )  # fmt: skip


def lqr(system: StateSpace, Q: ArrayLike, R: ArrayLike) -> NDArray[np.float64]:
    r"""Gain K, shape (n_u, n), of u = -K x that minimises the integral of x'Qx + u'Ru.

    Notes
    -----
    :math:`K = R^{-1} B^T P` with :math:`A^T P + P A - P B R^{-1} B^T P + Q = 0`.

    Raises
    ------
    ModelError
        If the Riccati equation has no stabilising solution.

    References
    ----------
    Kwakernaak and Sivan (1972), section 3.4; Atalla (1996), section 5.4.

    Examples
    --------
    >>> double = StateSpace(np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]]), np.zeros((2, 1)), np.eye(2))
    >>> lqr(double, np.eye(2), [[1.0]]).round(6)
    array([[1.      , 1.732051]])
    """
    r = np.atleast_2d(np.asarray(R, float))
    p = _riccati(system.A, system.B, np.asarray(Q, float), r)
    return np.asarray(np.linalg.solve(r, system.B.T @ p), np.float64)


def kalman(system: StateSpace, W: ArrayLike, V: ArrayLike) -> NDArray[np.float64]:
    """Gain L, shape (n, n_y), of the observer x' = A x + B u + L (y - C x) with the least error covariance.

    Parameters
    ----------
    W : array_like, shape (n_w, n_w)
        Two-sided spectral density of the disturbance, N^2 s.
    V : array_like, shape (n_y, n_y)
        Of the sensors' noise, m^2 s.

    References
    ----------
    Kwakernaak and Sivan (1972), section 4.3.
    """
    v = np.atleast_2d(np.asarray(V, float))
    w = np.atleast_2d(np.asarray(W, float))
    p = _riccati(system.A.T, system.C.T, system.G @ w @ system.G.T, v)
    return np.asarray(np.linalg.solve(v, system.C @ p), np.float64).T


def state_feedback(plant: StateSpace, K: NDArray) -> NDArray[np.float64]:
    """Closed loop x' = (A - B K) x, shape (n, n)."""
    return plant.A - plant.B @ K


def observer_feedback(plant: StateSpace, model: StateSpace, K: NDArray, L: NDArray) -> NDArray[np.float64]:
    """Closed loop of the states of the plant and of the observer, which believes in `model`, shape (2 n, 2 n)."""
    return np.block([[plant.A, -plant.B @ K], [L @ plant.C, model.A - model.B @ K - L @ model.C]])


def decay(closed: NDArray) -> float:
    """Rate, 1/s, at which the slowest part of a loop decays; negative where the loop is unstable."""
    return -float(np.linalg.eigvals(closed).real.max())


def cost_to_go(closed: NDArray, weight: NDArray, start: NDArray) -> float:
    """Integral of x' weight x from x(0) = start; infinite where the loop is unstable."""
    if decay(closed) <= 0:
        return float("inf")
    p = linalg.solve_continuous_lyapunov(closed.T, -weight)
    return float(start @ p @ start)


def mean_cost(closed: NDArray, weight: NDArray, density: NDArray) -> float:
    """Stationary mean of x' weight x under white noise of a density (n, n); infinite where the loop is unstable."""
    if decay(closed) <= 0:
        return float("inf")
    return float(np.trace(weight @ linalg.solve_continuous_lyapunov(closed, -density)))


def free_response(closed: NDArray, start: NDArray, row: NDArray, time: NDArray) -> NDArray[np.float64]:
    """Row x(t) of x' = closed x, x(0) = start, shape (n_times,)."""
    values, vectors = np.linalg.eig(closed)
    share = (row @ vectors) * np.linalg.solve(vectors, start.astype(complex))
    return np.real(np.exp(np.outer(time, values)) @ share)


def settling_time(time: NDArray, response: NDArray, band: float = 0.02) -> float:
    """Time after which |response| stays below `band` times its peak; NaN if it does not within `time`."""
    size = np.abs(response)
    above = np.flatnonzero(size > band * size.max())
    last = int(above[-1]) + 1 if above.size else 0
    return float(time[last]) if last < time.size else float("nan")


def modulus_margin(plant: StateSpace, model: StateSpace, K: NDArray, L: NDArray, omega: NDArray) -> float:
    """Least distance of the loop gain from -1 over the frequencies (rad/s): how much the plant may be off.

    The loop is cut at the actuator; one control force.
    """
    n = len(model.A)
    s = 1j * omega[:, None, None] * np.eye(n)
    through = np.linalg.solve(s - plant.A, plant.B.astype(complex))
    controller = K @ np.linalg.solve(s - (model.A - model.B @ K - L @ model.C), L.astype(complex))
    gain = (controller @ (plant.C @ through))[:, 0, 0]
    return float(np.abs(1 + gain).min())


def _riccati(a: NDArray, b: NDArray, q: NDArray, r: NDArray) -> NDArray[np.float64]:
    try:
        return np.asarray(linalg.solve_continuous_are(a, b, q, r), float)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ModelError(f"no stabilising gain: {error}") from error


def _below(forces: NDArray) -> NDArray[np.float64]:
    return np.vstack([np.zeros_like(forces), forces])


def _columns(places: ArrayLike) -> NDArray[np.float64]:
    a = np.asarray(places, float)
    return a[:, None] if a.ndim == 1 else a
