"""Nonlinear physics first, then the linear search on what it leaves: one answer from both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.answer import answer, parts_of, promised
from labnnum.diagnosis.nonlinear.beside import Beneath, added_to, beneath, misled, quietest_of, strained
from labnnum.diagnosis.nonlinear.bounds import hopeless, hopeless_beside
from labnnum.diagnosis.nonlinear.decision import (
    EQUAL,
    FOUND,
    KNOWN,
    MISFIT,
    NOTHING,
    UNCONFIRMED,
    USELESS,
    NonlinearAnswer,
)
from labnnum.diagnosis.nonlinear.detect import CHANGE
from labnnum.diagnosis.nonlinear.explore import NOISY
from labnnum.diagnosis.nonlinear.locate import Lead
from labnnum.diagnosis.nonlinear.mended import Fault, mended
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import Places
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Diagnosis, Limits, Named
from labnnum.diagnosis.words import next_experiment, summarise
from labnnum.mechanisms import CATALOGUE
from labnnum.structures.modal import ModalStructure

if TYPE_CHECKING:
    from labnnum.diagnosis.gates import Gate


OWN = Scatter(
    frequency=0.01, damping=1.0, residue=0.2, shape=1e-4, gain=1e-5, phase=1e-5, complexity=1e-5, remainder=1e-3,
    floor=3e-4,
)  # fmt: skip
"""Errors of a model that was identified with the sensors it is judged by."""


NEARLY = 1 / 3
"""Part of the base's held-out error, to which a law must bring it down, for what is left to be no objection where the
base was identified and misses its own data: it has no physics that the law could contradict."""


LEAST = 1e-3
"""What any identified base misses at least, RMS over the lines of a response, relative: errors then weigh as they do in
a simulated response, and not line by line."""


def own_scatter(error: float) -> Scatter:
    """Errors of a model that was identified with the sensors it is judged by, and missed its own data by `error`."""
    return replace(
        OWN, shape=max(OWN.shape, error / 2), remainder=max(OWN.remainder, 2 * error), floor=max(OWN.floor, error / 2)
    )


def nonlinear_first(
    engine: Engine, gate: Gate, observations: Sequence[Observation], held_out: Sequence[Observation], places: Places,
    scatter: Scatter, limits: Limits, span: tuple[float, float] | None,
    again: Callable[..., Diagnosis], progress: Callable[[str], None], known: Sequence[Lead] = (),
) -> Diagnosis | None:  # fmt: skip
    """The whole diagnosis where the runs show nonlinear physics, else None.

    `known` laws are those that the model holds. The linear search (`again`) runs on FRFs from which the law's share is
    taken. Where it names a fault of a channel, that is taken off the spectra and the law is sought once more.
    """
    from labnnum.diagnosis.runs import kept_back, nonlinear_signs

    nearly = 0.0
    if isinstance(engine.structure, ModalStructure):
        scatter = own_scatter(engine.structure.error)
        nearly = NEARLY if engine.structure.error > 0 else 0.0
    usable = gate.usable
    kept = set() if held_out or len(usable) < 2 else kept_back(usable)
    train = [o for i, o in enumerate(usable) if i not in kept]
    test = list(held_out) or [usable[i] for i in sorted(kept)]
    if isinstance(engine.structure, ModalStructure):
        miss = max(engine.structure.error, LEAST)
        train, test = ([_missing(o, miss) for o in part] for part in (train, test))
    band = span or (float(engine.band[0] / 2 / np.pi), float(engine.band[1] / 2 / np.pi))

    def law(
        on: Engine, *, known: Sequence[Lead] = (), doubted: int | None = None, whole: bool = True,
        suspicious: bool = True, strong: bool | None = None,
    ) -> NonlinearAnswer | None:  # fmt: skip
        others = usable if whole else ()
        return answer(
            on, train, test, places, scatter, limits, band, progress, others, known, nearly, doubted, suspicious, strong
        )

    faults: list[Fault] = []
    of_channels: tuple[Named, ...] = ()

    def beside(under: Beneath) -> NonlinearAnswer | None:
        """What the law is with linear physics of the quietest level in the model, and faults of channels off."""
        nonlocal train, test, usable
        before = train, test, usable
        train, test, usable = ([mended(o, under.faults) for o in part] for part in before)
        on = under.engines[0]
        parts = parts_of(engine, train, test, usable, band) if len(under.engines) > 1 else None
        if parts is not None:
            on = min(under.engines, key=lambda e: promised(e, parts, places, scatter, band))
        made = law(on, suspicious=False)
        train, test, usable = before
        return made

    def quiet_search() -> tuple[Diagnosis, Beneath | None]:
        progress("searching for linear physics at the quietest level")
        quiet = again(quietest_of(usable, train), depth=2)
        return quiet, beneath(engine, quiet)

    free = not isinstance(engine.structure, ModalStructure) and not known
    parts = parts_of(engine, train, test, usable, band) if free else None
    early = parts is not None and misled(engine, parts, scatter, band)
    found: NonlinearAnswer | None = None
    under: Beneath | None = None
    second: NonlinearAnswer | None = None
    if early:
        found = law(engine, suspicious=False, strong=True)
    sure = found is not None and _clear(found)
    if early and not sure:
        quiet, under = quiet_search()
        if under is not None:
            second = beside(under)
            if quiet.named and (second is None or second.reason == UNCONFIRMED):
                return None  # with that in the model there is nothing nonlinear
    if not (sure or better(second, NOISY)):
        whole = law(engine, known=known, strong=False if early else None)
        if found is None or (whole is not None and whole.misfit < found.misfit):
            found = whole
        if found is None or found.reason == UNCONFIRMED:
            return None
        if free and not early and not _explained(found):
            under = quiet_search()[1]
            second = beside(under) if under is not None else None
    if under is not None and second is not None and (found is None or _instead(second, found)):
        found, faults, of_channels = second, under.faults, under.named
        train, test, usable = ([mended(o, faults) for o in part] for part in (train, test, usable))
    assert found is not None
    if found.reason == NOTHING and strained(found):
        progress("searching for linear physics that hides the law")
        rest = again(found.linearised, found.linearised_held_out, depth=1)
        wider = added_to(engine, rest)
        if wider is not None:
            second = law(wider)
            if second is not None and second.named and second.misfit < found.misfit:
                found = second
    if not found.named and found.reason != KNOWN and found.reason not in FOUND:
        useless = hopeless(found, observations, scatter, limits)
        plain = again(
            observations, held_out, **({"catalogue": ()} if useless else {})
        )  # what one linear mechanism explains needs no law that has no name
        periodic = all(o.run is not None for o in train)
        small = found.base_error[1] < max(limits.sound, 3 * found.noise)
        sound = plain.verdict in ("consistent", "parameters") and (
            small if found.reason == USELESS else not (periodic or found.gained)
        )
        change = nonlinear_signs(observations)["level_dependence"]
        linear = (
            not found.gained and change is not None and change < CHANGE
        )  # it rings, perhaps, or the shaker distorts
        if not useless and (plain.named or sound or linear):
            return plain
        if not gate.named and (found.misfit > MISFIT or not found.gained):
            # what such a law leaves is no linear structure either, or what there was before
            return merged(found, plain, (), nonlinear_signs(observations), observations)
    if not found.linearised:
        rest = again(observations, held_out, catalogue=())
        return merged(found, rest, gate.named, nonlinear_signs(observations), observations)
    progress("searching for linear physics beside it")
    sure = bool(found.named) or found.reason in (KNOWN, EQUAL, *FOUND)
    explained = sure and found.misfit < EXPLAINED and found.lying is None
    near = found.misfit < MISFIT and found.lying is None
    hid = found.study.engine is not engine  # one mechanism kept the law from being named: that one is sought
    own = sure and not (hid or nearly) and found.lying is None  # the search begins with what the law leaves
    spent = not explained and own and hopeless_beside(found, scatter, limits)
    kind: dict = {"catalogue": ()} if spent else {"beside": near, **({"depth": 1} if hid else {})}
    if explained:  # a law and the errors of a sound model may excuse a channel's fault
        kind = {"beside": True, "catalogue": CHANNELS}
    measured = [[mended(o, faults, back=True) for o in p] for p in (found.linearised, found.linearised_held_out)]
    rest = again(*((found.linearised, found.linearised_held_out) if explained else measured), **kind)
    if explained and not rest.named and rest.verdict not in ("consistent", "parameters"):
        rest, of_channels = again(*measured), ()  # the law's errors excused what a channel has wrong
    periodic = all(o.run is not None for o in train)
    doubted = _doubted(rest, train) if periodic and found.lying is None and found.misfit > 1.5 else None
    if doubted is not None and not faults:
        progress("leaving out a channel that the law does not explain")
        second = law(engine, doubted=doubted, whole=False)
        if second is not None and second.named and second.misfit < 0.5 * found.misfit:
            found = second
            rest = again(found.linearised, found.linearised_held_out)
    if periodic and not faults and any(n.place.kind == "channel" for n in rest.named):
        wrong = [Fault(n.term, n.value) for n in rest.named if n.place.kind == "channel"]
        train, test = ([mended(o, wrong) for o in part] for part in (train, test))
        second = law(engine, whole=False)
        if second is not None and second.reason == UNCONFIRMED:
            return None  # the channel made the signs; what is left of them no law explains
        less = second is not None and second.misfit < found.misfit and (bool(second.named) or not found.named)
        if second is not None and (less or (second.named and second.misfit < 1.5)):
            found = second
    signs = nonlinear_signs(observations)
    told = any(n.place.kind == "channel" for n in rest.named)
    return merged(found, rest, gate.named, signs, observations, () if told or not found.named else of_channels)


CHANNELS = tuple(m for m in CATALOGUE if m.domain == "channel")
"""Mechanisms that are asked for where a law leaves nothing."""
BETTER, NEARER = 0.8, 0.5
"""Part of what a law leaves to which it must bring it where linear physics was put beside it; and the part of that
which one without a name may leave."""


def better(second: NonlinearAnswer | None, most: float) -> bool:
    """Whether a law beside linear physics leaves less than `most` a value; one without a name, a part of that."""
    return second is not None and second.gained and second.misfit < (most if second.named else NEARER * most)


def _instead(second: NonlinearAnswer, found: NonlinearAnswer) -> bool:
    """Whether a law beside linear physics takes the place of one without; none without a name of one that has one."""
    return bool(second.named or not found.named) and better(second, BETTER * found.misfit)


CLEAR = 0.01
"""Part of what the base leaves below which a strong law was found, though it leaves more than noise."""


def _clear(found: NonlinearAnswer) -> bool:
    """Whether a strong law was found, which the quietest level can tell nothing about."""
    base = found.study.base.data_part / found.study.base.count
    return bool(found.named) and found.lying is None and found.misfit < max(MISFIT, CLEAR * base)


def _explained(found: NonlinearAnswer) -> bool:
    """Whether a law is named that leaves nothing for anything else."""
    return bool(found.named) and found.misfit < EXPLAINED and found.lying is None


def _doubted(rest: Diagnosis, train: Sequence[Observation]) -> int | None:
    """Number of the response at which the linear search finds what has no name."""
    if rest.verdict != "unexplained" or rest.place is None or rest.place.kind != "channel":
        return None
    names = [c.name for c in train[0].frf.outputs]
    return names.index(rest.place.id) if rest.place.id in names else None


def _missing(o: Observation, error: float) -> Observation:
    """The observation with what an identified base is known to miss."""
    return o if o.run is None else replace(o, run=replace(o.run, miss=error))


EXPLAINED = 1.2
"""Chi-square per value below which a law and the ordinary errors leave nothing for the linear search."""


def merged(
    found: NonlinearAnswer, rest: Diagnosis, gated: Sequence[Named], signs: dict, observations: Sequence[Observation],
    before: Sequence[Named] = (),
) -> Diagnosis:  # fmt: skip
    """One diagnosis: what the gates found, the nonlinear law, what was named `before` it, then what the linear search
    names beside it.
    """
    beside = rest.named if found.named and rest.verdict in ("missing-physics", "measurement-fault") else ()
    if found.misfit > MISFIT:  # what a law leaves at its own place is its own
        own = {(n.place.id, n.place.to) for n in found.named}
        beside = tuple(n for n in beside if (n.place.id, n.place.to) not in own)
    named = (*gated, *found.named, *before, *beside)
    verdict = "missing-physics" if found.named else "unexplained"
    if not found.named and rest.verdict == "measurement-fault":
        verdict, named = "measurement-fault", (*gated, *rest.named)
    if found.reason == KNOWN:
        verdict, named, beside = rest.verdict, (*gated, *rest.named), rest.named
    if gated:
        verdict = "measurement-fault" if named[0].term.mechanism.domain == "channel" else "missing-physics"
    place = named[0].place if gated or named else rest.place if found.reason == KNOWN else found.place
    detail = {**rest.detail, "nonlinear": found, "reason": found.reason}
    nonlinear = {**signs, "levels": [float(o.level) for o in observations]}
    source = rest if verdict == "measurement-fault" and not found.named else found
    shown = replace(
        rest, verdict=verdict, named=named if verdict != "unexplained" else (), place=place,
        alternatives=source.alternatives, located=source.located, base_error=source.base_error,
        extended_error=source.extended_error, nonlinear=nonlinear, detail=detail,
    )  # fmt: skip
    return replace(shown, next_experiment=next_experiment(shown, observations), summary=summarise(shown))
