"""Desk: what one run of an item has in hand, and the snapshots that are made of it."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from drivers.exciter import Exciter
from labnnum.errors import InputError, SafetyError
from sessions.display import Display
from sessions.guard import Guard
from sessions.items import Item
from sessions.recorder import Recorder, Stored, Tail
from sessions.rig import Rig
from sessions.runs import Run
from sessions.snapshot import POINTS, Curves, HitLine, Progress, Snapshot, scope_view

LIT = 3.0
"""s for which an overload lamp says "now"."""


class UserStopError(SafetyError):
    """The person asked for the end; the output has been switched off."""


def shown(estimate: Callable[[], Curves | None]) -> Curves | None:
    """What there is to draw; nothing where the data give no estimate (yet): what is only shown ends no measurement."""
    try:
        return estimate()
    except (InputError, np.linalg.LinAlgError):
        return None


@dataclass(eq=False)
class Status:
    """What a display is told besides the signals."""

    state: str = ""
    volts: float = float("nan")
    level: float = float("nan")
    target: float = float("nan")
    level_unit: str = ""
    curves: Callable[[], Curves | None] = lambda: None
    hit: NDArray[np.float64] | None = None
    hits: tuple[HitLine, ...] = ()
    messages: list[str] = field(default_factory=list)
    waiting: bool = False


@final
class Desk:
    """Blocks in SI units, one after the other, after they were guarded and stored.

    Parameters
    ----------
    rig : Rig
    item : Item
    run : Run
        Of a session that is open for writing.
    recorder : Recorder
    guard : Guard
    display : Display
    exciter : Exciter or None
    progress : sequence of Progress
        Of the whole plan; the item's own is kept up by `done`.
    keep : int
        Samples that can be looked back at.
    """

    def __init__(
        self,
        rig: Rig,
        item: Item,
        run: Run,
        recorder: Recorder,
        guard: Guard,
        display: Display,
        exciter: Exciter | None,
        progress: Sequence[Progress],
        keep: int = POINTS,
    ) -> None:
        self.rig, self.item, self.run, self.recorder = rig, item, run, recorder
        self.guard, self.display, self.exciter = guard, display, exciter
        self.status = Status()
        self.commands: list[str] = []
        self.halted = False
        """The person asked for the end, or nothing is recorded any more: nothing is switched on."""
        recorder.silence = self.halt
        self.position = 0
        self.tail = Tail(len(item.stored), max(keep, POINTS))
        self._progress = [replace(p, current=p.key == item.key) for p in progress]
        self._frame = 0

    def blocks(self) -> Iterator[tuple[Stored, NDArray[np.float64]]]:
        """Stored blocks with their samples in SI units; the display is served and heard in between."""
        for one in self.recorder:
            si = np.array([s.to_si(row) for s, row in zip(self.item.stored, one.block.data, strict=True)])
            self.tail.add(one.at, si)
            self.position = one.at + si.shape[1]
            self._frame = one.block.start
            yield one, si
            self.listen()
            if self.display.wants():
                self.display.show(self.snapshot())

    def listen(self) -> None:
        """Take the person's commands; "stop" ends the run, output first."""
        new = self.display.commands()
        if "stop" in new:
            self.commands += new[: new.index("stop")]
            self.halt()
            raise UserStopError("stopped by the user")
        self.commands += new

    @contextmanager
    def exciting(self) -> Generator[None]:
        """While it lasts, "stop" switches off from whatever thread; one that was said before ends the run here."""
        before, self.display.urgent = self.display.urgent, self.halt
        try:
            self.listen()
            yield
        finally:
            self.display.urgent = before

    def halt(self) -> None:
        """Switch the generator off, for good."""
        self.halted = True
        self.off()

    def off(self) -> None:
        """Switch the generator off."""
        if self.exciter is not None:
            self.exciter.off()

    def done(self, done: int, total: int) -> None:
        """How far the item is."""
        where = self.item.number
        self._progress[where] = Progress(self.item.key, done, total, True)

    def snapshot(self, **changes: Any) -> Snapshot:
        """What there is now."""
        s, e = self.status, self.rig.toml.excitation
        lit, since = self.guard.overloaded_at, self._frame - LIT * self.rig.rate
        view: dict[str, Any] = scope_view(self.item.channels, self.rig.rate, self.tail.latest(POINTS))
        return Snapshot(
            s.state,
            **view,
            curves=shown(s.curves),
            hit=s.hit,
            hits=s.hits,
            progress=tuple(self._progress),
            overload=tuple(bool(o) for o in self.guard.overloaded),
            over_now=tuple(bool(at >= max(since, 0)) for at in lit),
            band=(e.low, e.high) if e.high else None,
            time=self._frame / self.rig.rate,
            lost=self.recorder.lost,
            overflows=self.recorder.overflows,
            volts=s.volts,
            level=s.level,
            target=s.target,
            level_unit=s.level_unit,
            messages=(*self.guard.warnings[-4:], *s.messages[-6:]),
            waiting=s.waiting,
            judged=self.item.kind == "hammer",
            **changes,
        )

    def say(self, text: str) -> None:
        """A line for the person."""
        self.status.messages.append(text)

    @property
    def progress(self) -> list[Progress]:
        """Of the whole plan."""
        return [replace(p, current=False) for p in self._progress]


Measure = Callable[[Desk], None]
