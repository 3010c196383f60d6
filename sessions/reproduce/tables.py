"""A study as plain numbers, as a text table and as rows of a CSV file."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from sessions.reproduce.keep import key_of
from sessions.reproduce.study import Study, noisy_name


def summary(done: Study) -> dict[str, Any]:
    """Figures of a study as plain numbers, ready for JSON."""
    out: dict[str, Any] = {
        "key": key_of(done.case.name, done.effort), "case": done.case.name, "title": done.case.title,
        "where": done.case.where, "samples": done.case.samples, "sets": len(done.truth), "gamma": done.gamma,
        "effort": asdict(done.effort), "names": list(done.names),
        "published": {n: [_plain(v) for v in pair] for n, pair in done.case.published.items()}, "noise": [],
    }  # fmt: skip
    for noise in done.effort.noises:
        refined = done.of("refined", noise)
        plain, sphere, of = done.nominal_failures.get(noise, (None, None, 0))
        out["noise"].append({
            "noise": noise,
            "methods": {e.method: _numbers(e) for e in done.errors if e.noise == noise},
            "efficiency": [float(v) for v in done.efficiency.get(noise, ())],
            "failures": None if refined is None else refined.failures,
            "from_nominal": {"plain": plain, "sphere": sphere, "sets": of},
        })  # fmt: skip
    return out


def _numbers(e: Any) -> dict[str, list[float]]:
    out = {"mean": [float(v) for v in e.mean], "max": [float(v) for v in e.most]}
    if e.coverage is not None:
        out["coverage_90"] = [float(v) for v in e.coverage]
    return out


def _plain(v: float) -> float | None:
    return None if np.isnan(v) else float(v)


def columns(at: dict[str, Any]) -> list[str]:
    """Methods worked out at a noise level, in the order of the table."""
    order = ["printed", "network", "large network", noisy_name(at["noise"]), "refined", "bound"]
    return [m for m in order if m in at["methods"]]


def text_table(found: dict[str, Any]) -> str:
    """The table that the command prints: e_avg / e_max in percent."""
    heads = {"printed": "as printed", "network": "our network", "large network": "large network"}
    effort = found["effort"]
    lines = [
        f"{found['title']} ({found['where']}): e_avg / e_max in % over {found['sets']} sets,"
        f" {found['samples']} training samples",
        f"gamma of the network as printed {found['gamma']:.3g}; trained with noise: {effort['noisy_samples']} samples"
        f" on {effort['centres']} centres" + (f"; {effort['lines']} lines in each band" if effort["lines"] else ""),
    ]
    for at in found["noise"]:
        methods = columns(at)
        head = ["parameter", "published", *(heads.get(m, m) for m in methods)]
        rows = []
        for j, name in enumerate(found["names"]):
            mean, most = found["published"][name]
            row = [name, _pair(mean, most) if at["noise"] == 0 else "-"]
            rows.append([*row, *(_pair(at["methods"][m]["mean"][j], at["methods"][m]["max"][j]) for m in methods)])
        lines += ["", f"{100 * at['noise']:g} % noise", *_aligned([head, *rows]), *_remarks(found, at)]
    return "\n".join(lines) + "\n"


def _remarks(found: dict[str, Any], at: dict[str, Any]) -> list[str]:
    nominal = at["from_nominal"]
    out = [f"failures to converge: {at['failures']} of {found['sets']} from the network"]
    if nominal["sets"]:
        out[0] += (
            f"; from nominal values {nominal['plain']} of {nominal['sets']}, approached on the sphere"
            f" {nominal['sphere']}"
        )
    if at["efficiency"]:
        out.append("refined RMS error over the bound: " + _list(at["efficiency"]))
        out.append("refined, truths in the 90 % intervals: " + _list(at["methods"]["refined"]["coverage_90"]))
        own = at["methods"].get(noisy_name(at["noise"]))
        if own is not None:
            bound = at["methods"]["bound"]["mean"]
            out.append(
                "network e_avg over the bound's: " + _list([a / b for a, b in zip(own["mean"], bound, strict=True)])
            )
            out.append("network, truths in the 90 % intervals: " + _list(own["coverage_90"]))
    return out


def csv_rows(found: dict[str, Any]) -> str:
    """One row for each noise, method and parameter."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["case", "noise", "method", "parameter", "e_avg_percent", "e_max_percent", "coverage_90"])
    for name, (mean, most) in found["published"].items():
        rows.writerow([found["case"], 0, "published", name, mean, "" if most is None else most, ""])
    for at in found["noise"]:
        for method in columns(at):
            numbers = at["methods"][method]
            for j, name in enumerate(found["names"]):
                cover = numbers.get("coverage_90", [""] * len(found["names"]))[j]
                rows.writerow([found["case"], at["noise"], method, name, numbers["mean"][j], numbers["max"][j], cover])
    return text.getvalue()


def _pair(mean: float, most: float | None) -> str:
    return f"{mean:.3g}" + ("" if most is None else f" / {most:.3g}")


def _list(values: Sequence[float]) -> str:
    return " ".join(f"{v:.3f}" for v in values)


def _aligned(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
