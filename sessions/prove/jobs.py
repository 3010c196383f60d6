"""Many independent computations: one after the other here, or several at a time in processes of this machine."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TypeVar

LIBRARIES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
THREAD_SETTINGS = (*LIBRARIES, "LABNNUM_THREADS")
"""Variables of the environment that say how many threads a process takes; that of `labnnum.threads` is written out,
since what draws the truth imports nothing of the tool."""
Item = TypeVar("Item")
Result = TypeVar("Result")


def each(function: Callable[[Item], Result], items: Sequence[Item], jobs: int = 1) -> Iterator[tuple[Item, Result]]:
    """Every item with its result, as they become ready; leaving the loop drops what has not begun.

    Parameters
    ----------
    function : callable
        Must be importable (no lambda, no closure) where `jobs` is above 1.
    items : sequence
    jobs : int
        Processes. 1 computes here.
    """
    if jobs == 1 or len(items) < 2:
        for item in items:
            yield item, function(item)
        return
    for name in THREAD_SETTINGS:
        os.environ.setdefault(name, "1")
    pool = ProcessPoolExecutor(min(jobs, len(items)), mp_context=get_context("spawn"), initializer=_go_with_parent)
    try:
        asked: dict[Future[Result], Item] = {pool.submit(function, item): item for item in items}
        waiting = set(asked)
        while waiting:
            ready, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ready:
                yield asked[future], future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _go_with_parent() -> None:
    """End this process when the one that started it is gone, however that ended: its queue would wait for ever."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()
