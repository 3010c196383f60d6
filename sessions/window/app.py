"""The window's process: draws one snapshot after the other, as fast as it can and no faster."""

from __future__ import annotations

import sys
import threading
from multiprocessing.connection import Client, Connection
from typing import final

from PySide6 import QtCore, QtWidgets

from sessions.snapshot import Snapshot
from sessions.window.link import CLOSE, READY
from sessions.window.view import View

PACE = 40
"""ms between a picture and the next request: 25 pictures a second at most."""


@final
class Feed(QtCore.QObject):
    """Receives in a thread of its own, and hands over to the drawing thread."""

    arrived = QtCore.Signal(object)
    ended = QtCore.Signal()

    def __init__(self, connection: Connection) -> None:
        super().__init__()
        self._connection = connection
        self._lock = threading.Lock()

    def start(self) -> None:
        """Begin to receive, and ask for the first snapshot."""
        threading.Thread(target=self._receive, name="feed", daemon=True).start()
        self.send(READY)

    def send(self, word: str) -> None:
        """To the measuring process; it may be gone, which `ended` tells."""
        with self._lock:
            try:
                self._connection.send(word)
            except OSError:
                self.ended.emit()

    def _receive(self) -> None:
        while True:
            try:
                got = self._connection.recv()
            except (EOFError, OSError):
                self.ended.emit()
                return
            self.arrived.emit(got)


def main() -> None:
    """Connect to the measuring process, whose address is the first argument and whose key comes on standard input."""
    key = bytes.fromhex(sys.stdin.readline().strip())
    app = QtWidgets.QApplication(sys.argv[:1])
    connection = Client(_address(sys.argv[1]), authkey=key)
    feed = Feed(connection)
    view = View(feed.send)

    def draw(got: object) -> None:
        if isinstance(got, Snapshot):
            view.show_snapshot(got)
            QtCore.QTimer.singleShot(PACE, lambda: feed.send(READY))
        elif got == CLOSE:
            app.quit()

    feed.arrived.connect(draw)
    feed.ended.connect(view.ended)
    view.show()
    feed.start()
    sys.exit(app.exec())


def _address(text: str) -> str | tuple[str, int]:
    host, colon, port = text.rpartition(":")
    return (host, int(port)) if colon and port.isdigit() else text


if __name__ == "__main__":
    main()
