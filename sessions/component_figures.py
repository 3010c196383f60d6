"""Loops of component tests: force against motion and against speed, with the laws through them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labnnum.component_laws import ComponentTest, Vector
from labnnum.component_loops import steady_cycles
from sessions.report.figures import _STYLE, AFTER, BEFORE, MEASURED
from sessions.small_svg import write_svg

POINTS = 160
"""Of a drawn curve."""


def loops_figure(
    path: Path, tests: Sequence[ComponentTest], laws: Sequence[tuple[str, Sequence[Vector]]], titles: Sequence[str]
) -> None:
    """SVG with a column for each test: the last steady cycle of the force (kN) against motion (mm) and speed (m/s).

    Parameters
    ----------
    laws : sequence of (name, forces)
        The law that is named, then one that is shown for comparison; a force (n,) for each test.
    titles : sequence of str
        Of the columns.
    """
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(max(2.3 * len(tests), 4.6), 4.4), layout="constrained")
        axes = fig.subplots(2, len(tests), sharey=True, squeeze=False)
        for column, (test, title) in enumerate(zip(tests, titles, strict=True)):
            shown = _thinned(steady_cycles(test)[-1])
            curves = [("measured", test.f, MEASURED, 0.8)]
            curves += [(n, f[column], c, 1.2) for (n, f), c in zip(laws, (AFTER, BEFORE), strict=False)]
            for row, x in enumerate((1e3 * test.z, test.v)):
                for name, f, colour, width in curves:
                    axes[row, column].plot(x[shown], 1e-3 * f[shown], color=colour, lw=width, label=name)
            axes[0, column].set_title("\n".join(wrap(title, 26)), fontsize=7)
            axes[0, column].set_xlabel("motion, mm")
            axes[1, column].set_xlabel("speed, m/s")
        for row in (0, 1):
            axes[row, 0].set_ylabel("force, kN")
        handles, names = axes[0, 0].get_legend_handles_labels()
        fig.legend(handles, names, loc="outside lower center", ncols=3, fontsize=8)
        write_svg(path, fig)


def _thinned(cycle: slice) -> NDArray[np.intp]:
    """Samples of a cycle, some of them."""
    return np.unique(np.linspace(cycle.start, cycle.stop - 1, POINTS).round().astype(np.intp))
