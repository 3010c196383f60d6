"""Devices of a rig that exist: an audio interface that digitises, and what excites beside it."""

from __future__ import annotations

from drivers.audio import AudioDigitiser
from drivers.exciter import Exciter
from drivers.generators import OPENERS
from drivers.generators.audio_output import AudioOutput
from drivers.generators.exciter import GeneratorExciter
from labnnum.errors import ConfigError
from sessions.items import Item
from sessions.rig import Rig


def audio_devices(rig: Rig, item: Item) -> tuple[AudioDigitiser, Exciter | None]:
    """The digitiser, still closed, and the exciter, open and off; None where a hammer excites or nothing does.

    Raises
    ------
    ConfigError
        If the rig does not say what its device needs.
    DriverError
        If the generator is not there or does not answer as it should.
    """
    digitiser = audio_digitiser(rig)
    if rig.toml.excitation.kind in ("hammer", "none"):
        return digitiser, None
    return digitiser, exciter(rig, digitiser)


def audio_digitiser(rig: Rig, complete: bool = True) -> AudioDigitiser:
    """The rig's inputs on its audio interface: those that it numbers, else in the order of the channels.

    ConfigError if a channel's full scale is not given, unless `complete` is false.
    """
    device = rig.toml.device
    for i, table in enumerate(rig.toml.channel if complete else ()):
        if "full_scale" not in table.model_fields_set or table.full_scale is None:
            raise ConfigError(
                f"{rig.path}: channel[{i + 1}].full_scale is missing: give the volts at the input of {table.name!r}"
                " that the interface turns into its largest number (labnnum calibrate finds them with a known sine)"
            )
    return AudioDigitiser(
        device.name,
        device.rate,
        [table.input or i + 1 for i, table in enumerate(rig.toml.channel)],
        [table.full_scale or 1.0 for table in rig.toml.channel],
        block=device.block,
        buffer=device.buffer,
        latency=device.latency,
        channels=device.channels,
    )


def exciter(rig: Rig, digitiser: AudioDigitiser) -> Exciter:
    """What [generator] names, open and off."""
    g = rig.toml.generator
    if g is None:
        raise ConfigError(f"{rig.path}: generator: excitation {rig.toml.excitation.kind!r} needs one")
    if g.kind == "audio":
        return _output(rig, digitiser)
    if g.kind not in OPENERS:
        raise ConfigError(
            f'{rig.path}: generator.kind: {g.kind!r} cannot play beside an audio interface; choose "audio" or one of'
            f" {', '.join(OPENERS)}"
        )
    if not g.port:
        raise ConfigError(f"{rig.path}: generator.port is missing: name the serial port, such as /dev/ttyUSB0 or COM3")
    generator = OPENERS[g.kind](g.port, g.output, g.max_volts)
    try:
        generator.identify()
    except BaseException:
        generator.transport.close()
        raise
    return GeneratorExciter(generator)


def _output(rig: Rig, digitiser: AudioDigitiser) -> AudioOutput:
    g, device = rig.toml.generator, rig.toml.device
    assert g is not None
    if g.full_scale is None:
        raise ConfigError(
            f"{rig.path}: generator.full_scale is missing: give the peak volts at the output for the largest number"
        )
    same = g.device in ("", device.name)
    output = AudioOutput(
        device.name if same else g.device,
        device.rate,
        g.output,
        g.full_scale,
        g.max_volts,
        latency=device.latency,
        channels=max(device.channels, 2),
        frame_at=digitiser.frame_at if same else None,
        other=None if same else lambda: digitiser.clock,
    )
    output.open()
    return output
