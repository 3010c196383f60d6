"""What became of the cases of a suite: split by structure, excitation and the like, and every failure by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from sessions.prove.answers import Judged
from sessions.prove.intervals import count
from sessions.prove.measures import Scored, plain, says


@dataclass(frozen=True)
class Group:
    """Visible single faults of the catalogue that share a property, and what became of them."""

    by: str
    value: str
    n: int
    place: int
    named: int
    right: int


def groups(cases: Sequence[Scored]) -> list[Group]:
    """The same cases split by structure, excitation, number of sensors and visibility."""
    seen = [c for c in cases if c.family in ("structure", "channel", "nonlinear") and c.visible]
    splits: dict[str, Callable[[Scored], str]] = {
        "structure": lambda c: str(c.truth["kind"]),
        "excitation": lambda c: str(c.truth["excitation"]),
        "sensors": lambda c: _bin(c.truth["sensors"], (2, 4, 6), "{} to {}"),
        "visibility": lambda c: _bin(c.visibility, (3, 10, 30, 100), "{} to {}"),
    }
    return [
        _group(by, value, [c for c in seen if of(c) == value])
        for by, of in splits.items()
        for value in sorted({of(c) for c in seen})
    ]


def _bin(value: float, edges: Sequence[int], words: str) -> str:
    at = max(i for i, e in enumerate(edges) if value >= e or i == 0)
    return words.format(edges[at], edges[at + 1]) if at + 1 < len(edges) else f"{edges[at]} and more"


def _group(by: str, value: str, cases: Sequence[Scored]) -> Group:
    counts = (sum(says(c, what) for c in cases) for what in ("place_right", "named", "name_right"))
    return Group(by, value, len(cases), *counts)


@dataclass(frozen=True)
class Rate:
    """Cases of one family on one kind of structure, or under one excitation, that came out as they should."""

    family: str
    by: str
    value: str
    n: int
    right: int
    shown: str


def rates(cases: Sequence[Scored]) -> list[Rate]:
    """Per family, by structure and by excitation: how many of the visible cases (and of the nulls) are no failure."""
    out = []
    for family in dict.fromkeys(c.family for c in cases):
        mine = [c for c in cases if c.family == family and counts(c)]
        for by, of in (("structure", "kind"), ("excitation", "excitation")):
            for value in sorted({str(c.truth[of]) for c in mine}):
                share = count([not why(c) for c in mine if c.truth[of] == value])
                out.append(Rate(family, by, value, share.n, share.k, str(share)))
    return out


def counts(case: Scored) -> bool:
    """Whether a case enters the rates: sound ones do, faulty ones if their faults show."""
    return case.family == "null" or (case.both_visible if case.family == "double" else case.visible)


def failures(cases: Sequence[Scored]) -> list[dict[str, Any]]:
    """Every case that did not come out as it should, with what was there and what was said."""
    return [_failure(c, reason) for c in cases if (reason := why(c))]


def why(case: Scored) -> str:
    """Why a case is a failure, in a few words; empty if it is none."""
    if case.judged is None:
        return f"no answer: {case.error.splitlines()[0] if case.error else 'no reason'}"
    j = case.judged
    if case.family == "null":
        return "named" if j.named else "false alarm" if j.alarm else ""
    if not case.visible:
        return "invisible, and wrongly named" if j.named and not j.name_right else ""
    if case.family == "outside":
        wrong = "falsely named" if j.named else "" if j.verdict == "unexplained" else f'"{j.verdict}"'
        return wrong or ("" if j.place_right else _elsewhere(j))
    if case.family == "double":
        return "" if all(j.found) else "one of two" if any(j.found) else "none of two"
    if not j.named:
        return "not named" if j.place_right else f"not named, {_elsewhere(j)}"
    return ("" if j.name_right else "wrong name") or ("" if j.both_right else _elsewhere(j))


def _elsewhere(judged: Judged) -> str:
    return "next to the place" if judged.adjacent else "wrong place"


def _failure(case: Scored, reason: str) -> dict[str, Any]:
    truth = case.truth
    return {
        "case": truth["case"],
        "why": reason,
        "family": case.family,
        "structure": truth["kind"],
        "excitation": truth["excitation"],
        "sensors": truth["sensors"],
        "visibility": plain(case.visibility),
        "truth": [
            f"{f['mechanism']} at {f['place']['kind']} {f['place']['id']}"
            + (f"-{f['place']['to']}" if f["place"]["to"] else "")
            + f", severity {f['severity']:.2f}"
            for f in truth["faults"]
        ],
        "said": case.judged.said if case.judged else "",
    }
