"""Running a suite: draw, seal, measure each case, ask the tool, score. Interrupt it and it goes on where it stopped."""

from __future__ import annotations

import gc
import json
import shutil
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from labnnum.errors import ConfigError, LabnnumError
from sessions.prove import score, seal
from sessions.prove.cases import write_case
from sessions.prove.jobs import each
from sessions.prove.suite import Ticket, draw

TOOL = "sessions.diagnose:diagnose_files"

Step = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and how much there is."""


@dataclass(frozen=True)
class Order:
    """What is to be proved, and how.

    `tool` is "module:function" of a function (recordings, model, out) -> dict that writes out/diagnosis.json: the
    program's own, or any other that is to be compared.
    """

    suite: str
    cases: int
    seed: int
    out: Path
    jobs: int = 1
    keep: bool = False
    tool: str = TOOL


def quiet(what: str, done: int, total: int) -> None:
    """A step that shows nothing."""


def start(order: Order) -> tuple[tuple[Ticket, ...], str]:
    """Draw and seal a suite; its tickets and the SHA-256 of the sealed truth."""
    if order.jobs < 1:
        raise ConfigError(f"--jobs {order.jobs} must be at least 1")
    tickets = draw(order.cases, order.seed, order.suite)
    return tickets, seal.seal(order.out, order.suite, order.seed, tickets, order.jobs)


def write_all(order: Order, tickets: Sequence[Ticket], step: Step = quiet) -> None:
    """Write the case folders only, so that any tool can be run on them."""
    todo = [t for t in tickets if not (case_folder(order.out, t.name) / "model.toml").is_file()]
    done = len(tickets) - len(todo)
    step("drawing", done, len(tickets))
    for _ in each(partial(_write, out=order.out), todo, order.jobs):
        done += 1
        step("drawing", done, len(tickets))


def _write(ticket: Ticket, out: Path) -> None:
    write_case(ticket.measured(), case_folder(out, ticket.name))


def case_folder(out: Path, case: str) -> Path:
    """Folder of what a user would have of a case."""
    return out / "cases" / case


def diagnose_all(order: Order, tickets: Sequence[Ticket], step: Step = quiet) -> None:
    """Measure and diagnose every case that has no answer yet."""
    load(order.tool)
    todo = [t for t in tickets if not score.answer_path(order.out, t.name).is_file()]
    done = len(tickets) - len(todo)
    step("diagnosing", done, len(tickets))
    ask = partial(answer, out=order.out, keep=order.keep, tool=order.tool)
    for _ in each(ask, todo, order.jobs):
        done += 1
        step("diagnosing", done, len(tickets))


def load(tool: str) -> Callable[..., Any]:
    """The function that a "module:function" names; ConfigError if there is none."""
    module, _, function = tool.partition(":")
    try:
        return getattr(import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"--tool {tool}: {error}; it must be module:function") from None


def answer(ticket: Ticket, out: Path, keep: bool, tool: str) -> str:
    """Measure one case, have it diagnosed, keep the answer and its time; the name of the case.

    A tool that fails leaves error.txt instead of an answer: the case counts as one without answer, and is listed. So
    does a concealed structure that runs away, which nobody can measure.
    """
    folder = case_folder(out, ticket.name)
    target = score.answer_path(out, ticket.name).parent
    target.mkdir(parents=True, exist_ok=True)
    failed = target / "error.txt"
    failed.unlink(missing_ok=True)
    try:
        recordings = write_case(ticket.measured(), folder)
    except FloatingPointError as error:
        failed.write_text(f"not measured: {error}\n", encoding="utf-8")
        return ticket.name
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        load(tool)(recordings, folder / "model.toml", target)
        if not score.answer_path(out, ticket.name).is_file():
            failed.write_text("the tool wrote no diagnosis.json\n", encoding="utf-8")
    except LabnnumError as error:
        failed.write_text(f"{type(error).__name__}: {error}\n", encoding="utf-8")
    except Exception as error:
        failed.write_text(f"{type(error).__name__}: {error}\n\n{traceback.format_exc()}", encoding="utf-8")
    times = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    (target / "time.json").write_text(json.dumps(times), encoding="utf-8")
    if not keep:
        shutil.rmtree(folder)
    gc.collect()  # a case leaves cycles that hold its spectra, some hundred MB under long sweeps
    return ticket.name


def score_all(order: Order, tickets: Sequence[Ticket], sha256: str, step: Step = quiet) -> dict[str, Any]:
    """Score what was answered so far; writes score.json and score.md."""
    cases = score.read(order.out, tickets, order.jobs, partial(step, "scoring"))
    head = {"schema": 1, "suite": order.suite, "seed": order.seed, "sha256": sha256, "tool": order.tool}
    found = score.summary(cases, {**head, "drawn": len(tickets)})
    score.write(order.out, found)
    return found
