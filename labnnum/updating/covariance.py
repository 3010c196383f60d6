"""Covariance of a least squares estimate under errors that neighbouring lines and responses share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.parameters import Parameter
from labnnum.updating.leaked import Leaked, leaked_score
from labnnum.updating.noise import Noise


def information(slope: NDArray, noise: Noise) -> NDArray[np.float64]:
    """J' W J, shape (n_par, n_par), of complex slopes (n_par, n_out, n_in, n_f) with W = 2 / variance."""
    flat = (slope * np.sqrt(noise.weight)).reshape(len(slope), -1)
    return np.real(flat @ flat.conj().T)


def score_covariance(slope: NDArray, noise: Noise) -> NDArray[np.float64]:
    r"""Covariance of the gradient J' W e, shape (n_par, n_par), errors e correlated as `noise` says.

    Notes
    -----
    .. math:: \tfrac12 \mathrm{Re} \sum_{f, g} \bar\jmath_f w_f\, C_{fg}\, w_g j_g^T,\quad
              C_{fg} = r(|f - g|) \sqrt{v_f v_g}

    a sandwich whose filling is known beforehand, so that it has no sampling error of its own.
    """
    rows = slope * noise.weight * np.sqrt(noise.variance)
    total = np.zeros((len(slope), len(slope)))
    for lag, correlation in enumerate(noise.lags):
        first, second = _pairs(noise.position, lag)
        share = np.real(correlation * _paired(rows[..., first], rows[..., second], noise, first, second))
        total += (share if lag == 0 else share + share.T) / 2
    return total


def _pairs(position: NDArray, lag: int) -> tuple[NDArray, NDArray]:
    """Numbers of the lines that lie `lag` steps apart."""
    if lag == 0:
        every = np.arange(position.size)
        return every, every
    at = np.searchsorted(position, position + lag)
    inside = at < position.size
    match = np.zeros(position.size, bool)
    match[inside] = position[at[inside]] == position[inside] + lag
    first = np.flatnonzero(match)
    return first, at[first]


def _paired(a: NDArray, b: NDArray, noise: Noise, first: NDArray, second: NDArray) -> NDArray[np.complex128]:
    if noise.outputs is None:
        n = len(a)
        return a.reshape(n, -1).conj() @ b.reshape(n, -1).T
    between = (noise.outputs[..., first] + noise.outputs[..., second]) / 2
    return np.einsum("aoif,opf,bpif->ab", a.conj(), between, b, optimize=True)


def estimate_covariance(
    slope: NDArray,
    noise: Noise,
    prior: NDArray | None = None,
    scale: NDArray | None = None,
    leak: Leaked | None = None,
) -> NDArray[np.float64]:
    """Covariance of the parameters, shape (n_par, n_par); infinite variances become very large ones.

    Parameters
    ----------
    slope : ndarray, shape (n_par, n_out, n_in, n_f)
        Derivative of the model's FRF.
    noise : Noise
    prior : ndarray, shape (n_par,), optional
        Information of a prior, 1/std^2 (0 where there is none).
    scale : ndarray, shape (n_par,), optional
        Natural size of each parameter, for conditioning.
    leak : Leaked, optional
        The part of the error that is leakage, which lines share in another way than noise.
    """
    size = np.ones(len(slope)) if scale is None else scale
    scaled = slope * size[:, None, None, None]
    held = np.zeros(len(slope)) if prior is None else prior * size**2
    inner = information(scaled, noise) + np.diag(held)
    inverse, lift = stable_inverse(inner)
    filling = np.diag(held) + lift
    if leak is None:
        filling = filling + score_covariance(scaled, noise)
    else:
        filling = filling + score_covariance(scaled, replace(noise, variance=leak.noise))
        filling = filling + leaked_score(scaled * noise.weight, leak.error, noise.position)
    covariance = inverse @ filling @ inverse
    return (covariance + covariance.T) / 2 * np.outer(size, size)


def stable_inverse(a: NDArray, floor: float = 1e-13) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Inverse of a positive semidefinite matrix whose eigenvalues are lifted to `floor` of the largest, and the lift.

    Eigenvalues are those after scaling to unit diagonal.
    """
    diagonal = np.diag(a)
    size = np.sqrt(np.where(diagonal > 0, diagonal, max(float(diagonal.max(initial=0.0)), 1.0) * floor))
    values, vectors = np.linalg.eigh(a / np.outer(size, size))
    lifted = np.maximum(values, floor * max(float(values.max(initial=1.0)), 1e-300))
    half = vectors / np.sqrt(lifted) / size[:, None]
    rest = vectors * np.sqrt(lifted - values) * size[:, None]
    return half @ half.T, rest @ rest.T


def confusions(
    covariance: NDArray, parameters: Sequence[Parameter], limit: float = 0.5
) -> tuple[tuple[float, tuple[str, ...]], ...]:
    """Combinations of parameters that the data leave open: (relative spread, names), worst first.

    Parameters
    ----------
    covariance : ndarray, shape (n_par, n_par)
        From the data alone.
    parameters : sequence of Parameter
        Their `spread` is the yardstick.
    limit : float
        A direction in parameter space counts as open if its standard deviation exceeds this share of the prior
        spread.
    """
    spread = np.array([p.spread for p in parameters])
    values, vectors = np.linalg.eigh(covariance / np.outer(spread, spread))
    found = []
    for value, vector in sorted(zip(values, vectors.T, strict=True), key=lambda pair: -pair[0]):
        size = float(np.sqrt(max(value, 0.0)))
        if size > limit:
            names = tuple(p.name for p, v in zip(parameters, vector, strict=True) if abs(v) > 0.3)
            found.append((size, names))
    return tuple(found)
