"""A channel that runs into the end of its range beside a law: what the law makes of its peaks is not recorded.

Where the structure distorts, distortion lines and FRFs that change with level do not tell a channel that clips, and a
rail at which only one of several runs ends leaves no other to compare with. A law that explains all else predicts what
the channel should have read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.linearise import errors_of_sensors
from labnnum.diagnosis.nonlinear.lines import Lines, choose_lines
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.verdict import Named
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.channel_clipping import ChannelClipping
from labnnum.parameters import Parameter

LEFT = 1.5
"""Chi-square per value that a law leaves of a channel in one run, at least, for its rail to be sought."""
EXPLAINS = 0.3
"""Part of that which a rail may leave at most."""
QUIET = 0.7
"""Level, of the loudest, below which runs tell the ordinary errors of sensors."""
LOWEST = 0.4
"""Rail, of the highest reading that is predicted, below which none is sought."""
LOOKED_AT = 24
"""Rails that are looked at before the best is refined."""
OWN = 1e-3
"""Standard deviation of a rail, relative, beyond what noise leaves: the law's own errors beside it."""
FINE = 8
"""Samples of the predicted reading to one of the run: what is cut off has steep flanks."""


@dataclass(frozen=True, eq=False)
class Overload:
    """A channel that clips: number of the response, its rail as a named fault, and spectra of what was cut off, with
    the inputs of the runs that they belong to.
    """

    output: int
    named: Named
    cut: tuple[tuple[NDArray[np.complex128], NDArray[np.complex128]], ...]

    def restored(self, o: Observation) -> Observation:
        """The observation with what was cut off put back, in the spectra of its periods and in its FRFs."""
        run = o.run
        cut = None if run is None else next((c for u, c in self.cut if np.array_equal(u, run.u)), None)
        if run is None or cut is None or not np.any(cut):
            return o
        y, value = run.y.copy(), o.frf.value.copy()
        y[self.output] += cut
        at = np.searchsorted(run.frequency, o.frf.frequency - 1e-9)
        value[self.output, 0] += cut[at] / run.u[at]
        return replace(o, run=replace(run, y=y), frf=replace(o.frf, value=value))


def overloaded(found: NonlinearAnswer, observations: Sequence[Observation]) -> Overload | None:
    """The one channel of periodic runs whose readings end where the law goes on; None where there is none, or several.

    Parameters
    ----------
    found : NonlinearAnswer
        With a law that is named.
    observations : sequence of Observation
        Those that were fitted and held out, every channel of them as it was recorded.

    Notes
    -----
    Of each response the readings that the law predicts, with the ordinary errors that the sensors show in the quieter
    runs, are compared with what was recorded; then the same cut off at a rail, one for all runs, which must leave less
    than a third. A channel that clips may have been left out of the fit.
    """
    if not (found.named and found.orbits) or found.recorder is not None:
        return None
    study, last = found.study, found.laws[-1].made
    runs = [*study.runs, *found.held_out]
    if len(found.orbits) != len(runs) or not all(r.lasting for r in runs):
        return None
    recorded = [_as_recorded(r, observations) for r in runs]
    sampled = [_samples(r, observations) for r in runs]
    lines = [choose_lines(r, 0, found.scatter.floor) for r in recorded]
    joint = Joint(study.engine, study.point, recorded, last.terms, found.scatter, lines, whole=True)
    top = max(r.level for r in runs)
    quiet = [k for k, r in enumerate(study.runs) if r.level < QUIET * top] or [0]
    errors = errors_of_sensors(joint, last.x, found.orbits, quiet)
    made = joint.receptances(last.x)
    whole = [
        y + joint.misread(made[r.key], r, o, y, errors, silent=False)
        for y, r, o in zip(joint.predict(last.x, found.orbits), recorded, found.orbits, strict=True)
    ]  # fmt: skip
    every = [_rail(i, recorded, [w[i] for w in whole], lines, sampled) for i in range(runs[0].y.shape[0])]
    likely = [i for i, one in enumerate(every) if one is not None and one.left < EXPLAINS]
    if len(likely) != 1:
        return None
    one = every[likely[0]]
    assert one is not None
    i = likely[0]
    channel = runs[0].outputs[i]
    parameter = Parameter("rail", one.rail, 0.0, np.inf, channel.unit)
    term = Term(ChannelClipping(), Place("channel", channel.name), (parameter,), np.zeros((0, 1)))
    named = Named(term, np.array([one.rail]), np.array([one.std]), 0.99)
    return Overload(i, named, tuple((r.u, c) for r, c in zip(runs, one.cut, strict=True)))


@dataclass(frozen=True, eq=False)
class _Rail:
    rail: float
    std: float
    left: float
    """Part that it leaves of what is left without it, in the runs that it cuts."""
    cut: list[NDArray[np.complex128]]


def _rail(
    i: int, runs: Sequence[Run], made: Sequence[NDArray], lines: Sequence[Lines], sampled: Sequence[int]
) -> _Rail | None:  # fmt: skip
    """The rail of response i that explains most; None where nothing is left that it could explain.

    An amplifier cuts the signal itself, a converter its samples, `sampled` of them in the period of each run.
    """
    sigma = [_everywhere(r, i, a) for r, a in zip(runs, lines, strict=True)]
    first = [int(a.at[0]) for a in lines]  # below the band stand offsets, which are no matter of a rail
    pieces = zip(runs, made, sigma, first, strict=True)
    left = [float(np.mean(np.abs((r.y[i, k:] - m[k:]) / s[k:]) ** 2)) for r, m, s, k in pieces]
    if max(left) < LEFT:
        return None
    both = (_cut(runs, made, i, sigma, first, n) for n in ([r.period * FINE for r in runs], sampled))
    return min((one for one in both if one is not None), key=lambda one: one.left, default=None)


def _cut(
    runs: Sequence[Run], made: Sequence[NDArray], i: int, sigma: Sequence[NDArray], first: Sequence[int],
    n: Sequence[int],
) -> _Rail | None:  # fmt: skip
    """The rail that cuts readings, taken at `n` samples in each run's period, so that least is left of response i
    from the `first` lines on.
    """
    time = [_time(m, k) for m, k in zip(made, n, strict=True)]
    tops = [float(np.max(np.abs(t))) for t in time]

    def cut(rail: float) -> list[NDArray[np.complex128]]:
        return [
            _spectrum(t - np.clip(t, -rail, rail), m.size) if top > rail else np.zeros_like(m)
            for t, top, m in zip(time, tops, made, strict=True)
        ]  # fmt: skip

    def remains(rail: float) -> NDArray[np.float64]:
        pieces = zip(runs, made, sigma, first, cut(rail), strict=True)
        return np.array([np.sum(np.abs((r.y[i] - m + c)[k:] / s[k:]) ** 2) for r, m, s, k, c in pieces])

    grid = max(tops) * np.linspace(LOWEST, 1.0, LOOKED_AT + 1)
    best = int(np.argmin([remains(g).sum() for g in grid]))
    if best in (0, LOOKED_AT):
        return None
    sharp: Any = minimize_scalar(
        lambda g: float(remains(g).sum()), bounds=(grid[best - 1], grid[best + 1]), method="bounded",
        options={"xatol": 1e-4 * grid[best]},
    )  # fmt: skip
    rail, step = float(sharp.x), 0.01 * float(sharp.x)
    touched = np.array(tops) > rail
    before, after = remains(max(tops))[touched].sum(), remains(rail)[touched].sum()
    bend = float((remains(rail + step) + remains(rail - step) - 2 * remains(rail)).sum()) / step**2
    size = sum(m.size - k for m, k, there in zip(made, first, touched, strict=True) if there)
    std = float(np.hypot(np.sqrt(max(after / max(size, 1), 1.0) / bend), OWN * rail)) if bend > 0 else step
    return _Rail(rail, std, float(after / before) if before > 0 else 1.0, cut(rail))


def _as_recorded(run: Run, observations: Sequence[Observation]) -> Run:
    """The run with every response believed, also where one was left out of the fit."""
    same = (o.run for o in observations if o.run is not None and o.run.u.shape == run.u.shape)
    return next((r for r in same if np.array_equal(r.u, run.u)), run)


def _samples(run: Run, observations: Sequence[Observation]) -> int:
    """Samples in a period of the record from which a run was made."""
    for o in observations:
        if o.run is not None and o.recordings and np.array_equal(o.run.u, run.u):
            return round(run.period * o.recordings[0].rate / run.rate)
    return run.period


def _everywhere(run: Run, i: int, lines: Lines) -> NDArray[np.float64]:
    """Standard deviation (n_lines,) of response i, beyond the lines compared as at the nearest of these."""
    nearest = np.clip(np.searchsorted(lines.at, np.arange(run.u.size)), 0, lines.at.size - 1)
    return lines.sigma[i, nearest]


def _time(spectrum: NDArray, n: int) -> NDArray[np.float64]:
    whole = np.zeros(n // 2 + 1, complex)
    whole[: spectrum.size] = spectrum
    return np.fft.irfft(whole * (n / 2), n)


def _spectrum(time: NDArray, size: int) -> NDArray[np.complex128]:
    return np.fft.rfft(time)[:size] * (2 / time.size)
