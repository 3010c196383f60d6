"""Another law beside a slider that sticks at the quietest level, where neither is found alone.

There the slider is a spring, which a linear search names, and the base beside it is the structure's own. Either law
fitted alone bends that base for the other. As with one strong law (`tempered`) a wide tolerance on every line brings
both to themselves from strengths and limits several times off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, of_fits, tried_fit
from labnnum.diagnosis.nonlinear.beside import ONE_LEVEL
from labnnum.diagnosis.nonlinear.explore import LAWS, LINES
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, recover
from labnnum.diagnosis.nonlinear.pairs import number_of, pair_shares
from labnnum.diagnosis.nonlinear.stuck import spread_of
from labnnum.diagnosis.nonlinear.tempered import (
    BEGUN,
    BRIEF,
    CARRIED,
    LADDER,
    ROUGHLY,
    SETTLED,
    STEPS,
    UNFIT,
    left_by,
    nearest_of,
    sizes_of,
    slackened,
)

SPOTS = 4
"""Places, by the distortion that forces there and at the slider explain, at which a law is looked at beside it."""
LIMIT, LIMITS = 1.0, (0.4, 2.5)
"""Limit of the slider, of its spring's force at the RMS of the motion, beside which laws are looked at, and those
beside which the foremost are looked at too."""
FOREMOST = 12
"""Laws that are."""
HOPEFUL = 0.35
"""Part of what the slider alone leaves with the widest tolerance above which no law beside it is worth more."""
ANCHOR = 0.03
"""Tolerance on the runs of the lowest level."""
WIDE = 3
"""Tolerances, of the ladder's, that may be the widest."""
FORMS = 2
"""Pairs that are handed on, the first with many sliders side by side too."""

Two = tuple[Lead, Lead]


def partners(bench: Bench, x: NDArray, slider: Lead, motion: float, spots: Sequence[Spot]) -> tuple[Two, ...]:
    """A slider and another law in the forms that leave least with the widest tolerance; none where that is too much.

    Parameters
    ----------
    bench : Bench
        Of the structure without the slider.
    x : ndarray
        Base vector, as the quietest level shows it beside the slider's spring.
    slider : Lead
        With its spring's stiffness.
    motion : float
        RMS of the motion there at the highest level, m or rad.
    spots : sequence of Spot
        Where the other law may act.
    """
    bench = bench.on(LINES)
    force = slider.p[0] * motion
    slack, least = _tolerance(bench, x, [_limited(slider, part * force) for part in (LIMIT, *LIMITS)])
    wide = _anchored(bench, slack)
    high = int(np.argmax([r.level for r in bench.runs]))
    loud = replace(wide, runs=(wide.runs[high],), lines=(wide.lines[high],), closing=slack / ROUGHLY)
    looked = [(left_by(loud, x, two), two) for two in _forms(bench, x, _limited(slider, LIMIT * force), spots, high)]
    looked = _foremost(looked)
    more = [(_limited(slider, part * force), other) for _, (_, other) in looked[:FOREMOST] for part in LIMITS]
    looked = _foremost([*looked, *((left_by(loud, x, two), two) for two in more)])
    settled = [_held(wide, x, two, STEPS, base=True) for _, two in looked[:FOREMOST]]
    begun = [_held(wide, x, of_fits(t), BRIEF) for t in nearest_of([t for t in settled if t is not None], BEGUN)]
    near = nearest_of([t for t in begun if t is not None], CARRIED)
    ended = [_held(wide, t.made.x[: t.made.n_base], of_fits(t), SETTLED) for t in near]
    near = nearest_of([t for t in ended if t is not None], FORMS)
    if not near or near[0].cost > HOPEFUL * least:
        return ()
    best, *others = (of_fits(t) for t in near)
    slider, other = best
    many = spread_of(slider, slider.p), other
    return tuple(_two(leads) for leads in (best, many, *others))


def _held(bench: Bench, x: NDArray, leads: Sequence[Lead], steps: int, *, base: bool = False) -> Tried | None:
    """A slider and others fitted while its spring is held, and the `base` too."""
    joint = bench.joint(leads)
    begin = joint.start(x)
    if base:
        joint.low[: joint.n_base] = joint.high[: joint.n_base] = begin[: joint.n_base]
    joint.low[joint.n_base] = joint.high[joint.n_base] = begin[joint.n_base]
    return tried_fit(joint, begin, [None] * len(bench.runs), leads[0], steps, exact=not base, more=leads[1:])


def _tolerance(bench: Bench, x: NDArray, sliders: Sequence[Lead]) -> tuple[float, float]:
    """The widest tolerance that the slider alone does not satisfy, or the last of the wide ones, and what the slider
    leaves with it, at the best of its limits.
    """
    slack, least = LADDER[0], np.inf
    for slack in LADDER[:WIDE]:
        wide = _anchored(bench, slack)
        made = [t for s in sliders if (t := _held(wide, x, [s], STEPS)) is not None]
        least = min((t.cost for t in made), default=np.inf)
        if any(t.made.data_part > UNFIT * t.made.count for t in made if t.cost == least):
            break
    return slack, least


def _anchored(bench: Bench, slack: float) -> Bench:
    """The bench with a tolerance, but for the runs of the lowest level, which tell the base and the spring."""
    wide, close = slackened(bench, slack), slackened(bench, min(slack, ANCHOR))
    most = ONE_LEVEL * min(r.level for r in bench.runs)
    some = zip(bench.runs, wide.lines, close.lines, strict=True)
    return replace(wide, lines=tuple(b if r.level < most else a for r, a, b in some), closing=close.closing)


def _forms(bench: Bench, x: NDArray, slider: Lead, spots: Sequence[Spot], high: int) -> list[Two]:
    """The slider with every law at the spots where the forces of both explain most, in the strengths looked at."""
    plain = bench.joint([])
    shares = pair_shares(plain, x, spots)
    own = number_of(spots, slider.spot)
    order = sorted((i for i in range(len(spots)) if i != own), key=lambda i: -max(shares[own, i], shares[i, own]))
    found = [recover(plain, x, bench.point, spots[i]) for i in order[:SPOTS]]
    return [(slider, lead) for q in found for law in LAWS for lead in sizes_of(bench, q, law, high)]


def _foremost(looked: Sequence[tuple[float, Two]]) -> list[tuple[float, Two]]:
    """The form of each law at each place that leaves least, those that leave least first."""
    best: dict[tuple, tuple[float, Two]] = {}
    for left, two in sorted((row for row in looked if np.isfinite(row[0])), key=lambda row: row[0]):
        best.setdefault((two[1].mechanism, two[1].spot.where), (left, two))
    return list(best.values())


def _limited(slider: Lead, limit: float) -> Lead:
    """The slider with another limit."""
    p = slider.p.copy()
    p[1] = limit
    return replace(slider, p=p)


def _two(leads: Sequence[Lead]) -> Two:
    first, second = leads
    return first, second
