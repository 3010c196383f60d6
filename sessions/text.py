"""A snapshot as text for the terminal: what goes on, overloads, hits with their reasons, the FRF in small."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from sessions.snapshot import Curves, Snapshot

BARS = " ▁▂▃▄▅▆▇█"
WIDTH = 48
LAST = 8


def render(snapshot: Snapshot) -> RenderableType:
    """The snapshot as lines and tables."""
    parts: list[RenderableType] = [_headline(snapshot), _plan(snapshot), _channels(snapshot)]
    if snapshot.hits:
        last = snapshot.hits[-1]
        unit = snapshot.units[snapshot.inputs[0]] if snapshot.inputs else ""
        parts.append(Text(last.headline(unit), style="bold white on " + ("green" if last.accepted else "red")))
        parts.append(_hits(snapshot))
    if snapshot.curves is not None:
        parts.append(_frf(snapshot.curves))
    parts += [Text(f"  {m}", style="yellow") for m in snapshot.messages]
    return Group(*parts)


def _headline(s: Snapshot) -> Text:
    out = Text(f"{s.state}   {s.time:.1f} s", style="bold")
    if not math.isnan(s.target):
        level = "–" if math.isnan(s.level) else f"{s.level:.4g}"
        volts = "" if math.isnan(s.volts) else f" at {s.volts:.3g} V RMS"
        out.append(f"   level {level} of {s.target:g} {s.level_unit} RMS{volts}", style="default")
    if s.lost or s.overflows:
        out.append(f"   {s.lost} frames lost, {s.overflows} overflows", style="bold red")
    return out


def _plan(s: Snapshot) -> Text:
    out = Text()
    done = sum(p.done >= p.total for p in s.progress)
    out.append(f"{done} of {len(s.progress)} done", style="green")
    for p in s.progress:
        if p.current:
            share = min(p.done / p.total, 1.0) if p.total else 0.0
            count = f"{p.done}/{p.total}" if p.total <= 100 else f"{share:.0%}"
            out.append(f"   {p.key} {'█' * round(20 * share):░<20} {count}")
    return out


def _channels(s: Snapshot) -> Table:
    table = Table(box=None, pad_edge=False)
    for title in ("channel", "peak", "RMS", "", "spectrum"):
        table.add_column(title, justify="right" if title in ("peak", "RMS") else "left")
    for i, (name, unit) in enumerate(zip(s.names, s.units, strict=True)):
        row = s.scope[i] if s.scope.shape[1] else np.zeros(1)
        lamp = _lamp(s, i, unit)
        table.add_row(
            name, f"{np.abs(row).max():.4g}", f"{np.sqrt(np.mean(row**2)):.4g}", lamp, _bars(s.spectrum[i], 32)
        )
    return table


def _lamp(s: Snapshot, row: int, unit: str) -> Text:
    if s.over_now[row : row + 1] == (True,):
        return Text("OVERLOAD", style="bold white on red")
    return Text(f"{unit} was over", style="yellow") if s.overload[row : row + 1] == (True,) else Text(unit)


def _hits(s: Snapshot) -> Table:
    accepted = sum(h.accepted for h in s.hits)
    table = Table(title=f"{accepted} of {len(s.hits)} hits accepted", box=None, pad_edge=False, title_justify="left")
    for title in ("hit", "peak", "", "why"):
        table.add_column(title, overflow="fold")
    for hit in s.hits[-LAST:]:
        word = Text("accepted", style="green") if hit.accepted else Text("rejected", style="red")
        table.add_row(str(hit.index), f"{hit.peak:.4g}", word, hit.reason)
    return table


def _frf(c: Curves) -> Table:
    table = Table(title=f"FRF, {c.averages:.3g} averages", box=None, pad_edge=False, title_justify="left")
    for title in ("", f"|H| {c.frequency[0]:.4g} - {c.frequency[-1]:.4g} Hz", "coherence"):
        table.add_column(title, no_wrap=True)
    for i, name in enumerate(c.names):
        coherence = "" if c.coherence is None else f"{np.nanmean(c.coherence[i]):.3f}"
        table.add_row(name, _bars(c.magnitude[i], WIDTH), coherence)
    return table


def _bars(values: NDArray, width: int) -> str:
    """The largest value of each stretch, on a logarithmic scale of 60 dB, as bars."""
    if values.size < 2:
        return ""
    edges = np.linspace(0, values.size, min(width, values.size) + 1).astype(int)
    peaks = np.array([np.max(values[a:b]) for a, b in pairwise(edges)])
    with np.errstate(divide="ignore"):
        level = 20 * np.log10(peaks / max(float(peaks.max()), 1e-300))
    steps = np.clip((level + 60) / 60 * (len(BARS) - 1), 0, len(BARS) - 1)
    return "".join(BARS[round(float(k))] for k in np.nan_to_num(steps))
