"""Nonlinear physics first, then the linear search on what it leaves: one answer from both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.answer import Given, answer, parts_of
from labnnum.diagnosis.nonlinear.bases import nominal, without
from labnnum.diagnosis.nonlinear.bench import Bench, leads_of
from labnnum.diagnosis.nonlinear.beside import (
    Beneath,
    added_to,
    beneath,
    channels_of,
    confirmed,
    ends_of,
    finds_first,
    left_alone,
    misled,
    quietest_of,
    shares_of,
    supposed,
)
from labnnum.diagnosis.nonlinear.bounds import hopeless, hopeless_beside
from labnnum.diagnosis.nonlinear.clamps import giving, named_in, nearer_to
from labnnum.diagnosis.nonlinear.decision import (
    EQUAL,
    FOUND,
    KNOWN,
    MISFIT,
    UNCONFIRMED,
    USELESS,
    NonlinearAnswer,
)
from labnnum.diagnosis.nonlinear.detect import CHANGE, steadier
from labnnum.diagnosis.nonlinear.effort import counted
from labnnum.diagnosis.nonlinear.explore import MISLED, NOISY, STRAINED, calmed
from labnnum.diagnosis.nonlinear.fast import held_fast
from labnnum.diagnosis.nonlinear.identified import LEAST, NEARLY, missing, own_scatter
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, spots
from labnnum.diagnosis.nonlinear.mended import Fault, mended
from labnnum.diagnosis.nonlinear.merge import merged
from labnnum.diagnosis.nonlinear.overloaded import overloaded
from labnnum.diagnosis.nonlinear.partner import partners
from labnnum.diagnosis.nonlinear.records import Split
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.nonlinear.stuck import let_go, sticking, unsprung
from labnnum.diagnosis.nonlinear.weighed import (
    BETTER,
    EXPLAINED,
    better,
    bought,
    certain,
    clear,
    dear,
    explains,
    held_in,
    held_of,
    idle,
    instead,
    same_place,
    total,
    twice,
)
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Diagnosis, Limits, Named
from labnnum.mechanisms import CATALOGUE
from labnnum.structures.modal import ModalStructure

if TYPE_CHECKING:
    from labnnum.diagnosis.gates import Gate


def nonlinear_first(
    engine: Engine, gate: Gate, observations: Sequence[Observation], held_out: Sequence[Observation], places: Places,
    scatter: Scatter, limits: Limits, span: tuple[float, float] | None,
    again: Callable[..., Diagnosis], progress: Callable[[str], None], known: Sequence[Lead] = (),
    held: Sequence[Fault] = (),
) -> Diagnosis | None:  # fmt: skip
    """The whole diagnosis where the runs show nonlinear physics, else None.

    `known` laws are those that the model holds, and `held` what it says that the recorder does to all channels, which
    is taken off. The linear search (`again`) runs on FRFs from which the law's share is taken. Where it names a fault
    of a channel, that is taken off the spectra and the law is sought once more.
    """
    from labnnum.diagnosis.runs import kept_from_law

    usable, held_out = ([mended(o, held) for o in some] for some in (steadier(gate.usable), held_out))
    kept = set() if held_out else kept_from_law(usable)
    train = [o for i, o in enumerate(usable) if i not in kept]
    test = list(held_out) or [usable[i] for i in sorted(kept)]
    nearly = 0.0
    if isinstance(engine.structure, ModalStructure):
        scatter = own_scatter(engine.structure.error)
        nearly = NEARLY if engine.structure.error > 0 else 0.0
        miss = max(engine.structure.error, LEAST)
        train, test = ([missing(o, miss) for o in part] for part in (train, test))
    band = span or (float(engine.band[0] / 2 / np.pi), float(engine.band[1] / 2 / np.pi))
    whole = _Whole(
        engine, gate, observations, held_out, places, scatter, limits, band, again, progress, known, nearly, train,
        test, list(usable),
    )  # fmt: skip
    with counted():
        found = whole.first()
        if found is None:
            return None
        found = whole.unhidden(found)
        if not found.named and found.reason != KNOWN and not certain(found):
            linear = whole.nameless(found)
            if linear is not None:
                return linear
        return whole.beside(found)


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
class _Whole:
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
        if not sure and second is not None and under is not None and dear(second):
            loose = self._let_go(second, under)
            second = loose if loose is not None and loose.named and total(loose) < total(second) else second
        if not sure and second is not None and better(second, NOISY):
            again = self._unsprung(second, under) if under is not None and twice(second) else None
            second = again if again is not None and again.named and BETTER * again.misfit < second.misfit else second
        elif not sure:
            on_clamps = self._giving(parts) if early and parts is not None else None
            if on_clamps is not None:
                self._stands_on(on_clamps)
                return on_clamps
            whole = self.law(self.engine, known=self.known, strong=False if early else None)
            if found is None or (whole is not None and whole.misfit < found.misfit):
                found = whole
            if found is None or found.reason == UNCONFIRMED:
                return None
            if free and not early and not explains(found):
                under = self._quiet()[1]
                second = self._above(under) if under is not None else None
        if under is not None and second is not None and (found is None or instead(second, found)):
            found, self.faults, self.of_channels = second, under.faults, under.named
            self._mend(self.faults)
        return found

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
            if made is not None and made.named:
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

    def _spots(self) -> list[Spot]:
        """The spots of the structure alone where a law may act."""
        return spots(self.engine, self.engine.site(self.places.nodes, self.places.elements, self.places.supports))

    def unhidden(self, found: NonlinearAnswer) -> NonlinearAnswer:
        """The law, sought once more where one that leaves too much, named or not, stands beside something linear that
        the base pays for, in the structure or on a channel.
        """
        if not bought(found):
            return found
        if len(found.laws) > 1:
            second = self._retraced(found)
            found = second if second is not None and _retraces(second, found) else found
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

    def _retraced(self, found: NonlinearAnswer) -> NonlinearAnswer | None:
        """The same laws from the nominal base on: one that was found alone has bent the base, and does not come back
        when the others join it.
        """
        self.progress("fitting these laws together from the nominal model")
        leads = tuple(leads_of(found.laws))
        engine = found.study.engine
        return self._with((), engine, given=Given((leads,), nominal(engine, engine.theta0), NOISY))

    # ------------------------------------------------------------ linear physics instead of it and beside it

    def nameless(self, found: NonlinearAnswer) -> Diagnosis | None:
        """The linear search where no law has a name and that says more; None where the law's share is to be taken out
        first.
        """
        useless = hopeless(found, self.observations, self.scatter, self.limits)
        # what one linear mechanism explains needs no law that has no name
        plain = self.again(self.observations, self.held_out, **({"catalogue": ()} if useless else {}))
        small = found.base_error[1] < max(self.limits.sound, 3 * found.noise)
        sound = plain.verdict in ("consistent", "parameters") and (
            small if found.reason == USELESS else not (self.periodic or found.gained)
        )
        change = self.signs["level_dependence"]
        linear = not found.gained and change is not None and change < CHANGE  # it rings, or the shaker distorts
        moves = found.gained and change is not None and change > 2 * CHANGE  # which no linear mechanism does
        if not useless and ((plain.named and not moves) or sound or linear):
            return plain
        if not self.gate.named and (found.misfit > MISFIT or not found.gained):
            # what such a law leaves is no linear structure either, or what there was before
            return merged(found, plain, (), self.signs, self.observations)
        return None

    def beside(self, found: NonlinearAnswer) -> Diagnosis | None:
        """The law and what the linear search finds beside it; None where a channel alone made the signs."""
        if not found.linearised:
            rest = self.again(self.observations, self.held_out, catalogue=())
            return merged(found, rest, self.gate.named, self.signs, self.observations)
        found, clipped = self._restored(found)
        self.progress("searching for linear physics beside it")
        found, rest = self._supposing(found, self._rest(found))
        rest = self._confirming(found, rest)
        unsure = self.periodic and found.lying is None and found.misfit > UNSURE
        doubted = _doubted(rest, self.train) if unsure else None
        if doubted is not None and not self.faults:
            self.progress("leaving out a channel that the law does not explain")
            second = self.law(self.engine, doubted=doubted, whole=False)
            if second is not None and second.named and second.misfit < HALF * found.misfit:
                found = second
                rest = self.again(found.linearised, found.linearised_held_out)
        wrong = [Fault(n.term, n.value) for n in rest.named if n.place.kind == "channel"]
        if self.periodic and not self.faults and wrong and not any(f.lost for f in wrong):
            self.train, self.test = ([mended(o, wrong) for o in part] for part in (self.train, self.test))
            second = self.law(self.engine, whole=False)
            if second is not None and second.reason == UNCONFIRMED:
                return None  # the channel made the signs; what is left of them no law explains
            less = second is not None and second.misfit < found.misfit and (bool(second.named) or not found.named)
            if second is not None and (less or (second.named and second.misfit < UNSURE)):
                found = second
        told = any(n.place.kind == "channel" for n in rest.named)
        before = clipped or (() if told or not found.named else self.of_channels)
        before = (*(self.clamps if found.named else ()), *before)
        return merged(found, rest, self.gate.named, self.signs, self.observations, before)

    def _restored(self, found: NonlinearAnswer) -> tuple[NonlinearAnswer, tuple[Named, ...]]:
        """The law with what one channel cuts off put back into its runs, and that channel's rail; what it was where the
        law does not say that any does.
        """
        if not self.periodic or self.gate.named or self.faults or self.nearly:
            return found, ()
        one = overloaded(found, (*self.train, *self.test))
        if one is None:
            return found, ()
        self.progress("searching for the law with what a channel cuts off put back")
        before = self.train, self.test, self.usable
        self.train, self.test, self.usable = ([one.restored(o) for o in part] for part in before)
        second = self.law(self.engine, suspicious=False, whole=False)
        if second is not None and second.named and second.misfit < max(UNSURE, found.misfit):
            return second, (one.named,)
        self.train, self.test, self.usable = before
        return found, (one.named,)

    def _supposing(self, found: NonlinearAnswer, rest: Diagnosis) -> tuple[NonlinearAnswer, Diagnosis]:
        """The law and the linear search beside it, both again with what that search found in the model, where it found
        something that has no name yet; what they were where that does not make a name of it.
        """
        open_ = bool(found.named) and found.lying is None and rest.verdict == "unexplained" and not rest.named
        under = supposed(self.engine, rest) if open_ and not self.faults and not self.nearly else None
        if under is None:
            return found, rest
        self.progress("searching for the law with that in the model")
        before = self.train, self.test, self.usable
        self._mend(under.faults)
        second = self.law(under.engines[0], suspicious=False)
        if second is not None and second.named and second.linearised and second.misfit < SAME * found.misfit:
            if not under.faults:
                again = self._rest(second)
                if again.named:
                    return second, again
            else:
                again = self.again(second.linearised, second.linearised_held_out, beside=True, catalogue=CHANNELS)
                if not again.named and _left(again) < HALF * _left(rest):
                    self.faults, self.of_channels = under.faults, under.named
                    return second, again
        self.train, self.test, self.usable = before
        return found, self._rest(found, supposing=False) if explains(found) else rest

    def _confirming(self, found: NonlinearAnswer, rest: Diagnosis) -> Diagnosis:
        """The linear search beside a law; with the fault of a channel that it finds first but cannot name, where the
        quietest level shows the same.
        """
        open_ = bool(found.named) and rest.verdict == "unexplained" and not (rest.named or self.faults or self.nearly)
        if not open_ or not confirmed(rest, rest):
            return rest
        self.progress("searching for that channel's fault at the quietest level")
        quiet = self.again(quietest_of(self.usable, self.train), depth=1, hint=True)
        named = confirmed(rest, quiet)
        return replace(rest, verdict="measurement-fault", named=named) if named else rest

    def _rest(self, found: NonlinearAnswer, supposing: bool = True) -> Diagnosis:
        """The linear search on the FRFs from which the law's share is taken, as far as it may find anything there.

        `supposing`: whether what it finds, if that has no name yet, is put into the model before anything else.
        """
        sure = bool(found.named) or found.reason in (KNOWN, EQUAL, *FOUND)
        explained = sure and found.misfit < EXPLAINED and found.lying is None
        near = found.misfit < MISFIT and found.lying is None
        hid = found.study.engine is not self.engine  # one mechanism kept the law from being named: that one is sought
        own = sure and not (hid or self.nearly) and found.lying is None  # the search begins with what the law leaves
        last = found.laws[-1].made
        paid = last.prior_part > STRAINED * last.n_base  # the base stands in for something linear
        spent = not explained and own and not paid and hopeless_beside(found, self.scatter, self.limits)
        limits = replace(self.limits, misfit=max(self.limits.misfit, MISFIT))  # the law's own errors are in it too
        kind: dict = {"beside": near, **({"depth": 1} if hid else {})}
        if spent:  # nothing linear explains what is left, but a channel may be wrong beside it
            kind = {"catalogue": CHANNELS, "beside": True}
        if (explained or found.named) and hid:  # what is in the model already has to be found there, and nothing else
            laws = [n.place for n in found.named]
            held = [t.mechanism for t in held_in(found) if not any(same_place(t.place, p) for p in laws)]
            kind |= {"limits": limits, "catalogue": (*held, *CHANNELS)}
        parts = (found.linearised, found.linearised_held_out)
        measured = [[mended(o, self.faults, back=True) for o in part] for part in parts]
        if not explained or hid:
            return self.again(*measured, **kind)
        if supposing:
            # a law and the errors of a sound model may excuse a channel's fault
            rest = self.again(*parts, beside=True, limits=limits, **({} if paid else {"catalogue": CHANNELS}))
            if rest.named or rest.verdict in ("consistent", "parameters"):
                return rest
            if found.named and supposed(self.engine, rest) is not None and not (self.faults or self.nearly):
                return rest
        rest = self.again(*measured, limits=limits)  # the law's errors excused what a channel has wrong
        if not finds_first(rest, self.faults):
            self.of_channels = ()
        return rest


UNSURE, HALF = 1.5, 0.5
"""Chi-square per value that a law leaves above which a channel may lie; part of it to which it must come without it."""
CHANNELS = tuple(m for m in CATALOGUE if m.domain == "channel")
"""Mechanisms that are asked for where a law leaves nothing."""
SAME = 1.1
"""Part of what a law leaves that it may leave where linear physics that it did not know of is in the model."""


def _retraces(second: NonlinearAnswer, found: NonlinearAnswer) -> bool:
    """Whether laws fitted from the nominal base take the place of the same as they were found: they leave clearly less,
    or no more and have their names.
    """
    named = bool(second.named) and not found.named
    return total(second) < (1.0 if named else BETTER) * total(found)


def _left(rest: Diagnosis) -> float:
    """What the structure as it is leaves in a linear search."""
    return float(rest.detail["selection"].chain[0].cost)


def _doubted(rest: Diagnosis, train: Sequence[Observation]) -> int | None:
    """Number of the response at which the linear search finds what has no name."""
    if rest.verdict != "unexplained" or rest.place is None or rest.place.kind != "channel":
        return None
    names = [c.name for c in train[0].frf.outputs]
    return names.index(rest.place.id) if rest.place.id in names else None
