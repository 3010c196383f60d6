"""Compiled functions on disk that are older than what they call.

numba keeps machine code beside the source and compiles again when the function's own file has changed. Code of
functions of other files that it calls is part of it, and a change in those goes unseen.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any


def up_to_date(function: Any) -> Any:
    """A function that numba compiled; its machine code on disk, and that of all compiled functions that it calls, is
    deleted where a file that the code draws on is newer.

    To be applied before the first call, above `numba.njit(cache=True)`.
    """
    if not hasattr(function, "py_func"):  # compiling is switched off
        return function
    for one in _reached(function):
        newest = max(_source(f).stat().st_mtime_ns for f in _reached(one))
        for index in Path(one.stats.cache_path).glob(f"{_source(one).stem}.{one.py_func.__qualname__}-*.nbi"):
            with suppress(OSError):  # another process was faster, or may not write here: then numba cannot either
                if index.stat().st_mtime_ns < newest:
                    index.unlink()
    return function


def _source(function: Any) -> Path:
    return Path(function.py_func.__code__.co_filename)


def _reached(function: Any) -> set[Any]:
    """A compiled function and all compiled ones that it calls, directly or not."""
    seen, todo = {function}, [function]
    while todo:
        here = todo.pop().py_func
        named = (here.__globals__.get(name) for name in here.__code__.co_names)
        fresh = {f for f in named if hasattr(f, "py_func")} - seen
        seen |= fresh
        todo += fresh
    return seen
