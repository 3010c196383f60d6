"""channels.toml written by the program: what exported files say about themselves."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from labnnum.frf import Frf
from labnnum.recording import Channel, Recording

CHANNELS_KEY = "channels_toml"
"""Name of the array in NPZ and MAT files that holds the text."""


def recording_toml(recording: Recording, sources: Sequence[str | int] | None = None) -> str:
    """channels.toml of a recording whose samples are written in SI units."""
    lines = [f"sample_rate = {recording.rate!r}"]
    if recording.period:
        lines += [f"period = {recording.period}", f"drop_periods = {recording.drop_periods}"]
    if not math.isnan(recording.level):
        lines.append(f"level = {recording.level!r}")
    if recording.breaks:
        lines.append(f"breaks = {list(recording.breaks)}")
    if recording.excluded:
        lines.append(f"excluded = {[list(e) for e in recording.excluded]}")
    if recording.overloads:
        names = [recording.channels[c].name for c, _, _ in recording.overloads]
        pairs = zip(names, recording.overloads, strict=True)
        lines.append(f"overloads = {json.dumps([[n, a, b] for n, (_, a, b) in pairs], ensure_ascii=False)}")
    return "\n".join([*lines, *_channels(recording.channels, sources)]) + "\n"


def frf_toml(frf: Frf, rows: Sequence[dict[str, Any]] | None = None) -> str:
    """channels.toml of an FRF: whole arrays "f", "H", "coherence", "variance", or the given columns a row."""
    lines = ["[frf]", f"frequency = {_toml('f' if rows is None else 0)}"]
    if rows is None:
        lines.append('value = "H"')
        lines += [f'{key} = "{key}"' for key in ("coherence", "variance") if getattr(frf, key) is not None]
    lines.append(f"n_averages = {frf.n_averages!r}")
    lines.append(f"estimator = {_toml(frf.estimator)}")
    settings = {k: v for k, v in frf.settings.items() if isinstance(v, (str, int, float, bool))}
    if settings:
        lines += ["", "[frf.settings]", *(f"{_toml(str(k))} = {_toml(v)}" for k, v in settings.items())]
    for row in rows or ():
        lines += ["", "[[frf.row]]", *(f"{key} = {_toml(value)}" for key, value in row.items())]
    return "\n".join([*lines, *_channels((*frf.outputs, *frf.inputs))]) + "\n"


def _channels(channels: Sequence[Channel], sources: Sequence[str | int] | None = None) -> list[str]:
    lines: list[str] = []
    for i, channel in enumerate(channels):
        kept = ("name", "quantity", "unit", "role", "node", "direction")
        said: dict[str, str | int] = {k: getattr(channel, k) for k in kept if getattr(channel, k)}
        if sources is not None:
            said["source"] = sources[i]
        lines += ["", "[[channel]]", *(f"{key} = {_toml(value)}" for key, value in said.items())]
    return lines


def _toml(value: str | float | bool) -> str:
    """A TOML value."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    return json.dumps(value, ensure_ascii=False)
