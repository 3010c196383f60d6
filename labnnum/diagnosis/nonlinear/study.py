"""Which nonlinear law acts, and where: leads from recovered forces, followed along the motion, the best simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.fit import Scatter
from labnnum.diagnosis.nonlinear.follow import Followed, marched_from
from labnnum.diagnosis.nonlinear.laws import SHAPES
from labnnum.diagnosis.nonlinear.lines import Lines, choose_lines
from labnnum.diagnosis.nonlinear.locate import (
    Background,
    Lead,
    Recovered,
    Spot,
    general_lead,
    law_leads,
    ranked,
    recover,
)  # fmt: skip
from labnnum.diagnosis.nonlinear.march import N_P
from labnnum.diagnosis.nonlinear.problem import Joint, Made, fit
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.errors import EstimationError

LAWS = (
    "cubic-stiffness", "quadratic-stiffness", "quadratic-damping", "coulomb-friction", "one-sided-gap", "clearance",
    "stick-slip",
)  # fmt: skip
"""Laws that are regressed on the recovered motion; hysteresis starts from stick-slip."""
LINES = 160
"""Lines of a run on which laws are sought."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A law at a spot, fitted; `cost` its objective plus the price of its parameters.

    `simulated`: whether the fit was by simulation, and not along the recovered motion only.
    """

    lead: Lead
    made: Made
    cost: float
    simulated: bool = True

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

    def same(self, other: Tried) -> bool:
        """Whether both are one answer."""
        same_terms = self.named or np.array_equal(self.lead.p != 0, other.lead.p != 0)
        return self.mechanism == other.mechanism and self.spot.place == other.spot.place and same_terms


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

    def on(self, most: int) -> Bench:
        """The same with `most` lines a run."""
        return replace(self, lines=tuple(choose_lines(r, most, self.scatter.floor) for r in self.runs))

    def joint(self, leads: Sequence[Lead]) -> Joint:
        """The objective of laws that are simulated."""
        return Joint(self.engine, self.point, self.runs, [lead.acting() for lead in leads], self.scatter, self.lines)

    def follow(self, x: NDArray, lead: Lead, steps: int) -> Tried | None:
        """A law fitted along the recovered motion, from the base vector `x`."""
        joint = Followed(self.engine, self.point, self.runs, lead.acting(), self.scatter, self.lines)
        return _tried(joint, joint.start(x), [None] * len(self.runs), lead, steps, simulated=False)

    def follow_on(self, one: Tried, steps: int) -> Tried:
        """The same carried on."""
        return self.follow(one.made.x[: one.made.n_base], of_fit(one), steps) or one

    def simulate(self, one: Tried, steps: int) -> Tried | None:
        """A law that was followed, fitted by simulation: from its force along the motion, or else from nothing."""
        joint = self.joint([of_fit(one)])
        made = _tried(joint, one.made.x, marched_from(joint, one.made.x, one.made.orbits), one.lead, steps)
        return made or _tried(joint, one.made.x, [None] * len(self.runs), one.lead, steps)

    def direct(self, starts: Sequence[NDArray], lead: Lead, steps: int) -> Tried | None:
        """A law fitted by simulation from what the recovered motion promised, from several base vectors."""
        joint = self.joint([lead])
        begin = [joint.start(x) for x in starts]
        if lead.mechanism == "stick-slip":
            begin.append(joint.start(softened(joint, starts[0], lead)))
        made = [_tried(joint, x, [None] * len(self.runs), lead, steps) for x in begin]
        return min((t for t in made if t is not None), key=lambda t: t.cost, default=None)

    def carry_on(self, one: Tried, steps: int, *, always: bool = False) -> Tried:
        """A simulated fit carried on, on other lines perhaps."""
        joint = Joint(self.engine, self.point, self.runs, one.made.terms, self.scatter, self.lines)
        return _tried(joint, one.made.x, one.made.orbits, one.lead, steps, always=always) or one


def _tried(
    joint: Joint, x: NDArray, orbits: Sequence, lead: Lead, steps: int, *, simulated: bool = True, always: bool = False
) -> Tried | None:  # fmt: skip
    try:
        made = fit(joint, x, orbits, steps=steps, always=always)
    except (EstimationError, np.linalg.LinAlgError):
        return None
    return Tried(lead, made, cost(made, lead.mechanism), simulated)


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


def of_fit(one: Tried) -> Lead:
    """Its lead with the parameters where its fit ended."""
    p, _ = one.made.law(0)
    full = np.zeros(N_P)
    full[: p.size] = p
    return replace(one.lead, p=full)


ENOUGH = 1.15
"""Chi-square per value at which a law leaves nothing for a general one to explain."""
NEAREST = 5
"""Spots, of either order, whose recovered motion is asked for every law."""
PRICE = 4.0
"""Price of one parameter of a law, in chi-square."""


def cost(made: Made, mechanism: str) -> float:
    """Objective plus the price of the law's parameters; what hysteresis only shapes is not counted."""
    n = 2 if mechanism == "hysteresis" else len(SHAPES[mechanism].names)
    if mechanism == "general":
        n = int(np.count_nonzero(made.x[made.n_base :]))
    return made.objective + PRICE * (n + (1 if mechanism == "hysteresis" else 0))


IDLE = 0.8
"""Part of the base's chi-square below which a law must come along the motion to be worth simulating,"""
NOISY = 10.0
"""where chi-square per value is above this."""


@dataclass(frozen=True, eq=False)
class Prospect:
    """What the recovered motion promises: the laws that were followed, best first, and the base they began from."""

    bench: Bench
    calm: Made
    base: Made
    recovered: tuple[Recovered, ...]
    near: tuple[Tried, ...]
    leads: tuple[Lead, ...] = ()

    @property
    def level(self) -> float:
        """Chi-square per value that the best law leaves."""
        return self.near[0].made.data_part / self.near[0].made.count

    @property
    def hopeless(self) -> bool:
        """Whether no law removes a fifth of what the base leaves, and that is far more than noise."""
        best = self.near[0]
        whole = self.base.objective * best.made.count / self.base.count
        return best.cost > IDLE * whole and self.level > NOISY

    @property
    def nameless(self) -> bool:
        """Whether a law without a name leaves so much less than every named one that no simulation can turn that."""
        best = self.near[0]
        others = [self.base.objective * best.made.count / self.base.count, *(t.cost for t in self.near if t.named)]
        return not best.named and NEAR * best.cost < min(others)


def explore(
    engine: Engine, point: Point, runs: Sequence[Run], quiet: int, spots: Sequence[Spot], scatter: Scatter,
    *, lines: int = LINES, carry_on: bool = True, unnamed: bool = True,
    progress: Callable[[str], None] = lambda text: None,
) -> Prospect | None:  # fmt: skip
    """Fit the base, locate, regress, and follow the leads along the recovered motion.

    Parameters
    ----------
    runs : sequence of Run
        Training runs at their levels.
    quiet : int
        Number of the one that distorts least.
    spots : sequence of Spot
    carry_on : bool
        Whether all that came near after a few steps is followed to the end, or the nearest two only.
    unnamed : bool
        Whether smooth laws of one term that have no name compete with the named ones.
    """
    bench = Bench(engine, point, tuple(runs), scatter, ()).on(lines)
    alone = Joint(engine, point, [runs[quiet]], (), scatter, [choose_lines(runs[quiet], 2 * lines, scatter.floor)])
    calm = fit(alone, alone.start(), [None], steps=15)
    plain = bench.joint([])
    base = fit(plain, plain.start(calm.x), [None] * len(runs), steps=12)
    progress("locating")
    nominal = engine_start(plain)
    found, leads = looked(plain, calm.x, spots, unnamed)
    near: list[Tried] = []
    if leads:
        progress("following nonlinear laws along the motion")
        near = followed(bench, (calm.x, nominal), leads, carry_on)
    if calm.data_part > MISLED * calm.count and not (near and near[0].made.data_part < MISLED * near[0].made.count):
        other, leads = looked(plain, nominal, spots, unnamed)
        again = followed(bench, (nominal,), leads, carry_on) if leads else []
        if again and (not near or again[0].cost < near[0].cost):
            near, found = sorted([*again, *near], key=lambda t: t.cost), other
    return Prospect(bench, calm, base, tuple(found), tuple(near), tuple(leads)) if near else None


PROMISING = 0.85
"""Part of the best lead's gain above which another is simulated from where it stands."""


def search(
    seen: Prospect, progress: Callable[[str], None] = lambda text: None, *, unsure: bool = False
) -> Study | None:  # fmt: skip
    """The laws that came nearest along the recovered motion, fitted by simulation; a general law beside them.

    Where the base is `unsure` of motions that no sensor sees, as one that was identified is, so is what is recovered
    through it: the best leads are then simulated from where the score left them, too.
    """
    progress("fitting nonlinear laws")
    bench = seen.bench
    tried = simulated(bench, seen.near)
    if unsure and seen.leads:
        top = max(lead.gain for lead in seen.leads)
        some = [lead for lead in seen.leads if lead.gain > PROMISING * top and lead.mechanism != "hysteresis"]
        starts = (seen.calm.x, engine_start(bench.joint([])))
        straight = [bench.direct(starts, lead, LONG) for lead in sorted(some, key=lambda lead: -lead.gain)[:FRONT]]
        tried = sorted([*tried, *(t for t in straight if t is not None)], key=lambda t: t.cost)
    if not tried:
        return None
    best = tried[0].made
    law = None
    if best.data_part > ENOUGH * best.count:
        background = Background(bench.joint([]), seen.near[0].made.x[: seen.calm.n_base])
        general = [general_lead(background, q) for q in nearest(seen.recovered)]
        law = _general(bench, tried[0], general)
    return Study(
        bench.engine, bench.point, bench.runs, seen.base, seen.calm, tuple(tried), law, seen.recovered
    )  # fmt: skip


def of_known(
    engine: Engine, point: Point, runs: Sequence[Run], quiet: int, known: Sequence[Lead], scatter: Scatter,
    lines: int = 250,
) -> Study | None:  # fmt: skip
    """The laws that a model holds already, fitted with the base; None where they do not settle."""
    bench = Bench(engine, point, tuple(runs), scatter, ()).on(lines)
    plain = bench.joint([])
    base = fit(plain, plain.start(), [None] * len(runs), steps=12)
    joint = bench.joint(known)
    tried = _tried(joint, joint.start(), [None] * len(runs), known[0], 8)
    return None if tried is None else Study(engine, point, tuple(runs), base, base, (tried,), None, ())


MISLED = 5.0
"""Chi-square per value of the base at the quietest level above which it may be a strong law that it was fitted to."""


def looked(
    plain: Joint, x: NDArray, spots: Sequence[Spot], unnamed: bool = False
) -> tuple[list[Recovered], list[Lead]]:  # fmt: skip
    """Spots ranked by the forces recovered with the base at `x`, and what every law promises at the nearest."""
    background = Background(plain, x[: plain.n_base])
    found = ranked(background, [recover(plain, x, plain.point, s) for s in spots])
    leads = [lead for q in nearest(found) for lead in law_leads(background, q, LAWS)]
    if unnamed:
        leads += [lead for q in nearest(found) for lead in q.unnamed]
    return found, leads


def nearest(found: Sequence[Recovered]) -> list[Recovered]:
    """Spots that stand out: by what a general law removes there, and by the share of the distortion of a force there.

    A base that a strong law has misled spoils the first more than the second, which any force has where there are no
    more sensors than places.
    """
    by_share = sorted(found, key=lambda q: -q.share)
    return [q for q in found if q in found[:NEAREST] or q in by_share[:NEAREST]]


def engine_start(plain: Joint) -> NDArray[np.float64]:
    """The nominal model's vector."""
    n, m = plain.engine.theta0.size, plain.engine.band_modes.size
    x = plain.start()
    x[:n], x[n : n + m], x[n + 2 * m : n + 3 * m] = plain.engine.theta0, 0.0, 0.0
    x[n + m : n + 2 * m] = np.log(plain.engine.zeta0[plain.engine.band_modes])
    return x


# -------------------------------------------------------------------- along the motion

FAINT = 0.05
"""Part of the best lead's gain below which a lead is not followed."""
QUICK, LONG = 3, 10
"""Steps of a follow that begins well, and of those that came near."""
SLOW = ("stick-slip", "coulomb-friction")
"""Laws that come near late."""
BEATEN = 10.0
"""Cost, of the least so far, above which a follow is not carried on."""
PRIME = 2
"""Places, by the best lead and by the best follow after one step, at which every law is carried on: a law with memory
begins badly where a smooth one does well."""
BRIEF = 12
"""Follows, the best after one step, that are carried on however far behind; those that are carried on to the end at
most; leads followed where a channel is left out."""
NEAR = 3.0
"""Cost, of the least, below which a follow is carried on; and simulated."""


def followed(
    bench: Bench, starts: Sequence[NDArray], leads: Sequence[Lead], carry_on: bool = True
) -> list[Tried]:  # fmt: skip
    """Leads fitted along the recovered motion, best first; hysteresis wherever a slider comes near.

    `starts` are base vectors: a strong law may have misled the base that was fitted without it.
    """
    top = max(lead.gain for lead in leads)
    some = [lead for lead in leads if lead.gain > FAINT * top and lead.mechanism != "hysteresis"]
    some.sort(key=lambda lead: -lead.gain)
    begun: list[Tried] = []
    for lead in some if carry_on else some[:BRIEF]:
        made = [bench.follow(x, lead, 1) for x in starts]
        begun += sorted((t for t in made if t is not None), key=lambda t: t.cost)[:1]
    begun.sort(key=lambda t: t.cost)
    if not begun:
        return []
    prime = [*dict.fromkeys(t.spot.place for t in begun)][:PRIME]
    prime += [*dict.fromkeys(lead.spot.place for lead in some)][:PRIME]
    limit = NEAR * begun[0].cost
    first = [
        bench.follow_on(t, QUICK - 1) if i < BRIEF or t.cost < limit or t.spot.place in prime else t
        for i, t in enumerate(begun)
    ]
    first.sort(key=lambda t: t.cost)
    if not carry_on:
        return sorted([*(bench.follow_on(t, LONG) for t in first[:2]), *first[2:]], key=lambda t: t.cost)
    limit = NEAR * first[0].cost
    done: list[Tried] = []
    best = np.inf
    for i, t in enumerate(first):
        slow = t.spot.place in prime and t.mechanism in SLOW
        if t.cost < min(limit, BEATEN * best) and (i < BRIEF or slow):
            t = bench.follow_on(t, LONG)
        best = min(best, t.cost)
        done.append(t)
    done.sort(key=lambda t: t.cost)
    for t in [t for t in done if t.mechanism == "stick-slip" and t.cost < NEAR * done[0].cost][:2]:
        smooth = _smooth(bench, t)
        if smooth is not None:
            done.append(smooth)
    return sorted(done, key=lambda t: t.cost)


def _smooth(bench: Bench, slider: Tried) -> Tried | None:
    """Hysteresis in place of a slider."""
    p, _ = slider.made.law(0)
    start = np.zeros(N_P)
    start[:4] = p[0], p[1] / max(p[0], 1e-300), 1.5, 0.5
    lead = Lead(slider.spot, "hysteresis", start, slider.lead.gain)
    return bench.follow(slider.made.x[: slider.made.n_base], lead, LONG)


FRONT = 4
"""Follows that are simulated, at most,"""
UNNAMED_FRONT = 2
"""and of laws that have no name;"""
FAR_FRONT = (2, 1)
"""the same where none comes near the noise."""
CLOSE = 1.5
"""Cost, of the least, below which a follow may turn out better when it is simulated."""


def simulated(bench: Bench, near: Sequence[Tried]) -> list[Tried]:
    """The follows that came nearest fitted by simulation, then the others as they are."""
    out: list[Tried] = []
    best = np.inf
    far = near[0].made.data_part > NOISY * near[0].made.count
    most = FAR_FRONT if far else (FRONT, UNNAMED_FRONT)
    for t in near:
        enough = sum(o.simulated for o in out)
        alike = sum(o.simulated for o in out if o.named == t.named)
        if alike >= most[0 if t.named else 1] or (
            enough and t.cost > CLOSE * min(best, near[0].cost) and t.cost > best
        ):
            out.append(t)
            continue
        one = bench.simulate(t, LONG)
        if one is None:
            continue
        out.append(one)
        best = min(best, one.cost)
    if not any(t.simulated for t in out):
        return []
    return sorted(out, key=lambda t: t.cost)


def _general(bench: Bench, best: Tried, leads: Sequence[Lead]) -> Tried | None:
    """The general law where it promises most and at the best candidate's spot, followed, and the better simulated."""
    leads = sorted((lead for lead in leads if lead.gain > 0), key=lambda lead: -lead.gain)
    own = next((g for g in leads if g.spot.place == best.spot.place), None)
    some = leads[:2] if own is None or own in leads[:2] else [*leads[:2], own]
    made = [bench.follow(best.made.x[: best.made.n_base], g, LONG) for g in some]
    near = sorted((t for t in made if t is not None), key=lambda t: t.cost)
    done = [bench.simulate(t, LONG) for t in near[:1]]
    return next((t for t in done if t is not None), None)


def at_places(study: Study, best: Tried, spots: Sequence[Spot], scatter: Scatter, lines: int = LINES) -> list[Tried]:
    """The winning law at other spots: followed, and simulated where that comes near."""
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(lines)
    x = best.made.x[: best.made.n_base]
    made = [bench.follow(x, replace(of_fit(best), spot=s), LONG) for s in spots]
    near = [t for t in made if t is not None]
    done = [bench.simulate(t, LONG) if t.cost < CLOSE * best.cost else t for t in near]
    return [t for t in done if t is not None]


FINE = 350
"""Lines of a run on which the best laws are told apart, and their gain over the base is judged."""


def base_again(study: Study, scatter: Scatter, lines: int = FINE) -> Made:
    """The base fitted to as many lines as the best laws are: gains are differences on the same data."""
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(lines)
    return fit(bench.joint([]), study.base.x, [None] * len(study.runs), steps=6)


def refined(study: Study, scatter: Scatter, more: Sequence[Tried], lines: int = FINE, most: int = 2) -> list[Tried]:
    """All candidates, best first, the `most` best fitted on more lines so that near ones are told apart.

    Costs of the others are raised by what the best's own rose with the lines: they stay comparable.
    """
    everyone = sorted((t for t in [*study.tried, *more] if np.isfinite(t.cost)), key=lambda t: t.cost)
    front: list[Tried] = []
    for t in everyone:
        if not any(t.same(o) for o in front):
            front.append(t)
    shown = [t for t in front if t.simulated]
    if not shown:
        return []
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(lines)
    limit = shown[0].cost * 3 + 1e3
    kept = [*shown[:most], *[t for t in shown if t.named][:1]]  # the best name too, to be told from what has none
    kept = [t for i, t in enumerate(kept) if t not in kept[:i] and (t is shown[0] or t.cost < limit)]
    done = [bench.carry_on(t, 4) for t in kept]
    best = min(done, key=lambda t: t.cost)
    sure = bench.carry_on(best, 2, always=True)
    done = [sure if t is best else t for t in done]
    ratio = sure.made.count / shown[0].made.count
    rest = [replace(t, cost=t.cost * ratio) for t in front if not any(t.same(o) for o in done)]
    ahead = sorted([*done, *(t for t in rest if t.simulated)], key=lambda t: t.cost)
    return [ahead[0], *sorted([*ahead[1:], *(t for t in rest if not t.simulated)], key=lambda t: t.cost)]
