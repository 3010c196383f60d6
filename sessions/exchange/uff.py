"""Universal files, dataset 58 (functions at nodal degrees of freedom): reading, ASCII and binary.

Functions become recordings (time responses) or FRFs with their coherence; other kinds can be looked at. Units come
from the axis labels where a program wrote them, else from the data type and the units dataset 164. Geometry and
units datasets are read by pyuff; functions are read here, because pyuff loses labels that are not UTF-8, searches
binary data for the end mark, and takes a truncated function for a whole one.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError

TIME, FRF, COHERENCE, MULTIPLE_COHERENCE = 1, 4, 6, 26
KINDS = {
    0: "general", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "frequency response function",
    5: "transmissibility", 6: "coherence", 7: "auto correlation", 8: "cross correlation",
    9: "power spectral density", 10: "energy spectral density", 12: "spectrum", 18: "mode indicator",
    24: "shock response spectrum", 26: "multiple coherence", 27: "order function",
}  # fmt: skip
QUANTITIES = {
    8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force", 15: "pressure",
    5: "temperature", 3: "strain",
}  # fmt: skip
TURNING = {
    "displacement": "angle", "velocity": "angular_velocity", "acceleration": "angular_acceleration", "force": "moment",
}  # fmt: skip
AXES = ("", "x", "y", "z", "rx", "ry", "rz")
_MARK = re.compile(rb"^ {4}-1[ \t]*\r?(?:\n|\Z)", re.MULTILINE)
_MARK_BEHIND_BINARY = re.compile(rb" {4}-1[ \t]*\r?(?:\n|\Z)")


@dataclass(frozen=True, eq=False)
class Function:
    """One function of a universal file, as it stands there.

    Parameters
    ----------
    number : int
        Its place among the file's functions, from 1.
    kind : int
        A key of `KINDS`.
    ids : tuple of str
        The five ID lines.
    response, reference : tuple of (entity name, node, direction code)
    spacing : tuple of (first, step) or None
        None if the abscissa is uneven.
    x, data : ndarray
        Abscissa and ordinate, in the file's units.
    labels, units : tuple of str
        Axis labels and units of abscissa, ordinate and ordinate's denominator; "" where the file says NONE.
    types : tuple of int
        Their specific data types.
    """

    number: int
    kind: int
    ids: tuple[str, ...]
    response: tuple[str, int, int]
    reference: tuple[str, int, int]
    version: int
    spacing: tuple[float, float] | None
    x: NDArray[np.float64]
    data: NDArray
    labels: tuple[str, str, str]
    units: tuple[str, str, str]
    types: tuple[int, int, int]
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """Unit of the ordinate, with its denominator."""
        return f"{self.units[1]}/{self.units[2]}" if self.units[2] else self.units[1]

    @property
    def title(self) -> str:
        """What to call it."""
        dof = f"{self.response[1]}:{direction(self.response[2])}" if self.response[1] else ""
        return (
            self.notes.get("out", {}).get("name") or self.response[0] or dof or self.ids[0] or f"function {self.number}"
        )


def read_functions(path: Path) -> list[Function]:
    """Every function (dataset 58) of a universal file.

    Raises
    ------
    FileError
        If it is no universal file, or a function is truncated or not IEEE; it is named.
    """
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from error
    return [_function(path, raw, start, n) for n, start in enumerate(_datasets(path, raw, 58), 1)]


def dataset_kinds(path: Path) -> list[int]:
    """Numbers of all datasets of a universal file, in order."""
    return [number for number, _ in _walk(path, path.read_bytes())]


def _datasets(path: Path, raw: bytes, wanted: int) -> Iterator[int]:
    return (start for number, start in _walk(path, raw) if number == wanted)


def _walk(path: Path, raw: bytes) -> Iterator[tuple[int, int]]:
    """(number, position after the number's line's start) of each dataset; binary data are stepped over."""
    at, found = 0, False
    while (mark := _MARK.search(raw, at)) is not None:
        start = mark.end()
        line = raw[start : _line_end(raw, start)]
        match = re.match(rb" *(\d+)", line)
        if match is None:
            raise FileError(f"{path}: a dataset without a number at byte {start}; is it truncated?")
        found, number, body, close = True, int(match[1]), start, _MARK
        yield number, start
        if number == 58 and line[6:7].lower() == b"b":
            body, close = _after_lines(raw, start, 12) + _binary_length(raw, start), _MARK_BEHIND_BINARY
        end = close.search(raw, body)
        if end is None:
            raise FileError(f"{path}: dataset {number} at byte {start} has no end mark; the file is truncated")
        at = end.end()
    if not found:
        raise FileError(f"{path}: is no universal file: it has no dataset marks")


def _line_end(raw: bytes, at: int) -> int:
    end = raw.find(b"\n", at)
    return len(raw) if end < 0 else end


def _after_lines(raw: bytes, at: int, count: int) -> int:
    for _ in range(count):
        at = min(_line_end(raw, at) + 1, len(raw))
    return at


def _header(raw: bytes, start: int) -> list[str]:
    """The dataset's line and its eleven records, as text."""
    end = _after_lines(raw, start, 12)
    lines = raw[start:end].decode("latin-1").splitlines()
    return lines + [""] * (12 - len(lines))


def _form(header: Sequence[str]) -> tuple[int, int, int, float, float]:
    """Data type, number of values, spacing, first abscissa, step."""
    text = header[7].ljust(80)
    real = [float(text[i : i + 13].replace("D", "E") or 0) for i in (30, 43)]
    return int(text[:10]), int(text[10:20]), int(text[20:30]), real[0], real[1]


def _count(form: tuple[int, int, int, float, float]) -> int:
    kind, n, spacing = form[:3]
    return n * ((2 if kind in (5, 6) else 1) + (0 if spacing else 1))


def _binary_length(raw: bytes, start: int) -> int:
    form = _form(_header(raw, start))
    return _count(form) * (8 if form[0] in (4, 6) else 4)


def _function(path: Path, raw: bytes, start: int, number: int) -> Function:
    header = _header(raw, start)
    where = f"{path}: function {number} ({header[1].strip() or 'NONE'})"
    try:
        form = _form(header)
        ids = tuple(_text(line) for line in header[1:6])
        kind, version, response, reference = _dofs(header[6])
        labels, units, types = zip(*(_axis(line) for line in header[8:11]), strict=True)
    except ValueError as error:
        raise FileError(f"{where}: its header cannot be read ({error})") from error
    if form[0] not in (2, 4, 5, 6):
        raise FileError(f"{where}: ordinate data type {form[0]} is none of 2, 4, 5, 6")
    body = _after_lines(raw, start, 12)
    values = (
        _binary(where, raw, body, header, form) if header[0][6:7].lower() == "b" else _ascii(where, raw, body, form)
    )
    notes = _notes(ids)
    x, data, spacing = _split(values, form, notes)
    return Function(
        number, kind, ids, response, reference, version, spacing, x, data, labels, units, types, notes
    )  # fmt: skip


def _text(line: str) -> str:
    text = line.strip()
    return "" if text == "NONE" else text


def _dofs(line: str) -> tuple[int, int, tuple[str, int, int], tuple[str, int, int]]:
    text = line.ljust(80)

    def whole(a: int, b: int) -> int:
        return int(text[a:b].strip() or 0)

    response = (_text(text[31:41]), whole(41, 51), whole(51, 55))
    reference = (_text(text[56:66]), whole(66, 76), whole(76, 80))
    return whole(0, 5), whole(15, 20), response, reference


def _axis(line: str) -> tuple[str, str, int]:
    text = line.ljust(80)
    return _text(text[26:46]), _text(text[47:67]), int(text[:10].strip() or 0)


def _binary(where: str, raw: bytes, body: int, header: Sequence[str], form: Any) -> NDArray[np.float64]:
    order, style = int(header[0][7:13]), int(header[0][13:19])
    if style not in (0, 2):
        raise FileError(f"{where}: floating-point format {style} is not IEEE (2); export it as ASCII")
    size = 8 if form[0] in (4, 6) else 4
    need = _count(form) * size
    if body + need > len(raw):
        raise FileError(f"{where}: holds {len(raw) - body} of {need} bytes; the file is truncated")
    return np.frombuffer(raw, f"{'>' if order == 2 else '<'}f{size}", _count(form), body).astype(float)


def _ascii(where: str, raw: bytes, body: int, form: Any) -> NDArray[np.float64]:
    end = _MARK.search(raw, body)
    text = raw[body : end.start() if end else len(raw)].replace(b"D", b"E").replace(b"d", b"e")
    parts = re.sub(rb"(?<=\d)-", b" -", text).split()
    need = _count(form)
    if len(parts) < need:
        raise FileError(f"{where}: holds {len(parts)} of {need} numbers; the file is truncated")
    try:
        return np.array(parts[:need], float)
    except ValueError as error:
        raise FileError(f"{where}: {error}") from error


def _notes(ids: Sequence[str]) -> dict[str, Any]:
    """What `uff_write` says in the ID lines beyond the standard: exact spacing, channels, period, level."""
    out: dict[str, Any] = {}
    for line in ids:
        if line.startswith("{") and line.endswith("}"):
            try:
                out.update(json.loads(line))
            except json.JSONDecodeError:
                continue  # another program's ID line that happens to have braces
    return out


def _split(values: NDArray, form: Any, notes: dict[str, Any]) -> tuple[NDArray, NDArray, Any]:
    kind, n, spacing, first, step = form
    if not spacing:
        table = values.reshape(n, -1)
        x, y = np.ascontiguousarray(table[:, 0]), table[:, 1:]
        return x, (y[:, 0] + 1j * y[:, 1] if kind in (5, 6) else np.ascontiguousarray(y[:, 0])), None
    first, step = notes.get("x0", first), 1.0 / notes["rate"] if "rate" in notes else notes.get("dx", step)
    x = first + step * np.arange(n)
    return x, (values[0::2] + 1j * values[1::2] if kind in (5, 6) else values), (first, step)


def direction(code: int) -> str:
    """A direction code of the standard as "x", "-rz", ...; "" for a scalar."""
    return ("-" if code < 0 else "") + AXES[abs(code)] if 0 < abs(code) <= 6 else ""


def unit_scales(path: Path) -> dict[str, float]:
    """SI units per file unit of each quantity, by the file's dataset 164; {} if there is none or it is SI."""
    if 164 not in dataset_kinds(path):
        return {}
    units = _others(path, 164)[0]
    length, force = 1.0 / units["length"], 1.0 / units["force"]
    motions = {"displacement": length, "velocity": length, "acceleration": length}
    return {**motions, "force": force, "moment": force * length, "pressure": force / length**2}


def nodes(path: Path) -> dict[str, tuple[float, float, float]]:
    """Nodes of datasets 15 and 2411: name -> x, y, z in m."""
    kinds = dataset_kinds(path)
    scale = unit_scales(path).get("displacement", 1.0)
    out: dict[str, tuple[float, float, float]] = {}
    for kind in (15, 2411):
        for found in _others(path, kind) if kind in kinds else []:
            names = found["node_nums"]
            for name, x, y, z in zip(names, found["x"], found["y"], found["z"], strict=True):
                out[str(int(name))] = (float(x) * scale, float(y) * scale, float(z) * scale)
    return out


def _others(path: Path, kind: int) -> list[dict[str, Any]]:
    """Datasets other than 58, by pyuff, which raises nothing more precise than Exception."""
    import pyuff

    try:
        file = pyuff.UFF(str(path))
        return [file.read_sets(i) for i, k in enumerate(file.get_set_types()) if k == kind]
    except Exception as error:
        raise FileError(f"{path}: dataset {kind} cannot be read ({error})") from error
