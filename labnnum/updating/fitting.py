"""Training: the dissertation's network as printed, and one whose scales are tuned by exact leave-one-out.

With as many centres as samples the network interpolates (kernel matrix, Cholesky); with fewer it is a least
squares fit, done by QR because normal equations lose half of the digits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize

from labnnum.errors import EstimationError
from labnnum.updating.gains import affordable_powers, fit_gains
from labnnum.updating.kernels import KERNELS, kernel_values, squared_distances, tail_terms
from labnnum.updating.network import RbfNetwork
from labnnum.updating.regression import regress


def require_samples(features: NDArray, parameters: NDArray, least: int = 4) -> tuple[NDArray, NDArray]:
    """The two arrays as floats; EstimationError where they do not pair, are too few, or are not finite."""
    x, y = np.asarray(features, float), np.asarray(parameters, float)
    if x.ndim != 2 or y.ndim != 2 or len(x) != len(y):
        raise EstimationError(f"training needs rows of features and parameters in pairs, got {x.shape} and {y.shape}")
    if len(x) < least:
        raise EstimationError(f"training needs at least {least} samples, got {len(x)}: raise --samples")
    bad = ~(np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1))
    if bad.any():
        raise EstimationError(
            f"training sample {int(np.flatnonzero(bad)[0])} is not finite: the model is singular there"
        )
    return x, y


# ---------------------------------------------------------------- as printed


def fit_printed(
    features: NDArray, parameters: NDArray, *, gamma: float | None = 1.0, weights: NDArray | None = None
) -> RbfNetwork:
    r"""The dissertation's network: exp(-d), every sample a centre, distances weighted by sigma.

    Parameters
    ----------
    features : ndarray, shape (n, n_features)
    parameters : ndarray, shape (n, n_parameters)
    gamma : float or None
        Scale of the spread constants; None lets `descend_gamma` choose it on a quarter of the samples.
    weights : ndarray, shape (n_features,), optional
        Factors on the normalised inputs (1/rho of equation 4.48). An input that never varies gets no say.

    Notes
    -----
    .. math:: y = W h,\; h_j = e^{-d_j},\; d_j^2 = \sum_r \sigma_r^2 (x_r - c_{r,j})^2,\; \sigma_r = \gamma\,std(x_r)

    with x normalised to [0, 1]; outputs normalised likewise. Equation 4.38 multiplies by sigma, equation 3.20
    divides; only multiplying makes gamma = 1 "a very good initial guess".

    References
    ----------
    Atalla (1996), equations 4.2, 4.3, 4.10, 4.11, 4.37, 4.38 and 4.48.
    """
    x, y = require_samples(features, parameters)
    low, span = x.min(axis=0), np.ptp(x, axis=0)
    alive = span > 1e-12 * np.maximum(np.abs(low), np.abs(low + span))
    if not alive.any():
        raise EstimationError("no feature varies over the training set: the bands do not see the parameters")
    span = np.where(alive, span, np.inf)
    unit = (x - low) / span
    sigma = unit.std(axis=0)
    factor = np.ones_like(span) if weights is None else np.asarray(weights, float)
    shift, scale = y.mean(axis=0), y.std(axis=0)
    z, t = unit * factor * sigma, (y - shift) / scale
    if gamma is None:
        gamma = descend_gamma(z, t)
    solution = _interpolate(np.sqrt(squared_distances(z, z)) * gamma, t)
    return RbfNetwork(
        origin=low,
        projection=np.diag(gamma * factor * sigma / span),
        centres=gamma * z,
        weights=solution,
        tail=np.empty((0, y.shape[1])),
        degree=-1,
        kernel="exponential",
        shift=shift,
        scale=scale,
        residual=_printed_residual(z * gamma, t, scale),
        kind="printed",
        gamma=float(gamma),
    )


def _interpolate(distance: NDArray, targets: NDArray) -> NDArray[np.float64]:
    """W of equation 4.3; the kernel exp(-d) is positive definite for distinct samples."""
    kernel = np.exp(-distance)
    kernel[np.diag_indices_from(kernel)] += 1e-13
    try:
        return linalg.cho_solve(linalg.cho_factor(kernel, lower=True, check_finite=False), targets)
    except linalg.LinAlgError:
        return np.linalg.lstsq(kernel, targets, rcond=None)[0]


def _printed_residual(z: NDArray, t: NDArray, scale: NDArray) -> NDArray[np.float64]:
    kernel = np.exp(-np.sqrt(squared_distances(z, z)))
    kernel[np.diag_indices_from(kernel)] += 1e-13
    inverse = np.linalg.inv(kernel)
    error = (inverse @ t) / np.diag(inverse)[:, None]
    return (error.T @ error) / len(t) * np.outer(scale, scale)


def descend_gamma(z: NDArray, t: NDArray, *, start: float = 1.0, steps: int = 12, seed: int = 0) -> float:
    """The gamma that gradient descent reaches on held-out samples, from `start`.

    Parameters
    ----------
    z : ndarray, shape (n, n_features)
        Inputs already weighted by std (gamma = 1).
    t : ndarray, shape (n, n_parameters)
        Normalised targets.

    Notes
    -----
    The descent runs in log gamma, so that gamma stays positive, with a step that halves whenever the error
    would grow. On clean data it drifts towards 0, where exp(-gamma d) becomes the linear spline.

    References
    ----------
    Atalla (1996), equations 4.13 to 4.27.
    """
    order = np.random.default_rng(seed).permutation(len(z))
    held, kept = order[: len(z) // 4], order[len(z) // 4 :]
    inner = np.sqrt(squared_distances(z[kept], z[kept]))
    outer = np.sqrt(squared_distances(z[held], z[kept]))
    log_gamma, rate = np.log(start), 1.0
    error, slope = gamma_gradient(np.exp(log_gamma), inner, outer, t[kept], t[held])
    for _ in range(steps):
        step = -rate * np.sign(slope) * min(1.0, abs(slope) * np.exp(log_gamma) / max(error, 1e-300))
        trial, trial_slope = gamma_gradient(np.exp(log_gamma + step), inner, outer, t[kept], t[held])
        if trial < error:
            log_gamma, error, slope = log_gamma + step, trial, trial_slope
        else:
            rate /= 2
    return float(np.exp(log_gamma))


def gamma_gradient(
    gamma: float, inner: NDArray, outer: NDArray, known: NDArray, wanted: NDArray
) -> tuple[float, float]:
    """Error of equation 4.13 on held-out samples and its derivative to gamma (equation 4.24).

    Parameters
    ----------
    gamma : float
    inner : ndarray, shape (n, n)
        Distances among training samples at gamma = 1.
    outer : ndarray, shape (n_held, n)
        Distances from held-out samples to training samples.
    known, wanted : ndarray, shapes (n, n_parameters) and (n_held, n_parameters)
    """
    h_train, h_held = np.exp(-gamma * inner), np.exp(-gamma * outer)
    h_train[np.diag_indices_from(h_train)] += 1e-13
    factor = linalg.cho_factor(h_train, lower=True, check_finite=False)
    w = linalg.cho_solve(factor, known)
    error = wanted - h_held @ w
    by_weights = linalg.cho_solve(factor, (inner * h_train) @ w)
    slope = h_held @ by_weights - (outer * h_held) @ w
    n = len(wanted)
    return float((error**2).sum() / (2 * n)), float(-(error * slope).sum() / n)


# ---------------------------------------------------------------- tuned


@dataclass(frozen=True)
class Scales:
    """What leave-one-out chose: a length for each principal component, and the ridge."""

    lengths: NDArray[np.float64]
    ridge: float
    error: float


def fit_tuned(
    features: NDArray,
    parameters: NDArray,
    *,
    kernel: str = "gaussian",
    degree: int = 2,
    centres: int | None = None,
    components: int | None = None,
    most: int = 24,
    tune: int = 400,
    seed: int = 0,
) -> RbfNetwork:
    """A network whose scales minimise its exact leave-one-out error.

    Parameters
    ----------
    features : ndarray, shape (n, n_features)
    parameters : ndarray, shape (n, n_parameters)
    kernel : str
        A key of `KERNELS`.
    degree : int
        Of the polynomial tail: -1 none, 0, 1 or 2.
    centres : int, optional
        Number of centres; all samples where absent. Fewer than samples: least squares by QR.
    components : int, optional
        Principal components that enter; by default those above 1e-9 of the variance, at most `most`.
    most : int
    tune : int
        Samples (the first ones) on which the scales are tuned.
    seed : int
        Chooses the centres where they are fewer than the samples.

    Notes
    -----
    Leave-one-out error of an interpolant with tail: e_i = (B y)_i / B_ii, B the leading block of the inverse of
    the bordered kernel matrix (Dubrule, 1983). Of a least squares fit: e_i / (1 - leverage_i).
    """
    x, y = require_samples(features, parameters)
    origin, rotation = principal_components(x, components, most=most)
    shift, scale = y.mean(axis=0), y.std(axis=0)
    if not (scale > 0).all():
        raise EstimationError("a parameter is the same in all training samples: widen its bounds or drop it")
    t, z = (y - shift) / scale, (x - origin) @ rotation
    n_centres = len(z) if centres is None else min(centres, len(z))
    few = min(tune, n_centres)
    first = _affordable_degree(degree, z.shape[1], few)
    scales = tune_scales(z[:few], t[:few], kernel, first)
    degree = first if n_centres == len(z) else _affordable_degree(degree, z.shape[1], len(z) - n_centres)
    u = z / scales.lengths
    if n_centres == len(z):
        where, (w, v, error) = u, _solve_interpolant(u, t, kernel, degree, scales.ridge)
    else:
        chosen = np.sort(np.random.default_rng(seed).choice(len(u), n_centres, replace=False))
        where = u[chosen]
        w, v, error = _solve_least_squares(u, t, where, kernel, degree)
    gains, reach, error = _second_stage(u, t, error, n_centres)
    return RbfNetwork(
        origin=origin,
        projection=rotation / scales.lengths,
        centres=where,
        weights=w,
        tail=v,
        degree=degree,
        kernel=kernel,
        shift=shift,
        scale=scale,
        residual=(error.T @ error) / len(t) * np.outer(scale, scale),
        gains=gains,
        reach=reach,
    )


def _second_stage(u: NDArray, t: NDArray, error: NDArray, centres: int) -> tuple[NDArray, NDArray, NDArray]:
    """Gains, reach and leave-one-out errors: a second stage where samples are many and leave-one-out prefers it."""
    none = np.empty((0, 1 + u.shape[1], t.shape[1])), np.empty(0), error
    powers = affordable_powers(len(u), u.shape[1], t.shape[1])
    if centres == len(u) or not powers:
        return none
    found = fit_gains(t - error, u, t, powers)
    before, after = ((e**2).mean(axis=0) for e in (error, found[2]))
    return found if np.log(after / before).mean() < 0 else none


def principal_components(
    x: NDArray, components: int | None = None, floor: float = 1e-9, most: int = 24
) -> tuple[NDArray, NDArray]:
    """Mean (n_features,) and the map (n_features, k) to principal components of unit variance.

    Features are standardised first; one that never varies gets no say.
    """
    mean, std = x.mean(axis=0), x.std(axis=0)
    alive = std > 1e-12 * np.maximum(np.abs(mean), 1e-300)
    if not alive.any():
        raise EstimationError("no feature varies over the training set: the bands do not see the parameters")
    inverse = np.where(alive, 1 / np.where(alive, std, 1.0), 0.0)
    unit = (x - mean) * inverse
    _, singular, rows = np.linalg.svd(unit, full_matrices=False)
    variance = singular**2 / len(x)
    keep = int((variance > floor * variance.sum()).sum()) if components is None else components
    keep = max(1, min(keep, most if components is None else keep, int((variance > 1e-14 * variance[0]).sum())))
    return mean, inverse[:, None] * rows[:keep].T / np.sqrt(variance[:keep])


def _affordable_degree(degree: int, inputs: int, samples: int) -> int:
    """The highest degree up to `degree` whose terms are at most a third of the samples."""
    for d in range(degree, -1, -1):
        if tail_terms(np.zeros((1, inputs)), d).shape[1] <= samples // 3:
            return d
    return -1


def tune_scales(z: NDArray, t: NDArray, kernel: str, degree: int, steps: int = 60) -> Scales:
    """Lengths and ridge that minimise the leave-one-out error over (z, t), by its exact gradient."""
    k = z.shape[1]
    start = np.concatenate([np.full(k, np.log(2 * np.sqrt(k))), [np.log(1e-8)]])
    limits = [(np.log(0.3), np.log(300.0))] * k + [(np.log(1e-13), np.log(10.0))]
    terms = tail_terms(z, degree)
    found = optimize.minimize(
        _loo_objective,
        start,
        (z, t, terms, KERNELS[kernel]),
        jac=True,
        method="L-BFGS-B",
        bounds=limits,
        options={"maxiter": steps},
    )
    return Scales(np.exp(found.x[:-1]), float(np.exp(found.x[-1])), float(found.fun))


def _loo_objective(log_scales: NDArray, z: NDArray, t: NDArray, terms: NDArray, profile) -> tuple[float, NDArray]:
    """Mean over outputs of log(mean squared leave-one-out error), and its gradient to the log scales."""
    u = z / np.exp(log_scales[:-1])
    ridge = np.exp(log_scales[-1])
    phi, slope = profile(squared_distances(u, u))
    kernel = phi.copy()
    kernel[np.diag_indices_from(kernel)] += ridge
    bordered = _projected_inverse(kernel, terms)
    if bordered is None:
        return 50.0, np.zeros_like(log_scales)
    diagonal = np.diag(bordered)
    alpha = bordered @ t
    error = alpha / diagonal[:, None]
    mean = (error**2).mean(axis=0)
    value = float(np.log(mean).mean())
    by_error = 2 * error / (len(t) * mean * t.shape[1])
    by_alpha = by_error / diagonal[:, None]
    by_diagonal = -(by_error * error).sum(axis=1) / diagonal
    half = bordered @ (by_alpha @ t.T @ bordered + by_diagonal[:, None] * bordered)
    by_kernel = -(half + half.T) / 2
    spread = by_kernel * slope
    row_sum = spread.sum(axis=1)
    by_lengths = -4 * ((u**2).T @ row_sum - np.einsum("ik,ik->k", u, spread @ u))
    return value, np.append(by_lengths, ridge * np.trace(by_kernel))


def _projected_inverse(kernel: NDArray, terms: NDArray) -> NDArray[np.float64] | None:
    """B = K^-1 - K^-1 P (P' K^-1 P)^-1 P' K^-1; None where K is not positive definite to rounding."""
    try:
        lower = linalg.cholesky(kernel, lower=True, check_finite=False)
    except linalg.LinAlgError:
        return None
    inverse = linalg.solve_triangular(lower, np.eye(len(lower)), lower=True, check_finite=False)
    if terms.shape[1]:
        basis = np.linalg.qr(inverse @ terms)[0]
        inverse = inverse - basis @ (basis.T @ inverse)
        return inverse.T @ inverse
    return inverse.T @ inverse


def _solve_interpolant(
    u: NDArray, t: NDArray, kernel: str, degree: int, ridge: float
) -> tuple[NDArray, NDArray, NDArray]:
    """Weights, tail weights and leave-one-out errors with every sample a centre."""
    matrix = kernel_values(kernel, squared_distances(u, u))
    terms = tail_terms(u, degree)
    for _ in range(12):
        loaded = matrix.copy()
        loaded[np.diag_indices_from(loaded)] += ridge
        bordered = _projected_inverse(loaded, terms)
        if bordered is not None:
            break
        ridge *= 10
    else:
        raise EstimationError("the kernel matrix is singular: are all training samples the same?")
    factor = linalg.cho_factor(loaded, lower=True, check_finite=False)
    solved = linalg.cho_solve(factor, np.hstack([terms, t]))
    q = terms.shape[1]
    tail = (
        np.linalg.lstsq(terms.T @ solved[:, :q], terms.T @ solved[:, q:], rcond=None)[0]
        if q
        else np.empty((0, t.shape[1]))
    )
    weights = solved[:, q:] - solved[:, :q] @ tail
    error = (bordered @ t) / np.diag(bordered)[:, None]
    return weights, tail, error


def _solve_least_squares(
    u: NDArray, t: NDArray, centres: NDArray, kernel: str, degree: int
) -> tuple[NDArray, NDArray, NDArray]:
    """Weights, tail weights and leave-one-out errors with fewer centres."""
    found = regress(
        lambda part: tail_terms(u[part], degree),
        lambda part: kernel_values(kernel, squared_distances(u[part], centres)),
        t,
    )
    return found.body, found.head, found.errors
