"""Scoring a suite: sealed truth, the tool's answers, the table, the detection limits and every failure."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from labnnum.errors import FileError
from sessions.prove import measures, seal
from sessions.prove.answers import judge
from sessions.prove.cases import KINDS, Case
from sessions.prove.measures import Scored
from sessions.prove.referee import misfit
from sessions.prove.suite import Ticket

NULLS = 16
"""Sound structures of each kind that fix the null median of the referee, besides those of the suite."""
NULL_SEED = 500


def answer_path(folder: Path, case: str) -> Path:
    """Where the answer to a case lies."""
    return folder / "answers" / case / "diagnosis.json"


def null_median(kind: str) -> float:
    """Median chi2 that the referee leaves on sound structures of a kind, development seeds."""
    found = [misfit(Ticket("null", NULL_SEED + i, "null", kind, (), (), "multisine").conceal()) for i in range(NULLS)]
    return float(np.median(found))


def visibilities(
    tickets: Sequence[Ticket], folder: Path, step: Callable[[str], None] = lambda _: None
) -> dict[str, dict[str, Any]]:
    """Visibility of every faulty case and of each of its faults alone, kept in visibility.json of `folder`."""
    path = folder / "visibility.json"
    known: dict[str, dict[str, Any]] = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    medians = {k: v for k, v in known.get("null median", {}).items()}
    for kind in KINDS:
        if kind not in medians and any(t.kind == kind for t in tickets):
            medians[kind] = null_median(kind)
    known["null median"] = medians
    for ticket in tickets:
        if ticket.name not in known:
            known[ticket.name] = _visibility(ticket, medians[ticket.kind])
        step(ticket.name)
    path.write_text(json.dumps(known, indent=1), encoding="utf-8")
    return known


def _visibility(ticket: Ticket, median: float) -> dict[str, Any]:
    whole = misfit(ticket.conceal()) / median
    if len(ticket.faults) < 2:
        return {"whole": whole, "alone": [whole] * len(ticket.faults)}
    return {"whole": whole, "alone": [misfit(c) / median for c in _singles(ticket)]}


def _singles(ticket: Ticket) -> list[Case]:
    """The case with one of its faults at a time."""
    return [ticket.alone(i).conceal() for i in range(len(ticket.faults))]


def read(folder: Path, tickets: Sequence[Ticket], step: Callable[[str], None] = lambda _: None) -> list[Scored]:
    """All cases of a suite that was run in `folder`, scored one by one."""
    truths = {c["case"]: c for c in seal.unseal(folder)["cases"]}
    shown = visibilities(tickets, folder, step)
    return [_scored(folder, truths[t.name], shown[t.name]) for t in tickets if _tried(folder, t.name)]


def _tried(folder: Path, case: str) -> bool:
    return answer_path(folder, case).is_file() or _error_path(folder, case).is_file()


def _error_path(folder: Path, case: str) -> Path:
    return answer_path(folder, case).with_name("error.txt")


def _scored(folder: Path, truth: dict[str, Any], shown: dict[str, Any]) -> Scored:
    path = answer_path(folder, str(truth["case"]))
    alone = tuple(shown["alone"])
    if not path.is_file():
        error = _error_path(folder, str(truth["case"])).read_text("utf-8").strip()
        return Scored(truth, None, shown["whole"], alone, float("nan"), error)
    try:
        answer = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise FileError(f"{path} is not JSON: {error}; delete it to have the case diagnosed again") from None
    time = path.with_name("time.json")
    seconds = json.loads(time.read_text("utf-8"))["wall_s"] if time.is_file() else float("nan")
    return Scored(truth, judge(truth, answer), shown["whole"], alone, float(seconds))


def summary(cases: Sequence[Scored], head: dict[str, Any]) -> dict[str, Any]:
    """What score.json holds."""
    return {
        **head,
        "cases": len(cases),
        "families": {f: sum(c.family == f for c in cases) for f in dict.fromkeys(c.family for c in cases)},
        "visible": sum(c.visible for c in cases if c.family != "null"),
        "measures": [m.as_dict() | {"shown": m.shown} for m in measures.table(cases)],
        "limits": [x.as_dict() for x in measures.limits(cases)],
        "groups": [g.__dict__ for g in measures.groups(cases)],
        "failures": measures.failures(cases),
    }


def markdown(score: dict[str, Any]) -> str:
    """The score as a page."""
    families = ", ".join(f"{n} {name}" for name, n in score["families"].items())
    lines = [
        f"# Concealed suite `{score['suite']}`, seed {score['seed']}",
        "",
        f"{score['cases']} cases ({families}); {score['visible']} of the faulty ones visible."
        f" Sealed truth SHA-256 `{score['sha256']}`.",
        "",
        "| measure | to reach | found, with 95 % Clopper-Pearson interval | |",
        "|---|---|---|---|",
        *(f"| {m['name']} | {m['goal']} | {m['shown']} | {_mark(m['reached'])} |" for m in score["measures"]),
        "",
        "## Detection limits",
        "",
        "| mechanism | cases | visible | named rightly | severity at which half are named | in its own measure |",
        "|---|---|---|---|---|---|",
        *(_limit_row(x) for x in score["limits"]),
        "",
        "## Visible single faults, split",
        "",
        "| by | | cases | place right | named | named rightly |",
        "|---|---|---|---|---|---|",
        *(
            f"| {g['by']} | {g['value']} | {g['n']} | {g['place']} | {g['named']} | {g['right']} |"
            for g in score["groups"]
        ),
        "",
        f"## Failures ({len(score['failures'])})",
        "",
        "| case | why | what was there | what was said | structure | visibility |",
        "|---|---|---|---|---|---|",
        *(_failure_row(f) for f in score["failures"]),
    ]
    return "\n".join(lines) + "\n"


def _mark(reached: bool | None) -> str:
    return "" if reached is None else "yes" if reached else "**no**"


def _limit_row(x: dict[str, Any]) -> str:
    at = "-" if x["severity"] is None else f"{x['severity']:.2f}"
    own = "-" if x["measure"] is None else f"{x['measure']:.3g} ({x['measure_of']})"
    return f"| {x['mechanism']} | {x['n']} | {x['visible']} | {x['named']} | {at} | {own} |"


def _failure_row(f: dict[str, Any]) -> str:
    there = "; ".join(f["truth"]) or "nothing"
    stage = f"{f['structure']}, {f['excitation']}, {f['sensors']} sensors"
    shown = "-" if f["visibility"] is None else f"{f['visibility']:.1f}"
    return f"| {f['case']} | {f['why']} | {there} | {f['said']} | {stage} | {shown} |"


def write(folder: Path, score: dict[str, Any]) -> None:
    """Write score.json and score.md into `folder`."""
    (folder / "score.json").write_text(json.dumps(score, indent=1) + "\n", encoding="utf-8")
    (folder / "score.md").write_text(markdown(score), encoding="utf-8")
