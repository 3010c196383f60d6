"""What the recovered motion promises: places in order, leads of every law, and the laws followed along it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.nonlinear.bench import Bench, Tried
from labnnum.diagnosis.nonlinear.effort import ONCE, exhausted, spent
from labnnum.diagnosis.nonlinear.fitting import Made, fit
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.leads import law_leads, ranked
from labnnum.diagnosis.nonlinear.lines import LINES, choose_lines
from labnnum.diagnosis.nonlinear.locate import Background, Lead, Recovered, Spot, recover
from labnnum.diagnosis.nonlinear.problem import Joint, holds_springs
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.stuck import spread_lead, stuck
from labnnum.diagnosis.nonlinear.tempered import Contest, contest, relaxed
from labnnum.diagnosis.scatter import Scatter

LAWS = (
    "cubic-stiffness", "quadratic-stiffness", "quadratic-damping", "coulomb-friction", "one-sided-gap", "clearance",
    "stick-slip",
)  # fmt: skip
"""Laws that are tried from afar; hysteresis starts from stick-slip."""
REGRESSED = (*LAWS, "stiffening")
"""Laws that are regressed on the recovered motion."""
NEAREST = 5
"""Spots, of either order, whose recovered motion is asked for every law."""
IDLE = 0.8
"""Part of the base's chi-square below which a law must come along the motion to be worth simulating,"""
NOISY = 10.0
"""where chi-square per value is above this."""
SOUND = 1.1
"""Chi-square per value that a sound base leaves at most."""
GAINS = 0.9
"""Part of the base's error below which a law must bring it to be of use, held out or, of a sound base, along the
motion."""


@dataclass(frozen=True, eq=False)
class Prospect:
    """What the recovered motion promises: the laws that were followed, best first, and the base they began from."""

    bench: Bench
    calm: Made
    base: Made
    recovered: tuple[Recovered, ...]
    near: tuple[Tried, ...]
    leads: tuple[Lead, ...] = ()
    pairs: tuple[Tried, ...] = ()
    """Two laws that come far nearer than the best alone, simulated, best first."""
    sought: bool = False
    """Whether strong laws are not to be sought from far away any more."""
    seen: tuple[NDArray, list[Recovered], list[Lead]] | None = None
    """A base vector, the forces that it recovers from these runs on these lines, and what named laws promise there."""

    @property
    def level(self) -> float:
        """Chi-square per value that the best law leaves."""
        return self.near[0].made.data_part / self.near[0].made.count

    @property
    def misled(self) -> bool:
        """Whether the base leaves so much of the quietest level that strong laws were sought from the nominal one."""
        return self.calm.data_part > MISLED * self.calm.count

    @property
    def hopeless(self) -> bool:
        """Whether no law removes a fifth of what the base leaves, and that is far more than noise."""
        best = self.near[0]
        whole = self.base.objective * best.made.count / self.base.count
        return best.cost > IDLE * whole and self.level > NOISY

    @property
    def idle(self) -> bool:
        """Whether the base leaves no more than a sound one, and no law so much less that it would predict better."""
        base = self.base.data_part / self.base.count
        return base < SOUND and self.level > GAINS**2 * base

    @property
    def nameless(self) -> bool:
        """Whether a law without a name leaves so much less than every named one that no simulation can turn that.

        What leaves many times the noise itself was followed along a motion that is not the structure's.
        """
        best = self.near[0]
        if best.made.data_part > NOISY * best.made.count:
            return False
        others = [self.base.objective * best.made.count / self.base.count, *(t.cost for t in self.near if t.named)]
        return not best.named and NEAR * best.cost < min(others)


def explore(
    engine: Engine, point: Point, runs: Sequence[Run], quiet: int, spots: Sequence[Spot], scatter: Scatter,
    *, lines: int = LINES, carry_on: bool = True, unnamed: bool = True, strong: bool | None = None,
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
    strong : bool, optional
        Whether a law that is strong at the lowest level too is looked for only, or not again; else before others.
    """
    bench = Bench(engine, point, tuple(runs), scatter, ()).on(lines)
    calm = calmed(engine, point, runs[quiet], scatter, lines)
    plain = bench.joint([])
    base = fit(plain, plain.start(calm.x), [None] * len(runs), steps=12)
    progress("locating")
    nominal = engine_start(plain)
    misled = calm.data_part > MISLED * calm.count
    strained = not misled and calm.prior_part > STRAINED * plain.n_base
    rounds = [nominal, calm.x][: 2 if carry_on else 1] if misled else [calm.x]
    best: Prospect | None = None
    pairs: tuple[Tried, ...] = ()
    for x in rounds:
        found, leads = looked(plain, x, spots, unnamed)
        seen = x, found, [lead for lead in leads if lead.mechanism != "general"]
        near: list[Tried] = []
        shown = misled and carry_on and x is nominal and _shown(bench, base, rounds, leads)
        if misled and carry_on and x is nominal and not shown:
            far = strong is not False and spent() < ONCE and not exhausted()
            look = partial(looked, plain, spots=spots, unnamed=unnamed)
            held = contest(bench, nominal, found, LAWS, leads, progress, look) if far else Contest()
            near, pairs = list(held.near), held.pairs
            if not strong and not pairs and (not near or near[0].made.data_part > LEAVES * base.data_part):
                sliders = [] if holds_springs(bench.engine) else stuck(bench, quiet, found, HELD, LONG)
                near = sorted([*near, *sliders], key=lambda t: t.cost)
        best_of = (*pairs, *near)[:1]
        dry = bool(best_of) and best_of[0].made.data_part < LEAVES * base.data_part
        if strong and not (dry or shown):
            return None
        if dry:
            leads = [lead for lead in leads if lead.spot.place == near[0].spot.place]
            begin = [near[0].made.x[: near[0].made.n_base]]
        else:
            begin = [x, nominal] if strained else rounds if shown else [x]
        if leads:
            progress("following nonlinear laws along the motion")
            near = sorted([*near, *followed(bench, begin, leads, carry_on)], key=lambda t: t.cost)
        if near and (best is None or near[0].cost < best.near[0].cost):
            sought = misled and not shown
            best = Prospect(bench, calm, base, tuple(found), tuple(near), tuple(leads), pairs, sought, seen)
        if dry or shown or (near and near[0].made.data_part < MISLED * near[0].made.count):
            break
    if best is not None and carry_on and not misled and best.level > MISLED and not holds_springs(bench.engine):
        # a slider that sticks at the quietest level is a spring, which a base with free stiffness takes for its own
        sliders = stuck(bench, quiet, best.recovered, HELD, LONG)
        best = replace(best, near=tuple(sorted([*best.near, *sliders], key=lambda t: t.cost)))
    return best


def resumed(
    engine: Engine, point: Point, runs: Sequence[Run], quiet: int, spots: Sequence[Spot], scatter: Scatter,
    given: Sequence[Sequence[Lead]], begin: NDArray,
) -> Prospect | None:  # fmt: skip
    """Laws that were found on another engine, in any of the forms `given`, simulated on this one; None where none is.

    Parameters
    ----------
    begin : ndarray
        Base vector from which they are fitted.
    """
    bench = Bench(engine, point, tuple(runs), scatter, ()).on(LINES)
    calm = calmed(engine, point, runs[quiet], scatter)
    plain = bench.joint([])
    base = fit(plain, plain.start(calm.x), [None] * len(runs), steps=12)
    made = [relaxed(bench, begin, leads) for leads in given]
    near = sorted((t for t in made if t is not None), key=lambda t: t.cost)
    if not near:
        return None
    misled = calm.data_part > MISLED * calm.count
    return Prospect(bench, calm, base, tuple(recovered(plain, calm.x, spots)[1]), tuple(near[:1]), sought=misled)


def _shown(bench: Bench, base: Made, starts: Sequence[NDArray], leads: Sequence[Lead]) -> bool:
    """Whether a law explains nearly all along the motion, and no base is bent for it: it is simulated then, and strong
    laws are sought from afar only where that leaves too much.
    """
    near = followed(bench, starts, leads, carry_on=False) if leads else []
    made = near[0].made if near else None
    if made is None or made.prior_part > STRAINED * made.n_base:
        return False
    return made.data_part * base.count < PLAIN * base.data_part * made.count


def calmed(engine: Engine, point: Point, run: Run, scatter: Scatter, lines: int = LINES) -> Made:
    """The base model alone, fitted to the run that distorts least."""
    alone = Joint(engine, point, [run], (), scatter, [choose_lines(run, 2 * lines, scatter.floor)])
    return fit(alone, alone.start(), [None], steps=15)


STRAINED = 4.0
"""Price of the base at the quietest level, of its entries, above which its parameters stand in for a law."""
MISLED = 5.0
"""Chi-square per value of the base at the quietest level above which it may be a strong law that it was fitted to."""


PLAIN = 0.01
"""Part of what the base leaves up to which a law leaves nearly nothing along the motion."""
HELD, LEAVES = 2, 0.1
"""Places at which sliders that stick at the quietest level are looked for; and the part of what the base leaves that a
strong law may leave for nothing else to be looked for elsewhere."""


def looked(
    plain: Joint, x: NDArray, spots: Sequence[Spot], unnamed: bool = False
) -> tuple[list[Recovered], list[Lead]]:  # fmt: skip
    """Spots ranked by the forces recovered with the base at `x`, and what every law promises at the nearest."""
    background, found = recovered(plain, x, spots)
    leads = [lead for q in nearest(found) for lead in law_leads(background, q, REGRESSED)]
    if unnamed:
        leads += [lead for q in nearest(found) for lead in q.unnamed]
    return found, leads


def recovered(plain: Joint, x: NDArray, spots: Sequence[Spot]) -> tuple[Background, list[Recovered]]:
    """What the base at `x` leaves, and the spots ranked by the forces that it recovers there."""
    background = Background(plain, x[: plain.n_base])
    return background, ranked(background, [recover(plain, x, plain.point, s) for s in spots])


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
    x[n + 3 * m] = plain.engine.start().law[0]
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
EQUAL = 0.9
"""Part of the gain that the best follow promised from which on another is carried on all the same: it may be slower."""
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
    """Leads fitted along the recovered motion, best first; many sliders and hysteresis wherever a slider comes near.

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
    ahead = -np.inf
    for i, t in enumerate(first):
        slow = t.spot.place in prime and t.mechanism in SLOW
        equal = t.lead.gain > EQUAL * ahead
        if t.cost < (limit if equal else min(limit, BEATEN * best)) and (i < BRIEF or slow):
            t = bench.follow_on(t, LONG)
        if t.cost < best:
            best, ahead = t.cost, t.lead.gain
        done.append(t)
    done.sort(key=lambda t: t.cost)
    for t in [t for t in done if t.mechanism == "stick-slip" and t.cost < NEAR * done[0].cost][:2]:
        lead = spread_lead(t)
        softer = _smooth(bench, t), bench.follow(t.made.x[: t.made.n_base], lead, LONG)
        done += [s for s in softer if s is not None]
    return sorted(done, key=lambda t: t.cost)


def _smooth(bench: Bench, slider: Tried) -> Tried | None:
    """Hysteresis in place of a slider."""
    p, _ = slider.made.law(0)
    start = np.zeros(N_P)
    start[:4] = p[0], p[1] / max(p[0], 1e-300), 1.5, 0.5
    lead = Lead(slider.spot, "hysteresis", start, slider.lead.gain)
    return bench.follow(slider.made.x[: slider.made.n_base], lead, LONG)
