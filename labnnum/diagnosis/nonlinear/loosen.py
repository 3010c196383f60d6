"""Laws in noise fitted while their march is tied to the measured motion, ever more loosely.

Where a response hardly forgets how it began, the objective of a free march is a heap of narrow valleys: from
parameters a few percent off the march takes other turns than the structure did, and a descent ends at once. Tied
closely it goes where the structure went, and the objective is smooth; loosened step by step the ties have less and less
to do, and in the end none (continuation in the coupling: Abarbanel et al. 2009).
"""

from __future__ import annotations

from dataclasses import replace

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, of_fits, tried_fit
from labnnum.diagnosis.nonlinear.follow import along, marched_from

TIES = (3.0, 1.0, 0.3, 0.1, 0.03, 0.0)
"""Dashpots of the ties, of one that pushes as hard as the law does, one fit after the other."""
STEPS, LAST = 6, 12
"""Steps of these fits, and of the one without ties."""


def loosened(bench: Bench, one: Tried, *, last: bool = False) -> Tried | None:
    """A law that was followed, `one`, fitted by simulation from ties that are loosened; None where a march fails."""
    terms = [replace(lead.acting(), last=last) for lead in of_fits(one)]
    joint = bench.joint_of(terms)
    x, orbits = one.made.x, None
    made: Tried | None = None
    for tie in TIES:
        shown = marched_from(joint, x, along(joint, x), tied=True)
        orbits = shown if orbits is None else [
            None if o is None or s is None else replace(o, tie=s.tie) for o, s in zip(orbits, shown, strict=True)
        ]  # fmt: skip
        for steady in joint.steady:
            steady.tie = tie
        made = tried_fit(joint, x, orbits, one.lead, STEPS if tie else LAST, more=one.more)
        if made is None:
            return None
        x, orbits = made.made.x, list(made.made.orbits)
    return made


def led_astray(bench: Bench, followed: Tried, simulated: Tried | None) -> bool:
    """Whether a simulation in noise leaves more than the law does along the measured motion, which has that motion's
    errors too: then it goes elsewhere than the structure did.
    """
    if followed.simulated or not all(r.open for r in bench.runs):
        return False
    return simulated is None or simulated.made.data_part > followed.made.data_part
