"""One writer a session: a lock file that names its owner and outlives no process."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from datetime import UTC, datetime
from pathlib import Path
from typing import final

from labnnum.errors import StoreError

try:
    import fcntl
except ImportError:  # Windows locks a byte of the file instead
    fcntl = None


_FAR = 1 << 30  # behind what the file says about its owner, which others must be able to read


def lock_path(path: Path) -> Path:
    """The lock file of a session file."""
    return path.with_name(path.name + "-lock")


@final
class WriterLock:
    """Holds a session for one writer; `notice` says so if a dead writer's lock was taken over.

    The operating system frees the lock when its process ends, however it ends; the file beside the session only
    tells who it is.

    Raises
    ------
    StoreError
        If a living process writes the session: names it, and says what to do; or if nothing can be written there.
    """

    def __init__(self, path: Path) -> None:
        self._path = lock_path(path)
        self.notice = ""
        before = _owner(self._path)
        self._fd = self._take(path)
        if before:
            self.notice = (
                f"{path.name}: process {before.get('pid')} stopped without closing the session on"
                f" {before.get('since')}; its lock is taken over, all it had acknowledged is kept"
            )
        own = {"pid": os.getpid(), "host": socket.gethostname(), "since": _now()}
        try:
            os.ftruncate(self._fd, 0)
            os.lseek(self._fd, 0, os.SEEK_SET)
            os.write(self._fd, json.dumps(own).encode())
        except OSError as error:
            self.release()
            raise StoreError(f"{path}: cannot be locked for writing ({error.strerror})") from error

    def release(self) -> None:
        """Give the session free."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):  # should the file stay, it names no owner
                os.ftruncate(self._fd, 0)
            if fcntl is not None:  # while it is ours; Windows removes no file that is open
                self._remove()
            os.close(self._fd)
            self._fd = -1
            if fcntl is None:
                self._remove()

    def _remove(self) -> None:
        with contextlib.suppress(FileNotFoundError, PermissionError):  # a folder that turned read-only
            self._path.unlink()

    def _take(self, path: Path) -> int:
        while True:
            try:
                fd = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
            except OSError as error:
                raise StoreError(f"{path}: cannot be locked for writing ({error.strerror})") from error
            if not _lock(fd):
                os.close(fd)
                raise StoreError(_busy(path, _owner(self._path)))
            if _same_file(fd, self._path):
                return fd
            os.close(fd)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _lock(fd: int) -> bool:
    try:
        if fcntl is not None:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            _lock_byte(fd)
    except OSError:
        return False
    return True


def _lock_byte(fd: int) -> None:
    import msvcrt

    os.lseek(fd, _FAR, os.SEEK_SET)
    msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)  # ty: ignore[missing-attribute]


def _same_file(fd: int, path: Path) -> bool:
    """False if the file was unlinked by its last owner between our open and our lock."""
    try:
        return os.path.samestat(os.fstat(fd), path.stat())
    except FileNotFoundError:
        return False


def _owner(path: Path) -> dict:
    """What the lock file says; {} if there is none or it is empty."""
    try:
        return json.loads(path.read_text() or "{}")
    except (FileNotFoundError, json.JSONDecodeError):
        return {}


def _busy(path: Path, owner: dict) -> str:
    who = f"process {owner['pid']} on {owner['host']} since {owner['since']}" if owner else "another process"
    return f"{path}: is being written by {who}; wait until it ends, or stop it, then try again"
