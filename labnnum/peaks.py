"""One mode read off an FRF around its peak, for following it over levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError


def peak(frequency: NDArray, h: NDArray, low: float, high: float, *, width: float = 0.04) -> tuple[float, float]:
    r"""Frequency (Hz) and damping ratio of the mode whose peak is the largest between `low` and `high`.

    .. math:: H \approx \frac{(a + ib)\,\omega^2}{\omega_0^2 - \omega^2 + 2i\zeta\omega_0\omega} + c + d\,\omega

    by least squares on the lines within `width` of the peak, relative (a local fit of one degree of freedom with
    residual terms; Ewins, "Modal Testing", 2000, section 4.3).

    Parameters
    ----------
    frequency : ndarray, shape (n_f,)
        Hz.
    h : ndarray, shape (n_f,)
        Accelerance or another FRF.

    Raises
    ------
    EstimationError
        If fewer than eight lines lie around the peak.
    """
    from scipy.optimize import least_squares

    inside = (frequency >= low) & (frequency <= high)
    if not inside.any():
        raise EstimationError(f"no line of the FRF lies between {low:g} and {high:g} Hz")
    top = float(frequency[inside][np.argmax(np.abs(h[inside]))])
    near = np.abs(frequency - top) <= width * top
    if np.count_nonzero(near) < 8:
        raise EstimationError(f"only {np.count_nonzero(near)} lines lie around {top:g} Hz; 8 are needed")
    x, y = frequency[near] / top, h[near]

    def basis(p: NDArray) -> NDArray[np.complex128]:
        w, z = p[0], np.exp(p[1])
        pole = x**2 / (w**2 - x**2 + 2j * z * w * x)
        return np.array([pole, 1j * pole, np.ones_like(x), 1j * np.ones_like(x), x, 1j * x], complex)

    def left(p: NDArray) -> NDArray[np.float64]:
        a = basis(p).T
        real = np.concatenate([np.real(a), np.imag(a)])
        b = np.concatenate([np.real(y), np.imag(y)])
        return real @ np.linalg.lstsq(real, b, rcond=1e-12)[0] - b

    scale = float(np.sqrt(np.mean(np.abs(y) ** 2)))
    found = [
        least_squares(
            lambda p: left(p) / scale, [1.0, np.log(z)], bounds=([1 - width, np.log(1e-4)], [1 + width, -1.2])
        )
        for z in (0.003, 0.01, 0.03)
    ]
    best = min(found, key=lambda f: f.cost)
    return float(best.x[0] * top), float(np.exp(best.x[1]))
