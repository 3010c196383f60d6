"""Simulated sessions: what a bench would have recorded from a model, without a plan and without a wait."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.block import Block
from drivers.simulated import Drive, Input, Operator, Player, SimulatedBench, Source, plant, with_chain
from drivers.simulated.filters import HALF
from drivers.trigger import Trigger
from labnnum.errors import ConfigError, EstimationError
from labnnum.excitation import Drive as Wave
from labnnum.nonlinear import Element
from labnnum.recording import Channel
from labnnum.response import modes
from labnnum.structures.base import Structure
from sessions.items import waveform
from sessions.rig_tables import ExcitationTable
from sessions.store import Session

Progress = Callable[[int, int], None]
HEADROOM = 1.6
"""Full scale over the largest sample of the pilot, where a converter is asked for without its range."""

PILOT = 8.0
"""s that are simulated first to find ranges and noise levels."""


@dataclass(frozen=True)
class Bench:
    """What is simulated besides the structure.

    Parameters
    ----------
    rate : float
        Samples per second.
    noise : float
        RMS of each channel's noise over the RMS of its signal.
    bits : int
        Of the converter, 0 without steps; ranges that inputs leave at infinity fit the signal.
    block : int
    oversample : int
    seed : int
        Of noise, and of a hammer's blows; the waveform has the excitation's own.
    tip : str
        Of the hammer.
    interval : float
        s between blows: the length of a hit.
    """

    rate: float
    noise: float = 0.0
    bits: int = 0
    block: int = 4096
    oversample: int = 8
    seed: int = 0
    tip: str = "plastic"
    interval: float = 2.0


def simulate_run(
    session: Session,
    structure: Structure,
    theta: ArrayLike,
    inputs: Sequence[Input],
    drive: Drive,
    excitation: ExcitationTable,
    bench: Bench,
    *,
    level: float,
    hits: int = 5,
    realisation: int = 0,
    label: str = "",
    elements: Sequence[Element] = (),
    progress: Progress | None = None,
) -> None:
    """Append one simulated run to a session.

    Parameters
    ----------
    session : Session
        Open for writing.
    structure : Structure
    theta : array_like, shape (n_parameters,)
        The truth.
    inputs : sequence of Input
        Sensors and inputs, in the order of the channels. Without a sensitivity volts are SI units. An infinite
        `full_scale` is set to fit.
    drive : Drive
        Where and through what; `gain` SI units per volt.
    excitation : ExcitationTable
    bench : Bench
    level : float
        RMS of the drive's force or acceleration; mean peak of a hammer's blows.
    hits : int
        Blows of a hammer.
    realisation : int
        Which of the excitation's waveforms is played.
    elements : sequence of Element
        Nonlinear forces besides.
    progress : callable, optional
        Is told frames done and frames in all.

    Raises
    ------
    ModelError, ChannelError
        If the structure cannot be simulated, or has no such places.
    ConfigError
        If the excitation cannot be played.
    """
    theta = np.asarray(theta, float)
    source, wave, lead, frames = _source(structure, theta, excitation, bench, drive, level, hits, realisation)
    inputs = with_chain(structure, theta, inputs)
    made = _Made(structure, theta, drive, source, bench, tuple(elements))
    inputs = _ranged(made, inputs, lead, frames)
    digitiser = made.digitiser(inputs)
    run = session.start_run(
        [i.channel for i in inputs],
        bench.rate,
        level=level,
        period=0 if wave is None else wave.period,
        label=label,
        unit="V" if any(i.channel.sensitivity is not None for i in inputs) else "SI",
        full_scale=[i.full_scale for i in inputs],
        info=_info(excitation, bench, realisation, wave),
    )
    trigger = _Blows(run, inputs, bench, level) if excitation.kind == "hammer" else None
    for block in _blocks(digitiser, lead, frames):
        run.append(block)
        if trigger is not None:
            trigger.feed(block)
        if progress is not None:
            progress(min(block.start + block.n_frames - lead, frames), frames)
    if trigger is not None:
        trigger.finish(hits)
    run.finish()


def _info(e: ExcitationTable, bench: Bench, realisation: int, wave: Wave | None) -> dict[str, Any]:
    told = {"simulated": True, "excitation": e.model_dump(), "realisation": realisation, "seed": bench.seed}
    return told | ({"lines": wave.lines} if wave is not None and wave.period else {})


def default_inputs(structure: Structure, drive: Channel, responses: Sequence[str] = ()) -> list[Channel]:
    """Channels for a simulation: the drive, and accelerations at `responses` (all translations if none are given)."""
    places = list(responses) or [d for d in structure.dofs if d.partition(":")[2] in ("x", "y", "z")]
    if not places:
        raise ConfigError("the model has no translation to measure; name responses as node:direction")
    out = [drive]
    for place in places:
        node, _, direction = place.partition(":")
        angular = direction.lstrip("+-").startswith("r")
        quantity = "angular_acceleration" if angular else "acceleration"
        out.append(Channel(f"a{node}{direction}", quantity, "response", node, direction))
    return out


def _source(
    structure: Structure, theta: NDArray, e: ExcitationTable, bench: Bench, drive: Drive, level: float, hits: int,
    realisation: int,
) -> tuple[Source, Wave | None, int, int]:  # fmt: skip
    """What plays, its waveform if it has one, frames to let pass first, and frames to record."""
    if e.kind == "hammer":
        frames = round((hits * bench.interval * 1.1 + 1.0) * bench.rate)
        return Operator(bench.tip, bench.interval, level / drive.gain, lead=0.5, seed=bench.seed), None, 0, frames
    wave = waveform(e, bench.rate, realisation)
    player = Player()
    player.play(wave.samples, repeat=True, gain=level / drive.gain)
    if wave.period:
        lead = -(-round(settling(structure, theta) * bench.rate) // wave.period) * wave.period
        return player, wave, lead, e.periods * wave.period
    lead = e.period if e.kind == "burst random" else round(settling(structure, theta) * bench.rate)
    return player, wave, lead, round(e.duration * bench.rate)


def settling(structure: Structure, theta: ArrayLike) -> float:
    """Time, in s, in which every mode decays to 1e-6; at most 120 s, and 1 s where nothing is damped."""
    found = modes(structure, theta)
    rate = 2 * np.pi * found.frequency * found.damping_ratio
    slowest = rate[rate > 0].min(initial=np.inf)
    return float(min(max(np.log(1e6) / slowest, 0.05), 120.0)) if np.isfinite(slowest) else 1.0


@dataclass(frozen=True, eq=False)
class _Made:
    """Everything but the inputs."""

    structure: Structure
    theta: NDArray[np.float64]
    drive: Drive
    source: Source
    bench: Bench
    elements: tuple[Element, ...]

    def digitiser(self, inputs: Sequence[Input]) -> SimulatedBench:
        """The bench with these inputs."""
        made, b = plant(self.structure, self.theta, inputs, [self.drive]), self.bench
        options: dict[str, Any] = {"block": b.block, "oversample": b.oversample, "seed": b.seed}
        return SimulatedBench(made, inputs, [self.source], b.rate, elements=self.elements, **options)


def _blocks(digitiser: SimulatedBench, lead: int, frames: int):
    """Blocks of exactly `frames` frames after `lead`."""
    digitiser.start()
    stop = lead + frames
    while True:
        block = digitiser.read()
        a, b = max(lead - block.start, 0), min(stop - block.start, block.n_frames)
        if b <= 0:
            return
        if a < b:
            yield Block(block.data[:, a:b], block.start + a, block.time, block.lost, block.overflow, block.overload)
        if b < block.n_frames:
            return


def _ranged(made: _Made, inputs: Sequence[Input], lead: int, frames: int) -> list[Input]:
    """Inputs with ranges that fit the signals, and noise in proportion to them."""
    bench = made.bench
    open_ended = [not np.isfinite(i.full_scale) for i in inputs]
    if not any(open_ended) and bench.noise == 0:
        return [replace(i, bits=i.bits if bench.bits == 0 else bench.bits) for i in inputs]
    ideal = [replace(i, full_scale=1e12, bits=0, noise=0.0, input_noise=0.0) for i in inputs]
    pilot = made.digitiser(ideal)
    pilot_frames = min(frames, max(round(PILOT * bench.rate), 4 * bench.block))
    volts = np.hstack([b.data for b in _blocks(pilot, lead, pilot_frames)])
    peak, rms = np.abs(volts).max(axis=1), np.sqrt(np.mean(volts**2, axis=1))
    if (peak == 0).any():
        dead = inputs[int(np.argmin(peak))].channel.name
        raise EstimationError(
            f"channel {dead!r} does not move at all: is it a node of the mode, or without excitation?"
        )
    out = []
    for i, free, p, r in zip(inputs, open_ended, peak, rms, strict=True):
        full = HEADROOM * p * (1 + 4 * bench.noise) if free else i.full_scale
        bits = bench.bits if free or bench.bits else i.bits
        out.append(
            replace(i, full_scale=float(full), bits=bits, input_noise=float(np.hypot(i.input_noise, bench.noise * r)))
        )
    return out


class _Blows:
    """Hits of a simulated hammer, found as a bench would find them."""

    def __init__(self, run: Any, inputs: Sequence[Input], bench: Bench, level: float) -> None:
        self._run = run
        self._row = next(k for k, i in enumerate(inputs) if i.channel.role == "reference")
        self._scale = 1 / inputs[self._row].volts_per_unit
        pre = max(round(0.01 * bench.rate), HALF + 8)  # the converters' filters ring before a short pulse
        length = round(0.85 * bench.interval * bench.rate)
        self._detector = Trigger(0.1 * level, pre, length).start()
        self._events = []

    def feed(self, block: Block) -> None:
        """Watch the force."""
        self._events += self._detector.feed(block.data[self._row] * self._scale)

    def finish(self, hits: int) -> None:
        """Store the first `hits` of them as accepted, further ones as spare."""
        if len(self._events) < hits:
            raise EstimationError(f"only {len(self._events)} of {hits} blows were found; lengthen the interval")
        for k, event in enumerate(self._events):
            reason = "simulated" if k < hits else "more than were asked for"
            self._run.add_hit(event.start, event.stop, k < hits, reason)
