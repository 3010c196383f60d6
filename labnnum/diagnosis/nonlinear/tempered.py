"""Strong laws fitted from far away: first with a wide tolerance on every line, then with narrower ones.

A law that holds or pushes hard changes the structure so much that the base model fitted without it is another one's,
and a motion recovered through that base is nobody's. From the nominal model a simulated law could come to the truth,
but peaks that stand a little beside each other leave hundreds of times the noise, and a descent ends wherever it may
flatten them. With a tolerance of a third of the response around a line only the law's size counts; from there each
narrower tolerance begins near its own best (continuation in the scale of the errors: Blake and Zisserman 1987,
graduated non-convexity).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, loudest, of_fit
from labnnum.diagnosis.nonlinear.duet import duets
from labnnum.diagnosis.nonlinear.effort import spent
from labnnum.diagnosis.nonlinear.fitting import Made, calmed, fit
from labnnum.diagnosis.nonlinear.laws import FRACTIONS, SHAPES, candidates, force_along
from labnnum.diagnosis.nonlinear.leads import named_like, unnamed_like
from labnnum.diagnosis.nonlinear.lines import LINES, choose_lines
from labnnum.diagnosis.nonlinear.locate import Lead, Recovered, Spot
from labnnum.diagnosis.nonlinear.nearby import heard, moved
from labnnum.diagnosis.nonlinear.numbered import numbered
from labnnum.diagnosis.nonlinear.problem import reduced
from labnnum.diagnosis.nonlinear.run import shortened
from labnnum.diagnosis.nonlinear.slack import (
    BEGUN,
    BOTH,
    BRIEF,
    CARRIED,
    ENDED,
    FAR,
    LADDER,
    LAST,
    ROUGH,
    ROUGHLY,
    SETTLED,
    STEPS,
    UNFIT,
    nearest_of,
    sharp,
    slackened,
    within,
)
from labnnum.diagnosis.nonlinear.stuck import smooth_of, spread_of
from labnnum.mechanisms.base import Place

SIZES = (0.1, 0.4, 1.6), (0.07, 0.2, 0.5, 1.2, 3.0)
"""Strengths that are looked at, of laws with a gap or slip and of others: the force along the motion that the nominal
model recovers, of the one recovered."""
GLIMPSE, LEAST = 0.25, 4096
"""Part of a stretch of noise on which laws are fitted with the widest tolerance, and samples of it at least."""
CORNERS = FRACTIONS[[0, 2, 4]]
"""Gaps and slip motions that are looked at, of the largest motion."""
SPOTS, ALIKE = 3, 0.9
"""Spots, by the share of the distortion that a force there explains, at which laws are looked at; and the part of the
first one's share that another must have."""
BEHIND = 10.0
"""Cost after the first steps, of the least, above which a law is not carried on."""
CLEAR = 0.2
"""Part of what the base alone leaves with the widest tolerance below which a law is the one: others are then fitted at
its place only."""
FAR_OFF = 15.0
"""Nominal seconds of one search from afar after which only the nearest law is followed."""
HELPS = 0.9
"""Part of what the base alone leaves with the widest tolerance above which nothing is sought beside a law;"""
HOPEFUL = 0.35
"""Part of that above which no law is."""


Look = Callable[[NDArray], tuple[Sequence[Recovered], Sequence[Lead]]]
"""What a base vector shows: forces at every spot, and what laws promise at the nearest."""


@dataclass(frozen=True, eq=False)
class Contest:
    """Laws alone, best first, and those of which the first beside a second came far nearer than it did alone."""

    near: tuple[Tried, ...] = ()
    pairs: tuple[Tried, ...] = ()


def contest(
    bench: Bench, x: NDArray, found: Sequence[Recovered], laws: Sequence[str], leads: Sequence[Lead] = (),
    progress: Callable[[str], None] = lambda text: None, look: Look | None = None,
) -> Contest:  # fmt: skip
    """Laws at the spots whose force explains most of the distortion, fitted from far away; best first.

    Parameters
    ----------
    x : ndarray
        Vector of the nominal base.
    found : sequence of Recovered
        Forces and motions that the nominal base shows.
    laws : sequence of str
        Mechanisms that are looked at.
    leads : sequence of Lead
        What the recovered motion promises; those at the spots are looked at too.
    look : callable, optional
        Forces and leads as another base vector shows them: the base alone, fitted with the widest tolerance, has the
        peaks where they are, and the nominal one beside them. Its foremost spots are looked at as well.
    """
    ladder, alone = _begins(bench, x)
    if alone is None:
        return Contest()
    progress("simulating strong laws")
    shown = [(x, _foremost(found), leads)]
    if look is not None:  # that base may be bent already, so that its spots are looked at from the nominal one too
        seen, more = look(alone.x)
        ahead, have = _foremost(seen), [q.spot.column for q in shown[0][1]]
        other = [q for q in ahead if not any(np.array_equal(q.spot.column, c) for c in have)]
        shown += [(alone.x, ahead, more), (x, other, ())]
    glimpse, latest = _glimpse(bench), spent() + FAR_OFF
    near, alone = _widest(glimpse, x, alone, shown, [q.spot for q in found], laws, ladder[0], latest)
    wide = slackened(bench, ladder[0])
    if glimpse is not bench:
        whole = [wide.direct((t.made.x[: t.made.n_base],), of_fit(t), STEPS, soften=False) for t in near]
        near = _nearest([t for t in whole if t is not None], CARRIED)
    if not near or near[0].cost * alone.count > HELPS * alone.objective * near[0].made.count:
        return Contest()
    told = not near[0].named and within(near[0], heard(bench, wide))
    firsts = [] if told else [t for t in near if t.named]
    pairs = [] if spent() > latest else duets(bench, firsts, [q.spot for q in found], laws, ladder)
    if near[0].cost * alone.count > HOPEFUL * alone.objective * near[0].made.count and not pairs:
        return Contest()
    near = near[:1] if pairs else near
    jumps = near[0].mechanism == "coulomb-friction"  # with coarse steps the next tolerance would bend its base
    for slack in (*ladder[2 if jumps else 1 :], 0.0):
        on, steps = (slackened(bench, slack), STEPS) if slack else (bench, LAST)
        carried: list[Tried] = []
        for t in near[: 1 if spent() > latest else len(near)]:
            racing = on.against(*(one for one in carried if one.named))
            made = racing.carry_on(t, steps, last=sharp(t) and slack < ROUGH)
            carried.append(_unbent(racing, x, made, steps))
        near = _nearest([t for t in carried if np.isfinite(t.cost)], CARRIED if slack else ENDED)
        if not near:
            return Contest()
    return Contest(tuple(near), tuple(t for t in pairs if t.cost < BETTER * near[0].cost))


def _unbent(bench: Bench, x: NDArray, t: Tried, steps: int) -> Tried:
    """A law that a narrower tolerance leaves unfit, or from the base vector `x` and where it is, whichever costs less:
    with a wide one the base may have gone where the law could not follow.
    """
    if t.more or not t.named or t.made.data_part < UNFIT * t.made.count:
        return t
    again = bench.against(t).again(x, t, of_fit(t), steps)
    return again if again is not None and again.cost < t.cost else t


def _nearest(tried: list[Tried], most: int) -> list[Tried]:
    """The best named laws, as far as they are near the first of them, and one without a name that is better."""
    named = nearest_of([t for t in tried if t.named], most)
    least = min((t.cost for t in named), default=np.inf)
    return sorted([*named, *(t for t in tried if not t.named and t.cost < least)], key=lambda t: t.cost)


Shown = tuple[NDArray, Sequence[Recovered], Sequence[Lead]]
"""A base vector, the spots that it shows, and what laws promise there."""


def _widest(
    bench: Bench, x: NDArray, base: Made, shown: Sequence[Shown], spots: Sequence[Spot], laws: Sequence[str],
    slack: float, latest: float,
) -> tuple[list[Tried], Made]:  # fmt: skip
    """Laws fitted with the widest tolerance, best first, and what the base alone leaves, begun from `base`. After
    `latest` of the search no other form or place of those that were begun is tried.
    """
    wide = slackened(bench, slack)
    joint = wide.joint([])
    alone = fit(joint, joint.start(base.x), [None] * len(wide.runs), steps=STEPS)
    clear, noise = CLEAR * alone.data_part, heard(bench, wide)
    promised = _once(_promising(bench, *one, laws, slack) for one in shown)
    begun = _begun(wide, promised, BEGUN if len(shown) == 1 else BOTH, clear)
    if spent() < latest:
        begun += _kin(wide, promised, begun, clear)
    near: list[Tried] = []
    for t in nearest_of(begun, CARRIED, BEHIND):
        near.append(wide.carry_on(t, SETTLED, last=False) if spent() < latest or not near else t)
    if spent() < latest:
        near = nearest_of([*near, *_turned(wide, x, near, min(clear / alone.count, noise))], CARRIED)
    if spent() < latest:
        near = nearest_of([*near, *moved(wide, x, near, spots, noise)], CARRIED)
    kin = _kindred(wide, near, laws, noise) if spent() < latest else []
    return sorted([*near, *kin], key=lambda t: t.cost), alone


def _glimpse(bench: Bench) -> Bench:
    """The bench over parts of its stretches of noise: with the widest tolerance these tell as much."""
    runs = tuple(shortened(r, max(GLIMPSE, LEAST / r.period)) for r in bench.runs)
    if all(a is b for a, b in zip(runs, bench.runs, strict=True)):
        return bench
    return replace(bench, runs=runs, lines=tuple(choose_lines(r, LINES, bench.scatter.floor) for r in runs))


BETTER = 0.4
"""Part of what the best law alone leaves to which two must bring it."""


def relaxed(bench: Bench, x: NDArray, leads: Sequence[Lead]) -> Tried | None:
    """Laws fitted together from the base vector `x` and from where they are, with a tolerance that narrows; None where
    no steady state is found.
    """
    t = slackened(bench, LADDER[1]).both(x, leads, SETTLED)
    if t is None:
        return None
    for slack in (*LADDER[2:], 0.0):
        on, steps = (slackened(bench, slack), STEPS) if slack else (bench, LAST)
        before, t = t, on.carry_on(t, steps, last=sharp(t) and slack < ROUGH)
        if t.made.data_part > UNFIT * t.made.count and before.made.data_part < UNFIT * before.made.count:
            fewer = numbered(on, replace(t, made=replace(t.made, x=before.made.x)), STEPS)  # before the base bends
            t = t if fewer is None else fewer
    return t


def _kindred(wide: Bench, near: Sequence[Tried], laws: Sequence[str], noise: float) -> list[Tried]:
    """The best named law, and the best without a name, that makes nearly the same force as the nearest one, if that
    leaves more than `noise` a value or bends the base, and these cost less.
    """
    best = min(near, key=lambda t: t.cost, default=None)
    if best is None or within(best, noise):
        return []
    loud = loudest(best, wide.runs)
    if loud is None:
        return []
    racing, base = wide.against(best), best.made.x[: best.made.n_base]
    leads = [*named_like(best.lead, loud, laws), *unnamed_like(best.lead, loud, SIMILAR)[:NAMELESS]]
    made = [one for q in leads if (one := racing.direct((base,), q, STEPS, soften=False)) is not None]
    made = [*nearest_of([t for t in made if t.named], 1), *nearest_of([t for t in made if not t.named], 1)]
    return [t for t in (racing.carry_on(t, SETTLED, last=False) for t in made) if t.cost < best.cost]


SIMILAR, NAMELESS = 0.4, 4
"""Correlation with the force of the nearest law from which one without a name is tried instead, and how many are."""


RELATED = 10.0
"""Cost, of the least, above which a law is not tried in another form."""


def _turned(wide: Bench, x: NDArray, near: Sequence[Tried], clear: float) -> list[Tried]:
    """Laws of the same place and size in the stead of those that come nearest, if the first leaves more than `clear` a
    value or bends the base: of a slider what yields bit by bit, of a stop on one side stops on both, and the other way
    round; each from the base vector `x`.
    """
    best = min(near, key=lambda t: t.cost, default=None)
    if best is None or within(best, clear):
        return []
    leads: dict[tuple[str, bytes], Lead] = {}
    for t in nearest_of(list(near), len(near), RELATED):
        for lead in _forms(t.lead, t.made.whole(0)):
            leads.setdefault((lead.mechanism, lead.acting().column.tobytes()), lead)
    made = [wide.direct((x,), lead, STEPS, soften=False) for lead in leads.values()]
    return [wide.carry_on(t, SETTLED, last=False) for t in made if t is not None]


def _forms(lead: Lead, p: NDArray) -> list[Lead]:
    """Leads of laws that make a force of the same size at the same motion as one with the parameters `p`."""
    if lead.mechanism == "stick-slip":
        return [smooth_of(lead, p), spread_of(lead, p)]
    half, twice = np.array([0.5, 1.0]), np.array([2.0, 1.0])
    plain = Spot(lead.spot.place, lead.spot.axis.lstrip("-"), lead.spot.column)
    if lead.mechanism == "one-sided-gap":
        return [Lead(plain, "clearance", _resized(p, half), lead.gain)]
    if lead.mechanism == "clearance":
        back = Spot(plain.place, "-" + plain.axis, plain.column)
        return [Lead(side, "one-sided-gap", _resized(p, twice), lead.gain) for side in (plain, back)]
    return []


def _resized(p: NDArray, by: NDArray) -> NDArray[np.float64]:
    out = p.copy()
    out[: by.size] *= by
    return out


def _begins(bench: Bench, x: NDArray) -> tuple[Sequence[float], Made | None]:
    """The ladder from the widest tolerance on that the base alone does not satisfy, and the base there; None where it
    satisfies all of them.
    """
    for i, slack in enumerate(LADDER):
        joint = slackened(bench, slack).joint([])
        alone = fit(joint, joint.start(x), [None] * len(bench.runs), steps=STEPS)
        if alone.data_part > UNFIT * alone.count:
            return LADDER[i:], alone
    return (), None


def _begun(wide: Bench, leads: Sequence[tuple[Lead, NDArray]], most: int, clear: float) -> list[Tried]:
    """The first leads, `most` of them, fitted with the widest tolerance, each from its base; only those at its place
    once one leaves less than `clear`.
    """
    out: list[Tried] = []
    place: Place | None = None
    for lead, x in leads:
        if len(out) == most:
            break
        if place is not None and lead.spot.place != place:
            continue
        one = wide.against(*out).direct((x,), lead, BRIEF, soften=False)
        if one is None:
            continue
        if one.cost < FAR * min((t.cost for t in out), default=np.inf):
            one = wide.carry_on(one, STEPS, last=False)
        out.append(one)
        if one.made.data_part < clear:
            place = lead.spot.place
    return out


def _kin(
    wide: Bench, leads: Sequence[tuple[Lead, NDArray]], begun: Sequence[Tried], clear: float
) -> list[Tried]:  # fmt: skip
    """The other laws at the place of the one that came nearest, where none left less than `clear`: what a law promises
    with a strength of a few that are looked at says less of it than where it acts.
    """
    best = min(begun, key=lambda t: t.cost, default=None)
    if best is None or best.made.data_part < clear:
        return []
    done = [t.lead for t in begun]
    rest = [(q, x) for q, x in leads if q.spot.place == best.spot.place and not any(q is lead for lead in done)]
    return _begun(wide, rest, BEGUN, clear)


def _foremost(found: Sequence[Recovered]) -> list[Recovered]:
    """The spots whose force explains most of the distortion."""
    first = sorted(found, key=lambda q: -q.share)[:SPOTS]
    return [q for q in first if q.share >= ALIKE * first[0].share]


def _promising(
    bench: Bench, x: NDArray, found: Sequence[Recovered], leads: Sequence[Lead], laws: Sequence[str], slack: float
) -> list[tuple[Lead, NDArray]]:  # fmt: skip
    """Every law at some spots, with the strength that leaves least of the loudest run and the base `x` as it is; those
    that leave least first.
    """
    high = int(np.argmax([r.level for r in bench.runs]))
    loud = slackened(replace(bench, runs=(bench.runs[high],), lines=(bench.lines[high],), firm=()), slack)
    loud = replace(loud, closing=slack / ROUGHLY)
    out: list[tuple[float, Lead]] = []
    for q in found:
        own = [lead for lead in leads if np.array_equal(np.abs(lead.spot.column), np.abs(q.spot.column))]
        for law in laws:
            sizes, alone = sizes_of(bench, q, law, high), [[lead] for lead in own if lead.mechanism == law]
            n = len(SIZES[0] if SHAPES[law].inner else SIZES[1])
            grown = [sizes[i : i + n] for i in range(0, len(sizes), n)]
            looked = [one for some in (*grown, *alone) for one in _until_worse(loud, x, some)]
            out += sorted((p for p in looked if np.isfinite(p[0])), key=lambda pair: pair[0])[:1]
    return [(lead, x) for _, lead in sorted(out, key=lambda pair: pair[0])]


def _until_worse(bench: Bench, x: NDArray, leads: Iterable[Lead]) -> list[tuple[float, Lead]]:
    """What a law of growing strength leaves, until it leaves more than before."""
    out: list[tuple[float, Lead]] = []
    for lead in leads:
        out.append((left_by(bench, x, [lead]), lead))
        if len(out) > 1 and out[-1][0] > out[-2][0]:
            break
    return out


def _once(promised: Iterable[Sequence[tuple[Lead, NDArray]]]) -> list[tuple[Lead, NDArray]]:
    """What several bases promise, in turn: the first of each law at each spot, on either side of it, from each base."""
    first: dict[tuple[str, bytes, int], tuple[Lead, NDArray]] = {}
    for together in zip_longest(*promised):
        for one in together:
            if one is not None:
                first.setdefault((one[0].mechanism, np.abs(one[0].spot.column).tobytes(), id(one[1])), one)
    return list(first.values())


def left_by(bench: Bench, x: NDArray, leads: Sequence[Lead]) -> float:
    """Objective of laws as they stand, over the bench's runs; infinite where no steady state is found."""
    joint = bench.joint(leads)
    start = joint.start(x)
    with np.errstate(all="ignore"):  # a law that pushes may go beyond all numbers
        orbits = calmed(joint, start, joint.settle(start, [None] * len(bench.runs), 8))
        if any(o is None or not np.isfinite(o.closing) for o in orbits):
            return np.inf
        return reduced(*joint.parts(start, orbits))[0]


def sizes_of(bench: Bench, q: Recovered, law: str, high: int) -> list[Lead]:
    """A law with the strengths that are looked at, its gap or slip at each of some parts of the motion."""
    shape = SHAPES[law]
    z, v = q.z[high], q.v[high]
    force = float(np.sqrt(np.mean(q.f[high] ** 2)))
    sides = (1.0, -1.0) if law in ("one-sided-gap", "cubic-stiffness", "quadratic-stiffness") else (1.0,)
    units = [u for u in candidates(shape, q.top) if not shape.inner or np.isclose(u[1] / q.top, CORNERS).any()]
    out = []
    for unit in units:
        for side in sides:
            turned = side if law == "one-sided-gap" else 1.0
            along = force_along(shape, turned * z, turned * v, unit, around=bench.runs[high].lasting)
            rms = float(np.sqrt(np.mean(along**2)))
            spot = Spot(q.spot.place, "-" + q.spot.axis, q.spot.column) if turned < 0 else q.spot
            for size in SIZES[0 if shape.inner else 1] if rms > 0 else ():
                p = unit.copy()
                p[0] = side * turned * size * force / rms
                if shape.law == "stick-slip":
                    p[1] = p[0] * unit[1]
                out.append(Lead(spot, law, p, q.gain))
    return out
