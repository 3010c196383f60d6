"""Link: the window lives in a process of its own, asks for snapshots when it can draw, and sends the person's keys.

A window that hangs asks for nothing, so that nobody waits for it; one that is gone leaves the measurement running.
"""

from __future__ import annotations

import contextlib
import secrets
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from dataclasses import replace
from multiprocessing.connection import Connection, Listener
from typing import Any, final

import numpy as np

from labnnum.errors import LabnnumError
from sessions.display import Display
from sessions.snapshot import Snapshot

READY, CLOSE = "ready", "close"
PATIENCE = 5.0
"""s after which a person is told that the window has yet to open."""


@final
class Window(Display):
    """A live window; snapshots go to it, commands come from it.

    Parameters
    ----------
    stay : bool
        Leave the window open when the measurement is over.
    timeout : float
        s that it may take to open: a cold machine that does other work reads and compiles Qt for long.

    Raises
    ------
    LabnnumError
        If it cannot open.
    """

    interval = 0.05

    def __init__(self, stay: bool = True, timeout: float = 120.0) -> None:
        super().__init__()
        self._stay = stay
        self._latest: Snapshot | None = None
        self._shown: Snapshot | None = None
        self._fresh = threading.Condition()
        self._asked = False
        self._commands: deque[str] = deque()
        self._over = False
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed in close()
        key = secrets.token_bytes(16)
        listener = Listener(authkey=key)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "sessions.window.app", _address(listener.address)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,  # it outlives the command, which others may be listening to
            stderr=self._said,
            start_new_session=True,
        )
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it died at once: said below, with its reason
            self.process.stdin.write(key.hex().encode() + b"\n")
            self.process.stdin.close()
        self._connection = self._accept(listener, timeout)
        self._threads = [
            threading.Thread(target=loop, name=name, daemon=True)
            for name, loop in (("window-out", self._send), ("window-in", self._receive))
        ]
        for thread in self._threads:
            thread.start()

    def _accept(self, listener: Listener, timeout: float) -> Connection:
        got: list[Any] = []

        def accept() -> None:
            with contextlib.suppress(OSError, EOFError):  # the listener is closed below when nobody comes
                got.append(listener.accept())

        waiter = threading.Thread(target=accept, daemon=True)
        waiter.start()
        began, warned = time.monotonic(), False
        while waiter.is_alive() and time.monotonic() < began + timeout and self.process.poll() is None:
            waiter.join(0.05)
            if not warned and time.monotonic() > began + PATIENCE:
                warned = True
                print("the live window takes long to open; still waiting for it", file=sys.stderr, flush=True)
        waiter.join(0.2)
        listener.close()
        if not got:
            raise LabnnumError(f"the live window cannot open: {self._last_words()}; measure without --live")
        return got[0]

    def _last_words(self) -> str:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._said.seek(0)
        lines = self._said.read().decode(errors="replace").strip().splitlines()
        self._said.close()
        said = [line for line in lines if "qt." in line or "Error" in line] or lines[-1:]
        return said[-1] if said else "it gave no reason"

    def show(self, snapshot: Snapshot) -> None:
        """Keep the snapshot for when the window asks; never waits."""
        with self._fresh:
            self._latest = self._shown = snapshot
            self._fresh.notify()

    def end(self, why: str, failed: bool = False) -> None:
        """Show the last snapshot with how it ended, and no generator that is on."""
        nothing = np.zeros((0, 0))
        last = self._shown or Snapshot("", (), (), 1.0, nothing, np.zeros(0), nothing)
        nan = float("nan")
        self.show(replace(last, state=why, finished=True, failed=failed, volts=nan, level=nan, target=nan))

    def commands(self) -> list[str]:
        """What the person asked for since the last call."""
        return [self._commands.popleft() for _ in range(len(self._commands))]

    @property
    def alive(self) -> bool:
        """Whether the window is still there."""
        return not self._over and self.process.poll() is None

    def close(self) -> None:
        """Give the window the last snapshot; it stays, or closes."""
        with self._fresh:
            self._over = True
            self._fresh.notify()
        self._threads[0].join(1.0)  # longer than that only a window takes that hangs
        if not self._stay:
            self._tell(CLOSE)
            try:
                self.process.wait(2.0)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._connection.close()
        self._said.close()

    def _tell(self, what: Any) -> bool:
        try:
            self._connection.send(what)
        except (OSError, ValueError):  # closed, by either side
            return False
        return True

    def _send(self) -> None:
        while True:
            with self._fresh:
                self._fresh.wait_for(lambda: self._over or (self._asked and self._latest is not None))
                snapshot, self._latest, self._asked = self._latest, None, False
                over = self._over
            if (snapshot is not None and not self._tell(snapshot)) or over:
                return

    def _receive(self) -> None:
        while True:
            try:
                word = self._connection.recv()
            except (EOFError, OSError, TypeError):  # the window is gone, or this side closed the line
                return
            if word == READY:
                with self._fresh:
                    self._asked = True
                    self._fresh.notify_all()
            else:
                self._hear(str(word))

    def _hear(self, command: str) -> None:
        """Keep the command, and at "stop" switch off at once; where that fails, whoever takes the command tells it."""
        self._commands.append(command)
        if command == "stop":
            with contextlib.suppress(LabnnumError):
                self.urgent()


def _address(address: Any) -> str:
    return address if isinstance(address, str) else f"{address[0]}:{address[1]}"
