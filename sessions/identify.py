"""A base model from recordings: modal identification of files, written as a model of kind modal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from labnnum.diagnosis.observe import Observation
from labnnum.errors import FileError
from labnnum.frf import Frf
from labnnum.identification import Identified, identify
from sessions.diagnose import observations_of
from sessions.toml_write import dumps


def lowest(recordings: Sequence[str | Path], channels: str | Path | None, only: str = "") -> Observation:
    """The observation at the lowest level, of those whose label contains `only`."""
    every = [o for o in observations_of(recordings, channels) if only in o.label]
    if not every:
        raise FileError(f"no recording's label contains {only!r}")
    return min(every, key=lambda o: o.level if np.isfinite(o.level) else 0.0)


def identify_files(
    recordings: Sequence[str | Path], out: str | Path, channels: str | Path | None = None, low: float | None = None,
    high: float | None = None, order: int = 40, modes: int | None = None, only: str = "",
) -> dict[str, Any]:  # fmt: skip
    """Identify the recording of the lowest level, write the model to `out`, and say what was found.

    Parameters
    ----------
    low, high : float, optional
        Band in Hz; the whole measured one by default.
    order : int
        Highest order of the stabilisation diagram.
    modes : int, optional
        How many modes to keep.
    only : str
        Part of the label of the recordings to look at.
    """
    o = lowest(recordings, channels, only)
    f = o.frf.frequency
    band = (float(f[0] if low is None else low), float(f[-1] if high is None else high))
    frf = _cut(o.frf, band)
    found = identify(frf, order, modes)
    path = Path(out)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(dumps(tables_of(found, frf, band)), encoding="utf-8")
    return {
        "model": str(path),
        "recording": o.label,
        "level": float(o.level),
        "modes": [
            {"frequency": float(f), "damping_ratio": float(z)}
            for f, z in zip(found.frequency, found.damping_ratio, strict=True)
        ],
        "error": found.error,
        "beyond_noise": found.structure.error,
        "nodal_at_drive": found.nodal.tolist(),
        "clipped": sorted(o.clipped),
        "stable_poles": int(found.stabilisation.stable.sum()),
    }


def _cut(frf: Frf, band: tuple[float, float]) -> Frf:
    cut = frf.lines(*band)
    if cut.frequency.size < 16:
        raise FileError(f"only {cut.frequency.size} lines lie between {band[0]:g} and {band[1]:g} Hz; 16 are needed")
    return cut


def tables_of(found: Identified, frf: Frf, band: tuple[float, float]) -> dict[str, Any]:
    """Tables of model.toml of what was identified from an FRF in a band in Hz."""
    nodes = list(dict.fromkeys(c.node for c in frf.outputs))
    modes = [
        {
            "frequency": float(f"{m.frequency:.9g}"),
            "damping_ratio": float(f"{m.damping_ratio:.9g}"),
            "shape": {d: float(f"{float(v):.9g}") for d, v in m.shape.items()},
        }
        for m in found.structure.modes
    ]
    return {
        "structure": {"kind": "modal", "error": float(f"{found.structure.error:.3g}"), "mode": modes},
        "band": [{"low": band[0], "high": band[1]}],
        "places": {"nodes": nodes, "elements": [list(p) for p in combinations(nodes, 2)], "supports": []},
    }
