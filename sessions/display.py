"""Displays: where a plan shows what it holds, and where the person's keys come from."""

from __future__ import annotations

import contextlib
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib import import_module
from types import TracebackType
from typing import Any, Self, final

from sessions.snapshot import Snapshot


class Display(ABC):
    """Shows snapshots and hands over commands: "accept N", "reject N", "undo", "next", "stop"."""

    interval = 0.1
    """s between snapshots at least; building one costs time."""

    def __init__(self) -> None:
        self._due = 0.0
        self.urgent: Callable[[], None] = lambda: None
        """Called at once, from whatever thread, when the person says "stop": it switches the generator off.

        It is that of the run that goes on, and does nothing between two runs.
        """

    def wants(self) -> bool:
        """Whether a snapshot is due."""
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = now + self.interval
        return True

    @abstractmethod
    def show(self, snapshot: Snapshot) -> None:
        """Draw, or keep for whoever draws; never waits."""

    def commands(self) -> list[str]:
        """What the person asked for since the last call."""
        return []

    def end(self, why: str, failed: bool = False) -> None:
        """The measurement is over, as asked for or not, and why."""
        return None

    def close(self) -> None:
        """No more snapshots."""
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@final
class Quiet(Display):
    """Shows nothing and asks nothing; keeps the last snapshot, and gives prepared commands."""

    def __init__(self, commands: list[tuple[int, str]] | None = None) -> None:
        super().__init__()
        self._prepared = sorted(commands or [])
        self.last: Snapshot | None = None
        self._hits = 0

    def wants(self) -> bool:
        """Always, if there are commands to give."""
        return bool(self._prepared) or super().wants()

    def show(self, snapshot: Snapshot) -> None:
        """Keep."""
        self.last = snapshot
        self._hits = len(snapshot.hits)

    def commands(self) -> list[str]:
        """Those prepared for the number of hits seen."""
        due = [c for n, c in self._prepared if n <= self._hits]
        self._prepared = [(n, c) for n, c in self._prepared if n > self._hits]
        return due


@final
class Text(Display):
    """The same in text on the terminal (standard error), redrawn in place; single keys are commands."""

    interval = 0.2

    def __init__(self) -> None:
        super().__init__()
        from rich.console import Console
        from rich.live import Live

        self._keys = Keys()
        self._heard = 0
        self._live = Live(console=Console(file=sys.stderr), refresh_per_second=8, transient=False)
        self._live.start()

    def commands(self) -> list[str]:
        """What the keys that were pressed mean."""
        return [COMMANDS[key] for key in self._keys.pressed() if key in COMMANDS]

    def show(self, snapshot: Snapshot) -> None:
        """Redraw."""
        from sessions.text import render

        if len(snapshot.hits) > self._heard and not snapshot.hits[-1].accepted:
            self._live.console.bell()  # eyes and hands are with the hammer
        self._heard = len(snapshot.hits)
        self._live.update(render(snapshot))

    def close(self) -> None:
        """Leave the last picture standing."""
        self._live.stop()
        self._keys.close()


COMMANDS = {"a": "accept", "r": "reject", "u": "undo", "n": "next", " ": "next", "q": "stop"}
"""What a key means."""
FUNCTION_KEYS = "\x00\xe0"
"""What the Windows console puts before the code of an arrow or function key."""


@final
class Keys:
    """Single keys from the terminal or the Windows console, without waiting; none where input comes from elsewhere."""

    def __init__(self) -> None:
        self._saved: Any = None
        self._console: Any = None
        try:
            if not sys.stdin.isatty():
                return
        except (AttributeError, ValueError):  # no standard input at all, or one that is closed
            return
        try:
            import termios
            import tty
        except ImportError:
            self._console = import_module("msvcrt")  # Windows
            return
        with contextlib.suppress(OSError, ValueError, termios.error):  # an input that only looks like a terminal
            self._saved = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)

    def pressed(self) -> list[str]:
        """Keys since the last call."""
        if self._console is not None:
            return self._from_console()
        if self._saved is None:
            return []
        import os
        import select

        out = ""
        while select.select([sys.stdin], [], [], 0)[0]:
            got = os.read(sys.stdin.fileno(), 64)
            if not got:
                break
            out += got.decode(errors="ignore")
        return list(out)

    def _from_console(self) -> list[str]:
        out = []
        while self._console.kbhit():
            key = self._console.getwch()
            if key in FUNCTION_KEYS:
                self._console.getwch()
            else:
                out.append(key)
        return out

    def close(self) -> None:
        """Give the terminal back as it was."""
        if self._saved is not None:
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._saved)
            self._saved = None
