"""The nonlinear part of a diagnosis as a section: recovered force against motion and speed, with the law through it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labnnum.diagnosis import Diagnosis
from labnnum.diagnosis.nonlinear.decision import KNOWN
from labnnum.diagnosis.nonlinear.joined import Predicted, levels
from labnnum.diagnosis.nonlinear.shown import Drawn, of_each
from sessions.report.figures import _STYLE, AFTER, BEFORE, MEASURED, fixed, svg
from sessions.report.figures import RASTER_FROM as MANY
from sessions.report.numbers import percent
from sessions.report.sections import Section, figure, table

SHOWN = 8
"""Responses that are drawn."""


def nonlinear_section(d: Diagnosis) -> Section | None:
    """Signs of nonlinearity, over all levels and level by level, what was tried, and the restoring force of each law
    that was found, level by level; None where there is nothing to say.
    """
    found = d.detail.get("nonlinear")
    by_level = signs_by_level(d.nonlinear.get("per_level", ()))
    if found is None and not by_level:
        return None
    rows = [
        ["change of the FRFs, lowest to highest level", _share(d.nonlinear.get("level_dependence"))],
        ["odd distortion, the largest of all runs", _db(d.nonlinear.get("odd_distortion_db"))],
        ["even distortion, the largest of all runs", _db(d.nonlinear.get("even_distortion_db"))],
    ]
    if found is not None:
        rows += [
            ["chi-square per value, base model", f"{found.study.base.data_part / found.study.base.count:.3g}"],
            ["chi-square per value, with the laws", f"{found.misfit:.3g}"],
        ]
    body = table(["sign", "value"], rows, (1,)) + by_level
    drawn = of_each(found) if found is not None else ()
    if drawn:
        body += Markup("<p>{}</p>").format(
            "The force that the base model lacks at a place, recovered line by line from the responses, against the"
            " motion and the speed there, where several laws are named with the others' forces known. A law without"
            " memory is one line; a loop is friction or hysteresis."
        )
    for one in drawn:
        body += Markup("<h3>{} at {}, {}</h3>").format(one.name, one.spot.place, one.spot.axis.lstrip("-"))
        body += figure(
            restoring_figure(one),
            "Dark: recovered. Blue: the law along the same motion, a line where it is a function of it.",
        )
    return Section("nonlinear", "Nonlinear physics" if found is not None else "Signs of nonlinear physics", body)


KINDS = {"periodic": "periods", "random": "noise or sweep", "hammer": "hits", "frf": "FRFs"}
UNITS = {"periodic": "RMS", "random": "RMS", "hammer": "peak"}


def signs_by_level(rows: Sequence[Mapping[str, Any]]) -> Markup:
    """What each level shows, a row a level; empty where no level shows anything that could be told."""
    if not rows:
        return Markup("")
    orders = list(dict.fromkeys(k for r in rows for k in r["harmonics"] or {}))
    parts = list(dict.fromkeys(k for r in rows for k in r["shares"] or {}))
    head = ["recorded", "level", "runs", "change of the FRFs", "odd distortion", "even distortion"]
    head += [f"order {k}" for k in orders] + [f"{name}" for name in parts]
    body = []
    for r in rows:
        level = "–" if r["level"] is None else f"{r['level']:.3g} {UNITS.get(r['kind'], '')}"
        change = "–" if r["change"] is None else percent(r["change"])
        row = [KINDS.get(r["kind"], r["kind"]), level, r["runs"], change, _beyond(r, "odd"), _beyond(r, "even")]
        told = [(r["harmonics"] or {}).get(k) for k in orders]
        row += ["–" if x is None else f"{x:.1f} dB" for x in told]
        shares = [(r["shares"] or {}).get(k) for k in parts]
        body.append(row + ["–" if x is None else percent(max(x, 0.0)) for x in shares])
    text = (
        "Level by level, the quietest first: the change of the FRFs from the quietest level; what stands on detection"
        " lines, relative to the lines that were played, and by how much it stands above the noise there; the harmonics"
        " of a sweep, relative to its fundamental; and shares of the responses' power, in the mean, that ordinary"
        " coherence lacks, by what made them. A dash: this excitation does not tell."
    )
    return Markup("<p>{}</p>").format(text) + table(head, body, tuple(range(1, len(head))))


def _beyond(row: Mapping[str, Any], name: str) -> str:
    """Distortion in dB, and in brackets how far above the noise."""
    value, above = row[f"{name}_db"], row[f"{name}_over_noise_db"]
    if value is None:
        return "–"
    return f"{value:.1f} dB" + ("" if above is None else f" ({above:+.1f})")


def levels_section(d: Diagnosis) -> Section | None:
    """FRFs of every run beside those of the base model and of the model with its laws; None for a linear diagnosis."""
    found = d.detail.get("nonlinear")
    if found is None:
        return None
    with_laws = bool(found.named) or found.reason == KNOWN
    base = levels(found, linear=True)
    extended = levels(found) if with_laws else None
    n_train = len(found.study.runs)
    shown = each_level([(p.run.level, i >= n_train) for i, p in enumerate(base)])
    body = Markup("<p>{}</p>").format(
        "The FRF that each run measured, and what the models make of the same input"
        + (": the laws are simulated in time at that run's level. " if with_laws else ". ")
        + "One run a level; "
        + ("those marked as held out were not fitted to. " if d.held_apart else "all were fitted, none was held out. ")
        + "Below: what each model leaves of it."
    )
    body += errors_table(d)
    outputs = base[0].run.outputs
    for o in range(min(len(outputs), SHOWN)):
        drawn = levels_figure(base, extended, o, shown, n_train)
        body += figure(drawn, f"{outputs[o].name} over {base[0].run.input.name}")
    return Section("fit", "Before and after, level by level", body)


def errors_table(d: Diagnosis) -> Markup:
    """Errors of base and extended model, over what was fitted and what was held out."""
    kinds = {"base (parameters updated)": d.base_error, "extended": d.extended_error}
    rows = [
        [kind, percent(error[0]), percent(error[1]) if d.held_apart else "none was"] for kind, error in kinds.items()
    ]
    return table(
        ["model", "error, training", "error, held out"], [*rows, ["noise floor", "", percent(d.noise_floor)]], (1, 2)
    )


def each_level(runs: Sequence[tuple[float, bool]], same: float = 1.1) -> list[int]:
    """Numbers of the runs to draw: one a level, a run held out rather than one that was fitted to, levels ascending.

    Parameters
    ----------
    runs : sequence of (level, held out)
    same : float
        Ratio of two levels up to which they count as one.

    Examples
    --------
    >>> each_level([(1.0, False), (3.0, False), (3.1, True)])
    [0, 2]
    """
    out: list[int] = []
    for i in sorted(range(len(runs)), key=lambda i: runs[i][0]):
        if out and runs[i][0] < same * runs[out[-1]][0]:
            if runs[i][1] and not runs[out[-1]][1]:
                out[-1] = i
        else:
            out.append(i)
    return out


def levels_figure(
    base: Sequence[Predicted], extended: Sequence[Predicted] | None, o: int, shown: Sequence[int], n_train: int
) -> str:
    """SVG: FRF and residuals of response `o`, a column a run of `shown`."""
    with matplotlib.rc_context(_STYLE):
        width = max(7.5, 2.2 * len(shown))
        fig = Figure(figsize=(width, 4.0))
        margins = {"left": 0.7 / width, "right": 1 - 0.1 / width, "bottom": 0.12, "top": 0.88, "wspace": 0.08}
        axes = fig.subplots(
            2, len(shown), sharex="col", sharey="row", squeeze=False, height_ratios=(3, 2), gridspec_kw=margins
        )
        for (top, low), i in zip(axes.T, shown, strict=True):
            plain = base[i]
            f, measured = plain.frf()
            top.semilogy(f, np.abs(measured[o]), color=MEASURED, lw=1.4, label="measured", rasterized=f.size > MANY)
            curves = [("base", BEFORE, "--", plain.frf(made=True)[1][o])]
            if extended is not None:
                curves.append(("extended", AFTER, "-", extended[i].frf(made=True)[1][o]))
            for name, colour, style, h in curves:
                top.semilogy(f, np.abs(h), color=colour, lw=1.0, ls=style, label=name, rasterized=f.size > MANY)
                left = np.abs(h - measured[o]) + 1e-300
                low.semilogy(f, left, color=colour, lw=0.9, rasterized=f.size > MANY)
            held = ", held out" if i >= n_train else ""
            top.set_title(f"input {plain.run.level:.3g} RMS{held}", fontsize=8, y=1.0)
            low.set_xlabel("frequency, Hz")
            for ax in (top, low):
                fixed(ax, -0.55 / (width / len(shown)))
        handles, labels = axes[0, 0].get_legend_handles_labels()
        at = (0.7 / width, 1.0)
        fig.legend(handles, labels, ncols=3, fontsize=8, loc="upper left", bbox_to_anchor=at, borderpad=0)
        for ax, name in zip(axes[:, 0], ("|FRF|", "residual"), strict=True):
            ax.set_ylabel(name)
        return svg(fig)


def _share(x: float | None) -> str:
    return "one level only" if x is None else percent(x)


def _db(x: float | None) -> str:
    return "no detection lines" if x is None else f"{x:.1f} dB relative to the excited lines"


MOVING, TURNING = ("motion, m", "speed, m/s", "force, N"), ("rotation, rad", "rate, rad/s", "moment, N m")
"""What stands along the axes where a place moves, and where it turns."""


def restoring_figure(found: Drawn) -> str:
    """SVG: restoring force of a law against displacement and velocity, a row a run."""
    turns = found.spot.axis.lstrip("-").startswith("r")
    motion, speed, force = TURNING if turns else MOVING

    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 2.3 * len(found.curves) + 0.4))
        axes = np.atleast_2d(fig.subplots(len(found.curves), 2))
        for row, c in zip(axes, found.curves, strict=True):
            for ax, x, name in ((row[0], c.z, motion), (row[1], c.v, speed)):
                ax.plot(x, c.force, ".", ms=1.2, color=MEASURED, alpha=0.5, rasterized=True)
                order = np.argsort(x)
                line = one_line(c.law[order])
                style = {"lw": 1.2} if line else {"ls": "", "marker": ".", "rasterized": True}
                ax.plot(x[order], c.law[order], color=AFTER, markersize=0.8, **style)
                ax.set_xlabel(name)
                ax.ticklabel_format(axis="x", scilimits=(-2, 4))
            row[0].set_ylabel(force)
            row[0].set_title(f"input {c.level:.3g} RMS", fontsize=8)
        fig.tight_layout()
        return svg(fig)


WAY = 8.0
"""Way up and down along an axis, of its range, beyond which a law is no function of what is drawn there."""


def one_line(law: NDArray[np.float64]) -> bool:
    """Whether a law's forces (n,), ordered by motion or by speed, are a function of it: else they jump to and fro.

    >>> one_line(np.linspace(-1, 1, 50) ** 3), one_line(np.tile([-1.0, 1.0], 25))
    (True, False)
    """
    return bool(np.sum(np.abs(np.diff(law))) <= WAY * np.ptp(law))
