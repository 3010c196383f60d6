"""labnnum reproduce: the dissertation's examples worked again, beside the bound that no method can pass."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def reproduce(
    example: Annotated[
        str,
        typer.Argument(
            help='truck, kabe, yang, duffing, beam, frame, or one case such as "truck-5-1frf"; control, drift, flags or'
            " leakage; every example where absent.",
            show_default=False,
        ),
    ] = "",
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for tables and figures.")] = Path("reproduced"),
    cases: Annotated[
        int,
        typer.Option(
            help="Verification sets of each case; fewer for a quick look. By default 5000; 90 blocks of"
            " drift, 200 measurements of each kind for flags, 40 records for leakage.",
            show_default=False,
        ),
    ] = 0,
    noise: Annotated[
        list[float] | None, typer.Option(help="Noise on the FRF as a share of |H|; repeat. By default 0, 0.01, 0.03.")
    ] = None,
    samples: Annotated[int, typer.Option(help="Training samples of the networks trained with noise.")] = 30_000,
    large: Annotated[int, typer.Option(help="Samples of one more clean network on 800 centres; 0 leaves it out.")] = 0,
    nominal: Annotated[int, typer.Option(help="Sets that are refined from the nominal values as well.")] = 500,
    lines: Annotated[
        int, typer.Option(help="Lines in each band; 0 takes ours, 60: the dissertation does not print its own.")
    ] = 0,
    seed: Annotated[int, typer.Option(help="The same seed gives the same numbers.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON and nothing else.")] = False,
) -> None:
    """Work the dissertation's examples again.

    For every parameter: mean and largest error in percent as published, of the network as printed, of ours, refined by
    least squares, and of the Cramer-Rao bound, without noise and with noise on the FRF. Tables, figures and one page a
    case go to a folder. Stop it with Ctrl-C and run it again: it goes on where it stopped.

    Besides, control compares gains of an optimal regulator on the truck, drift follows a truck that changes while its
    loop is closed, flags counts false alarms and misses of the checks on a measurement, and leakage fits the model to
    H1 of time records, seen through their window and not.

    For example:

        labnnum reproduce truck -o reproduced

        labnnum reproduce kabe-damped --cases 200 --samples 2000
    """
    import json

    from labnnum.errors import ConfigError
    from sessions.reproduce.cases import chosen
    from sessions.reproduce.extras import EXTRAS
    from sessions.reproduce.run import open_folder, reproduce_case
    from sessions.reproduce.study import Effort
    from sessions.reproduce.tables import text_table

    noises = tuple(sorted(set(noise))) if noise else (0.0, 0.01, 0.03)
    if cases < 0 or samples < 0 or any(not 0 <= n < 1 for n in noises):
        raise ConfigError("reproduce: --cases and --samples must be at least 0, --noise from 0 to below 1")
    if example in EXTRAS:
        work, number = EXTRAS[example]
        with _progress(example) as say:
            table = work(cases or number, seed, open_folder(output), say)
        typer.echo((output / f"{example}.json").read_text(encoding="utf-8") if as_json else table)
        return
    if lines and lines < 8:
        raise ConfigError("reproduce: --lines must be 0, or at least 8 in each band")
    names, cases = chosen(example), cases or 5000
    folder = open_folder(output)
    effort = Effort(cases, noises, samples, large=large, nominal=min(nominal, cases), seed=seed, lines=lines)
    every = []
    for name in names:
        with _progress(name) as say:
            found = reproduce_case(name, effort, folder, say)
        every.append(found)
        if not as_json:
            typer.echo(text_table(found))
    if as_json:
        typer.echo(json.dumps(every))
    else:
        typer.echo(f"Tables and figures of {len(names)} cases stand in {folder}.")


def _progress(name: str):
    """Context that gives a say(what, done, total) and draws a bar where a terminal is."""
    from contextlib import contextmanager

    from rich.console import Console
    from rich.progress import Progress

    @contextmanager
    def shown():
        console = Console(stderr=True)
        with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
            task = bar.add_task(name)

            def say(what: str, done: int, total: int) -> None:
                bar.update(task, description=f"{name}: {what}", completed=done, total=total)

            yield say

    return shown()
