"""Working cases through into a folder: tables as text, JSON and CSV, figures as one page for each case."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from labnnum.errors import FileError
from sessions.reproduce.cases import CASES
from sessions.reproduce.figures import histograms, worst_frfs
from sessions.reproduce.keep import clear_progress, finished, load_progress, save_progress, write
from sessions.reproduce.networks import Say
from sessions.reproduce.page import page
from sessions.reproduce.study import Effort, study
from sessions.reproduce.tables import csv_rows, summary, text_table


def open_folder(folder: Path) -> Path:
    """The folder, made if need be.

    Raises
    ------
    FileError
        If it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"{folder}: cannot be made ({error.strerror}); choose another folder with -o") from error
    return folder


def reproduce_case(name: str, effort: Effort, folder: Path, say: Say) -> dict[str, Any]:
    """Figures of one case; what an earlier run finished or began is taken up.

    Writes NAME.txt, NAME.csv, NAME.html and, last of all, NAME.json.
    """
    known = finished(folder, name, effort)
    if known is not None:
        return known
    done = study(
        CASES[name]().with_lines(effort.lines), effort, say, load_progress(folder, name, effort),
        lambda found: save_progress(folder, name, effort, found),
    )  # fmt: skip
    found = summary(done)
    table = text_table(found)
    write(folder, f"{name}.txt", table)
    write(folder, f"{name}.csv", csv_rows(found))
    write(folder, f"{name}.html", page(done.case.title, [("Errors", table, [histograms(done), worst_frfs(done)])]))
    write(folder, f"{name}.json", json.dumps(found, indent=1))
    clear_progress(folder, name)
    return found
