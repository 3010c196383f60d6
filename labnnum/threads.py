"""Independent pieces of one computation at a time on several cores, with the same result to the bit on any number.

The pieces must leave the interpreter for most of their time (compiled loops that let it go, transforms, products of
matrices), or threads give nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from threading import Lock, local
from typing import TypeVar

VARIABLE = "LABNNUM_THREADS"
"""Environment variable with the number of threads; one for each core that the process may use if it is unset."""
Item = TypeVar("Item")
Result = TypeVar("Result")

_lock = Lock()
_pool: ThreadPoolExecutor | None = None
_inside = local()


def threads() -> int:
    """How many pieces are computed at a time."""
    asked = os.environ.get(VARIABLE, "")
    if asked.isdecimal() and int(asked) > 0:
        return int(asked)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def each(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`work` of every item, in their order.

    All are computed, whether one raises or not, so that what is counted meanwhile does not depend on the number of
    threads; the first error in the order of the items is raised then. Pieces within pieces run one after the other.
    """
    if len(items) < 2 or threads() < 2 or getattr(_inside, "a_piece", False):
        done: list[Result | Exception] = [_tried(work, item) for item in items]
    else:
        pool = _made()
        asked = [pool.submit(copy_context().run, _piece, work, item) for item in items]
        done = [future.result() for future in asked]
    return [_told(one) for one in done]  # ty: ignore[invalid-explicit-return]


def _made() -> ThreadPoolExecutor:
    global _pool
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(threads(), thread_name_prefix="labnnum")
        return _pool


def _piece(work: Callable[[Item], Result], item: Item) -> Result | Exception:
    _inside.a_piece = True
    return _tried(work, item)


def _tried(work: Callable[[Item], Result], item: Item) -> Result | Exception:
    try:
        return work(item)
    except Exception as error:
        return error


def _told(one: Result | Exception) -> Result:
    if isinstance(one, Exception):
        raise one
    return one
