"""What every fit of one search shares, a law that was tried, and what a search found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.nonlinear.fitting import Made, fit
from labnnum.diagnosis.nonlinear.follow import Followed, marched_from
from labnnum.diagnosis.nonlinear.laws import SHAPES
from labnnum.diagnosis.nonlinear.lines import Lines, choose_lines
from labnnum.diagnosis.nonlinear.locate import Lead, Recovered, Spot
from labnnum.diagnosis.nonlinear.orbit import CLOSED, Orbit
from labnnum.diagnosis.nonlinear.problem import Acting, Joint, holds_springs, reduced
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.scatter import Scatter
from labnnum.errors import EstimationError, ModelError
from labnnum.mechanisms.base import Place


@dataclass(frozen=True, eq=False)
class Tried:
    """A law at a spot, fitted; `cost` its objective plus the price of its parameters.

    `simulated`: whether the fit was by simulation, and not along the recovered motion only. `more`: laws that were
    sought together with it, and are fitted with it.
    """

    lead: Lead
    made: Made
    cost: float
    simulated: bool = True
    more: tuple[Lead, ...] = ()

    @property
    def spot(self) -> Spot:
        """Where."""
        return self.lead.spot

    @property
    def mechanism(self) -> str:
        """Its id."""
        return self.lead.mechanism

    @property
    def named(self) -> bool:
        """Whether its law is one of the catalogue."""
        return self.mechanism != "general"

    @property
    def name(self) -> str:
        """The mechanism of the catalogue that it is."""
        return self.lead.name

    @property
    def all_of_it(self) -> frozenset[tuple[str, Place]]:
        """Names and places of all its laws."""
        leads = (self.lead, *self.more)
        return frozenset((lead.name, lead.spot.place) for lead in leads)

    def same(self, other: Tried) -> bool:
        """Whether both are one answer."""
        if self.more or other.more:
            return self.all_of_it == other.all_of_it
        same_terms = self.named or np.array_equal(self.lead.p != 0, other.lead.p != 0)
        return self.name == other.name and self.spot.place == other.spot.place and same_terms


@dataclass(frozen=True, eq=False)
class Study:
    """What the search found: candidates best first, the general law, the base model fitted to the same runs."""

    engine: Engine
    point: Point
    runs: tuple[Run, ...]
    base: Made
    quiet: Made
    tried: tuple[Tried, ...]
    general: Tried | None
    recovered: tuple[Recovered, ...]
    company: tuple[Tried, ...] = ()
    """Rivals of the first of several laws, each beside the others."""
    pairs: tuple[Tried, ...] = ()
    """Two laws that came far nearer than the best alone, from far away; best first."""

    @property
    def best(self) -> Tried:
        """The candidate that costs least."""
        return self.tried[0]


@dataclass(frozen=True, eq=False)
class Bench:
    """What every fit of one search shares: base model, runs, the scatter of a sound model, the lines compared."""

    engine: Engine
    point: Point
    runs: tuple[Run, ...]
    scatter: Scatter
    lines: tuple[Lines, ...]
    closing: float = CLOSED
    """Relative gap of a period, or change from march to march, at which a steady state counts as found."""
    limit: float = np.inf
    """Objective per value above which where a fit ends is of no use: one that falls too slowly for it is given up."""
    firm: tuple[int, ...] = ()
    """Numbers of the runs that hold the base: they are given no tolerance."""

    def against(self, *tried: Tried) -> Bench:
        """The same for rivals of laws, if there are any: those that leave several times as much as the best of these
        need not be followed to their end.
        """
        best = min(tried, key=lambda t: t.cost, default=None)
        return self if best is None else replace(self, limit=RACE * best.cost / best.made.count)

    def on(self, most: int) -> Bench:
        """The same with `most` lines a run."""
        return replace(self, lines=tuple(choose_lines(r, most, self.scatter.floor) for r in self.runs))

    def joint(self, leads: Sequence[Lead]) -> Joint:
        """The objective of laws that are simulated."""
        return self.joint_of([lead.acting() for lead in leads])

    def joint_of(self, terms: Sequence[Acting]) -> Joint:
        """The objective of laws with what their march needs."""
        return Joint(
            self.engine, self.point, self.runs, terms, self.scatter, self.lines, closing=self.closing, limit=self.limit
        )  # fmt: skip

    def follow(self, x: NDArray, lead: Lead, steps: int) -> Tried | None:
        """A law fitted along the recovered motion, from the base vector `x`."""
        joint = Followed(self.engine, self.point, self.runs, [lead.acting()], self.scatter, self.lines)
        return tried_fit(joint, joint.start(x), [None] * len(self.runs), lead, steps, simulated=False)

    def both(self, x: NDArray, leads: Sequence[Lead], steps: int) -> Tried | None:
        """Several laws that act together fitted by simulation, from the base vector `x`."""
        joint = self.joint(leads)
        return tried_fit(joint, joint.start(x), [None] * len(self.runs), leads[0], steps, more=leads[1:])

    def follow_on(self, one: Tried, steps: int) -> Tried:
        """The same carried on."""
        return self.follow(one.made.x[: one.made.n_base], of_fit(one), steps) or one

    def simulate(self, one: Tried, steps: int, *, last: bool = False) -> Tried | None:
        """A law that was followed, fitted by simulation: from its force along the motion, or else from nothing; with
        finer steps where it is the `last` fit.
        """
        terms = [replace(lead.acting(), last=last) for lead in of_fits(one)]
        joint = self.joint_of(terms)
        begun = marched_from(joint, one.made.x, one.made.orbits)
        made = tried_fit(joint, one.made.x, begun, one.lead, steps, more=one.more)
        return made or tried_fit(joint, one.made.x, [None] * len(self.runs), one.lead, steps, more=one.more)

    def direct(self, starts: Sequence[NDArray], lead: Lead, steps: int, *, soften: bool = True) -> Tried | None:
        """A law fitted by simulation from what the recovered motion promised, from several base vectors.

        Of a slider one more is tried (`soften`): the first without the spring of what sticks, which it holds already;
        not where the base keeps it.
        Of a law that its strength alone makes, weaker ones (`WEAKER`) where no steady state is found: what a sensor far
        away shows of its place may be noise, and promise a law that carries the structure off.
        """
        soften = soften and lead.mechanism == "stick-slip" and not holds_springs(self.engine)
        made = self._direct(starts, lead, steps, soften)
        if made is None and not SHAPES[lead.mechanism].inner:
            weaker = (self._direct(starts, replace(lead, p=part * lead.p), steps) for part in WEAKER)
            made = next((t for t in weaker if t is not None), None)
        return made

    def _direct(self, starts: Sequence[NDArray], lead: Lead, steps: int, soften: bool = False) -> Tried | None:
        joint = self.joint([lead])
        begin = [joint.start(x) for x in starts]
        if soften:
            begin.append(joint.start(softened(joint, starts[0], lead)))
        made = [tried_fit(joint, x, [None] * len(self.runs), lead, steps) for x in begin]
        return min((t for t in made if t is not None), key=lambda t: t.cost, default=None)

    def again(self, x: NDArray, one: Tried, lead: Lead, steps: int) -> Tried | None:
        """A simulated fit from another base vector and other parameters of its law, with as fine steps."""
        joint = self.joint_of([replace(lead.acting(), last=one.made.terms[0].last)])
        return tried_fit(joint, joint.start(x), [None] * len(self.runs), one.lead, steps)

    def law_alone(self, x: NDArray, lead: Lead, steps: int) -> Tried | None:
        """A law fitted by simulation, the base held where `x` has it."""
        joint = self.joint([lead])
        begin = joint.start(x)
        joint.low[: joint.n_base] = joint.high[: joint.n_base] = begin[: joint.n_base]
        return tried_fit(joint, begin, [None] * len(self.runs), lead, steps, exact=False)

    def carry_on(self, one: Tried, steps: int, *, always: bool = False, last: bool = True) -> Tried:
        """A simulated fit carried on, on other lines perhaps; with finer steps where it is the `last`, and with still
        finer ones where it leaves more than noise only because these are too long.
        """
        terms = [replace(t, last=last) for t in one.made.terms]
        made = self._carried(one, terms, steps, always)
        while last and (finer := self._finer(made)) is not None:
            made = self._carried(made, finer, steps, always)
        return made

    def _carried(self, one: Tried, terms: Sequence[Acting], steps: int, always: bool) -> Tried:
        joint = self.joint_of(terms)
        made = tried_fit(joint, one.made.x, one.made.orbits, one.lead, steps, always=always, more=one.more)
        return made or self.as_it_is(one)

    def as_it_is(self, one: Tried) -> Tried:
        """A simulated fit, no further, with what it leaves of this bench's lines; of infinite cost where it settles on
        none of them.
        """
        joint, before = self.joint_of(one.made.terms), one.made
        try:
            x = joint.begin(before.x)
            orbits = joint.settle(x, before.orbits, 8)
            r, b = joint.parts(x, orbits)
            left, price = reduced(r, b)[0], joint.price(x)
        except (EstimationError, ModelError, np.linalg.LinAlgError):
            return replace(one, cost=np.inf)
        if not np.isfinite(left + price):
            return replace(one, cost=np.inf)
        made = replace(
            before, x=x, objective=left + price, data_part=left, prior_part=price, orbits=tuple(orbits),
            count=int(r.size),
        )  # fmt: skip
        return replace(one, made=made, cost=one.cost - before.objective + made.objective)

    def _finer(self, one: Tried) -> Sequence[Acting] | None:
        """The laws with half as long steps of the march, where a fit leaves more than noise and these leave far less of
        it, all else as it is.
        """
        made = one.made
        if made.data_part < NOISY * made.count or not all(made.orbits):
            return None
        joint = self.joint_of(made.terms)
        if not joint.refine(FINEST):
            return None
        try:
            r, b = joint.parts(made.x, joint.settle(made.x, made.orbits, 8))
        except EstimationError:
            return None
        return joint.terms if reduced(r, b)[0] < SHORTER * made.data_part else None


RACE = 4.0
"""Objective of the best law's above which a rival is not followed to its end; more than what any comparison of two laws
asks of the worse one."""
WEAKER = (0.25, 0.06)
"""Parts of a law's strength at which it is tried where with the whole of it no steady state is found."""
NOISY, SHORTER, FINEST = 1.3, 0.8, 128.0
"""Chi-square per value above which shorter steps are tried; part of it below which they must bring it; and how many to
a period of the highest excited line are tried at most."""


def tried_fit(
    joint: Joint, x: NDArray, orbits: Sequence, lead: Lead, steps: int, *, simulated: bool = True, always: bool = False,
    exact: bool = True, more: Sequence[Lead] = (),
) -> Tried | None:  # fmt: skip
    """The fit of `joint` from `x` as a candidate; None where no steady state is found."""
    try:
        made = fit(joint, x, orbits, steps=steps, always=always, exact=exact)
    except (EstimationError, ModelError, np.linalg.LinAlgError):
        return None
    price = sum(cost(made, one.mechanism) - made.objective for one in more)
    return Tried(lead, made, cost(made, lead.mechanism) + price, simulated, tuple(more))


def softened(joint: Joint, x: NDArray, lead: Lead) -> NDArray[np.float64]:
    """The base without the spring of a slider that sticks at low levels, to first order: that spring it holds twice."""
    n, b = joint.engine.theta0.size, joint.engine.band_modes
    r = next(iter(joint.receptances(joint.start(x)).values()))
    out = x.copy()
    less = 0.5 * lead.p[0] * r.w[0, b] ** 2 / r.omega[b] ** 2
    out[n : n + b.size] -= np.minimum(less, SOFTER)
    return out


SOFTER = 0.05
"""Fall of a frequency at most when a base is set free of what sticks."""


def loudest(one: Tried, runs: Sequence[Run]) -> Orbit | None:
    """Where a simulated law went in the loudest run."""
    return one.made.orbits[int(np.argmax([r.level for r in runs]))]


def of_fit(one: Tried) -> Lead:
    """Its lead with the parameters where its fit ended."""
    return of_fits(one)[0]


def of_fits(one: Tried) -> list[Lead]:
    """The leads of all its laws with the parameters where its fit ended."""
    out = []
    for i, lead in enumerate((one.lead, *one.more)):
        out.append(replace(lead, p=one.made.whole(i)))
    return out


PRICE = 4.0
"""Price of one parameter of a law, in chi-square."""


def cost(made: Made, mechanism: str) -> float:
    """Objective plus the price of the law's parameters; what hysteresis only shapes is not counted."""
    n = 2 if mechanism == "hysteresis" else len(SHAPES[mechanism].names)
    if mechanism == "general":
        n = int(np.count_nonzero(made.x[made.n_base :]))
    return made.objective + PRICE * (n + (1 if mechanism == "hysteresis" else 0))


def leads_of(laws: Sequence[Tried]) -> list[Lead]:
    """Leads of a chain's laws with the parameters of its last fit."""
    last = laws[-1].made
    out = []
    for i, t in enumerate(laws):
        out.append(replace(t.lead, p=last.whole(i)))
    return out
