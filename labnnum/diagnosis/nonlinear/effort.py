"""How much one diagnosis has marched, in nominal seconds: the same on every machine, so that what a search leaves out
when it has taken long does not depend on how fast it ran.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Lock

_spent: ContextVar[list[int] | None] = ContextVar("spent", default=None)
_whole: ContextVar[list[int] | None] = ContextVar("whole", default=None)
_adding = Lock()
UNIT = 1e-10
"""Nominal seconds that are counted as one: whole numbers add up to the same in any order, whatever the threads do."""
STEP, TANGENT, TRANSFORM = 2000, 6, 100
"""Units of a step of the march for each pair of forces, of one mode's tangent for each force, and of a sample of a
tangent that is transformed to lines or from them.
"""


LONG = 30.0
"""Nominal seconds of one diagnosis after which only what was found is carried on: no more pairs, no more suspects."""
LAST = 45.0
"""The same after which the rivals of several laws are not asked beside the others either."""
ONCE = 8.0
"""Nominal seconds of one diagnosis after which laws are not simulated once more from far away."""
TWO = 10.0
"""The same of one search for two laws at once."""
WHOLE = 45.0
"""The same of all searches of one diagnosis, those that count anew included: what was found by then is the answer, and
what would only ask whether another structure, level or channel does better is not begun."""


@contextmanager
def counted() -> Generator[None]:
    """Counts from nothing while it lasts; within another count, what it counts is that one's whole effort too."""
    token = _spent.set([0])
    outer = None if _whole.get() is not None else _whole.set([0])
    try:
        yield
    finally:
        _spent.reset(token)
        if outer is not None:
            _whole.reset(outer)


def marched(steps: int, modes: int, forces: int, tangents: int) -> None:
    """One more march."""
    _add(steps * forces * (STEP * forces + TANGENT * modes * tangents), _spent, _whole)


def transformed(samples: int, rows: int) -> None:
    """The tangents of a march, to lines or from them: the whole diagnosis counts that too, since of long records it is
    most of the time.
    """
    _add(TRANSFORM * samples * rows, _whole)


def _add(units: int, *counts: ContextVar[list[int] | None]) -> None:
    with _adding:
        for count in counts:
            total = count.get()
            if total is not None:
                total[0] += units


def tired() -> bool:
    """Whether a search has taken so long that nothing more is sought."""
    return spent() > LONG


def weary() -> bool:
    """Whether it has taken so long that rivals are not asked either."""
    return spent() > LAST


def exhausted() -> bool:
    """Whether all searches of a diagnosis have taken so long that no other is begun."""
    return _seconds(_whole) > WHOLE


def spent() -> float:
    """Nominal seconds so far; 0 where nothing is counted."""
    return _seconds(_spent)


def _seconds(count: ContextVar[list[int] | None]) -> float:
    total = count.get()
    return 0.0 if total is None else UNIT * total[0]
