"""Four ways to deal with what a model leaves out, on the same concealed cases, lines and held-out data.

    python benchmarks/diagnosis_comparators.py --cases 40 --seed 3000 [--jobs 2] [--json]

- parameters: the model's parameters and modal dampings updated, nothing else.
- best subspace: Atalla (1996), equation 2.19. Columns of sensitivity to the stiffness of every element and to a mass at
  every node; the one that best represents what the updated model misses gives the place, the best three are then
  updated together with the parameters.
- black box: rational functions with common poles (a state-space model in modal form) fitted to what the updated model
  misses, by vector fitting (Gustavsen and Semlyen, 1999); the order is the one of least Bayesian information criterion.
- diagnosis: `labnnum diagnose`.

"Error" is the relative RMS error of the FRFs on held-out data (another realisation, or the last run of each level),
its median over visible faulty cases; "gain" the median over cases of parameters' error over this one's. Place and name
count over visible single faults of the catalogue. Nulls: how often a sound structure is given a place or a name.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.fit import fit
from labnnum.diagnosis.places import all_terms, places_of
from labnnum.diagnosis.prediction import predicted, relative_error, trimmed
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.task import choose_lines, data_of
from labnnum.mechanisms import CATALOGUE, Term
from sessions.diagnose import run
from sessions.model import read_model
from sessions.prove.answers import judge, same_place
from sessions.prove.cases import measure, write_case
from sessions.prove.jobs import each
from sessions.prove.measures import VISIBLE
from sessions.prove.suite import Ticket, draw
from sessions.prove.visible import TWINS, misfits

COLUMNS = {"joint-stiffness": "element", "added-mass": ""}
SUBSPACE = 3
LINES = 400


def columns(d: Any, model: Any) -> list[Term]:
    """Stiffness of every element and mass at every node: the substructures of the best-subspace method."""
    engine = d.detail["engine"]
    places = {k: v for k in ("nodes", "elements", "supports") if (v := getattr(model.places, k)) is not None}
    _, terms = all_terms(engine, places_of(engine, places), CATALOGUE)
    return [t for t in terms if COLUMNS.get(t.mechanism.id) == t.variant and t.n == 1]


def sensitivity(engine: Any, point: Any, terms: tuple[Term, ...], new: Term, data: Data) -> NDArray[np.float64]:
    """Whitened column of a term about a fitted point, real and imaginary parts, by a small difference."""
    from dataclasses import replace

    step = 1e-4 * float(np.abs(new.starts).min())
    here = engine.response(point, terms, data.s).value
    there = engine.response(replace(point, terms=np.append(point.terms, step)), (*terms, new), data.s).value
    return _stacked(((there - here) / step / data.sigma).ravel())


def best_subspace(d: Any, model: Any) -> tuple[list[Term], float]:
    """Terms in the order in which they enter, and the held-out error with them updated."""
    engine, train, base = d.detail["engine"], d.detail["train"], d.detail["base"]
    thin = train.at(np.arange(train.frequency.size) % max(train.frequency.size // LINES, 1) == 0)
    data = data_of(thin, Scatter(floor=0.03))
    b = _stacked(((thin.value - predicted(engine, base, thin)) / data.sigma).ravel())
    terms = columns(d, model)
    S = np.array([sensitivity(engine, base.point, base.terms, t, data) for t in terms])
    S = S / np.linalg.norm(S, axis=1, keepdims=True)
    chosen: list[int] = []
    for _ in range(SUBSPACE):
        left = [_distance(S[[*chosen, i]], b) if i not in chosen else np.inf for i in range(len(terms))]
        chosen.append(int(np.argmin(left)))
    picked = tuple(terms[i] for i in chosen)
    return list(picked), _updated(d, data, picked)


def _distance(rows: NDArray, b: NDArray) -> float:
    """e^P of equation 2.19."""
    found = np.linalg.lstsq(rows.T, b, rcond=None)[0]
    return float(np.linalg.norm(b - rows.T @ found) / np.linalg.norm(b))


def _updated(d: Any, data: Data, terms: tuple[Term, ...]) -> float:
    from dataclasses import replace

    engine, base = d.detail["engine"], d.detail["base"]
    start = replace(base.point, terms=np.append(base.point.terms, np.zeros(len(terms))))
    held = replace(base, point=start, terms=(*base.terms, *terms))
    made = fit(engine, data, held.terms, Scatter(), start.vector(), steps=40)
    made = trimmed(engine, choose_lines(d.detail["train"]), made, Scatter())
    test = d.detail["test"]
    return relative_error(test, predicted(engine, made, test))


def black_box(d: Any) -> float:
    """Held-out error of the updated model plus a rational model of what it misses on the training lines."""
    engine, train, test, base = (d.detail[k] for k in ("engine", "train", "test", "base"))
    missing = (train.value - predicted(engine, base, train)).reshape(-1, train.frequency.size)
    weight = 1 / np.sqrt(np.mean(np.abs(train.value) ** 2, axis=-1)).reshape(-1, 1)
    sizes = range(0, 2 * engine.band_modes.size + 7, 2)
    best = min((rational(1j * train.omega, missing * weight, n) for n in sizes), key=lambda found: found[0])
    added = best[1](1j * test.omega) / weight
    return relative_error(test, predicted(engine, base, test) + added.reshape(test.value.shape))


def rational(s: NDArray, H: NDArray, order: int) -> tuple[float, Any]:
    """Bayesian information criterion and evaluation of a model with `order` common poles, shape of H (n_rows, n_f)."""
    size = np.abs(s).max()
    x = s / size
    poles = (-0.01 + 1j) * np.linspace(np.abs(x).min(), 1, order // 2)
    for _ in range(12 if order else 0):
        poles = _relocated(x, H, poles)
    A = _basis(x, poles)
    tall, wanted = _stacked(A), _stacked(H.T)
    c = np.linalg.lstsq(tall, wanted, rcond=None)[0]
    left = np.linalg.norm(wanted - tall @ c) ** 2
    n = 2 * H.size
    criterion = n * np.log(left / n + 1e-300) + np.log(n) * (c.size + 2 * poles.size)
    return float(criterion), lambda z: (_basis(z / size, poles) @ c).T


def _stacked(a: NDArray) -> NDArray[np.float64]:
    """Real part above imaginary part, along the first axis."""
    return np.concatenate([np.real(a), np.imag(a)])


def _basis(x: NDArray, poles: NDArray) -> NDArray:
    """Partial fractions of conjugate pairs with real coefficients, and a constant, shape (n_f, 2 n_pairs + 1)."""
    pairs = [f(p) for p in poles for f in (lambda p: _pair(x, p, 1), lambda p: _pair(x, p, 1j))]
    return np.array([*pairs, np.ones_like(x)]).T


def _pair(x: NDArray, p: complex, phase: complex) -> NDArray:
    return phase / (x - p) + np.conj(phase) / (x - np.conj(p))


def _relocated(x: NDArray, H: NDArray, poles: NDArray) -> NDArray:
    """Poles that follow from one step of vector fitting: zeros of sigma, each row's own fit projected out."""
    A = _basis(x, poles)
    B = A[:, :-1]
    Q = np.linalg.qr(_stacked(A))[0]
    rows, right = [], []
    for h in H:
        m, y = _stacked(-h[:, None] * B), _stacked(h)
        rows.append(m - Q @ (Q.T @ m))
        right.append(y - Q @ (Q.T @ y))
    c = np.linalg.lstsq(np.vstack(rows), -np.concatenate(right), rcond=None)[0]
    n = poles.size
    state, load = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    for i, p in enumerate(poles):
        a, w = float(np.real(p)), float(np.imag(p))
        state[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[a, w], [-w, a]]
        load[2 * i] = 2.0
    new = np.linalg.eigvals(state - np.outer(load, -c))
    new = new[np.imag(new) > 0]
    new = np.concatenate([new, poles[new.size :]])[:n] if new.size < n else new[:n]
    return -np.abs(np.real(new)) - 1e-5 + 1j * np.imag(new)


def one(ticket: Ticket) -> dict[str, Any]:
    """What the four ways make of one case."""
    with tempfile.TemporaryDirectory() as folder:
        case = measure(ticket.conceal())
        model = read_model(write_case(case, Path(folder))[0].parent / "model.toml")
        d = run(sorted(Path(folder).glob("case_*.npz")), model)
        said = d.as_dict()
        terms, subspace = best_subspace(d, model)
        seen = misfits(ticket, twins=TWINS)
        truth = json.loads(json.dumps({**case.truth, "family": ticket.family}))
        judged = judge(truth, said)
        fault = truth["faults"][0] if truth["faults"] else None
        return {
            "case": ticket.name,
            "family": ticket.family,
            "visible": seen["whole"] > VISIBLE * max(seen["sound"], 1e-12),
            "error": {
                "parameters": d.base_error[1],
                "best subspace": subspace,
                "black box": black_box(d),
                "diagnosis": d.extended_error[1],
            },
            "place": {
                "best subspace": bool(fault) and same_place(terms[0].place.as_dict(), fault),
                "diagnosis": judged.place_right,
            },
            "name": {
                "best subspace": bool(fault) and terms[0].mechanism.id == fault["mechanism"],
                "diagnosis": judged.name_right,
            },
            "alarm": {"best subspace": True, "diagnosis": judged.alarm},
        }


def table(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One line a method."""
    faulty = [r for r in rows if r["family"] != "null" and r["visible"]]
    single = [r for r in faulty if r["family"] in ("structure", "channel")]
    nulls = [r for r in rows if r["family"] == "null"]
    out = []
    for method in ("parameters", "best subspace", "black box", "diagnosis"):
        errors = np.array([r["error"][method] for r in faulty])
        gains = np.array([r["error"]["parameters"] / r["error"][method] for r in faulty])
        on_nulls = np.array([r["error"]["parameters"] / r["error"][method] for r in nulls])

        def share(of: str, among: list[dict[str, Any]], method: str = method) -> str:
            known = [r[of][method] for r in among if method in r[of]]
            return f"{sum(known)} of {len(known)}" if known else "-"

        out.append(
            {
                "method": method,
                "error %": round(100 * float(np.median(errors)), 2) if errors.size else None,
                "gain": round(float(np.median(gains)), 2) if gains.size else None,
                "worst gain": round(float(gains.min()), 2) if gains.size else None,
                "gain on nulls": round(float(np.median(on_nulls)), 2) if on_nulls.size else None,
                "place": share("place", single),
                "name": share("name", single),
                "alarms on nulls": share("alarm", nulls),
            }
        )
    return out


def _rows(cases: int, seed: int, jobs: int, keep: Path | None) -> list[dict[str, Any]]:
    """Every case's row; those in the file `keep` are taken from there, new ones added to it."""
    known: dict[str, dict[str, Any]] = {}
    if keep is not None and keep.is_file():
        known = {row["case"]: row for row in map(json.loads, keep.read_text(encoding="utf-8").splitlines())}
    tickets = draw(cases, seed)
    for ticket, row in each(partial(one), [t for t in tickets if t.name not in known], jobs):
        known[ticket.name] = row
        if keep is not None:
            with keep.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
    return [known[t.name] for t in tickets]


def main() -> None:
    """Run the four ways and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=3000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    parser.add_argument(
        "--keep", type=Path, help="file of rows, a line of JSON a case: what it holds is not done again"
    )
    given = parser.parse_args()
    rows = _rows(given.cases, given.seed, given.jobs, given.keep)
    found = table(rows)
    if given.json:
        print(json.dumps({"table": found, "cases": rows}))
        return
    print("| " + " | ".join(found[0]) + " |\n|" + "---|" * len(found[0]))
    for line in found:
        print("| " + " | ".join("-" if v is None else str(v) for v in line.values()) + " |")


if __name__ == "__main__":
    main()
