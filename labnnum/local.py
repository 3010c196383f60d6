r"""FRFs of a whole record by local rational functions of frequency, which see through leakage.

Around every estimated line the spectra of a record that neither repeats nor begins at rest obey

.. math:: A(r) Y(k + r) = B(r) U(k + r) + C(r) + V(k + r), \quad |r| \le w

with polynomials A (A(0) = 1), B and C of the line number r: B/A is the FRF there, C/A what the ends of the record put
into it, which is as smooth as the FRF is (McKelvey and Guerin 2012, equation 6; Pintelon and Schoukens 2012, chapter 7,
with A = 1 as the local polynomial method). Segments and windows are not needed, so that a resonance is seen with the
resolution of the whole record, and a sweep like noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError
from labnnum.frf import Frf
from labnnum.recording import Recording
from labnnum.rest import lead_of, led

__all__ = ["local_frf"]

HALF = 8
"""Lines on either side of an estimated one that enter its estimate."""
ORDER = 2
"""Degree of the polynomials."""
BETTER, SURE = 0.8, 0.4
"""Variance that a denominator must leave at most, of what the polynomials alone leave, to be used; and to be believed.

Above the second the noise may have happened to suit it: what the polynomials leave is then taken for the noise, else
the variances would be a third too small.
"""
DRIVEN = 1e-4
"""Power of the input, of its largest, below which a line is not estimated."""


def local_frf(
    recordings: Recording | Sequence[Recording], *, half: int = HALF, step: int | None = None, lead: int | None = None
) -> Frf:  # fmt: skip
    """FRFs of all responses to the one input of a record, every `step`-th line.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        One input; the longest span without a gap is used. Of several records, equally long, the mean is taken with
        the weights of their variances.
    half : int
        Lines on either side that enter an estimate, at least 6.
    step : int, optional
        Lines from one estimate to the next; `2 * half + 1`, so that estimates share no line, if not given.
    lead : int, optional
        Samples in which nothing moves that are put before every record; a third of its length before a sweep that
        goes up and begins at rest if not given, else none (`labnnum.rest`). The first lines of such a sweep turn as
        little from line to line as what the ends put in, and without it nothing tells the two apart.

    Returns
    -------
    Frf
        With the variance of every value from what the local functions leave, and the coherence that goes with it;
        estimator "local", averages as many as a window has degrees of freedom.

    Raises
    ------
    ChannelError
        If there is not exactly one input.
    EstimationError
        If the record is too short for a single estimate, or several are not equally long.

    References
    ----------
    T. McKelvey and G. Guerin 2012, "Non-parametric frequency response estimation using a local rational model";
    R. Pintelon and J. Schoukens 2012, "System Identification", chapter 7.
    """
    if not isinstance(recordings, Recording):
        lead = lead_of(recordings) if lead is None else lead
        every = [local_frf(r, half=half, step=step, lead=lead) for r in recordings]
        return _mean(every, [r.label for r in recordings])
    return local_frf_with_errors(recordings, half=half, step=step, lead=lead)[0]


def local_frf_with_errors(
    recording: Recording, *, half: int = HALF, step: int | None = None, lead: int | None = None
) -> tuple[Frf, NDArray[np.complex128], NDArray[np.float64]]:
    """`local_frf` of one record, with samples of its error and the input's power.

    Returns
    -------
    frf : Frf
    errors : ndarray, shape (2 half + 1, n_out, n_f)
        What the local functions leave line by line, scaled to the variances of the FRFs: how errors of the rows go
        together.
    power : ndarray, shape (n_f,)
        Variance of a line of the responses over that of the FRF, in the input's unit^2 s^2: how much power of the
        input counts there, what cannot be told from the ends of the record left out.
    """
    if len(recording.inputs) != 1:
        raise ChannelError(f"{recording.label}: local FRFs need one input, not {len(recording.inputs)}")
    if half < 6:
        raise EstimationError(f"half is {half}, expected at least 6 lines on either side")
    start, stop = max(recording.spans(), key=lambda span: span[1] - span[0])
    x = recording.data[:, start:stop]
    lead = lead_of([recording]) if lead is None else lead
    x = led(x - x.mean(axis=1, keepdims=True), lead)
    n = x.shape[1]
    spectra = np.fft.rfft(x, axis=1) / recording.rate
    u, y = spectra[recording.inputs[0]], spectra[list(recording.outputs)]
    step = 2 * half + 1 if step is None else step
    centres = np.arange(half + 1, u.size - half, step)
    around = centres[:, None] + np.arange(-half, half + 1)
    power = np.mean(np.abs(u[around]) ** 2, axis=1) if centres.size else np.zeros(0)
    if not centres.size or not power.max() > 0:
        raise EstimationError(f"{recording.label}: {n} samples are too few for local FRFs, or the input is silent")
    driven = power > DRIVEN * power.max()
    centres, around = centres[driven], around[driven]
    value = np.empty((y.shape[0], centres.size), complex)
    variance = np.empty((y.shape[0], centres.size))
    errors = np.empty((2 * half + 1, y.shape[0], centres.size), complex)
    for i, row in enumerate(y):
        value[i], variance[i], left, power = _local(u[around], row[around])
        size = np.sqrt(np.mean(np.abs(left) ** 2, axis=1))
        errors[:, i] = left.T * (np.sqrt(variance[i]) / np.maximum(size, 1e-300))
    freedom = 2 * half + 1 - 2 * (ORDER + 1)
    driven_part = np.abs(value) ** 2
    coherence = driven_part / np.maximum(driven_part + freedom * variance, 1e-300)
    made = Frf(
        centres * recording.rate / n, value[:, None], tuple(recording.channels[i] for i in recording.outputs),
        (recording.channels[recording.inputs[0]],), coherence, variance[:, None], float(freedom), "local",
        {"rate": recording.rate, "n_record": n, "half": half, "step": step, "lead": lead},
    )  # fmt: skip
    return made, errors, power


def _mean(frfs: Sequence[Frf], labels: Sequence[str]) -> Frf:
    """Of FRFs on the same lines, weighted by their variances."""
    first = frfs[0]
    if len(frfs) == 1:
        return first
    for one, label in zip(frfs, labels, strict=True):
        if one.settings["n_record"] != first.settings["n_record"] or one.settings["rate"] != first.settings["rate"]:
            raise EstimationError(
                f"{label}: has {one.settings['n_record']} samples at {one.settings['rate']:g} Hz, expected"
                f" {first.settings['n_record']} at {first.settings['rate']:g} Hz as in {labels[0]}"
            )
    lines = frfs[0].frequency
    for one in frfs[1:]:
        lines = np.intersect1d(lines, one.frequency)
    cut = [one.at(np.isin(one.frequency, lines)) for one in frfs]
    weight = np.array([1.0 / np.maximum(np.asarray(one.variance), 1e-300) for one in cut])
    whole = weight.sum(axis=0)
    value = np.sum(weight * np.array([one.value for one in cut]), axis=0) / whole
    n = sum(one.n_averages for one in cut)
    driven_part = np.abs(value[:, 0]) ** 2
    coherence = driven_part / np.maximum(driven_part + n / whole[:, 0], 1e-300)
    return replace(cut[0], value=value, variance=1.0 / whole, coherence=coherence, n_averages=n)


def _local(u: NDArray, y: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """FRF and its variance at the middle of windows (n, 2 half + 1) of spectra, what is left over each window, and
    the power of the input that counts.
    """
    half = u.shape[1] // 2
    r = np.arange(-half, half + 1) / half
    powers = r[:, None] ** np.arange(ORDER + 1)
    plain = np.concatenate([u[:, :, None] * powers, np.broadcast_to(powers, (*u.shape, ORDER + 1))], axis=2)
    value, variance, spread, left = _fitted(plain, y)
    power = np.maximum(spread, 1e-300) / np.maximum(variance, 1e-300)
    whole = np.concatenate([plain, -y[:, :, None] * powers[:, 1:]], axis=2)
    other, other_variance, other_spread, other_left = _fitted(whole, y)
    use = other_spread < BETTER * spread
    left = np.where(use[:, None], other_left, left)
    lucky = use & (other_spread > SURE * spread)
    other_variance = np.where(lucky, other_variance * spread / np.maximum(other_spread, 1e-300), other_variance)
    return np.where(use, other, value), np.where(use, other_variance, variance), left, power


def _fitted(columns: NDArray, y: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Least squares window by window: first coefficient, its variance, variance of what is left, and that itself."""
    scale = np.sqrt(np.sum(np.abs(columns) ** 2, axis=1)) + 1e-300
    q, r = np.linalg.qr(columns / scale[:, None])
    inner = np.einsum("nij,ni->nj", np.conj(q), y)
    left = y - np.einsum("nij,nj->ni", q, inner)
    spread = np.sum(np.abs(left) ** 2, axis=1) / (y.shape[1] - columns.shape[2])
    identity = np.broadcast_to(np.eye(columns.shape[2]), r.shape)
    diagonal = np.abs(np.einsum("njj->nj", r))
    r = np.where((diagonal < 1e-10)[:, :, None] & (identity > 0), 1e-10, r)
    inverse = np.linalg.solve(r, identity.astype(complex))
    value = np.einsum("nj,nj->n", inverse[:, 0], inner) / scale[:, 0]
    return value, spread * np.sum(np.abs(inverse[:, 0]) ** 2, axis=1) / scale[:, 0] ** 2, spread, left
