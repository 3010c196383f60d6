"""Leakage: parameters from time records of the simulated bench, the model seen through the data's window and not.

The truck stands on the bench, a random force at its wheel; the driver's seat is measured without any noise. H1 with a
Hann window is taken with blocks of several lengths from one record, and the model is fitted to each from its nominal
parameters. Every set has parameters of its own, drawn from their prior.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from drivers.simulated import Drive, Input, Player, SimulatedBench, plant
from labnnum.estimators import H1, Welch
from labnnum.excitation import random
from labnnum.frf import Frf
from labnnum.parameters import truncated_samples
from labnnum.recording import Recording
from labnnum.response import modes
from labnnum.structures.examples import EXAMPLES, Example
from labnnum.updating.refine import refine
from sessions.report.figures import AFTER, BEFORE, MEASURED, svg
from sessions.reproduce.networks import Say
from sessions.simulate import settling

RATE = 32.0
"""Samples per second; the bands end below 7 Hz."""

SECONDS = 1600.0
"""Length of a record."""

LENGTHS = (10.0, 20.0, 40.0, 80.0)
"""s in a block."""

SEEN, EXACT = "seen through the window", "as it is"
"""How the model is compared with the FRF."""


def record(example: Example, theta: NDArray, seed: int) -> Recording:
    """Force and response of the simulated bench, once it has settled."""
    structure = example.structure
    channels = (example.inputs[0], example.outputs[0])
    inputs, drive = [Input(c) for c in channels], Drive(channels[0])
    lead, frames = round(settling(structure, theta) * RATE), round(SECONDS * RATE)
    player = Player()
    player.play(random(RATE, lead + frames, (0.2, 12.0), seed=seed).samples, repeat=False)
    bench = SimulatedBench(plant(structure, theta, inputs, [drive]), inputs, [player], RATE, block=4096, seed=seed)
    bench.start()
    blocks, have = [], 0
    while have < lead + frames:
        blocks.append(bench.read().data)
        have += blocks[-1].shape[1]
    return Recording(channels, np.hstack(blocks)[:, lead : lead + frames], RATE)


def estimated(recording: Recording, seconds: float) -> Frf:
    """H1 with Hann windows that overlap by half, without the lines that the excitation leaves out."""
    return H1(Welch(round(seconds * RATE), "hann", 0.5))(recording).lines(0.4, 11.0)


def leakage(sets: int, seed: int, say: Say) -> dict[str, Any]:
    """Errors in percent and in stated standard deviations for each length of block; ready for JSON."""
    example = EXAMPLES["truck"]()
    free = example.structure.parameters
    truth = truncated_samples(free, np.random.default_rng(seed + 1).random((sets, len(free))))
    error = {(length, how): np.empty((sets, 2, len(free))) for length in LENGTHS for how in (SEEN, EXACT)}
    for i, theta in enumerate(truth):
        recording = record(example, theta, seed * 100_000 + i)
        for length in LENGTHS:
            frf = estimated(recording, length)
            for how in (SEEN, EXACT):
                view = "auto" if how == SEEN else None
                found = refine(example.structure, frf, bands=example.bands, view=view)
                off = found.value - theta
                error[length, how][i] = 100 * off / theta, off / found.std
        say("records", i + 1, sets)
    narrowest = modes(example.structure, example.structure.nominal)
    width = float((2 * narrowest.damping_ratio * narrowest.frequency).min())
    rows = [
        {"seconds": length, "how": how, "lines_per_bandwidth": width * length,
         "bias_percent": e[:, 0].mean(axis=0).tolist(),
         "bias_standard_error": (e[:, 0].std(axis=0) / np.sqrt(max(sets - 1, 1))).tolist(),
         "bias_std": e[:, 1].mean(axis=0).tolist(), "rms_std": np.sqrt((e[:, 1] ** 2).mean(axis=0)).tolist(),
         "rms_percent": np.sqrt((e[:, 0] ** 2).mean(axis=0)).tolist(),
         "beyond_three": int((np.abs(e[:, 1]) > 3).sum())}
        for (length, how), e in error.items()
    ]  # fmt: skip
    return {"sets": sets, "seed": seed, "seconds": SECONDS, "rate": RATE, "names": [p.name for p in free], "rows": rows}


def leakage_table(found: dict[str, Any]) -> str:
    """Text: a line for each length and each way to see the model."""
    names = found["names"]
    lines = [
        f"Truck from x3 and the force, {found['sets']} records of {found['seconds']:g} s without noise, H1, Hann, half"
        f" overlapping (seed {found['seed']})",
        "bias in % +- its standard error; RMS error in stated standard deviations (1 is honest);"
        f" errors beyond three, of {found['sets'] * len(names)}",
        f"{'block s':>8}{'lines/bw':>9}  {'model':24}"
        + "".join(f"{n + ' %':>19}" for n in names)
        + "".join(f"{n + ' std':>8}" for n in names)
        + f"{'beyond 3':>10}",
    ]
    for row in found["rows"]:
        bias = [f"{b:.3g} +- {s:.2g}" for b, s in zip(row["bias_percent"], row["bias_standard_error"], strict=True)]
        lines.append(
            f"{row['seconds']:8g}{row['lines_per_bandwidth']:9.1f}  {row['how']:24}"
            + "".join(f"{b:>19}" for b in bias)
            + "".join(f"{r:8.2f}" for r in row["rms_std"])
            + f"{row['beyond_three']:10d}"
        )
    return "\n".join(lines) + "\n"


def leakage_figure(found: dict[str, Any]) -> str:
    """Bias against the length of the block, parameter by parameter."""
    names = found["names"]
    figure = Figure(figsize=(9.0, 3.0), layout="constrained")
    axes = figure.subplots(1, len(names), squeeze=False)[0]
    for j, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for how, colour in ((EXACT, BEFORE), (SEEN, AFTER)):
            rows = [r for r in found["rows"] if r["how"] == how]
            axis.errorbar(
                [r["seconds"] for r in rows], [r["bias_percent"][j] for r in rows],
                [2 * r["bias_standard_error"][j] for r in rows], color=colour, marker="o", ms=3, lw=1.0, label=how,
            )  # fmt: skip
        axis.axhline(0, color=MEASURED, lw=0.8)
        axis.set(xscale="log", title=name, xlabel="block (s)")
    axes[0].set_ylabel("bias (%)")
    axes[0].legend(fontsize=7)
    return svg(figure)
