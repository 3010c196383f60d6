"""A base model from recordings: modal identification of files, written as a model of kind modal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from labnnum.diagnosis.observe import Observation
from labnnum.errors import EstimationError, FileError
from labnnum.frf import Frf
from labnnum.identification import Identified, identify, reciprocal
from labnnum.identification_residues import PoleResidues, fit_residues
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
    report: bool = False,
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
    report : bool
        Whether to write a page beside the model, of its name with .html.

    Raises
    ------
    FileError
        If a file cannot be read, holds too few lines in the band, or the page would write over something else.
    EstimationError
        If nothing can be identified in the FRFs.
    """
    path = Path(out)
    page = path.with_suffix(".html") if report else None
    if page is not None:
        from sessions.report.page import require_page

        require_page(page)
    o = lowest(recordings, channels, only)
    f = o.frf.frequency
    band = (float(f[0] if low is None else low), float(f[-1] if high is None else high))
    frf = _cut(o.frf, band)
    if len(frf.outputs) == 1 and len(frf.inputs) > 1:  # a roving hammer
        frf = reciprocal(frf)
    found = identify(frf, order, modes)
    free = _free(frf, found)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(dumps(tables_of(found, frf, band)), encoding="utf-8")
    if page is not None:
        from sessions.report.identify import IdentifiedPage, write_identified

        clips, nodal = sorted(o.clipped), found.nodal.tolist()
        write_identified(
            page, IdentifiedPage(path.stem, o.label, frf, found, free, order, remarks(o.label, clips, nodal))
        )
    return {
        "model": str(path),
        "report": None if page is None else str(page),
        "recording": o.label,
        "level": float(o.level),
        "modes": [
            {"frequency": float(f), "damping_ratio": float(z)}
            for f, z in zip(found.frequency, found.damping_ratio, strict=True)
        ],
        "poles": [] if free is None else poles_of(free),
        "error": found.error,
        "error_complex": None if free is None else free.error,
        "beyond_noise": found.structure.error,
        "nodal_at_drive": found.nodal.tolist(),
        "clipped": sorted(o.clipped),
        "stable_poles": int(found.stabilisation.stable.sum()),
    }


def _free(frf: Frf, found: Identified) -> PoleResidues | None:
    """The same modes with complex residues and residual terms; None where the lines are too few for them."""
    try:
        return fit_residues(frf, np.column_stack([found.frequency, found.damping_ratio]))
    except EstimationError:
        return None


def poles_of(free: PoleResidues) -> list[dict[str, float]]:
    """Frequency in Hz and damping ratio of each pole with their standard deviations, for --json."""
    names = ("frequency", "frequency_std", "damping_ratio", "damping_ratio_std", "collinearity")
    columns = (free.frequency, free.frequency_std, free.damping_ratio, free.damping_std, free.collinearity)
    return [dict(zip(names, map(float, row), strict=True)) for row in zip(*columns, strict=True)]


def remarks(label: str, clipped: Sequence[str], nodal: Sequence[float]) -> list[str]:
    """What a user of the model must know, one line each."""
    out = [f"{label}: {', '.join(clipped)} clips; modes from it are not to be trusted"] if clipped else []
    return out + [
        f"the mode at {f:.4g} Hz hardly moves the driven place: the size of its shape elsewhere is uncertain"
        for f in nodal
    ]


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
