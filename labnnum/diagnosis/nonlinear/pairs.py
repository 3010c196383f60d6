"""Two laws at once, where one alone explains too little: both forces recovered together, and both simulated.

A law that is fitted while another one acts takes that one's distortion for its own, and neither comes near the
noise. Where there are more sensors than forces both can be recovered line by line.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, of_fits
from labnnum.diagnosis.nonlinear.effort import TWO, spent, tired
from labnnum.diagnosis.nonlinear.explore import LAWS, LONG, Prospect, engine_start
from labnnum.diagnosis.nonlinear.fitting import fit
from labnnum.diagnosis.nonlinear.further import alike, asked, needed
from labnnum.diagnosis.nonlinear.laws import SHAPES, candidates
from labnnum.diagnosis.nonlinear.leads import companion_columns, law_column
from labnnum.diagnosis.nonlinear.locate import (
    Background,
    Lead,
    Recovered,
    Spot,
    lengths,
    moments,
    motions_of,
    recover,
    weighted,
)
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.receptance import Base, per_place
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.stuck import smooth_of, spread_of
from labnnum.diagnosis.nonlinear.study import FINE, UNSURE
from labnnum.diagnosis.nonlinear.tempered import BETTER
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Place

SPARE = 1
"""Sensors beyond two forces from which on the forces alone tell the places."""
WIDE = 4
"""Pairs of places, by the part of the distortion that two forces there explain, at which laws are asked for."""
FIRST = 2
"""Those nearest single laws."""
EACH = 3
"""Pairs of laws at a pair of places that are looked at,"""
ALIKE = 2
"""of them that are simulated,"""
TRIED = 6
"""and at all pairs, that are simulated in one round."""
ROUNDS = 4
"""Rounds, each from the base that the best pair so far left."""
GLANCE, BRIEF = 2, 4
"""Steps of a fit that shows whether a pair is worth more, and how many more it then gets."""
WORTH = 3
"""Pairs of a round that get them."""
HOPEFUL = 1.5
"""Cost of the best pair of a round, of the best single law's, above which no more are looked for."""
ONWARD = 0.8
"""Part of what the best pair left to which a round must bring it for another."""
SCANNED = 300
"""Lines of a run on which pairs of places are compared."""
ENOUGH = 1.3
"""Chi-square per value below which a pair leaves nothing to be sought."""
CLOSE, SIMULATED = 3.0, 3
"""Cost, of the least, below which a pair is told from the best on more lines, and how many are."""

QUICK, KIN = 1.0, 4
"""Nominal seconds of a fit on more lines below which all last fits have fine steps, and other laws at the best pair's
places, so many at most, are followed as far.
"""
BENT, INSTEAD = 4.0, 3
"""Price of the base beside the best pair, of its entries, above which it stands in for what the pair has wrong,
and pairs that are then followed as far."""

Combined = tuple[float, NDArray[np.float64], tuple[Lead, Lead]]
"""What two laws leave of the objective, the base vector that this was seen with, and the laws."""


def paired(
    seen: Prospect, spots: Sequence[Spot], progress: Callable[[str], None] = lambda text: None
) -> list[Tried]:  # fmt: skip
    """Two laws together fitted by simulation, best first; none where they explain no more than one does.

    Round by round pairs of places and laws are looked for with the base that the best pair so far left: a base that was
    fitted without the laws, or beside one of them, shows neither rightly. A search that has marched for long (`TWO`)
    ends with what it has.
    """
    bench = seen.bench.against(seen.near[0])
    progress("fitting two nonlinear laws")
    plain = bench.joint([])
    own = seen.near[0].made
    starts = [seen.calm.x[: plain.n_base], engine_start(plain)[: plain.n_base], own.x[: own.bare]]
    firsts = [t.spot for t in seen.near]
    done: list[Tried] = []
    latest = spent() + TWO
    for _ in range(ROUNDS):
        promised: list[Combined] = []
        for x in starts:
            background = Background(plain, x)
            for a, b in _places(plain, x, spots, firsts):
                promised += combined(background, x, a, b)
        promised.sort(key=lambda row: row[0])
        fresh = _distinct(promised, [t.all_of_it for t in done])
        before = done[0].cost if done else np.inf
        made: list[Tried] = []
        for _, x, two in fresh:
            one = bench.both(x, two, GLANCE) if spent() < latest or not made else None
            made += [one] if one is not None else []
        made.sort(key=lambda t: t.cost)
        made[:WORTH] = [bench.carry_on(t, BRIEF, last=False) if spent() < latest else t for t in made[:WORTH]]
        done = sorted([*done, *made], key=lambda t: t.cost)
        if not done or done[0].cost > HOPEFUL * seen.near[0].cost:
            return []
        done[0] = bench.carry_on(done[0], LONG, last=False)
        done.sort(key=lambda t: t.cost)
        enough = done[0].made.data_part < ENOUGH * done[0].made.count
        if done[0].cost > ONWARD * before or enough or spent() > latest:
            break
        starts = [done[0].made.x[: done[0].made.bare]]
        firsts = [lead.spot for lead in (done[0].lead, *done[0].more)]
    short = done[0].cost < BETTER * seen.near[0].cost and done[0].made.data_part > ENOUGH * done[0].made.count
    if short and spent() < latest:
        near = [t for t in done[1:] if t.cost < CLOSE * done[0].cost][:SIMULATED]
        done[1 : 1 + len(near)] = [bench.carry_on(t, LONG, last=False) for t in near]
        done.sort(key=lambda t: t.cost)
        done += _elsewhere(plain, done[0], spots, bench)
        done.sort(key=lambda t: t.cost)
        done += _softer(seen, done[0])
    done.sort(key=lambda t: t.cost)
    return done if done[0].cost < BETTER * seen.near[0].cost else []


def _elsewhere(plain: Joint, best: Tried, spots: Sequence[Spot], bench: Bench) -> list[Tried]:
    """The best pair with one of its laws at a place from which two forces explain nearly as much, or more."""
    x = best.made.x[: best.made.bare]
    shares = pair_shares(plain, x, spots)
    shares = np.maximum(shares, shares.T)
    leads = of_fits(best)
    at = [k for lead in leads if (k := number_of(spots, lead.spot)) is not None]
    if len(at) < len(leads):
        return []
    out = []
    for i in range(2):
        others = sorted((j for j in range(len(spots)) if j not in at), key=lambda j: -shares[at[1 - i], j])
        for j in others[:AROUND]:
            two = list(leads)
            two[i] = replace(leads[i], spot=replace(spots[j], axis=_sense(leads[i].spot) + spots[j].axis))
            out.append(bench.both(x, two, GLANCE + BRIEF))
    near = sorted((t for t in out if t is not None), key=lambda t: t.cost)
    return [bench.carry_on(t, LONG, last=False) if t.cost < CLOSE * best.cost else t for t in near]


AROUND = 2
"""Places that are tried instead of each of the best pair's."""


def number_of(spots: Sequence[Spot], spot: Spot) -> int | None:
    """Where a spot, in either sense, stands among all; None where another one stands for it."""
    return next((i for i, s in enumerate(spots) if (s.place, s.axis) == spot.where), None)


def _sense(spot: Spot) -> str:
    """The sign of a law that differs for the two senses of a motion."""
    return "-" if spot.axis.startswith("-") else ""


def _softer(seen: Prospect, best: Tried) -> list[Tried]:
    """The best pair with a slider of it replaced by many, and by hysteresis, where it leaves more than noise."""
    out = []
    for i, lead in enumerate((best.lead, *best.more)):
        if lead.mechanism != "stick-slip" or best.made.data_part < ENOUGH * best.made.count:
            continue
        p, _ = best.made.law(i)
        for soft in (spread_of(lead, p), smooth_of(lead, p)):
            two = [soft if one is lead else one for one in of_fits(best)]
            two[i] = soft
            out.append(seen.bench.both(best.made.x[: best.made.bare], two, LONG))
    return [t for t in out if t is not None]


def _distinct(promised: Sequence[Combined], have: Sequence[frozenset]) -> list[Combined]:
    """The first of them that are none of those there are, a few at each pair of places."""
    out: list[Combined] = []
    seen = list(have)
    count: dict[frozenset, int] = {}
    for row in promised:
        laws = frozenset((lead.mechanism, lead.spot.place) for lead in row[2])
        places = frozenset(lead.spot.place for lead in row[2])
        if laws in seen or count.get(places, 0) == ALIKE or len(out) == TRIED:
            continue
        count[places] = count.get(places, 0) + 1
        seen.append(laws)
        out.append(row)
    return out


def study_of(seen: Prospect, pairs: Sequence[Tried], scatter: Scatter, alarm: float) -> tuple[Study, list[Tried]]:
    """What `paired` found as the decision takes it: candidates on more lines, and the chain of the best one's laws.

    Of two laws of which one can be spared the other is left; what is missed most comes first.
    """
    bench = seen.bench.on(FINE)
    close = [t for t in pairs if t.cost < CLOSE * pairs[0].cost]
    near = close[: 1 if tired() else SIMULATED]
    before = spent()
    coarse = sorted((bench.carry_on(t, LONG, last=is_fine(t)) for t in near), key=lambda t: t.cost)
    brief = spent() - before < QUICK * len(near)
    finer = [
        bench.carry_on(t, LONG, last=brief or not tired() or is_fine(t))
        for t in coarse
        if t.cost < CLOSE * coarse[0].cost
    ]
    if brief:  # coarse steps leave most of what smooth laws' harmonics do
        kin = [t for t in close if _there(t) == _there(finer[0]) and not any(t.same(o) for o in coarse)]
        finer += [bench.carry_on(bench.carry_on(t, LONG, last=False), LONG, last=True) for t in kin[:KIN]]
        finer.sort(key=lambda t: t.cost)
        finer[0] = _from_calm(bench, seen.calm.x, finer[0])
    finer.sort(key=lambda t: t.cost)
    if finer[0].made.prior_part > BENT * finer[0].made.n_base and not tired():
        others = [t for t in pairs if not any(t.same(o) for o in finer)][:INSTEAD]
        finer += [bench.carry_on(bench.carry_on(t, LONG, last=True), LONG, last=True) for t in others]
        finer.sort(key=lambda t: t.cost)
    best = bench.carry_on(finer[0], 4, always=True, last=brief or not tired() or is_fine(finer[0]))
    tried = (best, *finer[1:])
    plain = bench.joint([])
    base = fit(plain, seen.base.x, [None] * len(bench.runs), steps=6)
    study = Study(bench.engine, bench.point, bench.runs, base, seen.calm, tried, None, seen.recovered)
    chain = [Tried(lead, best.made, best.cost) for lead in (best.lead, *best.more)]
    laws = needed(study, chain, scatter, alarm, FINE)
    if len(laws) == 1:
        study = replace(study, tried=(laws[0], *tried[1:]))
    return study, laws


def is_fine(t: Tried) -> bool:
    """Whether a fit was simulated with fine steps, and loses its place with coarse ones."""
    return any(term.last for term in t.made.terms)


AGAIN, BEGINNING = (0.75, 0.87, 1.15, 1.35), 6
"""What parameters of a pair that leaves much are multiplied by, one after the other, and steps of a fit from there;"""
FALLS = 0.5
"""part of what the pair leaves below which one of these has found another valley."""


def _from_calm(bench: Bench, calm: NDArray, pair: Tried) -> Tried:
    """Two laws that leave far more than noise fitted again from the base of the quietest level, each with its gap or
    its limit, or else its strength, larger and smaller; what they were where that finds nothing better.

    A strong law may hold a steady state that the structure was not in, and the base with it: next to the right
    parameters such a fit stays where it is.
    """
    if pair.made.data_part < UNSURE * pair.made.count:
        return pair
    own = of_fits(pair)
    forms = [own]
    for i, lead in enumerate(own):
        at = 1 if SHAPES[lead.mechanism].inner else 0
        for by in AGAIN:
            p = lead.p.copy()
            p[at] *= by
            forms.append([replace(lead, p=p) if j == i else one for j, one in enumerate(own)])
    begun = [bench.both(calm[: pair.made.bare], two, BEGINNING) for two in forms]
    near = min((t for t in begun if t is not None), key=lambda t: t.cost, default=None)
    if near is None or near.cost > FALLS * pair.cost:
        return pair
    return bench.carry_on(bench.carry_on(near, LONG, last=False), LONG, last=True)


def _there(t: Tried) -> frozenset[Place]:
    """The places of its laws."""
    return frozenset(lead.spot.place for lead in (t.lead, *t.more))


# -------------------------------------------------------------------- places


def _places(
    plain: Joint, x: NDArray, spots: Sequence[Spot], firsts: Sequence[Spot]
) -> list[tuple[Spot, Spot]]:  # fmt: skip
    """Pairs of places at which laws are asked for, a place beside itself among them."""
    out: list[tuple[Spot, Spot]] = []
    n = len(spots)
    shares = pair_shares(plain, x, spots)
    if plain.runs[0].y.shape[0] >= 2 + SPARE:
        order = sorted(combinations(range(n), 2), key=lambda ij: -shares[ij])
        out += [(spots[i], spots[j]) for i, j in order[:WIDE]]
    most = asked(plain.runs)
    first = list(dict.fromkeys(s.place for s in firsts))[:FIRST]
    some = [next(s for s in firsts if s.place == place) for place in first]
    if len(some) == FIRST:
        out.append((some[0], some[1]))
    for one in some:
        out.append((one, one))
        i = number_of(spots, one)
        if i is None:
            continue
        beside = sorted((j for j in range(n) if j != i), key=lambda j: -max(shares[i, j], shares[j, i]))
        out += [(one, spots[j]) for j in beside[:most]]
    distinct: list[tuple[Spot, Spot]] = []
    for a, b in out:
        key = {a.place, b.place}
        if key not in [{c.place, d.place} for c, d in distinct]:
            distinct.append((_along(a), _along(b)))
    return distinct


def _along(spot: Spot) -> Spot:
    """The spot in its own sense."""
    return replace(spot, axis=spot.axis.lstrip("-"))


def pair_shares(plain: Joint, x: NDArray, spots: Sequence[Spot]) -> NDArray[np.float64]:
    """Part (n, n) of the distortion of all runs that forces at two places explain together, for each two of `spots`."""
    n = len(spots)
    kept, whole = np.zeros((n, n)), 0.0
    columns = np.array([s.column for s in spots]).T
    for run in plain.runs:
        top, power, all_ = _scanned(plain, x, columns, run)
        whole += all_
        own = np.maximum(np.einsum("lcc->lc", power).real, 1e-300)
        size = np.abs(top) ** 2
        det = own[:, :, None] * own[:, None] - np.abs(power) ** 2
        det = np.maximum(det, COLLINEAR * own[:, :, None] * own[:, None])
        cross = 2 * np.real(np.conj(top)[:, :, None] * power * top[:, None])
        both = (size[:, :, None] * own[:, None] + size[:, None] * own[:, :, None] - cross) / det
        kept += both.sum(axis=0)
    return kept / max(whole, 1e-300)


COLLINEAR = 1e-4
"""Sine squared of the angle between two forces' responses below which they are not told apart."""


def _scanned(
    plain: Joint, x: NDArray, columns: NDArray, run: Run
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], float]:
    """Products of the forces' responses with the residual (lines, n) and among each other (lines, n, n), and its own
    square, on some lines of a run where distortion is seen.
    """
    omega = 2 * np.pi * run.frequency
    vector = x[: plain.n_base]
    bare = Base(plain.engine, plain.point, columns[:, :0], omega, run.decay).at(vector)
    left, weight, quiet = weighted(run, run.y - bare.lift * (bare.plain * bare.gain * run.u))
    at = np.flatnonzero(quiet)
    if at.size > SCANNED:
        at = at[np.unique(np.linspace(0, at.size - 1, SCANNED).round().astype(int))]
    base = Base(plain.engine, plain.point, columns, np.concatenate([omega[:2], omega[at]]), run.decay)
    m = per_place(plain.engine)
    r = base.at(np.concatenate([vector, np.zeros(columns.shape[1] * m)]))
    seen = r.lift[:, None, 2:] * r.h[:, :, 2:]
    top, power = moments(seen, weight[:, at], left[:, at])
    return top, power, float(np.sum(weight[:, at] * np.abs(left[:, at]) ** 2))


# -------------------------------------------------------------------- laws


def both_recovered(plain: Joint, x: NDArray, a: Spot, b: Spot) -> tuple[Recovered, Recovered]:
    """Forces and motions at two places, recovered together."""
    columns = np.array([a.column, b.column]).T
    m = per_place(plain.engine)
    parts: list[tuple[list[NDArray], list[NDArray], list[NDArray]]] = [([], [], []), ([], [], [])]
    alone: tuple[dict, dict] = ({}, {})
    for run in plain.runs:
        omega = 2 * np.pi * run.frequency
        base = Base(plain.engine, plain.point, columns, omega, run.decay)
        r = base.at(np.concatenate([x[: plain.n_base], np.zeros(2 * m)]))
        seen = motions_of(run, r)
        for i in range(2):
            for list_, row in zip(parts[i], seen[:, i].T, strict=True):
                list_.append(np.ascontiguousarray(row))
            alone[i].setdefault(run.key, replace(r, h=r.h[:, [i]], g=r.g[[i]][:, [i]], z=r.z[[i]]))
    made = []
    for spot, (z, v, f), receptance in zip((a, b), parts, alone, strict=True):
        made.append(Recovered(spot, 0.0, (), tuple(z), tuple(v), tuple(f), receptance))
    return made[0], made[1]


def combined(background: Background, x: NDArray, a: Spot, b: Spot) -> list[Combined]:
    """The best pairs of laws at two places, or at one, along the motions there; springs and dashpots beside them."""
    plain = background.joint
    one = a.place == b.place and a.axis == b.axis
    if one:
        q = recover(plain, x, plain.point, a)
        found = (q, q)
    else:
        found = both_recovered(plain, x, a, b)
    held = [c for q in (found[:1] if one else found) for c in companion_columns(background, q)]
    rows: list[tuple[int, Lead]] = []
    columns = list(held)
    for i, q in enumerate(found[:1] if one else found):
        for lead in units(q):
            columns.append(
                law_column(plain, q, lead.mechanism, lead.p, -1.0 if lead.spot.axis.startswith("-") else 1.0)
            )
            rows.append((i, lead))
    gram, along = background.moments(np.array(columns))
    gram, along, base = _beside(gram, along, len(held))
    out: dict[tuple[str, str], Combined] = {}
    for i, j in combinations(range(len(rows)), 2):
        (p, first), (q, second) = rows[i], rows[j]
        if p == q and (not one or alike(first.mechanism, second.mechanism)):
            continue
        sizes = _sizes(gram, along, i, j)
        if sizes is None or not (_allowed(first, sizes[0]) and _allowed(second, sizes[1])):
            continue
        left = background.objective - base - float(sizes @ along[[i, j]])
        key = first.mechanism, second.mechanism
        if key not in out or left < out[key][0]:
            out[key] = left, x, (_sized(first, sizes[0]), _sized(second, sizes[1]))
    return sorted(out.values(), key=lambda row: row[0])[:EACH]


def units(q: Recovered) -> list[Lead]:
    """Every law of unit strength that is tried at a place, on its grid."""
    out = []
    for mechanism in LAWS:
        sides = ("", "-") if mechanism == "one-sided-gap" else ("",)
        for side in sides:
            spot = Spot(q.spot.place, side + q.spot.axis, q.spot.column)
            out += [Lead(spot, mechanism, p, 0.0) for p in candidates(SHAPES[mechanism], q.top)]
    return out


def _beside(gram: NDArray, along: NDArray, n: int) -> tuple[NDArray, NDArray, float]:
    """Products of all but the first `n` columns beside those, scaled to one, and what those remove."""
    d = lengths(gram)
    d[np.isinf(d)] = 1.0
    gram, along = gram / np.outer(d, d), along / d
    solve = np.linalg.pinv(gram[:n, :n], rcond=1e-10)
    cross = gram[n:, :n] @ solve
    rest = along[n:] - cross @ along[:n]
    inner = gram[n:, n:] - cross @ gram[:n, n:]
    return inner * np.outer(d[n:], d[n:]), rest * d[n:], float(along[:n] @ solve @ along[:n])


def _sizes(gram: NDArray, along: NDArray, i: int, j: int) -> NDArray[np.float64] | None:
    """Amplitudes of two columns; None where they are not told apart."""
    a, b, c = gram[i, i], gram[j, j], gram[i, j]
    det = a * b - c * c
    if not det > 1e-6 * a * b:
        return None
    return np.array([b * along[i] - c * along[j], a * along[j] - c * along[i]]) / det


def _allowed(lead: Lead, size: float) -> bool:
    return size > 0 or not SHAPES[lead.mechanism].positive


def _sized(lead: Lead, size: float) -> Lead:
    """The law with that strength."""
    p = lead.p.copy()
    p[0] = size
    if lead.mechanism == "stick-slip":
        p[1] = size * lead.p[1]
    return replace(lead, p=p)
