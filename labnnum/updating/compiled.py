"""A network compiled for one feature vector at a time: for estimates inside a control loop, within microseconds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.updating.network import RbfNetwork


def compiled(network: RbfNetwork) -> Callable[[NDArray], NDArray[np.float64]]:
    """Function from a feature vector (n_features,) to parameters, equal to the network's own answer to rounding.

    Raises
    ------
    EstimationError
        If the kernel is not the Gaussian one.

    Notes
    -----
    The first call compiles, which takes a second or two, once on a machine.
    """
    if network.kernel != "gaussian":
        raise EstimationError(f"network: only a gaussian kernel is compiled, this one has {network.kernel!r}")
    rows = np.ascontiguousarray(network.projection.T)
    offset = rows @ network.origin
    centres = np.ascontiguousarray(network.centres)
    weights = np.ascontiguousarray(network.weights.T)
    shift, scale, degree = np.array(network.shift), np.array(network.scale), network.degree
    tail = np.ascontiguousarray(network.tail.T)

    def answer(features: NDArray) -> NDArray[np.float64]:
        return _answer(features, rows, offset, centres, weights, tail, degree, shift, scale)

    return answer


@njit(cache=True, fastmath=True)
def _answer(x, rows, offset, centres, weights, tail, degree, shift, scale):  # pragma: no cover - compiled
    n_in, n_centres, n_out = rows.shape[0], centres.shape[0], weights.shape[0]
    z = np.empty(n_in)
    for i in range(n_in):
        total = -offset[i]
        for j in range(x.size):
            total += rows[i, j] * x[j]
        z[i] = total
    phi = np.empty(n_centres)
    for c in range(n_centres):
        total = 0.0
        for i in range(n_in):
            apart = z[i] - centres[c, i]
            total += apart * apart
        phi[c] = -0.5 * total
    for c in range(n_centres):
        phi[c] = np.exp(phi[c])
    out = np.empty(n_out)
    for o in range(n_out):
        total = 0.0
        for c in range(n_centres):
            total += weights[o, c] * phi[c]
        if degree >= 0:
            total += tail[o, 0]
        if degree >= 1:
            for i in range(n_in):
                total += tail[o, 1 + i] * z[i]
        if degree >= 2:
            at = 1 + n_in
            for i in range(n_in):
                for j in range(i, n_in):
                    total += tail[o, at] * z[i] * z[j]
                    at += 1
        out[o] = shift[o] + scale[o] * total
    return out
