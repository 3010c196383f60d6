"""Compiled inner loops of what is asked for on every line of a long record: modal receptances, recovered forces."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, error_model="numpy", nogil=True)
def _modal(omega, zeta, share, decay, turn, rigid, out):  # pragma: no cover - compiled
    for i in range(omega.size):
        w = omega[i]
        loss = 2.0 * zeta[i] * w
        for j in range(turn.size):
            t = turn[j]
            re = w * w + loss * (1.0 - share) * decay + decay * decay - t * t
            im = loss * ((1.0 - share) * t + share * w) + 2.0 * decay * t
            size = re * re + im * im
            here = size > 0.0 and (w >= rigid or decay != 0.0 or t != 0.0)
            out[i, 2 * j] = re / size if here else 0.0
            out[i, 2 * j + 1] = -im / size if here else 0.0


def modal(
    omega: NDArray, zeta: NDArray, share: float, decay: float, turn: NDArray, rigid: float
) -> NDArray[np.complex128]:
    """Receptances 1 / (omega^2 + 2 zeta omega rate + s^2) of modes (m,) on lines s = decay + i turn, (m, n_lines).

    rate is s of viscous damping and i omega of hysteretic, whose `share` there is. Zero where a mode below `rigid`
    rad/s is asked for a force that lasts, and where a mode without damping is met.
    """
    out = np.empty((omega.size, 2 * turn.size))
    _modal(np.ascontiguousarray(omega), np.ascontiguousarray(zeta), share, decay, turn, rigid, out)
    return out.view(np.complex128)


def combined(rows: NDArray, spectra: NDArray) -> NDArray[np.complex128]:
    """Real rows (..., m) times complex spectra (m, n), as real products: half of what a complex one would take."""
    return (rows @ spectra.view(np.float64)).view(np.complex128)


@njit(cache=True, inline="always")
def _at(j, size):  # pragma: no cover - compiled
    """Where line j stands when the lines are mirrored at their ends."""
    if j < 0:
        j = -1 - j
    if j >= size:
        j = 2 * size - 1 - j
    return j


AROUND = 15
"""Lines over which what the base leaves between excited lines is averaged."""


@njit(cache=True, error_model="numpy", nogil=True)
def weighed(left, lift, h, fixed, quiet, hann):  # pragma: no cover - compiled
    """What a force at one place explains of residual spectra `left` (n_out, n_lines), which are changed in place.

    Parameters
    ----------
    left : ndarray
        Residuals; seen through a Hann window if `hann`.
    lift, h : ndarray, shape (n_out, n_lines)
        From displacement to what the channels read; displacements per force.
    fixed : ndarray, shape (n_out, n_lines)
        Variance that is known beforehand; a part of the power around, on `quiet` lines, is added.

    Returns
    -------
    top, power : ndarray, shape (n_lines,)
        h^H W r and h^H W h.
    whole : float
        r^H W r on quiet lines.
    """
    n_out, n = left.shape
    top, power, whole = np.zeros(n, np.complex128), np.zeros(n), 0.0
    around, beside = np.empty(n), 0
    half = AROUND // 2
    for o in range(n_out):
        row = left[o]
        if hann:
            before = row[0]
            row[0] = 0.5 * before - 0.25 * row[1]
            for j in range(1, n):
                here = row[j]
                after = row[j + 1] if j + 1 < n else 0.0
                row[j] = 0.5 * here - 0.25 * (before + after)
                before = here
        for j in range(n):
            around[j] = row[j].real ** 2 + row[j].imag ** 2 if quiet[j] else 0.0
        total, beside = 0.0, 0
        for j in range(-half, half + 1):
            at = _at(j, n)
            total += around[at]
            beside += quiet[at]
        for j in range(n):
            if j:
                new, old = _at(j + half, n), _at(j - half - 1, n)
                total += around[new] - around[old]
                beside += int(quiet[new]) - int(quiet[old])
            local = max(total, 0.0) / max(beside, 1e-9 * AROUND)
            w = 1.0 / max(fixed[o, j] + 0.03**2 * local, 1e-300)
            seen = lift[o, j] * h[o, j]
            top[j] += np.conj(seen) * w * row[j]
            power[j] += (seen.real**2 + seen.imag**2) * w
            if quiet[j]:
                whole += w * (row[j].real ** 2 + row[j].imag ** 2)
    return top, power, whole
