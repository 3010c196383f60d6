"""Least squares with more samples than weights, in blocks of rows: QR, then a ridge that the data choose.

Columns come in two groups. The head (a polynomial) is fitted freely; of the body (kernels, products) only what the
head does not explain counts, each column scaled to unit size. Wide kernels are nearly polynomials, so without that
step almost all of a body column would be head, and a ridge that is small beside it would still wipe out the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Rows = Callable[[slice], NDArray]
"""Rows of a design matrix for a slice of the samples."""

BLOCK = 4096
"""Samples whose rows are in memory together."""

_RIDGES = np.concatenate([[0.0], 10.0 ** np.arange(-10.0, 0.0, 0.5)])
_ROUNDING = 4 * np.finfo(float).eps
_NOTHING = 1e-12
"""Share of a column below which what the head leaves of it is rounding error."""

_ALIKE = 1.001
"""Ratio of cross-validation scores that counts for nothing: the larger ridge has the smaller weights."""

_STEADY = 1e-13
"""Ridge on the head, relative to its columns: those that all but coincide stay harmless."""


@dataclass(frozen=True, eq=False)
class Regression:
    """What a fit gave.

    Parameters
    ----------
    head, body : ndarray, shapes (n_head, n_outputs) and (n_body, n_outputs)
        Weights.
    errors : ndarray, shape (n, n_outputs)
        Leave-one-out errors, target minus answer.
    ridge : ndarray, shape (n_outputs,)
        Chosen ridges, relative to columns of unit size.
    """

    head: NDArray[np.float64]
    body: NDArray[np.float64]
    errors: NDArray[np.float64]
    ridge: NDArray[np.float64]


def triangle(parts: Iterator[NDArray], start: NDArray) -> NDArray[np.float64]:
    """R of the QR decomposition of stacked rows, shape (width, width); `start` (width, width) stands above them."""
    found = start
    for rows in parts:
        found = np.asarray(np.linalg.qr(np.vstack([found, rows]), mode="r"))
    return found


def regress(head: Rows, body: Rows, targets: NDArray, block: int = BLOCK) -> Regression:
    r"""Weights of both groups, with a ridge on the body.

    Parameters
    ----------
    head, body : callable
        Rows of each group for a slice of the samples.
    targets : ndarray, shape (n, n_outputs)
    block : int
        Samples whose rows are in memory together.

    Notes
    -----
    For each output the ridge minimises generalised cross-validation, n rss / (n - trace of the hat matrix)^2, and
    never falls below the rounding errors of the columns: what is left of a column after the head carries an error of
    some eps times the whole. With B the rows of the body without the head, scaled, and U s V' their decomposition, the
    leverage of a sample is that of the head plus the sum of (B V)^2 / (s^2 + ridge^2), so that leave-one-out is exact.

    References
    ----------
    Golub, Heath and Wahba (1979), Generalized cross-validation; Golub and Van Loan (2013), sections 5.3 and 6.1.
    """
    n, n_out = targets.shape
    slices = [slice(start, min(start + block, n)) for start in range(0, n, block)]
    p, m = head(slice(0, 1)).shape[1], body(slice(0, 1)).shape[1]
    steady = np.zeros(p + m + n_out)
    steady[:p] = _STEADY * np.sqrt(n) * np.abs(head(slices[0])).max(axis=0)
    whole = triangle((np.hstack([head(s), body(s), targets[s]]) for s in slices), np.diag(steady))
    first, across, wanted = whole[:p, :p], whole[:p, p : p + m], whole[:p, p + m :]
    rest, aim = whole[p : p + m, p : p + m], whole[p : p + m, p + m :]
    least = (whole[p + m :, p + m :] ** 2).sum(axis=0)
    before = np.sqrt((whole[: p + m, p : p + m] ** 2).sum(axis=0))
    size = np.sqrt((rest**2).sum(axis=0))
    size = np.where(size > _NOTHING * before, size, np.inf)
    left, s, right = linalg.svd(rest / size, full_matrices=False, check_finite=False)
    floor = _ROUNDING * float(np.median(before[np.isfinite(size)] / size[np.isfinite(size)])) if s.any() else 1.0
    seen = left.T @ aim
    ridge = np.array([_chosen(s, seen[:, j], float(least[j]), n, p, floor) for j in range(n_out)])
    shrunk = s[:, None] ** 2 + ridge**2
    w = (right.T @ (s[:, None] * seen / shrunk)) / size[:, None]
    v = linalg.solve_triangular(first, wanted - across @ w, check_finite=False)
    errors = np.empty((n, n_out))
    turn = right.T / size[:, None]
    for part in slices:
        a, k = head(part), body(part)
        q = linalg.solve_triangular(first.T, a.T, lower=True, check_finite=False).T
        leverage = (q**2).sum(axis=1)[:, None] + ((k - q @ across) @ turn) ** 2 @ (1 / shrunk)
        errors[part] = (targets[part] - a @ v - k @ w) / np.maximum(1 - leverage, 1e-3)
    return Regression(v, w, errors, ridge)


def _chosen(s: NDArray, seen: NDArray, least: float, n: int, free: int, floor: float) -> float:
    """The largest ridge that generalised cross-validation likes as well as the best, for one output."""
    ridges = np.unique(np.maximum(_RIDGES * max(s[0], floor), floor))
    kept = s**2 / (s**2 + ridges[:, None] ** 2)
    rss = least + ((1 - kept) ** 2 * seen**2).sum(axis=1)
    score = rss / np.maximum(n - free - kept.sum(axis=1), 0.5) ** 2
    return float(ridges[np.flatnonzero(score <= _ALIKE * score.min() + np.finfo(float).tiny)[-1]])
