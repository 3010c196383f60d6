"""The diagnosis of natural frequencies as a page: what the updated model misses by mode, and what would mend it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from labnnum import __version__
from sessions.report.diagnosis import TITLES
from sessions.report.figures import _STYLE, BEFORE, MEASURED, svg
from sessions.report.numbers import percent, with_error
from sessions.report.page import _template
from sessions.report.sections import Section, figure, notes, table


def write_modal_page(path: Path, name: str, said: Mapping[str, Any]) -> Path:
    """The page at `path` of the content of a diagnosis.json that came from natural frequencies of the model `name`."""
    sections = [_answer(said), _modes(said), _rivals(said), _parameters(said), _next(said)]
    facts = [
        (percent(said["fit"]["base"]["held_out"]), "error of modes held out"),
        (str(said["repeats"]), "repeats"),
        (percent(said["fit"]["noise_floor"]), "scatter of their mean"),
    ]
    text = _template().render(
        title=f"Diagnosis: {name}", date=time.strftime("%Y-%m-%d %H:%M"), verdict=TITLES[said["verdict"]],
        facts=facts, sections=[s for s in sections if s is not None], version=__version__,
    )  # fmt: skip
    path.write_text(text, encoding="utf-8")
    return path


def _answer(said: Mapping[str, Any]) -> Section:
    return Section("answer", "What the model left out", Markup("<p>{}</p>").format(said["summary"]))


def _modes(said: Mapping[str, Any]) -> Section:
    rows = [
        [
            str(m["mode"]),
            f"{m['measured_hz']:.4g} Hz",
            f"{100 * m['missing']:+.3f} %",
            f"{100 * m['std_of_mean']:.3f} %",
            " to ".join(f"{100 * x:+.2f}" for x in m["repeats_90"]) + " %",
        ]
        for m in said["modes"]
    ]
    caption = "Measured over model less one. Dots: mean of the repeats; bars: nine in ten single repeats."
    body = figure(_drawing(said), caption)
    head = ["mode", "measured", "missed by the updated model", "standard deviation of the mean", "nine in ten repeats"]
    return Section("modes", "Mode by mode", body + table(head, rows, (1, 2, 3)))


def _drawing(said: Mapping[str, Any]) -> str:
    """SVG: what the updated model misses of each mode, with the range of the repeats."""
    modes = said["modes"]
    mean = 100 * np.array([m["missing"] for m in modes])
    low, high = 100 * np.array([m["repeats_90"] for m in modes]).T
    with matplotlib.rc_context(_STYLE):
        fig = Figure(figsize=(7.5, 2.8))
        ax = fig.subplots()
        at = np.arange(1, len(modes) + 1)
        ax.axhline(0.0, color=BEFORE, lw=1.0)
        reach = np.array([np.maximum(mean - low, 0), np.maximum(high - mean, 0)])
        ax.errorbar(at, mean, yerr=reach, fmt="o", color=MEASURED, capsize=4)
        ax.set_xticks(at)
        ax.set_xlabel("mode")
        ax.set_ylabel("measured over model, %")
        return svg(fig)


def _rivals(said: Mapping[str, Any]) -> Section | None:
    rows = [
        [a["mechanism"], a["place"]["id"] + (f"-{a['place']['to']}" if a["place"]["to"] else ""), a["why_not"]]
        for a in said["alternatives"]
    ]
    return Section("rivals", "Candidates", table(["candidate", "place", "why not"], rows)) if rows else None


def _parameters(said: Mapping[str, Any]) -> Section | None:
    rows = [[name, with_error(p["value"], p["std"], p["unit"])] for name, p in said["parameters"].items()]
    return Section("parameters", "Parameters of the structure", table(["parameter", "updated"], rows, (1,)))


def _next(said: Mapping[str, Any]) -> Section | None:
    lines = [said["next_experiment"]] if said["next_experiment"] else []
    return Section("next", "What to measure next", notes(lines, "fine")) if lines else None
