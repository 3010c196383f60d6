"""The answer to nonlinear signs: base, location, laws, and the linear data that remain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bench import Study, Tried
from labnnum.diagnosis.nonlinear.chain import laws_of, rivals
from labnnum.diagnosis.nonlinear.decision import (
    KNOWN,
    MISFIT,
    NEARLY,
    NonlinearAnswer,
    decide,
    lead_over,
    unsimulated,
)
from labnnum.diagnosis.nonlinear.detect import signs
from labnnum.diagnosis.nonlinear.effort import tired
from labnnum.diagnosis.nonlinear.explore import NOISY, Prospect, explore, resumed
from labnnum.diagnosis.nonlinear.fitting import Made
from labnnum.diagnosis.nonlinear.joined import joined, records
from labnnum.diagnosis.nonlinear.linearise import linearised
from labnnum.diagnosis.nonlinear.locate import Lead, spots
from labnnum.diagnosis.nonlinear.pairs import BETTER, paired, study_of
from labnnum.diagnosis.nonlinear.records import Split, changed, split
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.nonlinear.study import (
    anew,
    base_again,
    corners,
    fine_enough,
    nameless_kin,
    of_known,
    refined,
    search,
    yielding_kin,
)
from labnnum.diagnosis.nonlinear.suspect import FEW, POOR, back, finer, suspect, without
from labnnum.diagnosis.nonlinear.timing import timing, told
from labnnum.diagnosis.nonlinear.valley import deepened
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Limits
from labnnum.structures.modal import ModalStructure


@dataclass(frozen=True, eq=False)
class Given:
    """Laws that were found on another engine, in several forms; a base vector to begin from; and the chi-square per
    value above which it is not worth going on with them.
    """

    leads: tuple[tuple[Lead, ...], ...]
    base: NDArray[np.float64]
    most: float


def answer(
    engine: Engine, train: Sequence[Observation], test: Sequence[Observation], places: Places, scatter: Scatter,
    limits: Limits, span: tuple[float, float], progress: Callable[[str], None] = lambda text: None,
    others: Sequence[Observation] = (), known: Sequence[Lead] = (), nearly: float = 0.0, doubted: int | None = None,
    suspicious: bool = True, strong: bool | None = None, given: Given | None = None,
) -> NonlinearAnswer | None:  # fmt: skip
    """What nonlinear physics the observations show; None where they show none.

    Parameters
    ----------
    train, test : sequence of Observation
        Periodic runs with their spectra.
    others : sequence of Observation
        Hits and random data, which are looked at where there are no periodic runs.
    known : sequence of Lead
        Laws that the model holds: where they explain the data nothing else is sought.
    span : (low, high)
        Band in Hz.
    nearly : float
        Part of the base's held-out error to which a law must bring it down for its misfit to be excused, of a model
        that was identified and misses its own data; 0 for others, which have `NEARLY`. The place of such a model is
        told by the time at which distortion comes, where that tells.
    doubted : int, optional
        Number of a response of periodic runs that is left out.
    suspicious : bool
        Whether responses are left out one after the other where a law leaves too much.
    strong : bool, optional
        Whether laws that are strong at the lowest level too are looked for only, or not again.
    given : Given, optional
        Laws that were found on another engine, which are not looked for but fitted.
    """
    identified = isinstance(engine.structure, ModalStructure)
    parts = parts_of(engine, train, test, others, span)
    if parts is None:
        return None
    train, test, whole = list(parts.train), list(parts.test), parts.whole
    runs = [o.run for o in train if o.run is not None]
    i = quietest(runs)
    point = base_point(engine, train[i], scatter, span)
    if known:
        progress("fitting the laws of the model")
        held = of_known(engine, point, runs, i, known, scatter)
        if held is not None and held.best.made.data_part < MISFIT * held.best.made.count:
            made = decide(held, [held.best], train, test, scatter, limits, whole)
            return replace(made, named=(), place=None, reason=KNOWN)
    site = engine.site(places.nodes, places.elements, places.supports)
    every = spots(engine, site)
    timed = timing(train, every) if nearly else []
    if told(timed, limits):
        every = [s for s in every if s.place == timed[0].spot.place]

    def exploring(some: Sequence[Observation]) -> Prospect | None:
        own = base_point(engine, some[i], scatter, span)
        return explore(
            engine,
            own,
            [o.run for o in some if o.run is not None],
            i,
            every,
            scatter,
            lines=FEW,
            carry_on=False,
            unnamed=not identified,
        )

    if given is not None:
        progress("fitting the law as it is without that in the model")
        seen = resumed(engine, point, runs, i, every, scatter, given.leads, given.base)
    else:
        seen = explore(engine, point, runs, i, every, scatter, unnamed=not identified, strong=strong, progress=progress)
    if seen is None and strong:
        return None
    if given is not None and (seen is None or seen.level > given.most):
        return None
    if seen is not None and doubted is None and not nearly and seen.idle:
        return None
    if seen is not None and doubted is None and seen.nameless:
        return unsimulated(seen, train, test, scatter)
    believed: tuple[Observation, ...] = ()
    deep: list[Made] = []

    def pursued(seen: Prospect) -> tuple[Study, list[Tried]] | None:
        found = search(seen, progress, unsure=nearly > 0)
        if found is None:
            return None
        progress("comparing places and laws")
        tried = refined(found, scatter, rivals(found, every, scatter))
        if not tried:
            return None
        tried = [corners(found, tried, scatter, POOR), *tried[1:]]
        if not identified:  # the base of such a model is the quietest level's, and no law has bent it
            best = fine_enough(found, anew(found, tried, scatter), scatter)
            best = deepened(found, best, scatter)
            deep.append(best.made)
            tried = [*yielding_kin(found, best, scatter), *tried[1:]]
            tried = [*_ahead(nameless_kin(found, tried[0], scatter), tried[0], limits), *tried]
        found = replace(found, tried=tuple(tried), base=base_again(found, scatter))
        two = both(seen, tried[0]) if not identified and _poor(tried[0]) else None
        return two or (found, laws_of(found, every, train, test, scatter, limits, progress, identified))

    def both(seen: Prospect, one: Tried | None = None) -> tuple[Study, list[Tried]] | None:
        """Two laws that were sought together, where they explain what the best `one` does not."""
        pairs = [] if tired() else paired(seen, every, progress)
        if not pairs:
            return None
        progress("comparing pairs of nonlinear laws")
        found, laws = study_of(seen, pairs, scatter, limits.further)
        level = laws[-1].made.data_part / laws[-1].made.count
        before = np.inf if one is None else one.made.data_part / one.made.count
        return (found, laws) if level < min(NOISY, BETTER * before) else None

    done: tuple[Study, list[Tried]] | None = None
    lying: tuple[int, Prospect] | None = None
    if doubted is not None:
        again = exploring([without(o, doubted) for o in train])
        lying = None if again is None else (doubted, again)
    else:
        far = seen is not None and seen.hopeless and not identified
        if seen is not None and given is not None and seen.near[0].more:
            done = study_of(seen, list(seen.near), scatter, limits.further)
        elif seen is not None and not far:
            done = pursued(seen)
        elif seen is not None and not identified:
            done = both(seen)
            far = done is None
        last = None if done is None else done[1][-1].made
        doubtful = last is None or last.data_part > POOR * last.count
        if suspicious and not (whole or nearly or tired()) and doubtful:
            lying = suspect(train, seen, exploring)
        if lying is None and seen is not None and far:
            return unsimulated(seen, train, test, scatter)
        if lying is not None and seen is not None:
            whole_again = back(seen, lying[1])
            if whole_again is not None:  # it was the way to the law that was hard to find, not the channel that lied
                done, lying = pursued(whole_again) or done, None
    if lying is not None:
        progress(f"without channel {runs[0].outputs[lying[0]].name}")
        believed = (*train, *test)
        train, test = ([without(o, lying[0]) for o in part] for part in (train, test))
        done = pursued(finer(lying[1]))
    if done is None:
        return None
    found, laws = done
    more = records(others, span, runs[0].miss) if nearly and not whole else []
    if more:
        progress("fitting records that are not periodic")
        laws[-1] = joined(found, laws[-1], more, scatter)
    if not identified and all(laws[-1].made is not m for m in deep):
        laws[-1] = deepened(found, laws[-1], scatter)
    made = decide(found, laws, train, test, scatter, limits, whole, nearly or NEARLY, timed)
    if lying is None:
        return made
    every_channel = linearised(found, made.laws[-1].made, made.orbits, believed, scatter, lying[0])
    return replace(
        made, lying=lying[0], linearised=tuple(every_channel[: len(train)]),
        linearised_held_out=tuple(every_channel[len(train) :]),
    )  # fmt: skip


def parts_of(
    engine: Engine, train: Sequence[Observation], test: Sequence[Observation], others: Sequence[Observation],
    span: tuple[float, float],
) -> Split | None:  # fmt: skip
    """Runs to fit and runs held out, by level, and the originals of hits, noise and sweeps; None where no run shows
    nonlinear signs.
    """
    train = sorted((o for o in train if o.run is not None), key=lambda o: o.level)
    test = sorted((o for o in test if o.run is not None), key=lambda o: o.level)
    runs = [o.run for o in train if o.run is not None]
    whole: tuple[Observation, ...] = ()
    if not runs:
        if not changed(others):
            return None
        b = engine.band_modes
        parts = split(others, float(1 / np.min(engine.zeta0[b] * engine.state(engine.theta0).omega[b])))
        train = sorted((_within(o, span) for o in parts.train), key=lambda o: o.level)
        test = sorted((_within(o, span) for o in parts.test), key=lambda o: o.level)
        runs, whole = [o.run for o in train if o.run is not None], parts.whole
    elif not signs(runs).present:
        return None
    return Split(tuple(_levels(train, runs)[0]), tuple(test), whole)


def _ahead(other: Tried | None, best: Tried, limits: Limits) -> list[Tried]:
    """Another candidate where it leads the best as far as a name must."""
    if other is None:
        return []
    left = other.made.data_part / other.made.count
    lead = lead_over(other.cost, best.cost, max(1.0, left), left > limits.misfit)
    return [other] if lead > limits.name else []


def _poor(last: Tried) -> bool:
    """Whether a law leaves so much that something else acts beside them."""
    return last.made.data_part > POOR * last.made.count


def _within(o: Observation, span: tuple[float, float]) -> Observation:
    """The observation with its run compared inside the band only."""
    assert o.run is not None
    inside = (o.run.frequency >= span[0]) & (o.run.frequency <= span[1])
    return replace(o, run=replace(o.run, use=inside if o.run.use is None else o.run.use & inside))


def _levels(train: Sequence[Observation], runs: list[Run], most: int = 4) -> tuple[list[Observation], list[Run]]:
    """At most `most` runs, spread over the levels."""
    if len(runs) <= most:
        return list(train), runs
    pick = np.unique(np.linspace(0, len(runs) - 1, most).round().astype(int))
    return [train[i] for i in pick], [runs[i] for i in pick]
