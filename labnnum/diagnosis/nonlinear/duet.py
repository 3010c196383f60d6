"""A second strong law beside the first, from far away: sought while the tolerance is still wide.

Of two strong laws the first comes near with a tolerance of a third of the response, where only its size counts, and
with a narrower one the base bends for what the other does. Before it bends, what is left of the lines is the other
law's: the force that a second place asks for there stands out, though the first law's parameters are not right yet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, of_fits
from labnnum.diagnosis.nonlinear.effort import TWO, counted, spent
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.leads import law_leads, ranked
from labnnum.diagnosis.nonlinear.locate import Background, Lead, Spot, recover
from labnnum.diagnosis.nonlinear.slack import (
    BEGUN,
    BRIEF,
    CARRIED,
    ENDED,
    LAST,
    ROUGH,
    SETTLED,
    STEPS,
    UNFIT,
    nearest_of,
    sharp,
    slackened,
    within,
)
from labnnum.diagnosis.nonlinear.stuck import smooth_of, spread_of
from labnnum.errors import EstimationError

FAINT = 0.1
"""Part of what the best lead promises below which another is not fitted."""
FIRSTS, RUNGS = 2, 2
"""Laws beside which a second is sought, best first, and tolerances with which it is, from the widest."""
SHORT = 5.0
"""Nominal seconds of one search after which no second law is begun."""
HALF = 0.5
"""Part of the first law's cost to which a second must bring it with the same tolerance,"""
KEPT = 3.0
"""Chi-square per value above which a pair is given up, with any tolerance or without;"""
FEWER = 0.8
"""part of a pair's cost to which one must that yields bit by bit in the stead of a slider."""


def duets(
    bench: Bench, firsts: Sequence[Tried], spots: Sequence[Spot], laws: Sequence[str], ladder: Sequence[float]
) -> list[Tried]:
    """Two laws, fitted down to the lines without tolerance, best first; none where a law alone comes near with the
    tolerances that are asked, and no base is bent for it, or where no second beside it does better by far.

    Parameters
    ----------
    firsts : sequence of Tried
        Laws alone, fitted with the first tolerance, best first. The next is asked where none beside the one before
        will do.
    spots : sequence of Spot
        Where a second law is sought.
    laws : sequence of str
        Mechanisms that are sought.
    ladder : sequence of float
        Tolerances, from the widest that the base alone does not satisfy.
    """
    with counted():  # apart: a search that may find nothing tires none that comes after it
        for first in firsts[:FIRSTS]:
            kept = 0
            for i, slack in enumerate(ladder[:RUNGS]):
                on = slackened(bench, slack)
                alone = on.carry_on(first, STEPS, last=False) if i else first
                if i and sharp(first) and not within(alone, UNFIT):  # it may be the steps that bend the base
                    alone = on.carry_on(alone, STEPS, last=True)
                if within(alone, UNFIT):
                    kept += 1
                    continue
                pairs = _beside(on, first, spots, laws)
                if pairs and pairs[0].cost < HALF * alone.cost:
                    near = nearest_of([*pairs, *_of_kind(on, pairs[0])], ENDED)
                    if done := _narrowed(bench, near, ladder[i + 1 :]):
                        return done
            if kept == len(ladder[:RUNGS]):  # this one alone comes near with all of them
                break
    return []


def _beside(on: Bench, first: Tried, spots: Sequence[Spot], laws: Sequence[str]) -> list[Tried]:
    """The first law with each of the best second ones, fitted with one tolerance; best first. None is begun after
    `SHORT` of the search, nor carried on after `TWO`.
    """
    if spent() > SHORT:
        return []
    made = first.made
    own = of_fits(first)
    joint = on.joint(own)
    try:
        orbits = joint.settle(made.x, made.orbits, 8)
        background = Background(joint, made.x, orbits)
    except (EstimationError, np.linalg.LinAlgError):
        return []
    found = ranked(background, [recover(joint, made.x, on.point, s, orbits) for s in spots])
    leads = [lead for q in found for lead in law_leads(background, q, laws)]
    begun = []
    for lead in _foremost(leads, own):
        one = on.both(made.x[: made.bare], [*own, lead], BRIEF) if spent() < SHORT else None
        begun += [] if one is None else [one]
    near = nearest_of(begun, CARRIED)
    for steps in (STEPS, SETTLED):
        near = nearest_of([on.carry_on(t, steps, last=False) if spent() < TWO else t for t in near], ENDED)
    return near


def _of_kind(on: Bench, pair: Tried) -> list[Tried]:
    """The pair with each of its laws that yield as the kind of them that it is: what yields bit by bit where that costs
    far less, and a slider where it costs hardly more; nothing where that is the pair itself.
    """
    best = pair
    for i in range(2):
        leads = of_fits(best)
        lead, made = leads[i], []
        for kind, most in _kinds(lead):
            two = [kind if j == i else one for j, one in enumerate(leads)]
            one = on.both(best.made.x[: best.made.bare], two, SETTLED)
            made += [] if one is None or one.cost > most * best.cost else [one]
        best = min(made, key=lambda t: t.cost, default=best)
    return [] if best is pair else [best]


def _kinds(lead: Lead) -> list[tuple[Lead, float]]:
    """Laws of the same kind in a law's stead, and the cost, of its, up to which each is taken."""
    if lead.mechanism == "stick-slip":
        return [(smooth_of(lead, lead.p), FEWER), (spread_of(lead, lead.p), FEWER)]
    if lead.mechanism not in ("hysteresis", "sliders"):
        return []
    p = np.zeros(N_P)
    p[:2] = lead.p[0], lead.p[0] * lead.p[1] if lead.mechanism == "hysteresis" else lead.p[1]
    return [(replace(lead, mechanism="stick-slip", p=p), 1 / FEWER)]


def _foremost(leads: Sequence[Lead], own: Sequence[Lead]) -> list[Lead]:
    """The leads that promise most, one of a law at a place; none that the first law is already."""
    have = [(lead.mechanism, lead.spot.place) for lead in own]
    out: list[Lead] = []
    for lead in sorted(leads, key=lambda lead: -lead.gain):
        key = (lead.mechanism, lead.spot.place)
        if key in have or lead.mechanism == "hysteresis" or lead.gain < FAINT * (out[0].gain if out else 0.0):
            continue
        have.append(key)
        out.append(lead)
    return out[:BEGUN]


def _narrowed(bench: Bench, pairs: list[Tried], ladder: Sequence[float]) -> list[Tried]:
    """Pairs carried through the tolerances that are left, and fitted without; without those that leave more than they
    may: with the right laws each tolerance is kept, with others the base bends from one to the next.
    """
    for slack in (*ladder, 0.0):
        on, steps = (slackened(bench, slack), STEPS) if slack else (bench, LAST)
        pairs = [on.carry_on(t, steps, last=sharp(t) and slack < ROUGH) for t in pairs]
        pairs = nearest_of([t for t in pairs if t.made.data_part < KEPT * t.made.count], ENDED)
    return pairs
