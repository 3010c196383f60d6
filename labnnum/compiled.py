"""Compiled functions on disk that are older than what they call.

numba keeps machine code beside the source and compiles again when the function's own file has changed. Code of
functions of other files that it calls is part of it, and a change in those goes unseen.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any


def up_to_date(function: Any) -> Any:
    """A function that numba compiled, its machine code on disk deleted where a file that it draws on is newer.

    To be applied before the first call, above `numba.njit(cache=True)`.
    """
    if not hasattr(function, "py_func"):  # compiling is switched off
        return function
    newest = max(path.stat().st_mtime_ns for path in _sources(function))
    own = function.py_func
    stem = Path(own.__code__.co_filename).stem
    for index in Path(function.stats.cache_path).glob(f"{stem}.{own.__qualname__}-*.nbi"):
        with suppress(OSError):  # another process was faster, or may not write here: then numba cannot either
            if index.stat().st_mtime_ns < newest:
                index.unlink()
    return function


def _sources(function: Any) -> set[Path]:
    """Files of a compiled function and of all compiled ones that it calls."""
    seen, todo = {function.py_func}, [function.py_func]
    while todo:
        here = todo.pop()
        named = (here.__globals__.get(name) for name in here.__code__.co_names)
        fresh = {f.py_func for f in named if hasattr(f, "py_func")} - seen
        seen |= fresh
        todo += fresh
    return {Path(f.__code__.co_filename) for f in seen}
