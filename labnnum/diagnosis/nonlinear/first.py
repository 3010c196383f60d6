"""Nonlinear physics first, then the linear search on what it leaves: one answer from both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.beside import (
    Beneath,
    added_to,
    confirmed,
    finds_first,
    quietest_of,
    supposed,
)
from labnnum.diagnosis.nonlinear.bounds import hopeless, hopeless_beside
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
from labnnum.diagnosis.nonlinear.effort import counted, exhausted
from labnnum.diagnosis.nonlinear.explore import STRAINED
from labnnum.diagnosis.nonlinear.identified import LEAST, NEARLY, missing, own_scatter, settled
from labnnum.diagnosis.nonlinear.locate import Lead
from labnnum.diagnosis.nonlinear.matched import matched, within
from labnnum.diagnosis.nonlinear.mended import Fault, mended
from labnnum.diagnosis.nonlinear.merge import merged
from labnnum.diagnosis.nonlinear.overloaded import overloaded
from labnnum.diagnosis.nonlinear.weighed import (
    EXPLAINED,
    certain,
    doubted_by,
    explains,
    held_in,
    left,
    same_place,
)
from labnnum.diagnosis.nonlinear.whole import Whole
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Diagnosis, Limits, Named
from labnnum.identification import IDENTIFIED
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
    if span is not None and not isinstance(engine.structure, ModalStructure):  # its band is what one level showed
        usable, held_out = ([within(o, span) for o in some] for some in (usable, held_out))
    held_out = [same for o in held_out if (same := matched(o, usable[0])) is not None]
    kept = set() if held_out else kept_from_law(usable)
    train = [o for i, o in enumerate(usable) if i not in kept]
    test = list(held_out) or [usable[i] for i in sorted(kept)]
    nearly = 0.0
    if isinstance(engine.structure, ModalStructure):
        scatter = own_scatter(engine.structure.error)
        nearly = NEARLY if engine.structure.error > IDENTIFIED else 0.0
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
        found = whole.unhidden(whole.from_below(found))
        if not found.named and found.reason != KNOWN and not certain(found):
            linear = whole.nameless(found)
            if linear is not None:
                return linear
        return whole.beside(found)


@dataclass
class _Whole(Whole):
    """The same with linear physics instead of the law and beside it."""

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
        moved = settled(self.engine, found.laws[-1].made) if self.nearly and found.named else None
        self.again = self.again if moved is None else partial(self.again, on=moved)
        found, rest = self._supposing(found, self._rest(found))
        rest = self._confirming(found, rest)
        found, rest = self._alone(found, rest)
        unsure = self.periodic and found.lying is None and found.misfit > UNSURE
        doubted = doubted_by(rest, self.train) if unsure else None
        if doubted is not None and not (self.faults or exhausted()):
            self.progress("leaving out a channel that the law does not explain")
            second = self.law(self.engine, doubted=doubted, whole=False)
            n = len(self.train[0].frf.outputs)  # the one left out leaves nothing, and counts
            if second is not None and second.named and second.misfit * n / (n - 1) < HALF * found.misfit:
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
        if under is None or exhausted():
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
                if not again.named and left(again) < HALF * left(rest):
                    self.faults, self.of_channels = under.faults, under.named
                    return second, again
        self.train, self.test, self.usable = before
        return found, self._rest(found, supposing=False) if explains(found) else rest

    def _alone(self, found: NonlinearAnswer, rest: Diagnosis) -> tuple[NonlinearAnswer, Diagnosis]:
        """A slider and the linear search beside it, in the stead of a law that yields and of a spring beside it; what
        they were where a slider alone does not do better.
        """
        plain = found.study.engine is self.engine and found.lying is None and not (self.faults or exhausted())
        wide = added_to(self.engine, rest) if plain and rest.named else None
        one = self._one_for_two(found, Beneath([wide], [], ())) if wide is not None else None
        return (found, rest) if one is None or not one.linearised else (one, self._rest(one))

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
