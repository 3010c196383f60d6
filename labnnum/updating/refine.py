"""Refinement: least squares on the FRF itself, whitened by its measured variance.

The model is seen through the same window as the data, slopes are exact (Atalla 1996, equation 4.35), and the
covariance knows that neighbouring lines share their error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import qmc

from labnnum.bands import Band
from labnnum.frf import Frf
from labnnum.parameters import Estimate
from labnnum.response import frf as model_frf
from labnnum.structures.base import Structure
from labnnum.updating import doubts
from labnnum.updating.covariance import estimate_covariance
from labnnum.updating.discrepancy import fit_discrepancy
from labnnum.updating.leaked import leaked
from labnnum.updating.lsq import Minimum, least_squares
from labnnum.updating.noise import Noise
from labnnum.updating.problem import Problem, chi_square, is_misfit, make_problem, memory
from labnnum.updating.seen import View, points_needed, view_of, view_settings

ResidualKind = Literal["complex", "log"]


_LINES = 2500
"""Most lines that enter where the model's error rules: neighbours would only repeat each other."""

_EXPLAINED = 2.0
"""chi2 up to which a model counts as complete where the noise is known by the FRF's roughness only."""

_RESTARTS = 6
"""Further starts, spread over the bounds, where nobody gave one and the nominal parameters lead to a misfit."""


@dataclass(frozen=True, eq=False)
class Fit:
    """An Estimate with what it was made from.

    Parameters
    ----------
    estimate : Estimate
    frequency : ndarray, shape (n_f,)
        Lines that were fitted, in Hz.
    measured, model : ndarray, shape (n_out, n_in, n_f)
        FRFs on these lines, the model at the estimate and through the window.
    slope : ndarray, shape (n_par, n_out, n_in, n_f)
        Exact derivatives there.
    noise : Noise
    steps : int
        Evaluations of the model.
    """

    estimate: Estimate
    frequency: NDArray[np.float64]
    measured: NDArray[np.complex128]
    model: NDArray[np.complex128]
    slope: NDArray[np.complex128]
    noise: Noise
    steps: int


def refine(
    structure: Structure,
    frf: Frf,
    start: ArrayLike | None = None,
    *,
    bands: Sequence[Band] = (),
    view: View | Literal["auto"] | None = "auto",
    prior: bool = False,
    floor: float | None = None,
    residual: ResidualKind = "complex",
    max_steps: int = 60,
) -> Estimate:
    r"""Parameters that bring the model's FRF closest to the measured one, with their covariance.

    Parameters
    ----------
    structure : Structure
    frf : Frf
        Measured; where it carries no variance, that is estimated from its roughness and a warning says so.
    start : array_like, shape (n_parameters,), optional
        From a network, say; the nominal values where absent.
    bands : sequence of Band
        Lines that count; all where empty.
    view : View or "auto" or None
        The window's view of the model, such as `labnnum.leakage.WindowView`. "auto" takes it from the FRF's
        settings, as finely as the structure's damping needs; None compares with the model itself.
    prior : bool
        Counts the parameters' priors (those with a std) as further data.
    floor : float, optional
        Relative error of the model that is added to every line's random error. By default 0 where the variance
        was measured; where it had to be estimated, the model's errors are estimated as well, see
        `labnnum.updating.discrepancy`.
    residual : {"complex", "log"}
        "log" fits log H, which suits errors proportional to |H|. Both approach on the Riemann sphere first, where
        H = infinity is a point like any other and a resonance that is off by its width still pulls.
    max_steps : int

    Raises
    ------
    EstimationError
        If there are fewer data than parameters.

    Notes
    -----
    .. math:: \min_\theta \sum_{o,i,f} 2\,|\hat H - H(\theta)|^2 / v,\quad v = E|dH|^2

    with the covariance (J'WJ)^-1 (J'W C W J) (J'WJ)^-1, C from `labnnum.updating.noise.line_correlation`. Where the
    misfit exceeds the random error, the covariance is widened by it and a warning is given.

    References
    ----------
    Atalla (1996), equations 2.45 and 4.35.
    """
    return fit(
        structure, frf, start, bands=bands, view=view, prior=prior, floor=floor, residual=residual, max_steps=max_steps
    ).estimate


def fit(
    structure: Structure,
    frf: Frf,
    start: ArrayLike | None = None,
    *,
    bands: Sequence[Band] = (),
    view: View | Literal["auto"] | None = "auto",
    prior: bool = False,
    floor: float | None = None,
    residual: ResidualKind = "complex",
    max_steps: int = 60,
) -> Fit:
    """The same as `refine`, with model, residuals and slopes at the estimate."""
    first = structure.nominal if start is None else np.asarray(start, float)
    search = _Search(floor, residual, max_steps, 0 if start is not None else _RESTARTS)
    if view != "auto":
        return search.run(make_problem(structure, frf, bands, view, prior), first)
    settings = view_settings(frf)
    found = search.run(make_problem(structure, frf, bands, view_of(frf, structure, first), prior), first)
    value = found.estimate.value
    if settings and points_needed(settings, structure, value) > 1.3 * points_needed(settings, structure, first):
        finer = make_problem(structure, frf, bands, view_of(frf, structure, value), prior)
        found = replace(search, restarts=0).run(finer, value)
    return found


def seen_frf(structure: Structure, theta: ArrayLike, frf: Frf) -> NDArray[np.complex128]:
    """FRF of the model at theta as the measurement `frf` would show it, on its lines and channels."""
    values = np.asarray(theta, float)
    view = view_of(frf, structure, values)
    if view is None:
        return model_frf(structure, values, frf.frequency, frf.outputs, frf.inputs)
    return view.apply(model_frf(structure, values, view.frequency, frf.outputs, frf.inputs))


@dataclass(frozen=True)
class _Search:
    """How a problem is solved."""

    floor: float | None
    residual: ResidualKind
    max_steps: int
    restarts: int

    def run(self, problem: Problem, first: NDArray) -> Fit:
        if self.floor is None and problem.noise.estimated:
            rough = _fit_with_discrepancy(problem.thinned(_LINES), first, self.max_steps)
            if rough.estimate.chi2 > _EXPLAINED:
                return rough
            first = rough.estimate.value
        problem = problem.with_floor(self.floor or 0.0)
        found = self._from(problem, first)
        if self.restarts and _misfits(problem, found.x):
            found = min([found, *self._elsewhere(problem)], key=lambda m: m.cost)
        return _summary(problem, found)

    def _from(self, problem: Problem, start: NDArray) -> Minimum:
        """On the sphere to the basin, then the residual that was asked for; straight there if that ends lower."""
        approach = self._approach(problem, problem.x(start), self.max_steps)
        found = self._final(problem, approach.x)
        if _misfits(problem, found.x):
            found = min(found, self._final(problem, problem.x(start)), key=lambda m: m.cost)
        return replace(found, steps=found.steps + approach.steps)

    def _elsewhere(self, problem: Problem) -> list[Minimum]:
        """What the best of some starts all over the bounds leads to."""
        low, high = problem.limits
        unit = qmc.Sobol(low.size, seed=0).random_base2(3)[: self.restarts]
        tried = [self._approach(problem, low + u * (high - low), 15) for u in unit]
        return [self._final(problem, min(tried, key=lambda m: m.cost).x)]

    def _approach(self, problem: Problem, x: NDArray, steps: int) -> Minimum:
        low, high = problem.limits
        return least_squares(problem.sphere_residual, np.clip(x, low, high), low, high, max_steps=steps, tolerance=1e-4)

    def _final(self, problem: Problem, x: NDArray) -> Minimum:
        residual = problem.complex_residual if self.residual == "complex" else problem.log_residual
        low, high = problem.limits
        return least_squares(residual, np.clip(x, low, high), low, high, max_steps=self.max_steps)


def _misfits(problem: Problem, x: NDArray) -> bool:
    value, _ = problem.model(problem.theta(x))
    return is_misfit(*chi_square(problem.frf.value - value, problem.noise, x.size))


def _fit_with_discrepancy(problem: Problem, start: NDArray, max_steps: int) -> Fit:
    """Fit of an FRF that states no random error: sizes of the model's errors are estimated too."""
    frf, n_pairs = problem.frf, problem.frf.value.shape[0] * problem.frf.value.shape[1]

    def model(x: NDArray) -> tuple[NDArray, NDArray]:
        value, slope = problem.model(problem.theta(x))
        steep = slope * problem.spread[:, None, None, None]
        return value.reshape(n_pairs, -1), steep.reshape(len(slope), n_pairs, -1)

    lower, upper = problem.limits
    size = np.maximum(np.abs(frf.value) ** 2, 1e-300)
    found = fit_discrepancy(
        model, frf.value.reshape(n_pairs, -1), (problem.noise.variance / size).reshape(n_pairs, -1),
        np.clip(problem.x(start), lower, upper), lower, upper, max_steps=max_steps,
    )  # fmt: skip
    theta = problem.theta(found.x)
    value, slope = problem.model(theta)
    covariance = found.covariance * np.outer(problem.spread, problem.spread)
    level = chi_square(frf.value - value, problem.noise, theta.size)[0]
    warnings = [doubts.roughness(found.level, found.line)]
    warnings += doubts.shifts(problem, theta)
    warnings += [*doubts.confused(problem, covariance), *doubts.at_bounds(problem.structure.parameters, theta)]
    warnings += [] if found.converged else [doubts.not_converged(found.steps)]
    estimate = Estimate(
        problem.structure.parameters, theta, covariance, "least squares, model error estimated", level,
        tuple(warnings), found.converged,
    )  # fmt: skip
    return Fit(estimate, frf.frequency, frf.value, value, slope, problem.noise, found.steps)


def _summary(problem: Problem, found: Minimum) -> Fit:
    theta = problem.theta(found.x)
    value, slope = problem.model(theta)
    difference = problem.frf.value - value
    level, scatter = chi_square(difference, problem.noise, theta.size)
    leak = leaked(problem.structure, theta, problem.frf, problem.noise.position) if problem.floor == 0.0 else None
    covariance = estimate_covariance(slope, problem.noise, problem.prior, problem.spread, leak)
    alone = estimate_covariance(slope, problem.noise, None, problem.spread, leak)
    warnings = [doubts.roughness()] if problem.noise.estimated else []
    warnings += [*doubts.confused(problem, alone), *doubts.at_bounds(problem.structure.parameters, theta)]
    if problem.floor == 0.0 and is_misfit(level, scatter):
        widening = level * max(1.0, memory(difference, problem.noise) / problem.noise.memory)
        covariance = covariance * widening
        warnings.append(doubts.misfit(level, widening))
        warnings += doubts.shifts(problem, theta)
    if not found.converged:
        warnings.append(doubts.not_converged(found.steps))
    estimate = Estimate(
        problem.structure.parameters, theta, covariance, "least squares", level, tuple(warnings), found.converged
    )
    return Fit(estimate, problem.frf.frequency, problem.frf.value, value, slope, problem.noise, found.steps)
