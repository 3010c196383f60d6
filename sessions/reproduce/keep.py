"""What a reproduction has found so far, on disk: an interrupted run goes on, a finished case is not worked again."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from labnnum import __version__
from labnnum.errors import FileError
from sessions.reproduce.study import Effort, Progress


def key_of(name: str, effort: Effort) -> str:
    """Text that two runs share if their numbers do."""
    return json.dumps({"case": name, "version": __version__, **asdict(effort)}, sort_keys=True)


def finished(folder: Path, name: str, effort: Effort) -> dict[str, Any] | None:
    """Summary of a case that was finished with this effort; None if it has to be worked."""
    path = folder / f"{name}.json"
    if not path.is_file():
        return None
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read ({error}); delete it to work the case again") from error
    return stored if stored.get("key") == key_of(name, effort) else None


def load_progress(folder: Path, name: str, effort: Effort) -> Progress | None:
    """The progress of an interrupted run with the same effort; None if there is none."""
    path = _partial(folder, name)
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            if str(stored["key"]) != key_of(name, effort):
                return None
            arrays = {n[5:]: stored[n] for n in stored.files if n.startswith("rows:")}
            return Progress.of(arrays, int(stored["done"]))
    except (OSError, ValueError, KeyError) as error:
        raise FileError(f"{path}: the unfinished case cannot be read ({error}); delete it") from error


def save_progress(folder: Path, name: str, effort: Effort, found: Progress) -> None:
    """Write the progress; a kill while writing leaves the one before."""
    path = _partial(folder, name)
    part = path.with_suffix(".tmp")
    with part.open("wb") as file:
        rows: dict[str, Any] = {f"rows:{n}": value for n, value in found.arrays().items()}
        np.savez(file, key=np.array(key_of(name, effort)), done=np.array(found.done), **rows)
    os.replace(part, path)


def clear_progress(folder: Path, name: str) -> None:
    """Forget the progress of a finished case."""
    _partial(folder, name).unlink(missing_ok=True)


def write(folder: Path, name: str, text: str) -> Path:
    """Write a result; FileError where that is impossible."""
    path = folder / name
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise FileError(f"{path}: cannot be written ({error.strerror}); choose another folder with -o") from error
    return path


def _partial(folder: Path, name: str) -> Path:
    return folder / f"{name}.partial.npz"
