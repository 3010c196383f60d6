"""Files of other programs into a session: all of them or, if one cannot be used, none."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from drivers.block import Block
from labnnum.errors import StoreError
from labnnum.frf import Frf
from sessions.exchange import channels_of, read_files
from sessions.exchange.imported import ImportedRun
from sessions.journal import journal_path
from sessions.screen import screened
from sessions.store import Session, create_session, publish, require_new
from sessions.toml import read_toml

BLOCK = 65536
"""Samples that are handed to the store at a time."""


def import_files(
    paths: Sequence[Path],
    output: Path,
    channels: Path | None = None,
    model: Path | None = None,
    rig: Path | None = None,
    keep_bad: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[str]:
    """A new session of the recordings, or the FRF, that files hold; notes on what was left unused.

    Parameters
    ----------
    paths : sequence of Path
        Each becomes a run, or several; FRF files become one FRF together.
    output : Path
        Must not exist.
    channels : Path, optional
        channels.toml; looked for beside the files if None.
    model, rig : Path, optional
        model.toml and rig.toml to keep in the session.
    keep_bad : bool
        Store channels that are not finite, constant or clipped too, marked as such.
    progress : callable
        Told how many samples are stored, and of how many.

    Raises
    ------
    InputError
        If anything cannot be used; `output` is then not created.
    """
    require_new(output)
    found = read_files(paths, channels)
    runs = [] if isinstance(found, Frf) else screened(found, keep_bad)
    rig_text, model_text = ("" if path is None else read_toml(path) for path in (rig, model))
    told, notes = channels_of(paths[0], channels)
    part = output.with_name(f".{output.stem}.importing-{os.getpid()}{output.suffix}")
    try:
        with create_session(part, rig_text, model_text) as session:
            if isinstance(found, Frf):
                session.add_frf(found, {"files": _sources(paths), "channels_toml": told}, name=paths[0].name)
            _store(session, runs, paths, told, progress)
        publish(part, output)
    except StoreError as error:
        why = str(error).removeprefix(f"{part}: ").removeprefix(f"{part.name}: ").partition(";")[0]
        raise StoreError(f"{output}: nothing was imported: {why}") from error
    finally:
        for left in (part, journal_path(part)):
            left.unlink(missing_ok=True)
    return notes


def _store(
    session: Session,
    runs: Sequence[ImportedRun],
    paths: Sequence[Path],
    channels_toml: str,
    progress: Callable[[int, int], None],
) -> None:
    total = sum(run.raw.shape[1] for run in runs)
    done = 0
    sources = _sources(paths)
    for imported in runs:
        single = imported.raw.dtype.itemsize <= 4 and np.array_equal(imported.raw.astype("f4"), imported.raw)
        told = {"breaks": imported.breaks, "excluded": imported.excluded, "overloads": imported.overloads}
        run = session.start_run(
            imported.channels, imported.rate, level=imported.level, period=imported.period,
            drop_periods=imported.drop_periods, label=imported.label, dtype="f4" if single else "f8",
            info={"imported": told, "files": sources, "channels_toml": channels_toml},
        )  # fmt: skip
        for start in range(0, imported.raw.shape[1], BLOCK):
            block = imported.raw[:, start : start + BLOCK].astype(float)
            run.append(Block(block, start, math.nan))
            done += block.shape[1]
            progress(done, total)
        run.finish("imported")


def _sources(paths: Sequence[Path]) -> dict[str, str]:
    """File name -> SHA-256 of its bytes."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
