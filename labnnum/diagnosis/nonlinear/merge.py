"""One diagnosis from a nonlinear law and what the linear search names beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from labnnum.diagnosis.decide import told_at_all
from labnnum.diagnosis.nonlinear.decision import KNOWN, MISFIT, NonlinearAnswer, strays
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.verdict import Diagnosis, Named
from labnnum.diagnosis.words import next_experiment, summarise
from labnnum.structures.modal import ModalStructure

PART, NOISY = 1 / 3, 3.0
"""Part of the base's held-out error, and times the noise of these data, above both of which what is named leaves too
much to be what acts there, or all of it."""
HALFWAY = "the best nonlinear law leaves too much of what is missing on data held out"
"""The reason then, where nothing else was found that may be what is left."""


def merged(
    found: NonlinearAnswer, rest: Diagnosis, gated: Sequence[Named], signs: dict, observations: Sequence[Observation],
    before: Sequence[Named] = (),
) -> Diagnosis:  # fmt: skip
    """One diagnosis: what the gates found, the nonlinear law, what was named `before` it, then what the linear search
    names beside it.
    """
    if _halfway(found) and not (gated or before or any(told_at_all(n) for n in rest.named)):
        place = found.located[0][0] if found.located else found.place
        found = replace(found, named=(), reason=HALFWAY, place=place, extended_error=found.base_error)
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
    noise = rest.noise_floor if source is rest else found.noise  # of the same errors: FRFs hold the distortion as well
    shown = replace(
        rest, noise_floor=noise, verdict=verdict, named=named if verdict != "unexplained" else (), place=place,
        alternatives=source.alternatives, located=source.located, base_error=source.base_error,
        extended_error=source.extended_error, nonlinear=nonlinear, detail=detail,
    )  # fmt: skip
    return replace(shown, next_experiment=next_experiment(shown, observations), summary=summarise(shown, observations))


def _halfway(found: NonlinearAnswer) -> bool:
    """Whether named laws leave far more than noise of data held out and a good part of what the base leaves; one that
    was identified misses data by itself. Where the model strays into another steady state, the motion that was measured
    tells what the laws leave.
    """
    left = found.shown if strays(found) else found.extended_error[1]
    far = left > max(PART * found.base_error[1], NOISY * found.noise)
    return bool(found.named) and far and not isinstance(found.study.engine.structure, ModalStructure)
