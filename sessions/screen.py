"""Channels that cannot be trusted: not finite, constant, or clipped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.clipping import clipped_runs, runs
from labnnum.errors import ChannelError
from labnnum.recording import Recording
from sessions.exchange.imported import ImportedRun

KEEP = "or keep it as it is with --keep-bad"


def find_clipping(recording: Recording) -> tuple[tuple[int, int, int], ...]:
    """Overloads (channel number, start, stop) that the samples themselves show, monitors left out.

    Examples
    --------
    >>> from labnnum.recording import Channel
    >>> sine = np.sin(2 * np.pi * np.arange(1000) / 100)
    >>> pair = (Channel("a"), Channel("b"))
    >>> [c for c, _, _ in find_clipping(Recording(pair, np.array([sine, np.minimum(sine, 0.8)]), 1.0))][:1]
    [1]
    """
    found = []
    for i, (channel, row) in enumerate(zip(recording.channels, recording.data, strict=True)):
        if channel.role != "monitor":
            found += [(i, a, b) for a, b in clipped_runs(row)]
    return tuple(found)


def require_unclipped(recording: Recording, remedy: str = KEEP) -> None:
    """ChannelError that names the first channel clipped in a stretch that is used, how often, and the remedy."""
    spans = list(recording.spans())
    found = [one for one in find_clipping(recording) if any(one[1] < b and one[2] > a for a, b in spans)]
    if found:
        first, at, _ = found[0]
        times = sum(1 for c, _, _ in found if c == first)
        channel, value = recording.channels[first], recording.data[first, at]
        raise ChannelError(
            f"{recording.label}: channel {channel.name!r} is clipped at {value:.4g} {channel.unit} ({times} times,"
            f" first at sample {at}): lower the gain and record again, {remedy}"
        )


def screened(imported: Sequence[ImportedRun], keep_bad: bool) -> list[ImportedRun]:
    """Runs that may be stored: an error at the first bad channel, or with `keep_bad` what is bad marked as such."""
    return [_marked(run) if keep_bad else _sound(run) for run in imported]


def _sound(run: ImportedRun) -> ImportedRun:
    recording = run.recording()
    try:
        recording.require_finite()
    except ChannelError as error:
        raise ChannelError(f"{error}; leave the channel out of channels.toml, {KEEP}") from error
    require_unclipped(recording)
    return run


def _marked(run: ImportedRun) -> ImportedRun:
    """Samples that are not finite are excluded; clipped ones are overloads."""
    bad = ~np.isfinite(run.raw).all(axis=0) if run.raw.dtype.kind == "f" else np.zeros(run.raw.shape[1], bool)
    filled = replace(run, raw=_filled(run.raw))
    overloads = (*run.overloads, *find_clipping(filled.recording()))
    return replace(run, excluded=(*run.excluded, *runs(bad)), overloads=overloads)


def _filled(raw: NDArray) -> NDArray:
    return np.nan_to_num(raw, nan=0.0, posinf=0.0, neginf=0.0) if raw.dtype.kind == "f" else raw
