"""What is marginalised of a fit's residuals: columns of each row's own, and columns that all rows share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis import sums


@dataclass(frozen=True, eq=False)
class Marginal:
    """Columns (n, rows, 2 f), of deviation one, the first `own` of them each row's own, and their factor.

    `factor` (rows, own, n) is the Cholesky factor of each row's own, beside what it leaves of the common ones, whose
    Gram matrix over all rows is then `common`.
    """

    columns: NDArray[np.float64]
    own: int
    factor: NDArray[np.float64]
    common: NDArray[np.float64]

    def reduce(self, r: NDArray, shifted: NDArray) -> float:
        """Whitened squares of `r` (rows, 2 f), what is marginalised taken off at its price, and the price of frequency
        offsets, `shifted` (k + 1, k + 1) in the common columns and what is left.
        """
        along = np.matmul(self.columns.transpose(1, 0, 2), r[:, :, None])[:, :, 0]
        within, taken = sums.forward(self.factor, along)
        squares = float(np.vdot(r, r))
        whole, left = squares + float(shifted[-1, -1]), squares - taken + float(shifted[-1, -1])
        if not len(self.common):
            return sensible(left, whole)
        across = along[:, self.own :].sum(axis=0) - np.tensordot(within, self.factor[:, :, self.own :], 2)
        across += shifted[:-1, -1]
        inner = self.common + shifted[:-1, :-1] + np.eye(across.size)
        return sensible(left - float(across @ np.linalg.solve(inner, across)), whole)


@dataclass(frozen=True, eq=False)
class Irregularity:
    """What a structure's parts differ by.

    `size` (k,) along the directions that are marginalised, `parts` (n_parts,) part by part; `added` (rows, 2 f) is what
    the columns of those directions add to the whitened responses.
    """

    size: NDArray[np.float64]
    parts: NDArray[np.float64]
    added: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gathered:
    """Whitened columns at one point: `own` marginalised by row, `common` to all, derivatives, residuals.

    `columns` (own + common + n_x + 1, rows, 2 f); `moved` (common, m_b): by how much what is common moves frequencies;
    `gram` and `factor` as of `marginal.by_rows`.
    """

    columns: NDArray[np.float64]
    own: int
    common: int
    moved: NDArray[np.float64]
    gram: NDArray[np.float64]
    factor: NDArray[np.float64]
    irregular: Irregularity | None


def sensible(left: float, whole: float) -> float:
    """What is left of squares, or the whole where it is next to nothing: so large that its own ordinary errors would
    explain anything.
    """
    return left if left >= 1e-9 * whole else whole


def by_rows(columns: NDArray, n: int) -> tuple[NDArray, NDArray]:
    """Gram matrix of columns (n + m, rows, 2 f), summed over rows, each row's own first n marginalised; and the factor
    (rows, n, n + m) of those.
    """
    gram = np.matmul(columns.transpose(1, 0, 2), columns.transpose(1, 2, 0))
    factor = sums.eliminated(gram, n)
    rest = factor[:, :, n:].reshape(-1, len(columns) - n)
    return gram[:, n:, n:].sum(axis=0) - rest.T @ rest, factor


def common_out(gram: NDArray, k: int) -> NDArray:
    """The same with the first k, common to all rows and of deviation one, left out."""
    if not k:
        return gram
    return gram[k:, k:] - gram[:k, k:].T @ np.linalg.solve(gram[:k, :k] + np.eye(k), gram[:k, k:])
