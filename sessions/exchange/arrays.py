"""What a measurement file holds before anyone says what it means: named arrays, perhaps a rate."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, FileError

_INDEX = re.compile(r"^(?P<key>.*)\[(?P<index>[-\d:,\s]+)\]$", re.DOTALL)
_TIME_NAMES = ("time", "t", "Time", "TIME")


@dataclass(frozen=True, eq=False)
class Arrays:
    """Arrays of a file by name, in the file's order.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to ndarray
        Columns of a table stand as rows of "data", and under their headings where it has any.
    rate : float
        Samples per second, as the file itself says; NaN if it does not.
    channels : str
        Text of the channels.toml that the file carries; "" if none.
    parts : bool
        Whether samples are parts of full scale, as in sound files.
    """

    path: Path
    arrays: Mapping[str, NDArray] = field(default_factory=dict)
    rate: float = float("nan")
    channels: str = ""
    parts: bool = False

    @property
    def table(self) -> NDArray | None:
        """The array that holds all channels as rows: "data", or the only one with two dimensions."""
        if "data" in self.arrays and self.arrays["data"].ndim == 2:
            return _upright(self.arrays["data"])
        flat = [a for a in self.arrays.values() if np.squeeze(a).ndim == 2 and min(a.shape) > 1]
        if len(flat) == 1:
            return _upright(np.squeeze(flat[0]))
        only = list(self.arrays.values())
        return only[0].reshape(1, -1) if len(only) == 1 and np.squeeze(only[0]).ndim == 1 else None

    def pick(self, source: str | int, what: str) -> NDArray:
        """The array, row or column that `source` names: 2, "force", "Acceleration[0]", "data[:,1]".

        Raises
        ------
        ChannelError
            If there is none; it lists what there is. `what` says for whom.
        """
        if isinstance(source, int):
            return self._row(source, what)
        if source in self.arrays:
            return np.squeeze(self.arrays[source])
        match = _INDEX.match(source)
        if match is None or match["key"] not in self.arrays:
            raise ChannelError(f"{self.path}: {what}: there is no array {source!r}; there are {self.names()}")
        array = self.arrays[match["key"]]
        try:
            return np.squeeze(array[tuple(_slice(part) for part in match["index"].split(","))])
        except (IndexError, ValueError) as error:
            raise ChannelError(f"{self.path}: {what}: {source!r} lies outside an array of {array.shape}") from error

    def names(self) -> str:
        """What there is, for messages."""
        shown = [f"{k}{list(v.shape)}" if v.ndim > 1 else k for k, v in self.arrays.items()]
        return ", ".join(shown[:20]) + (", ..." if len(shown) > 20 else "") if shown else "none"

    def scalar(self, source: str, what: str) -> float:
        """A single number of the file."""
        value = np.asarray(self.pick(source, what))
        if value.size != 1:
            raise ChannelError(f"{self.path}: {what}: {source!r} holds {value.size} numbers where one is needed")
        return float(np.real(value.reshape(-1)[0]))

    def time_axis(self) -> str | None:
        """An array that is called time and is as long as the others."""
        return next((n for n in _TIME_NAMES if n in self.arrays and np.squeeze(self.arrays[n]).ndim == 1), None)

    def _row(self, number: int, what: str) -> NDArray:
        table = self.table
        rows = list(table) if table is not None else [np.squeeze(a) for a in self.arrays.values()]
        if not -len(rows) <= number < len(rows):
            raise ChannelError(
                f"{self.path}: {what}: there is no row or column {number}; there are {len(rows)}, counted from 0"
            )
        return rows[number]


def _upright(table: NDArray) -> NDArray:
    """Channels as rows: a recording has more samples than channels."""
    return table.T if table.shape[0] > table.shape[1] else table


def _slice(part: str) -> int | slice:
    if ":" not in part:
        return int(part)
    return slice(*(int(p) if p.strip() else None for p in part.split(":")))


def even_rate(time: NDArray, where: str) -> tuple[float, tuple[int, ...]]:
    """Samples per second of a time axis, and the samples before which it jumps.

    Raises
    ------
    FileError
        If it does not ascend, or its steps differ.
    """
    step = np.diff(np.asarray(time, float))
    if step.size == 0 or not np.isfinite(step).all() or np.median(step) <= 0:
        raise FileError(f"{where} must be a time axis in s that ascends")
    usual = float(np.median(step))
    jumps = np.flatnonzero(np.abs(step - usual) > 0.5 * usual) + 1
    if jumps.size > max(1, step.size // 100) or (step <= 0).any():
        at = int(jumps[0])
        raise FileError(
            f"{where} is uneven, first at sample {at} (a step of {step[at - 1]:g} s where {usual:g} is usual):"
            " resample it first, or give sample_rate"
        )
    whole = step if not jumps.size else step[np.abs(step - usual) <= 0.5 * usual]
    rate = 1.0 / float(whole.mean())
    return (float(round(rate)) if abs(rate - round(rate)) < 1e-5 * rate else rate), tuple(int(j) for j in jumps)
