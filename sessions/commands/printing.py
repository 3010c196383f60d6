"""What commands share when they print: notes and progress on standard error, numbers that JSON can hold."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

Progress = Callable[[int, int], None]


def note(text: str) -> None:
    """A line on standard error."""
    sys.stderr.write(f"labnnum: note: {text}\n")


@contextmanager
def bar(what: str) -> Generator[Progress]:
    """A progress bar on standard error, where that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as shown:
        task = shown.add_task(what, total=None)
        yield lambda done, total: shown.update(task, completed=done, total=total)


SPARSE = 5.0
"""s between lines that tell where a command is, at least, where standard error is no terminal."""


@contextmanager
def stages(first: str) -> Generator[Callable[[str], None]]:
    """What a long command is at and since when: beside a spinner on a terminal, else a line on standard error now and
    then, so that a log shows that it goes on.
    """
    import time

    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    began = last = time.monotonic()

    def line(text: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= SPARSE:
            last = now
            sys.stderr.write(f"labnnum: {now - began:.0f} s: {text}\n")
            sys.stderr.flush()

    if not sys.stderr.isatty():
        yield line
        return
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Bar(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(first, total=None)
        yield lambda text: shown.update(task, description=text)


def finite(value: Any) -> Any:
    """`value` with numbers that JSON has no word for (NaN, infinity) as null."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def plural(count: int, word: str) -> str:
    """A count with its word.

    Examples
    --------
    >>> plural(1, "run"), plural(2, "run")
    ('1 run', '2 runs')
    """
    return f"{count} {word}{'' if count == 1 else 's'}"


def table(head: list[str], rows: list[list[str]]) -> str:
    """Rows as aligned text; columns of numbers to the right."""
    if not rows:
        return ""
    widths = [max(len(r[k]) for r in [head, *rows]) for k in range(len(head))]
    numeric = [all(_is_number(r[k]) for r in rows) for k in range(len(head))]
    lines = [
        "  ".join(c.rjust(w) if n else c.ljust(w) for c, w, n in zip(row, widths, numeric, strict=True)).rstrip()
        for row in [head, *rows]
    ]
    return "\n".join(lines)


def _is_number(cell: str) -> bool:
    return cell in ("", "-") or cell.replace(".", "").replace("-", "").replace("+", "").replace("e", "").isdigit()
