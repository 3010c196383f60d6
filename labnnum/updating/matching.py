"""The channels of a measurement brought into the order, direction and quantity that an updater or model expects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labnnum.errors import ChannelError
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.recording import Channel


def matched(frf: Frf, outputs: Sequence[Channel], inputs: Sequence[Channel]) -> Frf:
    """The part of an Frf that belongs to `outputs` and `inputs`, in their order, with their signs and quantities.

    Raises
    ------
    ChannelError
        Naming the first place that the measurement lacks, or a quantity that cannot be converted.
    """
    columns = [_find(c, frf.inputs, "input") for c in inputs]
    rows = [_find(c, frf.outputs, "response") for c in outputs]
    cut = _cut(frf, rows, columns)
    cut = _converted(cut, outputs)
    signs = np.array([a.sign * b.sign for a, b in zip(outputs, cut.outputs, strict=True)])
    pushes = np.array([a.sign * b.sign for a, b in zip(inputs, cut.inputs, strict=True)])
    value = cut.value * signs[:, None, None] * pushes[None, :, None]
    return replace(cut, value=value, outputs=tuple(outputs), inputs=tuple(inputs))


def _kind(channel: Channel) -> str:
    """Motion or effort, so that places match only what can be converted."""
    if channel.quantity in MOTION_ORDER:
        return "rotation" if channel.quantity.startswith("ang") else "motion"
    return channel.quantity


def _find(wanted: Channel, offered: Sequence[Channel], part: str) -> int:
    for i, channel in enumerate(offered):
        base = wanted.role == "base" and channel.role == "base"
        if (base or (channel.dof == wanted.dof and wanted.dof)) and _kind(channel) == _kind(wanted):
            return i
    place = wanted.dof or ("the base" if wanted.role == "base" else wanted.name)
    there = ", ".join(f"{c.name} ({c.dof or c.role})" for c in offered)
    raise ChannelError(
        f"the measurement has no {part} at {place} ({wanted.quantity}); it has {there}: measure it, or train without it"
    )


def _cut(frf: Frf, rows: list[int], columns: list[int]) -> Frf:
    pick = np.ix_(rows, columns)
    spectrum = None if frf.input_spectrum is None else frf.input_spectrum[np.ix_(columns, columns)]
    return replace(
        frf, value=frf.value[pick], outputs=tuple(frf.outputs[r] for r in rows),
        inputs=tuple(frf.inputs[c] for c in columns),
        coherence=None if frf.coherence is None else frf.coherence[rows],
        variance=None if frf.variance is None else frf.variance[pick], input_spectrum=spectrum,
    )  # fmt: skip


def _converted(frf: Frf, outputs: Sequence[Channel]) -> Frf:
    """Responses brought to the wanted derivative, one factor (i omega)^k a row."""
    power = [MOTION_ORDER[w.quantity] - MOTION_ORDER[c.quantity] for w, c in zip(outputs, frf.outputs, strict=True)]
    if not any(power):
        return frf
    kept = frf.at(frf.frequency > 0) if min(power) < 0 else frf
    factor = (1j * kept.omega)[None, :] ** np.array(power)[:, None]
    variance = None if kept.variance is None else kept.variance * np.abs(factor[:, None]) ** 2
    return replace(kept, value=kept.value * factor[:, None], variance=variance)
