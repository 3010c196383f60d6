"""Diagnosis from natural frequencies alone: a table of repeats, and what an updated model cannot make of it.

Frequencies say less than recordings: no place without a model, no damping, no channel. What they do say is said with
its uncertainty: which modes the updated model misses and by how much, over the repeats; which mechanism at which place
would explain them; and which of these the frequencies cannot tell apart.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labnnum.diagnosis import Limits, Scatter
from labnnum.errors import FileError
from sessions.diagnose import write_updated
from sessions.modal_fit import ModalFit, best_fit, candidates, fit_modes, frequencies
from sessions.model import Model, read_model

COUNTERS = ("run", "repeat", "number", "no")
"""Names of a first column that numbers the rows."""
ALARM, ENOUGH = 0.99, 0.95
"""Probabilities under which ordinary errors stay below the alarm, and below what counts as explained."""


def is_modal_table(path: str | Path) -> bool:
    """Whether a file is a comma-separated table whose columns are f1, f2, ... (after one that counts)."""
    if Path(path).suffix.lower() != ".csv" or not Path(path).is_file():
        return False
    with Path(path).open(encoding="utf-8") as file:
        names = [name.strip().lower() for name in file.readline().split(",")]
    names = names[1:] if names and names[0] in COUNTERS else names
    return bool(names) and names == [f"f{i + 1}" for i in range(len(names))]


def read_modal_table(path: str | Path) -> NDArray[np.float64]:
    """Natural frequencies in Hz, shape (n_repeats, n_modes), ascending in each row; rows with a NaN are left out.

    Raises
    ------
    FileError
        If a row is no list of ascending positive numbers, or there are fewer than two modes.
    """
    with Path(path).open(encoding="utf-8", newline="") as file:
        head, *rows = list(csv.reader(file))
    first = 1 if head[0].strip().lower() in COUNTERS else 0
    out = []
    for number, row in enumerate(rows, 2):
        if not row:
            continue
        try:
            values = np.array(row[first:], float)
        except ValueError:
            raise FileError(f"{path}, line {number}: {','.join(row)!r} is no row of numbers") from None
        if np.any(np.isnan(values)):
            continue
        if values.size != len(head) - first or not np.all(np.isfinite(values)) or np.any(values <= 0):
            raise FileError(f"{path}, line {number}: {len(head) - first} positive frequencies in Hz were expected")
        if np.any(np.diff(values) <= 0):
            raise FileError(f"{path}, line {number}: frequencies must ascend from mode to mode")
        out.append(values)
    if not out or out[0].size < 2:
        raise FileError(f"{path}: holds no repeats of at least two modes")
    return np.array(out)


def diagnose_modes(
    table: NDArray, model: Model, scatter: Scatter | None = None, limits: Limits | None = None
) -> dict[str, Any]:
    """Content of diagnosis.json from repeats of natural frequencies, shape (n_repeats, n_modes)."""
    return examine(table, model, scatter, limits)[0]


def examine(
    table: NDArray, model: Model, scatter: Scatter | None = None, limits: Limits | None = None
) -> tuple[dict[str, Any], ModalFit]:
    """Content of diagnosis.json, and the fit that it stands on: of what was named, else of the base."""
    scatter, limits = scatter or Scatter(), limits or Limits()
    structure = model.structure
    mean, n, m = table.mean(axis=0), len(table), table.shape[1]
    repeat = table.std(axis=0, ddof=1) / mean if n > 1 else np.zeros(m)
    sigma = np.hypot(repeat / np.sqrt(n), scatter.frequency)
    base = fit_modes(structure, None, mean, sigma)
    ranked = sorted((fit_modes(structure, t, mean, sigma) for t in candidates(model)), key=lambda f: f.chi2)
    alarm = base.chi2 > chi2.ppf(ALARM, m) and base.chi2 > limits.alarm / 4
    explained = [f for f in ranked if f.chi2 < chi2.ppf(ENOUGH, max(m - 1, 1))]
    rivals = [f for f in ranked[1:] if f.chi2 < ranked[0].chi2 + limits.name]
    verdict = "missing-physics" if alarm and explained and not rivals else "unexplained" if alarm else ""
    if not alarm:
        moved = np.abs(base.theta - structure.nominal) > 2 * base.std[: base.theta.size]
        verdict = "parameters" if np.any(moved) else "consistent"
    named = ranked[0] if verdict == "missing-physics" else None
    return _content(verdict, base, ranked, named, table, model, scatter, limits), named or base


def _content(
    verdict: str, base: ModalFit, ranked: Sequence[ModalFit], named: ModalFit | None, table: NDArray, model: Model,
    scatter: Scatter, limits: Limits,
) -> dict[str, Any]:  # fmt: skip
    best = ranked[0] if ranked else None
    gains = np.array([max(base.chi2 - f.chi2, 0.0) for f in ranked])
    located = [
        {"place": f.term.place.as_dict(), "share": round(float(g / base.chi2), 4)}
        for f, g in zip(ranked, gains, strict=True)
        if f.term is not None
    ]
    repeats = _over_repeats(base, table, model, scatter)
    said = {
        "schema": 1,
        "verdict": verdict,
        "place": named.term.place.as_dict() if named and named.term else _place_of(verdict, best, ranked, limits),
        "mechanism": _mechanism(named) if named else None,
        "further": [],
        "alternatives": [_alternative(f, ranked[0], limits) for f in ranked[:8] if f is not named],
        "located": located[:12],
        "fit": {
            "metric": "relative RMS error of natural frequencies, each mode predicted from the others",
            "base": {"train": float(np.sqrt(np.mean(base.missing**2))), "held_out": base.held_out},
            "extended": {
                "train": float(np.sqrt(np.mean((named or base).missing ** 2))),
                "held_out": (named or base).held_out,
            },
            "noise_floor": float(np.sqrt(np.mean((table.std(axis=0) / table.mean(axis=0)) ** 2 / len(table)))),
        },
        "nonlinear": {"level_dependence": None, "odd_distortion_db": None, "even_distortion_db": None},
        "modes": repeats,
        "parameters": {
            p.name: {"value": float(v), "std": float(s), "unit": p.unit}
            for p, v, s in zip(model.structure.parameters, base.theta, base.std, strict=False)
        },
        "chi2": {
            "base": base.chi2,
            "alarm": float(chi2.ppf(ALARM, table.shape[1])),
            "best": best.chi2 if best else None,
            "enough": float(chi2.ppf(ENOUGH, max(table.shape[1] - 1, 1))),
        },
    }
    said["repeats"] = len(table)
    return said | {"summary": _summary(said), "next_experiment": _next(verdict)}


def _over_repeats(base: ModalFit, table: NDArray, model: Model, scatter: Scatter) -> list[dict[str, Any]]:
    """What the updated base misses, mode by mode: over the mean, and how far single repeats scatter about it."""
    sigma = np.full(table.shape[1], scatter.frequency)
    each = []
    for row in table:
        x = best_fit(model.structure, None, row, sigma, sigma > 0, base.theta)[0]
        each.append(row / frequencies(model.structure, None, x, row.size) - 1)
    spread = np.std(each, axis=0, ddof=1) if len(table) > 1 else np.zeros(table.shape[1])
    low, high = np.percentile(each, [5, 95], axis=0)
    mean = table.mean(axis=0)
    return [
        {
            "mode": i + 1,
            "measured_hz": float(mean[i]),
            "repeat_std_hz": float(table[:, i].std(ddof=1)) if len(table) > 1 else None,
            "missing": float(base.missing[i]),
            "std_of_mean": float(spread[i] / np.sqrt(len(table))),
            "repeats_90": [float(low[i]), float(high[i])],
        }
        for i in range(table.shape[1])
    ]


def _mechanism(fit: ModalFit) -> dict[str, Any]:
    assert fit.term is not None
    own = fit.std[fit.theta.size :]
    return {
        "id": fit.term.mechanism.id,
        "sense": fit.term.mechanism.sense(fit.term, fit.value),
        "confidence": 0.9,
        "parameters": {
            p.name: {"value": float(v), "std": float(s), "unit": p.unit}
            for p, v, s in zip(fit.term.parameters, fit.value, own, strict=True)
        },
    }


def _alternative(fit: ModalFit, best: ModalFit, limits: Limits) -> dict[str, Any]:
    assert fit.term is not None
    behind = fit.chi2 - best.chi2
    tie = "the frequencies cannot tell it from the best" if behind < limits.name else f"chi-square {behind:.0f} behind"
    return {
        "place": fit.term.place.as_dict(),
        "mechanism": fit.term.mechanism.id,
        "held_out_error": fit.held_out,
        "parameters": _mechanism(fit)["parameters"],
        "chi2": fit.chi2,
        "tie": behind < limits.name,
        "why_not": tie,
    }


def _place_of(
    verdict: str, best: ModalFit | None, ranked: Sequence[ModalFit], limits: Limits
) -> dict[str, str | None] | None:
    """Where all that come near the best agree on a place, that; else the whole structure."""
    if verdict != "unexplained":
        return None
    near = [f.term.place for f in ranked if f.term and best and f.chi2 < best.chi2 + limits.name]
    if near and all(p == near[0] for p in near):
        return near[0].as_dict()
    return {"kind": "global", "id": "structure", "to": None}


def _summary(said: dict[str, Any]) -> str:
    parts = [
        f"mode {m['mode']} {100 * m['missing']:+.2f} % (mean of the repeats +- {100 * m['std_of_mean']:.3f})"
        for m in said["modes"]
    ]
    left = "What the updated model misses: " + ", ".join(parts) + "."
    if said["mechanism"]:
        return f"{left} {said['mechanism']['id']} explains it."
    if said["verdict"] == "unexplained":
        chi = said["chi2"]
        near = [a for a in said["alternatives"] if a["tie"]]
        names = ", ".join(f"{a['mechanism']} at {_at(a['place'])} ({_values(a)})" for a in near)
        alike = "alike to these frequencies" if len(near) > 1 else "alone"
        return (
            f"{left} Nearest, and {alike}: {names}; chi-square falls from {chi['base']:.0f} to {chi['best']:.1f}, and"
            f" {chi['enough']:.1f} would be enough. So no single mechanism of the catalogue is named."
        )
    return f"{left} That is within what a sound model misses."


def _at(place: dict[str, Any]) -> str:
    return place["id"] + (f"-{place['to']}" if place["to"] else "")


def _values(alternative: dict[str, Any]) -> str:
    given = alternative["parameters"].items()
    return ", ".join(f"{k} {v['value']:.3g} +- {v['std']:.1g} {v['unit']}".rstrip(" 1") for k, v in given)


def _next(verdict: str) -> str:
    if verdict in ("consistent", "parameters"):
        return ""
    return (
        "Measure FRFs or mode shapes at every coordinate: frequencies alone leave the place open."
        " A known mass added at one place and measured again tells mass from stiffness."
    )


def diagnose_modal_file(
    table: str | Path, model: str | Path, out: str | Path, scatter: Scatter | None = None
) -> dict[str, Any]:
    """Content of diagnosis.json from a table of natural frequencies, written into the folder `out` with its page and
    extended.toml, the model with its updated parameters and what was named.
    """
    read = read_model(model)
    content, fit = examine(read_modal_table(table), read, scatter)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "diagnosis.json").write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    write_updated(folder / "extended.toml", read, fit.theta, _entries(fit))
    from sessions.report.modal_diagnosis import write_modal_page

    write_modal_page(folder / "diagnosis.html", read.path.stem, content)
    return content


def _entries(fit: ModalFit) -> list[dict[str, Any]]:
    """The [[mechanism]] entry of what was named; none for a base."""
    if fit.term is None:
        return []
    place = {k: v for k, v in fit.term.place.as_dict().items() if v is not None}
    entry = {"id": fit.term.mechanism.id, "place": place, "parameters": _mechanism(fit)["parameters"]}
    return [entry | ({"variant": fit.term.variant} if fit.term.variant else {})]
