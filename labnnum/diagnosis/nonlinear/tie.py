"""A march that is tied to the motion which the measurement shows: while it begins, or all along.

Play in noise hardly forgets how a stretch began: over half of its length, and more, it runs as a wrong beginning left
it, though every mode of the structure has long died out; and from where it takes a wrong turn on it runs elsewhere. A
dashpot between the place and the motion that is recovered there costs nothing where both agree, and brings the march
back where they do not (a chaotic response that is driven into step: Abarbanel et al. 2009; Voss et al. 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from labnnum.diagnosis.nonlinear.discrete import Discrete
from labnnum.diagnosis.nonlinear.effort import marched
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.march import march
from labnnum.diagnosis.nonlinear.orbit import Marched, Orbit, Tie

HIDDEN, IN_STEP = 0.11, 0.2
"""Parts of a stretch: what its window hides at either end, so that no motion is known; and where the tie ends that
brings the march into step. What is compared of the response weighs 3 % up to there."""


def tied_march(
    on: Discrete, codes: NDArray, step: float, source: NDArray, p: NDArray, orbit: Orbit, ds: NDArray | None,
    vary: NDArray | None,
) -> Marched:  # fmt: skip
    """The march over an open run from `orbit`, whose motions are tied as its `tie` says.

    Forces are those of the laws alone: what a tie has to do is missing in the response.
    """
    bond = orbit.tie
    assert bond is not None
    n, k, m, room = source.shape[0], source.shape[1], on.w.shape[1], orbit.memory.shape[1]
    n_s, n_v = 0 if ds is None else ds.shape[3], 0 if vary is None else vary.shape[0]
    nt = n_s + n_v
    marched(n, m, k, nt)
    X = np.zeros((2, m, nt))
    df, dmem, dp = np.zeros((k, nt)), np.zeros((k, room, nt)), np.zeros((k, N_P, nt))
    if vary is not None:
        dp[:, :, n_s:] = np.moveaxis(vary, 0, -1)
    if ds is None:
        ds = np.zeros((n, k, 2, 0), np.float32)
    forces, motion, slopes = np.empty((n, k)), np.empty((n, k, 2)), np.empty((n, k, nt), np.float32)
    x, f, memory = orbit.x.copy(), orbit.f.copy(), orbit.memory.copy()
    push, dpush = f.copy(), df.copy()
    toward = np.ascontiguousarray(bond.motion[:, :, 1])
    a, b, c = int(HIDDEN * n), int(IN_STEP * n), int((1 - HIDDEN) * n)
    bad = 0
    for low, high, tight in ((0, a, 0.0), (a, b, max(1.0, bond.tight)), (b, c, bond.tight), (c, n, 0.0)):
        here = slice(low, high)
        bad += march(
            on.T, on.W0, on.W1, on.w, on.inner, on.rate, on.back, on.seated, step, source[here], codes, p, x, f, memory,
            forces[here], motion[here], X, df, dmem, dp, ds[here], slopes[here], push, dpush,
            _pull(tight * bond.dashpot, on.rate), toward[here],
        )  # fmt: skip
    end = np.concatenate([X.reshape(2 * m, nt), df, dmem.reshape(room * k, nt)])
    return Marched(np.concatenate([x.reshape(-1), f, memory.reshape(-1)]), forces, motion, end, slopes, bad)


def _pull(dashpot: NDArray, rate: NDArray) -> NDArray[np.float64]:
    """What dashpots (k,) push with (k, k) per speed before any force of the step: they give way to each other."""
    c = np.diag(dashpot)
    return np.asarray(np.linalg.solve(np.eye(c.shape[0]) + c @ rate, c), np.float64)


def tie_of(followed: Orbit, n: int, dashpot: NDArray, tight: float) -> Tie:
    """The tie to a motion that was followed, on n samples."""
    return Tie(_sampled(followed.motion[:, :, :2], n), dashpot, tight)


def dashpots(followed: Orbit) -> NDArray[np.float64]:
    """Dashpots (k,) at the laws' places that push as hard as what is recovered there."""
    _, v, f = np.moveaxis(followed.motion, 2, 0)
    return np.linalg.norm(f, axis=0) / np.maximum(np.linalg.norm(v, axis=0), 1e-300)


def tightness(orbits: Sequence[Orbit | None]) -> float | None:
    """How tightly these are held in step with the measured motion; None where none is brought into it."""
    return max((o.tie.tight for o in orbits if o is not None and o.tie is not None), default=None)


def resampled(tie: Tie, n: int) -> Tie:
    """The same on n samples."""
    return tie if tie.motion.shape[0] == n else replace(tie, motion=_sampled(tie.motion, n))


def _sampled(motion: NDArray, n: int) -> NDArray[np.float64]:
    """Motions (m, k, 2) over a stretch on n samples."""
    m = motion.shape[0]
    return np.ascontiguousarray(CubicSpline(np.arange(m) / m, motion)(np.arange(n) / n))
