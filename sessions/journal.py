"""A file under HDF5 that is never half written: appended data first, changed pages through a journal.

HDF5 changes its index pages in place, so a process that is killed between two of those writes can leave a file
that no program opens. `JournaledFile` stands between HDF5 and the disk (h5py's file-object driver):

- while HDF5 works, everything it writes stays in memory;
- `commit` appends what is new behind the end of the file, and what replaces committed pages as one checksummed
  record in `<name>-journal`. A process killed before the record is whole leaves the state before, and killed
  after it the state after;
- `checkpoint` copies the journal's pages to their places, with fsync on both sides, and empties the journal.

The file itself is plain HDF5 as of its last checkpoint; `replay` brings it to the last commit. The layout is
described in docs/formats.md.
"""

from __future__ import annotations

import errno
import os
import struct
import threading
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn, final

from labnnum.errors import StoreError

try:
    import fcntl
except ImportError:  # Windows has no flock: a reader there meets the file as of some checkpoint
    fcntl = None

PAGE = 512
MAGIC = b"LNNJRNL1"
_HEAD = struct.Struct("<8sQQIIQQI")  # magic, generation, end of file, record number, pages, tail start, length, crc
_SEAL = 0xFFFFFFFF
_CRC = struct.Struct("<I")
_AT = struct.Struct("<Q")

Pages = dict[int, bytes]


def journal_path(path: Path) -> Path:
    """The journal that belongs to a session file."""
    return path.with_name(path.name + "-journal")


def force_folder(folder: Path) -> None:
    """Make new names in a folder outlive a power cut, where the system can."""
    if os.name == "posix":
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


def _pwrite(fd: int, data: bytes | bytearray | memoryview, offset: int) -> None:
    os.lseek(fd, offset, os.SEEK_SET)
    view = memoryview(data)
    while view:
        view = view[os.write(fd, view) :]


def _pread(fd: int, length: int, offset: int) -> bytearray:
    os.lseek(fd, offset, os.SEEK_SET)
    out = bytearray()
    while len(out) < length and (part := os.read(fd, length - len(out))):
        out += part
    return out


def _record(generation: int, end: int, number: int, pages: Pages, tail_at: int, tail: bytes | bytearray) -> bytes:
    head = _HEAD.pack(MAGIC, generation, end, number, len(pages), tail_at, len(tail), zlib.crc32(tail))
    body = b"".join([head, *(_AT.pack(at) + page for at, page in pages.items())])
    return body + _CRC.pack(zlib.crc32(body))


def _records(data: bytes) -> Iterator[tuple[int, int, Pages, tuple[int, int, int]]]:
    """Whole records of one generation: (end, number, pages, (tail start, length, crc))."""
    at, generation, expected = 0, None, 0
    step = _AT.size + PAGE
    while at + _HEAD.size <= len(data):
        magic, gen, end, number, count, tail_at, tail_n, tail_crc = _HEAD.unpack_from(data, at)
        stop = at + _HEAD.size + count * step
        if magic != MAGIC or generation not in (None, gen) or number not in (expected, _SEAL):
            return
        if stop + _CRC.size > len(data) or _CRC.unpack_from(data, stop)[0] != zlib.crc32(data[at:stop]):
            return
        first = at + _HEAD.size
        starts = range(first, stop, step)
        pages = {_AT.unpack_from(data, s)[0]: data[s + _AT.size : s + step] for s in starts}
        yield end, number, pages, (tail_at, tail_n, tail_crc)
        generation, expected, at = gen, number + 1, stop + _CRC.size


def pending(path: Path) -> tuple[Pages, int] | None:
    """Pages of the journal that are committed and not yet in their places, and the file's end.

    None where there is no journal or no whole record in it. A record counts only if what it appended to the file
    arrived as well, so that a power cut between the two leaves the commit before.
    """
    try:
        data = journal_path(path).read_bytes()
    except FileNotFoundError:
        return None
    records = list(_records(data))
    if not records:
        return None
    sealed = records[-1][1] == _SEAL
    pages: Pages = {}
    end = -1
    with path.open("rb") as file:
        for stop, number, changed, (tail_at, tail_n, crc) in records:
            if not sealed and number != _SEAL and zlib.crc32(_pread(file.fileno(), tail_n, tail_at)) != crc:
                break
            pages.update(changed)
            end = stop
    return (pages, end) if end >= 0 else None


def replay(path: Path) -> bool:
    """Bring a session file to its last commit and remove the journal; True if there was anything to do.

    The caller holds the session's lock. Replaying twice, or being killed on the way, does no harm.
    """
    found = pending(path)
    if found is not None:
        pages, end = found
        with path.open("r+b") as file:
            _apply(file.fileno(), pages, end)
            os.fsync(file.fileno())
    if journal_path(path).exists():
        journal_path(path).unlink()
        force_folder(path.parent)
    return found is not None


def _apply(fd: int, pages: Pages, end: int) -> None:
    for at in sorted(pages):
        _pwrite(fd, pages[at], at)
    os.ftruncate(fd, end)


def _lay_over(out: bytearray, start: int, pages: Pages | dict[int, bytearray]) -> None:
    """Replace in `out`, which begins at `start`, what `pages` hold."""
    stop = start + len(out)
    for at in range(start - start % PAGE, stop, PAGE):
        if at in pages:
            low, high = max(at, start), min(at + PAGE, stop)
            out[low - start : high - start] = pages[at][low - at : high - at]


@final
class Snapshot:
    """File object that shows a session file, which another process is writing, as of its last commit; read only."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        if fcntl is not None:
            fcntl.flock(self._file, fcntl.LOCK_SH)
        found = pending(path)
        size = os.fstat(self._file.fileno()).st_size
        self._pages, self._size = ({}, size) if found is None else (found[0], min(found[1], size))
        self._position = 0

    def read(self, length: int = -1) -> bytes:
        """Bytes from the position on."""
        length = self._size - self._position if length < 0 else length
        out = _pread(self._file.fileno(), max(0, min(length, self._size - self._position)), self._position)
        _lay_over(out, self._position, self._pages)
        self._position += len(out)
        return bytes(out)

    def readinto(self, buffer: bytearray | memoryview) -> int:
        """Fill `buffer` from the position on; how many bytes there were."""
        out = self.read(len(buffer))
        memoryview(buffer)[: len(out)] = out
        return len(out)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position."""
        self._position = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence] + offset
        return self._position

    def tell(self) -> int:
        """The position."""
        return self._position

    def truncate(self, size: int | None = None) -> int:
        """Nothing: a snapshot keeps its size."""
        return self._size if size is None else size

    def flush(self) -> None:
        """Nothing: a snapshot holds no changes."""

    def close(self) -> None:
        """Let the writer put its pages in their places again."""
        self._file.close()


@final
class JournaledFile:
    """File object for `h5py.File(...)` whose changes reach the disk together, at `commit`.

    Parameters
    ----------
    path : Path
        An existing HDF5 file, already brought up to date by `replay`. The caller holds its lock.
    sync : float or None
        Seconds between checkpoints, each of which is forced to the disk (fsync): what a power cut may cost.
        0 forces every commit; None leaves the moment to the operating system.
    """

    def __init__(self, path: Path, sync: float | None = 1.0) -> None:
        self._path, self._sync = path, sync
        self._fd = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
        self._journal = -1  # made by the first commit: who only looks, or is refused, leaves the folder as it was
        self._journal_end = 0
        self._generation = time.time_ns()
        self._number = 0
        size = os.fstat(self._fd).st_size
        self._end = self._size = size + -size % PAGE
        self._tail = bytearray()
        self._changed: dict[int, bytearray] = {}
        self._deferred: Pages = {}
        self._position = 0
        self._checked = time.monotonic()
        self._failed = ""
        self._guard = threading.RLock()

    # What h5py's file-object driver calls.

    def read(self, length: int = -1) -> bytes:
        """Bytes from the position on."""
        length = self._size - self._position if length < 0 else length
        out = bytearray(length)
        return bytes(out[: self.readinto(out)])

    def readinto(self, buffer: bytearray | memoryview) -> int:
        """Fill `buffer` from the position on; how many bytes there were."""
        start = self._position
        count = max(0, min(len(buffer), self._size - start))
        self._position = start + count
        if count:
            with self._guard:
                memoryview(buffer)[:count] = self._get(start, start + count)
        return count

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Take `data` at the position; nothing reaches the disk before `commit`."""
        view = memoryview(data).cast("B")
        if self._fd < 0:  # HDF5 lets go of an object after the file was closed: all that counts is on the disk
            return len(view)
        with self._guard:
            return self._put(view)

    def _put(self, view: memoryview) -> int:
        start, stop = self._position, self._position + len(view)
        if start < self._end:
            self._change(start, view[: self._end - start])
        if stop > self._end:
            first = max(start, self._end) - self._end
            if len(self._tail) < stop - self._end:
                self._tail.extend(bytes(stop - self._end - len(self._tail)))
            self._tail[first : stop - self._end] = view[max(start, self._end) - start :]
        self._position = stop
        self._size = max(self._size, stop)
        return len(view)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position."""
        origin = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = origin + offset
        return self._position

    def tell(self) -> int:
        """The position."""
        return self._position

    def truncate(self, size: int | None = None) -> int:
        """Set the size; what is committed keeps its place on the disk."""
        with self._guard:
            self._size = self._position if size is None else size
            self._tail = self._tail[: max(0, self._size - self._end)]
            self._tail.extend(bytes(max(0, self._size - self._end - len(self._tail))))
            return self._size

    def flush(self) -> None:
        """HDF5 handed over all it had; `commit` is what writes it."""

    # What the store calls.

    def commit(self) -> None:
        """Make all that HDF5 wrote since the last commit outlive a kill, or nothing of it.

        Raises
        ------
        StoreError
            If the disk is full or fails; the file then stays as of the commit before, for good.
        """
        with self._guard:
            self._commit()
        if time.monotonic() - self._checked >= (1.0 if self._sync is None else self._sync):
            self.checkpoint()

    def _commit(self) -> None:
        if self._failed:
            raise StoreError(self._failed)
        if not self._tail and not self._changed:
            return
        try:
            self._append()
        except OSError as error:
            if self._journal >= 0:
                os.ftruncate(self._journal, self._journal_end)
            os.ftruncate(self._fd, self._end)
            self._fail(error)

    def rollback(self) -> None:
        """Forget what HDF5 wrote since the last commit; HDF5 must have let go of the file."""
        self._tail, self._changed = bytearray(), {}
        self._size = self._end
        self._position = 0

    def checkpoint(self) -> bool:
        """Copy committed pages to their places in the file; False while a reader keeps the file open."""
        with self._guard:
            return self._checkpoint()

    def _checkpoint(self) -> bool:
        self._checked = time.monotonic()
        if not self._deferred and self._journal_end == 0:
            return True
        if not _nobody_reads(self._fd):
            return False
        try:
            self._seal()
            _apply(self._fd, self._deferred, self._end)
            self._force(self._fd)
            os.ftruncate(self._journal, 0)
            self._force(self._journal)  # else new records could come to lie over old ones that count again
        except OSError as error:
            self._fail(error)
        finally:
            _let_read(self._fd)
        self._deferred.clear()
        self._journal_end, self._number = 0, 0
        self._generation += 1
        return True

    def close(self) -> None:
        """Checkpoint and let go; what was not committed is dropped."""
        try:
            done = not self._failed and self.checkpoint()
        finally:
            self.abandon()
        if done:
            journal_path(self._path).unlink(missing_ok=True)

    def abandon(self) -> None:
        """Let go without a checkpoint, as a process does that is killed."""
        fds, self._fd, self._journal = (self._fd, self._journal), -1, -1
        for fd in fds:
            if fd >= 0:
                os.close(fd)

    def _append(self) -> None:
        if self._journal < 0:
            flags = os.O_RDWR | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0)
            self._journal = os.open(journal_path(self._path), flags, 0o666)
            force_folder(self._path.parent)
            os.ftruncate(self._fd, self._end)  # to a whole page
        tail = self._padded_tail()
        _pwrite(self._fd, tail, self._end)
        pages = {at: bytes(page) for at, page in self._changed.items()}
        end = self._end + len(tail)
        record = _record(self._generation, end, self._number, pages, self._end, tail)
        _pwrite(self._journal, record, self._journal_end)
        self._journal_end += len(record)
        self._number += 1
        self._deferred.update(pages)
        self._end = end
        self._tail, self._changed = bytearray(), {}

    def _padded_tail(self) -> bytearray:
        """The tail, ending on a page: only whole pages are ever journaled."""
        return self._tail + bytes(-(self._end + len(self._tail)) % PAGE) if self._tail else self._tail

    def _seal(self) -> None:
        """Mark the journal as complete: from here on its pages may already be in their places."""
        self._force(self._fd)
        record = _record(self._generation, self._end, _SEAL, {}, self._end, b"")
        _pwrite(self._journal, record, self._journal_end)
        self._force(self._journal)

    def _force(self, fd: int) -> None:
        if self._sync is not None:
            os.fsync(fd)

    def _fail(self, error: OSError) -> NoReturn:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        why = "the disk is full" if full else f"the disk failed ({error.strerror})"
        self._failed = f"{self._path.name}: {why}; everything acknowledged before is kept and readable"
        raise StoreError(self._failed) from error

    def _get(self, start: int, stop: int) -> bytearray:
        """Bytes as HDF5 last wrote them: the disk's, with deferred and changed pages laid over, and the tail."""
        wanted = max(0, min(stop, self._end) - start)
        out = _pread(self._fd, wanted, start)
        out += bytes(wanted - len(out))
        for layer in (self._deferred, self._changed):
            _lay_over(out, start, layer)
        if stop > self._end:
            out += self._tail[max(0, start - self._end) : stop - self._end]
            out += bytes(stop - start - len(out))
        return out

    def _change(self, start: int, data: memoryview) -> None:
        """Keep those pages of committed data that `data` really changes."""
        stop = start + len(data)
        first, last = start - start % PAGE, stop + -stop % PAGE
        old = self._get(first, min(last, self._end))
        old += bytes(last - first - len(old))
        new = bytearray(old)
        new[start - first : stop - first] = data
        for at in range(first, last, PAGE):
            page = new[at - first : at - first + PAGE]
            if page != old[at - first : at - first + PAGE]:
                self._changed[at] = page


def _nobody_reads(fd: int) -> bool:
    """Whether no HDF5 program has the file open for reading; keeps new ones out until `_let_read`."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _let_read(fd: int) -> None:
    if fcntl is not None:
        fcntl.flock(fd, fcntl.LOCK_UN)
