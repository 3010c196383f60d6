"""MATLAB files: version 5 and before through SciPy, version 7.3 through HDF5; structs as "struct.field"."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError
from sessions.exchange.arrays import Arrays
from sessions.exchange.describe import CHANNELS_KEY

_LIMIT = 2**31 - 1024


def read(path: Path) -> Arrays:
    """Numeric variables of a MAT file; FileError if it is none or truncated."""
    if not path.is_file():
        raise FileError(f"{path}: no such file")
    with path.open("rb") as file:
        head = file.read(520)
    try:
        content = _read_73(path) if b"MATLAB 7.3" in head or head[512:520] == b"\x89HDF\r\n\x1a\n" else _read_5(path)
    except Exception as error:  # SciPy and h5py raise whatever a damaged byte leads to
        raise FileError(f"{path}: is truncated or no MAT file ({type(error).__name__}: {error})") from error
    told = content.pop(CHANNELS_KEY, "")
    arrays = {k: v for k, v in content.items() if isinstance(v, np.ndarray) and v.dtype.kind in "fiubc"}
    return Arrays(path, arrays, channels=told if isinstance(told, str) else "")


def _read_5(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    with path.open("rb") as file:
        loaded = loadmat(file, simplify_cells=True)
    return dict(_flat({k: v for k, v in loaded.items() if not k.startswith("__")}))


def _flat(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        elif isinstance(value, (int, float, complex, np.number)):
            yield prefix + key, np.asarray(value)
        else:
            yield prefix + key, value


def _read_73(path: Path) -> dict[str, Any]:
    import h5py

    out: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            out[name.replace("/", ".")] = _variable(item)

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return out


def _variable(item: Any) -> Any:
    """A MATLAB variable: axes reversed, complex from its two parts, text from its character codes."""
    kind = item.attrs.get("MATLAB_class", b"")
    if item.attrs.get("MATLAB_empty", 0):
        return "" if kind == b"char" else np.zeros(0)
    value = np.asarray(item[()]).T
    if kind == b"char":
        return "".join(chr(c) for c in value.reshape(-1))
    if value.dtype.names == ("real", "imag"):
        return np.squeeze(value["real"] + 1j * value["imag"])
    return np.squeeze(value)


def write(path: Path, arrays: Mapping[str, NDArray], channels: str) -> None:
    """A MAT file, version 5, that carries its channels.toml; numbers to the last bit."""
    from scipy.io import savemat

    for name, array in arrays.items():
        if array.nbytes > _LIMIT:
            raise FileError(f"{path}: array {name!r} is over the 2 GiB of a MAT file; export to NPZ or UFF instead")
    savemat(path, {**arrays, CHANNELS_KEY: channels}, oned_as="row", long_field_names=True)
