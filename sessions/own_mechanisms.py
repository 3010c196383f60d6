"""Mechanisms of users beside the catalogue's: from installed packages, by entry point, and from files of their own.

A file is Python and is run, so it is only read where a command or a model names it.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from labnnum.errors import ConfigError, FileError
from labnnum.mechanisms import CATALOGUE, Mechanism

GROUP = "labnnum.mechanisms"
PREFIX = "labnnum_own_"
TEXTS = ("id", "title", "equation", "shows", "told_apart", "symbol", "reference")


def catalogue(files: Iterable[str | Path] = ()) -> tuple[Mechanism, ...]:
    """The catalogue, then the mechanisms of installed packages (entry points "labnnum.mechanisms") and of `files`.

    Raises
    ------
    FileError
        If a file is missing or cannot be run.
    ConfigError
        If a mechanism lacks one of its texts, or has the id of another.
    """
    found = list(CATALOGUE)
    for entry in entry_points(group=GROUP):
        found += _checked(_instances(entry.load()), f"entry point {entry.name!r}")
    for path in dict.fromkeys(Path(f).resolve() for f in files):
        found += _checked(from_file(path), str(path))
    ids = [m.id for m in found]
    for name in ids:
        if ids.count(name) > 1:
            raise ConfigError(f"two mechanisms have the id {name!r}; give yours another")
    return tuple(found)


def from_file(path: Path) -> list[Mechanism]:
    """The mechanisms that a Python file defines: one of each concrete subclass of `Mechanism`."""
    if not path.is_file():
        raise FileError(f"{path}: no such file; a mechanism is one Python file")
    spec = spec_from_file_location(f"{PREFIX}{path.stem}", path)
    if spec is None or spec.loader is None:
        raise FileError(f"{path}: is no Python file; a mechanism's file ends in .py")
    module = module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise FileError(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    own = [
        c for c in vars(module).values()
        if inspect.isclass(c) and issubclass(c, Mechanism) and not inspect.isabstract(c)
        and c.__module__ == module.__name__
    ]  # fmt: skip
    if not own:
        raise FileError(f"{path}: defines no mechanism; expected a subclass of labnnum.mechanisms.Mechanism")
    return [c() for c in own]


def source_of(mechanism: Mechanism) -> Path | None:
    """The user's file that a mechanism came from; None if it is of a package."""
    if not type(mechanism).__module__.startswith(PREFIX):
        return None
    return Path(type(mechanism).terms.__code__.co_filename)


def sources(entries: Sequence[Mapping[str, Any]], folder: Path) -> list[Path]:
    """Files that a model's [[mechanism]] entries name by `file`, relative to the model's folder."""
    return [folder / str(e["file"]) for e in entries if e.get("file")]


def _instances(loaded: Any) -> list[Any]:
    several = loaded if isinstance(loaded, list | tuple) else [loaded]
    return [m() if inspect.isclass(m) else m for m in several]


def _checked(mechanisms: Sequence[Any], where: str) -> list[Mechanism]:
    for m in mechanisms:
        if not isinstance(m, Mechanism):
            raise ConfigError(f"{where}: {m!r} is no mechanism; expected a subclass of labnnum.mechanisms.Mechanism")
        for name in TEXTS:
            if not str(getattr(m, name, "")).strip():
                raise ConfigError(f"{where}: mechanism {type(m).__name__} has no {name}; it needs {', '.join(TEXTS)}")
    return list(mechanisms)
