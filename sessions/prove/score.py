"""Scoring a suite: sealed truth, the tool's answers, the table, the detection limits and every failure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labnnum.errors import FileError
from sessions.prove import listing, measures, seal
from sessions.prove.answers import judge
from sessions.prove.measures import Scored
from sessions.prove.suite import Ticket
from sessions.prove.visible import Step, silent, visibilities


def answer_path(folder: Path, case: str) -> Path:
    """Where the answer to a case lies."""
    return folder / "answers" / case / "diagnosis.json"


def read(folder: Path, tickets: Sequence[Ticket], jobs: int = 1, step: Step = silent) -> list[Scored]:
    """All cases of a suite that were answered so far in `folder`, scored one by one."""
    truths = {c["case"]: c for c in seal.unseal(folder)["cases"]}
    tried = [t for t in tickets if _tried(folder, t.name)]
    shown = visibilities(tried, folder, jobs, step)
    return [_scored(folder, truths[t.name], shown[t.name]) for t in tried]


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
    seconds = json.loads(time.read_text("utf-8"))["cpu_s"] if time.is_file() else float("nan")
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
        "groups": [g.__dict__ for g in listing.groups(cases)],
        "rates": [r.__dict__ for r in listing.rates(cases)],
        "failures": listing.failures(cases),
    }


def markdown(score: dict[str, Any]) -> str:
    """The score as a page."""
    families = ", ".join(f"{n} {name}" for name, n in score["families"].items())
    lines = [
        f"# Concealed suite `{score['suite']}`, seed {score['seed']}",
        "",
        f"{score['cases']} of {score['drawn']} cases answered ({families});"
        f" {score['visible']} of the faulty ones visible. Sealed truth SHA-256 `{score['sha256']}`.",
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
        "## Families, by structure and excitation",
        "",
        "Sound cases, and faulty ones that are visible, that came out as they should.",
        "",
        "| family | by | | as they should, with 95 % interval |",
        "|---|---|---|---|",
        *(f"| {r['family']} | {r['by']} | {r['value']} | {r['shown']} |" for r in score["rates"]),
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
