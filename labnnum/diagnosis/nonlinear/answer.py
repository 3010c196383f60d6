"""The answer to nonlinear signs: base, location, laws, and the linear data that remain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.alike import Equals, distinct
from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried
from labnnum.diagnosis.nonlinear.chain import laws_of, rivals
from labnnum.diagnosis.nonlinear.company import beside_others
from labnnum.diagnosis.nonlinear.decision import (
    BENT,
    KNOWN,
    MISFIT,
    NEARLY,
    NonlinearAnswer,
    decide,
    lead_over,
    unsimulated,
)
from labnnum.diagnosis.nonlinear.detect import repeating, signs
from labnnum.diagnosis.nonlinear.effort import counted, tired, weary
from labnnum.diagnosis.nonlinear.explore import LONG, NOISY, Prospect, explore, resumed
from labnnum.diagnosis.nonlinear.fast import fast_kin
from labnnum.diagnosis.nonlinear.fitting import Made
from labnnum.diagnosis.nonlinear.further import needed
from labnnum.diagnosis.nonlinear.joined import joined, records, with_friction
from labnnum.diagnosis.nonlinear.linearise import linearised
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, spots
from labnnum.diagnosis.nonlinear.matched import within
from labnnum.diagnosis.nonlinear.mended import Fault, mended
from labnnum.diagnosis.nonlinear.pairs import BETTER, ENOUGH, paired, study_of
from labnnum.diagnosis.nonlinear.recorded import behind_recorder
from labnnum.diagnosis.nonlinear.records import Split, changed, split
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.softened import softened
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.nonlinear.study import (
    FINE,
    anew,
    base_again,
    corners,
    fine_enough,
    from_afar,
    kindred,
    named_kin,
    nameless_kin,
    of_known,
    refined,
    search,
)
from labnnum.diagnosis.nonlinear.suspect import FEW, POOR, back, finer, suspect, without
from labnnum.diagnosis.nonlinear.timing import Timed, timing, told
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
    parts = parts_of(engine, train, test, others, span)
    if parts is None:
        return None
    one = _Search(engine, parts, others, scatter, limits, span, progress, nearly)
    found = _as_recorded(one, places, known, doubted, suspicious, strong, given)
    sought = found is not None and one.identified and not (known or parts.whole or found.lying is not None)
    if found is None or not sought or doubted is not None:
        return found

    def again(fault: Fault, carried: NonlinearAnswer | None = None) -> NonlinearAnswer | None:
        off = [[mended(o, [fault]) for o in some] for some in (parts.train, parts.test, others)]
        other = _Search(
            engine, Split(tuple(off[0]), tuple(off[1]), ()), off[2], scatter, limits, span, progress, nearly
        )  # fmt: skip
        with counted():
            if carried is not None:
                return other.carried(carried, one.timed)
            return _as_recorded(other, places, (), None, False, strong, given)

    return behind_recorder(found, one.runs, scatter, again, progress)


def _as_recorded(
    one: _Search, places: Places, known: Sequence[Lead], doubted: int | None, suspicious: bool, strong: bool | None,
    given: Given | None,
) -> NonlinearAnswer | None:  # fmt: skip
    """The answer of a search to its runs as they are."""
    held = one.of_model(known) if known else None
    if held is not None:
        return held
    one.look_around(places)
    seen = one.given(given) if given is not None else one.explored(strong)
    if seen is None and (strong or given is not None):
        return None
    if seen is not None and doubted is None and not one.nearly and seen.idle:
        return None
    if seen is not None and doubted is None and seen.nameless:
        return one.place_alone(seen)
    if doubted is not None:
        again = one.exploring([without(o, doubted) for o in one.train])
        return None if again is None else one.left_out(doubted, again)
    done = None if seen is None else one.laws(seen, given)
    lying = one.suspected(seen, done) if suspicious else None
    if lying is None and done is None and seen is not None and one.far(seen):
        return one.place_alone(seen)
    whole = None if lying is None or seen is None else back(seen, lying[1])
    if whole is not None:  # it was the way to the law that was hard to find, not the channel that lied
        return one.decided(one.pursued(whole) or done)
    return one.decided(done) if lying is None else one.left_out(*lying)


_Found = tuple[Study, list[Tried]]
"""The study in which laws were sought, and the laws."""


class _Search:
    """One search for laws, and its steps."""

    def __init__(
        self, engine: Engine, parts: Split, others: Sequence[Observation], scatter: Scatter, limits: Limits,
        span: tuple[float, float], progress: Callable[[str], None], nearly: float,
    ) -> None:  # fmt: skip
        self.engine, self.scatter, self.limits, self.span = engine, scatter, limits, span
        self.train, self.test, self.whole, self.others = list(parts.train), list(parts.test), parts.whole, others
        self.progress, self.nearly = progress, nearly
        self.identified = isinstance(engine.structure, ModalStructure)
        self.runs = _runs(self.train)
        self.calm = quietest(self.runs)
        self.point = base_point(engine, self.train[self.calm], scatter, span)
        self.every: list[Spot] = []
        self.equal: Equals = {}
        self.timed: list[Timed] = []
        self.deep: list[Made] = []

    def of_model(self, known: Sequence[Lead]) -> NonlinearAnswer | None:
        """That the laws which the model holds explain the runs, where they do."""
        self.progress("fitting the laws of the model")
        held = of_known(self.engine, self.point, self.runs, self.calm, known, self.scatter)
        if held is None or held.best.made.data_part >= MISFIT * held.best.made.count:
            return None
        made = decide(held, [held.best], self.train, self.test, self.scatter, self.limits, self.whole)
        return replace(made, named=(), place=None, reason=KNOWN)

    def look_around(self, places: Places) -> None:
        """The places where a law may act, one of those that move alike; by the timing of distortion if that tells."""
        every = spots(self.engine, self.engine.site(places.nodes, places.elements, places.supports))
        self.every, self.equal = (every, {}) if self.identified else distinct(self.engine, every)
        self.timed = timing(self.train, self.every) if self.nearly else []
        if told(self.timed, self.limits):
            self.every = [s for s in self.every if s.place == self.timed[0].spot.place]

    # ------------------------------------------------------------ along the motions that were measured

    def explored(self, strong: bool | None) -> Prospect | None:
        """What the motions promise."""
        return explore(
            self.engine, self.point, self.runs, self.calm, self.every, self.scatter, unnamed=not self.identified,
            strong=strong, progress=self.progress,
        )  # fmt: skip

    def exploring(self, some: Sequence[Observation]) -> Prospect | None:
        """What the motions of other observations of the same runs promise, on a few lines."""
        own = base_point(self.engine, some[self.calm], self.scatter, self.span)
        return explore(
            self.engine, own, _runs(some), self.calm, self.every, self.scatter, lines=FEW, carry_on=False,
            unnamed=not self.identified,
        )  # fmt: skip

    def given(self, given: Given) -> Prospect | None:
        """What laws that were found on another engine promise; None where that is too little."""
        self.progress("fitting the law as it is without that in the model")
        seen = resumed(
            self.engine, self.point, self.runs, self.calm, self.every, self.scatter, given.leads, given.base
        )  # fmt: skip
        return None if seen is None or seen.level > given.most else seen

    def far(self, seen: Prospect) -> bool:
        """Whether no law comes near enough to be simulated."""
        return seen.hopeless and not self.identified

    def suspected(self, seen: Prospect | None, done: _Found | None) -> tuple[int, Prospect] | None:
        """The response without which a law explains what none does with it, and what the motions promise then."""
        last = None if done is None else done[1][-1]
        if self.whole or self.nearly or tired() or not (last is None or _poor(last)):
            return None
        return suspect(self.train, seen, self.exploring)

    # ------------------------------------------------------------ by simulation

    def laws(self, seen: Prospect, given: Given | None) -> _Found | None:
        """The laws that the motions promise, fitted by simulation."""
        if given is not None and seen.near[0].more:
            return study_of(seen, list(seen.near), self.scatter, self.limits.further)
        if self.far(seen) and not (seen.sought or tired()):
            seen = from_afar(seen, self.progress)
        if seen.pairs and (two := self.both(seen, pairs=seen.pairs)) is not None:
            return two
        return self.both(seen) if self.far(seen) else self.pursued(seen)

    def pursued(self, seen: Prospect) -> _Found | None:
        """One law after the other, or two at once where the best one leaves too much."""
        found = search(seen, self.progress, unsure=self.nearly > 0)
        if found is None:
            return None
        if found.pairs and (two := self.both(seen, found.best, found.pairs)) is not None:
            return two
        self.progress("comparing places and laws")
        tried = refined(found, self.scatter, rivals(found, self.every, self.scatter))
        if not tried:
            return None
        tried = [corners(found, tried, self.scatter, POOR), *tried[1:]]
        if not self.identified:  # the base of such a model is the quietest level's, and no law has bent it
            best = self._deepened(found, fine_enough(found, anew(found, tried, self.scatter), self.scatter))
            tried = [*kindred(found, tried[1:], best, self.scatter), *tried[1:]]
            tried = [*fast_kin(found, tried[0], self.scatter), *tried[1:]]
            tried = [*named_kin(found, tried[0], self.scatter), *tried[1:]]
            tried = [*_ahead(nameless_kin(found, tried[0], self.scatter), tried[0], self.limits), *tried]
        found = replace(found, tried=tuple(tried), base=base_again(found, self.scatter))
        alone = not self.identified and (_poor(tried[0]) or _bought(tried[0]))
        two = self.both(seen, tried[0]) if alone else None
        return two or laws_of(
            found, self.every, self.train, self.test, self.scatter, self.limits, self.progress, self.identified
        )  # fmt: skip

    def both(self, seen: Prospect, one: Tried | None = None, pairs: Sequence[Tried] = ()) -> _Found | None:
        """Two laws that were sought together, where they explain what the best `one` does not; those of `pairs` if
        given.
        """
        if not pairs:
            pairs = [] if tired() else paired(seen, self.every, self.progress)
        if not pairs:
            return None
        self.progress("comparing pairs of nonlinear laws")
        found, laws = study_of(seen, pairs, self.scatter, self.limits.further)
        level = laws[-1].made.objective / laws[-1].made.count
        before = np.inf if one is None else one.made.objective / one.made.count
        return (found, laws) if level < min(NOISY, BETTER * before) else None

    def _deepened(self, found: Study, best: Tried) -> Tried:
        """The fit at the bottom of its valley."""
        best = deepened(found, best, self.scatter)
        self.deep.append(best.made)
        return best

    # ------------------------------------------------------------ the answer

    def place_alone(self, seen: Prospect) -> NonlinearAnswer:
        """The answer where no law is simulated."""
        return unsimulated(seen, self.train, self.test, self.scatter, self.equal)

    def decided(self, done: _Found | None) -> NonlinearAnswer | None:
        """The answer from the laws; None where there are none."""
        if done is None:
            return None
        found, laws = done
        if not (self.identified or weary()):
            found, laws = self._in_company(found, laws)
        if not self.identified:
            laws = softened(found, laws, self.scatter, self.limits.further)
        more = records(self.others, self.span, self.runs[0].miss) if self.nearly and not self.whole else []
        if more:
            self.progress("fitting records that are not periodic")
            laws[-1] = joined(found, laws[-1], more, self.scatter)
            dry = with_friction(found, laws[-1], more, self.scatter)
            laws += [] if dry is None else [dry]
        if not self.identified and all(laws[-1].made is not m for m in self.deep):
            laws[-1] = self._deepened(found, laws[-1])
        if not self.identified and laws[-1].simulated and not laws[-1].made.sure:
            bench = Bench(found.engine, found.point, found.runs, self.scatter, ()).on(FINE)
            laws[-1] = bench.carry_on(laws[-1], 2, always=True, last=laws[-1].made.terms[0].last)
        return decide(
            found, laws, self.train, self.test, self.scatter, self.limits, self.whole, self.nearly or NEARLY,
            self.timed, self.equal,
        )  # fmt: skip

    def _in_company(self, found: Study, laws: list[Tried]) -> _Found:
        """The laws, the first of them exchanged for a rival that leaves far less beside the others than it does, and
        the rivals that were asked beside them: which is the first alone may be the others' doing.
        """
        company = beside_others(found, laws, self.scatter)
        best = min(company, key=lambda t: t.cost / t.made.count, default=None)
        last = laws[-1]
        if best is None or best.cost * last.made.count > EXCHANGE * last.cost * best.made.count:
            return replace(found, company=company), laws
        chain = [Tried(lead, best.made, best.cost) for lead in (best.lead, *best.more)]
        made = needed(found, chain, self.scatter, self.limits.further)
        if made[-1].cost * last.made.count > EXCHANGE * last.cost * made[-1].made.count:
            return replace(found, company=company), laws
        first = [t for t in found.tried if t.name == best.name and t.spot.place == best.spot.place]
        tried = (*first, *(t for t in found.tried if all(t is not o for o in first)))
        rivals_of_it = (last, *(t for t in company if t.name != best.name or t.spot.place != best.spot.place))
        return replace(found, tried=tried, company=rivals_of_it), made

    def carried(self, found: NonlinearAnswer, timed: Sequence[Timed]) -> NonlinearAnswer | None:
        """The laws of another answer fitted on to this search's runs, which are its runs by another filter."""
        self.timed = list(timed)
        study, last = replace(found.study, runs=tuple(self.runs)), found.laws[-1]
        bench = Bench(study.engine, study.point, study.runs, self.scatter, ()).on(FINE)
        last = bench.carry_on(last, LONG, always=True, last=last.made.terms[0].last)
        return self.decided((study, [*found.laws[:-1], last]))

    def left_out(self, channel: int, seen: Prospect) -> NonlinearAnswer | None:
        """The answer without a response, whose FRFs and every other's are then freed of the law for a linear search."""
        self.progress(f"without channel {self.runs[0].outputs[channel].name}")
        believed, n = (*self.train, *self.test), len(self.train)
        self.train, self.test = ([without(o, channel) for o in part] for part in (self.train, self.test))
        done = self.pursued(finer(seen))
        made = self.decided(done)
        if done is None or made is None:
            return None
        every = linearised(done[0], made.laws[-1].made, made.orbits, believed, self.scatter, channel, n)
        return replace(made, lying=channel, linearised=tuple(every[:n]), linearised_held_out=tuple(every[n:]))


EXCHANGE = 0.5
"""Part of what laws leave below which a rival of the first beside the others takes its place."""


def parts_of(
    engine: Engine, train: Sequence[Observation], test: Sequence[Observation], others: Sequence[Observation],
    span: tuple[float, float],
) -> Split | None:  # fmt: skip
    """Runs to fit and runs held out, by level, and the originals of hits, noise and sweeps; None where no run shows
    nonlinear signs.
    """
    train, test = (sorted((o for o in some if o.run is not None), key=lambda o: o.level) for some in (train, test))
    train, test = repeating(train, test)
    runs = [o.run for o in train if o.run is not None]
    whole: tuple[Observation, ...] = ()
    if not runs:
        if not changed(others):
            return None
        b = engine.band_modes
        parts = split(others, float(1 / np.min(engine.zeta0[b] * engine.state(engine.theta0).omega[b])))
        train = sorted((within(o, span) for o in parts.train), key=lambda o: o.level)
        test = sorted((within(o, span) for o in parts.test), key=lambda o: o.level)
        runs, whole = [o.run for o in train if o.run is not None], parts.whole
    elif not signs(runs).present:
        return None
    train, test = ([o for o in some if o.run is not None and o.run.compared.any()] for some in (train, test))
    if not train:
        return None
    runs = [o.run for o in train if o.run is not None]
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


def _bought(last: Tried) -> bool:
    """Whether a law leaves more than noise though the base bends far for it."""
    made = last.made
    return made.prior_part > BENT * made.n_base and made.data_part > ENOUGH * made.count


def _runs(some: Sequence[Observation]) -> list[Run]:
    """Runs of observations that have one."""
    return [o.run for o in some if o.run is not None]


def _levels(train: Sequence[Observation], runs: list[Run], most: int = 4) -> tuple[list[Observation], list[Run]]:
    """At most `most` runs, spread over the levels."""
    if len(runs) <= most:
        return list(train), runs
    pick = np.unique(np.linspace(0, len(runs) - 1, most).round().astype(int))
    return [train[i] for i in pick], [runs[i] for i in pick]
