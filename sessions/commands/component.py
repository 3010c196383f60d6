"""labnnum component: which law ties force and motion of a component that is tested alone?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def component(
    files: Annotated[
        list[Path], typer.Argument(help="Sessions (.h5) or files of another program: component tests to fit to.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for component.json and loops.svg.")],
    held_out: Annotated[
        list[Path] | None, typer.Option("--held-out", help="Tests that no fit may see; may be given again.")
    ] = None,
    channels: Annotated[Path | None, typer.Option(help="channels.toml, if the files are another program's.")] = None,
    motion: Annotated[str, typer.Option(help="Channel of the motion, if several are displacements.")] = "",
    force: Annotated[str, typer.Option(help="Channel of the force, if several are forces.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print component.json and nothing else.")] = False,
) -> None:
    """Name the law of a damper, a joint or a bearing from its own test: force against imposed motion.

    The motion is a displacement of several cycles (the first is left out), the force the one that opposes it. Viscous
    and quadratic damping, dry friction, cubic springs, play, sliders and sliders behind play are simulated along the
    motion, fitted to the force and judged on the tests held out, which should be of other frequencies and strokes. The
    simplest law within 3 % of the least error is named, with 90 % intervals.

    For example:

        labnnum component slow.h5 medium.h5 --held-out fast.h5 --held-out long.h5 -o damper
    """
    import json

    from labnnum.errors import FileError
    from sessions.commands.printing import finite, note, stages
    from sessions.component import identify_tests, read_tests, write_component

    if out.exists() and not out.is_dir():
        raise FileError(f"{out}: is a file; --out names a folder for the answer")
    with stages("reading") as tell:
        tests = read_tests(files, channels, motion, force)
        others = read_tests(held_out or (), channels, motion, force)
        found = identify_tests(tests, others, tell)
        content = write_component(out, found)
    if as_json:
        typer.echo(json.dumps(finite(content)))
        return
    for line in _lines(content):
        typer.echo(line)
    if found.turned:
        note("the recorded force drives the motion; it was taken with the other sign")
    if not others:
        note("no test was held out: the laws are judged on what they were fitted to; give others with --held-out")
    if len(tests) == 1:
        note("one test was fitted to: intervals do not hold what differs from test to test")
    typer.echo(f"loops: {out / 'loops.svg'}")


def _lines(content: dict[str, Any]) -> list[str]:
    from sessions.commands.printing import table

    best = content["laws"][0]
    if content["law"] is None:
        left = f"law: none; the nearest, {content['nearest']}, leaves {100 * best['held_out']:.0f} % of the force"
    else:
        left = f"law: {content['law']}, leaves {100 * best['held_out']:.1f} % of the force on {content['judged_on']}"
    lines = [left]
    for name, p in (content["parameters"] | content["derived"]).items():
        lines.append(f"  {name}: {p['value']:.4g} +- {p['half_90']:.4g} {p['unit']} (90 %)")
    beside = content["viscous_beside"]
    lines.append(f"  a dashpot beside it: {beside['value']:.3g} +- {beside['half_90']:.3g} {beside['unit']} (90 %)")
    rows = [[f["law"], f"{f['error']:.3f}", f"{f['held_out']:.3f}"] for f in content["laws"]]
    lines += ["", table(["law", "error", "held out"], rows)]
    rows = [
        [
            t["test"] + (" (held out)" if t["held_out"] else ""),
            *(f"{t[k]:.3f}" for k in ("error", "error_viscous")),
            *(f"{t[k]:.4g}" for k in ("work_J", "work_law_J", "work_viscous_J")),
        ]
        for t in content["tests"]
    ]
    head = ["test", "error", "viscous", "work a cycle, J", "by the law", "by a dashpot"]
    return [*lines, "", table(head, rows)]
