"""Files that hold a structure's matrices: NPZ, MAT (5 and 7.3) and HDF5, with texts as well as numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError, FileError

REQUIRED = ("M0", "K0", "dofs")


def read_matrix_file(path: Path) -> dict[str, NDArray]:
    """Arrays by name; dofs, nodes and elements as strings, the others as numbers.

    Raises
    ------
    FileError
        If the file is missing, damaged, or of no known kind.
    ConfigError
        If M0, K0 or dofs are missing.
    """
    if not path.is_file():
        raise FileError(f"{path}: no such file (key file of [structure], relative to the model file)")
    readers = {".npz": _npz, ".mat": _mat, ".h5": _hdf5, ".hdf5": _hdf5}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise FileError(f"{path}: expected a file of matrices: {', '.join(readers)}")
    try:
        content = reader(path)
    except Exception as error:  # each library raises what a damaged byte leads it to
        raise FileError(f"{path}: is truncated or no {path.suffix[1:]} file ({type(error).__name__})") from error
    for name in REQUIRED:
        if name not in content:
            raise ConfigError(f"{path}: {name} is missing; the file needs {', '.join(REQUIRED)}")
    return {
        k: _as_texts(v) if k in ("dofs", "nodes", "elements") else _as_numbers(path, k, v) for k, v in content.items()
    }


def write_matrix_file(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """An NPZ file that `read_matrix_file` reads back to the last bit."""
    with path.open("wb") as file:
        np.savez(file, **dict[str, Any](arrays))


def _npz(path: Path) -> dict[str, Any]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as loaded:
        return {key: loaded[key] for key in loaded.files}


def _mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    with path.open("rb") as file:
        head = file.read(520)
    if b"MATLAB 7.3" in head or head[512:520] == b"\x89HDF\r\n\x1a\n":
        return _hdf5(path, matlab=True)
    loaded = loadmat(path, simplify_cells=True, chars_as_strings=True)
    return {k: v for k, v in loaded.items() if not k.startswith("__")}


def _hdf5(path: Path, matlab: bool = False) -> dict[str, Any]:
    import h5py

    with h5py.File(path, "r") as file:
        datasets = {k: v for k, v in file.items() if isinstance(v, h5py.Dataset)}
        return {k: _matlab(file, v) if matlab else v[()] for k, v in datasets.items()}


def _matlab(file: Any, item: Any) -> Any:
    """A variable of MATLAB 7.3: axes reversed; cells of text through their references."""
    kind = item.attrs.get("MATLAB_class", b"")
    if kind == b"cell":
        return np.array([_characters(file[r][()]) for r in item[()].reshape(-1)])
    value = item[()]
    if kind == b"char":
        return np.array([_characters(row) for row in np.atleast_2d(value.T)])
    return np.asarray(value).T


def _characters(codes: Any) -> str:
    return "".join(chr(int(c)) for c in np.asarray(codes).reshape(-1))


def _as_texts(value: Any) -> NDArray:
    """Strings without padding; bytes decoded, numbers as their digits."""
    array = np.asarray(value)
    flat = [v.decode() if isinstance(v, bytes) else str(int(v)) if _is_whole(v) else str(v) for v in array.reshape(-1)]
    return np.array([t.strip() for t in flat], dtype=str).reshape(array.shape)


def _is_whole(v: Any) -> bool:
    return isinstance(v, (int, float, np.number)) and float(v) == int(v)


def _as_numbers(path: Path, name: str, value: Any) -> NDArray:
    dense = value.toarray() if hasattr(value, "toarray") else value
    array = np.asarray(dense)
    if name[:2] in ("M0", "K0", "C0", "dM", "dK", "dC") or name == "xyz":
        if array.dtype.kind not in "fiub":
            raise ConfigError(f"{path}: {name} holds no real numbers")
        return np.atleast_2d(array.astype(float))
    return array
