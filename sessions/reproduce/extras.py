"""What is shown beside the tables of errors: control of the truck, control while it drifts, flags, and leakage."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from labnnum.structures.examples import TRUCK_PARAMETERS
from sessions.report.figures import AFTER, BEFORE, MEASURED, svg
from sessions.reproduce.control import control, control_table
from sessions.reproduce.drift import Block, drift
from sessions.reproduce.flags import flags, flags_table
from sessions.reproduce.keep import write
from sessions.reproduce.leakage import leakage, leakage_figure, leakage_table
from sessions.reproduce.networks import Say
from sessions.reproduce.page import page

Extra = Callable[[int, int, Path, Say], str]
"""(how many sets or blocks, seed, folder, progress) -> the table; files are written to the folder."""

STAGES = ("frf", "network", "refinement", "gains")


def write_control(sets: int, seed: int, folder: Path, say: Say) -> str:
    """Gains for the nominal, the estimated and the exact model."""
    found = control(sets, seed, say)
    table = control_table(found)
    return _written(folder, "control", "Control of the driver's seat", table, found, [])


def write_flags(sets: int, seed: int, folder: Path, say: Say) -> str:
    """False alarms and misses of the flags."""
    found = flags(sets, seed, say)
    return _written(folder, "flags", "Flags", flags_table(found), found, [])


def write_drift(blocks: int, seed: int, folder: Path, say: Say) -> str:
    """The loop closed while the truck drifts."""
    walk = drift(blocks, seed, say)
    found = [
        {"end_s": b.end, "truth": b.truth.tolist(), "estimate": b.estimate.tolist(), "std": b.std.tolist(),
         "fixed": b.fixed, "adaptive": b.adaptive, "latency_s": b.latency, "warnings": b.warnings}
        for b in walk
    ]  # fmt: skip
    return _written(folder, "drift", "Control while the truck drifts", drift_table(walk), found, [drift_figure(walk)])


def write_leakage(sets: int, seed: int, folder: Path, say: Say) -> str:
    """Parameters from time records, with the window's view of the model and without."""
    found = leakage(sets, seed, say)
    table = leakage_table(found)
    return _written(folder, "leakage", "Leakage", table, found, [leakage_figure(found)])


def _written(folder: Path, name: str, title: str, table: str, found: object, figures: Sequence[str]) -> str:
    write(folder, f"{name}.txt", table)
    write(folder, f"{name}.html", page(title, [("Figures", table, figures)]))
    write(folder, f"{name}.json", json.dumps(found, indent=1))
    return table


EXTRAS: dict[str, tuple[Extra, int]] = {
    "control": (write_control, 5000),
    "drift": (write_drift, 90),
    "flags": (write_flags, 200),
    "leakage": (write_leakage, 40),
}
"""Word -> what writes it, and how many sets (of each kind) or blocks it takes by default."""


def drift_table(walk: Sequence[Block]) -> str:
    """Text: errors, latencies, and what became of both gains."""
    error = np.array([100 * np.abs(b.estimate / b.truth - 1) for b in walk])
    inside = np.array([np.abs(b.estimate - b.truth) <= 2 * b.std for b in walk])
    lines = [
        f"{len(walk)} blocks of {walk[0].end:g} s in simulated real time; the gain follows after each",
        f"{'parameter':12}{'mean error %':>14}{'largest %':>12}{'within 2 std':>14}",
    ]
    for j, p in enumerate(TRUCK_PARAMETERS):
        lines.append(f"{p.name:12}{error[:, j].mean():14.3g}{error[:, j].max():12.3g}{inside[:, j].mean():14.2f}")
    for name, pairs in (("nominal gain", [b.fixed for b in walk]), ("following gain", [b.adaptive for b in walk])):
        rate, margin = np.array(pairs).T
        lines.append(
            f"{name}: unstable after {int((rate <= 0).sum())} of {len(walk)} blocks, slowest decay {rate.min():.3g}"
            f" 1/s, least modulus margin {margin.min():.3g}"
        )
    times = {s: 1e3 * np.array([b.latency[s] for b in walk]) for s in STAGES}
    lines.append("latency, median / largest in ms: " + ", ".join(
        f"{s} {np.median(t):.2g} / {t.max():.2g}" for s, t in times.items()))  # fmt: skip
    return "\n".join(lines) + "\n"


def drift_figure(walk: Sequence[Block]) -> str:
    """Parameters, decay of both loops, margins and latencies over time."""
    t = np.array([b.end for b in walk]) / 60
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    for j, p in enumerate(TRUCK_PARAMETERS):
        line = axes[0].plot(t, [b.truth[j] / p.nominal for b in walk], lw=1.0)[0]
        axes[0].plot(t, [b.estimate[j] / p.nominal for b in walk], ".", color=line.get_color(), ms=4, label=p.name)
    axes[0].set_ylabel("parameters over nominal\n(lines true, points estimated)")
    axes[0].legend(ncols=5, fontsize=7)
    for number, label in ((0, "decay (1/s)"), (1, "modulus margin")):
        axes[1 + number].plot(t, [b.fixed[number] for b in walk], color=BEFORE, label="nominal gain")
        axes[1 + number].plot(t, [b.adaptive[number] for b in walk], color=AFTER, label="following gain")
        axes[1 + number].set_ylabel(label)
    axes[1].axhline(0, color=MEASURED, lw=0.8)
    axes[1].legend(fontsize=7)
    for stage in STAGES:
        axes[3].plot(t, [1e3 * b.latency[stage] for b in walk], lw=1.0, label=stage)
    axes[3].set(yscale="log", ylabel="latency (ms)", xlabel="time (min)")
    axes[3].legend(ncols=4, fontsize=7)
    return svg(figure)
