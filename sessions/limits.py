"""Thresholds of the diagnosis for one rig: what its own sound structure does, kept beside rig.toml."""

from __future__ import annotations

import tomllib
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from labnnum.diagnosis import Limits, Scatter
from labnnum.errors import ConfigError, FileError

SUFFIX = ".diagnosis.toml"

COMPUTED = {"common", "rows"}
"""Fields that a diagnosis finds by itself."""

RETIRED = {"plain"}
"""Keys that files written earlier hold and nothing reads any more."""


def limits_path(rig: str | Path) -> Path:
    """Where the limits of a rig are kept: rig.toml -> rig.diagnosis.toml; a file of limits is itself."""
    path = Path(rig)
    return path if path.name.endswith(SUFFIX) else path.with_name(path.stem + SUFFIX)


def read_limits(rig: str | Path) -> tuple[Scatter, Limits]:
    """Scatter and limits of a rig; the shipped ones where it was not calibrated.

    Raises
    ------
    FileError
        If the rig file itself is missing.
    ConfigError
        If a key is unknown or no number.
    """
    path = limits_path(rig)
    if not path.exists():
        if not Path(rig).exists():
            raise FileError(f"{rig}: no such rig file")
        return Scatter(), Limits()
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not TOML: {error}") from error
    return _build(path, Scatter, tables.get("scatter", {})), _build(path, Limits, tables.get("limits", {}))


def _build(path: Path, kind: type[Scatter] | type[Limits], table: dict[str, Any]) -> Any:
    known = {f.name for f in fields(kind)} - COMPUTED
    table = {k: v for k, v in table.items() if k not in RETIRED}
    for key, value in table.items():
        if key not in known:
            raise ConfigError(f"{path}: key {key!r} is unknown; there are {', '.join(sorted(known))}")
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise ConfigError(f"{path}: key {key!r} must be a number, not {value!r}")
    values: dict[str, Any] = {k: float(v) for k, v in table.items()}
    return kind(**values)


def write_limits(rig: str | Path, scatter: Scatter, limits: Limits, note: str) -> Path:
    """Store scatter and limits beside the rig; the path."""
    path = limits_path(rig)
    lines = [f"# {note}", "", "[scatter]"]
    lines += [f"{k} = {v!r}" for k, v in asdict(scatter).items() if k not in COMPUTED]
    lines += ["", "[limits]", *(f"{k} = {v!r}" for k, v in asdict(limits).items())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
