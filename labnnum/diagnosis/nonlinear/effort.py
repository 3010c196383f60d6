"""How much one diagnosis has marched, in nominal seconds: the same on every machine, so that what a search leaves out
when it has taken long does not depend on how fast it ran.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from threading import Lock

_spent: ContextVar[list[int] | None] = ContextVar("spent", default=None)
_adding = Lock()
UNIT = 1e-10
"""Nominal seconds that are counted as one: whole numbers add up to the same in any order, whatever the threads do."""
STEP, TANGENT = 2000, 6
"""Units of a step of the march for each pair of forces, and of one mode's tangent for each force."""


LONG = 30.0
"""Nominal seconds of one diagnosis after which only what was found is carried on: no more pairs, no more suspects."""
LAST = 45.0
"""The same after which the rivals of several laws are not asked beside the others either."""
ONCE = 8.0
"""Nominal seconds of one diagnosis after which laws are not simulated once more from far away."""
TWO = 10.0
"""The same of one search for two laws at once."""


@contextmanager
def counted() -> Generator[None]:
    """Counts from nothing while it lasts."""
    token = _spent.set([0])
    try:
        yield
    finally:
        _spent.reset(token)


def marched(steps: int, modes: int, forces: int, tangents: int) -> None:
    """One more march."""
    total = _spent.get()
    if total is not None:
        with _adding:
            total[0] += steps * forces * (STEP * forces + TANGENT * modes * tangents)


def tired() -> bool:
    """Whether a diagnosis has taken so long that nothing more is sought."""
    return spent() > LONG


def spent() -> float:
    """Nominal seconds so far; 0 where nothing is counted."""
    total = _spent.get()
    return 0.0 if total is None else UNIT * total[0]
