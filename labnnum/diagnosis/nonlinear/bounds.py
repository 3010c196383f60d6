"""What no linear model of any kind can explain: a search for linear physics that cannot end well need not begin."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.decision import HALF, MISFIT, NonlinearAnswer
from labnnum.diagnosis.nonlinear.linearise import errors_of_sensors, share_read
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Limits


def linear_least(runs: Sequence[Run], scatter: Scatter) -> float:
    """Chi-square per value that no linear model of any kind can fall below: what the best FRF of all runs together
    leaves, line by line, and all that stands on lines that were not excited; where few lines differ from level to
    level, on these.

    Zero for runs whose spectra are not those of one period, where an FRF of single lines says nothing, unless their
    inputs are one signal at several levels: whatever leaks then does so in proportion.
    """
    return _least([(r, r.y) for r in runs], scatter)


def _least(parts: Sequence[tuple[Run, NDArray]], scatter: Scatter) -> float:
    """The same of runs with the spectra (n_out, n_lines) that are to be explained, weighed as measured."""
    runs = [r for r, _ in parts]
    groups = {r.key for r in runs}
    if len(runs) < 2 or len(groups) > 1 or not (all(r.lasting for r in runs) or one_signal(runs)):
        return 0.0
    lines = [choose_lines(r, 0, scatter.floor) for r in runs]
    at = reduce(np.intersect1d, [a.at for a in lines])
    if runs[0].telling is not None:
        at = at[runs[0].telling[at]]
    if at.size < 8 or not (runs[0].open or all(np.array_equal(a.at, at) for a in lines)):
        return 0.0
    u = np.array([np.where(r.excited[at], r.seen(r.u)[at], 0.0) for r in runs])[:, None]
    y = np.array([r.seen(spectra)[:, at] for r, spectra in parts])
    w = np.array([1.0 / a.sigma[:, np.searchsorted(a.at, at)] ** 2 for a in lines])
    power = np.sum(w * np.abs(u) ** 2, axis=0)
    h = np.where(power > 0, np.sum(w * np.conj(u) * y, axis=0) / np.maximum(power, 1e-300), 0.0)
    left = float(np.sum(w * np.abs(y - h * u) ** 2))
    return left / max(y.size - np.count_nonzero(power), 1)


ALIKE = 1e-4
"""Power of what an input has of another signal than the loudest one, of its own, up to which they are one."""


def one_signal(runs: Sequence[Run]) -> bool:
    """Whether stretches of noise or sweeps, of one length, hold one signal at several levels."""
    if len({r.key for r in runs}) > 1 or not all(r.open for r in runs):
        return False
    loud = max(runs, key=lambda r: r.level).u
    power = np.vdot(loud, loud).real

    def other(u: NDArray) -> float:
        return 1.0 - float(abs(np.vdot(loud, u)) ** 2 / (power * np.vdot(u, u).real))

    return max(other(r.u) for r in runs) < ALIKE


def frf_least(observations: Sequence[Observation], scatter: Scatter) -> tuple[float, float]:
    """The same of estimated FRFs, for hits, noise and sweeps: chi-square per value and relative RMS that the best FRF
    of all levels leaves of each level's. Zeros where there is one level, or hardly a line common to all.
    """
    known = [o.frf for o in observations if np.isfinite(o.level) and o.frf.variance is not None]
    if len(known) < 2 or len({f.value.shape[:2] for f in known}) > 1:
        return 0.0, 0.0
    every = [np.round(f.frequency, 6) for f in known]
    common = reduce(np.intersect1d, every)
    if common.size < 8:
        return 0.0, 0.0
    some = [f.at(np.searchsorted(each, common)) for f, each in zip(known, every, strict=True)]
    value = np.array([f.value for f in some])
    variance = np.array([f.variance for f in some]) + (scatter.floor * np.abs(value)) ** 2
    w = 1.0 / np.maximum(variance, 1e-300)
    left = value - np.sum(w * value, axis=0) / np.sum(w, axis=0)
    chi = float(np.sum(w * np.abs(left) ** 2)) / ((len(known) - 1) * value[0].size)
    part = np.sum(np.abs(left) ** 2, axis=-1) / np.sum(np.abs(value) ** 2, axis=-1)
    return chi, float(np.sqrt(np.mean(part)))


def hopeless(found: NonlinearAnswer, observations: Sequence[Observation], scatter: Scatter, limits: Limits) -> bool:
    """Whether the best FRF of all levels leaves more than the law does, or, where the law does not help, so much of
    what the base leaves that no linear name could improve the prediction enough.
    """
    runs, base = found.study.runs, found.study.base
    if all(r.lasting for r in runs) or one_signal(runs):
        left = found.misfit if found.gained else limits.improve**2 * base.data_part / base.count
        return linear_least(runs, scatter) > max(limits.misfit, left)
    chi, relative = frf_least(observations, scatter)
    left = found.reached[0] if found.gained else limits.improve * found.base_error[0]
    return chi > MISFIT and relative > left


def hopeless_beside(found: NonlinearAnswer, scatter: Scatter, limits: Limits) -> bool:
    """Whether what the law leaves of periodic runs is nothing linear: the best FRF of what remains after its share, as
    the channels read it, has been taken out leaves half of it.
    """
    runs = found.study.runs
    if not all(r.lasting for r in runs):
        return False
    last = found.laws[-1].made
    some = [choose_lines(r, 2, scatter.floor) for r in runs]
    joint = Joint(found.study.engine, found.study.point, runs, last.terms, scatter, some, whole=True)
    made, orbits = joint.receptances(last.x), found.orbits[: len(runs)]
    errors = errors_of_sensors(joint, last.x, orbits, range(len(runs)))
    shares = [share_read(joint, made[run.key], run, o, errors) for run, o in zip(runs, orbits, strict=True)]
    rest = [(run, run.y - share) for run, share in zip(runs, shares, strict=True)]
    return _least(rest, scatter) > max(limits.misfit, HALF * found.misfit)
