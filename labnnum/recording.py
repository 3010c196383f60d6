"""Channels and recordings: what was measured, in SI units, with its gaps and overloads."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ChannelError, EstimationError

Role = Literal["reference", "response", "base", "monitor"]
ROLES: tuple[Role, ...] = ("reference", "response", "base", "monitor")

SI_UNITS: dict[str, str] = {
    "force": "N",
    "moment": "N*m",
    "acceleration": "m/s^2",
    "velocity": "m/s",
    "displacement": "m",
    "angular_acceleration": "rad/s^2",
    "angular_velocity": "rad/s",
    "angle": "rad",
    "voltage": "V",
    "pressure": "Pa",
    "temperature": "K",
    "strain": "1",
    "dimensionless": "1",
}
"""SI unit that samples of each quantity are held in."""

DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True, slots=True)
class Channel:
    """One measured signal: what, where, and which part it plays.

    Parameters
    ----------
    name : str
        Unique in its recording.
    quantity : str
        A key of `SI_UNITS`, such as "force" or "acceleration".
    role : {"reference", "response", "base", "monitor"}
        "reference" is an input (force), "base" an input that is the motion of all supports,
        "response" an output; a "monitor" is kept and enters no estimate.
    node, direction : str
        Where on the structure: the node's name, and x, y, z, rx, ry or rz, with a leading "-" when the
        sensor points the other way. Empty where the signal has no place.
    sensitivity : float or None
        Volts per SI unit that raw volts were divided by; None if the file held units already.

    Examples
    --------
    >>> Channel("a3", "acceleration", "response", node="3", direction="-x").dof
    '3:x'
    """

    name: str
    quantity: str = "acceleration"
    role: Role = "response"
    node: str = ""
    direction: str = ""
    sensitivity: float | None = None

    def __post_init__(self) -> None:
        if not self.name:
            raise ChannelError("a channel has an empty name")
        if self.quantity not in SI_UNITS:
            raise ChannelError(f"channel {self.name!r}: quantity {self.quantity!r} is not one of {', '.join(SI_UNITS)}")
        if self.role not in ROLES:
            raise ChannelError(f"channel {self.name!r}: role {self.role!r} is not one of {', '.join(ROLES)}")
        if self.direction and self.direction.lstrip("+-") not in DIRECTIONS:
            raise ChannelError(
                f"channel {self.name!r}: direction {self.direction!r} is not one of {', '.join(DIRECTIONS)},"
                " with an optional sign"
            )

    @property
    def unit(self) -> str:
        """SI unit of the samples."""
        return SI_UNITS[self.quantity]

    @property
    def dof(self) -> str:
        """Degree of freedom as "node:direction" without sign; empty where the channel has no place."""
        axis = self.direction.lstrip("+-")
        return f"{self.node}:{axis}" if self.node and axis else ""

    @property
    def signal(self) -> Channel:
        """The same without its sensitivity, which leaves no trace in samples in SI units: recalibrated, or not."""
        return self if self.sensitivity is None else replace(self, sensitivity=None)

    @property
    def sign(self) -> float:
        """-1.0 if the sensor points against its axis, else 1.0."""
        return -1.0 if self.direction.startswith("-") else 1.0


def readonly(array: ArrayLike, dtype: type = float) -> NDArray:
    """Return a C-contiguous read-only copy of `array` (or itself if it is one already)."""
    out = np.ascontiguousarray(array, dtype=dtype)
    if out.flags.writeable:
        out = out.copy() if out is array or out.base is not None else out
        out.flags.writeable = False
    return out


@dataclass(frozen=True, eq=False)
class Recording:
    """Time signals of all channels of one run, in SI units, read-only.

    Parameters
    ----------
    channels : sequence of Channel
    data : array_like, shape (n_channels, n_samples)
        Samples in each channel's SI unit.
    rate : float
        Samples per second.
    breaks : sequence of int
        Sample numbers at which the record does not continue the sample before: the start of each
        further hit, or of what follows a gap. No segment of an estimate ever spans one.
    excluded : sequence of (start, stop)
        Sample ranges that were recorded and must not enter an estimate (a rejected hit, a known overflow).
    overloads : sequence of (channel number, start, stop)
        Where a channel was at the end of its input range.
    period : int
        Samples in one period of a periodic excitation; 0 if not periodic.
    drop_periods : int
        Periods at the start of each contiguous span that are still transient.
    level : float
        The excitation level that was asked for, in the unit of the plan; NaN if not stated.
    label : str
        Where it came from (file or run), for messages.
    burst : int
        Samples from the start of one burst of noise to that of the next, its silence included; 0 if there are none.
    bursts : sequence of int
        Samples at which a burst begins. A stretch that begins in the midst of one waits for the next.
    """

    channels: tuple[Channel, ...]
    data: NDArray[np.float64]
    rate: float
    breaks: tuple[int, ...] = ()
    excluded: tuple[tuple[int, int], ...] = ()
    overloads: tuple[tuple[int, int, int], ...] = ()
    period: int = 0
    drop_periods: int = 0
    level: float = float("nan")
    label: str = field(default="recording")
    burst: int = 0
    bursts: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", tuple(self.channels))
        data = readonly(np.atleast_2d(self.data))
        object.__setattr__(self, "data", data)
        if data.shape[0] != len(self.channels):
            raise ChannelError(f"{self.label}: {len(self.channels)} channels but {data.shape[0]} rows of data")
        names = [c.name for c in self.channels]
        if len(set(names)) < len(names):
            twice = next(n for n in names if names.count(n) > 1)
            raise ChannelError(f"{self.label}: two channels are named {twice!r}")
        if not self.rate > 0:
            raise EstimationError(f"{self.label}: sample rate {self.rate} must be positive")
        inside = sorted({int(b) for b in self.breaks if 0 < b < data.shape[1]})
        object.__setattr__(self, "breaks", tuple(inside))
        object.__setattr__(self, "bursts", tuple(sorted(int(b) for b in self.bursts)))
        object.__setattr__(self, "excluded", tuple((int(a), int(b)) for a, b in self.excluded))
        object.__setattr__(self, "overloads", tuple((int(c), int(a), int(b)) for c, a, b in self.overloads))

    @property
    def n_samples(self) -> int:
        """Samples per channel."""
        return self.data.shape[1]

    @property
    def duration(self) -> float:
        """Recorded time, in s."""
        return self.n_samples / self.rate

    def index(self, name: str) -> int:
        """Row of the channel called `name`; ChannelError if there is none."""
        for i, channel in enumerate(self.channels):
            if channel.name == name:
                return i
        raise ChannelError(f"{self.label}: no channel {name!r}; there are {', '.join(c.name for c in self.channels)}")

    def with_role(self, *roles: Role) -> tuple[int, ...]:
        """Rows of the channels that play one of `roles`."""
        return tuple(i for i, c in enumerate(self.channels) if c.role in roles)

    @property
    def inputs(self) -> tuple[int, ...]:
        """Rows of the references and base motions."""
        return self.with_role("reference", "base")

    @property
    def outputs(self) -> tuple[int, ...]:
        """Rows of the responses."""
        return self.with_role("response")

    def spans(self) -> Iterator[tuple[int, int]]:
        """Contiguous usable sample ranges (start, stop), in order: cut at breaks, without what is excluded."""
        edges = [0, *self.breaks, self.n_samples]
        cuts = sorted(self.excluded)
        for start, stop in itertools.pairwise(edges):
            for a, b in cuts:
                if b <= start or a >= stop:
                    continue
                if a > start:
                    yield start, a
                start = max(start, b)
            if start < stop:
                yield start, stop

    def select(self, names: Sequence[str]) -> Recording:
        """The same recording with the named channels only, in that order."""
        rows = [self.index(n) for n in names]
        where = {row: i for i, row in enumerate(rows)}
        overloads = tuple((where[c], a, b) for c, a, b in self.overloads if c in where)
        return replace(self, channels=tuple(self.channels[r] for r in rows), data=self.data[rows], overloads=overloads)

    def require_finite(self) -> Recording:
        """Return self; ChannelError naming the first channel that holds NaN or infinity, or is constant."""
        for channel, row in zip(self.channels, self.data, strict=True):
            if not np.isfinite(row).all():
                at = int(np.flatnonzero(~np.isfinite(row))[0])
                raise ChannelError(f"{self.label}: channel {channel.name!r} is not finite at sample {at}")
            if channel.role != "monitor" and row.size and np.ptp(row) == 0:
                raise ChannelError(
                    f"{self.label}: channel {channel.name!r} is constant ({row[0]:g}); is its sensor connected?"
                )
        return self
