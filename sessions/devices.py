"""Devices of a rig, ready for one item of its plan: the digitiser, and what excites."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.digitiser import Digitiser
from drivers.exciter import Exciter
from drivers.replay import Replay
from drivers.simulated import (
    TIPS,
    Drive,
    Faults,
    Input,
    Operator,
    Shaker,
    Silence,
    SimulatedBench,
    SimulatedExciter,
    Source,
    element,
    plant,
    with_chain,
)
from labnnum.errors import ConfigError
from labnnum.mechanisms import ExtendedStructure
from labnnum.nonlinear import Element
from labnnum.recording import Channel
from labnnum.structures.base import Structure
from sessions.items import Item, control, trigger_row
from sessions.rig import Rig
from sessions.rig_tables import SimulatedChannel


@dataclass(frozen=True, eq=False)
class Devices:
    """What one item is measured with; `exciter` is None where a hammer excites."""

    digitiser: Digitiser
    exciter: Exciter | None = None


@contextmanager
def devices(rig: Rig, item: Item, attempt: int = 0) -> Generator[Devices]:
    """Open the rig's devices for `item`; on any exit the generator is switched off before anything else.

    `attempt` counts the hits of earlier runs of the item: a simulated hammer does not strike the same blows again.

    Raises
    ------
    ConfigError
        If the rig lacks what its devices need.
    DeviceNotFoundError
        If a device is not there.
    """
    made = _MAKERS[rig.toml.device.kind](rig, item, attempt)
    try:
        with made.digitiser:
            try:
                yield made
            finally:
                if made.exciter is not None:
                    made.exciter.off()
    finally:
        if made.exciter is not None:
            made.exciter.close()


def _simulated(rig: Rig, item: Item, attempt: int) -> Devices:
    from sessions.model import read_model

    s = rig.toml.simulated
    model = read_model(rig.beside(s.model))
    structure = model.structure
    theta = true_parameters(structure, s.parameters, rig.path)
    inputs = with_chain(structure, theta, [simulated_input(rig, row, c) for row, c in enumerate(item.channels)])
    shaker = None if s.shaker is None else Shaker(**s.shaker.model_dump())
    seed = s.seed + 1000 * item.number + attempt
    if rig.toml.excitation.kind == "none":
        source: Source = Silence()
        drive, exciter = Drive(_drive_channel(rig, item)), None
    elif rig.toml.excitation.kind == "hammer":
        source = _operator(rig, seed)
        drive, exciter = Drive(item.channels[trigger_row(rig)]), None
    else:
        generator = rig.toml.generator
        if generator is not None and generator.kind != "simulated":
            raise ConfigError(
                f'{rig.path}: generator.kind: {generator.kind!r} does not drive a simulated device; choose "simulated"'
            )
        source = exciter = SimulatedExciter(rig.rate, generator.max_volts if generator else 10.0)
        drive = Drive(_drive_channel(rig, item), s.gain, shaker)
    device, faults = rig.toml.device, s.faults
    bench = SimulatedBench(
        plant(structure, theta, inputs, [drive]),
        inputs,
        [source],
        rig.rate,
        block=device.block,
        oversample=s.oversample,
        seed=seed,
        faults=Faults(faults.drift_ppm, faults.dropouts, faults.dropout_frames, faults.silent, faults.vanish or np.inf),
        elements=[
            *(element(structure, theta, e.law, e.at, e.to, **e.parameters) for e in s.element),
            *laws_in(structure),
        ],
        real_time=device.real_time,
        buffer=device.buffer,
    )
    return Devices(bench, exciter)


def laws_in(structure: Structure) -> tuple[Element, ...]:
    """The nonlinear laws that a model file itself holds, as time simulation takes them; none of most models."""
    return structure.law_elements() if isinstance(structure, ExtendedStructure) else ()


def true_parameters(structure: Structure, values: dict[str, float], path: Path) -> NDArray[np.float64]:
    """Parameter values of the simulated structure: nominal but for those that are named."""
    theta = structure.nominal.copy()
    names = [p.name for p in structure.parameters]
    for name, value in values.items():
        if name not in names:
            raise ConfigError(f"{path}: simulated.parameters.{name}: the model has {', '.join(names) or 'none'}")
        if not np.isfinite(value):
            raise ConfigError(f"{path}: simulated.parameters.{name}: {value} is no finite number")
        theta[names.index(name)] = value
    return theta


def model_text(rig: Rig) -> str:
    """Text of the model beside the rig, for the session to keep; empty if there is none."""
    path = rig.beside(rig.toml.simulated.model)
    return path.read_text(encoding="utf-8") if path.is_file() else ""


def simulated_input(rig: Rig, row: int, channel: Channel) -> Input:
    """The sensor and input that the rig simulates for a row; its stated sensitivity, whatever was calibrated."""
    s = rig.toml.simulated
    own = s.channel.get(channel.name, SimulatedChannel())
    return Input(
        replace(channel, sensitivity=rig.stated[row]),
        gain=own.gain,
        noise=own.noise,
        cross=own.cross,
        mass=own.mass,
        full_scale=rig.toml.channel[row].full_scale or 10.0,
        bits=s.bits if own.bits is None else own.bits,
        input_noise=s.input_noise if own.input_noise is None else own.input_noise,
        highpass=s.highpass if own.highpass is None else own.highpass,
        delay=own.delay,
    )


def _operator(rig: Rig, seed: int) -> Operator:
    h = rig.toml.simulated.hammer
    if h.tip not in TIPS:
        raise ConfigError(f"{rig.path}: simulated.hammer.tip: {h.tip!r} is not one of {', '.join(TIPS)}")
    return Operator(h.tip, h.interval, h.peak, h.double, h.overload, lead=0.5 + rig.toml.trigger.pre, seed=seed)


def _drive_channel(rig: Rig, item: Item) -> Channel:
    asked = rig.toml.simulated.drive
    if not asked:
        return item.channels[rig.index(control(rig).name)]
    node, _, direction = asked.partition(":")
    return Channel("drive", "force", "reference", node, direction)


def _replay(rig: Rig, item: Item, attempt: int) -> Devices:
    from sessions.store import open_session

    device = rig.toml.device
    if not device.session:
        raise ConfigError(f'{rig.path}: device.session: device.kind "replay" needs the session to play')
    with open_session(rig.beside(device.session)) as session:
        runs = [r for r in session.runs if r.info.get("item") == item.key] or list(session.runs)[device.run - 1 :]
        if not runs:
            raise ConfigError(f"{rig.path}: device.run: {device.session} has {len(session.runs)} runs")
        blocks = list(runs[0].replay())
        full = np.array([s.full_scale for s in runs[0].stored])
        rate = runs[0].rate
        names = [c.name for c in runs[0].channels]
    if names != [c.name for c in item.channels]:
        raise ConfigError(f"{rig.path}: channel: the replayed run has the channels {', '.join(names)}")
    if rate != rig.rate:
        raise ConfigError(f"{rig.path}: device.rate: the replayed run has {rate:g} Hz, not {rig.rate:g} Hz")
    if rig.toml.excitation.kind not in ("none", "hammer"):
        raise ConfigError(
            f"{rig.path}: excitation.kind: a replay has no generator to play {rig.toml.excitation.kind!r}; with"
            ' "none" the run is recorded again as it was, and labnnum frf estimates from it'
        )
    speed = device.speed or float("inf")
    return Devices(Replay(lambda: blocks, rig.rate, len(names), full, speed))


def _audio(rig: Rig, item: Item, attempt: int) -> Devices:
    from sessions.audio import audio_devices

    return Devices(*audio_devices(rig, item))


_MAKERS = {"simulated": _simulated, "replay": _replay, "audio": _audio}
