"""What lowers the coherence, told apart: a table by bands, shares over frequency, and the harmonics of a sweep."""

from __future__ import annotations

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from labnnum.orders import CLEAR, Orders
from labnnum.split import Split
from labnnum.split.base import SURE
from sessions.report.content import Content
from sessions.report.figures import _STYLE, AFTER, BEFORE, MEASURED, RASTER_FROM, TRUTH, fixed, svg
from sessions.report.numbers import percent
from sessions.report.sections import Section, figure, folded, notes, table
from sessions.splitting import Told, shown, told_of

OPEN = 4
"""Responses whose shares are drawn at once; further ones are folded."""
MEAN_OVER = 60
"""Part of all lines over which a drawn share is a running mean."""
COLOURS = (AFTER, BEFORE, TRUTH, "#8e5aa8", "#7a6a53")
BELOW = 1e-6
"""Share below which nothing is drawn."""
LOWEST = -140.0
"""dB below which no harmonic is drawn: rounding."""


def apart_section(content: Content) -> Section | None:
    """Where the coherence of the FRF goes; None where nothing was told apart."""
    frf = content.frf
    told = None if frf is None else told_of(content.results, str(frf.settings.get("stored", "")))
    if told is None:
        return None
    return Section("coherence", "What lowers the coherence", told_body(told))


def told_body(told: Told) -> Markup:
    """Table, figures and remarks of what was told apart."""
    if told.split is None:
        return notes([f"Nothing was told apart: {told.untold}"])
    split = told.split
    body = Markup("<p>{}</p>").format(EXPLAINED[split.kind])
    body += bands_table(split)
    drawn = [
        figure(shares_figure(split, i), f"{c.name}: shares of its power, each a running mean over some lines.")
        for i, c in enumerate(split.outputs)
    ]
    body += Markup("").join(drawn[:OPEN])
    if len(drawn) > OPEN:
        body += folded(f"{len(drawn) - OPEN} further responses", Markup("").join(drawn[OPEN:]))
    if told.harmonics is not None:
        body += harmonics_body(told.harmonics)
    remarks = [*split.remarks, *([told.untold] if told.untold else [])]
    return body + notes(remarks, "fine") if remarks else body


SEEN = " Below means that noise alone would make no more of it."
EXPLAINED = {
    "periods": "Ordinary coherence over all periods, those that are still transient too, is one less all of these"
    " shares of a response's power. Noise differs from period to period; nonlinear distortion repeats with the periods"
    " and differs from one realisation to the next; the transient is what the first periods hold beyond the later"
    " ones. Distortion on detection lines is the power where nothing was played, of that on the played lines around."
    + SEEN,
    "record": "Ordinary coherence over all segments is one less all of these shares of a response's power. Leakage is"
    " what the segments' ends put in: longer segments, or the local estimator, lower it. Ends of the record are what is"
    " put into the whole of it in the same way." + SEEN,
    "hits": "Ordinary coherence over all hits is one less all of these shares of a response's power. Noise is as loud"
    " as before the blow; the rest is what differs from hit to hit: where it fell and how hard, if the structure"
    " changes with level. What rings on past the end is cut off from all hits alike, so that coherence does not show"
    " it." + SEEN,
}


def bands_table(split: Split) -> Markup:
    """Mean shares of each response over octaves."""
    names = [*split.parts, *split.beside]
    rows = []
    for row in split.table():
        found = row["parts"] | row["beside"]
        cells = [shown(**found[name]) for name in names]
        rows.append([row["response"], f"{row['low']:.4g} to {row['high']:.4g}", percent(row["lost"]), *cells])
    head = ["response", "band, Hz", "1 − coherence", *split.parts, *(f"({name})" for name in split.beside)]
    text = table(head, rows, tuple(range(2, len(head))))
    return text + Markup("<p>{}</p>").format("In brackets: what coherence does not see.") if split.beside else text


def shares_figure(split: Split, o: int) -> str:
    """SVG: shares of response `o` over frequency, and what coherence lacks of one."""
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(9.0, 2.7), layout="constrained")
        ax = fig.subplots()
        f = split.frequency
        many = f.size > RASTER_FROM
        ax.plot(f, _drawn(1 - split.coherence[o]), color=MEASURED, lw=1.6, label="1 − coherence", rasterized=many)
        for (name, part), colour in zip((*split.parts.items(), *split.beside.items()), COLOURS, strict=False):
            y = _drawn(part[o], split.chance[name][o], split.related.get(name, 1.0))
            style = "-" if name in split.parts else ":"
            ax.plot(f, y, color=colour, lw=1.2, ls=style, label=name, rasterized=many)
        ax.set(yscale="log", xlabel="frequency (Hz)", ylabel="share of power", xlim=(f[0], f[-1]))
        low, high = ax.get_ylim()
        ax.set_ylim(max(low, BELOW), min(high, 2.0))
        ax.legend(ncols=3, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)
        fixed(ax, -0.07)
        ax.xaxis.set_label_coords(0.5, -0.13)
    return svg(fig)


def _drawn(x: NDArray, chance: NDArray | None = None, related: float = 1.0) -> NDArray[np.float64]:
    """A running mean, with gaps where noise alone would make as much."""
    width = max(x.size // MEAN_OVER, 1)
    mean = uniform_filter1d(x, width, mode="nearest")
    least = np.full(x.size, BELOW)
    if chance is not None:
        spread = np.sqrt(
            np.maximum(uniform_filter1d(chance**2, width, mode="nearest"), 0.0) * min(related, width) / width
        )
        least = np.maximum(least, SURE * spread)
    return np.where(mean > least, mean, np.nan)


# -------------------------------------------------------------------- harmonics


def harmonics_body(found: Orders) -> Markup:
    """Harmonics of a sweep: a table and a figure a channel."""
    rows = [
        [
            r["channel"],
            r["order"],
            "below the floor" if r["power_db"] is None else f"{r['power_db']:.1f}",
            f"{r['floor_db']:.1f}",
            "–" if r["largest_db"] is None else f"{r['largest_db']:.1f}",
            "–" if r["at_hz"] is None else f"{r['at_hz']:.4g}",
        ]
        for r in found.table()
    ]
    text = (
        "Harmonics while the sine sweeps, in dB relative to the fundamental of the same channel at the same time: those"
        " of the input are the exciter's own, and a response holds what the structure makes of them too. The floor is"
        " what no multiple of the played frequency explains."
    )
    body = Markup("<h3>Harmonics of the sweep</h3><p>") + escape(text) + Markup("</p>")
    head = ["channel", "order", "over the sweep, dB", "floor, dB", "largest, dB", "played then, Hz"]
    body += table(head, rows, (1, 2, 3, 4, 5))
    drawn = [
        figure(
            orders_figure(found, i), f"{c.name}{' (input)' if i == 0 else ''}: its orders over the frequency played."
        )
        for i, c in enumerate(found.channels)
    ]
    body += Markup("").join(drawn[: OPEN + 1])
    if len(drawn) > OPEN + 1:
        body += folded(f"{len(drawn) - OPEN - 1} further responses", Markup("").join(drawn[OPEN + 1 :]))
    return body


def orders_figure(found: Orders, i: int) -> str:
    """SVG: orders from 2 on of channel `i` in dB over the played frequency, the floor under each thin."""
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(9.0, 2.4), layout="constrained")
        ax = fig.subplots()
        levels, floors = found.decibels(i), found.floor(i)
        clear = found.amplitude[i, 1:] > CLEAR * found.noise[i, 1:]
        for level, floor, there, order, colour in zip(
            levels, floors, clear, found.order[1:], (*COLOURS, *COLOURS), strict=False
        ):
            ax.plot(found.frequency, floor, color=colour, lw=0.6, ls=":")
            ax.plot(found.frequency, np.where(there, level, np.nan), color=colour, lw=1.3, label=f"order {order}")
        told = np.concatenate([levels[clear], floors[np.isfinite(floors)]])
        if told.size:
            ax.set_ylim(max(np.min(told) - 5, LOWEST), max(np.max(told) + 5, LOWEST + 20))
        ax.set(xlabel="played (Hz)", ylabel="dB", xlim=(found.frequency[0], found.frequency[-1]))
        handles, labels = ax.get_legend_handles_labels()
        ax.legend(handles, labels, ncols=5, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)
        fixed(ax, -0.06)
        ax.xaxis.set_label_coords(0.5, -0.15)
    return svg(fig)
