"""Parameters of a model with their prior, and estimates of them with their covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ConfigError
from labnnum.recording import readonly


@dataclass(frozen=True, slots=True)
class Parameter:
    """One quantity of a model that may be updated, with its bounds and prior distribution.

    The prior is normal about `nominal` with standard deviation `std`, cut at the bounds; uniform
    between the bounds where `std` is None.
    """

    name: str
    nominal: float
    lower: float
    upper: float
    unit: str = "1"
    std: float | None = None

    def __post_init__(self) -> None:
        if not self.lower <= self.nominal <= self.upper or not self.lower < self.upper:
            raise ConfigError(
                f"parameter {self.name!r}: needs lower <= nominal <= upper and lower < upper, got"
                f" {self.lower:g}, {self.nominal:g}, {self.upper:g}"
            )
        if self.std is not None and not self.std > 0:
            raise ConfigError(f"parameter {self.name!r}: std {self.std:g} must be positive")

    @property
    def spread(self) -> float:
        """Standard deviation of the prior (that of the uniform distribution if `std` is None)."""
        return self.std if self.std is not None else (self.upper - self.lower) / np.sqrt(12.0)


def nominal(parameters: Sequence[Parameter]) -> NDArray[np.float64]:
    """Nominal values, shape (n_parameters,)."""
    return np.array([p.nominal for p in parameters], float)


def bounds(parameters: Sequence[Parameter]) -> NDArray[np.float64]:
    """Lower and upper bounds, shape (2, n_parameters)."""
    return np.array([[p.lower for p in parameters], [p.upper for p in parameters]], float).reshape(2, -1)


@dataclass(frozen=True, eq=False)
class Estimate:
    """Values of parameters with their covariance, and what to know before trusting them.

    Parameters
    ----------
    parameters : sequence of Parameter
    value : array_like, shape (n_parameters,)
        In each parameter's unit.
    covariance : array_like, shape (n_parameters, n_parameters)
    method : str
        How it was obtained, such as "network" or "network + least squares".
    chi2 : float
        Sum of whitened squared residuals divided by the degrees of freedom; near 1 when the model
        explains the data; NaN where no residual was formed.
    warnings : tuple of str
        Reasons to doubt the values: outside the training range, not identifiable, misfit, not converged.
    converged : bool
    """

    parameters: tuple[Parameter, ...]
    value: NDArray[np.float64]
    covariance: NDArray[np.float64]
    method: str = ""
    chi2: float = float("nan")
    warnings: tuple[str, ...] = ()
    converged: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        object.__setattr__(self, "value", readonly(self.value))
        object.__setattr__(self, "covariance", readonly(np.atleast_2d(self.covariance)))

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviations, shape (n_parameters,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation matrix, shape (n_parameters, n_parameters)."""
        s = self.std
        safe = np.where(s > 0, s, 1.0)
        return self.covariance / np.outer(safe, safe)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Name -> value, std and unit, as `--json` prints it."""
        return {
            p.name: {"value": float(v), "std": float(s), "unit": p.unit}
            for p, v, s in zip(self.parameters, self.value, self.std, strict=True)
        }

    def __getitem__(self, name: str) -> float:
        for p, v in zip(self.parameters, self.value, strict=True):
            if p.name == name:
                return float(v)
        raise KeyError(name)


def truncated_samples(parameters: Sequence[Parameter], uniform: ArrayLike, margin: float = 0.0) -> NDArray[np.float64]:
    """Map numbers in (0, 1), shape (n, n_parameters), to the parameters' prior.

    Parameters
    ----------
    uniform : array_like, shape (n, n_parameters)
        Random or Sobol numbers in the open unit cube.
    margin : float
        Fraction of the range by which uniform priors reach beyond the bounds on either side.
    """
    from scipy.special import ndtr, ndtri

    u = np.asarray(uniform, float)
    out = np.empty_like(u)
    for j, p in enumerate(parameters):
        reach = margin * (p.upper - p.lower)
        low, high = p.lower - reach, p.upper + reach
        if p.std is None:
            out[:, j] = low + (high - low) * u[:, j]
        else:
            a, b = ndtr((low - p.nominal) / p.std), ndtr((high - p.nominal) / p.std)
            out[:, j] = np.clip(p.nominal + p.std * ndtri(a + (b - a) * u[:, j]), low, high)
    return out
