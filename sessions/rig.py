"""rig.toml: the bench. Device, channels, generator, excitation, trigger, processing, safety, plan; and, for a bench
that does not exist, what is simulated.

    [device]
    kind = "simulated"                  # or "audio", "replay"
    rate = 2560
    [[channel]]
    name = "base"
    role = "base"
    unit = "m/s^2"
    sensitivity = 0.0102                # V per unit
    ...

docs/bench.md describes every key; `labnnum init` writes a commented one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import Field, model_validator

from labnnum.errors import ConfigError, InputError
from labnnum.recording import Channel
from sessions.calibration import Calibration, calibrated, read_calibration, stated
from sessions.rig_tables import (
    DeviceTable,
    ExcitationTable,
    GeneratorTable,
    PlanTable,
    ProcessingTable,
    QualityTable,
    RigChannel,
    SafetyTable,
    SimulatedTable,
    TriggerTable,
)
from sessions.tables import StoredChannel
from sessions.toml import Table, parse, read_toml, strangers


class RigToml(Table):
    """rig.toml as a whole."""

    name: str = ""
    device: DeviceTable
    channel: tuple[RigChannel, ...] = Field(min_length=1)
    generator: GeneratorTable | None = None
    excitation: ExcitationTable = Field(default_factory=ExcitationTable)
    trigger: TriggerTable = Field(default_factory=TriggerTable)
    quality: QualityTable = Field(default_factory=QualityTable)
    plan: PlanTable = Field(default_factory=PlanTable)
    processing: ProcessingTable = Field(default_factory=ProcessingTable)
    safety: SafetyTable = Field(default_factory=SafetyTable)
    simulated: SimulatedTable = Field(default_factory=SimulatedTable)

    @model_validator(mode="after")
    def _known_channels(self) -> RigToml:
        names = [c.name for c in self.channel]
        twice = next((n for n in names if names.count(n) > 1), None)
        if twice is not None:
            raise ValueError(f"channel: two channels are named {twice!r}; give each its own name")
        asked = [("trigger.channel", self.trigger.channel), ("excitation.control", self.excitation.control)]
        asked += [(f"simulated.channel.{n}", n) for n in self.simulated.channel]
        for key, name in asked:
            if name and name not in names:
                raise ValueError(f"{key}: there is no channel {name!r}; there are {', '.join(names)}")
        if self.excitation.high is not None and self.excitation.high > self.device.rate / 2:
            raise ValueError(
                f"excitation.high: {self.excitation.high:g} Hz is above half of device.rate {self.device.rate:g} Hz"
            )
        self._require_averages()
        return self

    def _require_averages(self) -> None:
        """Random excitation must last for two segments: one alone has no coherence."""
        e, p = self.excitation, self.processing
        have, need = e.duration * self.device.rate, p.segment * (2 - p.overlap)
        if e.kind == "random" and have < need:
            raise ValueError(
                f"processing.segment: two segments of {p.segment} samples need {need / self.device.rate:.4g} s, and"
                f" excitation.duration is {e.duration:g} s: lower one or raise the other"
            )


@dataclass(frozen=True, eq=False)
class Rig:
    """A bench as its rig.toml describes it.

    Parameters
    ----------
    toml : RigToml
        Every table, checked.
    text : str
        As it stood in the file; a session keeps it.
    path : Path
        The file; others that it names are found beside it.
    stored : tuple of StoredChannel
        Channels in the order of the blocks' rows.
    stated : tuple of float or None
        Sensitivities as rig.toml gives them, V per SI unit; those in `stored` are calibrated where that was done.
    calibration : Calibration
        What `labnnum calibrate` found.
    """

    toml: RigToml
    text: str
    path: Path
    stored: tuple[StoredChannel, ...]
    stated: tuple[float | None, ...] = ()
    calibration: Calibration = field(default_factory=Calibration)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels in the order of the blocks' rows."""
        return tuple(c.channel for c in self.stored)

    @property
    def rate(self) -> float:
        """Samples per second."""
        return self.toml.device.rate

    @property
    def limits(self) -> Mapping[str, tuple[float | None, float | None]]:
        """Channel name -> levels in SI units at which to warn and to stop."""
        return {c.name: (c.warn, c.stop) for c in self.toml.channel if c.warn or c.stop}

    def index(self, name: str) -> int:
        """Row of the channel called `name`."""
        return [c.name for c in self.channels].index(name)

    def beside(self, name: str) -> Path:
        """A file that the rig names, relative to the rig's own folder."""
        return self.path.parent / name


def parse_rig(text: str, path: str | Path = "rig.toml", known: Calibration | None = None, complete: bool = True) -> Rig:
    """A rig from its text, with its calibrations; ConfigError names the key that is wrong.

    Channels without a sensitivity are refused unless `complete` is false.
    """
    path, known = Path(path), known or Calibration()
    toml = parse(text, RigToml, str(path))
    for where, key, there in strangers(toml):
        if not where.startswith("channel["):  # those share their tables with channels.toml, which may hold others' keys
            raise ConfigError(f"{path}: {where}{key} is no key; there are {', '.join(dict.fromkeys(there))}")
    tables, stored, said = [], [], []
    for i, table in enumerate(toml.channel):
        where = f"{path}: channel[{i + 1}]: "
        try:
            said.append(stated(table))
            tables.append(calibrated(table, known))
            one = tables[-1].stored(f"channel {table.name!r}: ")
        except InputError as error:
            raise type(error)(f"{where}{error}") from error
        if one.channel.sensitivity is None and one.channel.quantity != "voltage" and complete:
            raise ConfigError(
                f"{where}channel {table.name!r} has no sensitivity: give V per {one.channel.unit}"
                " (or of the unit that you name)"
            )
        stored.append(one)
        _within_range(tables[-1], one, where)
    toml = toml.model_copy(update={"channel": tuple(tables)})
    return Rig(toml, text, path, tuple(stored), tuple(said), known)


def _within_range(table: RigChannel, one: StoredChannel, where: str) -> None:
    """ConfigError for a limit that the channel's input cannot reach: it would never stop anything."""
    if one.channel.sensitivity is None or table.full_scale is None:
        return
    most = float(np.abs(one.to_si(np.array([-table.full_scale, table.full_scale]))).max())
    for key, limit in (("warn", table.warn), ("stop", table.stop)):
        if limit is not None and limit > most:
            raise ConfigError(
                f"{where}channel {table.name!r}: {key} {limit:g} {one.channel.unit} lies beyond the input's range,"
                f" {most:.4g} {one.channel.unit} at full_scale {table.full_scale:g} V, and would never be met"
            )


def read_rig(path: str | Path, complete: bool = True) -> Rig:
    """A rig from its file, with the calibrations beside it; FileError or ConfigError in one line."""
    return parse_rig(read_toml(Path(path)), path, read_calibration(path), complete)
