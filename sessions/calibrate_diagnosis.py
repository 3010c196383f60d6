"""Thresholds of the diagnosis from repeats of a sound structure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from labnnum.diagnosis import Diagnosis, Limits, Scatter
from labnnum.errors import EstimationError
from sessions.diagnose import run
from sessions.limits import write_limits
from sessions.model import read_model

MARGIN = 1.25
"""The alarm stands so much above the largest gain that a sound repeat gave."""
ENOUGH = 5
"""Repeats from which the bench's own figures may be lower than the shipped ones."""


@dataclass(frozen=True)
class Calibrated:
    """Thresholds, where they are stored, and the gains they come from."""

    scatter: Scatter
    limits: Limits
    gains: tuple[float, ...]
    path: Path


def calibrate(
    repeats: Sequence[str | Path],
    model: str | Path,
    rig: str | Path,
    channels: str | Path | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Calibrated:
    """Diagnose each repeat with the shipped thresholds, and store what its soundness implies beside the rig.

    Raises
    ------
    EstimationError
        With fewer than two repeats.
    """
    if len(repeats) < 2:
        raise EstimationError(f"{len(repeats)} repeat cannot show a scatter: give two or more, remounted in between")
    read = read_model(model)
    found = []
    for i, path in enumerate(repeats):
        progress(f"repeat {i + 1} of {len(repeats)}")
        found.append(run([path], read, (), channels))
    gains = tuple(gain_of(d) for d in found)
    shifts = np.concatenate([d.detail["base_bayes"].point.shift for d in found])
    spread = float(np.sqrt(np.mean(shifts**2)))
    shipped_scatter, shipped = Scatter(), Limits()
    alarm = MARGIN * max(gains)
    frequency = max(spread, 2e-4)
    if len(repeats) < ENOUGH:
        alarm, frequency = max(alarm, shipped.alarm), max(frequency, shipped_scatter.frequency)
    scatter = replace(shipped_scatter, frequency=frequency)
    limits = replace(shipped, alarm=max(alarm, 10.0), further=max(shipped.further, alarm))
    path = write_limits(rig, scatter, limits, f"from {len(repeats)} repeats of a sound structure")
    return Calibrated(scatter, limits, gains, path)


def gain_of(d: Diagnosis) -> float:
    """How much the best mechanism gained over the structure alone, in chi-square."""
    selection = d.detail["selection"]
    best = min((c.cost for stage in selection.stages[:1] for c in stage), default=selection.chain[0].cost)
    return float(max(selection.chain[0].cost - best, 0.0))
