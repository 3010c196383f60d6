"""Universal files, dataset 58: writing, ASCII and binary, in double precision.

pyuff's writer is not used: it rounds the spacing to six digits, states half the bytes of complex binary data,
turns NaN to 0 in the caller's arrays and leaves a 7-byte file when it overwrites in binary. Where the standard has
no place for something (exact spacing, quantity, role, node names, period), an ID line holds it as JSON, which
other programs show as text.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording
from sessions.exchange.uff import AXES, COHERENCE, FRF, MULTIPLE_COHERENCE, QUANTITIES, TIME
from sessions.exchange.uff_meaning import usual_role
from sessions.units import infer_quantity

_CODES = {quantity: code for code, quantity in QUANTITIES.items() if code != 9}
_CODES |= {"angle": 8, "angular_velocity": 11, "angular_acceleration": 12, "moment": 13}
_TIME_AXIS, _FREQUENCY_AXIS = (17, "Time", "s"), (18, "Frequency", "Hz")


@dataclass(frozen=True, eq=False)
class _Set:
    kind: int
    x: NDArray[np.float64]
    data: NDArray
    output: Channel
    input: Channel | None
    abscissa: tuple[int, str, str]
    unit: str
    notes: dict[str, Any]
    version: int = 0


def write_recordings(path: Path, recordings: list[Recording], binary: bool = True) -> None:
    """Each channel of each contiguous usable stretch as a time response; excluded stretches are left out."""
    sets: list[_Set] = []
    for recording in recordings:
        for start, stop in recording.spans():
            sets += _time_sets(recording, start, stop, len({s.version for s in sets}) + 1)
    _write(path, sets, binary)


def _time_sets(recording: Recording, start: int, stop: int, version: int) -> Iterator[_Set]:
    x = np.arange(stop - start) / recording.rate
    notes: dict[str, Any] = {"run": version, "rate": recording.rate}
    if recording.period:
        notes |= {"period": recording.period, "drop": recording.drop_periods}
    if not math.isnan(recording.level):
        notes["level"] = recording.level
    for channel, row in zip(recording.channels, recording.data, strict=True):
        yield _Set(TIME, x, row[start:stop], channel, None, _TIME_AXIS, channel.unit, notes, version)


def write_frf(path: Path, frf: Frf, binary: bool = True) -> None:
    """Every pair of an FRF, its coherence and its variance; axes and values as they are, uneven or not."""
    sets = []
    told = {"est": frf.estimator} | ({} if math.isnan(frf.n_averages) else {"avg": frf.n_averages})
    for o, output in enumerate(frf.outputs):
        for i, inp in enumerate(frf.inputs):
            unit = output.unit
            sets.append(_Set(FRF, frf.frequency, frf.value[o, i], output, inp, _FREQUENCY_AXIS, unit, told))
            if frf.variance is not None:
                note = {"what": "variance"}
                sets.append(_Set(0, frf.frequency, frf.variance[o, i], output, inp, _FREQUENCY_AXIS, "", note))
        if frf.coherence is not None:
            kind = COHERENCE if len(frf.inputs) == 1 else MULTIPLE_COHERENCE
            only = frf.inputs[0] if kind == COHERENCE else None
            sets.append(_Set(kind, frf.frequency, frf.coherence[o], output, only, _FREQUENCY_AXIS, "1", {}))
    _write(path, sets, binary)


def _write(path: Path, sets: list[_Set], binary: bool) -> None:
    if not sets:
        raise FileError(f"{path}: there is nothing to export")
    with path.open("wb") as file:
        for one in sets:
            _write_set(file, one, binary)


def _write_set(file: BinaryIO, one: _Set, binary: bool) -> None:
    spacing = _spacing(one.x)
    values = _interleaved(one, even=spacing is not None)
    mark = f"{-1:6d}\n"
    head = f"{58:6d}"
    if binary:
        head += f"b{1:6d}{2:6d}{11:12d}{values.nbytes:12d}{0:6d}{0:6d}{0:12d}{0:12d}"
    file.write((mark + head.ljust(80) + "\n" + "\n".join(_records(one, spacing)) + "\n").encode("latin-1", "replace"))
    if binary:
        file.write(values.astype("<f8").tobytes())
    else:
        _write_ascii(file, values, one, spacing is not None)
    file.write(mark.encode())


def _spacing(x: NDArray) -> tuple[float, float] | None:
    """First and step of an axis that is even to rounding, else None."""
    if x.size < 2:
        return None
    first, step = float(x[0]), float(x[-1] - x[0]) / (x.size - 1)
    even = first + step * np.arange(x.size)
    return (first, step) if np.abs(even - x).max() <= 4 * np.finfo(float).eps * np.abs(x).max() else None


def _interleaved(one: _Set, even: bool) -> NDArray[np.float64]:
    columns = [] if even else [one.x]
    columns += [np.real(one.data), np.imag(one.data)] if np.iscomplexobj(one.data) else [one.data]
    return np.column_stack(columns).astype(float).reshape(-1)


def _records(one: _Set, spacing: tuple[float, float] | None) -> Iterator[str]:
    """Records 1 to 11."""
    notes = one.notes | _note("out", one.output, 1) | _note("in", one.input, 2)
    if spacing is not None and "rate" not in notes:
        notes |= {"x0": spacing[0], "dx": spacing[1]}
    name = one.output.name if one.input is None else f"{one.output.name} / {one.input.name}"
    second, fourth, fifth = _packed(notes)
    stamp = datetime.now().strftime("%d-%b-%y %H:%M:%S")
    yield from (name[:80].strip() or "NONE", second, stamp, fourth, fifth)
    yield (
        f"{one.kind:5d}{0:10d}{one.version:5d}{0:10d} {_dof(one.output)} {_dof(one.input)}"
    )  # fmt: skip
    first, step = spacing or (0.0, 0.0)
    kind = 6 if np.iscomplexobj(one.data) else 4
    yield f"{kind:10d}{one.x.size:10d}{int(spacing is not None):10d}{_e13(first)}{_e13(step)}{_e13(0.0)}"
    yield _axis(*one.abscissa)
    yield _axis(_CODES.get(one.output.quantity, 0) if one.unit not in ("", "1") else 0, one.output.quantity, one.unit)
    below = one.input if one.kind == FRF else None
    yield _axis() if below is None else _axis(_CODES.get(below.quantity, 0), below.quantity, below.unit)
    yield _axis()


def _packed(notes: dict[str, Any]) -> list[str]:
    """Notes as JSON in three lines of at most 80 characters."""
    lines: list[dict[str, Any]] = [{}]
    for key, value in notes.items():
        if len(_json({**lines[-1], key: value})) > 80 and lines[-1]:
            lines.append({})
        if len(_json({key: value})) <= 80:
            lines[-1][key] = value
    if len(lines) > 3:
        raise FileError(f"channel {notes.get('out', {})} has names too long for a universal file; shorten them")
    return [_json(line) for line in lines] + ["NONE"] * (3 - len(lines))


def _json(notes: dict[str, Any]) -> str:
    return json.dumps(notes, ensure_ascii=False, separators=(",", ":")) if notes else "NONE"


def _note(side: str, channel: Channel | None, number: int) -> dict[str, Any]:
    """What the standard's fields do not tell of a channel."""
    if channel is None:
        return {}
    said = {"name": channel.name}
    if infer_quantity(channel.unit) != channel.quantity:
        said["q"] = channel.quantity
    if channel.role != usual_role(number, channel.quantity):
        said["r"] = channel.role
    if channel.node and not channel.node.isdigit():
        said["n"] = channel.node
    return {side: said}


def _dof(channel: Channel | None) -> str:
    """Entity name, node and direction; a node that is no number stands as entity."""
    if channel is None:
        return f"{'NONE':<10s}{0:10d}{0:4d}"
    number = int(channel.node) if channel.node.isdigit() else 0
    entity = "NONE" if number or not channel.node else channel.node[:10]
    axis = channel.direction.lstrip("+-")
    code = AXES.index(axis) * int(channel.sign) if axis else 0
    return f"{entity:<10s}{number:10d}{code:4d}"


def _axis(kind: int = 0, label: str = "NONE", unit: str = "NONE") -> str:
    return f"{kind:10d}{0:5d}{0:5d}{0:5d} {label[:20] or 'NONE':<20s} {unit[:20] or 'NONE':<20s}"


def _e13(value: float) -> str:
    """A number in 13 columns, seven digits: one more than E13.5 and still in its field."""
    return f"{value:13.6E}"


def _write_ascii(file: BinaryIO, values: NDArray, one: _Set, even: bool) -> None:
    if even:
        pattern = ["%20.12E"] * 4
    else:
        pattern = ["%13.6E", "%20.12E", "%20.12E"] if np.iscomplexobj(one.data) else ["%13.6E", "%20.12E"] * 2
    whole = values.size - values.size % len(pattern)
    np.savetxt(file, values[:whole].reshape(-1, len(pattern)), fmt="".join(pattern), delimiter="", newline="\n")
    if whole < values.size:
        rest = values[whole:]
        file.write(("".join(pattern[: rest.size]) % tuple(rest) + "\n").encode())
