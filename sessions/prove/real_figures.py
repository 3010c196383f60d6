"""Figures of the real recordings, beside the table: measured responses and those of the base and of the named laws."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.joined import Predicted
from labnnum.diagnosis.nonlinear.recorder import Recorder
from sessions.report.figures import _STYLE, AFTER, BEFORE, MEASURED, svg


def levels_figure(path: Path, linear: Sequence[Predicted], extended: Sequence[Predicted], names: Sequence[str]) -> None:
    """SVG of the FRFs of every run (columns) and response (rows): measured, base, with the laws.

    Parameters
    ----------
    names : sequence of str
        Title of each run.
    """
    n = linear[0].measured.shape[0]
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(2.6 * len(names), 1.9 * n + 0.5), layout="constrained")
        axes = np.atleast_2d(fig.subplots(n, len(names), sharex=True, sharey="row"))
        for column, (name, plain, own) in enumerate(zip(names, linear, extended, strict=True)):
            for row in range(n):
                ax = axes[row, column]
                for y, colour, label in ((own.measured, MEASURED, "measured"), (plain.made, BEFORE, "base"),
                                         (own.made, AFTER, "with the laws")):  # fmt: skip
                    ax.semilogy(own.frequency, np.abs(y[row] / own.input), color=colour, lw=0.8, label=label)
                if column == 0:
                    ax.set_ylabel(own.run.outputs[row].name + " / input")
            axes[0, column].set_title(name, fontsize=8)
            axes[-1, column].set_xlabel("frequency, Hz")
        axes[0, 0].legend(fontsize=7)
        path.write_text(svg(fig), encoding="utf-8")


def record_figure(path: Path, rate: float, measured: NDArray, linear: NDArray, extended: NDArray, unit: str) -> None:
    """SVG of a record (n,) in time with the errors of the base model and of the extended one."""
    time = np.arange(measured.size) / rate
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 3.2), layout="constrained")
        upper, lower = fig.subplots(2, 1, sharex=True)
        upper.plot(time, measured, color=MEASURED, lw=0.3, rasterized=True)
        upper.set_ylabel(f"measured, {unit}")
        lower.plot(time, measured - linear, color=BEFORE, lw=0.3, rasterized=True, label="error, base")
        lower.plot(time, measured - extended, color=AFTER, lw=0.3, rasterized=True, label="error, with the laws")
        lower.set_ylabel(unit)
        lower.set_xlabel("time, s")
        lower.legend(fontsize=7)
        path.write_text(svg(fig), encoding="utf-8")


def filter_figure(path: Path, recorder: Recorder) -> None:
    """SVG of the filter in magnitude and phase, and above the excited band the harmonics that were recorded over those
    of the motion itself, as the model makes them.
    """
    seen, fault = recorder.shown or recorder.seen, recorder.fault
    f = np.linspace(0.0, seen.edges[-1], 400)[1:]
    through = fault.factor(2j * np.pi * f, back=True)
    phase = np.unwrap(np.angle(through))
    nearby = np.interp(seen.frequency, f, phase)
    measured = np.angle(seen.ratio * np.exp(-1j * nearby)) + nearby
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 3.6), layout="constrained")
        upper, lower = fig.subplots(2, 1, sharex=True)
        for ax, points, line, name in (
            (upper, np.abs(seen.ratio), np.abs(through), "magnitude"),
            (lower, np.degrees(measured), np.degrees(phase), "phase, degrees"),
        ):
            ax.plot(
                seen.frequency, points, "o", ms=4, color=MEASURED, label="harmonics, recorded over those of the motion"
            )
            ax.plot(f, line, color=AFTER, lw=1.2, label="the filter that was fitted")
            ax.axvline(seen.edges[0], color=BEFORE, lw=0.8, ls=":", label="highest excited line")
            ax.set_ylabel(name)
        upper.set_ylim(bottom=0.0)
        lower.set_xlabel("frequency, Hz")
        upper.legend(fontsize=7)
        path.write_text(svg(fig), encoding="utf-8")
