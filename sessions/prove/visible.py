"""How visible every fault of a suite is, kept in visibility.json so that it is computed once."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sessions.prove.cases import sound_twin
from sessions.prove.jobs import each
from sessions.prove.referee import misfit
from sessions.prove.suite import Ticket

NULLS = 16
"""Sound structures of each kind that fix the null median of the referee."""
NULL_SEED = 500
TWINS = 5
"""Sound structures of a case's own make that fix its own null median."""
NAME = "visibility.json"
SAVE_EVERY = 20

Step = Callable[[int, int], None]
"""Told how much is done, and how much there is."""


def silent(done: int, total: int) -> None:
    """A step that shows nothing."""


def visibilities(
    tickets: Sequence[Ticket], folder: Path, jobs: int = 1, step: Step = silent
) -> dict[str, dict[str, Any]]:
    """Case -> visibility of its faults together ("whole") and of each alone ("alone"), over the null median.

    The null median is that of sound structures of its kind, or that of sound twins of its own make where that is more:
    in a frame of low damping the ordinary errors alone shift sharp peaks far more than in most.

    What is known is read from visibility.json in `folder`; what is new is added there.
    """
    path = folder / NAME
    known: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.is_file() else {}
    _medians(tickets, known, path, jobs)
    todo = [t for t in tickets if t.name not in known]
    done = len(tickets) - len(todo)
    step(done, len(tickets))
    for ticket, found in each(partial(misfits, twins=TWINS), todo, jobs):
        known[ticket.name] = _over(found, known["null median"][ground_of(ticket)])
        done += 1
        step(done, len(tickets))
        if done % SAVE_EVERY == 0:
            _save(path, known)
    _save(path, known)
    return known


def ground_of(ticket: Ticket) -> str:
    """Which null median a case is compared with: that of its kind of structure, and of the referee's way of fitting."""
    return f"{ticket.kind}, marched" if ticket.lawful else ticket.kind


def null_median(kind: str, marched: bool = False, jobs: int = 1) -> float:
    """Median chi2 that the referee leaves on sound structures of a kind, development seeds."""
    sound = [Ticket("null", NULL_SEED + i, "null", kind, (), (), "multisine") for i in range(NULLS)]
    return float(np.median([chi2["whole"] for _, chi2 in each(partial(misfits, marched=marched), sound, jobs)]))


def _medians(tickets: Sequence[Ticket], known: dict[str, Any], path: Path, jobs: int) -> None:
    medians = known.setdefault("null median", {})
    for name in sorted({ground_of(t) for t in tickets} - set(medians)):
        medians[name] = null_median(name.split(",")[0], "," in name, jobs)
        _save(path, known)


def misfits(ticket: Ticket, marched: bool | None = None, twins: int = 0) -> dict[str, Any]:
    """The referee's chi2 of a case, of each of its faults alone, and the median of `twins` sound ones of its make.

    `marched` asks for the way of nonlinear cases. NaN where the concealed structure runs away and cannot be measured.
    """
    marched = ticket.lawful if marched is None else marched
    case = ticket.conceal()
    try:
        whole = misfit(case, marched)
    except FloatingPointError:
        return {"whole": np.nan, "alone": [np.nan] * len(ticket.faults), "sound": 0.0}
    sound = [misfit(sound_twin(case, i), marched) for i in range(twins)]
    alone = [whole] * len(ticket.faults)
    if len(ticket.faults) > 1:
        alone = [misfit(ticket.alone(i).conceal(), marched) for i in range(len(ticket.faults))]
    return {"whole": whole, "alone": alone, "sound": float(np.median(sound)) if sound else 0.0}


def _over(found: dict[str, Any], median: float) -> dict[str, Any]:
    null = max(median, found["sound"])
    return {
        "whole": found["whole"] / null,
        "alone": [x / null for x in found["alone"]],
        "null": null,
        "over the kind's median": found["whole"] / median,
    }


def _save(path: Path, known: dict[str, Any]) -> None:
    """Written beside and moved into place, so that a kill never leaves half a file."""
    spare = path.with_suffix(".part")
    spare.write_text(json.dumps(known, indent=1), encoding="utf-8")
    os.replace(spare, path)
