"""Joint fit of a base model and nonlinear laws to periodic runs at all levels, by simulation with exact slopes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.fit import Scatter
from labnnum.diagnosis.nonlinear.laws import SHAPES, LawShape
from labnnum.diagnosis.nonlinear.lines import Lines
from labnnum.diagnosis.nonlinear.march import N_P
from labnnum.diagnosis.nonlinear.receptance import Base, Receptance
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.steady import Orbit, Steady
from labnnum.errors import EstimationError

FINE_STEPS = 3.3
"""Steps of the march to a period of the highest excited line, at least: harmonics up to the fifth do not fold back."""
JUMPING, JUMPING_LAST = 8.0, 32.0
"""The same where a force jumps, in the search and in the last fit: a jump that comes half a step late lets its limit
come out too high, by a third of friction that mostly holds."""


@dataclass(frozen=True, eq=False)
class Acting:
    """A law at a motion: mechanism id, column (n,), parameters with their scales and bounds."""

    mechanism: str
    column: NDArray[np.float64]
    start: NDArray[np.float64]
    last: bool = False
    """Whether this is the last fit, with finer steps."""

    @property
    def shape(self) -> LawShape:
        """The law."""
        return SHAPES[self.mechanism]

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.shape.names)


PASSIVE = 0.5
"""Share of beta in a hysteretic law from which on no loop of it returns more than it took (Erlicher and Point 2004:
gamma between -beta and beta); far below, the law is no loop but a spring that softens."""
WARM = 3
"""Periods marched before Newton's method where nothing is known of the steady state."""
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

    def law(self, i: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Parameters of the i-th law and their standard deviations."""
        first = self.n_base + sum(t.n for t in self.terms[:i])
        at = slice(first, first + self.terms[i].n)
        return self.x[at], np.sqrt(np.maximum(np.diag(self.covariance)[at], 0))


class Joint:
    """The objective: runs, laws and the scatter of a sound model; `whole` where responses are wanted on all lines."""

    def __init__(
        self, engine: Engine, point: Point, runs: Sequence[Run], terms: Sequence[Acting], scatter: Scatter,
        lines: Sequence[Lines], whole: bool = False,
    ) -> None:  # fmt: skip
        self.point = point
        self.engine, self.runs, self.terms, self.scatter, self.lines = engine, tuple(runs), tuple(terms), scatter, lines
        n = engine.basis.shape[0]
        columns = np.array([t.column for t in terms]).T.reshape(n, len(terms))
        self.k = len(terms)
        self.bases: dict[Any, Base] = {}
        for key in {r.key for r in runs}:
            period, rate, decay = key
            omega = 2 * np.pi * np.arange(period // 2 + 1) * rate / period
            need = np.unique(np.concatenate([a.need for r, a in zip(runs, lines, strict=True) if r.key == key]))
            self.bases[key] = Base(engine, point, columns, omega, decay, None if whole else need)
        first = next(iter(self.bases.values()))
        self.x0 = first.start()
        self.n_base = self.x0.size
        self.exact = True
        self._last: tuple[bytes, dict[Any, Receptance]] | None = None
        self.codes = np.array([t.shape.code for t in terms], np.int64)
        self.steady = [Steady(r, self.codes, _fine(r, terms)) for r in runs]
        self._priors(point)
        self._bounds()

    def _priors(self, point: Point) -> None:
        sc, e = self.scatter, self.engine
        parameters = e.structure.parameters
        m = e.band_modes.size
        zeta0 = np.log(e.zeta0[e.band_modes])
        self.mean = np.concatenate([e.theta0, np.zeros(m), zeta0, np.zeros(m), np.zeros(self.k * m)])
        self.std = np.concatenate(
            [[p.spread for p in parameters], np.full(m, sc.frequency), np.full(m, sc.damping), np.full(m, sc.residue),
             np.full(self.k * m, sc.shape)]
        )  # fmt: skip
        mean, std = [], []
        for t in self.terms:
            one_mean, one_std = t.start.copy()[: t.n], np.full(t.n, np.inf)
            if t.mechanism == "hysteresis":
                one_mean[2:4], one_std[2:4] = (1.5, 0.5), (0.7, 0.2)
            mean.append(one_mean)
            std.append(one_std)
        self.mean = np.concatenate([self.mean, *mean])
        self.std = np.concatenate([self.std, *std])

    def _bounds(self) -> None:
        e = self.engine
        m = e.band_modes.size
        wide = np.concatenate([np.full(m, 0.5), np.full(m, 12.0), np.full(m, 0.9), np.full(self.k * m, 0.5)])
        low = np.concatenate([[p.lower for p in e.structure.parameters], -wide])
        high = np.concatenate([[p.upper for p in e.structure.parameters], wide])
        at = e.theta0.size + m
        high[at : at + m] = np.log(0.7)
        low, high, scale = [low], [high], [np.ones(low.size)]
        for t in self.terms:
            size = np.abs(t.start[: t.n])
            s = np.where(size > 0, size, 1.0)
            one_low = np.full(t.n, -np.inf)
            one_high = np.full(t.n, np.inf)
            if t.shape.positive:
                one_low[:] = 0.0
            if t.shape.law == "one-sided-gap":
                one_low[1] = 0.0
            if t.shape.law in ("stick-slip", "clearance", "hysteresis"):
                one_low[:2] = 1e-6 * s[:2]
            if t.shape.law == "hysteresis":
                one_low[2:4], one_high[2:4] = (0.6, PASSIVE), (6.0, 1.0)
            if t.shape.law == "general":
                unused = size == 0
                one_low[unused], one_high[unused] = 0.0, 0.0
            low.append(one_low)
            high.append(one_high)
            scale.append(s)
        self.low, self.high, self.scale = np.concatenate(low), np.concatenate(high), np.concatenate(scale)
        self.used = (self.high > self.low)[self.n_base :]

    # ---------------------------------------------------------------- pieces

    def laws(self, x: NDArray) -> NDArray[np.float64]:
        """Parameters (k, N_P) of the laws in the vector."""
        out = np.zeros((self.k, N_P))
        at = self.n_base
        for i, t in enumerate(self.terms):
            out[i, : t.n] = x[at : at + t.n]
            at += t.n
        return out

    def start(self, base: NDArray | None = None) -> NDArray[np.float64]:
        """The vector from which to begin, the base part given (its places' motions may be absent)."""
        x = self.x0.copy()
        if base is not None:
            n = min(base.size, x.size)
            x[:n] = base[:n]
        return np.concatenate([x, *(t.start[: t.n] for t in self.terms)])

    def receptances(self, x: NDArray) -> dict[Any, Receptance]:
        """One for each period length."""
        key = x[: self.n_base].tobytes()
        if self._last is None or self._last[0] != key:
            self._last = (key, {k: b.at(x[: self.n_base]) for k, b in self.bases.items()})
        return self._last[1]

    def settle(self, x: NDArray, orbits: Sequence[Orbit | None], steps: int) -> list[Orbit | None]:
        """Steady states at `x` from those given."""
        if not self.k:
            return [None] * len(self.runs)
        made = self.receptances(x)
        p = self.laws(x)
        out: list[Orbit | None] = []
        for run, steady, orbit in zip(self.runs, self.steady, orbits, strict=True):
            r = made[run.key]
            warm = 0
            if orbit is None:
                orbit, warm = steady.guess(r, np.zeros((steady.n, self.k))), WARM
            out.append(steady.settle(r, p, orbit, steps + warm, warm=warm))
        return out

    def predict(self, x: NDArray, orbits: Sequence[Orbit | None]) -> list[NDArray[np.complex128]]:
        """Spectra of the responses, (n_out, n_lines) a run, on all lines if the objective is `whole`."""
        made = self.receptances(x)
        return [self._response(made[r.key], r, o) for r, o in zip(self.runs, orbits, strict=True)]

    @staticmethod
    def _response(r: Receptance, run: Run, orbit: Orbit | None, at: NDArray | None = None) -> NDArray[np.complex128]:
        at = r.lines if at is None else at
        here = r.index(at)
        y = r.plain[:, here] * (r.gain * run.u)[at]
        if orbit is not None:
            y = y + (r.h[..., here] * orbit.force[:, at]).sum(axis=1)
        return r.lift[:, here] * y

    def _nuisance(self, r: Receptance, run: Run, orbit: Orbit | None, at: NDArray, y: NDArray) -> NDArray:
        """Complex columns (n_out, n, at) of what is marginalised."""
        sc, e = self.scatter, self.engine
        b, lift = e.band_modes, r.lift[:, None, r.index(at)]
        drive = r.load[b][:, None] * (r.gain * run.u)[at]
        if orbit is not None:
            drive = drive + r.w[:, b].T @ orbit.force[:, at]
        modal = sc.shape * e.typical[:, None] * r.d[b][:, at] * drive
        modal = lift * modal
        s = at / max(at.max(), 1)
        others = np.stack([sc.gain * y, 1j * sc.phase * y, 1j * sc.phase * s * y], axis=1)
        outside = np.setdiff1d(np.arange(r.omega.size), b)
        if outside.size:
            rest = (r.out[outside].T * r.load[outside]) @ r.d[outside][:, at] * (r.gain * run.u)[at] * lift[:, 0]
            others = np.concatenate([others, sc.remainder * rest[:, None], 0.3j * sc.remainder * rest[:, None]], axis=1)
        return np.concatenate([modal, 1j * (sc.complexity / sc.shape) * modal, others], axis=1)

    @staticmethod
    def _real(a: NDArray) -> NDArray[np.float64]:
        """(..., n) complex to (..., 2 n) real, so that squares sum to 2 |a|^2 / E|error|^2."""
        return np.sqrt(2.0) * np.concatenate([np.real(a), np.imag(a)], axis=-1)

    def parts(self, x: NDArray, orbits: Sequence[Orbit | None]) -> tuple[NDArray, NDArray]:
        """Whitened residual (n_out, N) and marginalised columns (n_out, n, N)."""
        made = self.receptances(x)
        r_all, b_all = [], []
        for run, lines, orbit in zip(self.runs, self.lines, orbits, strict=True):
            r = made[run.key]
            at = lines.need
            y = self._response(r, run, orbit, at)
            r_all.append(self._real(lines.seen(run.y[:, at] - y)))
            columns = lines.seen(np.moveaxis(self._nuisance(r, run, orbit, at, y), 1, 0))
            b_all.append(self._real(np.moveaxis(columns, 0, 1)))
        return np.concatenate(r_all, axis=-1), np.concatenate(b_all, axis=-1)

    def value(self, x: NDArray, orbits: Sequence[Orbit | None], columns: NDArray) -> float:
        """Objective, what is marginalised held."""
        r, _ = self.parts(x, orbits)
        return _reduced(r, columns)[0] + self.price(x)

    def price(self, x: NDArray) -> float:
        """Of the parameters' distance from their priors."""
        return float(np.sum(((x - self.mean) / self.std) ** 2))

    def slopes(self, x: NDArray, orbits: Sequence[Orbit | None]) -> tuple[NDArray, list[Orbit | None]]:
        """Derivatives of the whitened responses, (n_out, n_x, N), and the orbits marched once more."""
        made = self.receptances(x)
        whole = bool(self.k) and self.exact
        derived = {key: b.derivatives(x[: self.n_base], made[key], whole) for key, b in self.bases.items()}
        p = self.laws(x)
        n_law = sum(t.n for t in self.terms)
        vary = np.zeros((n_law, self.k, N_P))
        at = 0
        for i, t in enumerate(self.terms):
            for j in range(t.n):
                vary[at, i, j] = self.scale[self.n_base + at]
                at += 1
        vary = vary[self.used]
        moving = np.append(np.ones(self.n_base, bool), self.used)
        out, new = [], []
        for run, lines, steady, orbit in zip(self.runs, self.lines, self.steady, orbits, strict=True):
            r, (dp, dh, dz, dg) = made[run.key], derived[run.key]
            at = lines.need
            here = r.index(at)
            change = dp[:, :, here] * (r.gain * run.u)[at]
            if orbit is not None:
                orbit, slope = steady.slopes(r, p, orbit, (dz, dg), vary, exact=self.exact)
                through = np.zeros((slope.force.shape[0], *change.shape[1:]), complex)
                for c in range(self.k):
                    change = change + dh[:, :, c][..., here] * orbit.force[c, at]
                    through += r.h[:, c, here] * slope.force[:, c, None][..., here]
                every = np.zeros((moving.size, *change.shape[1:]), complex)
                every[moving] = np.concatenate([change + through[: self.n_base], through[self.n_base :]])
                change = every
            out.append(self._real(np.moveaxis(lines.seen(change * r.lift[:, here]), 0, 1)))
            new.append(orbit)
        return np.concatenate(out, axis=-1), new


def _fine(run: Run, terms: Sequence[Acting]) -> int:
    top = np.flatnonzero(run.excited)[-1]
    jumping = [t for t in terms if t.shape.law == "coulomb"]
    steps = FINE_STEPS if not jumping else JUMPING_LAST if any(t.last for t in jumping) else JUMPING
    fine = 1
    while run.period * fine < steps * top and fine < 16:
        fine *= 2
    return fine


def _reduced(r: NDArray, b: NDArray) -> tuple[float, NDArray, NDArray]:
    gram = np.matmul(b, b.transpose(0, 2, 1)) + np.eye(b.shape[1])
    br = np.matmul(b, r[..., None])[..., 0]
    inner = np.linalg.solve(gram, br[..., None])[..., 0]
    return float(np.sum(r * r) - np.sum(br * inner)), gram, inner


def fit(
    joint: Joint, x: NDArray, orbits: Sequence[Orbit | None], *, steps: int = 10, tolerance: float = 1e-3,
    floor: float = 1.0, exact: bool = True, always: bool = False,
) -> Made:  # fmt: skip
    """Levenberg-Marquardt from `x`; ends when a step gains less than `tolerance` of the objective and `floor`.

    `exact` slopes are marched where the base model's vector is short (`EXACT`), or `always`: standard deviations need
    them.
    """
    joint.exact = always or (exact and joint.n_base <= EXACT)
    scale, low, high = joint.scale, joint.low, joint.high
    x = np.clip(x, low, high)
    orbits = joint.settle(x, orbits, 14)
    damping, converged = 1e-3, False
    prior = (scale / joint.std) ** 2
    best: tuple[float, NDArray, Any, NDArray, NDArray] | None = None
    reach = np.concatenate([_reach(joint), np.full(x.size - joint.n_base, 0.7)])
    small = 0
    for _ in range(steps):
        try:
            jac, orbits = joint.slopes(x, orbits)
        except EstimationError:
            break
        r, b = joint.parts(x, orbits)
        part, gram, inner = _reduced(r, b)
        value = part + joint.price(x)
        bj = np.matmul(b, jac.transpose(0, 2, 1))
        hessian = np.matmul(jac, jac.transpose(0, 2, 1)).sum(axis=0)
        hessian -= np.matmul(bj.transpose(0, 2, 1), np.linalg.solve(gram, bj)).sum(axis=0)
        gradient = np.matmul(jac, r[..., None]).sum(axis=0)[:, 0]
        gradient -= np.matmul(bj.transpose(0, 2, 1), inner[..., None]).sum(axis=0)[:, 0]
        gradient -= prior * (x - joint.mean) / scale * np.isfinite(joint.std)
        hessian += np.diag(prior)
        if best is None or value < best[0]:
            best = (value, x, orbits, hessian, jac)
        moved = False
        for _ in range(5):
            trial = _step(joint, x, gradient, hessian, damping, reach)
            found = joint.settle(trial, orbits, 8)
            settled = all(o is None or np.isfinite(o.closing) for o in found)
            after = joint.value(trial, found, b) if settled else np.inf
            if np.isfinite(after) and after < value:
                moved = True
                break
            damping *= 6.0
        if not moved:
            converged = True
            break
        gain = value - after
        x, orbits, damping = trial, found, max(damping / 5.0, 1e-8)
        small = small + 1 if gain < max(tolerance * value, floor) else 0
        if small >= 1:
            converged = True
            break
    if best is None:
        raise EstimationError("the steady response does not settle at the start of the fit")
    r, b = joint.parts(x, orbits)
    value = _reduced(r, b)[0] + joint.price(x)
    if best[0] < value:
        value, x, orbits = best[0], best[1], best[2]
    hessian = best[3]
    d = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
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
        joint.n_base - joint.k * joint.engine.band_modes.size,
        int(r.size),
        converged,
    )


GROUPS = 40
"""Groups of neighbouring lines, all runs and responses together, that are wrong independently of each other."""


def _together(
    joint: Joint, jac: NDArray, r: NDArray, b: NDArray, inverse: NDArray, prior: NDArray, excess: float
) -> NDArray[np.float64]:  # fmt: skip
    """By what the variance (n_x,) of each entry grows because neighbouring lines are wrong together; one at least.

    What a model has wrong it has wrong alike at neighbouring lines and at every level, so that many lines tell no more
    than one. The variance that follows from the sums of the gradient's parts over groups of lines (cluster-robust,
    Liang and Zeger 1986) is compared with `excess` times the one that takes all lines as independent.
    """
    frequency = np.concatenate(
        [np.tile(a.at * run.rate / run.period, 2) for run, a in zip(joint.runs, joint.lines, strict=True)]
    )
    edges = np.quantile(frequency, np.linspace(0, 1, GROUPS + 1)[1:-1])
    group = np.searchsorted(edges, frequency)
    gram = np.matmul(b, b.transpose(0, 2, 1)) + np.eye(b.shape[1])
    left = r - np.matmul(b.transpose(0, 2, 1), np.linalg.solve(gram, np.matmul(b, r[..., None])))[..., 0]
    moved = jac - np.matmul(np.linalg.solve(gram, np.matmul(b, jac.transpose(0, 2, 1))).transpose(0, 2, 1), b)
    each = np.einsum("oxn,on->xn", moved, left)
    sums = np.array([each[:, group == g].sum(axis=1) for g in range(GROUPS)])
    sums = sums - sums.mean(axis=0)
    robust = np.diag(inverse @ (sums.T @ sums + np.diag(prior)) @ inverse)
    return np.maximum(robust / np.maximum(excess * np.diag(inverse), 1e-300), 1.0)


def _reach(joint: Joint) -> NDArray[np.float64]:
    e = joint.engine
    m = e.band_modes.size
    first = np.array([p.upper - p.lower for p in e.structure.parameters])
    return np.concatenate([first, np.full(m, 0.02), np.full(m, 0.7), np.full(m, 0.3), np.full(joint.k * m, 0.3)])


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


def with_runs(made: Made, n: int) -> Made:
    """The fit without its orbits, for other runs."""
    return replace(made, orbits=(None,) * n)
