"""Clipping found in the samples alone, where no instrument reported it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

FLATNESS = 3.0
"""How many times more samples the outermost level must hold than the next three inwards.

A smooth peak, a parabola at its top, holds as many in both; one of fourth order 2.4 times as many."""

PAIRS = 6
"""Samples at the rail up to which two in a row count: more pairs are a signal sampled in step with its period."""

TIES, OFTEN, INWARDS = 16, 8.0, 20
"""Samples at the very same outermost value that make a rail where none follows another: how many at least, how many
times as many as at any of the next values inwards, and how many of those are looked at."""

ROUNDING = 1e-9
"""Difference of two values, of the largest, that is none."""

LEVELS = 200
"""Sizes that a signal must take for a return to the very same one to tell anything."""

COARSE = 16
"""Steps of the converter that a signal must span: the outermost of a few is a step and no rail."""

AT_RAIL = 0.995
"""Share of a known full scale from which a sample counts as overloaded."""


def clipped_runs(signal: ArrayLike, full_scale: float | None = None) -> list[tuple[int, int]]:
    r"""Sample ranges (start, stop) in which a signal is clipped; an empty list if it is not.

    Parameters
    ----------
    signal : array_like, shape (n,)
    full_scale : float, optional
        Known end of range, in the signal's unit; every sample within 0.5 % of it counts. Without it a signal
        counts as clipped where its outermost level is a plateau: at least three samples in a row at the very
        same value (two, if the signal is finely resolved and noisy elsewhere), and far more samples at that level
        than a smooth peak leaves there; or single samples that return to it as they do to no other value. The same is
        tried with levels as wide as the noise, for signals that
        were clipped before noise was added. A signal of fewer than sixteen steps of its converter is too coarse to
        tell, and counts as not clipped.

    Notes
    -----
    Near the top of a smooth peak as much time is spent between levels d and 4d below the top as above d. Of a peak
    cut off by L the plateau holds about 2L/3d times the samples of the next three levels of height d.

    Examples
    --------
    >>> t = np.arange(1000) / 1000
    >>> clipped_runs(np.sin(2 * np.pi * 5 * t))
    []
    >>> len(clipped_runs(np.clip(np.sin(2 * np.pi * 5 * t), -0.9, 2)))
    5
    """
    x = np.asarray(signal, float)
    if full_scale is not None:
        return runs(np.abs(x) >= AT_RAIL * abs(full_scale))
    if x.size < 4 or not np.isfinite(x).all() or x.min() == x.max():
        return []
    if np.ptp(x) < COARSE * _smallest_gap(x):
        return []
    x = np.ldexp(x, -int(np.frexp(np.abs(x).max())[1]))  # exact, and squares of huge values stay finite
    centred = x - np.median(x)
    largest = np.abs(centred).max()
    step, noise = resolution(x), noise_level(x)
    found: list[tuple[int, int]] = []
    for side in (centred, -centred):
        if side.max() < 0.3 * largest:
            continue
        held = _exact_plateau(side, step, noise)
        if held is None:
            held = _noisy_plateau(side, step, noise)
        if held is not None:
            found += runs(held)
    return sorted(found) or _both_rails(x, step)


def _both_rails(x: NDArray, step: float) -> list[tuple[int, int]]:
    """Stretches in which a fast signal swings from the one rail to the other: too short at either for a plateau.

    Three samples in a row of the same size and both signs are no peak; only a pure sine of four samples a period does
    that too, and it does it throughout.
    """
    size = np.abs(x)
    top = size.max()
    slack = 1e-9 * top + 0.25 * min(step, 1e-6 * top)
    held = size >= top - slack
    below = np.count_nonzero((size < top - slack) & (size >= top - slack - 3 * step))
    turning = [(a, b) for a, b in runs(held) if b - a >= 3 and x[a:b].min() < 0 < x[a:b].max()]
    enough = FLATNESS * below < np.count_nonzero(held) <= 0.5 * x.size
    return runs(held) if turning and enough and np.unique(size).size >= LEVELS else []


def _exact_plateau(side: NDArray, step: float, noise: float) -> NDArray | None:
    """Samples at the outermost value, if they form a plateau."""
    top = side.max()
    slack = 1e-9 * np.abs(side).max() + 0.25 * min(step, 1e-6 * top)
    held = side >= top - slack
    longest = max(b - a for a, b in runs(held))
    fine = step < 1e-4 * top and noise > 4 * step and np.count_nonzero(held) <= PAIRS
    if longest < 2 or (longest == 2 and not fine):
        return held if returns(side) else None
    below = np.count_nonzero((side < top - slack) & (side >= top - slack - 3 * step))
    return held if np.count_nonzero(held) > FLATNESS * below else None


def returns(side: ArrayLike) -> bool:
    """Whether samples return to the outermost value as they do to none of the next ones inwards.

    Peaks shorter than two samples leave one sample each at a rail. What repeats itself exactly returns to every value
    alike, and a smooth peak of a coarse converter leaves at most a few times more samples at its top.

    Examples
    --------
    >>> x = np.random.default_rng(0).standard_normal(4000)
    >>> returns(x), returns(np.minimum(x, 2.0)), returns(np.tile(x, 20))
    (False, True, False)
    """
    x = np.asarray(side, float)
    step = ROUNDING * np.abs(x).max()
    if np.count_nonzero(x > x.max() - step) < TIES:
        return False
    value, count = np.unique(np.round(x / step), return_counts=True)
    return bool(value.size >= LEVELS and count[-1] > OFTEN * count[-1 - INWARDS : -1].max())


def _noisy_plateau(side: NDArray, step: float, noise: float) -> NDArray | None:
    """Samples within the noise of the outermost value, if they form a plateau that ends abruptly."""
    width = 6 * max(noise, step)
    top = side.max()
    if not 0 < width < 0.1 * top:
        return None
    held = side >= top - width
    count = np.count_nonzero(held)
    below = np.count_nonzero((side < top - width) & (side >= top - 4 * width))
    longest = max(b - a for a, b in runs(held))
    return held if longest >= 5 and count > FLATNESS * below + 8 else None


def runs(mask: ArrayLike) -> list[tuple[int, int]]:
    """Ranges (start, stop) of consecutive True values.

    Examples
    --------
    >>> runs([0, 1, 1, 0, 1])
    [(1, 3), (4, 5)]
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], np.asarray(mask, bool), [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def resolution(signal: NDArray) -> float:
    """Smallest difference between two values of a signal: the converter's step, if it shows; of eight bits at most."""
    return min(_smallest_gap(signal), float(np.ptp(signal)) / 250)


def _smallest_gap(signal: NDArray) -> float:
    """Between two values that are not the same but for rounding; 0 if there are no two."""
    gaps = np.diff(np.unique(signal))
    gaps = gaps[gaps > 1e-12 * np.abs(signal).max()]
    return float(gaps.min()) if gaps.size else 0.0


def noise_level(signal: NDArray) -> float:
    r"""Standard deviation of the white noise in a signal, from the quietest quarter of its differences.

    Notes
    -----
    The difference of order p of white noise has variance C(2p, p) sigma^2. Orders 3 and 6 are taken, each over blocks
    of 64 samples, ranked, and the smaller result: what is left of a smooth signal shrinks with the order.
    """
    return min(_difference_noise(signal, order) for order in (3, 6))


def _difference_noise(signal: NDArray, order: int) -> float:
    gain = float(np.sqrt(math.comb(2 * order, order)))
    rough = np.diff(signal, order)
    if rough.size < 256:
        return float(np.median(np.abs(rough)) / (0.6745 * gain)) if rough.size else 0.0
    power = np.mean(rough[: rough.size // 64 * 64].reshape(-1, 64) ** 2, axis=1)
    return float(np.sqrt(np.quantile(power, 0.25)) / gain)
