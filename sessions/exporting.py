"""What of a session or file is exported."""

from __future__ import annotations

from pathlib import Path

from labnnum.errors import FileError
from labnnum.frf import Frf
from labnnum.recording import Recording
from sessions.exchange import SESSION_SUFFIXES, load_frf, read_any
from sessions.store import open_session


def chosen_recordings(source: Path, number: int | None = None, channels: Path | None = None) -> list[Recording]:
    """All recordings of a session or file, or the one of that number, counted from 1; cut off or rejected ones too."""
    found = _every_run(source) or read_any(source, channels)
    if isinstance(found, Frf):
        raise FileError(f"{source}: holds FRFs and no recordings; export with --frf")
    if number is None:
        return found
    if not 1 <= number <= len(found):
        raise FileError(f"{source}: there is no run {number}; there are {len(found)}, counted from 1")
    return [found[number - 1]]


def _every_run(source: Path) -> list[Recording]:
    """All that a session holds; nothing of other files."""
    if source.suffix.lower() not in SESSION_SUFFIXES:
        return []
    with open_session(source) as session:
        return [run.recording() for run in session.runs if run.n_samples]


def chosen_frf(source: Path, number: int | None = None, channels: Path | None = None) -> Frf:
    """The last FRF of a session or file, or the one of that number, counted from 1."""
    if number is None or source.suffix.lower() not in SESSION_SUFFIXES:
        return load_frf(source, channels)
    with open_session(source) as session:
        found = session.frfs()
    if not 1 <= number <= len(found):
        raise FileError(f"{source}: there is no FRF {number}; there are {len(found)}, counted from 1")
    return found[number - 1]
