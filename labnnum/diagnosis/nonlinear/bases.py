"""Base vectors of an engine from those of another, or from parameters alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.receptance import cords, of_all


def without(engine: Engine, wide: Engine, x: NDArray) -> tuple[NDArray, NDArray] | None:
    """The base vector of an engine from that of one whose structure holds mechanisms besides, and the parameters of
    these; None where the two structures have other motions.
    """
    n, more, there = engine.theta0.size, wide.theta0.size, wide.band_modes
    if wide.basis.shape[0] != engine.basis.shape[0]:
        return None
    own = engine.band_modes
    _, at, where = np.intersect1d(own, there, return_indices=True)
    modes = np.stack([np.zeros(own.size), np.log(engine.zeta0[own]), np.zeros(own.size)])
    modes[:, at] = x[more : more + 3 * there.size].reshape(3, -1)[:, where]
    hung = more + 3 * there.size
    return np.concatenate([x[:n], modes.ravel(), x[hung : hung + of_all(engine)]]), x[n:more]


def nominal(engine: Engine, theta: NDArray) -> NDArray:
    """The base vector of an engine at parameters `theta`, all else nominal."""
    one = replace(engine.start(), theta=theta)
    return np.concatenate([one.theta, one.shift, one.log_zeta, one.size, one.law[:1], np.zeros(cords(engine))])
