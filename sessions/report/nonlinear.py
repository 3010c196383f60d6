"""The nonlinear part of a diagnosis as a section: recovered force against motion and speed, with the law through it."""

from __future__ import annotations

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from labnnum.diagnosis import Diagnosis
from sessions.report.figures import _STYLE, AFTER, MEASURED, svg
from sessions.report.numbers import percent
from sessions.report.sections import Section, figure, table


def nonlinear_section(d: Diagnosis) -> Section | None:
    """Signs of nonlinearity, what was tried, and the restoring force level by level; None for a linear diagnosis."""
    found = d.detail.get("nonlinear")
    if found is None:
        return None
    rows = [
        ["change of the FRFs, lowest to highest level", _share(d.nonlinear.get("level_dependence"))],
        ["odd distortion", _db(d.nonlinear.get("odd_distortion_db"))],
        ["even distortion", _db(d.nonlinear.get("even_distortion_db"))],
        ["chi-square per value, base model", f"{found.study.base.data_part / found.study.base.count:.3g}"],
        ["chi-square per value, with the laws", f"{found.misfit:.3g}"],
    ]
    body = table(["sign", "value"], rows, (1,))
    if found.curves:
        body += Markup("<p>{}</p>").format(
            "The force that the base model lacks at the place, recovered line by line from the responses, against the"
            " motion and the speed there. A law without memory is one line; a loop is friction or hysteresis."
        )
        body += figure(restoring_figure(d), "Dots: recovered. Line: the best law along the same motion.")
    return Section("nonlinear", "Nonlinear physics", body)


def _share(x: float | None) -> str:
    return "one level only" if x is None else percent(x)


def _db(x: float | None) -> str:
    return "no detection lines" if x is None else f"{x:.1f} dB under the excited lines"


def restoring_figure(d: Diagnosis) -> str:
    """SVG: restoring force against displacement and velocity, a row a level."""
    curves = d.detail["nonlinear"].curves
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 2.3 * len(curves) + 0.4))
        axes = np.atleast_2d(fig.subplots(len(curves), 2))
        for row, c in zip(axes, curves, strict=True):
            for ax, x, name in ((row[0], c.z, "motion, m"), (row[1], c.v, "speed, m/s")):
                ax.plot(x, c.force, ".", ms=1.2, color=MEASURED, alpha=0.5, rasterized=True)
                order = np.argsort(x)
                style = {"color": AFTER, "lw": 1.2} if ax is row[0] else {"color": AFTER, "ls": "", "marker": "."}
                ax.plot(x[order], c.law[order], **style, markersize=0.8)
                ax.set_xlabel(name)
            row[0].set_ylabel("force, N")
            row[0].set_title(f"input {c.level:.3g} RMS", fontsize=8)
        fig.tight_layout()
        return svg(fig)
