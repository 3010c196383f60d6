"""A second strong law beside the first, from far away: sought while the tolerance is still wide.

Of two strong laws the first comes near with a tolerance of a third of the response, where only its size counts, and
with a narrower one the base bends for what the other does. Before it bends, what is left of the lines is the other
law's: the force that a second place asks for there stands out, though the first law's parameters are not right yet.
"""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, of_fits
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
)
from labnnum.errors import EstimationError

FAINT = 0.1
"""Part of what the best lead promises below which another is not fitted."""
FIRSTS = 2
"""Laws beside which a second is sought, at most; the next only where none beside the one before came near."""


def duets(
    bench: Bench, x: NDArray, near: Sequence[Tried], spots: Sequence[Spot], laws: Sequence[str],
    ladder: Sequence[float],
) -> list[Tried]:  # fmt: skip
    """Two laws, fitted down to the lines without tolerance, best first; none where the first alone comes near with the
    second tolerance, or no second beside it does.

    Parameters
    ----------
    x : ndarray
        Vector of the base from which the laws were fitted.
    near : sequence of Tried
        Laws alone, fitted with the first tolerance, best first.
    spots : sequence of Spot
        Where a second law is sought.
    laws : sequence of str
        Mechanisms that are sought.
    ladder : sequence of float
        Tolerances, from the widest that the base alone does not satisfy.
    """
    if len(ladder) < 2:
        return []
    on = slackened(bench, ladder[1])
    alone = on.carry_on(near[0], STEPS, last=False)
    if alone.made.data_part < UNFIT * alone.made.count:
        return []
    for first in near[:FIRSTS]:
        pairs = _beside(on, x, first, spots, laws)
        if pairs and pairs[0].made.data_part < UNFIT * pairs[0].made.count:
            return _narrowed(bench, pairs, ladder[2:])
    return []


def _beside(on: Bench, x: NDArray, first: Tried, spots: Sequence[Spot], laws: Sequence[str]) -> list[Tried]:
    """The first law with each of the best second ones, fitted with one tolerance; best first."""
    made = first.made
    own = of_fits(first)
    joint = on.joint(own)
    try:
        orbits = joint.settle(made.x, made.orbits, 8)
    except EstimationError:
        return []
    background = Background(joint, made.x, orbits)
    found = ranked(background, [recover(joint, made.x, on.point, s, orbits) for s in spots])
    leads = [lead for q in found for lead in law_leads(background, q, laws)]
    begun = [on.both(made.x[: made.bare], [*own, lead], BRIEF) for lead in _foremost(leads, own)]
    near = nearest_of([t for t in begun if t is not None], CARRIED)
    near = nearest_of([on.carry_on(t, STEPS, last=False) for t in near], ENDED)
    return nearest_of([on.carry_on(t, SETTLED, last=False) for t in near], ENDED)


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
    """Pairs carried through the tolerances that are left, and fitted without."""
    for slack in (*ladder, 0.0):
        on, steps = (slackened(bench, slack), STEPS) if slack else (bench, LAST)
        pairs = nearest_of([on.carry_on(t, steps, last=sharp(t) and slack < ROUGH) for t in pairs], ENDED)
    return pairs
