"""labnnum calibrate: sensitivities and inputs of a rig, measured and kept with their dates."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sessions.calibration import Entry
    from sessions.rig import Rig


def calibrate(
    rig: Annotated[Path, typer.Argument(help="rig.toml; what is found is kept beside it.", show_default=False)],
    channel: Annotated[str, typer.Argument(help="The channel to calibrate; not with --inputs.")] = "",
    level: Annotated[
        str, typer.Option(help="What the calibrator does, RMS, with its unit; handheld ones make 1 g.")
    ] = "1 g",
    peak: Annotated[bool, typer.Option("--peak", help="The level is a peak, not an RMS.")] = False,
    frequency: Annotated[float, typer.Option(help="Of the calibrator or the sine, in Hz.")] = 159.155,
    sine: Annotated[
        float | None, typer.Option(help="A sine of so many volts RMS at the input: its full scale.", show_default=False)
    ] = None,
    mass: Annotated[
        float | None, typer.Option(help="Force channel moving a free mass of so many kg.", show_default=False)
    ] = None,
    against: Annotated[str, typer.Option(help="--mass: the calibrated acceleration of the mass.")] = "",
    band: Annotated[str, typer.Option(help="--mass: where the mass is rigid, LOW:HIGH in Hz.")] = "30:300",
    inputs: Annotated[
        bool, typer.Option("--inputs", help="One signal on all inputs: their delays and high-passes.")
    ] = False,
    reference: Annotated[str, typer.Option(help="--inputs: channel to compare with. Default: the first.")] = "",
    reference_highpass: Annotated[
        float, typer.Option(help="--inputs: corner of the reference's own coupling in Hz; 0 if DC coupled.")
    ] = 0.0,
    seconds: Annotated[float, typer.Option(help="How long to record.")] = 10.0,
    forget: Annotated[bool, typer.Option("--forget", help="Remove all calibrations of the channel.")] = False,
    show: Annotated[bool, typer.Option("--show", help="Only show what is known.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the outcome as JSON.")] = False,
) -> None:
    """Calibrate a rig's channels, and keep the result with its date beside rig.toml, where it holds from then on.

    **A sensor in a handheld calibrator** (159.2 Hz, 1 g RMS unless you say otherwise):

        labnnum calibrate rig.toml tip

        labnnum calibrate rig.toml tip --level "10 m/s^2" --peak --frequency 80

    **An input's full scale**, from a sine whose volts a meter shows:

        labnnum calibrate rig.toml tip --sine 0.7071 --frequency 200

    **A force channel**, from a rigid mass that hangs free and is tapped or shaken through the force sensor; the mass
    counts accelerometer and screws, and all that moves beyond the force sensor:

        labnnum calibrate rig.toml force --mass 1.25 --against tip --band 30:300

    **Delays and high-passes of the inputs**, from noise fed into all of them at once; FRFs are corrected for them:

        labnnum calibrate rig.toml --inputs --reference force

    What was found is shown with its standard error; a signal that is not what it should be (another frequency, an
    unsteady tone, an overload, lost samples) is refused with the reason. If rig.toml says something else later on, it
    is taken for another sensor, and asks you to calibrate again.
    """
    from sessions.calibration import add_entries, calibration_path, read_calibration
    from sessions.calibration import forget as remove
    from sessions.commands.printing import bar

    found = _read(rig, channel)
    _check(found, channel, seconds, inputs or show)
    if show or forget:
        if forget:
            _require(found, channel)
            said = f"{remove(rig, channel)} removed from {calibration_path(rig)}"
        _tell(rig, found, read_calibration(rig).entries, said if forget else "", as_json)
        return
    with bar("recording") as progress:
        options = {"seconds": seconds, "progress": progress}
        if inputs:
            entries = _inputs(found, reference, reference_highpass, options)
        elif mass is not None:
            entries = _mass(found, channel, mass, against, band, options)
        elif sine is not None:
            entries = _sine(found, channel, sine, frequency, options)
        else:
            entries = _tone(found, channel, level, peak, frequency, options)
    add_entries(rig, entries)
    _tell(rig, found, entries, f"kept in {calibration_path(rig)}", as_json)


def _check(found: Rig, channel: str, seconds: float, any_channel: bool) -> None:
    """ConfigError if no channel is named where one is needed, or no time."""
    from math import inf

    from labnnum.errors import ConfigError

    if not channel and not any_channel:
        names = ", ".join(c.name for c in found.channels)
        raise ConfigError(f"name the channel to calibrate, one of {names}; or all inputs at once with --inputs")
    if not 0 < seconds < inf:
        raise ConfigError(f"--seconds {seconds:g}: expected a positive number")


def _read(rig: Path, channel: str) -> Rig:
    """The rig with its calibrations; where those of the channel no longer fit, without them."""
    from labnnum.errors import ConfigError
    from sessions.calibration import read_calibration
    from sessions.rig import parse_rig
    from sessions.toml import read_toml

    text, known = read_toml(rig), read_calibration(rig)
    try:
        return parse_rig(text, rig, known, complete=False)
    except ConfigError:
        return parse_rig(text, rig, known.without(channel), complete=False)


def _require(found: Rig, channel: str) -> None:
    from sessions.calibrating import row_of

    row_of(found, channel)


def _tone(found: Rig, channel: str, level: str, peak: bool, frequency: float, options: dict[str, Any]) -> list[Entry]:
    import math

    from sessions.calibrating import row_of, tone
    from sessions.calibration import sensitivity_entry

    one = found.channels[row_of(found, channel)]
    rms = _level(level, one.quantity) / (math.sqrt(2) if peak else 1.0)
    result = tone(found, channel, rms, frequency, **options)
    method = f"tone of {result.frequency:.4g} Hz, {rms:.6g} {one.unit} RMS"
    return [sensitivity_entry(_stated(found, channel), result, method)]


def _sine(found: Rig, channel: str, volts: float, frequency: float, options: dict[str, Any]) -> list[Entry]:
    from sessions.calibrating import row_of, sine
    from sessions.calibration import full_scale_entry, rescaled

    row = row_of(found, channel)
    result = sine(found, channel, volts, frequency, **options)
    method = f"sine of {result.frequency:.4g} Hz, {volts:.6g} V RMS"
    entry = full_scale_entry(found.toml.channel[row], _stated(found, channel), result, method)
    return [entry, *rescaled(found.calibration, channel, 1 / result.value)]


def _mass(found: Rig, channel: str, kilograms: float, against: str, band: str, options: dict[str, Any]) -> list[Entry]:
    from labnnum.errors import ConfigError
    from sessions.calibrating import mass
    from sessions.calibration import sensitivity_entry
    from sessions.commands.printing import note

    if not against:
        raise ConfigError("--mass needs --against: the channel that measures the acceleration of the mass")
    result = mass(found, channel, against, kilograms, _band(band), **options)
    if result.inverted:
        note(f"channel {channel!r} has the opposite sign of {against!r}: turn its direction in rig.toml")
    method = f"mass of {kilograms:g} kg against {against}, {band} Hz"
    return [sensitivity_entry(_stated(found, channel), result, method)]


def _inputs(found: Rig, reference: str, highpass: float, options: dict[str, Any]) -> list[Entry]:
    from math import inf

    from labnnum.errors import ConfigError
    from sessions.calibrating import inputs, row_of
    from sessions.calibration import input_entries

    if not 0 <= highpass < inf:
        raise ConfigError(f"--reference-highpass {highpass:g}: expected a corner in Hz, or 0 if it is DC coupled")

    names = [c.name for c in found.channels]
    reference = names[row_of(found, reference)] if reference else names[0]
    others = [n for n in names if n != reference]
    result = inputs(found, others, reference, highpass, 0.4 * found.rate, **options)
    return list(
        input_entries(result, reference, f"common signal, reference {reference} with high-pass {highpass:g} Hz")
    )


def _stated(found: Rig, channel: str):
    """The channel as rig.toml has it, without calibrations."""
    from sessions.rig import parse_rig

    plain = parse_rig(found.text, found.path, complete=False)
    return plain.toml.channel[plain.index(channel)]


def _level(text: str, quantity: str) -> float:
    from labnnum.errors import UnitError
    from sessions.units import conversion

    number, _, unit = text.strip().partition(" ")
    try:
        value = float(number)
    except ValueError:
        raise UnitError(f'--level {text!r} is not a number with its unit, such as "1 g"') from None
    return value * conversion(unit.strip(), quantity, "--level: ").scale


def _band(text: str):
    from labnnum.bands import Band
    from labnnum.errors import BandError

    low, _, high = text.partition(":")
    try:
        return Band(float(low), float(high))
    except ValueError as error:
        if isinstance(error, BandError):
            raise
        raise BandError(f"--band {text!r} is not LOW:HIGH in Hz, such as 30:300") from None


def _tell(rig: Path, found: Rig, entries: Sequence[Entry], said: str, as_json: bool) -> None:
    import json

    from sessions.calibration import KINDS, calibration_path

    if as_json:
        told: dict[str, Any] = {"file": str(calibration_path(rig))}
        for kind, key in KINDS.items():
            told[key] = [e.model_dump() for e in entries if isinstance(e, kind)]
        typer.echo(json.dumps(told))
        return
    units = {c.name: c.unit for c in found.channels}
    for entry in entries:
        typer.echo(_line(entry, units.get(entry.channel, "unit")))
    typer.echo(said or ("" if entries else f"{calibration_path(rig)}: nothing was calibrated yet"))


def _line(entry: Entry, unit: str) -> str:
    from sessions.calibration import FullScaleEntry, InputEntry, SensitivityEntry

    how = f"({entry.method}; {entry.date})"
    if isinstance(entry, InputEntry) and entry.channel == entry.reference:
        return f"{entry.channel}: the reference, high-pass {entry.highpass:.4g} Hz as stated {how}"
    if isinstance(entry, InputEntry):
        return (
            f"{entry.channel}: {1e6 * entry.delay:.2f} ± {1e6 * entry.delay_error:.2g} µs late, high-pass"
            f" {entry.highpass:.4g} ± {entry.highpass_error:.2g} Hz, gain {entry.gain:.6g} of {entry.reference} {how}"
        )
    assert isinstance(entry, (SensitivityEntry, FullScaleEntry))
    full = isinstance(entry, FullScaleEntry)
    before = f", rig.toml says {entry.instead_of:.6g}" if entry.instead_of else ""
    what = f"full scale {entry.value:.6g} ± {entry.error:.2g} V" if full else ""
    return f"{entry.channel}: {what or f'{entry.value:.6g} ± {entry.error:.2g} V per {unit}'}{before} {how}"
