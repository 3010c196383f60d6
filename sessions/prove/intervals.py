"""Proportions with exact intervals, and the severity at which half are found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, expit


@dataclass(frozen=True)
class Share:
    """k of n, with the 95 % Clopper-Pearson interval."""

    k: int
    n: int

    @property
    def value(self) -> float:
        """K / n; NaN if n is 0."""
        return self.k / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the proportion (Clopper and Pearson, 1934)."""
        return clopper_pearson(self.k, self.n)

    def __str__(self) -> str:
        if not self.n:
            return "none"
        low, high = self.interval
        return f"{100 * self.value:.1f} % ({self.k} of {self.n}; {100 * low:.1f} to {100 * high:.1f})"


def clopper_pearson(k: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Exact interval of a binomial proportion.

    References
    ----------
    Clopper and Pearson (1934), Biometrika 26, 404-413.

    Examples
    --------
    >>> [round(x, 4) for x in clopper_pearson(0, 30)]
    [0.0, 0.1157]
    """
    if n == 0:
        return 0.0, 1.0
    tail = (1 - level) / 2
    low = float(betaincinv(k, n - k + 1, tail)) if k else 0.0
    high = float(betaincinv(k + 1, n - k, 1 - tail)) if k < n else 1.0
    return low, high


def count(flags: Sequence[bool]) -> Share:
    """Share of the true ones."""
    return Share(sum(bool(f) for f in flags), len(flags))


def half_point(severity: Sequence[float], found: Sequence[bool]) -> float:
    """Severity at which half are found, by logistic regression with a weak prior.

    NaN if all or none are, or if the cases do not tell: if the curve crosses half outside their severities.

    The prior (a normal slope about 10 per unit of severity, standard deviation 6) keeps small samples finite.
    """
    x, y = np.asarray(severity, float), np.asarray(found, float)
    if y.size == 0 or y.min() == y.max():
        return float("nan")
    p = np.array([-5.0, 10.0])
    for _ in range(60):
        p = p - np.linalg.solve(*_newton(p, x, y))
    half = float(-p[0] / p[1]) if p[1] > 0 else float("nan")
    return half if x.min() <= half <= x.max() else float("nan")


def _newton(p: NDArray, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """Curvature and slope of minus the log posterior of a logistic curve."""
    A = np.column_stack([np.ones_like(x), x])
    guess = expit(A @ p)
    weight = np.maximum(guess * (1 - guess), 1e-9)
    prior = np.array([[1 / 20.0**2, 0.0], [0.0, 1 / 6.0**2]])
    slope = A.T @ (guess - y) + prior @ (p - np.array([-5.0, 10.0]))
    return (A * weight[:, None]).T @ A + prior, slope
