"""WAV files: integers are parts of full scale (1.0), which `full_scale` of a channel turns into volts."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError
from sessions.exchange.arrays import Arrays


def read(path: Path) -> Arrays:
    """Channels of a WAV file as rows of "data", in parts of full scale, and its rate."""
    from scipy.io import wavfile

    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Chunk .*not understood", wavfile.WavFileWarning)
            warnings.filterwarnings("error", ".*(prematurely|truncated|EOF).*")
            rate, samples = wavfile.read(path)
    except FileNotFoundError:
        raise FileError(f"{path}: no such file") from None
    except (ValueError, OSError, EOFError, struct.error, wavfile.WavFileWarning) as error:
        raise FileError(f"{path}: is truncated or no WAV file ({error})") from error
    rows = np.atleast_2d(samples.T)
    return Arrays(path, {"data": _parts(rows)}, float(rate), parts=True)


def _parts(rows: NDArray) -> NDArray[np.float64]:
    """Integers as parts of full scale; 8 bits are unsigned."""
    if rows.dtype.kind == "f":
        return rows.astype(float)
    if rows.dtype == np.uint8:
        return (rows.astype(float) - 128.0) / 128.0
    return rows.astype(float) / float(2 ** (8 * rows.dtype.itemsize - 1))


def write(path: Path, rate: float, data: NDArray) -> None:
    """A WAV file of 64-bit floats, shape (n_channels, n_samples); FileError unless the rate is whole."""
    from scipy.io import wavfile

    if rate != int(rate):
        raise FileError(f"{path}: WAV files have whole sample rates, not {rate!r} Hz; export to NPZ or UFF instead")
    wavfile.write(path, int(rate), np.ascontiguousarray(data.T))
