"""channels.toml: what the arrays of a measurement file are.

    sample_rate = 25600                 # Hz; or the name of the array that holds it; or `time = "t"`
    [[channel]]
    name = "hammer"
    quantity = "force"
    unit = "lbf"
    role = "reference"
    node = "3"
    direction = "z"
    source = "data[1]"                  # where in the file; the channel's name if left out

docs/formats.md describes every key.
"""

from __future__ import annotations

import fnmatch
import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BeforeValidator, Field, field_validator, model_validator

from labnnum.errors import ConfigError, InputError
from labnnum.recording import DIRECTIONS, SI_UNITS, Channel, Role
from sessions.tables import StoredChannel
from sessions.toml import Table, parse, read_toml, strangers
from sessions.units import calibration, conversion, infer_quantity

Source = str | int
Text = Annotated[str, BeforeValidator(lambda v: str(v) if isinstance(v, (int, float)) else v)]


class ChannelTable(Table):
    """One [[channel]]."""

    name: Text = Field(min_length=1)
    quantity: str = ""
    unit: str = ""
    role: Role = "response"
    node: Text = ""
    direction: str = ""
    sensitivity: float | str | None = None
    full_scale: float | None = None
    source: Source | None = None
    offset: float | Literal["mean"] = 0.0

    @field_validator("quantity")
    @classmethod
    def _known_quantity(cls, value: str) -> str:
        if value and value not in SI_UNITS:
            raise ValueError(f"{value!r} is not one of {', '.join(SI_UNITS)}")
        return value

    @model_validator(mode="before")
    @classmethod
    def _split_dof(cls, raw: Any) -> Any:
        """Let node = "3:-z" say both at once."""
        if isinstance(raw, dict) and not raw.get("direction") and str(raw.get("node", "")).count(":") == 1:
            node, direction = str(raw["node"]).split(":")
            if direction.lstrip("+-") in DIRECTIONS:
                return {**raw, "node": node, "direction": direction}
        return raw

    def measured(self) -> str:
        """The quantity: as said, or told by the unit, or by the role."""
        told = self.quantity or infer_quantity(self.unit if self.sensitivity is None else "")
        return told or ("force" if self.role == "reference" else "acceleration")

    def stored(self, where: str) -> StoredChannel:
        """How raw samples become SI units."""
        quantity = self.measured()
        if self.sensitivity is None:
            c = conversion(self.unit, quantity, where)
            raw_unit = self.unit or SI_UNITS[quantity]
        else:
            c = calibration(self.sensitivity, self.unit, quantity, where)
            volts = c.scale * (c.sensitivity or 1.0)
            raw_unit = self.unit if not math.isclose(volts, 1.0) else "V"
        offset = c.offset if self.offset == "mean" else c.offset + self.offset
        channel = Channel(self.name, quantity, self.role, self.node, self.direction, c.sensitivity)
        limit = math.nan if self.full_scale is None else self.full_scale
        return StoredChannel(channel, raw_unit, c.scale, offset, limit)


class RunTable(Table):
    """One [[run]]: a stretch of the file that is a recording of its own."""

    label: str = ""
    start: int = Field(0, ge=0)
    stop: int | None = Field(None, ge=1)
    period: int | None = Field(None, ge=0)
    drop_periods: int | None = Field(None, ge=0)
    level: float | None = None
    file: str = "*"

    def fits(self, path: Path) -> bool:
        """Whether this stretch is of that file."""
        return fnmatch.fnmatch(path.name, self.file)


class FrfRow(Table):
    """One [[frf.row]]: where the FRF of one output and one input stands in the files."""

    output: Text
    input: Text
    value: Source | None = None
    real: Source | None = None
    imag: Source | None = None
    magnitude: Source | None = None
    phase: Source | None = None
    coherence: Source | None = None
    variance: Source | None = None
    file: str = "*"

    @model_validator(mode="after")
    def _some_value(self) -> FrfRow:
        pairs = (self.value is not None, self.real is not None and self.imag is not None)
        if sum((*pairs, self.magnitude is not None and self.phase is not None)) != 1:
            raise ValueError("needs value, or real and imag, or magnitude and phase (in degrees)")
        return self


class FrfTable(Table):
    """[frf]: the file holds frequency response functions."""

    frequency: Source = "f"
    frequency_unit: str = "Hz"
    value: Source | None = None
    coherence: Source | None = None
    variance: Source | None = None
    n_averages: float = Field(math.nan)
    estimator: str = "imported"
    convention: Literal["exp(+iwt)", "exp(-iwt)"] = "exp(+iwt)"
    settings: dict[str, Any] = Field(default_factory=dict)
    row: tuple[FrfRow, ...] = ()


class ChannelMap(Table):
    """channels.toml as a whole."""

    sample_rate: float | str | None = None
    time: Source | None = None
    period: int = Field(0, ge=0)
    drop_periods: int = Field(0, ge=0)
    level: float | dict[str, float] | None = None
    breaks: tuple[int, ...] = ()
    excluded: tuple[tuple[int, int], ...] = ()
    overloads: tuple[tuple[Text, int, int], ...] = ()
    channel: tuple[ChannelTable, ...] = Field(validation_alias=AliasChoices("channel", "channels"), min_length=1)
    run: tuple[RunTable, ...] = ()
    frf: FrfTable | None = None
    name: str = Field("channels.toml", exclude=True)

    @field_validator("sample_rate")
    @classmethod
    def _positive(cls, value: float | str | None) -> float | str | None:
        if isinstance(value, float) and not 0 < value < math.inf:
            raise ValueError(f"must be a positive number of Hz, not {value:g}")
        return value

    def stored(self) -> tuple[StoredChannel, ...]:
        """All channels, with how they become SI units."""
        out = []
        for i, table in enumerate(self.channel):
            try:
                out.append(table.stored(f"channel {table.name!r}: "))
            except InputError as error:
                raise type(error)(f"{self.name}: channel[{i + 1}]: {error}") from error
        names = [c.channel.name for c in out]
        twice = next((n for n in names if names.count(n) > 1), None)
        if twice is not None:
            raise ConfigError(f"{self.name}: two channels are named {twice!r}; give each its own name")
        return tuple(out)

    def level_of(self, path: Path) -> float:
        """The level of that file: one number for all, or a table of file names (with * and ?)."""
        if isinstance(self.level, dict):
            found = [v for k, v in self.level.items() if fnmatch.fnmatch(path.name, k)]
            return found[0] if found else math.nan
        return math.nan if self.level is None else self.level

    def unused(self) -> list[str]:
        """Keys that mean nothing here, as a note to the user."""
        return [f"{where}{key}" for where, key, _ in strangers(self)]


def parse_channels(text: str, name: str = "channels.toml") -> ChannelMap:
    """channels.toml from its text; ConfigError names the key that is wrong."""
    return parse(text, ChannelMap, name).model_copy(update={"name": name})


def read_channels(path: str | Path) -> ChannelMap:
    """channels.toml from its file."""
    return parse_channels(read_toml(Path(path)), str(path))
