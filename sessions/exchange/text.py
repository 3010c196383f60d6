"""Text tables (CSV, TSV, TXT, any usual separator, with or without headings) and JSON tables."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError
from sessions.exchange.arrays import Arrays

_COMMENT = ("#", "%", "//")
_SEPARATORS = ("\t", ";", ",", None)


def read(path: Path) -> Arrays:
    """Columns of a text table as rows of "data", and under their headings.

    Separator, decimal comma and headings are found from the first lines. Comment lines begin with # or %;
    those that form a channels.toml, as `write` makes them, are one.

    Raises
    ------
    FileError
        If there are no numbers, or a line has another number of columns: it is named.
    """
    lines = _decode(path).splitlines()
    told = "\n".join(line[2:] for line in lines if line.startswith("#:"))
    first, separator = _first_numbers(path, lines)
    heads = _headings(lines[:first], separator, len(_cells(lines[first], separator)))
    table = _numbers(path, lines, first, separator)
    arrays: dict[str, NDArray] = {"data": table}
    arrays |= {head: row for head, row in zip(heads, table, strict=False) if head and head != "data"}
    return Arrays(path, arrays, channels=told + "\n" if told else "")


def _decode(path: Path) -> str:
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from error
    if b"\0" in raw[:4096] and not raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FileError(f"{path}: is binary, not text; name the file by its format (.npz, .mat, .wav, .uff, ...)")
    for encoding in ("utf-16",) if raw.startswith((b"\xff\xfe", b"\xfe\xff")) else ("utf-8-sig", "latin-1"):
        try:
            return raw.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise FileError(f"{path}: its encoding is unknown; save it as UTF-8")


def _cells(line: str, separator: str | None) -> list[str]:
    text = line.strip()
    split = text.split() if separator is None else next(csv.reader([text], delimiter=separator), [])
    cells = [c.strip() for c in split]
    return cells[:-1] if len(cells) > 1 and cells[-1] == "" and separator is not None else cells


def _number(cell: str, separator: str | None) -> bool:
    try:
        float(cell.replace(",", ".") if separator != "," else cell)
    except ValueError:
        return cell == ""
    return True


def _first_numbers(path: Path, lines: Sequence[str]) -> tuple[int, str | None]:
    """Line and separator at which numbers begin."""
    for i, line in enumerate(lines):
        if not line.strip() or line.lstrip().startswith(_COMMENT):
            continue
        for separator in _SEPARATORS:
            cells = _cells(line, separator)
            if separator is not None and len(cells) < 2:
                continue
            if all(_number(c, separator) for c in cells) and any(cells):
                return i, separator
    raise FileError(f"{path}: no line of it holds numbers only; it is no table of measurements")


def _headings(before: Sequence[str], separator: str | None, count: int) -> list[str]:
    """The last line before the numbers that has as many cells as they have columns; [] if none."""
    for line in reversed(before):
        text = line.strip()
        if not text or text.startswith("#:"):
            continue
        cells = _cells(text.lstrip("#%/ "), separator)
        return cells if len(cells) == count and len(set(cells)) == count else []
    return []


def _numbers(path: Path, lines: Sequence[str], first: int, separator: str | None) -> NDArray[np.float64]:
    kept = [(i, line) for i, line in enumerate(lines[first:], first) if line.strip()]
    kept = [(i, line) for i, line in kept if not line.lstrip().startswith(_COMMENT)]
    text = "\n".join(line.strip().removesuffix(separator or "\n") for _, line in kept)
    if separator != "," and "," in text:
        text = text.replace(",", ".")
    if separator is not None:  # an empty cell is a sample that is missing
        text = re.sub(rf"(?:^|(?<={separator})) *(?={separator}|$)", "nan", text, flags=re.MULTILINE)
    try:
        return np.loadtxt(io.StringIO(text), delimiter=separator, ndmin=2, comments=None, dtype=float).T
    except ValueError as error:
        raise _broken(path, kept, separator, error) from error


def _broken(path: Path, kept: Sequence[tuple[int, str]], separator: str | None, error: ValueError) -> FileError:
    """The line that is at fault."""
    count = len(_cells(kept[0][1], separator))
    for i, line in kept:
        cells = _cells(line, separator)
        if len(cells) != count:
            return FileError(f"{path}: line {i + 1} has {len(cells)} columns where {count} are usual; is it truncated?")
        wrong = next((c for c in cells if not _number(c, separator)), None)
        if wrong is not None:
            return FileError(f"{path}: line {i + 1}: {wrong!r} is no number")
    return FileError(f"{path}: cannot be read as numbers ({error})")


def write(path: Path, columns: Mapping[str, NDArray], channels: str) -> None:
    """A CSV file with headings, its channels.toml as comment lines; 17 digits, so numbers to the last bit."""
    table = np.column_stack(list(columns.values()))
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"#:{line}\n" for line in channels.splitlines())
        file.write(",".join(f'"{name}"' if "," in name else name for name in columns) + "\n")
        np.savetxt(file, table, fmt="%.17g", delimiter=",")


def read_json(path: Path) -> Arrays:
    """Arrays and numbers of a JSON object, by key; a list at the top is "data"."""
    try:
        raw = json.loads(path.read_bytes())
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (ValueError, OSError) as error:
        raise FileError(f"{path}: is no JSON or truncated ({error})") from error
    content = raw if isinstance(raw, dict) else {"data": raw}
    arrays = {key: array for key, value in content.items() if (array := _array(path, key, value)) is not None}
    return Arrays(path, arrays)


def _array(path: Path, key: str, value: Any) -> NDArray | None:
    if not isinstance(value, (list, int, float)) or isinstance(value, bool):
        return None
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise FileError(f"{path}: {key!r} holds rows of different lengths; is it truncated?") from error
    return array if array.dtype.kind in "fiu" else None
