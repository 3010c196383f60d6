"""TOML text from plain tables: the counterpart of tomllib, for the files that labnnum writes itself."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from labnnum.errors import ConfigError

_BARE = re.compile(r"^[A-Za-z0-9_-]+$")


def dumps(table: Mapping[str, Any]) -> str:
    """TOML text of nested mappings, sequences, strings, numbers and booleans; None is left out.

    Examples
    --------
    >>> print(dumps({"structure": {"kind": "chain", "mass": [{"node": "1", "mass": 2.0}]}}), end="")
    [structure]
    kind = "chain"
    <BLANKLINE>
    [[structure.mass]]
    node = "1"
    mass = 2.0
    """
    lines: list[str] = []
    _write(table, "", lines)
    return "\n".join(lines).strip("\n") + "\n"


def _write(table: Mapping[str, Any], prefix: str, lines: list[str]) -> None:
    nested = {k: v for k, v in table.items() if _is_table(v) or _is_tables(v)}
    for key, value in table.items():
        if key not in nested and value is not None:
            lines.append(f"{_key(key)} = {_value(value, prefix + key)}")
    for key, value in nested.items():
        name = prefix + _key(key)
        if _is_table(value):
            lines += ["", f"[{name}]"]
            _write(value, name + ".", lines)
        else:
            for entry in value:
                lines += ["", f"[[{name}]]"]
                _write(entry, name + ".", lines)


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_tables(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str) and bool(value) and all(map(_is_table, value))


def _key(key: str) -> str:
    return key if _BARE.match(key) else json.dumps(key, ensure_ascii=False)


def _value(value: Any, where: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float) or hasattr(value, "__float__"):
        text = repr(float(value))
        return text if any(c in text for c in ".en") else text + ".0"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v, where)}" for k, v in value.items() if v is not None) + " }"
    if isinstance(value, Sequence):
        return "[" + ", ".join(_value(v, where) for v in value) + "]"
    raise ConfigError(f"{where}: a {type(value).__name__} has no place in a TOML file")
