"""A network compiled for one feature vector at a time: for estimates inside a control loop, within microseconds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.updating.gains import powers_of
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
    if not network.gains.size:

        def answer(features: NDArray) -> NDArray[np.float64]:
            return shift + scale * _answer(features, rows, offset, centres, weights, tail, degree)[1]

        return answer
    gains, reach = np.ascontiguousarray(network.gains.transpose(0, 2, 1)), np.array(network.reach)
    powers = powers_of(gains, reach.size)

    def second(features: NDArray) -> NDArray[np.float64]:
        z, first = _answer(features, rows, offset, centres, weights, tail, degree)
        return shift + scale * _second(z, first, gains, reach, powers)

    return second


@njit(cache=True, fastmath=True)
def _answer(x, rows, offset, centres, weights, tail, degree):  # pragma: no cover - compiled
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
        out[o] = total
    return z, out


@njit(cache=True, fastmath=True)
def _second(z, first, gains, reach, powers):  # pragma: no cover - compiled
    n_in, n_out = z.size, first.size
    terms = np.empty(gains.shape[0])
    terms[0] = 1.0
    p = np.empty(n_out)
    for i in range(n_out):
        p[i] = min(max(first[i] / reach[i], -1.0), 1.0)
        before, last = 1.0, p[i]
        terms[1 + i] = last
        for d in range(1, powers):
            before, last = last, 2 * p[i] * last - before
            terms[1 + d * n_out + i] = last
    at = 1 + powers * n_out
    for i in range(n_out):
        for j in range(i + 1, n_out):
            terms[at] = p[i] * p[j]
            at += 1
    out = np.zeros(n_out)
    for a in range(terms.size):
        for o in range(n_out):
            total = gains[a, o, 0]
            for i in range(n_in):
                total += gains[a, o, 1 + i] * z[i]
            out[o] += terms[a] * total
    return out
