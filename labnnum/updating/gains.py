r"""The second stage of a network: a linear answer whose coefficients depend on the first.

Where noise is small, the best estimate near a parameter set is linear in the features, with coefficients that change
slowly from set to set. The first stage says where; the second answers

.. math:: y = \sum_a T_a(p)\, (G_{a0} + G_a z),\quad p = \mathrm{clip}(y_1 / r, -1, 1)

with y_1 the first answer, r its reach over the training set, and T_a products of Chebyshev polynomials: 1, p_i, p_i p_j
and T_2 to T_P of each p_i. A kernel network spends its centres on the shape of the answer; here every coefficient is
free to cancel noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labnnum.updating.regression import regress

POWERS = 6
"""Highest degree in one parameter."""

TERMS = 1400
"""Coefficients of one output, at most."""

_EACH = 10
"""Training samples for each coefficient, at least."""


def n_polynomials(outputs: int, powers: int) -> int:
    """Number of the polynomials T_a of `outputs` parameters."""
    return 1 + outputs * powers + outputs * (outputs - 1) // 2


def polynomials(p: NDArray, powers: int) -> NDArray[np.float64]:
    """T_a at columns p (n_outputs, n) within [-1, 1], shape (n_polynomials, n)."""
    m, n = p.shape
    i, j = np.triu_indices(m, 1)
    out = np.empty((n_polynomials(m, powers), n))
    out[0], out[1 : 1 + m] = 1.0, p
    for degree in range(2, powers + 1):
        at = 1 + (degree - 1) * m
        np.multiply(2 * p, out[at - m : at], out=out[at : at + m])
        out[at : at + m] -= out[at - 2 * m : at - m] if degree > 2 else 1.0
    np.multiply(p[i], p[j], out=out[1 + powers * m :])
    return out


def slopes(p: NDArray, powers: int) -> NDArray[np.float64]:
    """Derivatives of T_a to p at one point p (n_outputs,), shape (n_polynomials, n_outputs)."""
    n = p.size
    i, j = np.triu_indices(n, 1)
    first, second = [np.ones(n), p], [np.zeros(n), np.ones(n)]
    for _ in range(powers - 1):
        second.append(2 * first[-1] + 2 * p * second[-1] - second[-2])
        first.append(2 * p * first[-1] - first[-2])
    unit = np.eye(n)
    rows = [np.zeros((1, n)), *(np.diag(s) for s in second[1 : powers + 1])]
    return np.vstack([*rows, unit[i] * p[j, None] + unit[j] * p[i, None]])


def affordable_powers(samples: int, inputs: int, outputs: int) -> int:
    """The highest degree whose coefficients `samples` can bear; 0 where a second stage has too many."""
    for powers in range(POWERS, 1, -1):
        terms = n_polynomials(outputs, powers) * (1 + inputs)
        if terms <= TERMS and terms * _EACH <= samples:
            return powers
    return 0


def powers_of(gains: NDArray, outputs: int) -> int:
    """The degree of stored gains, shape (n_polynomials, 1 + n_inputs, n_outputs)."""
    return (len(gains) - 1 - outputs * (outputs - 1) // 2) // outputs


def second_answer(
    first: NDArray, affine: NDArray, stacked: NDArray, reach: NDArray, powers: int
) -> NDArray[np.float64]:
    """Normalised answers in columns, shape (n_outputs, n).

    Parameters
    ----------
    first : ndarray, shape (n_outputs, n)
        First answers.
    affine : ndarray, shape (1 + n_inputs, n)
        A one above the inputs z.
    stacked : ndarray, shape (n_outputs n_polynomials, 1 + n_inputs)
        Gains, outputs slowest.
    reach : ndarray, shape (n_outputs,)
    powers : int
    """
    t = polynomials(np.clip(first / reach[:, None], -1, 1), powers)
    return np.einsum("oan,an->on", (stacked @ affine).reshape(len(first), *t.shape), t)


def second_jacobian(
    first: NDArray, by_input: NDArray, z: NDArray, gains: NDArray, reach: NDArray
) -> NDArray[np.float64]:
    """Derivative of the second answer to the inputs at one point, shape (n_outputs, n_inputs).

    Parameters
    ----------
    first : ndarray, shape (n_outputs,)
        The first answer.
    by_input : ndarray, shape (n_outputs, n_inputs)
        Its derivative.
    """
    p = np.clip(first / reach, -1, 1)
    powers = powers_of(gains, p.size)
    t = polynomials(p[:, None], powers)[:, 0]
    inner = (np.abs(first) < reach) / reach
    affine = np.einsum("aio,i->ao", gains, np.append(1.0, z))
    through = affine.T @ (slopes(p, powers) * inner)
    return np.einsum("a,aio->oi", t, gains[:, 1:]) + through @ by_input


def fit_gains(
    first: NDArray, z: NDArray, targets: NDArray, powers: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Gains (n_polynomials, 1 + n_inputs, n_outputs), reach (n_outputs,) and leave-one-out errors (n, n_outputs).

    Parameters
    ----------
    first : ndarray, shape (n, n_outputs)
        First answers as they are on data that the first stage has not seen: leave-one-out answers.
    z : ndarray, shape (n, n_inputs)
    targets : ndarray, shape (n, n_outputs)
    powers : int
    """
    reach = np.abs(first).max(axis=0)
    count, n_in = n_polynomials(targets.shape[1], powers), z.shape[1]

    def head(part: slice) -> NDArray:
        return np.hstack([np.ones((len(z[part]), 1)), z[part]])

    def body(part: slice) -> NDArray:
        t = polynomials(np.clip(first[part] / reach, -1, 1).T, powers)[1:].T
        return (t[:, :, None] * head(part)[:, None, :]).reshape(len(t), -1)

    found = regress(head, body, targets)
    gains = np.concatenate([found.head[None], found.body.reshape(count - 1, 1 + n_in, -1)])
    return gains, reach, found.errors
