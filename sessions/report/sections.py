"""Sections of a report. Each is a function of the content; None where there is nothing to say.

A further section is one more such function and one entry in SECTIONS.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from labnnum.frf import Frf
from sessions.report import figures
from sessions.report.content import Content, RunFacts
from sessions.report.numbers import date, percent, pretty_unit, quantity, with_error
from sessions.tables import plain

FIGURES_OPEN = 6
"""FRFs that are shown at once; further ones are folded."""


@dataclass(frozen=True)
class Section:
    """A titled piece of the page; `body` is HTML that is safe already."""

    anchor: str
    title: str
    body: str


SectionMaker = Callable[[Content], Section | None]


def table(head: list[str], rows: list[list[Any]], numbers: tuple[int, ...] = ()) -> Markup:
    """An HTML table; columns in `numbers` are set to the right, cells are escaped."""

    def cell(tag: str, column: int, value: Any) -> Markup:
        kind = ' class="n"' if column in numbers else ""
        return Markup(f"<{tag}{kind}>") + escape(value) + Markup(f"</{tag}>")

    def row(tag: str, values: list[Any]) -> Markup:
        return Markup("<tr>") + Markup("").join(cell(tag, i, v) for i, v in enumerate(values)) + Markup("</tr>")

    body = Markup("").join(row("td", values) for values in rows)
    return (
        Markup('<div class="scroll"><table><thead>')
        + row("th", head)
        + Markup("</thead><tbody>")
        + body
        + Markup("</tbody></table></div>")
    )


def figure(drawing: str, caption: str) -> Markup:
    """A drawing (SVG text) with its caption; empty for an empty drawing."""
    if not drawing:
        return Markup("")
    return (
        Markup("<figure>")
        + Markup(drawing)
        + Markup("<figcaption>")
        + escape(caption)
        + Markup("</figcaption></figure>")
    )


def notes(lines: list[str], kind: str = "warn") -> Markup:
    """A list of remarks; kind "warn" or "fine"."""
    items = Markup("").join(Markup("<li>") + escape(line) + Markup("</li>") for line in lines)
    return Markup(f'<ul class="{kind}">') + items + Markup("</ul>") if lines else Markup("")


def folded(summary: str, body: Markup) -> Markup:
    """A part that opens on a click."""
    return Markup("<details><summary>") + escape(summary) + Markup("</summary>") + body + Markup("</details>")


def preformatted(text: str) -> Markup:
    """Text as it stands."""
    return Markup("<pre>") + escape(text) + Markup("</pre>")


def parameters_section(content: Content) -> Section | None:
    """Updated parameters with their standard deviations, within their bounds."""
    stored = content.estimate
    if stored is None:
        return None
    e, truth = stored.estimate, stored.truth
    head = ["parameter", "nominal", "estimate ± std", "std", "change"]
    rows = []
    for p, value, std in zip(e.parameters, e.value, e.std, strict=True):
        relative = percent(std / abs(value)) if value else "–"
        change = percent((value - p.nominal) / abs(p.nominal), 3) if p.nominal else "–"
        row = [p.name, quantity(p.nominal, p.unit), with_error(value, std, p.unit), relative, change]
        if truth:
            row += _against_truth(truth.get(p.name), value, std, p.unit)
        rows.append(row)
    head += ["truth", "error in std"] if truth else []
    body = table(head, rows, numbers=tuple(range(1, len(head))))
    body += figure(figures.parameters_figure(e, truth), "Estimates within the bounds of the prior.")
    return Section("parameters", "Parameters", body)


def _against_truth(true: float | None, value: float, std: float, unit: str) -> list[str]:
    if true is None:
        return ["–", "–"]
    return [quantity(true, unit, 5), f"{(value - true) / std:+.2f}" if std > 0 else "–"]


def frf_section(content: Content) -> Section | None:
    """Measured FRFs with random error and coherence, and the model before and after."""
    frf = content.frf
    if frf is None:
        return None
    stored = content.estimate
    drawn = [_pair(frf, i, j, content) for i in range(len(frf.outputs)) for j in range(len(frf.inputs))]
    body = Markup("<p>") + escape(_frf_sentence(frf)) + Markup("</p>")
    if stored is not None and stored.bands:
        shown = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in stored.bands)
        body += Markup("<p>") + escape(f"Shaded: the bands that entered the estimate ({shown} Hz).") + Markup("</p>")
    body += Markup("").join(drawn[:FIGURES_OPEN])
    if len(drawn) > FIGURES_OPEN:
        body += folded(_count(len(drawn) - FIGURES_OPEN, "further FRF"), Markup("").join(drawn[FIGURES_OPEN:]))
    return Section("frf", "Measurement and model", body)


def _frf_sentence(frf: Frf) -> str:
    settings, parts = frf.settings, [f"Estimator {frf.estimator}"]
    if "window" in settings:
        parts.append(f"{settings['window']} window")
    if "n_segment" in settings and "rate" in settings:
        n, rate = int(settings["n_segment"]), float(settings["rate"])
        parts.append(f"segments of {n} samples ({quantity(n / rate, 's')}, {quantity(rate / n, 'Hz')} a line)")
    if "overlap" in settings:
        parts.append(f"{percent(float(settings['overlap']))} overlap")
    if np.isfinite(frf.n_averages):
        parts.append(f"{frf.n_averages:.4g} effective averages")
    return ", ".join(parts) + f"; {frf.frequency.size} lines from {frf.frequency[0]:.4g} to {frf.frequency[-1]:.4g} Hz."


def _pair(frf: Frf, output: int, source: int, content: Content) -> Markup:
    model, response, force = content.estimate, frf.outputs[output], frf.inputs[source]
    if model is not None and model.after.shape[:2] != frf.value.shape[:2]:
        model = None
    caption = f"{response.name} ({_place(response.dof)}) over {force.name} ({_place(force.dof)})."
    drawn = figure(figures.frf_figure(frf, output, source, model), caption)
    if model is not None:
        close = figures.bands_figure(frf, output, source, model)
        drawn += figure(close, "The bands close up: measured lines with ± 2 random errors, model before and after.")
        gap = figures.residual_figure(frf, output, source, model)
        drawn += figure(gap, "What the model leaves over, in random errors of the measurement; below 2 is chance.")
    return drawn


def _place(dof: str) -> str:
    return dof or "no place given"


def coherence_section(content: Content) -> Section | None:
    """What lowers the coherence of the FRF, told apart; None where nothing is stored about it."""
    from sessions.report.apart import apart_section  # which draws with what stands here

    return apart_section(content)


def trust_section(content: Content) -> Section | None:
    """Reasons to trust or to doubt: warnings, misfit, correlation, overloads, gaps."""
    stored, body = content.estimate, Markup("")
    doubts = [f"{r.label}: {text}" for r in content.runs for text in run_doubts(r)]
    if stored is not None:
        e = stored.estimate
        doubts = [*e.warnings, *([] if e.converged else ["the refinement did not converge"]), *doubts]
    body += notes(doubts) if doubts else notes(["No overloads, no gaps, no warnings."], "fine")
    if stored is not None:
        e = stored.estimate
        granted = f", up to an error of {percent(stored.floor)}" if stored.floor else ""
        head = ["method", f"misfit (chi², 1 if the model explains all{granted})"]
        body += table(head, [[e.method, f"{e.chi2:.3g}"]], (1,))
        if len(e.parameters) > 1:
            drawing = figures.correlation_figure([p.name for p in e.parameters], e.correlation)
            body += Markup('<div class="narrow">') + figure(drawing, "Correlation of the estimates.") + Markup("</div>")
    return Section("trust", "Can it be trusted?", body) if stored is not None or content.runs else None


def run_doubts(run: RunFacts) -> list[str]:
    """What went wrong in a run, one line each."""
    found = []
    if run.lost or run.gaps:
        found.append(f"{_count(run.lost, 'frame')} lost, {_count(run.gaps, 'gap')}; nothing was averaged across them")
    if run.overflows:
        found.append(f"the input overflowed in {_count(run.overflows, 'block')}; they were left out")
    found += [f"channel {name} reached the end of its range {_count(n, 'time')}" for name, n in run.overloads.items()]
    if not run.finished:
        found.append("was cut off; everything before is there")
    elif run.finished.startswith(("abort", "stop")):
        found.append(run.finished)
    return found


def measurement_section(content: Content) -> Section | None:
    """Runs and channels: what was measured, and how."""
    if not content.runs:
        return None
    head = ["run", "begun", "length", "rate", "level", "accepted", "ended"]
    rows = [
        [
            r.label,
            date(r.created),
            quantity(r.duration, "s"),
            quantity(r.rate, "Hz", 6),
            "–" if np.isnan(r.level) else f"{r.level:g}",
            _hits(r),
            r.finished or "cut off",
        ]
        for r in content.runs
    ]
    body = table(head, rows, (2, 3, 4))
    channels = [
        [c.name, c.role, c.quantity, c.place or "–", _sensitivity(c.sensitivity, c.unit), _full_scale(c.full_scale)]
        for c in content.channels
    ]
    body += table(["channel", "role", "quantity", "place", "sensitivity", "range"], channels, (4, 5))
    rejected = [[r.label, i, reason] for r in content.runs for i, accepted, reason in r.hits if not accepted]
    if rejected:
        body += folded(_count(len(rejected), "rejected hit"), table(["run", "hit", "reason"], rejected, (1,)))
    return Section("measurement", "How it was measured", body)


def _count(n: int, what: str) -> str:
    return f"{n} {what}{'' if n == 1 else 's'}"


def _hits(run: RunFacts) -> str:
    return f"{sum(accepted for _, accepted, _ in run.hits)} of {len(run.hits)}" if run.hits else "–"


def _sensitivity(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:g} V/({pretty_unit(unit)})"


def _full_scale(value: float) -> str:
    return "–" if np.isnan(value) else f"± {value:g} V"


def provenance_section(content: Content) -> Section:
    """Versions, settings of every result, and the configuration as it stood."""
    from labnnum import __version__

    facts = [["session", content.path.name], ["created", date(content.created)], ["by labnnum", content.code_version]]
    body = table(["", ""], [*facts, ["report by labnnum", __version__]])
    frf, stored = content.frf, content.estimate
    if frf is not None:
        body += folded(f"Settings of the FRF ({frf.settings.get('stored', '')})", preformatted(_json(frf.settings)))
    if stored is not None:
        facts = {"code_version": stored.code_version, "created": date(stored.created), **stored.settings}
        body += folded("Settings of the estimate", preformatted(_json(facts)))
    for title, text in (("rig.toml", content.rig_text), ("model.toml", content.model_text)):
        if text:
            body += folded(title, preformatted(text))
    others = [[r.kind, r.number, r.name, date(r.created), r.code_version] for r in content.results]
    if others:
        body += folded("Other stored results", table(["kind", "number", "name", "created", "version"], others))
    return Section("provenance", "Where it comes from", body)


def _json(value: Any) -> str:
    return json.dumps(plain(value), indent=2, ensure_ascii=False)


SECTIONS: tuple[SectionMaker, ...] = (
    parameters_section,
    frf_section,
    coherence_section,
    trust_section,
    measurement_section,
    provenance_section,
)
"""Sections in the order of the page."""
