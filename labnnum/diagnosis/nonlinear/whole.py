"""The law that runs show, and the linear physics beneath it: one search after another until one explains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.answer import Given, answer, parts_of
from labnnum.diagnosis.nonlinear.bases import nominal, without
from labnnum.diagnosis.nonlinear.below import lost, quieter_than, under
from labnnum.diagnosis.nonlinear.bench import Bench, leads_of
from labnnum.diagnosis.nonlinear.beside import (
    Beneath,
    added_to,
    beneath,
    channels_of,
    ends_of,
    left_alone,
    misled,
    quietest_of,
    shares_of,
)
from labnnum.diagnosis.nonlinear.clamps import giving, named_in, nearer_to
from labnnum.diagnosis.nonlinear.decision import (
    UNCONFIRMED,
    NonlinearAnswer,
)
from labnnum.diagnosis.nonlinear.effort import counted, exhausted
from labnnum.diagnosis.nonlinear.explore import MISLED, NOISY, calmed
from labnnum.diagnosis.nonlinear.fast import held_fast
from labnnum.diagnosis.nonlinear.force import YIELDING
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, spots
from labnnum.diagnosis.nonlinear.mended import Fault, mended
from labnnum.diagnosis.nonlinear.partner import partners
from labnnum.diagnosis.nonlinear.records import Split
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.nonlinear.stuck import let_go, sticking, unsprung
from labnnum.diagnosis.nonlinear.weighed import (
    BETTER,
    better,
    bought,
    clear,
    dear,
    explains,
    held_in,
    held_of,
    idle,
    instead,
    retraces,
    same_place,
    total,
    twice,
)
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Diagnosis, Limits, Named
from labnnum.structures.modal import ModalStructure

if TYPE_CHECKING:
    from labnnum.diagnosis.gates import Gate


@dataclass(frozen=True, eq=False)
class _Held:
    """The bench of the structure with what its quietest level shows, its base vector there, the base vector `base` of
    the structure alone, the parameters `values` of what is held, and the runs.
    """

    bench: Bench
    x: NDArray
    base: NDArray
    values: NDArray
    parts: Split


FOREMOST = 0.9
"""Share of the distortion, of the foremost place's, from which a place is where it comes from."""


@dataclass
class Whole:
    """The searches of one diagnosis and what they share; faults of channels that were found are off its runs."""

    engine: Engine
    gate: Gate
    observations: Sequence[Observation]
    held_out: Sequence[Observation]
    places: Places
    scatter: Scatter
    limits: Limits
    band: tuple[float, float]
    again: Callable[..., Diagnosis]
    progress: Callable[[str], None]
    known: Sequence[Lead]
    nearly: float
    train: list[Observation]
    test: list[Observation]
    usable: list[Observation]
    faults: list[Fault] = field(default_factory=list)
    of_channels: tuple[Named, ...] = ()
    shares: dict[frozenset, float] = field(default_factory=dict)
    loose: NonlinearAnswer | None = None
    clamps: tuple[Named, ...] = ()
    under: Beneath | None = None

    @property
    def signs(self) -> dict:
        """What shows that the runs are not linear."""
        from labnnum.diagnosis.runs import nonlinear_signs

        return nonlinear_signs(self.observations)

    @property
    def periodic(self) -> bool:
        """Whether all runs repeat."""
        return all(o.run is not None for o in self.train)

    def law(
        self, on: Engine, *, known: Sequence[Lead] = (), doubted: int | None = None, whole: bool = True,
        suspicious: bool = True, strong: bool | None = None, given: Given | None = None,
    ) -> NonlinearAnswer | None:  # fmt: skip
        """The law that the runs show on an engine."""
        others = self.usable if whole else ()
        return answer(
            on, self.train, self.test, self.places, self.scatter, self.limits, self.band, self.progress, others, known,
            self.nearly, doubted, suspicious, strong, given,
        )  # fmt: skip

    # ------------------------------------------------------------ the law, and what lies beneath it

    def first(self) -> NonlinearAnswer | None:
        """The law, sought with linear physics of the quietest level in the model where that is called for."""
        free = not isinstance(self.engine.structure, ModalStructure) and not self.known
        parts = parts_of(self.engine, self.train, self.test, self.usable, self.band) if free else None
        early = parts is not None and misled(self.engine, parts, self.scatter, self.band)
        found = self.law(self.engine, suspicious=False, strong=True) if early else None
        sure = found is not None and clear(found)
        under: Beneath | None = None
        second: NonlinearAnswer | None = None
        if early and not sure:
            quiet, under = self._quiet()
            held = self._held(under) if under is not None else None
            fast = self._fast(under, held) if under is not None and held is not None else None
            if under is not None and held is not None and not (fast is not None and explains(fast)):
                fast = self.loose = self._slipping(under, held)
            if fast is not None and explains(fast):
                found, second, sure = None, fast, True
            elif under is not None:
                second = self._above(under)
                if quiet.named and (second is None or second.reason == UNCONFIRMED or idle(second)):
                    return None  # with that in the model there is nothing nonlinear, or next to nothing
        if not sure and second is not None and under is not None and dear(second) and not exhausted():
            loose = self._let_go(second, under)
            second = loose if loose is not None and loose.named and total(loose) < total(second) else second
        if not sure and second is not None and better(second, NOISY):
            again = self._unsprung(second, under) if under is not None and twice(second) else None
            second = again if again is not None and again.named and BETTER * again.misfit < second.misfit else second
        elif not sure:
            on_clamps = self._giving(parts) if early and parts is not None and not exhausted() else None
            if on_clamps is not None:
                self._stands_on(on_clamps)
                return on_clamps
            enough = exhausted() and second is not None and second.named
            whole = None if enough else self.law(self.engine, known=self.known, strong=False if early else None)
            if found is None or (whole is not None and whole.misfit < found.misfit):
                found = whole
            if not enough and (found is None or found.reason == UNCONFIRMED):
                return None
            if free and not early and found is not None and not (explains(found) or (found.named and exhausted())):
                under = self._quiet()[1]
                second = self._above(under) if under is not None else None
        if under is not None and second is not None and (found is None or instead(second, found)):
            fresh = not (self.loose or exhausted())
            one = self._one_for_two(second, replace(under, engines=[second.study.engine])) if fresh else None
            self._rid_of(under)
            return one or second
        self.under = under
        return found

    def _rid_of(self, under: Beneath) -> None:
        """Takes faults of channels at the quietest level off all runs."""
        self.faults, self.of_channels = under.faults, under.named
        self._mend(self.faults)

    def _giving(self, parts: Split) -> NonlinearAnswer | None:
        """A strong law on the structure of which a clamp gives; None where that does not explain what the structure
        leaves of the runs as it is.
        """
        self.progress("searching for a strong law on a clamp that gives")
        plain = left_alone(self.engine, parts, self.scatter, self.band)
        for on in giving(self.engine, self.places):
            with counted():  # it begins anew, on another structure
                made = self.law(on, suspicious=False, strong=True)
                if made is None or not made.named or made.lying is not None or not clear(made, plain):
                    continue
                nearer = nearer_to(self.engine, on, made.laws[-1].made.x)
                leads = (tuple(leads_of(made.laws)),)
                if nearer is None:
                    return made
                again = self._with((), nearer, given=Given(leads, nominal(nearer, nearer.theta0), NOISY))
            return again if again is not None and again.named and again.misfit < made.misfit else made
        return None

    def _stands_on(self, found: NonlinearAnswer) -> None:
        """From now on the structure is the one on which that law was found."""
        self.clamps, self.engine = named_in(found), found.study.engine
        self.again = partial(self.again, on=self.engine.structure)

    def _mend(self, faults: Sequence[Fault]) -> None:
        """Takes faults of channels off all runs."""
        self.train, self.test, self.usable = (
            [mended(o, faults) for o in part] for part in (self.train, self.test, self.usable)
        )

    def _quiet(self) -> tuple[Diagnosis, Beneath | None]:
        """The linear search on the quietest level alone, and what of it goes into the model."""
        self.progress("searching for linear physics at the quietest level")
        quiet = self.again(quietest_of(self.usable, self.train), depth=2, hint=True)
        self.shares = shares_of(self.engine, self.train, self.places, self.scatter, self.band)
        return quiet, beneath(self.engine, quiet, max(self.usable, key=lambda o: o.level), self.shares)

    def _above(self, under: Beneath) -> NonlinearAnswer | None:
        """What the law is with linear physics of the quietest level in the model, and faults of channels off."""
        made: NonlinearAnswer | None = None
        for on in under.engines:
            one = self._with(under.faults, on)
            if made is None or (one is not None and one.misfit < made.misfit):
                made = one
            if made is not None and (made.named or exhausted()):
                break
        return made

    def _with(self, faults: Sequence[Fault], on: Engine, given: Given | None = None) -> NonlinearAnswer | None:
        """The law that the runs show on an engine while these faults of channels are off them."""
        before = self.train, self.test, self.usable
        self._mend(faults)
        made = self.law(on, suspicious=False, given=given)
        self.train, self.test, self.usable = before
        return made

    def _unsprung(self, second: NonlinearAnswer, under: Beneath) -> NonlinearAnswer | None:
        """The law without what its structure holds at the same place, from where both are; None where it cannot be."""
        last, wide = second.laws[-1].made, second.study.engine
        n = self.engine.theta0.size
        values = last.x[n : wide.theta0.size]
        made = without(self.engine, wide, last.x)
        base = made[0] if made is not None else nominal(self.engine, last.x[:n])
        forms = unsprung(second.laws, held_in(second), values, self._spots(), float(self.engine.band[0]))
        return self._with(under.faults, self.engine, given=Given(forms, base, NOISY)) if forms else None

    def _held(self, under: Beneath) -> _Held | None:
        """The base of the quietest level beside what its structure holds there; None where it holds nothing, or moves
        otherwise.
        """
        wide = under.engines[0]
        parts = self._parts(wide, under) if held_of(wide) else None
        if parts is None:
            return None
        runs = tuple(o.run for o in parts.train if o.run is not None)
        i = quietest(runs)
        point = base_point(wide, parts.train[i], self.scatter, self.band)
        x = calmed(wide, point, runs[i], self.scatter).x
        base = without(self.engine, wide, x)
        return None if base is None else _Held(Bench(wide, point, runs, self.scatter, ()), x, *base, parts)

    def _fast(self, under: Beneath, held: _Held) -> NonlinearAnswer | None:
        """Friction in the stead of what holds a place fast at the quietest level; None where nothing does."""
        bench, every = self._plain(held.parts)
        forms = held_fast(bench, held.base, held_of(held.bench.engine), every)
        if not forms:
            return None
        self.progress("seeking friction where something holds fast")
        return self._with(under.faults, self.engine, given=Given(forms, held.base, NOISY))

    def _slipping(self, under: Beneath, held: _Held) -> NonlinearAnswer | None:
        """Sliders in the stead of springs of the quietest level that hold where the distortion comes from; None where
        there is no such spring.
        """
        sliders = sticking(held.bench, held.x, self._spots(), held_of(held.bench.engine), held.values)
        most = max(self.shares.values(), default=0.0)
        sliders = [s for s in sliders if self.shares.get(ends_of(s[0].spot.place), 0.0) >= FOREMOST * most > 0]
        if not sliders:
            return None
        self.progress("letting a spring of the quietest level slip")
        return self._with(under.faults, self.engine, given=Given(let_go(sliders), held.base, NOISY))

    def _one_for_two(self, found: NonlinearAnswer, under: Beneath) -> NonlinearAnswer | None:
        """A slider alone in the stead of a law that yields and of a spring that is held or was found beside it; None
        where that costs more. One that hardly slips is a spring, and what it slips another place shows too.
        """
        yields = [t for t in found.laws if t.mechanism in (*YIELDING, "coulomb-friction")]
        if not found.named or len(found.laws) != 1 or not yields or self.nearly:
            return None
        held = self._held(under)
        if held is None:
            return None
        sliders = sticking(held.bench, held.x, self._spots(), held_of(held.bench.engine), held.values)
        sliders = [s for s in sliders if not same_place(s[0].spot.place, yields[0].spot.place)]
        if not sliders:
            return None
        self.progress("letting a spring slip instead of the law and it")
        alone = self._with(under.faults, self.engine, given=Given(let_go(sliders, hardly=True), held.base, NOISY))
        return alone if alone is not None and alone.named and total(alone) <= total(found) else None

    def _let_go(self, second: NonlinearAnswer, under: Beneath) -> NonlinearAnswer | None:
        """The law on the structure alone if each spring of the quietest level is a slider that holds there, and, where
        that is not all, another law beside such a slider; None where there is no such spring.
        """
        study = second.study
        base = without(self.engine, study.engine, study.quiet.x)
        bench, every = Bench(study.engine, study.point, study.runs, self.scatter, ()), [q.spot for q in study.recovered]
        sliders = [] if base is None else sticking(bench, study.quiet.x, every, held_in(second), base[1])
        if base is None or not sliders:
            return None
        forms = let_go(sliders)
        loose = self.loose or self._with(under.faults, self.engine, given=Given(forms, base[0], NOISY))
        if not (loose is not None and loose.named) and second.gained and len(second.laws) == 1:
            self.progress("letting a spring of the quietest level slip beside the law")
            (own,) = leads_of(second.laws)
            pairs = tuple((own, *form) for form in forms if not same_place(own.spot.place, form[0].spot.place))
            both = self._with(under.faults, self.engine, given=Given(pairs, base[0], NOISY)) if pairs else None
            loose = both if both is not None and (loose is None or both.misfit < loose.misfit) else loose
        if (loose is not None and loose.named) or study.quiet.data_part > MISLED * study.quiet.count:
            return loose
        parts = self._parts(self.engine, under)
        if parts is None:
            return loose
        self.progress("seeking another law beside a slider that sticks")
        bench, every = self._plain(parts)
        forms = tuple(two for slider, motion in sliders for two in partners(bench, base[0], slider, motion, every))
        return self._with(under.faults, self.engine, given=Given(forms, base[0], NOISY)) if forms else loose

    def _parts(self, on: Engine, under: Beneath) -> Split | None:
        """The runs of the fit as an engine takes them, faults of channels off."""
        train, usable = ([mended(o, under.faults) for o in some] for some in (self.train, self.usable))
        return parts_of(on, train, (), usable, self.band)

    def _plain(self, parts: Split) -> tuple[Bench, list[Spot]]:
        """The bench of the structure alone over some runs, and the spots where a law may act."""
        runs = tuple(o.run for o in parts.train if o.run is not None)
        own = base_point(self.engine, parts.train[quietest(runs)], self.scatter, self.band)
        return Bench(self.engine, own, runs, self.scatter, ()), self._spots()

    def _spots(self, on: Engine | None = None) -> list[Spot]:
        """The spots of the structure alone, or of another one, where a law may act."""
        on = self.engine if on is None else on
        return spots(on, on.site(self.places.nodes, self.places.elements, self.places.supports))

    def from_below(self, found: NonlinearAnswer) -> NonlinearAnswer:
        """The law that the levels below the loudest one show, fitted to all, where what all show leaves too much."""
        most = quieter_than(self.usable) if lost(found) and not (self.nearly or exhausted()) else 0.0
        if not most:
            return found
        self.progress("searching for the law at the quieter levels")
        before = self.train, self.test, self.usable
        self.train, self.test, self.usable = self._under(most)
        with counted():  # it begins anew, on less
            quiet = self.law(self.engine, suspicious=False)
        self.train, self.test, self.usable = before
        if quiet is None or not quiet.named or lost(quiet):
            return found
        self.progress("fitting that law at all levels")
        last = quiet.laws[-1].made
        with counted():
            given = Given((tuple(leads_of(quiet.laws)),), last.x[: last.n_base], NOISY)
            second = self.law(self.engine, suspicious=False, given=given)
        return second if second is not None and second.named and total(second) < BETTER * total(found) else found

    def _under(self, most: float) -> tuple[list[Observation], list[Observation], list[Observation]]:
        """Runs of levels below `most`: of the fit, held out anew where none were given for that, and all of them."""
        from labnnum.diagnosis.runs import kept_from_law

        train, test, usable = (under(some, most) for some in (self.train, self.test, self.usable))
        if not self.held_out:
            kept = kept_from_law(usable)
            train = [o for i, o in enumerate(usable) if i not in kept]
            test = [usable[i] for i in sorted(kept)]
        return train, test, usable

    def unhidden(self, found: NonlinearAnswer) -> NonlinearAnswer:
        """The law, sought once more where one that leaves too much, named or not, stands beside something linear that
        the base pays for, in the structure or on a channel.
        """
        if not bought(found) or exhausted():
            return found
        if (second := self._over(found)) is not None:
            return second
        if len(found.laws) > 1:
            second = self._retraced(found)
            found = second if second is not None and retraces(second, found) else found
            if not bought(found):
                return found
        self.progress("searching for linear physics that hides the law")
        rest = self.again(found.linearised, found.linearised_held_out, depth=1)
        wider = added_to(self.engine, rest)
        if wider is not None:
            second = self.law(wider)
            return second if second is not None and second.named and second.misfit < found.misfit else found
        wrong = () if self.faults or found.lying is not None else channels_of(rest)
        faults = [Fault(n.term, n.value) for n in wrong]
        if not faults or any(f.lost for f in faults):
            return found
        second = self._with(faults, self.engine)
        if second is None or not second.named or second.misfit > BETTER * found.misfit:
            return found
        self.faults, self.of_channels = faults, wrong
        self._mend(faults)
        return second

    def _over(self, found: NonlinearAnswer) -> NonlinearAnswer | None:
        """The law as it was found alone on the structure with what the quietest level shows; None where it has no name
        there, or leaves as much.
        """
        under = self.under
        if under is None or found.study.engine is not self.engine:
            return None
        self.progress("fitting the law with that of the quietest level in the model")
        for on in under.engines if held_of(under.engines[0]) else ():
            leads = on_structure(leads_of(found.laws), self._spots(on))
            if leads is None:
                continue
            second = self._with(under.faults, on, given=Given((leads,), nominal(on, on.theta0), NOISY))
            if second is not None and second.named and instead(second, found):
                self._rid_of(under)
                return second
        return None

    def _retraced(self, found: NonlinearAnswer) -> NonlinearAnswer | None:
        """The same laws from the nominal base on: one that was found alone has bent the base, and does not come back
        when the others join it.
        """
        self.progress("fitting these laws together from the nominal model")
        leads = tuple(leads_of(found.laws))
        engine = found.study.engine
        return self._with((), engine, given=Given((leads,), nominal(engine, engine.theta0), NOISY))


def on_structure(leads: Sequence[Lead], every: Sequence[Spot]) -> tuple[Lead, ...] | None:
    """Laws of one structure at the same spots of another, which may have more motions; None where it lacks one."""
    there = {(s.place, s.axis): s.column for s in every}
    columns = [there.get((lead.spot.place, lead.spot.axis.lstrip("-"))) for lead in leads]
    if any(c is None for c in columns):
        return None
    pairs = zip(leads, columns, strict=True)
    return tuple(replace(lead, spot=replace(lead.spot, column=c)) for lead, c in pairs if c is not None)
