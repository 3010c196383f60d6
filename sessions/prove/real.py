"""The real recordings by others: identified, diagnosed and simulated by the tool as it is, beside published figures."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from labnnum import __version__
from labnnum.errors import ConfigError, FileError
from sessions.prove.real_damper import friction_damper
from sessions.prove.real_f16 import f16
from sessions.prove.real_rows import Row
from sessions.prove.real_silverbox import COMPARATORS, silverbox

Run = Callable[[Path, Path, Path, Callable[[str], None]], list[Row]]

RUNS: dict[str, Run] = {"silverbox": silverbox, "f16": f16, "friction_damper": friction_damper}
SETS = tuple(RUNS)
"""Recordings that are run, folders of the recordings' directory."""

COLUMNS = ("recording", "measure", "run here", "published, not run here", "asked for")
"""Of the table."""


@dataclass(frozen=True)
class Comparison:
    """Rows of the table, what was and what was not run, notes, and the files that were written (relative to `out`)."""

    out: Path
    rows: list[Row]
    run: tuple[str, ...]
    absent: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def files(self) -> list[str]:
        """What lies in the folders of the sets that were run."""
        return [str(f.relative_to(self.out)) for name in self.run for f in sorted((self.out / name).iterdir())]

    def as_dict(self) -> dict[str, Any]:
        """What real.json holds."""
        return {
            "schema": 1,
            "labnnum": __version__,
            "run": list(self.run),
            "absent": list(self.absent),
            "rows": [asdict(r) for r in self.rows],
            "notes": list(self.notes),
            "files": self.files,
        }


def examples_folder(given: Path | None = None) -> Path:
    """examples/recordings: as given, else in the working directory, else in the checkout that labnnum runs from.

    Raises
    ------
    FileError
        If it is not there.
    """
    near = Path("examples") / "recordings"
    tried = [given] if given is not None else [near, Path(__file__).resolve().parents[2] / near]
    for folder in tried:
        if folder.is_dir():
            return folder
    raise FileError(
        f"{tried[0]}: no such folder; --examples takes the folder examples/recordings of labnnum's repository, which"
        " holds a channels.toml for every recording and is not installed with the program"
    )


def run_real(
    recordings: Path,
    examples: Path,
    out: Path,
    only: Sequence[str] = SETS,
    progress: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """Every set that is there, one after another; writes real.md and real.json beside a folder for each.

    Parameters
    ----------
    recordings : Path
        Folder with one folder a set; their public sources are in examples/recordings/README.md.
    examples : Path
        Folder of the channels.toml files, examples/recordings.
    out : Path
        Folder for the tables and, in a folder for each set, its answers and figures.

    Raises
    ------
    ConfigError
        If a name of `only` is no set.
    FileError
        If none of the sets is there.
    """
    unknown = [name for name in only if name not in RUNS]
    if unknown:
        raise ConfigError(f"--only {unknown[0]}: the real recordings are {', '.join(SETS)}")
    found = tuple(name for name in only if (recordings / name).is_dir())
    if not found:
        raise FileError(f"{recordings}: holds none of the folders {', '.join(only)}")
    absent = tuple(name for name in only if name not in found)
    rows: list[Row] = []
    for name in found:
        progress(name)
        rows += RUNS[name](recordings / name, examples / name, out / name, _told(progress, name))
    notes = [f"Not run: {name}; the recordings' folder does not hold it." for name in absent]
    notes.append("Published figures are quoted and were not run here; sources are in examples/recordings.")
    notes += [COMPARATORS] if "silverbox" in found else []
    comparison = Comparison(out, rows, found, absent, tuple(notes))
    _write(comparison)
    return comparison


def _told(progress: Callable[[str], None], name: str) -> Callable[[str], None]:
    return lambda text: progress(f"{name}: {text}")


def _write(c: Comparison) -> None:
    c.out.mkdir(parents=True, exist_ok=True)
    (c.out / "real.json").write_text(json.dumps(c.as_dict(), indent=1) + "\n", encoding="utf-8")
    (c.out / "real.md").write_text(markdown(c), encoding="utf-8")


def markdown(c: Comparison) -> str:
    """The table with its notes and figures, as Markdown."""
    lines = [
        "# Real recordings by others",
        "",
        f"`labnnum prove real`, version {__version__}.",
        "",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
        *("| " + " | ".join((r.recording, r.measure, r.found, r.published, r.asked)) + " |" for r in c.rows),
        "",
        *(f"- {note}" for note in c.notes),
    ]
    for file in c.files:
        if file.endswith(".svg"):
            lines += ["", f"![{Path(file).stem}]({file})"]
    return "\n".join(lines) + "\n"
