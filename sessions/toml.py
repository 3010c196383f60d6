"""TOML files of the user: read, checked against a pydantic model, refused with the key that is wrong."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from labnnum.errors import ConfigError, FileError


class Table(BaseModel):
    """Base of every table: keys that are no table's own are kept aside, and refused if they look misspelt."""

    model_config = ConfigDict(extra="allow", frozen=True, str_strip_whitespace=True)


T = TypeVar("T", bound=Table)


def read_toml(path: Path) -> str:
    """Text of a TOML file; FileError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from error


def parse(text: str, kind: type[T], name: str) -> T:
    """A TOML text as a `kind`.

    Raises
    ------
    ConfigError
        One line with the file, the key and what was expected; misspelt keys are found by their neighbours.
    """
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{name}: is not TOML: {str(error)[:1].lower()}{str(error)[1:]}") from error
    try:
        table = kind.model_validate(raw)
    except ValidationError as error:
        raise ConfigError(f"{name}: {_first(error, raw)}") from error
    for where, key, known in strangers(table):
        close = difflib.get_close_matches(key, known, 1, 0.75)
        if close:
            raise ConfigError(f"{name}: {where}{key} is no key; did you mean {close[0]!r}?")
    return table


def strangers(table: Table, where: str = "") -> Iterable[tuple[str, str, list[str]]]:
    """Keys that no table has, as (where, key, keys that there are)."""
    fields = type(table).model_fields
    known = [alias for key, field in fields.items() for alias in (field.alias or key, key)]
    for key in table.model_extra or {}:
        yield where, key, known
    for key in fields:
        value = getattr(table, key)
        for i, part in enumerate(value if isinstance(value, tuple) else (value,)):
            if isinstance(part, Table):
                index = f"[{i + 1}]" if isinstance(value, tuple) else ""
                yield from strangers(part, f"{where}{fields[key].alias or key}{index}.")


def _first(error: ValidationError, raw: Mapping[str, Any]) -> str:
    """The first complaint in one line: key, what is wrong, what stands there."""
    one = error.errors()[0]
    key = _key(one["loc"])
    if one["type"] == "missing":
        return f"{key} is missing" + _misspelt(one["loc"], raw)
    said = one["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    shown = one["input"] if isinstance(one["input"], (str, int, float, bool)) else type(one["input"]).__name__
    if one["type"] == "value_error":
        return f"{key}: {said}" if key else said
    return f"{key}: must be {said}, not {shown!r}"


def _key(loc: tuple[int | str, ...]) -> str:
    """("channel", 0, "unit") as "channel[1].unit"; names of union members are left out."""
    out = ""
    for part in loc:
        if isinstance(part, int):
            out += f"[{part + 1}]"
        elif part.replace("_", "").replace("-", "").isalnum():
            out += f".{part}" if out else part
    for member in (".str", ".int", ".float", ".bool", ".dict"):
        out = out.removesuffix(member)
    return out


def _misspelt(loc: tuple[int | str, ...], raw: Any) -> str:
    for part in loc[:-1]:
        if isinstance(raw, list) and isinstance(part, int):
            raw = raw[part]
        else:
            raw = raw.get(part, {}) if isinstance(raw, Mapping) else {}
    there = list(raw) if isinstance(raw, Mapping) else []
    close = difflib.get_close_matches(str(loc[-1]), there, 1, 0.6)
    return f"; did you mean it by {close[0]!r}?" if close else ""
