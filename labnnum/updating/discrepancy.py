r"""Fits to FRFs whose random error nobody stated: the misfit itself tells how far to trust which part of the data.

An imported FRF is usually averaged so long that its noise is nothing beside what every model gets wrong: the level of
each FRF (calibration, where exactly the hammer struck) and its course from line to line. Of the log ratio of model
to measurement, each FRF gets a level error of its own, shared by all its lines, and each line a further error; the
size of both is estimated from the residuals, robustly. What such a fit trusts most is therefore the shape of an FRF,
and so its resonances and antiresonances.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.updating.covariance import stable_inverse
from labnnum.updating.lsq import Minimum, Residual, least_squares

_FREEDOM = 4.0
"""Degrees of freedom of Student's t, by which lines and FRFs that do not fit lose their weight."""

_LEAST = 1e-4
"""Smallest model error that is assumed, as a share of |H|."""

_PIECES = 6
"""Stretches of lines that count as independent where the FRFs are too few to be clusters."""

_CLOSE = 1e-5
"""Tolerance of each round; the next one starts from there."""

Model = Callable[[NDArray], tuple[NDArray, NDArray]]
"""x -> FRF (n_pairs, n_f) and its derivatives (n, n_pairs, n_f)."""


@dataclass(frozen=True, eq=False)
class DiscrepancyFit:
    """A fit that estimated the model's error with its parameters.

    Parameters
    ----------
    x : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
    level : float
        Error that all lines of an FRF share, as a share of |H| (0.1 is 10 %).
    line : float
        Error from line to line, likewise.
    steps : int
    converged : bool
    """

    x: NDArray[np.float64]
    covariance: NDArray[np.float64]
    level: float
    line: float
    steps: int
    converged: bool


@dataclass(frozen=True, eq=False)
class _Weights:
    """Inverse variances of the lines' own errors, (n_pairs, n_f), and of the FRFs' levels, (n_pairs,)."""

    line: NDArray[np.float64]
    level: NDArray[np.float64]


def fit_discrepancy(
    model: Model,
    measured: NDArray,
    random: NDArray,
    start: NDArray,
    lower: NDArray,
    upper: NDArray,
    *,
    rounds: int = 12,
    max_steps: int = 40,
) -> DiscrepancyFit:
    """Parameters that explain log FRFs best under level and line errors of unknown size.

    Parameters
    ----------
    model : callable
    measured : ndarray, shape (n_pairs, n_f)
    random : ndarray, shape (n_pairs, n_f)
        E|dH|^2 / |H|^2 of the random error.
    start, lower, upper : ndarray, shape (n,)
    rounds, max_steps : int
        Reweightings, and evaluations of the model in each.

    Notes
    -----
    Iteratively reweighted least squares for Student's t with 4 degrees of freedom, on both kinds of error; their
    scales are medians of absolute residuals.
    """
    level, line = 0.2, 0.2
    weights = _Weights(1 / (random / 2 + line**2), np.full(len(measured), 1 / level**2))
    x, steps, found = start, 0, Minimum(start, np.inf, 0, False)
    for _ in range(rounds):
        found = least_squares(
            _whitened(model, measured, weights), x, lower, upper, max_steps=max_steps, tolerance=_CLOSE
        )
        steps += found.steps
        moved = float(np.abs(found.x - x).max())
        x, before = found.x, (level, line)
        level, line, weights = _reweighted(_log_ratio(model(x)[0], measured), random)
        settled = abs(level / before[0] - 1) + abs(line / before[1] - 1) < 0.02
        if moved < 1e-4 and settled:
            break
    covariance = _clustered(*_whitened(model, measured, weights)(x), measured.shape)
    return DiscrepancyFit(x, covariance, level, line, steps, found.converged)


def _log_ratio(value: NDArray, measured: NDArray) -> NDArray:
    ratio = value / np.where(measured == 0, 1e-300, measured)
    return np.log(np.maximum(np.abs(ratio), 1e-300)) + 1j * np.angle(ratio)


def _whitened(model: Model, measured: NDArray, weights: _Weights) -> Residual:
    """Residuals and Jacobian under which both errors are independent and of unit size.

    C^-1/2 r with C = diag(1/line) + 11'/level, by shrinking the weighted mean of each FRF.
    """
    total = weights.line.sum(axis=-1)
    kept = 1 - np.sqrt(weights.level / (weights.level + total))

    def residual(x: NDArray) -> tuple[NDArray, NDArray]:
        value, slope = model(x)
        steep = slope / np.where(value == 0, 1e-300, value)
        rows = np.concatenate([_log_ratio(value, measured)[None], steep])
        mean = (rows * weights.line).sum(axis=-1) / total
        white = (np.sqrt(weights.line) * (rows - (kept * mean)[..., None])).reshape(len(rows), -1)
        real = np.concatenate([np.real(white), np.imag(white)], axis=-1)
        return real[0], real[1:].T

    return residual


def _reweighted(r: NDArray, random: NDArray) -> tuple[float, float, _Weights]:
    centre = np.median(np.real(r), axis=1) + 1j * np.median(np.imag(r), axis=1)
    inner = r - centre[:, None]
    level, line = _scale(centre, 0.0), _scale(inner, float(np.median(random)) / 2)
    variance = random / 2 + line**2
    own = _student(np.abs(inner) ** 2 / 2 / variance) / variance
    return level, line, _Weights(own, _student(np.abs(centre) ** 2 / 2 / level**2) / level**2)


def _scale(r: NDArray, random: float) -> float:
    """Standard deviation of one part (real or imaginary) by the median of |r|^2, random variance taken off."""
    return float(np.sqrt(max(np.median(np.abs(r) ** 2) / (2 * np.log(2)) - random, _LEAST**2)))


def _student(power: NDArray) -> NDArray[np.float64]:
    """Weight of a residual whose mean squared real and imaginary part is `power` scales."""
    return (_FREEDOM + 2) / (_FREEDOM + 2 * power)


def _clustered(residual: NDArray, jacobian: NDArray, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Covariance from the scatter of what each FRF (or, of few, each stretch of it) wants of the parameters.

    Errors of a model have no known correlation along the lines; between FRFs taken at other points they are
    independent. Liang and Zeger (1986), with the factor m / (m - n) for m clusters and n parameters.
    """
    n, (n_pairs, n_lines) = jacobian.shape[1], shape
    pieces = 1 if n_pairs >= 2 * n else _PIECES
    piece = np.arange(n_lines) * pieces // n_lines
    cluster = (np.arange(n_pairs)[:, None] * pieces + piece).reshape(-1)
    score = np.zeros((n_pairs * pieces, n))
    np.add.at(score, np.tile(cluster, 2), jacobian * residual[:, None])
    inverse = stable_inverse(jacobian.T @ jacobian)[0]
    m = len(score)
    return inverse @ (score.T @ score * m / max(m - n, 1)) @ inverse
