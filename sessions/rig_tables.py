"""Tables of rig.toml, each key with its range and default."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from drivers.generators import OPENERS
from labnnum.errors import InputError
from labnnum.recording import Channel
from labnnum.windows import window
from sessions.channels import ChannelTable
from sessions.tables import StoredChannel
from sessions.toml import Table

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
        twice = next((p for p in self.points if self.points.count(p) > 1), None)
        if twice is not None:
            raise ValueError(f"points: {twice!r} stands there twice; raise plan.hits for more hits at a point")
        if self.best is not None and self.best > self.hits:
            raise ValueError(f"best: {self.best} hits cannot be chosen from {self.hits}: raise plan.hits or lower best")
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
