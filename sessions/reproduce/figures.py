"""Figures of a study: histograms of the error, and the FRF of the worst case, as the dissertation shows them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from sessions.report.figures import AFTER, BEFORE, MEASURED, svg
from sessions.reproduce.study import Study

_PRINTED = "network as printed"


def histograms(done: Study) -> str:
    """Signed errors of every parameter: both networks without noise; refined beside the bound at the highest noise."""
    n, noise = len(done.names), max(done.effort.noises)
    figure = Figure(figsize=(max(2.1 * n, 6.0), 5.6), layout="constrained")
    axes = figure.subplots(3, n, squeeze=False)
    for row, (method, colour) in enumerate((("printed", BEFORE), ("network", AFTER))):
        e = done.of(method, 0.0)
        for j in range(n if e is not None else 0):
            assert e is not None
            axes[row, j].hist(e.signed[:, j], bins=61, color=colour, histtype="stepfilled", alpha=0.7)
    for j, name in enumerate(done.names):
        _against_the_bound(axes[2, j], done, j, noise)
        axes[0, j].set_title(name, fontsize=9)
        axes[2, j].set(xlabel="error (%)")
    axes[0, 0].set_ylabel(f"{_PRINTED},\nno noise (sets)")
    axes[1, 0].set_ylabel("our network,\nno noise (sets)")
    axes[2, 0].set_ylabel(f"refined,\n{100 * noise:g} % noise (sets)")
    if axes[2, 0].get_legend_handles_labels()[0]:
        axes[2, 0].legend(fontsize=7)
    return svg(figure)


def _against_the_bound(axis: Axes, done: Study, j: int, noise: float) -> None:
    """Refined errors with the density that estimates on the bound would have."""
    refined, bound = done.of("refined", noise), done.of("bound", noise)
    if refined is None:
        return
    error = refined.signed[:, j]
    reach = np.quantile(np.abs(error), 0.999) if error.any() else 1.0
    edges = np.linspace(-reach, reach, 51)
    axis.hist(error, bins=edges.tolist(), color=AFTER, histtype="stepfilled", alpha=0.6)
    if bound is not None:
        deviation = np.abs(bound.signed[:, j]) * np.sqrt(np.pi / 2)
        x = (edges[1:] + edges[:-1]) / 2
        density = np.exp(-0.5 * (x[:, None] / deviation) ** 2) / (np.sqrt(2 * np.pi) * deviation)
        axis.plot(x, density.sum(axis=1) * (edges[1] - edges[0]), color=MEASURED, lw=1.2, label="at the bound")


def worst_frfs(done: Study) -> str:
    """The FRF of the set that each network does worst on, without noise: true, and from what was estimated."""
    methods = [(m, label) for m, label in (("printed", _PRINTED), ("network", "our network")) if done.of(m, 0.0)]
    if not methods:
        return ""
    solver, labels = done.case.solver(), done.case.labels
    shown = min(len(labels), 3)
    figure = Figure(figsize=(9.0, 2.2 * shown), layout="constrained")
    axes = figure.subplots(shown, len(methods), squeeze=False)
    for column, (method, label) in enumerate(methods):
        e = done.of(method, 0.0)
        assert e is not None
        worst = int((np.abs(e.signed) / e.most).max(axis=1).argmax()) if e.signed.any() else 0
        truth = done.truth[worst]
        pair = solver.frf(np.array([truth, truth * (1 + e.signed[worst] / 100)]))
        flat = pair.reshape(2, -1, pair.shape[-1])
        title = f"{label}: worst of {len(done.truth)} sets, {np.abs(e.signed[worst]).max():.3g} %"
        axes[0, column].set_title(title, fontsize=8)
        for row in range(shown):
            _overlaid(axes[row, column], done, flat[:, row], labels[row])
    axes[0, 0].legend(fontsize=7)
    return svg(figure)


def _overlaid(axis: Axes, done: Study, pair: NDArray, label: str) -> None:
    """True and estimated |H|, bands apart from each other."""
    f = done.case.frequency
    for number, band in enumerate(done.case.bands):
        inside = (f >= band.low) & (f <= band.high)
        for value, colour, style, what in ((pair[0], MEASURED, "-", "true"), (pair[1], BEFORE, "--", "estimated")):
            axis.plot(
                f[inside], np.abs(value[inside]), color=colour, ls=style, lw=1.1, label=what if not number else None
            )
    axis.set(yscale="log", ylabel=f"|{label}|", xlabel="frequency (Hz)")
