"""Figures of the real recordings, beside the table: measured responses and those of the base and of the named laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.joined import Predicted
from labnnum.diagnosis.nonlinear.recorder import Recorder
from sessions.report.figures import _STYLE, AFTER, BEFORE, MEASURED
from sessions.small_svg import write_svg


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
        write_svg(path, fig)


BINS = 300
"""Stretches of a long record that are drawn as one point."""


def record_figure(path: Path, rate: float, measured: NDArray, linear: NDArray, extended: NDArray, unit: str) -> None:
    """SVG of a record (n,) in time, least and largest value of each stretch; and stretch by stretch the RMS of the
    record and of what the base model and the extended one leave of it.
    """
    cuts = np.linspace(0, measured.size, min(BINS, measured.size) + 1).astype(int)[:-1]
    count = np.diff([*cuts, measured.size])
    time = (cuts + count / 2) / rate
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 3.8), layout="constrained")
        upper, lower = fig.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.4))
        upper.fill_between(
            time, np.minimum.reduceat(measured, cuts), np.maximum.reduceat(measured, cuts), color=MEASURED, lw=0.4
        )
        upper.set_ylabel(f"measured, {unit}")
        for y, colour, label in ((measured, MEASURED, "measured"), (measured - linear, BEFORE, "error of the base"),
                                 (measured - extended, AFTER, "error with the laws")):  # fmt: skip
            rms = np.sqrt(np.add.reduceat(y**2, cuts) / count)
            lower.semilogy(time, rms, color=colour, lw=0.9, label=label)
        lower.set_ylabel(f"RMS, {unit}")
        lower.set_xlabel("time, s")
        lower.minorticks_off()
        lower.legend(fontsize=7, ncols=3, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.1)
        write_svg(path, fig)


Peaks = Mapping[str, Sequence[tuple[float, float, float, bool]]]
"""Kind of excitation -> level (N RMS), frequency measured, simulated (Hz), whether no fit saw it."""


def withheld_figure(path: Path, linear: Predicted, extended: Predicted, title: str, peaks: Peaks) -> None:
    """SVG of the FRFs of a run that no fit saw, measured, of the base and with the laws, sensor by sensor; and of the
    frequency of one peak over the levels, measured and simulated, where it was found.
    """
    n = linear.measured.shape[0]
    (f, measured), (_, base), (_, laws) = extended.frf(), linear.frf(made=True), extended.frf(made=True)
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(8.2, 1.7 * n + 0.4), layout="constrained")
        grid = fig.add_gridspec(n, 2, width_ratios=(1.7, 1.0))
        axes = [fig.add_subplot(grid[i, 0]) for i in range(n)]
        for i, ax in enumerate(axes):
            for y, colour, label in ((measured, MEASURED, "measured"), (base, BEFORE, "base"),
                                     (laws, AFTER, "with the laws")):  # fmt: skip
                ax.semilogy(f, np.abs(y[i]), color=colour, lw=0.9, label=label)
            ax.set_ylabel(f"{extended.run.outputs[i].name} / input")
            ax.minorticks_off()
        axes[0].set_title(title, fontsize=8)
        axes[0].legend(fontsize=7)
        axes[-1].set_xlabel("frequency, Hz")
        side = fig.add_subplot(grid[:, 1])
        for (kind, points), style in zip(peaks.items(), ("-", "--"), strict=False):
            level, seen, made = (np.array([p[i] for p in points], float) for i in range(3))
            side.plot(level, seen, "o" + style, color=MEASURED, ms=4, lw=0.8, label=f"{kind}, measured")
            side.plot(level, made, "s" + style, color=AFTER, ms=4, lw=0.8, label=f"{kind}, simulated")
            held = np.array([p[3] for p in points], bool)
            side.plot(level[held], seen[held], "o", color="none", mec=BEFORE, ms=9)
        side.set_xlabel("force, N RMS (ringed: withheld)")
        side.set_ylabel("frequency of the torsion peak, Hz")
        side.legend(fontsize=7)
        write_svg(path, fig)


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
        write_svg(path, fig)
