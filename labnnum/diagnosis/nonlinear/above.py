"""Harmonics above the excited band, measured over predicted: what the recorder does to all channels alike.

A filter that is common to all channels cancels in every FRF. A nonlinear law acts on the motion itself, and its
harmonics above the band pass the filter once: there measured and predicted spectra differ by a smooth complex factor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.run import Run

TOP = 0.97
"""Part of the lines up to which they are looked at: the last ones may hold what folded back."""
BINS, LEAST = 12, 10
"""Bins of neighbouring lines in which the factor is taken as constant, and values that each must hold."""
COHERENT = 0.8
"""Share of the power above the band that the prediction must explain up to a factor a bin, for it to be that of the
same harmonics."""
FAR = 1 / 3
"""Part of what the prediction leaves as it is, to which those factors must bring it."""


@dataclass(frozen=True, eq=False)
class Above:
    """Measured over predicted spectra above the band, in bins.

    Parameters
    ----------
    frequency : ndarray, shape (n_bins,)
        Hz, means of the lines in each bin, weighed by the predicted power.
    ratio : ndarray, shape (n_bins,)
        Complex factor that explains most.
    power : ndarray, shape (n_bins,)
        Measured power, each response over its own in all bins.
    left : ndarray, shape (n_bins,)
        What the factor leaves of it, what any factor would explain by chance allowed for.
    plain : float
        Share of the power that the prediction leaves as it is.
    edges : ndarray, shape (n_bins + 1,)
        Hz.
    """

    frequency: NDArray[np.float64]
    ratio: NDArray[np.complex128]
    power: NDArray[np.float64]
    left: NDArray[np.float64]
    plain: float
    edges: NDArray[np.float64]

    @property
    def coherence(self) -> float:
        """Share of the power that the factors explain."""
        return float(1.0 - self.left.sum() / self.power.sum())

    @property
    def filtered(self) -> bool:
        """Whether the harmonics are predicted up to a factor, and the factor is not one."""
        return self.coherence > COHERENT and 1.0 - self.coherence < FAR * self.plain


def lines_above(run: Run) -> NDArray[np.intp]:
    """Lines of a run beyond the last that was excited."""
    return np.arange(int(np.flatnonzero(run.excited)[-1]) + 1, int(TOP * (run.u.size - 1)) + 1)


def above(runs: Sequence[Run], made: Sequence[NDArray]) -> Above | None:
    """Measured and predicted (n_out, n_lines) spectra of periodic runs compared; None where too few lines are above.

    Parameters
    ----------
    runs : sequence of Run
        As they were recorded.
    made : sequence of ndarray
        Predicted spectra of each.
    """
    f, y, m = _gathered(runs, made)
    n = min(BINS, f.size // LEAST)
    if n < 2:
        return None
    edges = np.linspace(f.min(), f.max() * (1 + 1e-12), n + 1)
    which = np.clip(np.searchsorted(edges, f, "right") - 1, 0, n - 1)
    rows, ratios = [], []
    for i in range(n):
        at = which == i
        count = int(np.count_nonzero(at))
        size, power = float(np.sum(np.abs(m[at]) ** 2)), float(np.sum(np.abs(y[at]) ** 2))
        if count < 2 or size == 0.0 or power == 0.0:
            continue
        ratio = complex(np.sum(m[at].conj() * y[at]) / size)
        left = float(np.sum(np.abs(y[at] - ratio * m[at]) ** 2))
        rows.append((float(np.sum(f[at] * np.abs(m[at]) ** 2) / size), power, min(left * count / (count - 1), power)))
        ratios.append(ratio)
    if len(rows) < 2:
        return None
    plain = float(np.sum(np.abs(y - m) ** 2) / np.sum(np.abs(y) ** 2))
    frequency, power, left = np.array(rows).T
    return Above(frequency, np.array(ratios), power, left, plain, edges)


def _gathered(runs: Sequence[Run], made: Sequence[NDArray]) -> tuple[NDArray, NDArray, NDArray]:
    """Frequencies, measured and predicted values (n,) of all responses and runs, each response in units of its own."""
    f, y, m = [], [], []
    for run, own in zip(runs, made, strict=True):
        at = lines_above(run)
        size = np.sqrt(np.mean(np.abs(run.y[:, at]) ** 2, axis=1, keepdims=True)) if at.size else np.ones((1, 1))
        size = np.where(size > 0, size, 1.0)
        f.append(np.tile(run.frequency[at], len(run.y)))
        y.append((run.y[:, at] / size).ravel())
        m.append((own[:, at] / size).ravel())
    return np.concatenate(f), np.concatenate(y), np.concatenate(m)
