"""The page beside an identified model: stabilisation diagram, measured and synthesised FRFs, modes, shapes and MAC."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labnnum import __version__
from labnnum.correlation import mac
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.identification import IDENTIFIED, Identified
from labnnum.identification_residues import PoleResidues
from labnnum.stabilisation import DAMPING_STAYS, FREQUENCY_STAYS
from sessions.report.figures import _STYLE, AFTER, BEFORE, MEASURED, RASTER_FROM, TRUTH, fixed, svg
from sessions.report.numbers import percent, quantity, with_error
from sessions.report.page import _template
from sessions.report.sections import FIGURES_OPEN, Section, figure, folded, notes, table

FAINT = "#b9c2ca"


@dataclass(frozen=True, eq=False)
class IdentifiedPage:
    """What the page shows.

    `frf` holds the lines of the band; `free` the same poles with complex residues and residual terms, None where the
    lines are too few for them; `remarks` what the user must know beforehand; `order` the highest of the diagram.
    """

    name: str
    recording: str
    frf: Frf
    found: Identified
    free: PoleResidues | None
    order: int
    remarks: Sequence[str] = ()

    @property
    def fitted(self) -> NDArray[np.complex128]:
        """FRFs of the model, as they were measured, (n_out, n_f)."""
        rise = np.array([MOTION_ORDER[c.quantity] for c in self.frf.outputs])
        sign = np.array([c.sign for c in self.frf.outputs]) * self.frf.inputs[0].sign
        return self.found.fitted * sign[:, None] * (1j * self.frf.omega) ** rise[:, None]


def write_identified(path: Path, page: IdentifiedPage) -> Path:
    """The page at `path`."""
    found = page.found
    made = [modes_section(page), diagram_section(page), frf_section(page), shapes_section(page), settings_section(page)]
    n = len(found.frequency)
    what = f"{n} mode{'' if n == 1 else 's'} identified; the model misses {percent(found.error)} of the FRFs"
    beyond = f", {percent(found.structure.error)} of them beyond noise" if found.structure.error > IDENTIFIED else ""
    facts = [(str(n), "modes in the band"), (percent(found.error), "error of the model, real modes")]
    if page.free is not None:
        facts.append((percent(page.free.error), "with complex residues and residual terms"))
    text = _template().render(
        title=f"Identified: {page.name}", date=time.strftime("%Y-%m-%d %H:%M"), facts=facts, version=__version__,
        verdict=(f"{what}{beyond}.", "doubt" if page.remarks else "good"), sections=[s for s in made if s is not None],
    )  # fmt: skip
    path.write_text(text, encoding="utf-8")
    return path


# -------------------------------------------------------------------- modes


def modes_section(page: IdentifiedPage) -> Section:
    """Natural frequencies and damping ratios as written, and with complex residues and standard deviations."""
    found, free = page.found, page.free
    head = ["mode", "natural frequency", "damping ratio", "stable at"]
    rows = [
        [str(i), f"{f:.6g} Hz", f"{100 * z:.4g} %", _steadiness(page, f)]
        for i, (f, z) in enumerate(zip(found.frequency, found.damping_ratio, strict=True), 1)
    ]
    if free is not None and len(free.frequency) == len(rows):
        head += ["frequency, complex residues", "damping ratio, complex residues", "phase collinearity"]
        for i, row in enumerate(rows):
            row += [
                with_error(free.frequency[i], free.frequency_std[i], "Hz"),
                f"{with_error(100 * free.damping_ratio[i], 100 * free.damping_std[i])} %",
                f"{free.collinearity[i]:.3f}",
            ]
    body = notes(list(page.remarks)) + table(head, rows, tuple(range(1, len(head))))
    body += Markup("<p>{}</p>").format(
        "The first columns are what the model holds: real modes. With complex residues each response may lag on its"
        " own, and standard deviations (after ±) count the noise and what the modes miss as if that were noise. A phase"
        " collinearity of 1 says that all places move in phase, as those of a real mode do."
    )
    return Section("modes", "Modes", body)


def _steadiness(page: IdentifiedPage, frequency: float) -> str:
    d = page.found.stabilisation
    here = d.stable & (np.abs(d.frequency - frequency) < FREQUENCY_STAYS * frequency)
    return f"{np.unique(d.order[here]).size} of {len(range(4, page.order + 1, 2))} orders"


# -------------------------------------------------------------------- diagram


def diagram_section(page: IdentifiedPage) -> Section:
    """The stabilisation diagram over the sum of the FRFs' magnitudes."""
    caption = (
        f"Decaying poles of each order over the sum of |FRF|, each over its RMS. A frequency is stable where the order"
        f" before has it within {percent(FREQUENCY_STAYS)}, a damping ratio within {percent(DAMPING_STAYS)}."
        f" Lines: the modes of the model."
    )
    return Section("stabilisation", "Stabilisation diagram", figure(diagram_figure(page), caption))


KINDS = (
    ("not stable", FAINT, "x", 16, lambda d: ~(d.stable | d.frequency_stays | d.damping_stays)),
    ("damping stable", TRUTH, "s", 13, lambda d: d.damping_stays & ~d.frequency_stays),
    ("frequency stable", BEFORE, "^", 15, lambda d: d.frequency_stays & ~d.stable),
    ("both stable", AFTER, "o", 15, lambda d: d.stable),
)
"""Name, colour, marker and size of each kind of pole, and which of a diagram's poles are of it."""


def diagram_figure(page: IdentifiedPage) -> str:
    """SVG of the diagram: poles by order, and the sum of magnitudes behind."""
    d, frf = page.found.stabilisation, page.frf
    size = np.abs(frf.value[:, 0])
    size = size / np.maximum(np.sqrt(np.mean(size**2, axis=1, keepdims=True)), 1e-300)
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(9.0, 4.6), layout="constrained")
        below = fig.subplots()
        many = frf.frequency.size > RASTER_FROM
        below.semilogy(frf.frequency, size.sum(axis=0), color=FAINT, lw=1.2, rasterized=many)
        below.set(xlabel="frequency, Hz", ylabel="sum of |FRF| over its RMS", xlim=frf.frequency[[0, -1]])
        above = below.twinx()
        for f in page.found.frequency:
            above.axvline(f, color=MEASURED, lw=0.6, ls=(0, (2, 3)))
        for name, colour, marker, area, chosen in KINDS:
            at = chosen(d)
            above.scatter(d.frequency[at], d.order[at], s=area, c=colour, marker=marker, lw=0.9, label=name, zorder=3)
        above.set(ylabel="order", ylim=(2, page.order + 2))
        above.spines["right"].set_visible(True)
        above.grid(visible=False)
        above.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)
        return svg(fig)


# -------------------------------------------------------------------- FRFs


def frf_section(page: IdentifiedPage) -> Section:
    """Measured FRFs, those of the model and of the complex residues, and what each leaves."""
    frf, free = page.frf, page.free
    head, rows = ["response", "error of the model"], []
    if free is not None:
        head += ["with complex residues", "of these beyond noise"]
    for o, c in enumerate(frf.outputs):
        row = [f"{c.name} ({c.dof})", percent(_error(page.fitted[o], frf.value[o, 0]))]
        if free is not None:
            row += [percent(_error(free.fitted[o], frf.value[o, 0])), percent(float(free.lack[o]))]
        rows.append(row)
    body = table(head, rows, tuple(range(1, len(head))))
    drawn = [
        figure(response_figure(page, o), f"{c.name} ({c.dof}) over {frf.inputs[0].name} ({frf.inputs[0].dof}).")
        for o, c in enumerate(frf.outputs)
    ]
    body += Markup("").join(drawn[:FIGURES_OPEN])
    if len(drawn) > FIGURES_OPEN:
        body += folded(f"{len(drawn) - FIGURES_OPEN} further FRFs", Markup("").join(drawn[FIGURES_OPEN:]))
    return Section("frf", "Measured and synthesised", body)


def _error(made: NDArray, measured: NDArray) -> float:
    return float(np.linalg.norm(made - measured) / max(np.linalg.norm(measured), 1e-300))


def response_figure(page: IdentifiedPage, o: int) -> str:
    """SVG: magnitude, phase and what is left of response `o`."""
    frf = page.frf
    f, measured = frf.frequency, frf.value[o, 0]
    curves = [("model, real modes", BEFORE, (0, (4, 2)), page.fitted[o])]
    if page.free is not None:
        curves.append(("complex residues", AFTER, "-", page.free.fitted[o]))
    many = f.size > RASTER_FROM
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(9.0, 4.8))
        top, middle, low = fig.subplots(3, 1, sharex=True, height_ratios=(3, 1.2, 2))
        top.semilogy(f, np.abs(measured), color=MEASURED, lw=1.4, label="measured", rasterized=many)
        middle.plot(f, np.angle(measured, deg=True), ".", color=MEASURED, ms=2, rasterized=many)
        for name, colour, style, made in curves:
            top.semilogy(f, np.abs(made), color=colour, lw=1.0, ls=style, label=name, rasterized=many)
            middle.plot(f, np.angle(made, deg=True), color=colour, lw=0.8, ls=style, rasterized=many)
            low.semilogy(f, np.abs(made - measured) + 1e-300, color=colour, lw=0.9, rasterized=many)
        if frf.variance is not None:
            noise = np.sqrt(frf.variance[o, 0])
            low.semilogy(f, np.where(noise > 0, noise, np.nan), color="#8a949e", lw=0.8, label="noise", rasterized=many)
            low.legend(fontsize=8, loc="upper right")
        top.legend(ncols=3, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)
        low.set(xlabel="frequency, Hz", xlim=(f[0], f[-1]))
        for ax, name in ((top, "|FRF|"), (middle, "phase, deg"), (low, "left over")):
            ax.set_ylabel(name)
            fixed(ax, -0.07)
        return svg(fig)


# -------------------------------------------------------------------- shapes


def shapes_section(page: IdentifiedPage) -> Section | None:
    """Shapes at the sensors and their MAC matrix; None for one sensor, whose shapes are all alike."""
    shapes, places = page.found.shapes, [c.dof for c in page.frf.outputs]
    head = ["place", *(f"{f:.5g} Hz" for f in page.found.frequency)]
    rows = [[p, *(f"{v:.4g}" for v in row)] for p, row in zip(places, shapes, strict=True)]
    values = table(head, rows, tuple(range(1, len(head))))
    if len(places) < 2:
        return Section("shapes", "Mode shapes", values)
    body = figure(shapes_figure(page), "Shapes at the sensors, the largest of each mode drawn as 1.")
    body += folded("Mass-normalised shapes, 1/√kg", values)
    if len(page.found.frequency) > 1:
        drawn = mac_figure(mac(shapes, shapes), [f"{f:.4g}" for f in page.found.frequency])
        text = "Modal assurance criterion between the modes: few sensors cannot tell shapes apart that are not alike."
        body += Markup('<div class="narrow">') + figure(drawn, text) + Markup("</div>")
    return Section("shapes", "Mode shapes", body)


def shapes_figure(page: IdentifiedPage) -> str:
    """SVG: a panel a mode, a bar a sensor."""
    shapes, places = page.found.shapes, [c.dof for c in page.frf.outputs]
    columns = min(len(page.found.frequency), 4)
    rows = -(-len(page.found.frequency) // columns)
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(9.0, 1.9 * rows), layout="constrained")
        axes = fig.subplots(rows, columns, squeeze=False, sharey=True)
        for ax in axes.flat[len(page.found.frequency) :]:
            ax.set_visible(False)
        for ax, f, shape in zip(axes.flat, page.found.frequency, shapes.T, strict=False):
            ax.bar(range(len(places)), shape / max(np.abs(shape).max(), 1e-300), color=AFTER, width=0.7)
            ax.axhline(0.0, color="#8a949e", lw=0.7)
            ax.set_title(f"{f:.5g} Hz", fontsize=9)
            ax.set(xticks=range(len(places)), ylim=(-1.1, 1.1))
            ax.set_xticklabels(places, fontsize=7, rotation=0 if len(places) < 6 else 90)
        return svg(fig)


def mac_figure(criterion: NDArray, names: Sequence[str]) -> str:
    """SVG: a MAC matrix (n, n) with its figures."""
    n = len(names)
    side = 1.2 + 0.5 * n
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(side, side), layout="constrained")
        ax = fig.subplots()
        ax.imshow(criterion, cmap="Blues", vmin=0.0, vmax=1.0)
        for i in range(n):
            for j in range(n):
                colour = "white" if criterion[i, j] > 0.6 else MEASURED
                ax.text(j, i, f"{criterion[i, j]:.2f}", ha="center", va="center", color=colour, fontsize=8)
        ax.set(xticks=range(n), yticks=range(n), xlabel="Hz", ylabel="Hz")
        ax.set_xticklabels(names, rotation=35, ha="right")
        ax.set_yticklabels(names)
        ax.grid(visible=False)
        return svg(fig)


# -------------------------------------------------------------------- settings


def settings_section(page: IdentifiedPage) -> Section:
    """What it was made of."""
    frf, found = page.frf, page.found
    beside = [m for m in found.structure.modes if not np.isclose(float(m.frequency), found.frequency).any()]
    rows = [
        ["recording", page.recording],
        ["FRFs", f"{len(frf.outputs)}, estimator {frf.estimator}, force at {frf.inputs[0].dof}"],
        ["band", f"{frf.frequency[0]:.5g} to {frf.frequency[-1]:.5g} Hz, {frf.frequency.size} lines"],
        ["highest order", str(page.order)],
        ["modes beside the band", ", ".join(quantity(float(m.frequency), "Hz") for m in beside) or "none needed"],
    ]
    if page.free is not None:
        rows.append(["residual terms of the complex residues", ", ".join(f"s^{p}" for p in page.free.powers)])
    return Section("settings", "Where it comes from", table(["", ""], rows))
