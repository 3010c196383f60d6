"""Sines of known frequency: their amplitudes, and the FRF of stretches that each hold one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording


def tone(signal: ArrayLike, rate: float, frequency: float) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    r"""Complex amplitudes of a sine of known frequency, by least squares, and their variance.

    Parameters
    ----------
    signal : array_like, shape (n_channels, n)
    rate : float
        Samples per second.
    frequency : float
        Hz.

    Returns
    -------
    amplitude : ndarray, shape (n_channels,)
        a with signal = Re(a exp(i omega t)), t from the first sample; a constant and harmonics up to the third that
        the rate can hold are fitted with it and left out.
    variance : ndarray, shape (n_channels,)
        E|da|^2 from what the fit leaves over.

    Examples
    --------
    >>> t = np.arange(100) / 100
    >>> a, _ = tone([1 + 2 * np.cos(2 * np.pi * 5.5 * t)], 100.0, 5.5)
    >>> round(float(abs(a[0])), 12)
    2.0
    """
    x = np.atleast_2d(np.asarray(signal, float))
    n = x.shape[1]
    harmonics = [k for k in (1, 2, 3) if k * frequency < 0.45 * rate] or [1]
    turns = 2 * np.pi * frequency / rate * np.arange(n)
    columns = [np.ones(n)]
    for k in harmonics:
        columns += [np.cos(k * turns), -np.sin(k * turns)]
    basis = np.stack(columns, axis=1)
    if n <= basis.shape[1] or n * frequency < rate:
        raise EstimationError(f"a tone of {frequency:g} Hz needs more than the {n} samples given: at least a cycle")
    fit, *_ = np.linalg.lstsq(basis, x.T, rcond=None)
    left = x.T - basis @ fit
    sigma2 = np.sum(left**2, axis=0) / (n - basis.shape[1])
    spread = np.linalg.inv(basis.T @ basis)
    return fit[1] + 1j * fit[2], sigma2 * (spread[1, 1] + spread[2, 2])


def tone_frf(recording: Recording, stretches: Sequence[tuple[int, int]], frequency: ArrayLike) -> Frf:
    """FRF of a stepped-sine recording, one line a stretch.

    Parameters
    ----------
    recording : Recording
        With one reference or base channel.
    stretches : sequence of (start, stop)
        Samples in which each tone is steady.
    frequency : array_like, shape (n_stretches,)
        Hz, different from each other, in any order.

    Raises
    ------
    EstimationError
        There is not one input, or no stretch holds a whole cycle without a break.

    Notes
    -----
    Where a stretch is broken (lost frames, exclusions) its longest unbroken part is taken; a line of which no part
    holds a cycle is left out.
    """
    if len(recording.inputs) != 1:
        raise EstimationError(f"{recording.label}: a stepped sine needs one input, not {len(recording.inputs)}")
    given = np.asarray(frequency, float)
    parts = [_unbroken(recording, *stretch) for stretch in stretches]
    order = [k for k in np.argsort(given) if _enough(parts[k], float(given[k]), recording.rate)]
    if not order:
        raise EstimationError(f"{recording.label}: no tone lasts for a cycle without a break")
    lines = given[order]
    rows = [recording.inputs[0], *recording.outputs]
    amplitude, variance = np.empty((len(rows), lines.size), complex), np.empty((len(rows), lines.size))
    for k, (f, at) in enumerate(zip(lines, order, strict=True)):
        start, stop = parts[at]
        amplitude[:, k], variance[:, k] = tone(recording.data[rows, start:stop], recording.rate, float(f))
    value = amplitude[1:] / amplitude[0]
    spread = (variance[1:] + np.abs(value) ** 2 * variance[0]) / np.abs(amplitude[0]) ** 2
    channels: list[Channel] = [recording.channels[r] for r in rows]
    return Frf(
        lines, value[:, None], tuple(channels[1:]), (channels[0],), variance=spread[:, None],
        estimator="stepped sine", settings={"rate": recording.rate, "level": recording.level},
    )  # fmt: skip


def _unbroken(recording: Recording, start: int, stop: int) -> tuple[int, int]:
    """The longest part of a stretch that no break or exclusion interrupts."""
    parts = [(max(a, start), min(b, stop)) for a, b in recording.spans()]
    return max(parts, key=lambda part: part[1] - part[0], default=(start, start))


def _enough(part: tuple[int, int], frequency: float, rate: float) -> bool:
    """Whether a stretch holds a cycle, and more samples than a constant and three harmonics have unknowns."""
    n = part[1] - part[0]
    return n > 7 and n * frequency >= rate
