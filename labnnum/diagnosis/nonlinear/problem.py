"""Joint fit of a base model and nonlinear laws to periodic runs at all levels, by simulation with exact slopes."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.nonlinear.force import HELD, N_P, TOLD, YIELDING
from labnnum.diagnosis.nonlinear.laws import SHAPES, LawShape
from labnnum.diagnosis.nonlinear.lines import Lines
from labnnum.diagnosis.nonlinear.orbit import CLOSED, Orbit
from labnnum.diagnosis.nonlinear.receptance import HANGS, LOSSES, Base, Receptance, cords, of_all, per_place
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.steady import Steady
from labnnum.diagnosis.objective import frequency_spread
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.extended import ExtendedStructure
from labnnum.structures.modal import ModalStructure
from labnnum.threads import each

FINE_STEPS = 3.3
"""Steps of the march to a period of the highest excited line, at least: harmonics up to the fifth do not fold back."""
JUMPING, JUMPING_LAST = 8.0, 32.0
"""The same where a force jumps, in the search and in the last fit: a jump that comes half a step late lets its limit
come out too high, by a third of friction that mostly holds."""
SLACK = 1.5
"""Bounds of the logarithms of the cords' frequency and damping, about their usual ones."""
KINKED, SMOOTH_LAST = ("stick-slip", "sliders", "hysteresis", "one-sided-gap", "clearance"), 8.0
"""Laws whose force has corners, and the same for the last fit of these and of laws without: what folds back of a strong
one's harmonics looks like a misfit, of 10 to 50 times the noise on the chain and the beam that were tried, which no law
explains, and moves a strong cubic spring by 3 to 9 %."""


@dataclass(frozen=True, eq=False)
class Acting:
    """A law at a motion: mechanism id, column (n,), parameters with their scales and bounds."""

    mechanism: str
    column: NDArray[np.float64]
    start: NDArray[np.float64]
    last: bool = False
    """Whether this is the last fit, with finer steps."""
    steps: float = 0.0
    """Steps to a period of the highest excited line that the march takes at least."""

    @property
    def shape(self) -> LawShape:
        """The law."""
        return SHAPES[self.mechanism]

    @property
    def n(self) -> int:
        """Number of parameters that are fitted."""
        return len(self.shape.names)

    def held(self, p: NDArray) -> NDArray[np.float64]:
        """Those that are fitted, `p`, with what the law has beside them: the number of its sliders, and what of its
        spring the structure holds.
        """
        out = np.zeros(N_P)
        out[: self.n] = p
        if self.mechanism == "sliders":
            out[self.n] = self.start[self.n]
        if self.shape.law in YIELDING:
            out[HELD], out[TOLD] = self.start[HELD], self.start[TOLD]
        return out

    def stuck(self) -> Acting:
        """The same beside a structure that was identified while it stuck, unless a file says what it holds."""
        if self.shape.law not in YIELDING or self.start[TOLD]:
            return self
        start = self.start.copy()
        start[HELD] = 1.0
        return replace(self, start=start)


SHAPED = 0.7, 0.2
"""Standard deviations of a loop's power and of the share of beta in it."""
FEW = 1e-3
"""Least standard deviation of what modes above the band do at a place."""
FREE = 0.3
"""Standard deviation at most of a place's relative motion in a mode."""
REMEMBERED = 100.0
"""Decay times of a mode in a stretch of noise, up to which what rings there from before it is fitted and not compared.
Through the Hann window it is still a two-thousandth of the response after so many."""
RESTLESS, MOST_STEPS = 0.05, 16.0
"""Relative change of the forces from march to march above which a run that does not close is marched with half as long
steps; and steps to a period of the highest excited line up to which that is done."""
WARM = 3
"""Periods marched before Newton's method where nothing is known of the steady state."""


def holds_springs(engine: Engine) -> bool:
    """Whether the structure was identified, from what sticks at its level: it holds the springs of what yields."""
    structure = engine.structure
    while isinstance(structure, ExtendedStructure):
        structure = structure.inner
    return isinstance(structure, ModalStructure) and structure.error > 0


class Joint:
    """The objective: runs, laws and the scatter of a sound model; `whole` where responses are wanted on all lines.

    `closing`: relative gap of a period, or change from march to march, at which a steady state counts as found.
    `limit`: objective per value above which where a fit ends is of no use.
    """

    def __init__(
        self, engine: Engine, point: Point, runs: Sequence[Run], terms: Sequence[Acting], scatter: Scatter,
        lines: Sequence[Lines], whole: bool = False, closing: float = CLOSED, limit: float = np.inf,
    ) -> None:  # fmt: skip
        self.point, self.closing, self.limit = point, closing, limit
        if holds_springs(engine):
            terms = [t.stuck() for t in terms]
        self.engine, self.runs, self.terms, self.scatter, self.lines = engine, tuple(runs), tuple(terms), scatter, lines
        n = engine.basis.shape[0]
        columns = np.array([t.column for t in terms]).T.reshape(n, len(terms))
        self.k = len(terms)
        jumps = any(t.shape.law == "coulomb" for t in terms)
        self.bases: dict[Any, Base] = {}
        for key in {r.key for r in runs}:
            period, rate, decay = key
            omega = 2 * np.pi * np.arange(period // 2 + 1) * rate / period
            need = np.unique(np.concatenate([a.need for r, a in zip(runs, lines, strict=True) if r.key == key]))
            self.bases[key] = Base(engine, point, columns, omega, decay, None if whole else need, jumps)
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
        hung = cords(e)
        self.mean = np.concatenate([e.theta0, np.zeros(m), zeta0, np.zeros(m), np.zeros(1 + hung + self.k * (m + 1))])
        self.std = np.concatenate(
            [[p.spread for p in parameters], frequency_spread(e, sc), np.full(m, sc.damping), np.full(m, sc.residue),
             [LOSSES], HANGS[:hung], self._motion_std()]
        )  # fmt: skip
        mean, std = [], []
        for t in self.terms:
            one_mean, one_std = t.start.copy()[: t.n], np.full(t.n, np.inf)
            if t.shape.shaped:
                one_mean[2:4], one_std[2:4] = t.shape.shaped, SHAPED
            mean.append(one_mean)
            std.append(one_std)
        self.mean = np.concatenate([self.mean, *mean])
        self.std = np.concatenate([self.std, *std])

    def _motion_std(self) -> NDArray[np.float64]:
        """Of the relative motion of each place in each band mode, what shapes differ by, and next to a node, or of
        neighbouring modes, what elements and masses of their own make of them; and in the modes above, (k (m + 1),).
        """
        sc = self.scatter
        first = next(iter(self.bases.values()))
        usual = np.full(first.w_typical.shape, sc.shape)
        if self.k and (sc.stiffness > 0 or sc.mass > 0):
            own = self.engine.shape_spread(first.columns.T, sc.stiffness, sc.mass)
            usual = np.hypot(usual, np.minimum(own / first.w_typical, FREE))
        return np.concatenate([usual, np.full((self.k, 1), max(sc.remainder, FEW))], axis=1).ravel()

    def _unseen(self) -> NDArray[np.intp]:
        """Entries of modes beyond the lines of a run: frequency, damping and motions, which laws' harmonics may feel in
        the march, but no derivative line by line holds.
        """
        e = self.engine
        m = e.band_modes.size
        top = 2 * np.pi * min(r.rate for r in self.runs) / 2
        far = np.flatnonzero(e.state(e.theta0).omega[e.band_modes] > top)
        n = e.theta0.size
        last = n + 3 * m + of_all(e)
        return np.concatenate([n + far, n + m + far, *(last + i * (m + 1) + far for i in range(self.k))])

    def _bounds(self) -> None:
        e = self.engine
        m = e.band_modes.size
        wide = [np.full(m, 0.5), np.full(m, 12.0), np.full(m, 0.9), [1.0], np.full(cords(e), SLACK)]
        wide = np.concatenate([*wide, np.full(self.k * (m + 1), 0.5)])
        low = np.concatenate([[p.lower for p in e.structure.parameters], -wide])
        high = np.concatenate([[p.upper for p in e.structure.parameters], wide])
        at = e.theta0.size + m
        high[at : at + m] = np.log(0.7)
        share = at + 2 * m
        low[share] = 0.0
        if isinstance(e.structure, ModalStructure):  # what was identified at the quietest level is the base's own
            low[share] = high[share] = self.mean[share] = self.x0[share]
        self._wide = low.copy(), high.copy()
        self._held = self._unseen() if self.k else np.zeros(0, int)
        low[self._held] = high[self._held] = self.x0[self._held]
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
            if t.shape.law in ("stick-slip", "sliders", "clearance", "hysteresis"):
                one_low[:2] = 1e-6 * s[:2]
            if t.shape.law == "sliders":
                one_high[2] = 1.0
            if t.shape.within:
                one_low[2:4], one_high[2:4] = np.transpose(t.shape.within)
            if t.shape.law == "general":
                unused = size == 0
                one_low[unused], one_high[unused] = 0.0, 0.0
            low.append(one_low)
            high.append(one_high)
            scale.append(s)
        self.low, self.high, self.scale = np.concatenate(low), np.concatenate(high), np.concatenate(scale)
        self.used = (self.high > self.low)[self.n_base :]

    def hold_places(self, x: NDArray | None) -> None:
        """Hold the motions at the laws' places, as `x` has them, in the fits to come; None frees them again."""
        self._bounds()
        if x is not None:
            at = slice(self.n_base - self.k * per_place(self.engine), self.n_base)
            self.low[at] = self.high[at] = x[at]

    def begin(self, x: NDArray) -> NDArray[np.float64]:
        """The vector inside the bounds; what no line tells of stays where it is."""
        held = self._held
        self.low[held] = self.high[held] = np.clip(x[held], self._wide[0][held], self._wide[1][held])
        return np.clip(x, self.low, self.high)

    def driven(self, runs: Sequence[Run]) -> Joint:
        """The same over runs with other inputs on the same lines; what was prepared of the base is shared."""
        out = copy(self)
        out.runs = tuple(runs)
        out.steady = [Steady(r, self.codes, s.fine) for r, s in zip(runs, self.steady, strict=True)]
        return out

    def over(self, pick: Sequence[int]) -> Joint:
        """The same over some of the runs."""
        out = copy(self)
        out.runs = tuple(self.runs[i] for i in pick)
        out.steady, out.lines = [self.steady[i] for i in pick], [self.lines[i] for i in pick]
        return out

    # ---------------------------------------------------------------- pieces

    @property
    def values(self) -> int:
        """Number of values that are compared."""
        return sum(2 * lines.sigma.size for lines in self.lines)

    def laws(self, x: NDArray) -> NDArray[np.float64]:
        """Parameters (k, N_P) of the laws in the vector."""
        out = np.zeros((self.k, N_P))
        at = self.n_base
        for i, t in enumerate(self.terms):
            out[i] = t.held(x[at : at + t.n])
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

        def settled(of: tuple[Run, Steady, Orbit | None]) -> Orbit | None:
            run, steady, orbit = of
            r = made[run.key]
            warm = 0
            if orbit is None:
                orbit, warm = steady.guess(r, np.zeros((steady.n, self.k))), WARM
            return steady.settle(r, p, orbit, steps + warm, self.closing, warm)

        return each(settled, list(zip(self.runs, self.steady, orbits, strict=True)))

    def restless(self, orbits: Sequence[Orbit | None]) -> bool:
        """Whether the march of an open run or a hit still changes from one to the next, each corrected by the one
        before: where a law is much stiffer than the structure and steps are long, the correction grows.
        """
        free = (o for r, o in zip(self.runs, orbits, strict=True) if o is not None and o.tie is None and not r.lasting)
        return any(max(RESTLESS, self.closing) < o.closing < np.inf for o in free)

    def refine(self, most: float = MOST_STEPS) -> bool:
        """March with half as long steps from now on; False where they are as short as they get, `most` to a period."""
        steps = 2 * max(s.fine * s.run.period / s.top for s in self.steady)
        terms = tuple(replace(t, steps=steps) for t in self.terms)
        finer = [Steady(r, self.codes, _fine(r, terms)) for r in self.runs]
        if steps > most or all(a.fine == b.fine for a, b in zip(finer, self.steady, strict=True)):
            return False
        self.terms, self.steady = terms, finer
        return True

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
        near = np.concatenate([b, e.modes_above])
        drive = r.load[near][:, None] * (r.gain * run.u)[at]
        if orbit is not None:
            drive = drive + r.w[:, near].T @ orbit.force[:, at]
        typical = np.concatenate([e.typical, np.abs(r.out[e.modes_above]).max(axis=1)])
        every = lift * (sc.shape * typical[:, None] * r.d[near][:, at] * drive)
        modal, higher = every[:, : b.size], every[:, b.size :]
        s = at / max(at.max(), 1)
        others = np.stack([sc.gain * y, 1j * sc.phase * y, 1j * sc.phase * s * y], axis=1)
        outside = np.setdiff1d(np.arange(r.omega.size), b)
        if outside.size:
            rest = (r.out[outside].T * r.load[outside]) @ r.d[outside][:, at] * (r.gain * run.u)[at] * lift[:, 0]
            others = np.concatenate([others, sc.remainder * rest[:, None], 0.3j * sc.remainder * rest[:, None]], axis=1)
        return np.concatenate([modal, 1j * (sc.complexity / sc.shape) * modal, higher, others], axis=1)

    def misread(
        self, r: Receptance, run: Run, orbit: Orbit | None, share: NDArray, errors: NDArray, silent: bool = True
    ) -> NDArray[np.complex128]:  # fmt: skip
        """What ordinary errors (n_out, n), in standard deviations, add to the `share` (n_out, n_lines) of the responses
        that the nonlinear forces make; to all of the responses where the input is not `silent`.
        """
        heard = replace(run, u=np.zeros_like(run.u)) if silent else run
        columns = self._nuisance(r, heard, orbit, r.lines, share)
        return np.einsum("on,onf->of", errors[:, : columns.shape[1]], columns, optimize=True)

    def _before(self, r: Receptance, run: Run, at: NDArray) -> NDArray[np.complex128]:
        """Complex columns (n_out, n, at) of what rings in a stretch from before it, two a mode, each channel's own;
        none where the run begins at rest or in its steady state.
        """
        b, length = self.engine.band_modes, run.period / run.rate
        omega, zeta = r.omega[b], r.zeta[b]
        slow = (zeta * omega * length < REMEMBERED) & run.open
        pole = omega[slow] * (-zeta[slow] + 1j * np.sqrt(np.maximum(1 - zeta[slow] ** 2, 0.0)))
        turn = np.exp(-2j * np.pi * at / run.period)
        ring, back = (
            (1 - np.exp(p * length))[:, None] / (1 - np.exp(p / run.rate)[:, None] * turn)
            for p in (pole, np.conj(pole))
        )
        columns = np.concatenate([ring + back, 1j * (ring - back)]) / run.period
        size = np.linalg.norm(run.y[:, run.inside], axis=1)
        return size[:, None, None] * columns

    @staticmethod
    def _real(a: NDArray) -> NDArray[np.float64]:
        """(..., n) complex to (..., 2 n) real, so that squares sum to 2 |a|^2 / E|error|^2."""
        return np.sqrt(2.0) * np.concatenate([np.real(a), np.imag(a)], axis=-1)

    def parts(self, x: NDArray, orbits: Sequence[Orbit | None]) -> tuple[NDArray, NDArray]:
        """Whitened residual (n_out, N) and marginalised columns (n_out, n, N)."""
        made = self.receptances(x)

        def part(of: tuple[Run, Lines, Orbit | None]) -> tuple[NDArray, NDArray, NDArray]:
            run, lines, orbit = of
            r = made[run.key]
            at = lines.need
            y = self._response(r, run, orbit, at)
            columns = lines.seen(np.moveaxis(self._nuisance(r, run, orbit, at, y), 1, 0))
            ringing = lines.seen(np.moveaxis(self._before(r, run, at), 1, 0))
            return (
                self._real(lines.seen(run.y[:, at] - y)),
                self._real(np.moveaxis(columns, 0, 1)),
                self._real(np.moveaxis(ringing, 0, 1)),
            )

        left, shared, own = zip(*each(part, list(zip(self.runs, self.lines, orbits, strict=True))), strict=True)
        return np.concatenate(left, axis=-1), _beside(shared, own)

    def left(self, x: NDArray, orbits: Sequence[Orbit | None]) -> NDArray[np.float64]:
        """Whitened residual (n_out, N) alone."""
        made = self.receptances(x)

        def part(of: tuple[Run, Lines, Orbit | None]) -> NDArray:
            run, lines, orbit = of
            return self._real(lines.seen(run.y[:, lines.need] - self._response(made[run.key], run, orbit, lines.need)))

        return np.concatenate(each(part, list(zip(self.runs, self.lines, orbits, strict=True))), axis=-1)

    def value(self, x: NDArray, orbits: Sequence[Orbit | None], columns: NDArray, gram: NDArray | None = None) -> float:
        """Objective, what is marginalised held: its columns, and their gram matrix where it is known."""
        return reduced(self.left(x, orbits), columns, gram)[0] + self.price(x)

    def price(self, x: NDArray) -> float:
        """Of the parameters' distance from their priors."""
        return float(np.sum(((x - self.mean) / self.std) ** 2))

    def evened(self, x: NDArray) -> tuple[NDArray, NDArray]:
        """The vector with every place's motions as near to the model's as one factor brings them, its law changed so
        that nothing else does; and these factors (k,).

        A place that moves twice as far against half the force does the same to the structure, whatever the law. Only
        the price of the motions tells how far it moves, along a valley that turns. A place that moves with the whole
        body, where that floats, is left as it is: how far is known.
        """
        out, factor, m = x.copy(), np.ones(self.k), per_place(self.engine)
        first, e = next(iter(self.bases.values())), self.engine
        every = e.state(x[: e.theta0.size]).shape
        shape, whole = every[:, e.band_modes], every[:, : e.rigid_modes]
        at = self.n_base
        for i, t in enumerate(self.terms):
            own = slice(self.n_base - (self.k - i) * m, self.n_base - (self.k - i - 1) * m)
            law = slice(at, at + t.n)
            at += t.n
            column = first.columns[:, i]
            carried = np.linalg.norm(column @ whole) > 1e-6 * np.linalg.norm(column @ shape)
            if carried or (self.low[own] == self.high[own]).all():
                continue
            plain = np.append(column @ shape / first.w_typical[i], 1.0)
            here, there = (plain + x[own]) / self.std[own], plain / self.std[own]
            by = float(here @ there) / max(float(here @ here), 1e-300)
            moved = by * (plain + x[own]) - plain
            p = x[law] * by ** np.array(t.shape.grows[: t.n], float) if by > 0 else x[law]
            inside = np.all((moved >= self._wide[0][own]) & (moved <= self._wide[1][own]))
            if by <= 0 or not inside or not np.all((p >= self.low[law]) & (p <= self.high[law])):
                continue
            out[own], out[law], factor[i] = moved, p, by
        return out, factor

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

        def part(of: tuple[Run, Lines, Steady, Orbit | None]) -> tuple[NDArray, Orbit | None]:
            run, lines, steady, orbit = of
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
            return self._real(np.moveaxis(lines.seen(change * r.lift[:, here]), 0, 1)), orbit

        done = each(part, list(zip(self.runs, self.lines, self.steady, orbits, strict=True)))
        return np.concatenate([change for change, _ in done], axis=-1), [orbit for _, orbit in done]


def steps_of(terms: Sequence[Acting]) -> float:
    """Steps of the march to a period of the highest excited line that laws need."""
    jumping = [t for t in terms if t.shape.law == "coulomb"]
    steps = FINE_STEPS if not jumping else JUMPING_LAST if any(t.last for t in jumping) else JUMPING
    if any(t.last for t in terms):
        steps = max(steps, SMOOTH_LAST)
    return max([steps, *(t.steps for t in terms)])


def _fine(run: Run, terms: Sequence[Acting]) -> int:
    top = np.flatnonzero(run.excited)[-1]
    steps = steps_of(terms)
    fine = 1
    while run.period * fine < steps * top and fine < 16:
        fine *= 2
    return fine


def _beside(shared: Sequence[NDArray], own: Sequence[NDArray]) -> NDArray[np.float64]:
    """Columns (n_out, n, N_i) that runs share, and after them each run's own, which are zero in the others."""
    out = np.concatenate(shared, axis=-1)
    ends = np.cumsum([0, *(a.shape[-1] for a in shared)])
    more = []
    for a, b, columns in zip(ends[:-1], ends[1:], own, strict=True):
        if columns.shape[1]:
            each = np.zeros((*columns.shape[:2], out.shape[-1]))
            each[..., a:b] = columns
            more.append(each)
    return np.concatenate([out, *more], axis=1) if more else out


def reduced(r: NDArray, b: NDArray, gram: NDArray | None = None) -> tuple[float, NDArray, NDArray]:
    """What is left of residuals r (n_out, N) beside marginalised columns b; their gram matrix and sizes."""
    gram = np.matmul(b, b.transpose(0, 2, 1)) + np.eye(b.shape[1]) if gram is None else gram
    br = np.matmul(b, r[..., None])[..., 0]
    inner = np.linalg.solve(gram, br[..., None])[..., 0]
    return float(np.sum(r * r) - np.sum(br * inner)), gram, inner
