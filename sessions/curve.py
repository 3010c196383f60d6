"""Curves of nonlinear responses in files and in words, for `labnnum curve`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import FileError
from labnnum.harmonic import Curve

SUFFIXES = (".csv", ".npz")
MISSED = 0.01
"""Relative motion of harmonics that were left out, from which more of them are advised."""


def require_writable(path: Path) -> None:
    """FileError unless a curve can be written at `path`: nothing is there, its folder is, and the suffix is known."""
    if path.exists():
        raise FileError(f"{path}: exists already and is not written over; choose another name")
    if path.suffix.lower() not in SUFFIXES:
        raise FileError(f"{path}: a curve is written as {' or '.join(SUFFIXES)}")
    if not path.parent.is_dir():
        raise FileError(f"{path}: there is no folder {path.parent}")


def write_curve(path: Path, curve: Curve, swept: tuple[NDArray, NDArray] | None = None) -> None:
    """Write the points of a curve, or what a sweep over it found: frequencies (n,) and amplitudes (n, n_out, h + 1).

    Text has a row a point: frequency in Hz, for points of the curve 1 where they are stable and the largest Floquet
    multiplier, then for each output the mean and amplitude and phase (degrees) of each harmonic. NPZ has `frequency`,
    `harmonics` (complex, the mean first), `outputs`, and of a curve `stable`, `multiplier`, `missed`, `work`, `lost`
    (J in a period) and `laws` as well.
    """
    frequency, harmonics = (curve.frequency, curve.harmonics) if swept is None else swept
    if path.suffix.lower() == ".npz":
        more: dict[str, Any] = {}
        if swept is None:
            more = {name: getattr(curve, name) for name in ("stable", "multiplier", "missed", "work", "lost")}
            more["laws"] = np.array(curve.laws, str)
        np.savez(path, frequency=frequency, harmonics=harmonics, outputs=np.array(curve.outputs, str), **more)
        return
    columns, head = [frequency], ["frequency [Hz]"]
    if swept is None:
        columns += [curve.stable.astype(float), curve.multiplier]
        head += ["stable", "multiplier"]
    for i, name in enumerate(curve.outputs):
        unit = "rad" if name.partition(":")[2].startswith("r") else "m"
        columns.append(harmonics[:, i, 0].real)
        head.append(f"{name} mean [{unit}]")
        for n in range(1, harmonics.shape[2]):
            columns += [np.abs(harmonics[:, i, n]), np.degrees(np.angle(harmonics[:, i, n]))]
            head += [f"{name} h{n} [{unit}]", f"{name} h{n} [deg]"]
    np.savetxt(path, np.column_stack(columns), "%.9g", ",", header=",".join(head), comments="", encoding="utf-8")


def describe(curve: Curve) -> dict[str, Any]:
    """What a curve holds, as `--json` prints it."""
    peaks = []
    for i, name in enumerate(curve.outputs):
        size = curve.amplitude(i)
        at = int(np.argmax(size))
        peaks.append(
            {"output": name, "frequency": float(curve.frequency[at]), "amplitude": float(size[at]),
             "stable": bool(curve.stable[at])}
        )  # fmt: skip
    return {
        "points": len(curve.orbits),
        "laws": list(curve.laws),
        "folds": [float(curve.frequency[i]) for i in curve.folds],
        "unstable": [[float(a), float(b)] for a, b in _ranges(curve)],
        "peaks": peaks,
        "missed": float(curve.missed.max()),
    }


def _ranges(curve: Curve) -> list[tuple[float, float]]:
    """Lowest and highest frequency of each stretch of the curve that is not stable."""
    off = np.flatnonzero(~curve.stable)
    runs: Sequence[NDArray] = np.split(off, np.flatnonzero(np.diff(off) > 1) + 1) if off.size else ()
    return [(curve.frequency[r].min(), curve.frequency[r].max()) for r in runs]


def in_words(told: dict[str, Any]) -> str:
    """The same as text."""
    laws = ", ".join(told["laws"]) or "no nonlinear law: the structure is linear"
    lines = [f"{told['points']} points; {laws}"]
    for p in told["peaks"]:
        unit = "rad" if p["output"].partition(":")[2].startswith("r") else "m"
        held = "" if p["stable"] else ", not stable"
        lines.append(f"{p['output']}: largest at {p['frequency']:.5g} Hz, {p['amplitude']:.4g} {unit}{held}")
    if told["folds"]:
        lines.append("folds at " + ", ".join(f"{f:.5g}" for f in told["folds"]) + " Hz")
    if told["unstable"]:
        lines.append("not stable: " + ", ".join(f"{a:.5g} to {b:.5g} Hz" for a, b in told["unstable"]))
    if told["missed"] > MISSED:
        lines.append(
            f"harmonics that were left out would move the laws by {100 * told['missed']:.2g} %: raise --harmonics"
        )
    return "\n".join(lines)
