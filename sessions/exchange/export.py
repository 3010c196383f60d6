"""Recordings and FRFs into files that other programs read; what comes back is what went out."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError, StoreError
from labnnum.frf import Frf
from labnnum.recording import Recording
from sessions.exchange import mat, npz, text, uff_write, wav
from sessions.exchange.describe import frf_toml, recording_toml

SUFFIXES = (".uff", ".unv", ".npz", ".csv", ".mat", ".wav")
"""Formats that can be written."""


def export_recordings(path: str | Path, recordings: Sequence[Recording], ascii_: bool = False) -> list[Path]:
    """Write recordings, in SI units; the files written.

    Universal files hold all of them; in other formats each has its own file, `name_run01.npz` and so on, if there
    are several. NPZ, CSV and MAT carry their channels.toml; beside a WAV file it is written as
    `name.channels.toml`.

    Raises
    ------
    FileError
        If a file exists already, the format cannot hold the recording, or its ending is not known.
    """
    path = _known(Path(path))
    if not recordings:
        raise FileError(f"{path}: there is no recording to export")
    if path.suffix.lower() in (".uff", ".unv"):
        return _published([path], lambda temp: uff_write.write_recordings(temp, list(recordings), not ascii_))
    if len(recordings) == 1:
        return _one(path, recordings[0])
    paths = [path.with_name(f"{path.stem}_run{i:02d}{path.suffix}") for i in range(1, len(recordings) + 1)]
    _require_new([p for one in paths for p in _files_of(one)])
    return [p for one, recording in zip(paths, recordings, strict=True) for p in _one(one, recording)]


def export_frf(path: str | Path, frf: Frf, ascii_: bool = False) -> Path:
    """Write an FRF, its coherence and its variance; the file written.

    Raises
    ------
    FileError
        If the file exists already, or the format cannot hold an FRF.
    """
    path = _known(Path(path))
    suffix = path.suffix.lower()
    if suffix == ".wav":
        raise FileError(f"{path}: a WAV file cannot hold an FRF; export to {', '.join(SUFFIXES[:-1])}")
    if suffix in (".uff", ".unv"):
        return _published([path], lambda temp: uff_write.write_frf(temp, frf, not ascii_))[0]
    if suffix == ".csv":
        columns, rows = _columns(frf)
        return _published([path], lambda temp: text.write(temp, columns, frf_toml(frf, rows)))[0]
    arrays: dict[str, NDArray] = {"f": frf.frequency, "H": frf.value}
    arrays |= {k: getattr(frf, k) for k in ("coherence", "variance") if getattr(frf, k) is not None}
    write = npz.write if suffix == ".npz" else mat.write
    return _published([path], lambda temp: write(temp, arrays, frf_toml(frf)))[0]


def _known(path: Path) -> Path:
    if path.suffix.lower() not in SUFFIXES:
        raise FileError(f"{path}: cannot export to {path.suffix!r}; choose one of {', '.join(SUFFIXES)}")
    return path


def _files_of(path: Path) -> list[Path]:
    return [path, path.with_name(f"{path.stem}.channels.toml")] if path.suffix.lower() == ".wav" else [path]


def _require_new(paths: Sequence[Path]) -> None:
    for path in paths:
        if path.exists():
            raise FileError(f"{path}: exists already and is not written over; choose another name")
        if not path.parent.is_dir():
            raise FileError(f"{path}: there is no folder {path.parent}")


def _published(paths: Sequence[Path], write: Callable[[Path], Any]) -> list[Path]:
    """Write beside the first path and give the finished file its name, so that none is ever half written."""
    _require_new(paths)
    temp = paths[0].with_name(f".{paths[0].stem}.part{paths[0].suffix}")
    temp.unlink(missing_ok=True)
    try:
        write(temp)
        temp.rename(paths[0])
    except OSError as error:
        raise StoreError(f"{paths[0]}: cannot be written ({error.strerror or error})") from error
    finally:
        temp.unlink(missing_ok=True)
    return list(paths)


def _one(path: Path, recording: Recording) -> list[Path]:
    suffix = path.suffix.lower()
    if suffix == ".wav":
        written = _published(_files_of(path)[:1], lambda temp: wav.write(temp, recording.rate, recording.data))
        beside = _files_of(path)[1]
        sources = list(range(len(recording.channels)))
        return written + _published([beside], lambda temp: temp.write_text(recording_toml(recording, sources)))
    names = [c.name for c in recording.channels]
    if suffix == ".mat":
        names = _identifiers(names)
    columns = dict(zip(names, recording.data, strict=True))
    told = recording_toml(recording, names)
    if suffix == ".csv":
        time = {"time": np.arange(recording.n_samples) / recording.rate}
        return _published([path], lambda temp: text.write(temp, {**time, **columns}, told))
    write = npz.write if suffix == ".npz" else mat.write
    return _published([path], lambda temp: write(temp, columns, told))


def _identifiers(names: Sequence[str]) -> list[str]:
    """Names that MATLAB takes for variables."""
    out: list[str] = []
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        plain = (plain if plain[:1].isalpha() else f"x{plain}")[:60]
        while plain in out:
            plain += "_"
        out.append(plain)
    return out


def _columns(frf: Frf) -> tuple[dict[str, NDArray], list[dict[str, Any]]]:
    """Columns of a table of FRFs, and where each pair stands in it."""
    columns: dict[str, NDArray] = {"f": frf.frequency}
    rows: list[dict[str, Any]] = []
    for o, output in enumerate(frf.outputs):
        for i, inp in enumerate(frf.inputs):
            pair = f"{output.name}/{inp.name}"
            row: dict[str, Any] = {"output": output.name, "input": inp.name}
            parts = {"real": frf.value[o, i].real, "imag": frf.value[o, i].imag}
            if frf.variance is not None:
                parts["variance"] = frf.variance[o, i]
            if frf.coherence is not None and i == 0:
                parts["coherence"] = frf.coherence[o]
            for key, column in parts.items():
                row[key] = len(columns)
                columns[f"{key} {pair}"] = column
            rows.append(row)
    return columns, rows
