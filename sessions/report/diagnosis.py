"""The diagnosis as a page: where, what, how the fit improved, why the others lost, and what to measure next."""

from __future__ import annotations

import math
import time
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labnnum import __version__
from labnnum.diagnosis import Diagnosis
from labnnum.diagnosis.locate import recover
from labnnum.diagnosis.prediction import predicted
from labnnum.diagnosis.verdict import Named
from labnnum.mechanisms.base import Place, Term
from sessions.model import Model
from sessions.report.figures import _STYLE, AFTER, BEFORE, MEASURED, fixed, svg
from sessions.report.nonlinear import SHOWN, errors_table, levels_section, nonlinear_section
from sessions.report.numbers import percent, with_error
from sessions.report.page import _template
from sessions.report.sections import Section, figure, notes, table

ALARM = "#b3261e"
TITLES = {
    "consistent": ("The nominal model explains the data.", "good"),
    "parameters": ("The model with updated parameters explains the data.", "good"),
    "missing-physics": ("The model lacks physics.", "doubt"),
    "measurement-fault": ("The measurement chain has a fault.", "doubt"),
    "unexplained": ("Something is missing that the catalogue does not name.", "doubt"),
}


ORDINARY = ": the ordinary errors of mesh, damping and mounting."
REMAINS = {
    "consistent": ORDINARY,
    "parameters": ORDINARY,
    "missing-physics": ": errors of mesh, damping and mounting, or something else beside what was named.",
    "measurement-fault": ": errors of mesh, damping and mounting, or something else beside what was named.",
    "unexplained": ", and nothing that was tried explains it.",
}


def write_page(path: Path, model: Model, d: Diagnosis) -> Path:
    """The page at `path`."""
    made = [
        answer_section(d),
        drawing_section(d),
        levels_section(d) or fit_section(d),
        creep_section(d),
        nonlinear_section(d),
        stiffness_section(d),
        rivals_section(d),
    ]
    made += [parameters_section(model, d), next_section(d)]
    judged = "held-out" if d.held_apart else "fitted"
    facts = [
        (percent(d.base_error[1]), f"{judged} error before"),
        (percent(d.extended_error[1]), f"{judged} error after"),
        (percent(d.noise_floor), "noise"),
    ]
    text = _template().render(
        title=f"Diagnosis: {_name(model.path)}", date=time.strftime("%Y-%m-%d %H:%M"), verdict=TITLES[d.verdict],
        facts=facts, sections=[s for s in made if s is not None], version=__version__,
    )  # fmt: skip
    path.write_text(text, encoding="utf-8")
    return path


def _name(path: Path) -> str:
    """What a model is called: as its file, or as the folder where that is a model.toml like any other."""
    return path.stem if path.stem != "model" else path.resolve().parent.name or path.stem


def answer_section(d: Diagnosis) -> Section:
    """The answer in words, and each mechanism with its equation."""
    body = Markup("<p>") + d.summary + Markup("</p>")
    for n in d.named:
        m = n.term.mechanism
        body += Markup("<h3>{}: {}</h3>").format(m.id, n.place)
        body += Markup("<p>{}: <code>{}</code>. Shows as: {}. Told apart from: {}. ({})</p>").format(
            m.title, m.equation, m.shows, m.told_apart, m.reference
        )
        rows = [[p.name, with_error(v, s, p.unit)] for p, v, s in zip(n.term.parameters, n.value, n.std, strict=True)]
        if rows:
            body += table(["parameter", "value"], rows)
        body += Markup("<p>Share of the weight of all candidates: {:.1f} %.</p>").format(100 * n.confidence)
    return Section("answer", "What the model left out", body)


# -------------------------------------------------------------------- drawing


def drawing_section(d: Diagnosis) -> Section | None:
    """The structure with sensors, supports and the place marked."""
    nodes = d.detail["engine"].structure.nodes
    if len(nodes) < 2:
        return None
    return Section(
        "where", "Where", figure(structure_figure(d), "Circles: sensors. Triangles: supports. Red: the place.")
    )


def structure_figure(d: Diagnosis) -> str:
    """SVG of the structure in its plane of greatest extent, the named place in red."""
    engine = d.detail["engine"]
    s = engine.structure
    names = list(s.nodes)
    xyz = np.array([s.nodes[n] for n in names], float)
    spread = np.ptp(xyz, axis=0)
    axes = np.argsort(-spread)[:2]
    at = {n: xyz[i][np.sort(axes)] for i, n in enumerate(names)}
    with matplotlib.rc_context(_STYLE):
        flat = spread[np.sort(axes)][1] < 0.05 * spread.max()
        fig = Figure(figsize=(7.5, 1.6 if flat else 4.2))
        ax = fig.add_subplot()
        for a, b in s.elements or pairwise(names):
            if a in at and b in at:
                ax.plot(*np.transpose([at[a], at[b]]), color="#8a949e", lw=2, zorder=1)
        for n in s.supports:
            if n in at:
                ax.plot(*at[n], marker="^", ms=11, color="#3b4650", zorder=2)
        for c in engine.outputs:
            if c.node in at:
                ax.plot(*at[c.node], marker="o", ms=6, color=AFTER, zorder=3)
        for c in engine.inputs:
            if c.node in at:
                ax.plot(*at[c.node], marker="v", ms=9, color=BEFORE, zorder=3)
        for n in names:
            ax.annotate(n, at[n], xytext=(0, 7), textcoords="offset points", ha="center", fontsize=7, color="#5b6670")
        for place in [x.place for x in d.named] or ([d.place] if d.place else []):
            _mark(ax, place, at, engine)
        ax.set_aspect("equal" if not flat else "auto")
        ax.margins(0.08, 0.6 if flat else 0.1)
        ax.axis("off")
        return svg(fig)


def _mark(ax, place: Place, at: dict, engine) -> None:
    if place.kind == "channel":
        nodes = [c.node for c in (*engine.outputs, *engine.inputs) if c.name in (place.id, place.to) and c.node in at]
    else:
        nodes = [n for n in (place.id, place.to) if n in at]
    if len(nodes) == 2 and place.kind in ("element", "joint"):
        ax.plot(*np.transpose([at[n] for n in nodes]), color=ALARM, lw=6, alpha=0.75, zorder=2)
    for n in nodes:
        ax.plot(*at[n], marker="o", ms=16, mfc="none", mec=ALARM, mew=2.2, zorder=4)


# -------------------------------------------------------------------- fit


def fit_section(d: Diagnosis) -> Section:
    """FRFs measured, base and extended, with what each leaves."""
    test = d.detail["test"]
    body = Markup("<p>Held-out data: neither model was fitted to them. Each may trim its natural frequencies and loads"
                  " within two standard deviations of what a sound model needs.</p>")  # fmt: skip
    body += errors_table(d)
    for o in range(min(len(test.outputs), SHOWN)):
        body += figure(response_figure(d, o), f"{test.outputs[o].name} over {test.inputs[0].name}")
    return Section("fit", "Before and after", body)


APART = 4.0
"""Steps between lines, in usual ones, over which no curve is drawn: nothing was held out there."""


def _in_stretches(frequency: NDArray, value: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A curve (n,) over its lines with gaps where lines are far apart."""
    step = np.diff(frequency)
    ends = np.flatnonzero(step > APART * np.median(step)) + 1 if step.size else np.zeros(0, int)
    return np.insert(frequency, ends, np.nan), np.insert(value, ends, np.nan)


def response_figure(d: Diagnosis, o: int) -> str:
    """SVG: magnitude and residuals of one response over the first input."""
    engine, test = d.detail["engine"], d.detail["test"]
    curves = [("base", BEFORE, d.detail["base"])]
    if d.detail["final"] is not d.detail["base"]:
        curves.append(("extended", AFTER, d.detail["final"]))
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 3.6))
        top, low = fig.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        top.semilogy(*_in_stretches(test.frequency, np.abs(test.value[o, 0])), color=MEASURED, lw=1.4, label="measured")
        for name, colour, made in curves:
            h = predicted(engine, made, test)[o, 0]
            top.semilogy(
                *_in_stretches(test.frequency, np.abs(h)),
                color=colour,
                lw=1.0,
                ls="--" if name == "base" else "-",
                label=name,
            )
            low.semilogy(*_in_stretches(test.frequency, np.abs(h - test.value[o, 0]) + 1e-300), color=colour, lw=0.9)
        if test.variance is not None:
            low.semilogy(*_in_stretches(test.frequency, np.sqrt(test.variance[o, 0])), color="#8a949e", lw=0.7)
        top.legend(ncol=3, fontsize=8, loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1)
        low.set_xlabel("frequency, Hz")
        for ax, name in ((top, "|FRF|"), (low, "residual")):
            ax.set_ylabel(name)
            fixed(ax, -0.09)
        return svg(fig)


# -------------------------------------------------------------------- drift


def creep_section(d: Diagnosis) -> Section | None:
    """How the natural frequencies went while the structure was measured."""
    if d.creep is None:
        return None
    return Section(
        "drift", "Natural frequencies during the session", figure(
            creep_figure(d), "One dot for every period or hit: by how much all natural frequencies then stood off those"
            " of the session's middle, to which the FRFs above were taken back. Line: the drift as named.",
        ),
    )  # fmt: skip


def creep_figure(d: Diagnosis) -> str:
    """SVG: stretch of every piece over the time that was recorded."""
    creep = d.creep
    assert creep is not None
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 2.6))
        ax = fig.add_subplot()
        ax.plot(creep.time, 100 * creep.change * (creep.time - creep.time.mean()), color=AFTER, lw=1.0)
        ax.plot(creep.time, 100 * creep.stretch, "o", ms=4, color=MEASURED)
        ax.axhline(0.0, color="#8a949e", lw=0.7)
        ax.set_xlabel("share of what was recorded")
        ax.set_ylabel("frequencies, %")
        return svg(fig)


# -------------------------------------------------------------------- apparent dynamic stiffness


def stiffness_section(d: Diagnosis) -> Section | None:
    """The apparent dynamic stiffness of what is missing, beside the named law."""
    found = _acting(d)
    if found is None:
        return None
    text = (
        "The force at the place that would explain the residual, divided by the motion there. Flat is a spring, falling"
        " with the square of frequency a mass, a growing imaginary part a dashpot, a resonance an appendage."
    )
    body = Markup("<p>{}</p>").format(text) + figure(
        stiffness_figure(d, *found), "Dots: recovered. Line: the named law."
    )
    return Section("stiffness", "What acts there", body)


def _acting(d: Diagnosis) -> tuple[Term, Named | None] | None:
    for n in d.named:
        if n.term.sought.groups:
            return n.term.sought, n
    if d.verdict == "unexplained" and d.place is not None:
        for t in d.detail["general"]:
            if t.place == d.place and t.groups:
                return t, None
    return None


def stiffness_figure(d: Diagnosis, term: Term, named: Named | None) -> str:
    """SVG: real and imaginary part of the recovered dynamic stiffness, and of the named law."""
    engine, data = d.detail["engine"], d.detail["data"]
    made = d.detail["bayes"]
    found = recover(engine, data, made.point, term)
    good = found.error < 1.0 * np.abs(found.stiffness)
    f = found.omega / 2 / np.pi
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 3.2))
        axes = fig.subplots(1, 2, sharex=True)
        for ax, part, name in zip(axes, (np.real, np.imag), ("real part", "imaginary part"), strict=True):
            y = part(found.stiffness)
            ax.errorbar(f[good], y[good], yerr=found.error[good], fmt=".", ms=3, lw=0.4, color=MEASURED, alpha=0.7)
            if named is not None:
                law = term.stiffness(data.s, named.value)[0, 0]
                ax.plot(f, part(law), color=AFTER, lw=1.6)
            if good.any():
                low, high = np.percentile(y[good], [5, 95])
                ax.set_ylim(low - 0.5 * (high - low) - 1e-12, high + 0.5 * (high - low) + 1e-12)
            ax.set_title(name, fontsize=9)
            ax.set_xlabel("frequency, Hz")
        axes[0].set_ylabel("N/m (per unit of the motion)")
        return svg(fig)


# -------------------------------------------------------------------- rivals, parameters, next


def rivals_section(d: Diagnosis) -> Section:
    """Who lost and why; where the residual can be explained from."""
    rows = [[a.term.mechanism.id, str(a.term.place), percent(a.held_out_error), a.why_not] for a in d.alternatives]
    head = ["candidate", "place", "held-out error", "why not"]
    foretold = any(math.isfinite(a.held_out_error) for a in d.alternatives)
    if not foretold:  # laws that lost are not simulated on data held out
        rows, head = [[*r[:2], r[3]] for r in rows], [*head[:2], head[3]]
    body = table(head, rows, (2,) if foretold else ()) if rows else Markup("<p>None came near.</p>")
    located = [[str(p), percent(s)] for p, s in d.located]
    body += Markup("<p>Share of the base model's misfit that something at each place can explain, without a name"
                   " (chance {}):</p>").format(percent(d.chance))  # fmt: skip
    body += table(["place", "share"], located, (1,)) if located else Markup("")
    return Section("rivals", "Candidates and places", body)


def parameters_section(model: Model, d: Diagnosis) -> Section | None:
    """The structure's parameters, updated together with what was added."""
    rows = [
        [p.name, f"{p.nominal:.5g}", with_error(v, s, p.unit)]
        for p, v, s in zip(model.structure.parameters[: d.theta.size], d.theta, d.theta_std, strict=True)
    ]
    if not rows:
        return None
    return Section("parameters", "Parameters of the structure", table(["parameter", "nominal", "updated"], rows, (1,)))


def next_section(d: Diagnosis) -> Section | None:
    """What remains, and the next experiment."""
    lines = [d.next_experiment] if d.next_experiment else []
    left = d.extended_error[1] / d.noise_floor if d.noise_floor > 0 else float("nan")
    if np.isfinite(left) and left > 2:
        lines.append(f"What remains is {left:.3g} times the noise{REMAINS[d.verdict]}")
    return Section("next", "What to measure next", notes(lines, "fine")) if lines else None
