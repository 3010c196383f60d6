"""A channel that lies beside a nonlinear law: found by leaving out one response after the other.

A faulty channel misleads the base model, the recovered forces and every law at once. Without that channel a law
explains what the others say, and the linear search sees what is wrong with it afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, of_fit
from labnnum.diagnosis.nonlinear.explore import LINES, LONG, Prospect
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.observe import Observation

POOR = 3.0
"""Chi-square per value that the best laws leave, simulated, above which a channel is suspected."""
TELLING = 0.5
"""Part of that to which the others must bring it down without the channel, counted on the others alone."""
AS_WELL = 1.5
"""Chi-square per value with the channel, of that without it, up to which the channel is believed after all."""
FEW = 80
"""Lines of a run on which channels are suspected."""
DEAF = 100.0
"""Standard deviation that a channel which is left out is given, in units of its response."""


def without(o: Observation, output: int) -> Observation:
    """The observation with nothing to be believed of one response."""
    assert o.run is not None
    assert o.frf.variance is not None
    variance = o.frf.variance.copy()
    variance[output] = (DEAF * np.max(np.abs(o.frf.value[output]))) ** 2
    run = deaf(o.run, output)
    return replace(o, run=run, frf=replace(o.frf, variance=variance))


def deaf(run: Run, output: int) -> Run:
    """The run with nothing to be believed of one response."""
    noise = np.where(np.isfinite(run.noise), run.noise, 0.0)
    noise[output] = (DEAF * np.max(np.abs(run.y[output]))) ** 2
    return replace(run, noise=noise)


def heard(run: Run) -> NDArray[np.bool_]:
    """Which responses (n_out,) of a run are to be believed."""
    top = np.max(np.abs(run.y), axis=1) ** 2
    return ~(np.min(np.where(np.isfinite(run.noise), run.noise, 0.0), axis=1) > top)


def suspect(
    train: Sequence[Observation], first: Prospect | None, explore: Callable[[Sequence[Observation]], Prospect | None]
) -> tuple[int, Prospect] | None:
    """The response without which a law explains the others, and what is promised there; None if none stands out.

    Parameters
    ----------
    train : sequence of Observation
        Periodic runs with their spectra.
    first : Prospect or None
        What all channels together promise.
    explore : callable
        The same search on other observations.
    """
    assert train[0].run is not None
    n_out = train[0].run.y.shape[0]
    level = np.inf if first is None else first.level
    if n_out < 3 or level < POOR:
        return None
    best: tuple[float, int, Prospect] | None = None
    for i in range(n_out):
        made = explore([without(o, i) for o in train])
        if made is None:
            continue
        left = made.level * n_out / (n_out - 1)
        if best is None or left < best[0]:
            best = left, i, made
    return None if best is None or best[0] > TELLING * level else best[1:]


def back(whole: Prospect, found: Prospect, most: int = 3) -> Prospect | None:
    """What was found without a channel followed with it, if it explains that channel as well; else None."""
    near = _again(whole.bench, found, most)
    alone = _again(found.bench, found, 1)
    n_out = whole.bench.runs[0].y.shape[0]
    level = (alone[0].made.data_part / alone[0].made.count if alone else found.level) * n_out / (n_out - 1)
    if not near or near[0].made.data_part > max(POOR, AS_WELL * level) * near[0].made.count:
        return None
    return replace(whole, near=tuple(near), recovered=found.recovered, seen=None)


def finer(found: Prospect, most: int = 6) -> Prospect:
    """The same on as many lines as others have."""
    bench = found.bench.on(LINES)
    near = _again(bench, found, most)
    return replace(found, bench=bench, near=tuple(near), seen=None) if near else found


def _again(bench: Bench, found: Prospect, most: int) -> list[Tried]:
    """What came nearest followed on another bench; what does not follow there is left out."""
    near = [bench.follow(t.made.x[: t.made.n_base], of_fit(t), LONG) for t in found.near[:most]]
    return sorted((t for t in near if t is not None), key=lambda t: t.cost)
