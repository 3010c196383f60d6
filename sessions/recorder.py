"""Recorder: blocks go from the digitiser to the disk before anybody computes with them."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, final

import numpy as np
from numpy.typing import NDArray

from drivers.block import Block
from drivers.digitiser import Digitiser
from labnnum.errors import LabnnumError

LIVE = 64 * 2**20
"""Bytes of stored blocks that wait for the live display at most; older ones are skipped, on the disk they are whole."""


class Sink(Protocol):
    """Where blocks are stored; `append` returns when the block is safe."""

    def append(self, block: Block) -> int:
        """Store; samples stored so far."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """A block that is on the disk.

    Parameters
    ----------
    block : Block
    at : int
        Number of its first sample among those stored.
    broken : bool
        It does not continue the stored sample before, or it overflowed: nothing may span its beginning.
    skipped : int
        Samples stored before it that were not handed over, because whoever asked was too slow.
    """

    block: Block
    at: int
    broken: bool = False
    skipped: int = 0


@final
class Recorder:
    """Reads, guards, stores, and then hands over; a thread of its own where the device keeps a pace.

    Parameters
    ----------
    digitiser : Digitiser
        Open.
    sink : Sink
        A run of a session.
    guard : callable, optional
        Sees each block first, before it is stored; what it raises ends the run (after the block is stored).
    timeout : float
        s without a block after which the device counts as lost.

    Notes
    -----
    A device without a pace of its own is read when the next block is asked for, so that every run is the same.
    """

    def __init__(
        self,
        digitiser: Digitiser,
        sink: Sink,
        guard: Callable[[Block], None] | None = None,
        timeout: float = 5.0,
    ) -> None:
        self._digitiser, self._sink, self._guard, self._timeout = digitiser, sink, guard, timeout
        self._waiting: deque[Stored] = deque()
        self._bytes = self._skipped = 0
        self._condition = threading.Condition()
        self._error: BaseException | None = None
        self._ended = False
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._next: int | None = None
        self._overflowed = False
        self.stored = self.lost = self.overflows = 0
        self.silence: Callable[[], None] = lambda: None
        """Called at once, by the thread that records, when its device, guard or disk ends the run: nobody guards any
        more, whatever blocks others still have to take."""

    def __enter__(self) -> Self:
        self._digitiser.start()
        if self._digitiser.paced:
            self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self._digitiser.stop()

    def __iter__(self) -> Iterator[Stored]:
        """Blocks after they were stored, until the device ends; errors of device, guard and disk come up here."""
        while (one := self.take()) is not None:
            yield one

    def take(self) -> Stored | None:
        """The next block that is on the disk; None where the device came to its end."""
        if self._thread is None:
            return self._step()
        with self._condition:
            self._condition.wait_for(lambda: self._waiting or self._ended)
            if self._waiting:
                one = self._waiting.popleft()
                self._bytes -= one.block.data.nbytes
                return one
        if self._error is not None:
            raise self._error
        return None

    def _step(self) -> Stored | None:
        block = self._digitiser.read(self._timeout)
        if block is None:
            return None
        alarm = self._alarm(block)
        at = self._sink.append(block) - block.n_frames
        broken = self._broken(block)
        self.stored = at + block.n_frames
        self.lost += block.lost
        self.overflows += block.overflow
        if alarm is not None:
            raise alarm
        return Stored(block, at, broken)

    def _alarm(self, block: Block) -> Exception | None:
        """What the guard has to say: it acts before the block goes to the disk, and is heard after."""
        try:
            if self._guard is not None:
                self._guard(block)
        except Exception as error:
            return error
        return None

    def _broken(self, block: Block) -> bool:
        jump = self._next is not None and block.start != self._next
        broken = jump or block.lost > 0 or block.overflow or self._overflowed
        self._next, self._overflowed = block.start + block.n_frames, block.overflow
        return broken

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                one = self._step()
                if one is None:
                    break
                self._hand_over(one)
        except BaseException as error:
            self._error = error
        if not self._stop.is_set():
            with suppress(LabnnumError):  # whoever takes the error switches off again, and tells
                self.silence()
        with self._condition:
            self._ended = True
            self._condition.notify()

    def _hand_over(self, one: Stored) -> None:
        with self._condition:
            while self._waiting and self._bytes + one.block.data.nbytes > LIVE:
                old = self._waiting.popleft()
                self._bytes -= old.block.data.nbytes
                self._skipped += old.block.n_frames + old.skipped
            if self._skipped and not self._waiting:
                one = Stored(one.block, one.at, True, self._skipped)
                self._skipped = 0
            elif self._skipped:
                first = self._waiting[0]
                self._waiting[0] = Stored(first.block, first.at, True, first.skipped + self._skipped)
                self._skipped = 0
            self._waiting.append(one)
            self._bytes += one.block.data.nbytes
            self._condition.notify()


@final
class Tail:
    """The last samples of a stream, in SI units, to cut hits from."""

    def __init__(self, n_channels: int, length: int) -> None:
        self._data = np.zeros((n_channels, 2 * length))
        self._length = length
        self._fill = 0
        self._end = 0

    def keep(self, length: int) -> None:
        """Keep at least `length` samples from now on."""
        self._length = max(self._length, length)

    def add(self, at: int, data: NDArray) -> None:
        """Samples from number `at` on; a stretch that does not continue the one before begins anew."""
        n = data.shape[1]
        if at != self._end:
            self._fill = 0
        if self._data.shape[1] < self._length + n:
            self._data = np.hstack([self._data, np.zeros((len(data), self._length + n))])
        if self._fill + n > self._data.shape[1]:
            keep = min(self._fill, self._length)
            self._data[:, :keep] = self._data[:, self._fill - keep : self._fill].copy()
            self._fill = keep
        self._data[:, self._fill : self._fill + n] = data
        self._fill += n
        self._end = at + n

    def cut(self, start: int, stop: int) -> NDArray[np.float64]:
        """Samples [start, stop), shape (n_channels, stop - start); they must be among the last `length`."""
        first = self._end - self._fill
        if not first <= start <= stop <= self._end:
            raise IndexError(f"samples {start} to {stop} are not among {first} to {self._end}")
        return self._data[:, start - first : stop - first].copy()

    def latest(self, count: int) -> NDArray[np.float64]:
        """The last `count` samples, or as many as there are."""
        return self._data[:, max(self._fill - count, 0) : self._fill].copy()
