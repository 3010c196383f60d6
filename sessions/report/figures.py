"""Pictures of a report, as SVG text without a display: matplotlib's Agg, no global state."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from numpy.typing import NDArray

from labnnum.frf import Frf
from labnnum.parameters import Estimate
from labnnum.recording import Channel
from sessions.estimates import StoredEstimate
from sessions.report.numbers import pretty_unit

MEASURED, BEFORE, AFTER, TRUTH = "#1b2631", "#d9822b", "#1f6fb2", "#2e8b57"
"""Colours that stay apart for colour-blind readers and in grey print."""

RASTER_FROM = 2500
"""Lines of an FRF from which a curve is stored as an image inside the SVG, which would grow too large."""

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "path",
    "svg.hashsalt": "labnnum",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a949e",
    "axes.labelcolor": "#3b4650",
    "xtick.color": "#5b6670",
    "ytick.color": "#5b6670",
    "axes.grid": True,
    "grid.color": "#e6eaee",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "savefig.dpi": 200,
}


def svg(figure: Figure) -> str:
    """The figure as an <svg> element that scales with the page and shares no ids with another."""
    text = io.StringIO()
    with matplotlib.rc_context(_STYLE):
        figure.savefig(text, format="svg", metadata={"Date": None})
    body = text.getvalue()
    body = body[body.index("<svg") :]
    body = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", body, count=1)
    body = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", body, count=1)
    return _own_ids(body)


def fixed(ax: Axes, left: float) -> None:
    """Labels at fixed places, the y label at `left` (axes' widths), and no ticks inside a decade of a logarithmic y.

    Looking for where labels do not touch, tick by tick, takes longer than drawing.
    """
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_label_coords(left, 0.5)
    ax.xaxis.set_label_coords(0.5, -0.28)


def _own_ids(body: str) -> str:
    """Ids made the figure's own, as several figures stand in one page."""
    mark = hashlib.sha256(body.encode()).hexdigest()[:8]
    body = re.sub(r'\bid="([^"]+)"', rf'id="f{mark}-\1"', body)
    body = re.sub(r'href="#([^"]+)"', rf'href="#f{mark}-\1"', body)
    return re.sub(r"url\(#([^)]+)\)", rf"url(#f{mark}-\1)", body)


def frf_figure(frf: Frf, output: int, source: int, model: StoredEstimate | None = None) -> str:
    """Magnitude, phase and coherence of one FRF with its random error, and the model before and after.

    Parameters
    ----------
    frf : Frf
    output, source : int
        Numbers of the response and of the input.
    model : StoredEstimate, optional
        Curves of the model on its own lines; bands that entered the estimate are shaded.

    Returns
    -------
    str
        SVG.
    """
    with matplotlib.rc_context(_STYLE):
        ratios = [3.0, 1.3] + ([1.0] if frf.coherence is not None else [])
        figure = Figure(figsize=(9.0, 1.05 * sum(ratios)), layout="constrained")
        axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios, squeeze=False)[:, 0]
        _magnitude(axes[0], frf, output, source, model)
        _phase(axes[1], frf, output, source, model)
        if frf.coherence is not None:
            _coherence(axes[2], frf, output)
        for axis in axes:
            _shade(axis, model)
        axes[-1].set(xlabel="frequency (Hz)", xlim=excited(frf))
        figure.align_ylabels(axes)
    return svg(figure)


def excited(frf: Frf) -> tuple[float, float]:
    """Lowest and highest line, in Hz, at which every input has power; all lines where that is not known."""
    f = frf.frequency
    if frf.input_spectrum is not None:
        power = np.einsum("iif->if", frf.input_spectrum).real
        live = np.flatnonzero((power > 1e-3 * power.max(axis=1, keepdims=True)).all(axis=0))
        if live.size > 1:
            f = f[live]
    return float(f[0]), float(f[-1])


def bands_figure(frf: Frf, output: int, source: int, model: StoredEstimate) -> str:
    """Magnitude of one FRF close up, one panel for each band that entered the estimate; "" if there is none."""
    bands = [b for b in model.bands if np.count_nonzero((frf.frequency >= b[0]) & (frf.frequency <= b[1])) > 1]
    if not bands:
        return ""
    columns = min(len(bands), 4)
    rows = -(-len(bands) // columns)
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 2.1 * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False)
        for axis in axes.flat[len(bands) :]:
            axis.set_visible(False)
        for axis, (low, high) in zip(axes.flat, bands, strict=False):
            reach = 0.15 * (high - low)
            kept = (model.frequency >= low - reach) & (model.frequency <= high + reach)
            near = frf.lines(low - reach, high + reach)
            _error_band(axis, near, output, source)
            size = np.abs(near.value[output, source])
            axis.plot(near.frequency, size, ".", color=MEASURED, ms=3)
            axis.plot(
                model.frequency[kept], np.abs(model.before[output, source, kept]), color=BEFORE, lw=1.1, ls=(0, (4, 2))
            )
            axis.plot(model.frequency[kept], np.abs(model.after[output, source, kept]), color=AFTER, lw=1.2)
            axis.axvspan(low, high, color=AFTER, alpha=0.07, lw=0, zorder=0)
            axis.set(yscale="log", xlim=(low - reach, high + reach), xlabel="Hz")
            axis.tick_params(labelsize=8)
    return svg(figure)


def _error_band(axis: Axes, frf: Frf, output: int, source: int) -> None:
    if frf.error_magnitude is None:
        return
    size = np.abs(frf.value[output, source])
    shown = np.where(size > 0, size, np.nan)
    error = np.minimum(frf.error_magnitude[output, source], 0.999 / 2)
    axis.fill_between(
        frf.frequency,
        shown * (1 - 2 * error),
        shown * (1 + 2 * error),
        color=MEASURED,
        alpha=0.18,
        lw=0,
        label="± 2 random errors",
        rasterized=frf.frequency.size > RASTER_FROM,
    )


def _curve(axis: Axes, x: NDArray, y: NDArray, colour: str, **how) -> None:
    axis.plot(x, y, color=colour, rasterized=x.size > RASTER_FROM, **how)


def _magnitude(axis: Axes, frf: Frf, output: int, source: int, model: StoredEstimate | None) -> None:
    size = np.abs(frf.value[output, source])
    nothing = np.where(size > 0, size, np.nan)
    _error_band(axis, frf, output, source)
    _curve(axis, frf.frequency, nothing, MEASURED, lw=1.1, label="measured")
    if model is not None:
        before, after = np.abs(model.before[output, source]), np.abs(model.after[output, source])
        _curve(axis, model.frequency, before, BEFORE, lw=1.2, ls=(0, (4, 2)), label="model before")
        _curve(axis, model.frequency, after, AFTER, lw=1.4, label="model after")
    low, high = excited(frf)
    seen = nothing[(frf.frequency >= low) & (frf.frequency <= high)]
    if np.isfinite(seen).any():
        axis.set_ylim(np.nanmin(seen) / 2, np.nanmax(seen) * 2)
    axis.set_yscale("log")
    axis.set_ylabel(f"|H|  ({_unit(frf.outputs[output], frf.inputs[source])})")
    axis.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)


def _phase(axis: Axes, frf: Frf, output: int, source: int, model: StoredEstimate | None) -> None:
    x, y = _unjumped(frf.frequency, np.angle(frf.value[output, source], deg=True))
    _curve(axis, x, y, MEASURED, lw=1.0)
    if model is not None:
        for value, colour, style in ((model.before, BEFORE, (0, (4, 2))), (model.after, AFTER, "-")):
            x, y = _unjumped(model.frequency, np.angle(value[output, source], deg=True))
            _curve(axis, x, y, colour, lw=1.2, ls=style)
    axis.set(ylabel="phase (°)", ylim=(-190, 190), yticks=[-180, -90, 0, 90, 180])


def _unjumped(x: NDArray, degrees: NDArray) -> tuple[NDArray, NDArray]:
    """Gaps put where the phase wraps, so that no vertical line is drawn."""
    at = np.flatnonzero(np.abs(np.diff(degrees)) > 270) + 1
    return np.insert(x, at, np.nan), np.insert(degrees, at, np.nan)


def _coherence(axis: Axes, frf: Frf, output: int) -> None:
    assert frf.coherence is not None
    _curve(axis, frf.frequency, frf.coherence[output], MEASURED, lw=1.0)
    axis.set(ylabel="coherence", ylim=(0, 1.05), yticks=[0, 0.5, 1])


def _shade(axis: Axes, model: StoredEstimate | None) -> None:
    for low, high in model.bands if model is not None else ():
        axis.axvspan(low, high, color=AFTER, alpha=0.07, lw=0, zorder=0)


def _unit(output: Channel, source: Channel) -> str:
    if output.unit == source.unit:
        return "1"
    over, under = pretty_unit(output.unit), pretty_unit(source.unit)
    return f"{f'({over})' if '/' in over else over}/{f'({under})' if '/' in under else under}"


def residual_figure(frf: Frf, output: int, source: int, model: StoredEstimate) -> str:
    """Misfit of the model before and after, in random errors of the measurement; "" where none is known.

    Within ± 2 lies what chance explains.
    """
    if frf.variance is None:
        return ""
    rows = np.searchsorted(frf.frequency, model.frequency)
    rows = np.clip(rows, 0, frf.frequency.size - 1)
    same = np.isclose(frf.frequency[rows], model.frequency, rtol=1e-9)
    rows, kept = rows[same], np.flatnonzero(same)
    std = np.sqrt(frf.variance[output, source, rows])
    measured = frf.value[output, source, rows]
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 1.9), layout="constrained")
        axis = figure.subplots()
        for value, colour, label in ((model.before, BEFORE, "model before"), (model.after, AFTER, "model after")):
            gap = np.abs(measured - value[output, source, kept]) / np.where(std > 0, std, np.nan)
            axis.plot(
                model.frequency[kept],
                gap,
                ".",
                ms=2.6,
                color=colour,
                label=label,
                rasterized=kept.size > RASTER_FROM,
            )
        axis.axhline(2, color="#8a949e", lw=0.9, ls=(0, (2, 2)))
        axis.set(yscale="log", xlabel="frequency (Hz)", ylabel="|misfit| / std", ylim=(0.03, None))
        axis.set_xlim(*excited(frf))
        axis.legend(ncols=2, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)
        _shade(axis, model)
    return svg(figure)


def parameters_figure(estimate: Estimate, truth: Mapping[str, float]) -> str:
    """Each parameter within its bounds: nominal, estimate with one and two standard deviations, truth if known."""
    n = len(estimate.parameters)
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 0.5 * n + 0.75), layout="constrained")
        axis = figure.subplots()
        for row, (p, value, std) in enumerate(zip(estimate.parameters, estimate.value, estimate.std, strict=True)):
            y, width = n - 1 - row, p.upper - p.lower
            at, reach = (value - p.lower) / width, std / width
            axis.plot([0, 1], [y, y], color="#d5dbe1", lw=5, solid_capstyle="round", zorder=1)
            axis.plot((p.nominal - p.lower) / width, y, "|", color=BEFORE, ms=13, mew=2.2, zorder=2)
            axis.plot([at - 2 * reach, at + 2 * reach], [y, y], color=AFTER, lw=1.6, zorder=3)
            axis.plot([at - reach, at + reach], [y, y], color=AFTER, lw=4.5, zorder=3, solid_capstyle="butt")
            axis.plot(at, y, "o", color=AFTER, ms=6, mec="white", mew=1.0, zorder=4)
            if p.name in truth:
                axis.plot((truth[p.name] - p.lower) / width, y, "D", color=TRUTH, ms=5, mfc="none", mew=1.5, zorder=5)
        axis.set(ylim=(-0.6, n - 0.4), yticks=range(n), xticks=[0, 0.5, 1])
        axis.set_yticklabels([p.name for p in reversed(estimate.parameters)])
        axis.set_xticklabels(["lower bound", "middle", "upper bound"])
        axis.grid(visible=False)
        axis.spines[["left", "bottom"]].set_visible(False)
        axis.tick_params(length=0)
        _parameter_legend(axis, bool(truth))
    return svg(figure)


def _parameter_legend(axis: Axes, with_truth: bool) -> None:
    from matplotlib.lines import Line2D

    entries = [
        Line2D([], [], color=BEFORE, marker="|", ls="", ms=11, mew=2.2, label="nominal"),
        Line2D([], [], color=AFTER, marker="o", lw=1.6, ms=6, mec="white", label="estimate, ± 1 and ± 2 std"),
    ]
    if with_truth:
        entries.append(Line2D([], [], color=TRUTH, marker="D", ls="", ms=5, mfc="none", mew=1.5, label="truth"))
    axis.legend(handles=entries, ncols=3, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)


def correlation_figure(names: Sequence[str], correlation: NDArray) -> str:
    """Correlation matrix of the estimate, with its figures."""
    n = len(names)
    side = 1.3 + 0.52 * n
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(side + 0.7, side), layout="constrained")
        axis = figure.subplots()
        shown = np.where(np.eye(n, dtype=bool), 0.0, correlation)
        axis.imshow(shown, cmap="RdBu_r", vmin=-1.3, vmax=1.3)
        for i in range(n):
            for j in range(n):
                colour = "#9aa5af" if i == j else "white" if abs(shown[i, j]) > 0.75 else MEASURED
                axis.text(j, i, f"{correlation[i, j]:+.2f}", ha="center", va="center", color=colour, fontsize=8)
        axis.set(xticks=range(n), yticks=range(n))
        axis.set_xticklabels(names, rotation=35, ha="right")
        axis.set_yticklabels(names)
        axis.grid(visible=False)
        axis.spines[:].set_visible(False)
        axis.tick_params(length=0)
    return svg(figure)
