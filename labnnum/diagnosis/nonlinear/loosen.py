"""Laws in noise fitted while their march is tied to the measured motion, ever more loosely.

Where a response hardly forgets how it began, the objective of a free march is a heap of narrow valleys: from
parameters a few percent off the march takes other turns than the structure did, and a descent ends at once. Tied
closely it goes where the structure went, and the objective is smooth; loosened step by step the ties have less and less
to do, and in the end none (continuation in the coupling: Abarbanel et al. 2009). What they do is never counted as
the law's: where the law does not do it, the response lacks it. A response that no free march can follow, because any
error grows in it, is compared in step.
"""

from __future__ import annotations

from dataclasses import replace

from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, of_fits, tried_fit
from labnnum.diagnosis.nonlinear.effort import tired
from labnnum.diagnosis.nonlinear.explore import STRAINED
from labnnum.diagnosis.nonlinear.follow import along, marched_from
from labnnum.diagnosis.nonlinear.orbit import Orbit

TIES = (10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.0)
"""Dashpots of the ties, of one that pushes as hard as the law does, one fit after the other."""
HOLDS = 1.0
"""Ties from which on the motion at the place is what it is tied to: how far it moves in a mode is then not fitted."""
STEPS = 8
"""Steps of each of these fits."""
SINKS = 0.5
"""Part of what was left with the tie before to which a looser one must bring a law that is far behind its rivals."""
LITTLE = 1.5
"""Chi-square per value up to which a free march is not led astray, whatever the law leaves along the motion."""


def in_step(bench: Bench, followed: Tried, steps: int) -> Tried | None:
    """A law that was followed, fitted by simulation; in step with the measured motion where a free march is led astray.

    As loosely as leaves least: what a tie has to do is missing, and the noise of the motion is what it brings in. Fits
    whose motion is as good as given are steps on the way, and compared only where none comes farther: they tell more
    of the motion that was recovered than of the law, and would let one at a neighbour win. After a long search, as over
    sweeps, nothing is tied any more.
    """
    free = bench.simulate(followed, steps)
    if tired() or not _astray(bench, followed, free):
        return free
    return tied(bench, followed, free)


def tied(bench: Bench, followed: Tried, free: Tried | None) -> Tried | None:
    """The best of a free simulation and of those in step with the measured motion."""
    done = loosened(bench, followed)
    loose = [t for t, tight in zip(done, TIES, strict=False) if tight < HOLDS] or done[-1:]
    return min((t for t in (free, *loose) if t is not None), key=lambda t: t.cost, default=None)


def in_step_already(one: Tried) -> bool:
    """Whether a simulation is tied all along."""
    return any(o is not None and o.tie is not None and o.tie.tight > 0 for o in one.made.orbits)


def _astray(bench: Bench, followed: Tried, free: Tried | None) -> bool:
    """Whether a simulation in noise leaves more than little, and than the law does along the measured motion, which has
    that motion's errors too, or bends the base where that does not: then it goes elsewhere than the structure did.
    """
    if followed.simulated or not all(r.open for r in bench.runs):
        return False
    if free is None or free.made.data_part > max(followed.made.data_part, LITTLE * free.made.count):
        return True
    most = max(STRAINED * free.made.n_base, followed.made.prior_part)
    return free.made.prior_part > most


def loosened(bench: Bench, one: Tried) -> list[Tried]:
    """A law that was followed, `one`, fitted by simulation with ties that are loosened, up to where a march fails, it
    stays far behind its rivals (`Bench.limit`), or the search has taken long.
    """
    joint = bench.joint_of([replace(lead.acting(), last=True) for lead in of_fits(one)])
    x: NDArray = one.made.x
    orbits: list[Orbit | None] | None = None
    done: list[Tried] = []
    for tight in TIES:
        if done and tired():
            break
        shown = marched_from(joint, x, along(joint, x), tight)
        orbits = shown if orbits is None else [_tied_as(o, s) for o, s in zip(orbits, shown, strict=True)]
        joint.hold_places(x if tight >= HOLDS else None)
        made = tried_fit(joint, x, orbits, one.lead, STEPS, more=one.more)
        if made is None:
            break
        x, orbits = made.made.x, list(made.made.orbits)
        lost = made.cost > bench.limit * made.made.count and bool(done) and made.cost > SINKS * done[-1].cost
        done.append(made)
        if lost:
            break
    return done


def _tied_as(orbit: Orbit | None, shown: Orbit | None) -> Orbit | None:
    """The orbit with the tie of another."""
    return orbit if orbit is None or shown is None else replace(orbit, tie=shown.tie)
