"""Natural frequencies and damping ratios that an FRF shows, and the model's counterpart with sensitivities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.bands import Band
from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.response import poles
from labnnum.structures.base import Structure

_SCATTER = (1e-3, 0.05)
"""Relative standard deviations that a measured frequency and a measured damping ratio are given."""


@dataclass(frozen=True, eq=False)
class ModalData:
    """Measured poles, as numbers to be matched.

    Parameters
    ----------
    values : ndarray, shape (2 n,)
        Natural frequencies in Hz, then damping ratios.
    scatter : ndarray, shape (2 n,)
        Standard deviations that weigh them: 0.1 % of a frequency, 5 % of a damping ratio.
    """

    values: NDArray[np.float64]
    scatter: NDArray[np.float64]


def modal_data(frf: Frf, bands: Sequence[Band]) -> ModalData:
    """Pole of the largest peak in each band, by a local least squares fit of one mode to all FRFs.

    Raises
    ------
    EstimationError
        If no band shows a peak inside.
    """
    found = [p for p in (_local_pole(frf, band) for band in bands) if p is not None]
    if not found:
        raise EstimationError("no band shows a resonance: the penalty function method needs measured poles")
    pole = np.array(found)
    values = np.concatenate([np.abs(pole) / (2 * np.pi), -np.real(pole) / np.abs(pole)])
    share = np.repeat(_SCATTER, pole.size)
    return ModalData(values, np.maximum(share * np.abs(values), 1e-9))


def _local_pole(frf: Frf, band: Band) -> complex | None:
    """Pole of H ~ (a + b s) / (s^2 + c s + d) fitted about the peak; None where the band has no inner peak.

    Linear in the unknowns: s^2 H = a + b s - c s H - d H, a and b for each pair, c and d shared.
    """
    inside = np.flatnonzero((frf.frequency >= band.low) & (frf.frequency <= band.high))
    power = np.sum(np.abs(frf.value) ** 2, axis=(0, 1))[inside]
    top = int(power.argmax())
    if inside.size < 6 or top in (0, inside.size - 1):
        return None
    near = np.flatnonzero(power > power[top] / 8)
    near = near[(near >= top - 12) & (near <= top + 12)]
    chosen = inside[max(0, min(near[0], top - 2)) : max(near[-1], top + 2) + 1]
    s = 1j * frf.omega[chosen] / frf.omega[inside[top]]
    h = frf.value[..., chosen].reshape(-1, chosen.size)
    rows, right = [], []
    for i, row in enumerate(h):
        own = np.zeros((chosen.size, 2 * len(h)), complex)
        own[:, 2 * i], own[:, 2 * i + 1] = 1.0, s
        scale = np.abs(row).max() or 1.0
        rows.append(np.hstack([-(s * row)[:, None] / scale, -row[:, None] / scale, own]))
        right.append(s**2 * row / scale)
    a, b = np.vstack(rows), np.concatenate(right)
    solved = np.linalg.lstsq(np.vstack([np.real(a), np.imag(a)]), np.concatenate([np.real(b), np.imag(b)]), rcond=None)[
        0
    ]
    root = np.roots([1.0, solved[0], solved[1]])
    up = root[root.imag > 0]
    return complex(up[0]) * float(frf.omega[inside[top]]) if up.size and up[0].real < 0 else None


def model_modal_data(
    structure: Structure, theta: NDArray, measured: ModalData
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The model's frequencies and damping ratios next to the measured ones, and their derivatives, (2 n, n_par).

    Poles are paired with the measured ones one to one, nearest in frequency; derivatives are central differences.
    """
    n = measured.values.size // 2

    def values(at: NDArray, chosen: NDArray | None) -> tuple[NDArray, NDArray]:
        found = poles(structure, at)
        found = found[found.imag > 0]
        found = found[np.argsort(found.imag)]
        f = np.abs(found) / (2 * np.pi)
        rows = _nearest(f, measured.values[:n]) if chosen is None else chosen
        return np.concatenate([f[rows], (-found.real / np.abs(found))[rows]]), rows

    centre, rows = values(theta, None)
    slope = np.empty((2 * n, theta.size))
    for j, p in enumerate(structure.parameters):
        step = 1e-5 * p.spread * np.eye(theta.size)[j]
        slope[:, j] = (values(theta + step, rows)[0] - values(theta - step, rows)[0]) / (2e-5 * p.spread)
    return centre, slope


def _nearest(f: NDArray, wanted: NDArray) -> NDArray[np.intp]:
    """Numbers of the model's frequencies next to the wanted ones, none used twice."""
    left = list(range(f.size))
    out = []
    for value in wanted:
        best = min(left or range(f.size), key=lambda i: abs(f[i] - value))
        out.append(best)
        if best in left:
            left.remove(best)
    return np.array(out, np.intp)
