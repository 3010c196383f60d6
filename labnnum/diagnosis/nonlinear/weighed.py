"""What the answer of a search for laws is worth: whether it explains, what it holds, and at what price."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.beside import strained
from labnnum.diagnosis.nonlinear.decision import BENT, BOUGHT, EQUAL, FOUND, MISFIT, NOTHING, USELESS, NonlinearAnswer
from labnnum.diagnosis.nonlinear.explore import STRAINED
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.verdict import Diagnosis
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.extended import ExtendedStructure

BETTER, NEARER = 0.8, 0.5
"""Part of what a law leaves to which it must bring it where linear physics was put beside it; and the part of that
which one without a name may leave."""
CLEAR = 0.01
"""Part of what the base leaves below which a strong law was found, though it leaves more than noise."""
EXPLAINED = 1.2
"""Chi-square per value below which a law and the ordinary errors leave nothing for the linear search."""


def bought(found: NonlinearAnswer) -> bool:
    """Whether laws, named or not, leave too much and explain the rest at the base's expense."""
    much = bool(found.named) and found.misfit > MISFIT
    return (found.reason in (NOTHING, BOUGHT) or much) and strained(found)


def certain(found: NonlinearAnswer) -> bool:
    """Whether nonlinear physics acts that has no name, or more than one: no linear mechanism stands in for it."""
    base = found.study.base.data_part / found.study.base.count
    return found.reason in FOUND or (found.reason == EQUAL and found.misfit < CLEAR * base)


def better(second: NonlinearAnswer | None, most: float) -> bool:
    """Whether a law beside linear physics leaves less than `most` a value; one without a name, a part of that."""
    return second is not None and second.gained and second.misfit < (most if second.named else NEARER * most)


def instead(second: NonlinearAnswer, found: NonlinearAnswer) -> bool:
    """Whether a law beside linear physics takes the place of one without; none without a name of one that has one."""
    names = bool(second.named) and not found.named and second.misfit < found.misfit
    return names or (bool(second.named or not found.named) and better(second, BETTER * found.misfit))


def clear(found: NonlinearAnswer, plain: float = np.inf) -> bool:
    """Whether a strong law was found, which the quietest level can tell nothing about: one that is named, that still
    needs something linear beside it to be, or that leaves little and has no name.

    `plain`: chi-square per value that another structure leaves by itself, if the law need be clear of that too.
    """
    base = min(found.study.base.data_part / found.study.base.count, plain)
    last = found.laws[-1].made
    sure = bool(found.named) or (found.reason in (NOTHING, BOUGHT) and strained(found))
    nameless = found.reason in FOUND and last.prior_part < BENT * last.n_base
    most = max(MISFIT, CLEAR * base) if sure else MISFIT
    return (sure or nameless) and found.lying is None and found.misfit < most


def idle(second: NonlinearAnswer) -> bool:
    """Whether a law beside linear physics helps to predict nothing, and the base there leaves little for one."""
    base = second.study.base
    return second.reason == USELESS and base.data_part < MISFIT * base.count


def held_in(found: NonlinearAnswer) -> list[Term]:
    """The mechanisms in the structure on which a law was found."""
    return held_of(found.study.engine)


def held_of(engine: Engine) -> list[Term]:
    """The mechanisms in an engine's structure."""
    structure = engine.structure
    return [a.term for a in structure.added] if isinstance(structure, ExtendedStructure) else []


def twice(found: NonlinearAnswer | None) -> bool:
    """Whether a law acts where its structure holds a mechanism already, which may be the law as the quietest level sees
    it: a slider that sticks is a spring.
    """
    return found is not None and any(same_place(t.place, n.place) for t in held_in(found) for n in found.named)


def dear(second: NonlinearAnswer) -> bool:
    """Whether a law stands beside something linear and the base pays more than a sound one all the same."""
    last = second.laws[-1].made
    return bool(held_in(second)) and (not second.named or last.prior_part > STRAINED * last.n_base)


def total(found: NonlinearAnswer) -> float:
    """What a law leaves and costs, a value."""
    last = found.laws[-1].made
    return last.objective / last.count


def same_place(a: Place, b: Place) -> bool:
    """Whether two places are one, an element and the joint in it being the same."""
    return {a.id, a.to} == {b.id, b.to}


def explains(found: NonlinearAnswer) -> bool:
    """Whether a law is named that leaves nothing for anything else."""
    return bool(found.named) and found.misfit < EXPLAINED and found.lying is None


def retraces(second: NonlinearAnswer, found: NonlinearAnswer) -> bool:
    """Whether laws fitted from the nominal base take the place of the same as they were found: they leave clearly less,
    or no more and have their names.
    """
    named = bool(second.named) and not found.named
    return total(second) < (1.0 if named else BETTER) * total(found)


def left(rest: Diagnosis) -> float:
    """What the structure as it is leaves in a linear search."""
    return float(rest.detail["selection"].chain[0].cost)


def doubted_by(rest: Diagnosis, train: Sequence[Observation]) -> int | None:
    """Number of the response at which the linear search finds what has no name."""
    if rest.verdict != "unexplained" or rest.place is None or rest.place.kind != "channel":
        return None
    names = [c.name for c in train[0].frf.outputs]
    return names.index(rest.place.id) if rest.place.id in names else None
