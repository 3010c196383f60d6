"""What the functions of a universal file mean: recordings, or FRFs with their coherence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError, UnitError
from labnnum.frf import Frf
from labnnum.recording import Channel, Role
from sessions.exchange.arrays import Arrays, even_rate
from sessions.exchange.imported import ImportedRun
from sessions.exchange.uff import (
    COHERENCE,
    FRF,
    MULTIPLE_COHERENCE,
    QUANTITIES,
    TIME,
    TURNING,
    Function,
    direction,
    read_functions,
    unit_scales,
)  # fmt: skip
from sessions.tables import StoredChannel
from sessions.units import conversion, infer_quantity, normal


def read(path: Path) -> Arrays:
    """Functions by name and in order, for a channels.toml that says what they are."""
    functions = read_functions(path)
    names = _unique([f.title for f in functions])
    arrays: dict[str, NDArray] = {name: f.data for name, f in zip(names, functions, strict=True)}
    if functions and functions[0].kind == FRF:
        arrays |= {"f": functions[0].x}
    rate = _rate(functions[0]) if functions and functions[0].kind == TIME else float("nan")
    return Arrays(path, arrays, rate)


def _unique(names: Sequence[str]) -> list[str]:
    """Names with #2, #3, ... where one comes again."""
    out: list[str] = []
    for name in names:
        count, told = 1, name
        while told in out:
            count, told = count + 1, f"{name} #{count + 1}"
        out.append(told)
    return out


def _rate(function: Function) -> float:
    if function.spacing is None:
        return even_rate(function.x, f"function {function.number}")[0]
    rate = function.notes.get("rate", 1.0 / function.spacing[1])
    return float(round(rate)) if abs(rate - round(rate)) < 1e-6 * rate else rate


def _channel(function: Function, side: int, name: str, scales: dict[str, float]) -> StoredChannel:
    """The channel at a function's response (side 1) or reference (side 2), with its way to SI."""
    _, node, code = function.response if side == 1 else function.reference
    unit, kind = function.units[side], QUANTITIES.get(function.types[side], "")
    note = function.notes.get("out" if side == 1 else "in", {})
    axis = direction(code)
    quantity = note.get("q") or infer_quantity(unit) or kind or ("force" if side == 2 else "acceleration")
    if not note and axis.lstrip("-").startswith("r") and kind:
        quantity = TURNING.get(quantity, quantity)
    role = note.get("r") or usual_role(side, quantity)
    where = note.get("n", str(node) if node else "")
    try:
        c = conversion(unit, quantity)
    except UnitError:
        unit, c = "", conversion("", quantity)
    scale = c.scale if unit else scales.get(quantity, 1.0)
    return StoredChannel(Channel(name, quantity, role, where, axis), normal(unit) or "file units", scale, c.offset)


def usual_role(side: int, quantity: str) -> Role:
    """The role of a channel at a function's response (1) or reference (2), if nothing else tells it."""
    return "reference" if side == 2 or quantity in ("force", "moment") else "response"


def to_recordings(path: Path, functions: Sequence[Function]) -> list[ImportedRun]:
    """Time responses as runs: those that share time axis and run number are the channels of one."""
    scales = unit_scales(path)
    groups: dict[tuple, list[Function]] = {}
    for f in functions:
        if f.kind == TIME:
            groups.setdefault((f.notes.get("run", 0), f.version, f.x.size, f.x[0], f.x[-1]), []).append(f)
    return [_run(path, group, scales, i, len(groups)) for i, group in enumerate(groups.values(), 1)]


def _run(path: Path, group: Sequence[Function], scales: dict[str, float], number: int, count: int) -> ImportedRun:
    names = _unique([f.title for f in group])
    channels = tuple(_channel(f, 1, name, scales) for f, name in zip(group, names, strict=True))
    note = group[0].notes
    label = path.name if count == 1 else f"{path.name} run {number}"
    return ImportedRun(
        channels, np.array([f.data for f in group]), _rate(group[0]), label,
        note.get("period", 0), note.get("drop", 0), note.get("level", float("nan")),
    )  # fmt: skip


def to_frf(path: Path, functions: Sequence[Function]) -> Frf:
    """FRFs, with their coherence, of all pairs of response and reference that the file holds.

    Raises
    ------
    FileError
        If a pair is missing, or their frequencies differ.
    """
    scales = unit_scales(path)
    frfs = [f for f in functions if f.kind == FRF]
    outputs = _side(frfs, 1, scales)
    inputs = _side(frfs, 2, scales)
    x = frfs[0].x
    value = np.full((len(outputs), len(inputs), x.size), np.nan, complex)
    for f in frfs:
        if not np.array_equal(f.x, x):
            raise FileError(f"{path}: function {f.number} has other frequencies than function {frfs[0].number}")
        o, i = list(outputs).index(_key(f, 1)), list(inputs).index(_key(f, 2))
        if not np.isnan(value[o, i, 0]):
            raise FileError(f"{path}: function {f.number} is a second FRF of the same response and reference")
        value[o, i] = f.data * outputs[_key(f, 1)].scale / inputs[_key(f, 2)].scale
    if np.isnan(value).all(axis=2).any():
        o, i = np.argwhere(np.isnan(value).all(axis=2))[0]
        names = [list(side.values())[k].channel.name for side, k in ((outputs, o), (inputs, i))]
        raise FileError(f"{path}: there is no FRF of response {names[0]!r} to reference {names[1]!r}")
    averages = frfs[0].notes.get("avg", float("nan"))
    estimator = frfs[0].notes.get("est", "imported")
    variance = _beside(functions, outputs, inputs, x, value.shape)
    return Frf(
        x,
        value,
        _plain(outputs),
        _plain(inputs),
        _coherence(functions, outputs, x),
        variance,
        averages,
        estimator,
        {"source": path.name},
    )


def _key(function: Function, side: int) -> tuple:
    note = function.notes.get("out" if side == 1 else "in", {})
    return (function.response, function.reference)[side - 1], note.get("name", "")


def _side(frfs: Sequence[Function], side: int, scales: dict[str, float]) -> dict[tuple, StoredChannel]:
    """Channels at one side, each once, in the order in which they come."""
    first = {_key(f, side): f for f in reversed(frfs)}
    order = [k for k in dict.fromkeys(_key(f, side) for f in frfs)]
    names = _unique([_name(first[k], side) for k in order])
    return {k: _channel(first[k], side, name, scales) for k, name in zip(order, names, strict=True)}


def _name(function: Function, side: int) -> str:
    entity, node, code = function.response if side == 1 else function.reference
    note = function.notes.get("out" if side == 1 else "in", {})
    kind = "f" if side == 2 else "a"
    return note.get("name") or entity or (f"{kind}{node}{direction(code)}" if node else f"{kind}")


def _plain(side: dict[tuple, StoredChannel]) -> tuple[Channel, ...]:
    return tuple(c.channel for c in side.values())


def _coherence(functions: Sequence[Function], outputs: dict[tuple, StoredChannel], x: NDArray) -> NDArray | None:
    told = {_key(f, 1): f.data for f in functions if f.kind in (COHERENCE, MULTIPLE_COHERENCE) and f.x.size == x.size}
    rows = [told.get(key) for key in outputs]
    return np.array([np.real(r) for r in rows if r is not None]) if all(r is not None for r in rows) else None


def _beside(
    functions: Sequence[Function], outputs: dict[tuple, Any], inputs: dict[tuple, Any], x: NDArray, shape: tuple
) -> NDArray | None:
    """Variance, which only files of `uff_write` carry."""
    found = [f for f in functions if f.kind == 0 and f.notes.get("what") == "variance" and f.x.size == x.size]
    if len(found) != shape[0] * shape[1]:
        return None
    out = np.zeros(shape)
    for f in found:
        out[list(outputs).index(_key(f, 1)), list(inputs).index(_key(f, 2))] = f.data
    return out
