"""Motions of the structure at which the terms of a model act, and what of them no parameter changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import Term


@dataclass(frozen=True, eq=False)
class Attached:
    """Columns of some terms together.

    `columns` (n, k) are their motions, `high` (k, h) their shares in the modes above the basis, `inertial` (k,) those
    that act on absolute motion. Columns that carry the structure along, `carrying` (k,), move it by `static` (n, k)
    besides, with `own_load` (k,) of base motion; `tied` (k, k) is what others' columns move with them.
    """

    columns: NDArray[np.float64]
    high: NDArray[np.float64]
    inertial: NDArray[np.bool_]
    carrying: NDArray[np.bool_]
    static: NDArray[np.float64]
    own_load: NDArray[np.float64]
    tied: NDArray[np.float64]

    @classmethod
    def of(cls, terms: Sequence[Term], high: NDArray) -> Attached:
        """Those of `terms` on a structure whose modes above the basis are `high` (n, h)."""
        columns = np.hstack([t.columns for t in terms])
        groups = [g for t in terms for g in t.groups]
        widths = [g.columns.shape[1] for g in groups]
        carrying = np.repeat([g.carried is not None for g in groups], widths)
        static = np.hstack([np.zeros_like(g.columns) if g.carried is None else g.carried for g in groups])
        load = [np.zeros(n) if g.load is None else g.load for g, n in zip(groups, widths, strict=True)]
        tied = np.where(carrying[None, :] & ~carrying[:, None], columns.T @ static, 0.0)
        inertial = np.concatenate([t.inertial for t in terms])
        return cls(columns, columns.T @ high, inertial, carrying, static, np.concatenate(load), tied + tied.T)
