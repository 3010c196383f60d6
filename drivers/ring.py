"""Ring: what an audio callback copies into and a reader takes blocks from; neither waits for the other."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Mark:
    """One delivery of the device: where it lies in the ring's count, when it came, and what was amiss before it.

    Parameters
    ----------
    at : int
        Frames put before it.
    frames : int
    time : float
        When it was handed over, in s of any clock that only goes forward.
    lost : int
        Frames known to be missing before it.
    broken : bool
        The device said that it lost some, and not how many.
    """

    at: int
    frames: int
    time: float
    lost: int = 0
    broken: bool = False

    @property
    def gap(self) -> bool:
        """Whether it does not continue what came before."""
        return self.broken or self.lost > 0


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """Frames without a gap inside: data (n_frames, n_channels), and the gap before them."""

    data: NDArray[np.float32]
    start: int
    lost: int
    broken: bool


@final
class Ring:
    """One writer, one reader, no lock: counters only grow, and each is written by one side.

    Parameters
    ----------
    frames : int
        That it holds; what comes while it is full is counted and dropped.
    channels : int

    Examples
    --------
    >>> ring = Ring(8, 1)
    >>> ring.put(np.ones((6, 1), np.float32), time=0.0)
    True
    >>> ring.take(4).start, ring.take(4)
    (0, None)
    """

    def __init__(self, frames: int, channels: int) -> None:
        self._data = np.zeros((frames, channels), np.float32)
        self._written = self._read = 0
        self._marks: deque[Mark] = deque()
        self._lost, self._broken = 0, False
        self._seen: deque[Mark] = deque()
        self._unheard: list[Mark] = []
        self._start = 0

    def put(self, data: NDArray[np.float32], time: float, lost: int = 0, broken: bool = False) -> bool:
        """Copy a delivery in; False if the ring was full and it was dropped. Called by the writer alone."""
        n, size = len(data), len(self._data)
        self._lost, self._broken = self._lost + lost, self._broken or broken
        if self._written - self._read + n > size:
            self._lost += n
            return False
        at = self._written % size
        first = min(n, size - at)
        self._data[at : at + first] = data[:first]
        self._data[: n - first] = data[first:]
        self._marks.append(Mark(self._written, n, time, self._lost, self._broken))
        self._lost, self._broken = 0, False
        self._written += n
        return True

    def marks(self) -> list[Mark]:
        """Deliveries since this was last asked, each of them once. Called by the reader alone."""
        self._absorb()
        new, self._unheard = self._unheard, []
        return new

    def _absorb(self) -> None:
        while self._marks:
            mark = self._marks.popleft()
            self._seen.append(mark)
            self._unheard.append(mark)

    def take(self, count: int, rest: bool = False) -> Piece | None:
        """The next `count` frames, fewer where a gap follows; None if they are not there yet.

        With `rest` whatever is there. Called by the reader alone.
        """
        written = self._written  # before the marks: of what lies ahead of it every mark is there by now
        self._absorb()
        lost, broken = self._gap_here()
        stop = self._stop(count)
        if written < stop:
            if not rest or written == self._read:
                return None
            stop = written
        size = len(self._data)
        rows = np.arange(self._read, stop) % size
        piece = Piece(self._data[rows], self._start + lost, lost, broken)
        self._start += lost + stop - self._read
        self._read = stop
        return piece

    def _gap_here(self) -> tuple[int, bool]:
        """What is amiss at the reader's place; deliveries that lie behind it are forgotten."""
        while self._seen and self._seen[0].at + self._seen[0].frames <= self._read:
            self._seen.popleft()
        here = self._seen[0] if self._seen else None
        return (here.lost, here.broken) if here is not None and here.at == self._read else (0, False)

    def _stop(self, count: int) -> int:
        """Where the next piece ends: after `count` frames, or at the first gap."""
        stop = self._read + count
        gaps = (m.at for m in self._seen if m.gap and self._read < m.at)
        return min(stop, next(gaps, stop))
