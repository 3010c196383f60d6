"""Levenberg-Marquardt on the joint objective, and where it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.orbit import Orbit, scaled
from labnnum.diagnosis.nonlinear.problem import Acting, Joint, reduced
from labnnum.diagnosis.nonlinear.receptance import cords, per_place
from labnnum.errors import EstimationError, ModelError
from labnnum.structures.modal import ModalStructure

SHORT, STALLS = 0.03, 2
"""Damping from which on a step is a short one, and how often such a step may gain little before a fit ends."""
UNTOLD = 1e-24
"""Curvature of the objective, in units of `scale`, that stands for what neither data nor a prior tell of an entry: a
deviation so large that nobody takes it for a figure, where none at all would look like certainty."""
EXACT = 80
"""Entries of the base model's vector up to which their tangents are marched."""


@dataclass(frozen=True, eq=False)
class Made:
    """Where a fit ended; `n_base` entries of `x` are the base's, `bare` of them not of the laws' places."""

    x: NDArray[np.float64]
    objective: float
    data_part: float
    prior_part: float
    covariance: NDArray[np.float64]
    orbits: tuple[Orbit | None, ...]
    terms: tuple[Acting, ...]
    n_base: int
    bare: int
    count: int
    converged: bool
    sure: bool = False
    """Whether the standard deviations hold that neighbouring lines are wrong together."""

    def law(self, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Parameters of the i-th law and their standard deviations."""
        first = self.n_base + sum(t.n for t in self.terms[:i])
        at = slice(first, first + self.terms[i].n)
        return self.x[at], np.sqrt(np.maximum(np.diag(self.covariance)[at], 0))

    def whole(self, i: int) -> NDArray[np.float64]:
        """All that says what the i-th law is, (N_P,)."""
        return self.terms[i].held(self.law(i)[0])


def fit(
    joint: Joint, x: NDArray, orbits: Sequence[Orbit | None], *, steps: int = 10, tolerance: float = 1e-3,
    floor: float = 1.0, exact: bool = True, always: bool = False,
) -> Made:  # fmt: skip
    """Levenberg-Marquardt from `x`; ends when a step gains less than `tolerance` of the objective and `floor`.

    `exact` slopes are marched where the base model's vector is short (`EXACT`), or `always`: standard deviations need
    them. Such a fit does not end either where a step gains little because it was a short one. One that falls too slowly
    to come below the objective's `limit` in the steps that are left ends at once.
    """
    joint.exact = always or (exact and joint.n_base <= EXACT)
    scale = joint.scale
    x, orbits, _ = _evened(joint, joint.begin(x), orbits)
    orbits = calmed(joint, x, joint.settle(x, orbits, 14))
    damping, converged = 1e-3, False
    prior = (scale / joint.std) ** 2
    best: tuple[float, NDArray, Any, NDArray, NDArray] | None = None
    reach = np.concatenate([_reach(joint), np.full(x.size - joint.n_base, 0.7)])
    stalled = 0
    left = steps
    while left > 0:
        left -= 1
        try:
            jac, orbits = joint.slopes(x, orbits)
        except EstimationError:
            break
        value, gradient, hessian, held = _model(joint, x, orbits, jac)
        if best is None or value < best[0]:
            best = (value, x, orbits, hessian, jac)
        moved = False
        for _ in range(5):
            trial = _step(joint, x, gradient, hessian, damping, reach)
            after, found = _tried(joint, trial, orbits, held)
            if np.isfinite(after) and after < value:
                moved = True
                break
            damping *= 6.0
        if not moved:
            converged = True
            break
        x, orbits, less = _evened(joint, trial, found)
        if less:
            orbits = joint.settle(x, orbits, 8)
        if joint.restless(orbits) and joint.refine():
            orbits, best = joint.settle(x, orbits, 14), None  # what longer steps left tells nothing
            left = max(left, 1)
            continue
        gain = value - after + less
        if steps - left > 1 and _hopeless(value, after, left, joint.limit * joint.values):
            break
        if gain < max(tolerance * value, floor):
            stalled += 1
            if not always or damping < SHORT or stalled > STALLS:
                converged = True
                break
            damping = 1e-3  # a short step gains little wherever it is made
        else:
            damping = max(damping / 5.0, 1e-8)
    if best is None:
        raise EstimationError("the steady response does not settle at the start of the fit")
    r, b = joint.parts(x, orbits)
    value = reduced(r, b)[0] + joint.price(x)
    if best[0] < value:
        value, x, orbits = best[0], best[1], best[2]
    if not (np.diag(best[3]) >= 0).all():  # what is marginalised explains more than all, beyond what numbers hold
        raise EstimationError("the response at the end of the fit is beyond all numbers")
    hessian = best[3] + np.diag(np.where(np.diag(best[3]) < UNTOLD, UNTOLD, 0.0))
    d = np.sqrt(np.diag(hessian))
    inverse = np.linalg.pinv(hessian / np.outer(d, d), rcond=1e-12) / np.outer(d, d)
    price = joint.price(x)
    if always:
        grown = np.sqrt(_together(joint, best[4], r, b, inverse, prior, max(1.0, (value - price) / r.size)))
        inverse *= np.outer(grown, grown)
    covariance = inverse * np.outer(scale, scale)
    return Made(
        x,
        value,
        value - price,
        price,
        covariance,
        tuple(orbits),
        joint.terms,
        joint.n_base,
        joint.n_base - joint.k * per_place(joint.engine),
        int(r.size),
        converged,
        always,
    )


def calmed(joint: Joint, x: NDArray, orbits: Sequence[Orbit | None]) -> Sequence[Orbit | None]:
    """Steady states at `x`, with shorter steps where the march does not settle with those it has."""
    while joint.restless(orbits) and joint.refine():
        orbits = joint.settle(x, [None] * len(orbits), 14)
    return orbits


SWIFTER = 2.0
"""How many of its last steps each step that is left may be worth, for a fit to be given up."""


def _hopeless(before: float, after: float, left: int, limit: float) -> bool:
    """Whether an objective that fell like this in a step stays above the limit in the steps that are left."""
    return after > limit and after * (after / before) ** (SWIFTER * left) > limit


EVEN = 0.3
"""Fall of the price from which a law and the motions at its place are evened."""


def _evened(
    joint: Joint, x: NDArray, orbits: Sequence[Orbit | None]
) -> tuple[NDArray, Sequence[Orbit | None], float]:  # fmt: skip
    """The vector with what places and laws share put where it costs least, its steady states, and by how much less.

    Not of an identified base: beside sweeps in which dry friction holds, whose marches do not settle, the objective of
    such a fit jumps, and one that was evened ended early.
    """
    if not joint.k or isinstance(joint.engine.structure, ModalStructure):
        return x, orbits, 0.0
    even, factor = joint.evened(x)
    less = joint.price(x) - joint.price(even)
    if less < EVEN:
        return x, orbits, 0.0
    return joint.begin(even), [None if o is None else scaled(o, factor) for o in orbits], less


def _model(
    joint: Joint, x: NDArray, orbits: Sequence[Orbit | None], jac: NDArray
) -> tuple[float, NDArray, NDArray, tuple[NDArray, NDArray]]:  # fmt: skip
    """Objective at `x`, its gradient and Gauss-Newton Hessian (halved, in units of `scale`), what is marginalised with
    its gram matrix.
    """
    scale = joint.scale
    prior = (scale / joint.std) ** 2
    r, b = joint.parts(x, orbits)
    part, gram, inner = reduced(r, b)
    bj = np.matmul(b, jac.transpose(0, 2, 1))
    hessian = np.matmul(jac, jac.transpose(0, 2, 1)).sum(axis=0)
    hessian -= np.matmul(bj.transpose(0, 2, 1), np.linalg.solve(gram, bj)).sum(axis=0)
    gradient = np.matmul(jac, r[..., None]).sum(axis=0)[:, 0]
    gradient -= np.matmul(bj.transpose(0, 2, 1), inner[..., None]).sum(axis=0)[:, 0]
    gradient -= prior * (x - joint.mean) / scale * np.isfinite(joint.std)
    return part + joint.price(x), gradient, hessian + np.diag(prior), (b, gram)


def promised(joint: Joint, made: Made) -> tuple[float, float, NDArray[np.float64]]:
    """Objective where a fit ended, by how much it would fall by an undamped step were it quadratic, and where that
    step leads.

    A fit ends too where a valley turns: its steps are short there, and each gains little.
    """
    joint.exact = True
    try:
        jac, orbits = joint.slopes(made.x, joint.settle(made.x, made.orbits, 8))
        value, gradient, hessian, _ = _model(joint, made.x, orbits, jac)
    except EstimationError:
        return made.objective, 0.0, made.x
    there = _step(joint, made.x, gradient, hessian, 1e-9, np.full(made.x.size, np.inf))
    step = (there - made.x) / joint.scale
    return value, float(2.0 * gradient @ step - step @ hessian @ step), there


def _tried(
    joint: Joint, x: NDArray, orbits: Sequence[Orbit | None], held: tuple[NDArray, NDArray]
) -> tuple[float, Sequence[Orbit | None]]:
    """Objective at `x` and the steady states there; infinite where there are none, or where the structure is none: a
    step that went too far.
    """
    try:
        found = joint.settle(x, orbits, 8)
        settled = all(o is None or np.isfinite(o.closing) for o in found)
        return (joint.value(x, found, *held) if settled else np.inf), found
    except ModelError:
        return np.inf, orbits


GROUPS = 40
"""Groups of neighbouring lines, all runs and responses together, that are wrong independently of each other."""


def _groups(joint: Joint) -> NDArray[np.int64]:
    """Group (N,) of each value of a response: neighbouring lines of all runs, as many values in each."""
    frequency = np.concatenate(
        [np.tile(a.at * run.rate / run.period, 2) for run, a in zip(joint.runs, joint.lines, strict=True)]
    )
    return np.searchsorted(np.quantile(frequency, np.linspace(0, 1, GROUPS + 1)[1:-1]), frequency)


def _left(r: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Residuals r (n_out, N) without what the marginalised columns b explain of them."""
    gram = np.matmul(b, b.transpose(0, 2, 1)) + np.eye(b.shape[1])
    inner = np.linalg.solve(gram, np.matmul(b, r[..., None]))
    return r - np.matmul(b.transpose(0, 2, 1), inner)[..., 0]


def _together(
    joint: Joint, jac: NDArray, r: NDArray, b: NDArray, inverse: NDArray, prior: NDArray, excess: float
) -> NDArray[np.float64]:  # fmt: skip
    """By what the variance (n_x,) of each entry grows because neighbouring lines are wrong together; one at least.

    What a model has wrong it has wrong alike at neighbouring lines and at every level, so that many lines tell no more
    than one. The variance that follows from the sums of the gradient's parts over groups of lines (cluster-robust,
    Liang and Zeger 1986) is compared with `excess` times the one that takes all lines as independent.
    """
    group = _groups(joint)
    gram = np.matmul(b, b.transpose(0, 2, 1)) + np.eye(b.shape[1])
    left = _left(r, b)
    moved = jac - np.matmul(np.linalg.solve(gram, np.matmul(b, jac.transpose(0, 2, 1))).transpose(0, 2, 1), b)
    each = np.einsum("oxn,on->xn", moved, left)
    sums = np.array([each[:, group == g].sum(axis=1) for g in range(GROUPS)])
    sums = sums - sums.mean(axis=0)
    robust = np.diag(inverse @ (sums.T @ sums + np.diag(prior)) @ inverse)
    plain = excess * np.diag(inverse)
    felt = plain > 1e-300  # what no value depends on has no variance to grow
    return np.maximum(np.divide(robust, plain, out=np.ones_like(robust), where=felt), 1.0)


def _reach(joint: Joint) -> NDArray[np.float64]:
    e = joint.engine
    m = e.band_modes.size
    first = np.array([p.upper - p.lower for p in e.structure.parameters])
    more = np.full(cords(e) + joint.k * (m + 1), 0.3)
    return np.concatenate([first, np.full(m, 0.02), np.full(m, 0.7), np.full(m, 0.3), [np.inf], more])


def _step(
    joint: Joint, x: NDArray, gradient: NDArray, hessian: NDArray, damping: float, reach: NDArray
) -> NDArray[np.float64]:
    at_low = (x <= joint.low) & (gradient < 0)
    at_high = (x >= joint.high) & (gradient > 0)
    free = ~(at_low | at_high)
    felt = np.diag(hessian) > 1e-200
    d = np.where(felt, np.sqrt(np.where(felt, np.diag(hessian), 1.0)), np.inf)
    scaled = hessian / np.outer(d, d) + damping * np.eye(d.size)
    step = np.zeros_like(x)
    if not (np.isfinite(scaled).all() and np.isfinite(gradient).all()):
        return x  # a response beyond all numbers leads nowhere
    step[free] = np.linalg.lstsq(scaled[np.ix_(free, free)], (gradient / d)[free], rcond=1e-13)[0] / d[free]
    own = np.maximum(np.abs(x[joint.n_base :] / joint.scale[joint.n_base :]), 0.05)
    most = reach.copy()
    most[joint.n_base :] *= own
    step = step / max(1.0, float(np.max(np.abs(step) / most)))
    return np.clip(x + step * joint.scale, joint.low, joint.high)
