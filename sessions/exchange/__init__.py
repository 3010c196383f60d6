"""Files of other programs, and sessions: whatever holds a measurement, by one door.

    read_any("hits.npz", channels="channels.toml")     # list of Recording, or an Frf
    load_recordings(["session.h5"])                    # list of Recording
    load_frf("frf.uff")                                # Frf

One format a module; `FORMATS` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from labnnum.errors import ConfigError, FileError
from labnnum.frf import Frf
from labnnum.recording import Recording
from sessions import HDF5_SUFFIXES
from sessions.channels import ChannelMap, parse_channels, read_channels
from sessions.exchange import mat, npz, text, uff, uff_meaning, wav
from sessions.exchange.arrays import Arrays
from sessions.exchange.imported import ImportedRun, to_frf, to_runs
from sessions.toml import read_toml

__all__ = ["FORMATS", "channels_of", "format_of", "load_frf", "load_recordings", "read_any", "read_files"]


@dataclass(frozen=True)
class Format:
    """A file format: how its files end, and how they are read."""

    name: str
    suffixes: tuple[str, ...]
    read: Callable[[Path], Arrays]


FORMATS: tuple[Format, ...] = (
    Format("NumPy", (".npz", ".npy"), npz.read),
    Format("text", (".csv", ".txt", ".tsv", ".dat", ".asc"), text.read),
    Format("JSON", (".json",), text.read_json),
    Format("MATLAB", (".mat",), mat.read),
    Format("WAV", (".wav",), wav.read),
    Format("universal file", (".uff", ".unv", ".uf"), uff_meaning.read),
)
"""Importable formats; sessions (.h5) are the program's own."""

SESSION_SUFFIXES = HDF5_SUFFIXES


def read_any(path: str | Path, channels: str | Path | ChannelMap | None = None) -> list[Recording] | Frf:
    """The recordings or the FRF of a session or of a file of another program.

    Parameters
    ----------
    path : path
        Told apart by its ending; `FORMATS` lists them. Of a session's plan only what was accepted and complete.
    channels : path or ChannelMap, optional
        channels.toml. If None: `<name>.channels.toml` beside the file, what the file itself carries (NPZ, MAT and
        CSV that labnnum exported, universal files), or channels.toml beside the file, in this order.

    Raises
    ------
    FileError
        If the file is missing, truncated, or of no known format; or no run of a session may be used.
    ConfigError, ChannelError, UnitError
        If channels.toml does not fit it.
    """
    path = Path(path)
    if path.suffix.lower() in SESSION_SUFFIXES:
        return _read_session(path)
    found = read_files([path], channels)
    return found if isinstance(found, Frf) else [run.recording() for run in found]


def load_recordings(
    paths: Sequence[str | Path] | str | Path, channels: str | Path | ChannelMap | None = None
) -> list[Recording]:
    """Recordings of several sessions or files, finite and with no dead channel.

    Raises
    ------
    ChannelError
        If a channel holds NaN or is constant: it is named.
    FileError
        If a file holds FRFs instead.
    """
    out: list[Recording] = []
    for path in [paths] if isinstance(paths, (str, Path)) else paths:
        found = read_any(path, channels)
        if isinstance(found, Frf):
            raise FileError(f"{path}: holds FRFs and no time recordings; give the recordings that they came from")
        out += [recording.require_finite() for recording in found]
    return out


def load_frf(path: str | Path, channels: str | Path | ChannelMap | None = None) -> Frf:
    """The FRF of a file, or the last one stored in a session.

    Raises
    ------
    FileError
        If there are time recordings only.
    """
    path = Path(path)
    if path.suffix.lower() in SESSION_SUFFIXES:
        from sessions.store import open_session

        with open_session(path) as session:
            found = session.frfs()
        if found:
            return found[-1]
        raise FileError(f"{path}: holds no FRF yet; estimate one with 'labnnum frf {path}'")
    found = read_any(path, channels)
    if isinstance(found, Frf):
        return found
    raise FileError(f"{path}: holds time recordings; import it and estimate an FRF with 'labnnum frf'")


def read_files(paths: Sequence[str | Path], channels: str | Path | ChannelMap | None = None) -> list[ImportedRun] | Frf:
    """What files of other programs hold together: runs with their raw samples, or one FRF."""
    files = [Path(p) for p in paths]
    if not files:
        raise FileError("no file is given")
    known = None if channels is None else _as_map(channels)
    if known is None and all(format_of(f).name == "universal file" for f in files) and not _beside(files[0], own=True):
        return _read_universal(files)
    arrays = [format_of(f).read(f) for f in files]
    maps = [known or _map_of(a) for a in arrays]
    if maps[0].frf is not None:
        return to_frf(arrays, maps[0])
    return [run for a, m in zip(arrays, maps, strict=True) for run in to_runs(a, m)]


def channels_of(path: Path, channels: Path | None = None) -> tuple[str, list[str]]:
    """Text of the channels.toml that a file is read with ("" if none), and notes on keys that mean nothing in it."""
    found = channels or _beside(path, own=True)
    if found is None:
        file = format_of(path).read(path)
        if file.channels or format_of(path).name == "universal file":
            return file.channels, []
        found = _beside(path)
    if found is None:
        return "", []
    unused = read_channels(found).unused()
    return read_toml(Path(found)), [f"{found}: {key} means nothing here and is not used" for key in unused]


def format_of(path: Path) -> Format:
    """The format that a file's ending tells; FileError if it is none of `FORMATS`, or a folder."""
    if path.is_dir():
        raise FileError(f"{path}: is a folder; name the files in it")
    for one in FORMATS:
        if path.suffix.lower() in one.suffixes:
            return one
    if path.suffix.lower() in SESSION_SUFFIXES:
        raise FileError(f"{path}: is a session already; nothing needs to be imported")
    known = ", ".join(s for f in FORMATS for s in f.suffixes)
    raise FileError(f"{path}: its format is not known by its ending {path.suffix!r}; known are {known}")


def _as_map(channels: str | Path | ChannelMap) -> ChannelMap:
    return channels if isinstance(channels, ChannelMap) else read_channels(channels)


def _beside(path: Path, own: bool = False) -> Path | None:
    """The channels.toml beside a file: its own, or the folder's."""
    candidates = [path.with_name(f"{path.stem}.channels.toml")]
    if not own:
        candidates.append(path.with_name("channels.toml"))
    return next((c for c in candidates if c.is_file()), None)


def _map_of(file: Arrays) -> ChannelMap:
    own = _beside(file.path, own=True)
    if own is None and file.channels:
        return parse_channels(file.channels, f"{file.path} (what it says itself)")
    found = own or _beside(file.path)
    if found is None:
        raise ConfigError(
            f"{file.path}: what are its channels? There is no channels.toml beside it: write one, or name it with"
            " --channels"
        )
    return read_channels(found)


def _read_universal(files: Sequence[Path]) -> list[ImportedRun] | Frf:
    runs: list[ImportedRun] = []
    for path in files:
        functions = uff.read_functions(path)
        kinds = {f.kind for f in functions}
        if uff.FRF in kinds and uff.TIME not in kinds:
            if len(files) > 1:
                raise FileError(f"{path}: holds FRFs; import one file of FRFs at a time")
            return uff_meaning.to_frf(path, functions)
        if uff.TIME not in kinds:
            raise FileError(f"{path}: {_holds(path, functions)}; it has no time recording and no FRF")
        runs += uff_meaning.to_recordings(path, functions)
    return runs


def _holds(path: Path, functions: Sequence[uff.Function]) -> str:
    if not functions:
        return f"holds datasets {', '.join(str(k) for k in sorted(set(uff.dataset_kinds(path))))}"
    shown = [f"the {uff.KINDS.get(f.kind, f'function of kind {f.kind}')} {f.title!r} in {f.unit}" for f in functions]
    return f"holds {', '.join(shown[:3])}"


def _read_session(path: Path) -> list[Recording] | Frf:
    from sessions.store import open_session

    with open_session(path) as session:
        recordings, left_out = session.recordings(), session.left_out()
        frfs = [] if recordings else session.frfs()
    if recordings:
        return recordings
    if left_out:
        raise FileError(f"{path}: no run of it can be used: {'; '.join(f'run {n} {w}' for n, w in left_out.items())}")
    if frfs:
        return frfs[-1]
    raise FileError(f"{path}: this session holds no samples yet")
