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
