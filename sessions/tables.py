"""Small things of a session file: texts, JSON, channel tables and growing tables, as HDF5 holds them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError
from labnnum.recording import Channel

Node = Any
"""A group or dataset of h5py, whose static types do not tell which."""

TEXT = h5py.string_dtype()


def plain(value: Any) -> Any:
    """`value` as lists, dicts, numbers and strings that JSON can hold; complex numbers become [re, im]."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(v) for v in value]
    if isinstance(value, complex):
        return [value.real, value.imag]
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)


def write_text(group: Node, name: str, text: str) -> None:
    """A scalar UTF-8 string dataset."""
    group.create_dataset(name, data=text, dtype=TEXT)


def read_text(group: Node, name: str) -> str:
    """The string dataset `name`; "" if there is none."""
    return group[name].asstr()[()] if name in group else ""


def write_json(group: Node, name: str, value: Any) -> None:
    """`value` as a JSON string dataset."""
    write_text(group, name, json.dumps(plain(value), ensure_ascii=False))


def read_json(group: Node, name: str) -> Any:
    """What `write_json` wrote; {} if there is none."""
    text = read_text(group, name)
    return json.loads(text) if text else {}


def new_table(group: Node, name: str, columns: Sequence[tuple[Any, ...]], chunk: int = 256) -> Node:
    """An empty table that can grow."""
    return group.create_dataset(name, (0,), dtype=np.dtype(list(columns)), maxshape=(None,), chunks=(chunk,))


def append_row(table: Node, row: tuple[Any, ...]) -> int:
    """Add one row; its number."""
    n = table.shape[0]
    table.resize((n + 1,))
    table[n] = np.array(row, dtype=table.dtype)
    return n


@dataclass(frozen=True, slots=True)
class StoredChannel:
    """A channel as stored: samples in SI units are (raw - offset) * scale.

    Parameters
    ----------
    channel : Channel
    raw_unit : str
        Unit that the raw samples are in.
    scale : float
        SI units per raw unit; 1 / sensitivity where raw is volts.
    offset : float
        Subtracted from raw first, in raw units.
    full_scale : float
        End of the input range, in raw units; NaN if unknown.
    """

    channel: Channel
    raw_unit: str = "V"
    scale: float = 1.0
    offset: float = 0.0
    full_scale: float = float("nan")

    @property
    def exact(self) -> bool:
        """Whether raw samples are SI already."""
        return self.scale == 1.0 and self.offset == 0.0

    def to_si(self, raw: NDArray) -> NDArray[np.float64]:
        """Raw samples in the channel's SI unit."""
        return np.asarray(raw, float) if self.exact else (np.asarray(raw, float) - self.offset) * self.scale


def stored(channel: Channel | StoredChannel, unit: str, full_scale: float = float("nan")) -> StoredChannel:
    """How a channel is stored whose raw samples are volts ("V") or SI units already ("SI")."""
    if isinstance(channel, StoredChannel):
        return channel
    if unit == "SI":
        return StoredChannel(channel, channel.unit, full_scale=full_scale)
    if channel.sensitivity is None and channel.quantity != "voltage":
        raise ChannelError(
            f"channel {channel.name!r} has no sensitivity, so its volts cannot become {channel.unit}:"
            f" give volts per {channel.unit}"
        )
    return StoredChannel(channel, "V", 1.0 / (channel.sensitivity or 1.0), full_scale=full_scale)


_CHANNEL = (
    ("name", TEXT),
    ("quantity", TEXT),
    ("role", TEXT),
    ("node", TEXT),
    ("direction", TEXT),
    ("sensitivity", "f8"),
    ("raw_unit", TEXT),
    ("scale", "f8"),
    ("offset", "f8"),
    ("full_scale", "f8"),
)


def write_channels(group: Node, name: str, channels: Sequence[StoredChannel]) -> None:
    """The channel table of a run or an FRF."""
    rows = [
        (
            *(c.channel.name, c.channel.quantity, c.channel.role, c.channel.node, c.channel.direction),
            *(float("nan") if c.channel.sensitivity is None else c.channel.sensitivity,),
            *(c.raw_unit, c.scale, c.offset, c.full_scale),
        )
        for c in channels
    ]
    group.create_dataset(name, data=np.array(rows, dtype=np.dtype(list(_CHANNEL))))


def read_channels(group: Node, name: str) -> tuple[StoredChannel, ...]:
    """What `write_channels` wrote."""
    return tuple(_channel(row) for row in group[name][:])


def _channel(row: Any) -> StoredChannel:
    text: dict[str, Any] = {k: _str(row[k]) for k in ("name", "quantity", "role", "node", "direction")}
    sensitivity = None if np.isnan(row["sensitivity"]) else float(row["sensitivity"])
    channel = Channel(**text, sensitivity=sensitivity)
    numbers = (float(row[k]) for k in ("scale", "offset", "full_scale"))
    return StoredChannel(channel, _str(row["raw_unit"]), *numbers)


def _str(value: bytes | str) -> str:
    return value.decode() if isinstance(value, bytes) else value
