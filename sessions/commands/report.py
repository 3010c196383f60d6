"""labnnum report: a session's results as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def report(
    session: Annotated[Path, typer.Argument(help="The session (.h5) to show.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The page to write; beside the session if left out.")
    ] = None,
    updater: Annotated[
        Path | None, typer.Option("--updater", "-u", help="Update with this updater first, and store the estimate.")
    ] = None,
    model: Annotated[
        Path | None, typer.Option("--model", "-m", help="Update this model first, from its nominal values.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print where the page is, for scripts.")] = False,
) -> None:
    """Write one self-contained HTML page of what a session holds.

    It shows what is stored and computes nothing: the channels and runs, the newest estimate with the FRF that it
    was made of (magnitude, phase, coherence, random error, the model before and after), what to doubt, and the
    settings and versions behind every figure. Pictures are inside the page, so it can be mailed as it is.

    First come `labnnum frf` and `labnnum update`, or name an updater or a model here; a session without results gives
    a page about its raw data.

    For example:

        labnnum report beam.h5

        labnnum report beam.h5 --updater beam-updater.h5 -o for-the-customer.html
    """
    from sessions.report.page import require_page, write_report

    page = out or session.with_suffix(".html")
    require_page(page)
    if updater is not None or model is not None:
        from sessions.updating import choose_frf, run_update, store

        store(session, run_update(choose_frf(session), updater, model))
    made = write_report(session, page)
    if as_json:
        import json

        typer.echo(json.dumps({"report": str(made)}))
    else:
        typer.echo(f"report: {made}")
