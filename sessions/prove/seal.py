"""The sealed file: the truth of a whole suite, written before the tool starts, with its SHA-256."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from labnnum.errors import ConfigError, FileError
from sessions.prove.jobs import each
from sessions.prove.suite import Ticket

SCHEMA = 1
NAME = "truth.json"


def text(suite: str, seed: int, tickets: Sequence[Ticket], jobs: int = 1) -> str:
    """The sealed file's text: the same for the same suite, seed and number of cases."""
    known = {ticket.name: truth for ticket, truth in each(Ticket.truth, tickets, jobs)}
    head = {"schema": SCHEMA, "suite": suite, "seed": seed, "cases": [known[t.name] for t in tickets]}
    return json.dumps(_rounded(head), indent=1, sort_keys=True) + "\n"


def _rounded(value: Any) -> Any:
    """The same with numbers to nine digits, so that the last bits of a machine's arithmetic do not break the seal."""
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(v) for v in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value


def seal(folder: Path, suite: str, seed: int, tickets: Sequence[Ticket], jobs: int = 1) -> str:
    """Write the sealed file into `folder` (or find the same one there) and return its SHA-256.

    Raises
    ------
    ConfigError
        If `folder` already holds the truth of another suite.
    """
    content = text(suite, seed, tickets, jobs).encode("utf-8")
    path = folder / NAME
    if path.exists():
        if path.read_bytes() != content:
            raise ConfigError(f"{path} holds another suite: give -o a new folder, or the same suite, seed and cases")
    else:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return digest(path)


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def unseal(folder: Path) -> dict[str, Any]:
    """The sealed truth of a suite; FileError if there is none, or one of a newer form."""
    path = folder / NAME
    if not path.is_file():
        raise FileError(f"{path} does not exist: draw the suite first (labnnum prove ... --draw-only)")
    try:
        out = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise FileError(f"{path} is not JSON: {error}") from None
    if out.get("schema") != SCHEMA:
        raise FileError(f"{path} has schema {out.get('schema')}; this version reads {SCHEMA}")
    return out
