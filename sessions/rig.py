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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from drivers.generators import OPENERS
from labnnum.errors import ConfigError, InputError
from labnnum.recording import Channel
from labnnum.windows import window
from sessions.calibration import Calibration, calibrated, read_calibration, stated
from sessions.channels import ChannelTable
from sessions.tables import StoredChannel
from sessions.toml import Table, parse, read_toml, strangers

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]

ExcitationKind = Literal[
    "hammer", "random", "burst random", "periodic random", "multisine", "chirp", "stepped sine", "none"
]
PERIODIC = ("periodic random", "multisine", "chirp")
"""Excitations that repeat a period exactly."""


class DeviceTable(Table):
    """[device]: what digitises."""

    kind: Literal["simulated", "audio", "replay"] = "simulated"
    name: str | int = ""
    rate: Positive
    block: Count = 1024
    session: str = ""
    run: Count = 1
    speed: Positive | None = None
    real_time: bool = False
    buffer: Positive = 10.0
    latency: Positive | Literal["low", "high"] = "high"
    channels: Annotated[int, Field(ge=0)] = 0


class RigChannel(ChannelTable):
    """One [[channel]] of the bench; `gain` is that of the conditioner between sensor and input."""

    input: Count | None = None
    full_scale: Positive | None = 10.0
    gain: Positive = 1.0
    warn: Positive | None = None
    stop: Positive | None = None

    def stored(self, where: str) -> StoredChannel:
        """How volts at the input become SI units."""
        one = super().stored(where)
        if self.gain == 1.0:
            return one
        given = one.channel.sensitivity
        channel = replace(one.channel, sensitivity=None if given is None else given * self.gain)
        return replace(one, channel=channel, scale=one.scale / self.gain)


class GeneratorTable(Table):
    """[generator]: what excites, unless a hammer does."""

    kind: str = "simulated"
    port: str = ""
    device: str | int = ""
    output: Count = 1
    full_scale: Positive | None = None
    max_volts: Positive = 1.0
    start_volts: Positive = 0.01
    gain: Positive | None = None

    @field_validator("kind")
    @classmethod
    def _known_kind(cls, value: str) -> str:
        kinds = ("simulated", "audio", *OPENERS)
        if value not in kinds:
            raise ValueError(f"{value!r} is not one of {', '.join(kinds)}")
        return value


class ExcitationTable(Table):
    """[excitation]: what is played, at which levels."""

    kind: ExcitationKind = "hammer"
    low: NotNegative = 0.0
    high: Positive | None = None
    levels: tuple[Positive, ...] = ()
    control: str = ""
    tolerance: Positive = 0.05
    duration: Positive = 30.0
    settle: NotNegative = 1.0
    period: Count = 4096
    periods: Count = 8
    drop_periods: Annotated[int, Field(ge=0)] = 2
    realisations: Count = 1
    detection: Annotated[int, Field(ge=0)] = 0
    odd: bool = False
    burst: Share = 0.6
    seed: int = 0
    lines: Count = 50
    spacing: Literal["log", "linear"] = "log"
    cycles: Count = 20
    directions: tuple[Literal["up", "down"], ...] = ("up",)

    @model_validator(mode="after")
    def _band(self) -> ExcitationTable:
        if self.high is not None and not self.low < self.high:
            raise ValueError(f"low {self.low:g} Hz must be below high {self.high:g} Hz")
        return self

    @property
    def periodic(self) -> bool:
        """Whether a period repeats exactly."""
        return self.kind in PERIODIC


class TriggerTable(Table):
    """[trigger]: what is a hit."""

    channel: str = ""
    level: Positive = 5.0
    hysteresis: Share = 0.5
    slope: Literal["rising", "falling", "either"] = "rising"
    pre: NotNegative = 0.01
    duration: Positive = 1.0


class QualityTable(Table):
    """[quality]: what each hit is held against."""

    second_hit: Annotated[float, Field(gt=0, lt=1)] = 0.2
    force_range: tuple[NotNegative, Positive] | None = None
    reach: NotNegative = 0.0
    reach_drop: Positive = 20.0
    settled: Positive = 0.05
    consistency: Share = 0.8


class PlanTable(Table):
    """[plan]: points to rove over, and hits at each."""

    points: tuple[str, ...] = ()
    rove: Literal["hammer", "sensor"] = "hammer"
    hits: Count = 5
    best: Count | None = None
    auto: bool = True
    most: Count = 50

    @model_validator(mode="after")
    def _places(self) -> PlanTable:
        for point in self.points:
            Channel("point", role="response", node=point.split(":")[0], direction=point.partition(":")[2])
            if not point.partition(":")[2]:
                raise ValueError(f"points: {point!r} must be node:direction, such as '3:-z'")
        return self


class ProcessingTable(Table):
    """[processing]: how FRFs are estimated while measuring; reprocessing may choose again."""

    estimator: Literal["H1", "H2", "Hv", "periodic"] | None = None
    window: str = "hann"
    segment: Annotated[int, Field(ge=2)] = 4096
    overlap: Annotated[float, Field(ge=0, lt=1)] = 0.5
    decay: NotNegative = 0.0
    force_gate: tuple[NotNegative, Positive] | None = None
    coherence: Share = 0.9

    @field_validator("window")
    @classmethod
    def _known_window(cls, value: str) -> str:
        try:
            window(value, 8)
        except InputError as error:
            raise ValueError(str(error)) from error
        return value


class SafetyTable(Table):
    """[safety]: how the generator is raised and lowered, and when it is switched off."""

    ramp: NotNegative = 0.5
    overload: Literal["ignore", "warn", "stop"] = "warn"
    lost: Literal["warn", "stop"] = "warn"


class SimulatedChannel(Table):
    """[simulated.channel.NAME]: what the channel's sensor and input do to the signal."""

    gain: float = 1.0
    noise: NotNegative = 0.0
    cross: dict[str, float] = Field(default_factory=dict)
    mass: NotNegative = 0.0
    bits: Annotated[int, Field(ge=0, le=32)] | None = None
    input_noise: NotNegative | None = None
    highpass: NotNegative | None = None
    delay: NotNegative = 0.0


class SimulatedShaker(Table):
    """[simulated.shaker]: an electrodynamic exciter; left out, force or motion comes as it is asked for."""

    mass: Positive = 0.2
    frequency: Positive = 20.0
    damping_ratio: NotNegative = 0.3
    stinger: Positive = 1e7
    stinger_loss: NotNegative = 0.01


class SimulatedHammer(Table):
    """[simulated.hammer]: the person with the hammer."""

    tip: str = "plastic"
    interval: Positive = 2.0
    peak: Positive = 100.0
    double: Share = 0.0
    overload: Share = 0.0


class SimulatedFaults(Table):
    """[simulated.faults]: what goes wrong with the device."""

    drift_ppm: float = 0.0
    dropouts: NotNegative = 0.0
    dropout_frames: Count = 300
    silent: bool = False
    vanish: Positive | None = None


class SimulatedElement(Table):
    """One [[simulated.element]]: a nonlinear force, against ground or between two places."""

    law: str
    at: str
    to: str = ""
    parameters: dict[str, float]


class SimulatedTable(Table):
    """[simulated]: the bench that does not exist."""

    model: str = "model.toml"
    seed: int = 0
    oversample: Count = 8
    gain: float = 10.0
    drive: str = ""
    bits: Annotated[int, Field(ge=0, le=32)] = 24
    input_noise: NotNegative = 0.0
    highpass: NotNegative = 0.0
    parameters: dict[str, float] = Field(default_factory=dict)
    channel: dict[str, SimulatedChannel] = Field(default_factory=dict)
    element: tuple[SimulatedElement, ...] = ()
    hammer: SimulatedHammer = Field(default_factory=SimulatedHammer)
    shaker: SimulatedShaker | None = None
    faults: SimulatedFaults = Field(default_factory=SimulatedFaults)


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
    toml = toml.model_copy(update={"channel": tuple(tables)})
    return Rig(toml, text, path, tuple(stored), tuple(said), known)


def read_rig(path: str | Path, complete: bool = True) -> Rig:
    """A rig from its file, with the calibrations beside it; FileError or ConfigError in one line."""
    return parse_rig(read_toml(Path(path)), path, read_calibration(path), complete)
