"""Pseudo-terminal: a serial line to a simulated instrument, with the faults of real ones. POSIX systems only."""

from __future__ import annotations

import os
import select
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self, final

from drivers.generators.simulated import SimulatedInstrument
from labnnum.errors import DriverError


@final
class PseudoTerminal:
    """A real serial port of the operating system, with a simulated instrument at its other end.

    Parameters
    ----------
    instrument : SimulatedInstrument
    link : Path or None
        A lasting name for the port, as udev gives to an adapter: it stays when the line is unplugged and plugged in.

    Attributes
    ----------
    delay : float
        s before each answer.
    mute : bool
        It hears and obeys, and says nothing.
    answered : int
        Commands dealt with so far, their answers sent.
    garble : bool
        Every byte of its answers but the end of the line comes with its bits turned over.

    Examples
    --------
    >>> from drivers.generators import OPENERS
    >>> from drivers.generators.simulated import SimulatedJunce
    >>> with PseudoTerminal(SimulatedJunce()) as line, OPENERS["junce"](line.port, max_volts=2) as generator:
    ...     generator.set_frequency(36.5)
    ...     generator.identity
    'JDS6600-60M number 1710301'
    """

    def __init__(self, instrument: SimulatedInstrument, link: Path | None = None) -> None:
        if not hasattr(os, "openpty"):
            raise DriverError("this system has no pseudo-terminals")
        self.instrument = instrument
        self.delay, self.mute, self.garble = 0.0, False, False
        self.heard: list[bytes] = []
        self.answered = 0
        self._link = link
        self._ends: tuple[int, int] | None = None
        self._thread: threading.Thread | None = None
        self.plug()

    @property
    def port(self) -> str:
        """What to open."""
        return str(self._link) if self._link else self._tty

    def plug(self) -> None:
        """Connect the line."""
        import tty

        master, slave = os.openpty()
        tty.setraw(slave)
        self._tty = os.ttyname(slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self._tty)
        self._ends = master, slave
        self._wake, self._poke = os.pipe()
        self._thread = threading.Thread(target=self._serve, args=(master,), name="instrument", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Take the line away; harmless when it is gone. The instrument stays as it is."""
        if self._ends is None or self._thread is None:
            return
        os.write(self._poke, b"x")
        if threading.current_thread() is not self._thread:
            self._thread.join()
        for end in (*self._ends, self._wake, self._poke):
            os.close(end)
        self._ends = None

    def _serve(self, master: int) -> None:
        waiting = b""
        while True:
            ready, _, _ = select.select([master, self._wake], [], [])
            if self._wake in ready:
                return
            waiting += os.read(master, 4096)
            while b"\n" in waiting:
                line, _, waiting = waiting.partition(b"\n")
                self.heard.append(line + b"\n")
                self._reply(master, self.instrument.answer(line + b"\n"))
                self.answered += 1

    def _reply(self, master: int, answer: bytes) -> None:
        if self.delay:
            time.sleep(self.delay)
        if self.mute or not answer:
            return
        os.write(master, bytes(b if b == 10 else b ^ 0xFF for b in answer) if self.garble else answer)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.unplug()
        if self._link is not None:
            self._link.unlink(missing_ok=True)
