"""`labnnum prove`: concealed suites that anyone can draw again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from sessions.prove.run import Order


def prove(
    suite: Annotated[
        str,
        typer.Argument(
            help="linear or nonlinear: which physics is concealed in drawn structures. limits: how strong a nonlinear"
            " law must be to be named. dissertation: what its models left out. real: recordings by others."
        ),
    ],
    cases: Annotated[int, typer.Option(help="How many cases to draw.")] = 40,
    seed: Annotated[
        int, typer.Option(help="Seed of the suite. 0 to 999 were used in development; take 1000 or above for a proof.")
    ] = 1000,
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder for truth, answers and score.")] = Path("prove"),
    jobs: Annotated[int, typer.Option(help="Cases computed at the same time.")] = 1,
    keep: Annotated[bool, typer.Option("--keep", help="Keep the recordings of every case.")] = False,
    draw_only: Annotated[
        bool, typer.Option("--draw-only", help="Write the case folders and the sealed truth, and diagnose nothing.")
    ] = False,
    score_only: Annotated[
        bool, typer.Option("--score-only", help="Score the answers that are there so far, whoever gave them.")
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="Diagnose this case of the suite only, or run this recording (silverbox, f16 or friction_damper) of"
            " `real` only; may be given again."
        ),
    ] = None,
    tool: Annotated[
        str, typer.Option(help="module:function that diagnoses: (recordings, model, out) writes out/diagnosis.json.")
    ] = "sessions.diagnose:diagnose_files",
    recordings: Annotated[
        Path | None, typer.Option(help="For the suite `real`: the folder of the recordings, with a folder for each.")
    ] = None,
    examples: Annotated[
        Path | None,
        typer.Option(
            help="For the suite `real`: the folder of their channels.toml files; examples/recordings if not given."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the score as JSON on standard output.")] = False,
) -> None:
    """Prove the diagnosis on cases whose truth is concealed.

    Structures with drawn faults (and sound ones) are simulated by code that shares nothing with the diagnosis:
    another mesh, another damping, a measurement chain in between. The truth is sealed in OUT/truth.json, whose
    SHA-256 is printed before the first case is diagnosed; the score follows with exact intervals, detection
    limits and every failure. Stop it with Ctrl-C and run it again: it goes on where it stopped.

        labnnum prove linear --cases 400 --seed 4711 -o proof

    The suite "limits" draws strength, level of the drive and noise apart and tells, for every nonlinear law, how strong
    it must be to be named at its place.

    The suite "dissertation" holds a fixed handful: the cantilevered beam and a frame of Atalla (1996), sections 5.6 and
    5.7, each with one effect concealed. The suite "real" runs recordings by others, found in --recordings, prints what
    was run here beside what is published, and writes both to OUT/real.md and real.json, with figures in a folder for
    each recording.

        labnnum prove real --recordings DIR -o real
    """
    from rich.console import Console

    console = Console(stderr=True)
    if suite == "real":
        _real(recordings, examples, out, only, as_json)
        return
    if suite == "dissertation":
        _dissertation(console, out, jobs, tool, only or [], as_json)
        return
    if suite == "limits":
        _limits(console, cases, seed, out, jobs, tool, score_only, as_json)
        return
    _require_suite(suite)
    from sessions.prove.run import Order, start

    order = Order(suite, cases, seed, out, jobs, keep, tool)
    with console.status("drawing the suite"):
        tickets, sha256 = start(order)
        asked = _those(tickets, only)
    console.print(f"sealed truth of {len(tickets)} cases: {out / 'truth.json'}\nSHA-256 {sha256}", highlight=False)
    if draw_only:
        _draw_only(console, order, asked)
        if as_json:
            _print_json({"cases": str(out / "cases"), "sha256": sha256})
        return
    found = _run(console, order, tickets, () if score_only else asked, sha256)
    if as_json:
        _print_json(found)
    else:
        _show(Console(), found, out)


def _require_suite(suite: str) -> None:
    """ConfigError if there is no suite of that name."""
    from labnnum.errors import ConfigError
    from sessions.prove.suite import SHARES

    if suite not in SHARES:
        raise ConfigError(f"suite {suite!r} is not one of {', '.join(SHARES)}, limits, dissertation, real")


def _limits(
    console: Console, cases: int, seed: int, out: Path, jobs: int, tool: str, score_only: bool, as_json: bool
) -> None:
    from rich.console import Console

    from sessions.prove import limits

    with _progress(console) as progress:
        bars = _Bars(progress)
        found = limits.run(
            out, cases, seed, jobs, tool, lambda done, total: bars.step("diagnosing", done, total), not score_only
        )
    if as_json:
        _print_json(found)
        return
    _table(Console(), "measure of a law at which half are named", limits.columns(), limits.lines(found))
    console.print(f"answers, limits.json and limits.md are in {out}", highlight=False)


def _real(recordings: Path | None, examples: Path | None, out: Path, only: list[str] | None, as_json: bool) -> None:
    """The real recordings: one table, or what real.json holds."""
    from rich.console import Console

    from labnnum.errors import ConfigError
    from sessions.commands.printing import note, stages
    from sessions.prove.real import COLUMNS, SETS, examples_folder, run_real

    if recordings is None:
        raise ConfigError("prove real: --recordings is missing; give the folder that holds the real recordings")
    with stages("reading") as tell:
        found = run_real(recordings, examples_folder(examples), out, only or SETS, tell)
    if as_json:
        _print_json(found.as_dict())
        return
    for name in dict.fromkeys(r.recording for r in found.rows):
        rows = [(r.measure, r.found, r.published, r.asked) for r in found.rows if r.recording == name]
        _table(Console(), name, COLUMNS[1:], rows)
    for text in found.notes:
        note(text)
    folders = ", ".join(str(out / name) for name in found.run)
    note(f"the table is in {out / 'real.md'} and real.json, figures in {folders}")


def _those(tickets: Any, only: list[str] | None) -> Any:
    """The tickets of the cases asked for, all of them if none is."""
    from labnnum.errors import ConfigError

    unknown = set(only or ()) - {t.name for t in tickets}
    if unknown:
        raise ConfigError(f"--only {min(unknown)}: the suite holds {tickets[0].name} to {tickets[-1].name}")
    return tuple(t for t in tickets if not only or t.name in only)


def _dissertation(console: Console, out: Path, jobs: int, tool: str, only: list[str], as_json: bool) -> None:
    import json

    from rich.console import Console

    from sessions.prove import dissertation

    with _progress(console) as progress:
        bars = _Bars(progress)
        rows = dissertation.run(out, jobs, tool, only, lambda done, total: bars.step("diagnosing", done, total))
    if as_json:
        typer.echo(json.dumps(rows))
        return
    columns = ("case", "concealed", "visible", "said", "base/extended", "right")
    shown = [
        (
            row["case"],
            row["what"],
            f"{row['visibility']:.1f}",
            row["said"],
            "-" if row["base_over_extended"] is None else f"{row['base_over_extended']:.1f}",
            "yes" if row["right"] else "NO",
        )
        for row in rows
    ]
    _table(Console(), "what the dissertation's models left out", columns, shown)
    console.print(f"cases, answers and dissertation.json are in {out}", highlight=False)


def _print_json(found: dict[str, Any]) -> None:
    import json

    typer.echo(json.dumps(found))


def _progress(console: Console) -> Any:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


class _Bars:
    """A bar for each thing that is being done."""

    def __init__(self, progress: Any) -> None:
        self.progress = progress
        self.tasks: dict[str, Any] = {}

    def step(self, what: str, done: int, total: int) -> None:
        if what not in self.tasks:
            self.tasks[what] = self.progress.add_task(what, total=total)
        self.progress.update(self.tasks[what], completed=done)


def _draw_only(console: Console, order: Order, tickets: Any) -> None:
    from sessions.prove.run import write_all

    with _progress(console) as progress:
        write_all(order, tickets, _Bars(progress).step)
    console.print(f"cases are in {order.out / 'cases'}; put each answer in {order.out / 'answers'}/CASE/diagnosis.json")


def _run(console: Console, order: Order, tickets: Any, asked: Any, sha256: str) -> dict[str, Any]:
    from sessions.prove.run import diagnose_all, score_all

    with _progress(console) as progress:
        bars = _Bars(progress)
        if asked:
            diagnose_all(order, asked, bars.step)
        return score_all(order, tickets, sha256, bars.step)


def _show(console: Console, found: dict[str, Any], out: Path) -> None:
    where = f"{found['cases']} of {found['drawn']} concealed cases, suite {found['suite']}, seed {found['seed']}"
    yes = {True: "yes", False: "NO", None: ""}
    measures = [(m["name"], m["goal"], m["shown"], yes[m["reached"]]) for m in found["measures"]]
    _table(console, where, ("measure", "to reach", "found (95 % Clopper-Pearson)", ""), measures)
    limits = [(x["mechanism"], x["n"], x["visible"], x["named"], *_limit(x)) for x in found["limits"]]
    names = ("mechanism", "cases", "visible", "named", "severity", "its own measure")
    _table(console, "detection limits: where half are named", names, limits)
    rates = [(r["family"], r["by"], r["value"], r["shown"]) for r in found["rates"]]
    _table(console, "sound, or visible and as they should be", ("family", "by", "", "found"), rates)
    failures = [(f["case"], f["why"], "; ".join(f["truth"]) or "nothing", f["said"]) for f in found["failures"]]
    _table(console, f"{len(failures)} failures", ("case", "why", "what was there", "what was said"), failures)
    console.print(f"the whole score is in {out / 'score.md'} and score.json", highlight=False)


def _limit(x: dict[str, Any]) -> tuple[str, str]:
    own = "-" if x["measure"] is None else f"{x['measure']:.3g}  {x['measure_of']}"
    return "-" if x["severity"] is None else f"{x['severity']:.2f}", own


def _table(console: Console, title: str, columns: tuple[str, ...], rows: list[tuple[Any, ...]]) -> None:
    from rich.table import Table

    table = Table(title=title)
    for name in columns:
        table.add_column(name)
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    console.print(table)
