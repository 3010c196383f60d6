"""Which lines of a run are compared with a model, and how far they may be off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from labnnum.diagnosis.nonlinear.run import Run

LINES = 160
"""Lines of a run on which laws are sought, of hits; see `choose_lines` for others."""
NEAR = 9
"""Lines over which the size of a response to noise or to a hit is averaged."""

PERIODIC, OPEN = 3, 6
"""Times as many lines as of hits are compared of periodic runs, and of noise and sweeps: each of their thousands holds
little, and of the latter none shows distortion alone. A march costs as much however many lines it is compared on."""

ROUGH = 0.01
"""What the base is known to miss, from which on no more lines are taken: it misses that alike at neighbouring lines."""

DISTORTION = 6.0
"""Relative error of the distortion around a line, in units of the floor that the scatter gives to a response."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Which lines of a run enter the objective, and the standard deviation there (n_out, n)."""

    at: NDArray[np.int64]
    sigma: NDArray[np.float64]
    windowed: bool = False

    @property
    def need(self) -> NDArray[np.int64]:
        """Lines that must be known: their neighbours too where they are seen through a Hann window."""
        return np.concatenate([self.at - 1, self.at, self.at + 1]) if self.windowed else self.at

    def seen(self, values: NDArray) -> NDArray:
        """Values (..., need) as they are compared, (..., n), over sigma."""
        if self.windowed:
            low, mid, high = np.split(values, 3, axis=-1)
            values = 0.5 * mid - 0.25 * (low + high)
        return values / self.sigma


def choose_lines(run: Run, most: int = 0, floor: float = 0.003) -> Lines:
    """Lines between the first and the last that is excited, `most` of them (0: all), with their deviation.

    `PERIODIC` times as many of periodic runs, `OPEN` times as many of noise and sweeps, unless the base is known to
    miss more than noise (`ROUGH`). Half of them are lines that show distortion alone, or a difference between levels,
    where few of all do.
    """
    inside = np.flatnonzero(run.compared)
    size = np.abs(run.seen(run.y))
    if not run.lasting:
        size = np.sqrt(uniform_filter1d(size**2, NEAR, axis=1, mode="nearest"))
        inside = inside[(inside > 0) & (inside < size.shape[1] - 1)]
    quiet = run.quiet
    local = np.zeros(size.shape)
    if quiet.any():
        at = np.flatnonzero(quiet)
        smooth = uniform_filter1d(size[:, at] ** 2, min(15, at.size), axis=1, mode="nearest")
        grid = np.arange(size.shape[1])
        local = np.array([np.interp(grid, at, row) for row in smooth])
    noise = run.noise
    if not np.isfinite(noise).all():
        noise = np.full(size.shape, 0.0) + (1e-3 * np.sqrt(np.mean(size[:, inside] ** 2, axis=1, keepdims=True))) ** 2
    row = np.sqrt(np.mean(size[:, inside] ** 2, axis=1, keepdims=True))
    sigma = np.sqrt(noise + (floor * size) ** 2 + (DISTORTION * floor) ** 2 * local + (0.02 * floor * row) ** 2)
    sigma = np.hypot(sigma, run.miss * row)
    if run.miss < ROUGH:
        most *= OPEN if run.open else PERIODIC if run.lasting else 1
    if most and inside.size > most:
        rng = np.random.default_rng(inside.size)
        on, off = inside[run.excited[inside]], inside[~run.excited[inside]]
        if run.telling is not None:
            on, off = inside[~run.telling[inside]], inside[run.telling[inside]]
        n_on = min(on.size, max(most // 2, most - off.size))
        pick = [np.sort(rng.choice(a, min(n, a.size), replace=False)) for a, n in ((on, n_on), (off, most - n_on))]
        inside = np.sort(np.concatenate(pick)).astype(int, copy=False)
    return Lines(inside, sigma[:, inside], run.open)
