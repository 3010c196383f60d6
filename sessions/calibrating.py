"""Calibrating a rig's channels: record what a calibrator, a mass or a common signal makes of them, and judge it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.digitiser import Digitiser
from drivers.simulated import Drive, FunctionWave, Player, SimulatedBench, Source, plant
from labnnum.bands import Band
from labnnum.calibration import InputResponse, Sensitivity, from_common_signal, from_mass, from_tone
from labnnum.errors import ChannelError, ConfigError, EstimationError
from labnnum.estimators import H1, Welch
from labnnum.recording import Channel, Recording
from labnnum.structures.chain import Chain, Link
from labnnum.system import System
from sessions.rig import Rig

Progress = Callable[[int, int], None]
NOISE_VOLTS = 0.5
"""RMS of the noise that a simulated generator plays while inputs or a mass are calibrated."""
TRUE_MASS_HZ = 2.0
"""Where a simulated calibration mass swings on its cord."""


def tone(rig: Rig, name: str, level: float, frequency: float, seconds: float, progress: Progress) -> Sensitivity:
    """Sensitivity of a channel while a calibrator of `level` (SI, RMS) acts on its sensor."""
    row = row_of(rig, name)
    return from_tone(_one(rig, row, level, frequency, seconds, progress), rig.rate, level, frequency)


def sine(rig: Rig, name: str, volts: float, frequency: float, seconds: float, progress: Progress) -> Sensitivity:
    """What the channel's input reads of a sine of so many volts RMS: volts, as the rig scales them, per true volt.

    ConfigError if the device tells true volts by itself.
    """
    if rig.toml.device.kind != "audio":
        raise ConfigError(f"{rig.path}: device.kind: only an audio interface has a full scale to find with a sine")
    row = row_of(rig, name)
    return from_tone(_one(rig, row, volts, frequency, seconds, progress), rig.rate, volts, frequency)


def mass(
    rig: Rig, name: str, against: str, kilograms: float, band: Band, seconds: float, progress: Progress
) -> Sensitivity:
    """Sensitivity of a force channel that moves a free mass, against a calibrated acceleration.

    Raises
    ------
    ChannelError
        The channels do not measure force and acceleration, or have no sensitivity to begin with.
    """
    rows = [row_of(rig, name), row_of(rig, against)]
    stored = [rig.stored[r] for r in rows]
    for one, quantity in zip(stored, ("force", "acceleration"), strict=True):
        if one.channel.quantity != quantity or one.channel.sensitivity is None:
            raise ChannelError(
                f"channel {one.channel.name!r} must measure {quantity} and have a sensitivity, if only a rough one"
            )
    volts = record(rig, lambda: _swinging(rig, rows, kilograms), rows, seconds, progress)
    channels = (replace(stored[0].channel, role="reference"), replace(stored[1].channel, role="response"))
    data = np.array([one.to_si(row) for one, row in zip(stored, volts, strict=True)])
    frf = H1(_welch(rig, seconds))(Recording(channels, data, rig.rate, label="calibration"))
    assert stored[0].channel.sensitivity is not None
    return from_mass(frf, kilograms, stored[0].channel.sensitivity, band)


def inputs(
    rig: Rig, names: Sequence[str], reference: str, highpass: float, top: float, seconds: float, progress: Progress
) -> dict[str, InputResponse]:
    """Delay, high-pass and gain of inputs that one signal is fed into, against a reference input, up to `top` Hz.

    The reference stands among them, with the corner `highpass` in Hz that it is said to have.
    """
    rows = [row_of(rig, n) for n in (reference, *names)]
    volts = record(rig, lambda: _common(rig), rows, seconds, progress)
    channels = (Channel(reference, "voltage", "reference"), *(Channel(n, "voltage", "response") for n in names))
    frf = H1(_welch(rig, seconds))(Recording(channels, volts, rig.rate, label="calibration"))
    return from_common_signal(frf.lines(0.0, top), highpass)


def _welch(rig: Rig, seconds: float) -> Welch:
    """Segments of two seconds, or a sixteenth of a short recording."""
    return Welch(max(64, min(round(2 * rig.rate), round(seconds * rig.rate / 16))), "hann")


def row_of(rig: Rig, name: str) -> int:
    """Row of a channel. ChannelError if the rig has none of that name."""
    names = [c.name for c in rig.channels]
    if name not in names:
        raise ChannelError(f"{rig.path}: there is no channel {name!r}; there are {', '.join(names)}")
    return names.index(name)


def _one(rig: Rig, row: int, level: float, frequency: float, seconds: float, progress: Progress) -> NDArray:
    return record(rig, lambda: _tone(rig, row, level, frequency), [row], seconds, progress)[0]


def record(
    rig: Rig, simulated: Callable[[], Digitiser], rows: Sequence[int], seconds: float, progress: Progress
) -> NDArray[np.float64]:
    """Volts of the rows for so many seconds, from the rig's device or, where that is simulated, from `simulated`.

    Raises
    ------
    EstimationError
        Frames were lost, or a channel was overloaded: the recording cannot be used.
    """
    digitiser = _device(rig, simulated)
    frames = round(seconds * rig.rate)
    parts, have = [], 0
    with digitiser:
        digitiser.start()
        while have < frames:
            block = digitiser.read()
            if block is None:
                raise EstimationError(f"{rig.path}: the device ended after {have / rig.rate:.3g} s")
            if parts and (block.lost or block.overflow):
                raise EstimationError(f"{rig.path}: frames were lost after {have / rig.rate:.3g} s: record again")
            over = [r for r in rows if block.overload is not None and block.overload[r]]
            if over:
                name = rig.channels[over[0]].name
                raise EstimationError(f"channel {name!r} is overloaded: lower its gain, and calibrate again")
            parts.append(block.data[list(rows)])
            have += block.n_frames
            progress(min(have, frames), frames)
    return np.hstack(parts)[:, :frames]


def _device(rig: Rig, simulated: Callable[[], Digitiser]) -> Digitiser:
    kind = rig.toml.device.kind
    if kind == "simulated":
        return simulated()
    if kind == "audio":
        from sessions.audio import audio_digitiser

        return audio_digitiser(rig, complete=False)
    raise ConfigError(f'{rig.path}: device.kind: {kind!r} cannot be calibrated, only "audio" and "simulated"')


def _tone(rig: Rig, row: int, level: float, frequency: float) -> SimulatedBench:
    """A simulated calibrator on one sensor; the others rest."""
    wave = FunctionWave()
    wave.frequency, wave.amplitude, wave.on = frequency, level * np.sqrt(2), True
    feed = np.zeros(len(rig.channels))
    feed[row] = 1.0
    return _static(rig, feed, wave)


def _common(rig: Rig) -> SimulatedBench:
    """One voltage, noise that suits the least range, on all inputs of a simulated bench."""
    least = min((s.full_scale for s in rig.stored if s.full_scale > 0), default=np.inf)
    suited = min(1.0, 0.1 * least / NOISE_VOLTS)
    return _static(rig, np.array([suited / (s or 1.0) for s in rig.stated]), _noise(rig))


def _static(rig: Rig, feed: NDArray, source: Source) -> SimulatedBench:
    """Sensors that take `feed` of the source, without a structure in between."""
    from sessions.devices import simulated_input

    sensors = [simulated_input(rig, row, c) for row, c in enumerate(rig.channels)]
    one, none = np.ones((1, 1)), np.zeros((feed.size, 1))
    nothing = System(one, one, one, np.zeros((1, 1)), none, none, none, feed[:, None])
    return SimulatedBench(
        nothing, sensors, [source], rig.rate, block=rig.toml.device.block, seed=rig.toml.simulated.seed
    )


def _swinging(rig: Rig, rows: Sequence[int], kilograms: float) -> SimulatedBench:
    """A simulated mass on a cord, driven through the force sensor; other channels see nothing."""
    from sessions.devices import simulated_input

    stiffness = kilograms * (2 * np.pi * TRUE_MASS_HZ) ** 2
    free = Chain(masses={"m": kilograms}, links=(Link("m", "ground", stiffness, 0.02 * stiffness / 12),))
    places = {rows[0]: {"node": "m", "direction": "x", "role": "reference"}, rows[1]: {"node": "m", "direction": "x"}}
    idle = {"node": "", "direction": "", "quantity": "voltage", "role": "monitor"}
    channels = [replace(c, **places.get(r, idle)) for r, c in enumerate(rig.channels)]
    sensors = [simulated_input(rig, row, c) for row, c in enumerate(channels)]
    drive = Drive(channels[rows[0]], gain=20.0)
    return SimulatedBench(
        plant(free, free.nominal, sensors, [drive]), sensors, [_noise(rig)], rig.rate, block=rig.toml.device.block
    )


def _noise(rig: Rig) -> Player:
    player = Player()
    player.play(NOISE_VOLTS * np.random.default_rng(rig.toml.simulated.seed).standard_normal(2**16), repeat=True)
    return player
