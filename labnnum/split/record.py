"""Noise and sweeps: what leaks, by local functions of the whole record; noise and distortion, by a repeat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate, correlation_lags

from labnnum.errors import ChannelError, EstimationError
from labnnum.local import BETTER, HALF, ORDER
from labnnum.orders import is_sweep
from labnnum.recording import Recording
from labnnum.rest import lead_of, led
from labnnum.spectra import Welch, pool
from labnnum.split.base import (
    BOTH,
    DISTORTION,
    DRIVEN,
    ENDS,
    LEAKAGE,
    NOISE,
    Split,
    left_of,
    share_of,
    solved,
)
from labnnum.windows import window

ALIKE = 0.98
"""Correlation of two inputs above which they are one signal, played twice."""
NEIGHBOURS = 2.0
"""Lines of a segment over which a window relates errors."""
EDGE = 4
"""Parts of a record over which two of one signal must overlap at least: all but one of so many."""


def split_record(recordings: Recording | Sequence[Recording], welch: Welch) -> Split:
    r"""Leakage, and noise with nonlinear distortion, of records that neither repeat nor begin at rest.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        One input, one level. Where two or more play the same signal (at any time after they begin), what differs
        between them tells noise from distortion.
    welch : Welch
        The segments whose ordinary coherence is split; its `detrend` is as that of the estimate.

    Returns
    -------
    Split
        On the segments' lines where the input has power. Parts "leakage" and "noise and nonlinear distortion", or
        instead of the latter "noise" and "nonlinear distortion" where a signal was played twice. Beside them "ends of
        the record": power that the ends of the whole record put in, which a local estimate takes out.

    Raises
    ------
    ChannelError
        There is not one input, or no response, or a channel is constant or not finite.
    EstimationError
        No two segments fit, or the record is too short for the local functions.

    Notes
    -----
    Around every line the spectra of the whole record obey A Y = B U + C + V with polynomials A, B and C of the line
    number (`labnnum.local`). V / A is what no linear structure and no end of a record explains: with S_vv its density
    and n_d effective averages, (1 - 1 / n_d) S_vv / S_yy of 1 - coherence is noise and nonlinear distortion, and the
    rest of it is leakage of the segments. Noise is half of what differs between two plays of one signal, beyond what H
    makes of the difference of their inputs.

    References
    ----------
    McKelvey and Guerin (2012), equation 6; Pintelon and Schoukens (2012), System identification, chapter 7 (local
    polynomial method) and section 2.5 (noise from repeats).
    """
    batch = pool(recordings)
    first = batch[0]
    outs = list(first.outputs)
    if len(first.inputs) != 1 or not outs:
        raise ChannelError(
            f"{first.label}: expected one input and a response, and there are {len(first.inputs)} inputs"
        )
    i = first.inputs[0]
    segments = [_segments(r, welch) for r in batch]
    every = np.concatenate([s for s in segments if s.size])
    spectra = welch(batch)
    lines = np.flatnonzero(_driven(every[:, i]))
    u, y = every[:, [i]][:, :, lines].transpose(2, 0, 1), every[:, outs][:, :, lines].transpose(2, 0, 1)
    h = solved(u, y)
    power = np.sum(np.abs(y) ** 2, axis=1).T
    lost = share_of(np.sum(np.abs(left_of(u, y, h)) ** 2, axis=1).T, power)
    averages = spectra.n_averages
    frequency = spectra.frequency[lines]
    scale = np.sum(window(welch.window, welch.n_segment) ** 2)
    made = [_local(r, frequency, i, outs) for r in batch]
    weight = np.array([n for _, n in made], float)
    density, ends, whole, unsure = (np.tensordot(weight, [m[k] for m, _ in made], 1) / weight.sum() for k in range(4))
    mean = power / every.shape[0]
    both = (1 - 1 / averages) * share_of(density * scale, mean)
    parts, remarks = {BOTH: both}, []
    spacing = float(np.median(weight)) / welch.n_segment  # lines of the record between two of a segment
    free_of_one = 2 * HALF + 1 - 3 * ORDER - 2  # degrees of freedom of a window with a denominator
    free = free_of_one * len(middles(int(spacing))) * len(batch)
    chance = {BOTH: both / np.sqrt(free)}
    many = max(1.0, (2 * HALF + 1) / spacing)
    noise, freedom = _noise_of_repeats(batch, welch, h, lines, i, outs)
    if noise is None:
        remarks.append(
            "One play of a signal cannot tell noise from nonlinear distortion: play the same signal once more at this"
            " level, or a multisine of several periods."
        )
    else:
        own = (1 - 1 / averages) * share_of(noise, mean)
        parts = {NOISE: own, DISTORTION: both - own}
        chance[NOISE] = own / np.sqrt(freedom)
        chance[DISTORTION] = np.sqrt(own**2 / free + chance[NOISE] ** 2)
    if any(is_sweep(r.data[i, a:b]) for r in batch for a, b in r.spans() if b - a > 64):
        remarks.append(
            f"Harmonics of a sweep are no noise: they may count up to {(2 * HALF + 1) / free_of_one:.1f} times as"
            " nonlinear distortion, and what counts too much is missing from leakage. Order by order they are exact."
        )
    parts[LEAKAGE] = lost - both
    chance[LEAKAGE] = np.abs(both) * np.sqrt(1 / free + 1 / max(averages - 1, 1))
    beside = {ENDS: share_of(ends, whole)}
    chance[ENDS] = share_of(unsure / np.sqrt(len(middles(int(spacing))) * len(batch)), whole)
    related = dict.fromkeys((*parts, *beside), max(many, NEIGHBOURS))
    return Split(
        "record", frequency, tuple(first.channels[o] for o in outs), 1 - lost, parts, beside, chance, related,
        remarks=tuple(remarks),
    )  # fmt: skip


def _driven(u: NDArray) -> NDArray[np.bool_]:
    """Lines (n_f,) of segments (n_seg, n_f) on which an input has power; the line at zero is none."""
    power = np.mean(np.abs(u) ** 2, axis=0)
    power[0] = 0.0
    return power > DRIVEN * power.max()


def _segments(recording: Recording, welch: Welch) -> NDArray[np.complex128]:
    """Spectra (n_seg, n_ch, n_f) of the windowed segments of a record."""
    n, shape = welch.n_segment, window(welch.window, welch.n_segment)
    pieces = [
        recording.data[:, at : at + n]
        for start, stop in welch.stretches(recording)
        for at in range(start, stop - n + 1, welch.hop)
    ]
    if not pieces:
        return np.zeros((0, len(recording.channels), n // 2 + 1), complex)
    x = np.array(pieces)
    if welch.detrend != "none":
        x = x - x.mean(axis=-1, keepdims=True)
    if welch.detrend == "linear":
        ramp = np.arange(n) - (n - 1) / 2
        x = x - np.sum(x * ramp, axis=-1, keepdims=True) / (ramp @ ramp) * ramp
    return np.fft.rfft(x * shape, axis=-1)


# -------------------------------------------------------------------- the whole record


def _local(recording: Recording, frequency: NDArray, i: int, outs: list[int]) -> tuple[list[NDArray], int]:
    """Around each of some frequencies, per sample of the record and response (n_out, n_f): power of what the local
    functions leave, of what the ends put in, of the response, and of what noise leaves in the second; and the number of
    samples.
    """
    start, stop = max(recording.spans(), key=lambda span: span[1] - span[0])
    x = recording.data[:, start:stop]
    n = x.shape[1]
    x = led(x - x.mean(axis=1, keepdims=True), lead_of([recording]))
    spectra = np.fft.rfft(x, axis=1)
    last = spectra.shape[1] - 1 - HALF
    centres = np.round(frequency * x.shape[1] / recording.rate).astype(int)
    if last < HALF + 1 or n < 4 * (2 * HALF + 1):
        raise EstimationError(f"{recording.label}: {n} samples are too few for local functions of frequency")
    spacing = int(np.median(np.diff(centres))) if centres.size > 1 else 1
    total = [np.zeros((len(outs), centres.size)) for _ in range(4)]
    places = middles(spacing)
    for place in places:
        around = np.clip(centres + place, HALF + 1, last)[:, None] + np.arange(-HALF, HALF + 1)
        u = spectra[i][around]
        for row, o in enumerate(outs):
            for kept, made in zip(total, _parted(u, spectra[o][around]), strict=True):
                kept[row] += made / (len(places) * n)
    return total, n


WINDOWS = 5
"""Windows of local functions around a line of a segment at most."""


def middles(spacing: int) -> list[int]:
    """Middles of windows that share no line and lie around one of lines `spacing` apart."""
    count = min(max(spacing // (2 * HALF + 1), 1), WINDOWS)
    return [round((k - (count - 1) / 2) * spacing / count) for k in range(count)]


def _parted(u: NDArray, y: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Over windows (n, 2 half + 1), power a line (n,) of V / A; of C / A at the middle without what noise leaves in it;
    of Y; and the power of what noise leaves there.
    """
    r = np.arange(-HALF, HALF + 1) / HALF
    powers = r[:, None] ** np.arange(ORDER + 1)
    ends = np.broadcast_to(powers, (*u.shape, ORDER + 1))
    plain = np.concatenate([ends, u[:, :, None] * powers], axis=2)  # C, B
    whole = np.concatenate([plain, -y[:, :, None] * powers[:, 1:]], axis=2)
    (x_plain, spread_plain, unsure_plain), (x_whole, spread_whole, unsure_whole) = _least(plain, y), _least(whole, y)
    use = spread_whole < BETTER * spread_plain
    below = np.ones(y.shape, complex)
    below[use] += np.einsum("wk,nk->nw", powers[:, 1:], x_whole[use][:, plain.shape[2] :])
    weight = np.mean(np.abs(below) ** 2, axis=1)
    left = np.where(use, spread_whole, spread_plain) / weight
    unsure = np.where(use, unsure_whole, unsure_plain)
    middle = np.abs(np.where(use, x_whole[:, 0], x_plain[:, 0])) ** 2
    whole_power = np.mean(np.abs(y) ** 2, axis=1)
    untold = unsure > whole_power  # at the ends of a band, where input and ends look alike
    return left, np.where(untold, 0.0, middle - unsure), whole_power, np.where(untold, whole_power, unsure)


def _least(columns: NDArray, y: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Least squares window by window: coefficients (n, k), the variance of what is left (n,), and that of the first
    coefficient (n,).
    """
    scale = np.sqrt(np.sum(np.abs(columns) ** 2, axis=1)) + 1e-300
    q, r = np.linalg.qr(columns / scale[:, None])
    inner = np.einsum("nij,ni->nj", np.conj(q), y)
    left = y - np.einsum("nij,nj->ni", q, inner)
    identity = np.broadcast_to(np.eye(r.shape[1]), r.shape)
    small = np.abs(np.einsum("njj->nj", r)) < 1e-10
    inverse = np.linalg.solve(np.where(small[:, :, None] & (identity > 0), 1e-10, r), identity.astype(complex))
    x = np.einsum("nij,nj->ni", inverse, inner) / scale
    spread = np.sum(np.abs(left) ** 2, axis=1) / (y.shape[1] - columns.shape[2])
    return x, spread, spread * np.sum(np.abs(inverse[:, 0]) ** 2, axis=1) / scale[:, 0] ** 2


# -------------------------------------------------------------------- repeats


def _noise_of_repeats(
    batch: Sequence[Recording], welch: Welch, h: NDArray, lines: NDArray, i: int, outs: list[int]
) -> tuple[NDArray[np.float64] | None, int]:
    """Power (n_out, n_f) of the noise in a segment, from records that play one signal, None where there are none; and
    its degrees of freedom.
    """
    groups: list[list[Recording]] = []
    for recording in batch:
        for group in groups:
            cut = _overlapping(group[0], recording, i)
            if cut is not None:
                group.append(cut)
                break
        else:
            groups.append([recording])
    total, freedom = np.zeros((len(outs), lines.size)), 0
    for group in (g for g in groups if len(g) > 1):
        data = [_segments(r, welch)[:, :, lines] for r in group]
        count = min(len(s) for s in data)
        e = [
            left_of(s[:count, [i]].transpose(2, 0, 1), s[:count, outs].transpose(2, 0, 1), h) for s in data
        ]  # (n_f, n_seg, n_out) each
        stack = np.array(e)
        total += np.sum(np.abs(stack - stack.mean(axis=0)) ** 2, axis=(0, 2)).T
        freedom += (len(group) - 1) * count
    return (total / freedom if freedom else None), freedom


def _overlapping(first: Recording, other: Recording, i: int) -> Recording | None:
    """`other` shifted so that its input is in step with that of `first`, with what is missing excluded; None where it
    plays another signal.
    """
    a, b = first.data[i] - first.data[i].mean(), other.data[i] - other.data[i].mean()
    lags = correlation_lags(a.size, b.size)
    lag = int(lags[np.argmax(correlate(a, b, method="fft"))])  # a[t] is as b[t - lag]
    n = a.size
    low, high = max(lag, 0), min(b.size + lag, n)
    if high - low < (EDGE - 1) * min(n, b.size) // EDGE:
        return None
    x, y = a[low:high], b[low - lag : high - lag]
    if x @ y < ALIKE * np.sqrt((x @ x) * (y @ y)):
        return None
    if lag == 0 and b.size == n:
        return other
    data = np.zeros((other.data.shape[0], n))
    data[:, low:high] = other.data[:, low - lag : high - lag]
    return Recording(
        other.channels, data, other.rate, excluded=tuple(s for s in ((0, low), (high, n)) if s[0] < s[1]),
        level=other.level, label=other.label,
    )  # fmt: skip
