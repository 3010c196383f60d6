"""Where the joint fit begins: the base model fitted to the FRFs of the level that distorts least."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.fit import Fit, fit
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.search import broaden
from labnnum.diagnosis.task import measured
from labnnum.frf import Frf

LADDER = (0.05, 0.015, 0.005)


def distortion(run: Run) -> float:
    """Power on detection lines beyond noise, over that on excited lines, the mean of the channels."""
    quiet, on = run.quiet, run.excited
    if not quiet.any():
        return 0.0
    power = np.mean(np.abs(run.y[:, quiet]) ** 2, axis=1)
    noise = np.mean(run.noise[:, quiet], axis=1) if np.isfinite(run.noise).all() else 0.0 * power
    signal = np.mean(np.abs(run.y[:, on]) ** 2, axis=1)
    return float(np.mean((np.maximum(power - 1.3 * noise, 0.0) + 0.03 * noise) / signal))


def quietest(runs: Sequence[Run]) -> int:
    """Number of the run that distorts least."""
    return int(np.argmin([distortion(r) for r in runs]))


def base_point(engine: Engine, o: Observation, scatter: Scatter, span: tuple[float, float]) -> Point:
    """The engine's point fitted to one run's FRFs, the ordinary errors of a model allowed for."""
    frf: Frf = o.frf.lines(*span)
    if frf.frequency.size > 400:
        frf = frf.at(np.unique(np.linspace(0, frf.frequency.size - 1, 400).round().astype(int)))
    data = measured(frf).with_floor(scatter.floor)
    start = engine.start()
    x = start.vector()
    rungs = [broaden(engine, data, start, (), kappa) for kappa in LADDER]
    best: Fit | None = None
    for first in (0, 1, 3):
        rough = x
        for rung in rungs[first:]:
            rough = fit(engine, rung, (), scatter, rough, steps=8, tolerance=1.0).point.vector()
        one = fit(engine, data, (), scatter, rough, steps=25)
        if best is None or one.objective < best.objective:
            best = one
    assert best is not None
    return best.point
