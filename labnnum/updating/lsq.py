"""Damped least squares with bounds: Levenberg's and Marquardt's method, free variables by projection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Residual = Callable[[NDArray], tuple[NDArray, NDArray]]
"""x -> residuals, shape (m,), and Jacobian, shape (m, n)."""


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where damped least squares ended.

    Parameters
    ----------
    x : ndarray, shape (n,)
    cost : float
        Half the sum of squares there.
    steps : int
        Evaluations of residual and Jacobian.
    converged : bool
        The last step, or what a further one could gain, was negligible.
    """

    x: NDArray[np.float64]
    cost: float
    steps: int
    converged: bool


def least_squares(
    residual: Residual, start: NDArray, lower: NDArray, upper: NDArray, *, max_steps: int = 60, tolerance: float = 1e-9
) -> Minimum:
    """The minimum of half the sum of squared residuals with lower <= x <= upper.

    Parameters
    ----------
    residual : callable
        x to residuals and Jacobian; x should be scaled so that 1 is a natural step.
    start, lower, upper : ndarray, shape (n,)
    max_steps : int
        Evaluations after which it gives up (`converged` is then False).
    tolerance : float
        Relative gain of cost, or length of step, below which it stops.

    Notes
    -----
    Damping follows Nielsen's rule (Madsen, Nielsen and Tingleff, 2004, section 3.2). Variables at a bound that
    the gradient pushes outwards are held for the step.

    Examples
    --------
    >>> import numpy as np
    >>> def circle(x):
    ...     return np.array([x @ x - 2, x[0] - x[1]]), np.array([2 * x, [1.0, -1.0]])
    >>> least_squares(circle, np.array([3.0, 0.5]), np.zeros(2), np.full(2, 9.0)).x.round(6)
    array([1., 1.])
    """
    x = np.clip(np.asarray(start, float), lower, upper)
    r, jacobian = residual(x)
    cost, damping, growth, steps = _half(r), 1e-4, 2.0, 1
    while steps < max_steps:
        gradient = jacobian.T @ r
        free = ~(((x <= lower) & (gradient > 0)) | ((x >= upper) & (gradient < 0)))
        if not free.any() or np.abs(gradient[free]).max() == 0.0:
            return Minimum(x, cost, steps, True)
        moved = _bounded_step(jacobian, gradient, damping, free, lower - x, upper - x)
        trial = np.clip(x + moved, lower, upper)
        predicted = -(gradient @ moved) - _half(jacobian @ moved)
        if predicted < 0:
            damping, growth = damping * growth, growth * 2
            if damping > 1e16:
                return Minimum(x, cost, steps, True)
            continue
        if np.abs(moved).max() <= tolerance * 1e-2 or predicted <= tolerance * 1e-3 * cost:
            return Minimum(*_better(residual, x, cost, trial), steps + 1, True)
        r_new, jacobian_new = residual(trial)
        steps += 1
        new = _half(r_new)
        gain = (cost - new) / predicted if np.isfinite(new) else -1.0
        if gain > 0:
            x, r, jacobian, cost = trial, r_new, jacobian_new, new
            damping = float(max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), 1e-12))
            growth = 2.0
        else:
            damping, growth = damping * growth, growth * 2
            if damping > 1e16:
                return Minimum(x, cost, steps, False)
    return Minimum(x, cost, steps, False)


def _half(r: NDArray) -> float:
    return float(r @ r) / 2


def _bounded_step(
    jacobian: NDArray, gradient: NDArray, damping: float, free: NDArray, down: NDArray, up: NDArray
) -> NDArray[np.float64]:
    """Damped step within down <= step <= up: what would pass a bound stops there, the others are solved again."""
    normal = jacobian.T @ jacobian
    held, step = ~free, np.zeros_like(gradient)
    while not held.all():
        go = ~held
        step[go] = _damped_step(normal[np.ix_(go, go)], gradient[go] + normal[np.ix_(go, held)] @ step[held], damping)
        beyond = go & ((step < down) | (step > up))
        if not beyond.any():
            break
        step[beyond] = np.clip(step[beyond], down[beyond], up[beyond])
        held = held | beyond
    return step


def _damped_step(normal: NDArray, gradient: NDArray, damping: float) -> NDArray[np.float64]:
    """Solution of (N + damping diag(N)) step = -gradient; directions without slope stay where they are."""
    diagonal = np.diag(normal)
    root = 1 / np.sqrt(np.maximum(diagonal, max(1e-28 * diagonal.max(), 1e-300)))
    scaled = root[:, None] * normal * root
    scaled[np.diag_indices_from(scaled)] += damping
    return root * np.linalg.solve(scaled, -gradient * root)


def _better(residual: Residual, x: NDArray, cost: float, trial: NDArray) -> tuple[NDArray, float]:
    new = _half(residual(trial)[0])
    return (trial, new) if new <= cost else (x, cost)
