"""Whether the structure is nonlinear: distortion on detection lines beyond noise, and FRFs that change with level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.run import Run

if TYPE_CHECKING:
    from labnnum.diagnosis.observe import Observation

SIGMAS = 6.0
"""How far, in standard deviations, the power on detection lines must stand above the noise."""
EXCESS = 1.6
"""And by what factor at least: shakers distort a little, and periods drift."""


@dataclass(frozen=True, eq=False)
class Signs:
    """Power over noise on odd and even detection lines (n_runs, n_out), and where that is beyond chance."""

    odd: NDArray[np.float64]
    even: NDArray[np.float64]
    odd_sure: NDArray[np.bool_]
    even_sure: NDArray[np.bool_]

    change: NDArray[np.float64]
    """Relative change (n_out,) of the FRFs from the lowest to the highest level, noise taken out; NaN with one."""
    change_sure: NDArray[np.bool_]

    @property
    def present(self) -> bool:
        """Distortion or change with level, in more channels than one where there are several."""
        sure = self.odd_sure | self.even_sure
        need = min(2, sure.shape[1])
        return bool((sure.sum(axis=1) >= need).any() or self.change_sure.sum() >= need)


UNSTEADY, WORSE = 0.1, 10.0
"""Uncertainty of the mean over the periods, of the response, RMS, from which on a run may be in no steady state; and
how many times that of the steadiest run it is.
"""


def repeating(train: Sequence[Observation], test: Sequence[Observation]) -> tuple[list[Observation], list[Observation]]:
    """The runs, to be fitted and held out, without those that do not repeat from period to period: a structure that
    hardens strongly may jump about for ever, and no steady state is like that. All where fewer than two were left.
    """
    apart = {id(o): _apart(o) for o in (*train, *test)}
    least = min(apart.values(), default=0.0)

    def steady(some: Sequence[Observation]) -> list[Observation]:
        return [o for o in some if apart[id(o)] < max(UNSTEADY, WORSE * least)]

    kept = steady(train), steady(test)
    return kept if len(kept[0]) > 1 and (kept[1] or not test) else (list(train), list(test))


RESTLESS, MORE = 0.03, 3.0
"""What neighbouring periods of a response differ by, relative RMS, from which on a run is told not to repeat; and how
many times what the steadiest run differs by, of the response and in the sensors' own units: their noise does not grow
with level.
"""


def restless(observations: Sequence[Observation]) -> dict[int, float]:
    """Number of the observation -> relative RMS difference of its response from period to period, of those that do not
    repeat though others do: they have not settled, or wander between steady states for ever.
    """
    repeated = {i: o.run for i, o in enumerate(observations) if o.run is not None and o.run.lasting}
    repeated = {i: r for i, r in repeated.items() if np.isfinite(r.noise).all()}
    runs = list(repeated.values())
    if len({r.outputs for r in runs}) != 1 or len(runs) < 2:
        return {}
    power = np.array([r.n_periods * np.sum(r.noise[:, r.compared], axis=1) for r in runs])
    share = np.sqrt([np.median(r.n_periods * r.unsure) for r in runs])
    own = np.median(np.sqrt(power / np.maximum(power.min(axis=0), 1e-300)), axis=1)
    moving = (share > max(RESTLESS, MORE * float(share.min()))) & (own > MORE)
    return {i: float(s) for i, s, m in zip(repeated, share, moving, strict=True) if m}


def steadier(observations: Sequence[Observation]) -> list[Observation]:
    """The runs without those that do not repeat, where one at least as loud repeats: it shows as much, and the mean of
    what wanders is no steady state.
    """
    moving = restless(observations)
    still = [o for i, o in enumerate(observations) if i not in moving]
    loudest = max((o.level for o in still), default=0.0)
    return still if all(observations[i].level <= loudest for i in moving) else list(observations)


def _apart(o: Observation) -> float:
    """RMS of what noise leaves in the mean over periods, of the response, the middle one of the channels."""
    if o.run is None or not np.isfinite(o.run.noise).all():
        return 0.0  # not known
    return float(np.sqrt(np.median(o.run.unsure)))


def _white(y: NDArray, block: int = 64) -> NDArray[np.float64]:
    """Power per line of the quietest stretch of each channel's spectrum, (n_out,): what a converter's steps leave
    everywhere, and at every period alike.
    """
    n = y.shape[1] // block * block
    if n < 2 * block:
        return np.zeros(y.shape[0])
    power = np.abs(y[:, :n]) ** 2
    return np.median(power.reshape(y.shape[0], -1, block), axis=2).min(axis=1) / np.log(2)


def signs(runs: Sequence[Run]) -> Signs:
    """Distortion of each run and channel against the noise that its periods show."""
    shape = (len(runs), runs[0].y.shape[0])
    out = {name: np.full(shape, np.nan) for name in ("odd", "even")}
    sure = {name: np.zeros(shape, bool) for name in ("odd", "even")}
    for i, run in enumerate(runs):
        if not np.isfinite(run.noise).all():
            continue
        lines = np.flatnonzero(run.excited)
        grid = np.arange(run.u.size)
        h = run.y[:, lines] / run.u[lines]
        through = np.array([np.interp(grid, lines, r.real) + 1j * np.interp(grid, lines, r.imag) for r in h])
        left = np.abs(run.y - through * run.u) ** 2
        floor = _white(run.y)
        for name, parity in (("odd", 1), ("even", 0)):
            at = run.quiet & (grid % 2 == parity)
            n = np.count_nonzero(at)
            if n < 4:
                continue
            noise = run.noise[:, at].mean(axis=1) + floor
            ratio = left[:, at].mean(axis=1) / np.maximum(noise, 1e-300)
            spread = np.sqrt(1.0 / n + 1.0 / (n * max(run.n_periods - 1, 1)))
            out[name][i] = ratio
            sure[name][i] = (ratio > 1 + SIGMAS * spread) & (ratio > EXCESS)
    return Signs(out["odd"], out["even"], sure["odd"], sure["even"], *_change(runs))


CHANGE = 0.05
"""Change of an FRF with level, relative, below which it may be a drift or another shaker amplifier."""


def _change(runs: Sequence[Run]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Change of the FRFs from the lowest to the highest level, and whether noise cannot explain it."""
    low, high = min(runs, key=lambda r: r.level), max(runs, key=lambda r: r.level)
    none = np.full(runs[0].y.shape[0], np.nan), np.zeros(runs[0].y.shape[0], bool)
    if high.level < 1.3 * low.level or not np.isclose(high.rate / high.period, low.rate / low.period, rtol=1e-9):
        return none
    n = min(low.u.size, high.u.size)  # as far as the one that was driven less far goes
    on = low.excited[:n] & high.excited[:n]
    if np.count_nonzero(on) < 8 or not (np.isfinite(low.noise).all() and np.isfinite(high.noise).all()):
        return none
    at = np.flatnonzero(on)
    a, b = low.y[:, at] / low.u[at], high.y[:, at] / high.u[at]
    noise = low.noise[:, at] / np.abs(low.u[at]) ** 2 + high.noise[:, at] / np.abs(high.u[at]) ** 2
    power, expected = np.sum(np.abs(a - b) ** 2, axis=1), np.sum(noise, axis=1)
    size = np.sqrt(np.maximum(power - expected, 0) / np.sum(np.abs(a) ** 2, axis=1))
    return size, (size > CHANGE) & (power > 3.0 * expected)
