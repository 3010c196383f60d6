"""Maximum a posteriori fit of a structure with terms, allowing the ordinary errors that any model has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.objective import Normal, Problem
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.errors import ModelError
from labnnum.mechanisms.base import Term
from labnnum.mechanisms.changes import Change


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a fit ended: point, objective (whitened squares plus price of the model's errors), covariance."""

    point: Point
    objective: float
    data_part: float
    prior_part: float
    covariance: NDArray[np.float64]
    log_determinant: float
    terms: tuple[Term, ...]
    converged: bool

    @property
    def n_theta(self) -> int:
        """Number of the structure's parameters."""
        return self.point.theta.size


def changes_of(made: Fit) -> list[tuple[Change, NDArray[np.float64]]]:
    """The changes of the whole structure that a fit holds, with their parameters."""
    out, at = [], 0
    for t in made.terms:
        if t.whole is not None:
            out.append((t.whole, made.point.terms[at : at + t.n]))
        at += t.n
    return out


NEAR, RIVAL = 1e4, 10.0
"""Chi-square per value, and of the goal if there is one, below which what is marginalised is followed where it misleads
a fit."""
HASTE = 3.0
"""How much faster than in its last step a fit may be expected to descend."""


def fit(
    engine: Engine, data: Data, terms: Sequence[Term], scatter: Scatter, x: NDArray, *, steps: int = 12,
    tolerance: float = 0.05, goal: float | None = None, follow: bool = True,
) -> Fit:  # fmt: skip
    """Levenberg-Marquardt from `x` to the nearest maximum of the posterior.

    Parameters
    ----------
    x : ndarray, shape (n_x,)
        Start, in the order of `Point.vector`.
    steps : int
        At most.
    tolerance : float
        Ends when a step gains less than this in the objective (a chi-square).
    goal : float, optional
        An objective that another model has reached: ends where `HASTE` times the last gain in each step that is left
        would not lead there.
    follow : bool
        Whether what is marginalised is followed, at its cost, once the fit goes up where its model falls: held as it
        is at each step, what is marginalised misleads a fit whose ordinary errors are far from none.
    """
    problem = Problem(engine, data, terms, scatter)
    x = problem.clip(x)
    here = problem.normal(x)
    damping, converged = 1e-3, False
    best = (here, x)
    small, moving = 0, False
    near = NEAR * 2 * data.value.size if follow else 0.0
    near = near if goal is None else min(near, RIVAL * goal)
    for left in range(steps - 1, -1, -1):
        moved = False
        for _ in range(6):
            step = _step(problem, here, x, damping)
            trial = problem.clip(problem.centred(x, x + step))
            try:
                value = problem.anew(trial) if moving else problem.value(trial, here)
            except ModelError:  # a mass below nothing: too far
                value = np.inf
            if np.isfinite(value) and value < here.objective:
                moved = True
                break
            damping *= 8.0
        if not moved:
            converged = True
            break
        gain = here.objective - value
        x, damping = trial, max(damping / 6.0, 1e-9)
        here = problem.normal(x, moving=moving)
        if here.objective < best[0].objective:
            best = (here, x)
        elif not moving and best[0].objective + tolerance < here.objective and best[0].data_part < near:
            moving, damping, small, x = True, 1e-3, 0, best[1]
            here = problem.normal(x, moving=True)
            continue
        small = small + 1 if gain < max(tolerance, 1e-4 * value) else 0
        if small == 2 or (small and damping < 1e-4):
            converged = True
            break
        if goal is not None and value - goal > HASTE * gain * left:
            break
    here, x = best
    covariance, log_det = _covariance(here.hessian, problem, x)
    return Fit(
        problem.start.with_vector(x), here.objective, here.data_part, here.prior_part, covariance, log_det,
        tuple(terms), converged,
    )  # fmt: skip


def _step(problem: Problem, here: Normal, x: NDArray, damping: float) -> NDArray:
    step = np.zeros_like(x)
    d = problem.scale(here.hessian)
    g = here.gradient / d
    scaled = here.hessian / d / d[:, None]
    scaled.flat[:: d.size + 1] += damping
    if not (np.isfinite(scaled).all() and np.isfinite(g).all()):
        return step  # a response beyond all numbers leads nowhere
    held = ((x <= problem.low) & (g < 0)) | ((x >= problem.high) & (g > 0))
    free = np.flatnonzero(~held)
    step[free] = _solved(scaled[free[:, None], free], g[free]) / d[free]
    return step / max(1.0, float((np.abs(step) / problem.reach).max()))


def _solved(matrix: NDArray, rhs: NDArray) -> NDArray:
    """The solution, or the nearest thing to one where rounding leaves no damped matrix."""
    try:
        return np.linalg.solve(matrix, rhs)
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(matrix, rhs, rcond=1e-13)[0]


def _covariance(hessian: NDArray, problem: Problem, x: NDArray) -> tuple[NDArray, float]:
    weak = 1.0 / np.clip(problem.reach, 1e-100, 1e30) ** 2  # of what the data do not tell, its range tells
    hessian = np.nan_to_num(hessian, nan=0.0, posinf=0.0, neginf=0.0)
    np.fill_diagonal(hessian, np.maximum(np.diag(hessian), weak))
    d = np.sqrt(np.diag(hessian))
    scaled = hessian / np.outer(d, d)
    value, vector = np.linalg.eigh(scaled)
    value = np.maximum(value, 1e-12)
    inverse = (vector / value) @ vector.T / np.outer(d, d)
    return inverse, float(np.sum(np.log(value)) + 2 * np.sum(np.log(d)))
