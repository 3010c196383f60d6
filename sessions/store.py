"""The session file: raw data first, results beside them, appended and never overwritten.

    with create_session("hits.h5", rig_text, model_text) as session:
        run = session.start_run(channels, rate=25600)
        run.append(block)                      # acknowledged when it returns
        run.finish()

    with open_session("hits.h5") as session:
        recordings = session.recordings()      # SI units

docs/formats.md describes the layout, and what outlives a kill and a power cut.
"""

from __future__ import annotations

import contextlib
import io
import os
import threading
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, final

import h5py
import numpy as np
from numpy.typing import NDArray

from labnnum import __version__
from labnnum.errors import FileError, StoreError
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording
from sessions import HDF5_SUFFIXES, runs, tables
from sessions.journal import JournaledFile, Snapshot, force_folder, journal_path, replay
from sessions.lock import WriterLock
from sessions.runs import Run
from sessions.tables import Node, StoredChannel

FORMAT = "labnnum session"
VERSION = 1


@dataclass(frozen=True, eq=False)
class Result:
    """One stored result: payload and arrays, with the settings that made it."""

    kind: str
    number: int
    name: str
    created: float
    code_version: str
    settings: dict[str, Any]
    payload: dict[str, Any]
    arrays: dict[str, NDArray] = field(default_factory=dict)


def create_session(
    path: str | os.PathLike[str], rig_text: str = "", model_text: str = "", sync: float | None = 1.0
) -> Session:
    """A new session, open for writing.

    Parameters
    ----------
    path : path
        Must not exist: nothing is written over.
    rig_text, model_text : str
        rig.toml and model.toml as they stood.
    sync : float or None
        Seconds between forced writes to the disk: what a power cut may cost. A kill costs nothing that was
        acknowledged, whatever `sync` is. 0 forces every block; None leaves it to the operating system.

    Raises
    ------
    FileError
        If `path` exists, or its folder does not.
    """
    path = Path(path)
    require_new(path)
    lock = WriterLock(path)
    try:
        journal_path(path).unlink(missing_ok=True)  # of a session that was deleted
        part = path.with_name(f".{path.name}.part")
        _skeleton(part, rig_text, model_text)
        publish(part, path)
        return Session(path, "a", sync, lock)
    except BaseException:
        lock.release()
        raise


def open_session(path: str | os.PathLike[str], mode: Literal["r", "a"] = "r", sync: float | None = 1.0) -> Session:
    """An existing session, to read ("r") or to append to ("a").

    A session whose writer was killed is brought to its last acknowledged block first. One that another process
    writes can be read as of its last acknowledged block; opening it with "a" is a StoreError.

    Raises
    ------
    FileError
        If the file is missing, truncated, no labnnum session, or of a newer version.
    StoreError
        If another process writes it.
    """
    path = Path(path)
    if path.is_dir():
        raise FileError(f"{path}: is a folder; name a session (.h5) in it")
    if not path.is_file():
        raise FileError(f"{path}: no such session; create one with 'labnnum import' or 'labnnum measure'")
    if mode not in ("r", "a"):
        raise StoreError(f"a session is opened with 'r' or 'a', not {mode!r}")
    lock = WriterLock(path) if mode == "a" else None
    try:
        return Session(path, mode, sync, lock)
    except BaseException:
        if lock is not None:
            lock.release()
        raise


@final
class Session:
    """A session file: its runs, and results beside them. Made by `create_session` and `open_session`."""

    def __init__(self, path: Path, mode: str, sync: float | None, lock: WriterLock | None) -> None:
        self.path, self.mode = path, mode
        self._lock, self.guard = lock, threading.RLock()
        self._journal: JournaledFile | None = None
        self._snapshot: Snapshot | None = None
        self.notice = lock.notice if lock else ""
        self.epoch = 0
        self._file: Node = self._open(sync)
        try:
            _check(path, self._file)
        except BaseException:
            self._release()
            raise

    def _open(self, sync: float | None) -> Node:
        with _naming(self.path):
            if self._lock is not None:
                replay(self.path)
                _check_hdf5(self.path)
                self._journal = JournaledFile(self.path, sync)
                return h5py.File(self._journal, "r+")
            if journal_path(self.path).exists() and not self._recover():
                self._snapshot = Snapshot(self.path)
                return h5py.File(self._snapshot, "r")
            _check_hdf5(self.path)
            return _open_plain(self.path)

    def _recover(self) -> bool:
        """Bring a session that a dead writer left to its last commit; False if its writer lives or we may not."""
        try:
            lock = WriterLock(self.path)
        except StoreError:
            return False
        try:
            replay(self.path)
        except PermissionError:
            return False
        finally:
            lock.release()
        self.notice = lock.notice
        return True

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _root(self) -> Node:
        if not self._file:
            raise StoreError(f"{self.path}: this session is closed; open it again with open_session")
        return self._file

    def node(self, path: str) -> Node:
        """A group or dataset of the file, by its path."""
        return self._root[path]

    @contextlib.contextmanager
    def transaction(self) -> Generator[None]:
        """What happens inside reaches the disk as a whole, or not at all."""
        with self.guard:
            if self._journal is None:
                raise StoreError(f"{self.path}: {'closed' if not self._file else 'open for reading only'}")
            try:
                yield
                self._file.flush()
                self._journal.commit()
            except BaseException:
                self._file.close()
                self._journal.rollback()
                self._file = h5py.File(self._journal, "r+")
                self.epoch += 1
                raise

    def start_run(
        self,
        channels: Sequence[Channel | StoredChannel],
        rate: float,
        *,
        level: float = float("nan"),
        period: int = 0,
        drop_periods: int = 0,
        label: str = "",
        unit: Literal["V", "SI"] = "V",
        full_scale: Sequence[float] | None = None,
        info: Mapping[str, Any] | None = None,
        dtype: str = "f8",
    ) -> Run:
        """Begin a run; append blocks to what is returned.

        Parameters
        ----------
        channels : sequence of Channel or StoredChannel
        rate : float
            Samples per second.
        level, period, drop_periods
            As in `Recording`.
        label : str
            What messages call the run; its number if empty.
        unit : {"V", "SI"}
            Whether blocks hold volts, which each channel's sensitivity turns into SI units, or SI units.
        full_scale : sequence of float, optional
            End of each input's range, in the blocks' unit.
        info : mapping, optional
            Whatever else is known: excitation, generator settings, point of a roving plan.
        dtype : str
            Of the stored samples: "f8", or "f4" where the device delivers no more.
        """
        limits = [float("nan")] * len(channels) if full_scale is None else list(full_scale)
        kept = [tables.stored(c, unit, limit) for c, limit in zip(channels, limits, strict=True)]
        attributes = {
            "level": float(level), "period": int(period), "drop_periods": int(drop_periods),
            "label": label, "dtype": dtype, "code_version": __version__,
        }  # fmt: skip
        with self.transaction():
            name = _next(self._root["runs"])
            runs.begin(self._root["runs"].create_group(name), kept, rate, attributes, info or {})
        return self._run(name)

    @property
    def runs(self) -> tuple[Run, ...]:
        """Every run, in order."""
        return tuple(self._run(name) for name in sorted(map(str, self._root["runs"]), key=int))

    def recordings(self) -> list[Recording]:
        """Every run that holds samples and may be used, as a Recording in SI units; see `left_out`."""
        with _naming(self.path):
            return [run.recording() for run in self.runs if run.n_samples and not run.unusable]

    def left_out(self) -> dict[int, str]:
        """Number of each run that holds samples and may not be used -> why: it was cut off, or no hit is accepted."""
        with _naming(self.path):
            return {run.index: run.unusable for run in self.runs if run.n_samples and run.unusable}

    @property
    def rig_text(self) -> str:
        """rig.toml as it stood."""
        return tables.read_text(self._root, "rig")

    @property
    def model_text(self) -> str:
        """model.toml as it stood."""
        return tables.read_text(self._root, "model")

    @property
    def created(self) -> float:
        """In s since the epoch."""
        return float(self._root.attrs["created"])

    @property
    def code_version(self) -> str:
        """Version of labnnum that created the session."""
        return str(self._root.attrs["code_version"])

    def add_result(
        self,
        kind: str,
        name: str,
        payload: Mapping[str, Any],
        arrays: Mapping[str, NDArray] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> str:
        """Store a result beside the raw data; its path in the file, such as "results/estimate/0002"."""
        with self.transaction():
            group = self._new_result(kind, name)
            tables.write_json(group, "settings", settings or {})
            tables.write_json(group, "payload", payload)
            held = group.create_group("arrays")
            for key, array in (arrays or {}).items():
                held.create_dataset(key, data=array)
        return str(group.name).lstrip("/")

    def results(self, kind: str = "") -> list[Result]:
        """Stored results of a kind (all if empty), oldest first; FRFs have `frfs`."""
        with _naming(self.path):
            return [_result(k, group) for k, group in self._result_groups(kind) if k != "frf"]

    def add_frf(self, frf: Frf, settings: Mapping[str, Any] | None = None, name: str = "frf") -> str:
        """Store an FRF beside the raw data; `settings` (windows, runs used, ...) join those of the FRF."""
        with self.transaction():
            group = self._new_result("frf", name)
            tables.write_json(group, "settings", {**frf.settings, **(settings or {})})
            group.attrs["estimator"] = frf.estimator
            group.attrs["n_averages"] = frf.n_averages
            for side in ("outputs", "inputs"):
                tables.write_channels(group, side, [tables.stored(c, "SI") for c in getattr(frf, side)])
            for key in _FRF_ARRAYS:
                if getattr(frf, key) is not None:
                    group.create_dataset(key, data=getattr(frf, key))
        return str(group.name).lstrip("/")

    def frfs(self) -> list[Frf]:
        """Stored FRFs, oldest first; each has "stored" (its path) and "name" among its settings."""
        with _naming(self.path):
            return [_frf(group) for _, group in self._result_groups("frf")]

    def close(self) -> None:
        """Put everything committed in its place and let the session go; closing twice does no harm."""
        with self.guard:
            if self._file:
                self._file.close()
            self._release()

    def _release(self) -> None:
        journal, self._journal = self._journal, None
        try:
            if journal is not None:
                journal.close()
        finally:
            if self._snapshot is not None:
                self._snapshot.close()
            if self._lock is not None:
                self._lock.release()

    def _run(self, name: str) -> Run:
        label = str(self._root["runs"][name].attrs["label"]) or f"run {int(name)}"
        return Run(self, name, f"{self.path.name}: {label}")

    def _result_groups(self, kind: str) -> Iterator[tuple[str, Node]]:
        results = self._root["results"]
        for key in sorted(results) if not kind else [kind] if kind in results else []:
            for number in sorted(results[key], key=int):
                yield key, results[key][number]

    def _new_result(self, kind: str, name: str) -> Node:
        parent = self._root["results"].require_group(kind)
        group = parent.create_group(_next(parent))
        group.attrs["name"], group.attrs["created"] = name, time.time()
        group.attrs["code_version"] = __version__
        return group


_FRF_ARRAYS = ("frequency", "value", "coherence", "variance", "input_spectrum", "input_condition")


def _frf(group: Node) -> Frf:
    sides: dict[str, Any] = {
        side: [c.channel for c in tables.read_channels(group, side)] for side in ("outputs", "inputs")
    }
    arrays: dict[str, Any] = {key: group[key][()] for key in _FRF_ARRAYS if key in group}
    settings = {**tables.read_json(group, "settings")}
    settings |= {"stored": str(group.name).lstrip("/"), "name": str(group.attrs["name"])}
    averages, estimator = float(group.attrs["n_averages"]), str(group.attrs["estimator"])
    return Frf(**arrays, **sides, n_averages=averages, estimator=estimator, settings=settings)


def _result(kind: str, group: Node) -> Result:
    attrs = group.attrs
    head = (str(attrs["name"]), float(attrs["created"]), str(attrs["code_version"]))
    texts = (tables.read_json(group, "settings"), tables.read_json(group, "payload"))
    arrays = {key: np.asarray(data[()]) for key, data in group["arrays"].items()}
    return Result(kind, int(str(group.name).rsplit("/", 1)[1]), *head, *texts, arrays)


def _next(group: Node) -> str:
    return f"{max((int(n) for n in group), default=0) + 1:04d}"


def require_new(path: Path) -> None:
    """FileError unless a session can be created at `path`: nothing is there, its folder is, and it is called .h5."""
    if path.exists():
        raise FileError(f"{path}: exists already and is not written over; choose another name")
    if path.suffix.lower() not in HDF5_SUFFIXES:
        raise FileError(f"{path}: a session is an .h5 file; call it {path.stem}.h5")
    if not path.parent.is_dir():
        raise FileError(f"{path}: there is no folder {path.parent}")


def discard_empty(path: Path) -> None:
    """Remove a session that holds no sample and no result; any other stays."""
    if not path.is_file():
        return
    with open_session(path) as session:
        empty = not any(run.n_samples for run in session.runs) and not session.results() and not session.frfs()
    if empty:
        path.unlink()
        journal_path(path).unlink(missing_ok=True)


def _skeleton(part: Path, rig_text: str, model_text: str) -> None:
    memory = io.BytesIO()  # HDF5 aborts the process where it cannot write; bytes are written by us
    with h5py.File(memory, "w") as file:
        file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
        file.attrs["code_version"], file.attrs["created"] = __version__, time.time()
        tables.write_text(file, "rig", rig_text)
        tables.write_text(file, "model", model_text)
        file.create_group("runs")
        file.create_group("results")
    part.unlink(missing_ok=True)  # never truncated: after a kill it may be a second name of a finished session
    try:
        with part.open("xb") as out:
            out.write(memory.getvalue())
            out.flush()
            os.fsync(out.fileno())
    except OSError as error:
        part.unlink(missing_ok=True)
        raise StoreError(f"{part.with_name(part.name[1:-5])}: cannot be created ({error.strerror or error})") from error


def publish(part: Path, path: Path) -> None:
    """Give a finished file its name; FileError if another took it meanwhile."""
    try:
        os.link(part, path)
        part.unlink()
    except FileExistsError:
        part.unlink()
        raise FileError(f"{path}: exists already and is not written over; choose another name") from None
    except OSError:  # a file system without hard links
        part.rename(path)
    force_folder(path.parent)


def _open_plain(path: Path, patience: float = 5.0) -> Node:
    """Open for reading; waits while a writer puts pages in their places."""
    deadline = time.monotonic() + patience
    while True:
        try:
            return h5py.File(path, "r")
        except BlockingIOError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.01)


@contextlib.contextmanager
def _naming(path: Path) -> Generator[None]:
    """Turn what h5py says about damage into one line that names the file."""
    try:
        yield
    except PermissionError as error:
        raise FileError(f"{path}: may not be opened (permission denied); check who owns it") from error
    except OSError as error:
        if "truncated file" in str(error):
            why = f"is truncated ({path.stat().st_size} bytes are there)"
        else:
            why = f"is damaged or cannot be read ({str(error).splitlines()[0]})"
        raise FileError(f"{path}: {why}; restore it from a copy") from error
    except KeyError as error:
        raise FileError(f"{path}: is damaged: {str(error).strip(chr(34))}; restore it from a copy") from error


def _check_hdf5(path: Path) -> None:
    if not h5py.is_hdf5(path):
        raise FileError(f"{path}: is no HDF5 file, so no session; bring data in with 'labnnum import'")


def _check(path: Path, file: Node) -> None:
    if str(file.attrs.get("format")).startswith("labnnum-updater"):
        raise FileError(f"{path}: is an updater and no session; use it as in 'labnnum update SESSION -u {path.name}'")
    if file.attrs.get("format") != FORMAT:
        raise FileError(f"{path}: is HDF5 but no labnnum session; bring data in with 'labnnum import'")
    version = int(file.attrs.get("version", 0))
    if version > VERSION:
        made = file.attrs.get("code_version", "?")
        raise FileError(
            f"{path}: has session version {version} (labnnum {made}); labnnum {__version__} reads up to"
            f" version {VERSION}: install a newer labnnum"
        )
    if "runs" not in file or "results" not in file:
        raise FileError(f"{path}: is damaged: it has no runs or results; restore it from a copy")
