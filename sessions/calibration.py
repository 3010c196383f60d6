"""Calibrations of a rig: kept with their dates in a TOML file beside it, and applied whenever the rig is read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from pydantic import Field

from labnnum.calibration import InputResponse, Sensitivity, corrected
from labnnum.errors import ConfigError, InputError
from labnnum.frf import Frf
from labnnum.recording import SI_UNITS
from sessions.channels import ChannelTable
from sessions.toml import Table, parse, read_toml
from sessions.toml_write import dumps

if TYPE_CHECKING:
    from sessions.rig_tables import RigChannel
    from sessions.runs import Run

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
SAME = 1e-6
"""Relative difference up to which rig.toml still says what it said when a channel was calibrated."""


class Entry(Table):
    """One calibration: of which channel, when, and how."""

    channel: str
    date: str
    method: str


class SensitivityEntry(Entry):
    """[[sensitivity]]: volts per SI unit."""

    value: Positive
    error: NotNegative = 0.0
    frequency: NotNegative = 0.0
    instead_of: Positive | None = None


class FullScaleEntry(Entry):
    """[[full_scale]]: volts at the input for the largest number."""

    value: Positive
    error: NotNegative = 0.0
    instead_of: Positive | None = None


class InputEntry(Entry):
    """[[input]]: delay in s and high-pass in Hz; delay and gain against a reference input, which has its own entry."""

    reference: str = ""
    delay: float = 0.0
    delay_error: NotNegative = 0.0
    highpass: NotNegative = 0.0
    highpass_error: NotNegative = 0.0
    gain: Positive = 1.0
    gain_error: NotNegative = 0.0

    @property
    def response(self) -> InputResponse:
        """What it does to its signal; what is not twice its error counts as nothing."""
        delay = self.delay if abs(self.delay) > 2 * self.delay_error else 0.0
        highpass = self.highpass if self.highpass > 2 * self.highpass_error else 0.0
        return InputResponse(delay, highpass, self.gain)


AnyEntry = TypeVar("AnyEntry", bound=Entry)


class Calibration(Table):
    """The file as a whole: every calibration that was made, oldest first; the last of a channel holds."""

    sensitivity: tuple[SensitivityEntry, ...] = ()
    full_scale: tuple[FullScaleEntry, ...] = ()
    input: tuple[InputEntry, ...] = ()

    @property
    def responses(self) -> dict[str, InputResponse]:
        """Channel name -> what its input does, where anything is known of it."""
        found = {e.channel: e.response for e in self.input}
        return {n: r for n, r in found.items() if r.delay or r.highpass}

    @property
    def entries(self) -> tuple[Entry, ...]:
        """All of them."""
        return (*self.sensitivity, *self.full_scale, *self.input)

    def without(self, channel: str) -> Calibration:
        """The same but for one channel."""
        return self.model_copy(
            update={key: tuple(e for e in getattr(self, key) if e.channel != channel) for key in KINDS.values()}
        )


KINDS: dict[type[Entry], str] = {SensitivityEntry: "sensitivity", FullScaleEntry: "full_scale", InputEntry: "input"}
"""Class of an entry -> its table in the file."""


def calibration_path(rig: str | Path) -> Path:
    """Where a rig's calibrations are: rig.calibration.toml beside rig.toml."""
    path = Path(rig)
    return path.with_name(f"{path.stem}.calibration.toml")


def read_calibration(rig: str | Path) -> Calibration:
    """Calibrations of the rig in that file; none if there is no file. ConfigError names the key that is wrong."""
    path = calibration_path(rig)
    return parse(read_toml(path), Calibration, str(path)) if path.exists() else Calibration()


def add_entries(rig: str | Path, entries: Sequence[Entry]) -> Path:
    """Keep calibrations beside those that there are; the file."""
    held = read_calibration(rig)
    added = {key: (*getattr(held, key), *(e for e in entries if type(e) is kind)) for kind, key in KINDS.items()}
    return _write(rig, held.model_copy(update=added))


def forget(rig: str | Path, channel: str) -> int:
    """Remove all calibrations of a channel; how many there were."""
    held = read_calibration(rig)
    kept = held.without(channel)
    _write(rig, kept)
    return len(held.entries) - len(kept.entries)


def _write(rig: str | Path, held: Calibration) -> Path:
    path = calibration_path(rig)
    tables = {key: part for key, part in held.model_dump(exclude_none=True).items() if part}
    new = path.with_suffix(".new")
    head = "# Written by labnnum calibrate; the last entry of a channel holds.\n\n"
    new.write_text(head + dumps(tables), encoding="utf-8")
    new.replace(path)
    return path


def now() -> str:
    """The date as it is stored."""
    return datetime.now().astimezone().isoformat(timespec="seconds")


def stated(table: ChannelTable) -> float | None:
    """Volts per SI unit as the rig says; None if it does not."""
    return table.stored("").channel.sensitivity


def calibrated(table: RigChannel, known: Calibration, where: str = "") -> RigChannel:
    """The channel with its last calibration.

    Raises
    ------
    ConfigError
        The rig says something else than when the channel was calibrated: another sensor, perhaps.
    """
    changes: dict[str, Any] = {}
    sensitivity = _last(known.sensitivity, table.name)
    if sensitivity is not None:
        quantity = table.measured()
        _require_same(where, table.name, "sensitivity", stated(table), sensitivity.instead_of)
        changes |= {"sensitivity": sensitivity.value, "unit": SI_UNITS[quantity], "quantity": quantity, "gain": 1.0}
    full = _last(known.full_scale, table.name)
    if full is not None:
        _require_same(where, table.name, "full_scale", table.full_scale, full.instead_of)
        changes["full_scale"] = full.value
    return table.model_copy(update=changes) if changes else table


def _last(entries: Sequence[AnyEntry], channel: str) -> AnyEntry | None:
    return next((e for e in reversed(entries) if e.channel == channel), None)


def _require_same(where: str, channel: str, key: str, says: float | None, said: float | None) -> None:
    same = says == said if says is None or said is None else math.isclose(says, said, rel_tol=SAME)
    if not same:
        raise ConfigError(
            f"{where}channel {channel!r} was calibrated when its {key} was given as {_shown(said)}, and now it is"
            f" {_shown(says)}: calibrate it again, or remove the calibration (labnnum calibrate RIG --forget {channel})"
        )


def _shown(value: float | None) -> str:
    return "nothing" if value is None else f"{value:.6g} V"


def sensitivity_entry(table: RigChannel, found: Sensitivity, method: str) -> SensitivityEntry:
    """What is kept of a calibrated sensitivity."""
    try:
        before = stated(table)
    except InputError:
        before = None
    return SensitivityEntry(
        channel=table.name,
        date=now(),
        method=method,
        value=found.value,
        error=found.error,
        frequency=found.frequency,
        instead_of=before,
    )


def full_scale_entry(recorded: RigChannel, table: RigChannel, found: Sensitivity, method: str) -> FullScaleEntry:
    """What is kept of an input's range: `found` is its reading, in volts by the range of `recorded`, per true volt."""
    value = (recorded.full_scale or 1.0) / found.value
    error = value * found.error / found.value
    before = table.full_scale
    return FullScaleEntry(channel=table.name, date=now(), method=method, value=value, error=error, instead_of=before)


def rescaled(known: Calibration, channel: str, factor: float) -> list[SensitivityEntry]:
    """The channel's calibrated sensitivity once its input reads `factor` as many volts: sensor and input together
    were calibrated, and together they stay as they are.
    """
    held = _last(known.sensitivity, channel)
    if held is None:
        return []
    changes = {"value": held.value * factor, "error": held.error * factor, "date": now()}
    return [
        held.model_copy(update={**changes, "method": f"{held.method.split(', rescaled')[0]}, rescaled with its input"})
    ]


def input_entries(found: Mapping[str, InputResponse], reference: str, method: str) -> list[InputEntry]:
    """What is kept of inputs' responses."""
    return [
        InputEntry(channel=name, date=now(), method=method, reference=reference, **asdict(r))
        for name, r in found.items()
    ]


def run_info(known: Calibration) -> dict[str, Any]:
    """What a run keeps of the inputs, so that its FRFs can be corrected at any time."""
    responses = {n: {"delay": r.delay, "highpass": r.highpass} for n, r in known.responses.items()}
    return {"inputs": responses} if responses else {}


def without_inputs(frf: Frf, runs: Sequence[Run]) -> Frf:
    """The FRF with the delays and high-passes of the runs' inputs divided out; as it is where none are known."""
    told = runs[0].info.get("inputs", {}) if runs else {}
    return corrected(frf, {n: InputResponse(**r) for n, r in told.items()})
