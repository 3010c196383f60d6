"""How the time of a linear diagnosis grows with sensors, places, mechanisms and lines.

    python benchmarks/diagnosis_time.py --seed 5 [--repeats 1] [--json]

A cantilevered beam on a shaker with a mass too many, as `labnnum prove linear` draws it, eight sensors. One quantity is
varied at a time and the others stay at what the case has. Times are processor seconds of `labnnum.diagnosis.diagnose`
alone (files read before), the least of the repeats; exponents are of a power law through the points, by least squares.
At most 220 to 400 lines are looked at, however many there are (`choose_lines`): time does not grow with a record.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from labnnum.diagnosis.diagnose import diagnose
from labnnum.diagnosis.observe import Observation
from labnnum.frf import Frf
from labnnum.mechanisms import CATALOGUE
from sessions.diagnose import observations_of
from sessions.model import Model, read_model
from sessions.prove.cases import make_case, write_case

SENSORS = (2, 4, 8)
PLACES = (2, 4, 8)
MECHANISMS = (3, 6, 12)
LINES = (60, 120, 240, 480)


def _cut(o: Observation, rows: Sequence[int] | None = None, lines: int | None = None) -> Observation:
    """The observation with some of its rows, and of its lines at even steps."""
    slope, distortion = o.drift_slope, o.distortion
    if rows is not None:
        n = len(o.frf.outputs)
        distortion = {k: v[list(rows)] if v.size == n else v for k, v in distortion.items()}
    return replace(
        o, frf=_frf(o.frf, rows, lines), drift_slope=None if slope is None else _frf(slope, rows, lines),
        distortion=distortion,
    )  # fmt: skip


def _frf(f: Frf, rows: Sequence[int] | None, lines: int | None) -> Frf:
    if lines is not None:
        f = f.at(np.linspace(0, f.frequency.size - 1, min(lines, f.frequency.size)).astype(int))
    if rows is None:
        return f
    pick = list(rows)
    return replace(
        f, value=f.value[pick], outputs=tuple(f.outputs[i] for i in pick),
        variance=None if f.variance is None else f.variance[pick],
    )  # fmt: skip


def _seconds(model: Model, observations: Sequence[Observation], repeats: int, **options: object) -> float:
    p = model.places
    places = {k: getattr(p, k) for k in ("nodes", "elements", "supports") if getattr(p, k) is not None}
    places |= options.pop("places", {})  # type: ignore[operator]
    span = (0.9 * model.bands[0].low, 1.05 * model.bands[-1].high)
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        diagnose(model.structure, observations, places=places, span=span, nonlinear=False, **options)  # type: ignore[arg-type]
        best = min(best, time.process_time() - start)
    return float(best)


def measure(seed: int, repeats: int) -> dict[str, list[tuple[int, float]]]:
    """Quantity -> (its size, seconds)."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_case(make_case(seed, "base-beam", "added-mass", 0.7, sensors=max(SENSORS)), Path(folder))
        model = read_model(Path(folder) / "model.toml")
        seen = observations_of(paths)
        n = len(seen[0].frf.outputs)
        nodes, elements = list(model.places.nodes or ()), list(model.places.elements or ())
        linear = [m for m in CATALOGUE if m.domain != "nonlinear"]
        out: dict[str, list[tuple[int, float]]] = {"sensors": [], "places": [], "mechanisms": [], "lines": []}
        for k in SENSORS:
            rows = np.linspace(0, n - 1, min(k, n)).astype(int)
            out["sensors"].append((len(rows), _seconds(model, [_cut(o, rows) for o in seen], repeats)))
        for k in PLACES:
            some = {"nodes": nodes[-k:], "elements": elements[-k:]}
            out["places"].append((k, _seconds(model, seen, repeats, places=some)))
        for k in MECHANISMS:
            out["mechanisms"].append((k, _seconds(model, seen, repeats, catalogue=linear[:k])))
        for k in LINES:
            cut = [_cut(o, lines=k) for o in seen]
            size = cut[0].frf.frequency.size
            out["lines"].append((size, _seconds(model, cut, repeats)))
        return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found = measure(options.seed, options.repeats)
    rows = {}
    for name, points in found.items():
        x, y = np.log(np.array(points, float)).T
        rows[name] = {"points": points, "exponent": float(np.polyfit(x, y, 1)[0])}
    if options.json:
        print(json.dumps(rows))
        return
    for name, row in rows.items():
        points = ", ".join(f"{n}: {s:.1f} s" for n, s in row["points"])
        print(f"{name:11s} exponent {row['exponent']:5.2f}   {points}")


if __name__ == "__main__":
    main()
