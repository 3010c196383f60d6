"""Hammer hits: noise before the blow, scatter between hits, and what still rings at the end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError
from labnnum.hits import Hits, gate
from labnnum.recording import Recording
from labnnum.spectra import line_frequencies, pool
from labnnum.split.base import (
    ALL,
    DRIVEN,
    NOISE,
    RINGING,
    SCATTER,
    Split,
    left_of,
    share_of,
    solved,
)
from labnnum.windows import exponential_window

BEGINS, FEWEST = 0.02, 12
"""Part of a blow's peak at which it has begun, and samples before it that tell the noise at least."""
QUARTERS = 4
"""Parts of what comes after the blow of which the last two tell how it rings on."""
CLEAR = 4.0
"""Times the noise that the last part must hold for its ringing to count."""


def split_hits(recordings: Recording | Sequence[Recording], hits: Hits) -> Split:
    """Noise, and what differs from hit to hit, of hammer hits; beside them what the end of the record cuts off.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        One input; each span between breaks is a hit. Two hits at least.
    hits : Hits
        As they enter the estimate: length, gate of the force, exponential window.

    Returns
    -------
    Split
        Parts "noise" (white, as loud as before the blow) and "scatter between hits" (where they fell, and how hard: a
        structure that changes with level scatters too), or both in one where too little was recorded before the blow.
        Beside them "ringing on past the end", the energy that was cut off over that of the response: hits share it,
        so that coherence does not see it.

    Raises
    ------
    ChannelError
        There is not one input, or no response, or a channel is constant or not finite.
    EstimationError
        There are fewer than two hits, or they have unlike lengths.

    References
    ----------
    Bendat and Piersol (2010), Random data, section 6.2 (what lowers coherence); Pintelon and Schoukens (2012), System
    identification, section 2.6 (what the ends of a record leave).
    """
    batch = pool(recordings)
    first = batch[0]
    if len(first.inputs) != 1 or not first.outputs:
        raise ChannelError(
            f"{first.label}: expected one input and a response, and there are {len(first.inputs)} inputs"
        )
    pieces = [r.data[:, a:b] for r in batch for a, b in r.spans()]
    if len(pieces) < 2:
        raise EstimationError(f"{first.label}: one hit has coherence 1 whatever the data; two are needed")
    n = hits.n_segment or min(p.shape[1] for p in pieces)
    rows = [first.inputs[0], *first.outputs]
    kept = tuple(first.channels[r] for r in rows)
    x = np.array([hits.prepare(p[rows], kept, first.rate, n) for p in pieces])
    spectra = np.fft.rfft(x, axis=-1)
    power = np.mean(np.abs(spectra[:, 0]) ** 2, axis=0)
    power[0] = 0.0
    lines = np.flatnonzero(power > DRIVEN * power.max())
    u, y = spectra[:, [0]][:, :, lines].transpose(2, 0, 1), spectra[:, 1:][:, :, lines].transpose(2, 0, 1)
    h = solved(u, y)
    whole = np.sum(np.abs(y) ** 2, axis=1).T
    lost = share_of(np.sum(np.abs(left_of(u, y, h)) ** 2, axis=1).T, whole)
    floor, samples = _floor(pieces, rows, hits, first.rate, n)
    remarks, common = [], {}
    if floor is None:
        parts, chance = {ALL: lost}, {ALL: lost / np.sqrt(len(pieces) - 1)}
        remarks.append(
            f"Fewer than {FEWEST} samples were recorded before the blow, so that noise cannot be told from what differs"
            " between hits: record longer before the trigger."
        )
    else:
        white = floor[1:, None] + np.abs(h[:, :, 0].T) ** 2 * floor[0]
        noise = share_of((1 - 1 / len(pieces)) * white * len(pieces), whole)
        parts, free = {NOISE: noise, SCATTER: lost - noise}, len(pieces) - 1
        chance = {NOISE: np.zeros(noise.shape), SCATTER: noise * np.sqrt(1 / free)}
        common = dict.fromkeys((NOISE, SCATTER), noise * np.sqrt(2 / samples))
    ringing, unsure = _ringing(x, lines, None if floor is None else floor[1:])
    return Split(
        "hits", line_frequencies(n, first.rate)[lines], kept[1:], 1 - lost, parts, {RINGING: ringing},
        chance | {RINGING: unsure}, {RINGING: 2.0 * QUARTERS}, common=common, remarks=tuple(remarks),
    )  # fmt: skip


def _floor(
    pieces: Sequence[NDArray], rows: Sequence[int], hits: Hits, rate: float, n: int
) -> tuple[NDArray[np.float64] | None, int]:
    """Power a line of the noise of every row (n_rows,) as it enters a transform, None where too little tells it; and
    how many samples do.
    """
    variance, weight, shape, samples = [], [], exponential_window(n, rate, hits.decay) ** 2, 0
    for piece in pieces:
        force = piece[rows[0]] - np.median(piece[rows[0]])
        begin = int(np.argmax(np.abs(force) > BEGINS * np.abs(force).max())) * 2 // 3
        if begin < FEWEST:
            return None, 0
        samples += begin
        variance.append(np.var(piece[list(rows)][:, :begin], axis=1, ddof=1))
        passed = np.ones(n)
        if hits.force_gate:
            passed[: min(n, piece.shape[1])] = gate(piece[rows[0], :n], rate, *hits.force_gate)[:n] ** 2
        weight.append([np.sum(shape * passed), *[float(shape[: piece.shape[1]].sum())] * (len(rows) - 1)])
    return np.mean(np.array(variance) * np.array(weight), axis=0), samples


def _ringing(x: NDArray, lines: NDArray, floor: NDArray | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Energy (n_out, n_f) that a response would still have sent after the end, over that of the response, from how it
    fell over the last two quarters after the blow; and what noise alone makes of it.
    """
    n = x.shape[2]
    blow = int(np.median(np.argmax(np.abs(x[:, 0]), axis=1)))
    length = (n - blow) // QUARTERS
    out = np.zeros((x.shape[1] - 1, lines.size))
    if length < 2 * QUARTERS:
        return out, out
    taper = np.hanning(length + 2)[1:-1]
    taper /= np.sqrt(np.mean(taper**2))
    y = np.pad(x[:, 1:], ((0, 0), (0, 0), (length, length)))

    def power(first: int) -> NDArray[np.float64]:
        return np.mean(np.abs(np.fft.rfft(y[:, :, first : first + length] * taper, axis=-1)) ** 2, axis=0)

    hop = max(length // QUARTERS, 1)
    whole = sum(power(a) for a in range(0, n + length - hop + 1, hop)) * (hop / length)
    before, last = power(n - length), power(n)
    noise = np.zeros((out.shape[0], 1)) if floor is None else floor[:, None] * (length / n)
    fall = np.clip(share_of(np.maximum(last - noise, 0), np.maximum(before - noise, 1e-300)), 1e-9, 0.999)
    # an exponential of which the taper shows the middle: what follows the end, over the power shown
    rest = np.where(last > CLEAR * noise, (last - noise) * np.sqrt(fall) / -np.log(fall), 0.0)
    at = np.arange(length // 2 + 1) * (n / length)
    unsure = out.copy()
    for o in range(out.shape[0]):
        out[o] = np.interp(lines, at, share_of(rest[o], whole[o]))
        unsure[o] = np.interp(lines, at, share_of(noise[o], whole[o])) / np.sqrt(len(x))
    return out, unsure
