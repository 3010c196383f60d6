"""The laws of an answer: the best one against its rivals, then one more at a time while prediction gains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, of_fit
from labnnum.diagnosis.nonlinear.decision import MOST_IDENTIFIED
from labnnum.diagnosis.nonlinear.effort import exhausted, spent, tired
from labnnum.diagnosis.nonlinear.elsewhere import answered, as_well
from labnnum.diagnosis.nonlinear.errors import errors_of, settled_on
from labnnum.diagnosis.nonlinear.explore import LINES, LONG, MISLED, STRAINED, engine_start, looked, nearest
from labnnum.diagnosis.nonlinear.further import GAIN, further, needed
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.nonlinear.loosen import in_step
from labnnum.diagnosis.nonlinear.slack import within
from labnnum.diagnosis.nonlinear.study import FINE, UNSURE, at_places
from labnnum.diagnosis.nonlinear.tempered import relaxed
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Limits
from labnnum.mechanisms.base import Place

PROMISE, WORTH = 0.15, 0.3
"""Part of what the first law leaves beyond noise that a second must promise to remove along the motion, which the first
has bent, and that it must remove in the end: of two laws the second must bring the fit near the noise."""
FURTHER = 0.97
"""Part of the held-out error so far that one more law must bring it below."""


def laws_of(
    found: Study, every: Sequence[Spot], train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter,
    limits: Limits, progress: Callable[[str], None], identified: bool = False,
) -> tuple[Study, list[Tried]]:  # fmt: skip
    """The study and its laws: the chain that begins with the best law, and once more where the law that is missed most
    of that chain turns out to be the better beginning.
    """

    def begun(study: Study) -> list[Tried]:
        return _begun(study, every, train, test, scatter, limits, progress, identified)

    laws = begun(found)
    again = restarted(found, laws, scatter)
    return (found, laws) if again is None else (again, begun(again))


def restarted(found: Study, laws: Sequence[Tried], scatter: Scatter) -> Study | None:
    """The study with the law that is missed most as its best; None where the chain began with that, or it costs more
    alone.

    A descent from the recovered motion may end far from where a law fits; beside others it finds the way.
    """
    first, best = laws[0], found.best
    if first.same(best) or not (first.named and first.simulated) or len(first.made.terms) > 1:
        return None
    if first.cost * best.made.count > best.cost * first.made.count:
        return None
    bench = Bench(found.engine, found.point, found.runs, scatter, ()).on(FINE)
    first = bench.carry_on(first, LONG, always=True, last=any(t.last for t in first.made.terms))
    if first.cost * best.made.count > best.cost * first.made.count:
        return None
    return replace(found, tried=(first, *(t for t in found.tried if not t.same(first))))


def _begun(
    found: Study, every: Sequence[Spot], train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter,
    limits: Limits, progress: Callable[[str], None], identified: bool = False,
) -> list[Tried]:  # fmt: skip
    """The chain that begins with the best named law, or the best law without a name where that leaves less.

    A law of one term without a name competes as a named one does, but must lead by as much as tells two names apart:
    catalogues hold what is common. Where it leaves no more than noise, no further laws are looked for.
    """
    named = [t for t in found.tried if t.named and t.simulated]
    best = found.best
    if best.named or not named:
        return chain(found, every, train, test, scatter, limits, progress, identified) if best.named else [best]
    excess = max(1.0, best.made.data_part / best.made.count)
    ahead = (named[0].cost - best.cost) / excess > limits.name
    if ahead and best.made.data_part < NOISE * best.made.count:
        return [best]
    rest = [t for t in found.tried if t is not named[0]]
    laws = chain(replace(found, tried=(named[0], *rest)), every, train, test, scatter, limits, progress, identified)
    last = laws[-1]
    behind = last.cost * best.made.count / last.made.count - best.cost
    return [best] if behind / excess > limits.name else laws


NOISE = 1.3
"""Chi-square per value below which a law leaves nothing for another one."""


def chain(
    found: Study, every: Sequence[Spot], train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter,
    limits: Limits, progress: Callable[[str], None], identified: bool = False,
) -> list[Tried]:  # fmt: skip
    """The best law, then another while the prediction of held-out runs gains.

    Laws that those found later make needless are taken out again. Where the base was `identified` a general law follows
    at last, which takes up what such a base lacks; elsewhere it would only hide that the names are wrong. A term of it
    that is a law of the catalogue is offered by its name first.
    """
    laws = [found.best]
    if laws[0].made.data_part < NOISE * laws[0].made.count:
        return laws

    def held_out(t: Tried) -> float:
        joint, (x, orbits) = settled_on(found, t, train, test, scatter)
        return errors_of(joint, x, orbits, len(train))[1]

    error = held_out(laws[0])
    refused = False
    for kind in ("named", "named", "own", "general") if identified else ("named",):
        full = len({(t.name, t.spot.place) for t in laws if t.named}) >= MOST_IDENTIFIED
        weary = exhausted() and not identified  # other structures were asked before this one
        if (kind == "named" and (refused or weary)) or (kind == "own" and full):
            continue
        progress(f"looking for nonlinear law {len(laws) + 1}")
        promise, worth = (GAIN, GAIN) if identified else (PROMISE, WORTH)
        more = further(
            found, laws[-1], every, scatter, limits.further, general=kind in ("own", "general"), own=kind == "own",
            promise=promise, worth=worth,
        )  # fmt: skip
        told = held_out(more) if more is not None else np.inf
        if more is None or told > FURTHER * error:
            refused = True
            continue
        laws.append(more)
        error = told
    return needed(found, laws, scatter, limits.further) if len(laws) > 1 else laws


def rivals(found: Study, every: Sequence[Spot], scatter: Scatter) -> list[Tried]:
    """The winning law at mirror images of its own spot, and where its force would do nearly as well, or better; where
    it leaves far more than noise, at the spots that explain the distortion next best, and where the distortion comes
    from as the winner's base recovers it.
    """
    best = found.best
    have = {(t.spot.place, t.spot.axis) for t in found.tried if t.mechanism == best.mechanism}
    own = next((q.gain for q in found.recovered if q.spot.place == best.spot.place), found.recovered[0].gain)
    near = [q.spot for q in found.recovered if (q.spot.place, q.spot.axis) not in have and q.gain > RIVAL * own]
    alike = [s for s in twins(found, best.spot, every) if (s.place, s.axis) not in have]
    near = [s for s in near if not any(s.place == o.place for o in alike)]
    some: Sequence[Spot | Lead] = [*alike, *near][:3]
    if best.named and best.simulated and best.made.data_part < UNSURE * best.made.count:
        leads = [q for gain, q in as_well(found, best, every, scatter) if gain > RIVAL]
        leads = [q for q in leads if q.spot.where not in have]
        some = [*alike, *(q for q in leads if not any(q.spot.place == o.place for o in alike))][:ASKED]
    before = spent()
    made = at_places(found, best, some, scatter)
    weary = tired() and (not some or spent() - before > QUICK * len(some))
    asked = [s if isinstance(s, Spot) else s.spot for s in some]
    have |= {s.where for s in asked}
    made += _moved_on(found, min([best, *made], key=lambda t: t.cost), every, scatter, have, 1 if weary else ROUNDS)
    reached = min([best, *made], key=lambda t: t.cost)
    bent = _strained(reached)
    if bent and reached.named and reached.simulated and reached.made.data_part < UNSURE * reached.made.count:
        made += _straightened(found, reached, scatter)
        reached = min([best, *made], key=lambda t: t.cost)
        bent = _strained(reached)
    if (
        reached.named
        and reached.simulated
        and (bent or reached.made.data_part > UNSURE * reached.made.count)
        and not weary
    ):
        made += _unbent(found, reached, every, scatter)
        reached = min([best, *made], key=lambda t: t.cost)
    if reached.simulated and reached.named and _strained(reached) and not weary and _misled(found):
        made += _from_nominal(found, reached, every, scatter)
        reached = min([best, *made], key=lambda t: t.cost)
    if not (reached.simulated and reached.named) or reached.made.data_part < UNSURE * reached.made.count or weary:
        return made
    plain = Bench(found.engine, found.point, found.runs, scatter, ()).on(LINES).joint([])
    again, _ = looked(plain, reached.made.x, every)
    there = [q.spot for q in nearest(again) if (q.spot.place, q.spot.axis) not in have][:ANEW]
    return [*made, *at_places(found, reached, there, scatter)]


def _moved_on(
    found: Study, reached: Tried, every: Sequence[Spot], scatter: Scatter, have: set[tuple[Place, str]], rounds: int
) -> list[Tried]:  # fmt: skip
    """The law that does better at a place that was asked for it, where its force would do as well from there, and so on
    while that is better: of the place that it came from those were asked. `have` holds what was asked, and is added to.
    """
    out: list[Tried] = []
    place = found.best.spot.place
    for _ in range(rounds):
        sure = reached.named and reached.simulated and reached.made.data_part < UNSURE * reached.made.count
        if not sure or reached.spot.place == place:
            break
        place = reached.spot.place
        leads = [q for gain, q in as_well(found, reached, every, scatter) if gain > RIVAL]
        leads = [q for q in leads if q.spot.where not in have][:ASKED]
        have |= {q.spot.where for q in leads}
        made = at_places(found, reached, leads, scatter) if leads else []
        out += made
        reached = min([reached, *made], key=lambda t: t.cost)
    return out


ROUNDS = 3
"""How often a law that does better at another place moves on from there; once after a long search."""


def _straightened(found: Study, one: Tried, scatter: Scatter) -> list[Tried]:
    """A law that leaves little, but for which the base bends, fitted again from the base of the quietest level, or from
    the nominal one where that level is strongly nonlinear itself; none where that is no better.
    """
    bench = Bench(found.engine, found.point, found.runs, scatter, ()).on(LINES).against(one)
    calm = engine_start(bench.joint([])) if _misled(found) else found.quiet.x[: one.made.bare]
    again = bench.again(calm, one, of_fit(one), LONG)
    return [again] if again is not None and again.cost < one.cost else []


def _unbent(found: Study, one: Tried, every: Sequence[Spot], scatter: Scatter) -> list[Tried]:
    """A law for which the base bends far, or that leaves much, at other spots from the base of the quietest level:
    where the distortion is, and where its force would do as well, with the strength and the gap that this takes.

    What is recovered through a base that was bent for the wrong place tells of no other, nor does a motion of it that
    leads there, since next to the right place a law's own bends a little too.
    """
    bench = Bench(found.engine, found.point, found.runs, scatter, ()).on(LINES).against(one)
    bare = found.quiet.x[: one.made.bare]
    out: list[Tried | None] = []
    for q in [q for q in found.recovered if q.spot.place != one.spot.place][:ELSEWHERE]:
        followed = bench.follow(bare, replace(of_fit(one), spot=q.spot), LONG)
        out.append(in_step(bench, followed, LONG) if followed is not None else None)
    moved = [(gain, q) for gain, q in as_well(found, one, every, scatter) if q.spot.place != one.spot.place]
    for _, lead in sorted((row for row in moved if row[0] > RIVAL), key=lambda row: -row[0])[:MOVED]:
        out.append(bench.direct((bare,), lead, LONG, soften=False))
    return [t for t in out if t is not None]


def _from_nominal(found: Study, one: Tried, every: Sequence[Spot], scatter: Scatter) -> list[Tried]:
    """A strong law for which the base bends far, at the other spots where its force would do as well beside the nominal
    base, each from there with a tolerance that narrows; no more of them once one leaves noise and bends no base.
    """
    bench = Bench(found.engine, found.point, found.runs, scatter, ()).on(LINES)
    x = engine_start(bench.joint([]))
    leads = [q for gain, q in answered(bench, x, one, every) if gain > RIVAL and q.spot.place != one.spot.place]
    out: list[Tried] = []
    for lead in leads[:MOVED]:
        made = relaxed(bench, x, [lead])
        out += [] if made is None else [made]
        if out and within(out[-1], UNSURE):
            break
    return out


def _misled(found: Study) -> bool:
    """Whether the quietest level is strongly nonlinear itself, so that its base is another structure's."""
    return found.quiet.data_part > MISLED * found.quiet.count


def _strained(one: Tried) -> bool:
    """Whether the base stands in for something beside a law."""
    return one.made.prior_part > STRAINED * one.made.n_base


ELSEWHERE, MOVED = 3, 4
"""Spots at which a law is tried for which the base bends far, by the distortion and by what its force does there."""


def twins(found: Study, spot: Spot, every: Sequence[Spot]) -> list[Spot]:
    """Other spots that move as much as `spot` in each mode, as the mirror image does of a symmetric structure: near
    each resonance a force there does the same, and only how modes act together tells the two apart.
    """
    shape = found.engine.state(found.engine.theta0).shape[:, found.engine.band_modes]

    def motion(s: Spot) -> NDArray[np.float64]:
        size = np.abs(shape.T @ s.column)
        return size / max(float(np.linalg.norm(size)), 1e-300)

    own = motion(spot)
    near = [(float(own @ motion(s)), s) for s in every if s.place != spot.place]
    return [s for likeness, s in sorted(near, key=lambda pair: -pair[0]) if likeness > TWIN][:MOST]


TWIN, MOST = 0.99, 2
"""Correlation of the motions' sizes over the modes from which on a spot is another one's mirror image; and how many of
these are tried."""

QUICK = 1.0
"""Nominal seconds that a law at another spot takes below which more are tried even after a long search."""
ASKED = 4
"""Spots at which a law that leaves little is tried: mirror images of its own, and by what its force does there."""
ANEW = 2
"""Spots at which a law that leaves far more than noise is tried, as its own base recovers the force."""

RIVAL = 0.8
"""Part of what a general law removes at the best place that it must remove at another for the law to be tried there."""
