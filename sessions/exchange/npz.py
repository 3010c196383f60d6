"""NumPy files: NPZ (one array a channel, or `data`) and NPY. No pickles."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError
from sessions.exchange.arrays import Arrays
from sessions.exchange.describe import CHANNELS_KEY


def read(path: Path) -> Arrays:
    """Arrays of an NPZ or NPY file; FileError if it is none, truncated, or holds objects."""
    try:
        with path.open("rb") as file:
            if not file.read(6).startswith((b"PK", b"\x93NUMPY")):
                raise FileError(f"{path}: is truncated or no NumPy file; save it again with numpy.savez")
            file.seek(0)
            arrays = _arrays(file)
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except FileError:
        raise
    except (ValueError, OSError, EOFError, KeyError, zipfile.BadZipFile) as error:
        why = "holds Python objects" if "pickle" in str(error).lower() else "is truncated or no NumPy file"
        raise FileError(f"{path}: {why}; save it again with numpy.savez, numbers only") from error
    told = str(arrays.pop(CHANNELS_KEY)) if CHANNELS_KEY in arrays else ""
    return Arrays(path, {k: v for k, v in arrays.items() if v.dtype.kind in "fiubc"}, channels=told)


def _arrays(file: BinaryIO) -> dict[str, NDArray]:
    loaded = np.load(file, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        return {"data": loaded}
    return {key: loaded[key] for key in loaded.files}


def write(path: Path, arrays: Mapping[str, NDArray], channels: str) -> None:
    """An NPZ file of arrays that carries its channels.toml; numbers to the last bit."""
    with path.open("wb") as file:
        np.savez(file, **{**arrays, CHANNELS_KEY: np.array(channels)})  # ty: ignore[invalid-argument-type]
