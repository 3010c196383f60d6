"""Periods and realisations: noise, nonlinear distortion and transient by the analysis of variance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError
from labnnum.periodic import excited_lines
from labnnum.recording import Recording
from labnnum.spectra import line_frequencies, pool
from labnnum.split.base import DISTORTION, EVEN, NOISE, ODD, TRANSIENT, Split, left_of, share_of, solved

SAME = 0.9
"""Match of two inputs, each line as strong as any, above which they are one realisation."""
FEWEST = 4
"""Detection lines of a kind that are needed."""


def split_periods(recordings: Recording | Sequence[Recording], lines: NDArray | None = None) -> Split:
    r"""Noise, nonlinear distortion and transient of periodic excitation, on the excited lines.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        With `period` set, at one level. Of each span the first `drop_periods` periods, one at least where three or more
        are there, are asked for what they hold beyond the later ones. Recordings that play one signal count as one
        realisation.
    lines : array_like of int, optional
        Excited lines, as multiples of rate / period; found from the inputs if not given.

    Returns
    -------
    Split
        Parts "noise" (what differs from steady period to steady period), "nonlinear distortion" (what differs from
        realisation to realisation beyond that; with more realisations than inputs only) and "transient"; beside them
        distortion on odd and even detection lines, as a share of the power of the excited lines around.

    Raises
    ------
    EstimationError
        No period is set or whole, periods differ, no line is excited, or no two steady periods are there.
    ChannelError
        There is no input or no response, or a channel is constant or not finite.

    Notes
    -----
    With H by least squares over the steady periods of all M realisations, e = Y - H U, s the number of steady periods
    and f of first ones, and e_m the mean over the steady periods of realisation m,

    .. math:: W = \sum_{steady} |e - e_m|^2, \quad B = \sum_m s_m |e_m|^2, \quad F = \sum_{first} |e|^2

    add up to the sum of squares that H leaves. Each is a sum of noise, distortion and transient with known weights,
    which are solved for; what ordinary coherence explains more with its own H, fitted to the first periods too, is
    taken off the transient.

    References
    ----------
    Pintelon and Schoukens (2012), System identification, section 4.3.1 (robust method) and 4.3.2 (detection lines).
    """
    batch = pool(recordings)
    ins, outs = list(batch[0].inputs), list(batch[0].outputs)
    if not ins or not outs:
        missing = "an input (role 'reference' or 'base')" if not ins else "a response (role 'response')"
        raise ChannelError(f"{batch[0].label}: no channel is {missing}")
    period = batch[0].period
    other = next((r for r in batch if r.period != period or r.period < 2), None)
    if other is not None:
        raise EstimationError(f"{other.label}: period is {other.period} samples, expected one of 2 or more for all")
    groups = _realisations(batch, ins)
    if len(groups) < len(ins):
        raise EstimationError(f"{batch[0].label}: {len(ins)} inputs need as many realisations; there are {len(groups)}")
    steady_count = np.array([s.shape[0] for _, s in groups])
    if steady_count.max() < 2:
        raise EstimationError(f"{batch[0].label}: no two steady periods are there, so that noise cannot be told")
    first, steady = (np.concatenate([g[i] for g in groups]) for i in (0, 1))
    owner = np.repeat(np.arange(len(groups)), steady_count)
    on = _excited(groups, ins, lines, batch[0].label)
    u, y = (steady[:, rows][:, :, on].transpose(2, 0, 1) for rows in (ins, outs))
    h = solved(u, y)
    e = left_of(u, y, h)
    mean = np.stack([e[:, owner == m].mean(axis=1) for m in range(len(groups))], axis=1)
    within = np.sum(np.abs(e - mean[:, owner]) ** 2, axis=1)
    between = np.einsum("m,fmo->fo", steady_count.astype(float), np.abs(mean) ** 2)
    noise = within / (steady.shape[0] - len(groups))
    own = max(len(groups) - len(ins), 0)
    known = within, between, noise, own
    parts, chance, power = _parts(first[:, ins][:, :, on], first[:, outs][:, :, on], u, y, h, *known, len(groups))
    remarks = []
    if not own:
        remarks.append(
            "Distortion of one realisation repeats with it, so that coherence does not see it: detection lines tell it,"
            " or another realisation at the same level."
        )
    if not first.shape[0]:
        remarks.append("Too few periods were recorded to tell a transient: record three or more.")
    beside, unsure, related = _detected(groups, ins, outs, on, h, power / (first.shape[0] + steady.shape[0]))
    coherence = 1 - np.sum(list(parts.values()), axis=0)
    frequency = line_frequencies(period, batch[0].rate)[on]
    return Split(
        "periods", frequency, tuple(batch[0].channels[o] for o in outs), coherence.T,
        {k: v.T for k, v in parts.items()}, {k: v.T for k, v in beside.items()},
        {k: v.T for k, v in (chance | unsure).items()}, related, remarks=tuple(remarks),
    )  # fmt: skip


def _parts(
    u_first: NDArray, y_first: NDArray, u: NDArray, y: NDArray, h: NDArray, within: NDArray, between: NDArray,
    noise: NDArray, own: int, n_groups: int,
) -> tuple[dict[str, NDArray], dict[str, NDArray], NDArray]:  # fmt: skip
    """Shares (n_f, n_out) that add up to 1 - coherence of all periods, what noise alone makes of each, and the power
    over all periods.
    """
    first, steady = u_first.shape[0], u.shape[1]
    u_first, y_first = u_first.transpose(2, 0, 1), y_first.transpose(2, 0, 1)
    power = np.sum(np.abs(y) ** 2, axis=1) + np.sum(np.abs(y_first) ** 2, axis=1)
    apart = between - own * noise if own else np.zeros(between.shape)
    of_noise = within + between - apart + first * noise
    of_distortion = apart * (1 + first / steady)
    every_u, every_y = np.concatenate([u, u_first], axis=1), np.concatenate([y, y_first], axis=1)
    total = np.sum(np.abs(left_of(every_u, every_y, solved(every_u, every_y))) ** 2, axis=1)
    free = steady - n_groups  # degrees of freedom of the noise
    out, chance = {NOISE: of_noise}, {NOISE: of_noise / np.sqrt(free)}
    if own:
        out[DISTORTION] = of_distortion
        chance[DISTORTION] = (1 + first / steady) * noise * np.sqrt(own + own**2 / free)
    if first:
        out[TRANSIENT] = total - sum(out.values())
        crossed = 2 * first * noise * np.maximum(between, 0) / steady  # noise times what repeats with a realisation
        less = first / steady * noise * np.sqrt(own + own**2 / free)
        chance[TRANSIENT] = np.sqrt(noise**2 * (first + first**2 / free) + crossed + less**2)
    parts, unsure = ({k: share_of(v, power) for k, v in made.items()} for made in (out, chance))
    return parts, unsure, power


def _realisations(batch: Sequence[Recording], ins: list[int]) -> list[tuple[NDArray, NDArray]]:
    """First and steady periods, as spectra (n_periods, n_ch, n_f), of every realisation."""
    groups: list[tuple[list[NDArray], list[NDArray], NDArray]] = []
    for recording in batch:
        for first, steady in _spans(recording):
            told = steady.mean(axis=0)
            for known in groups:
                turned = _turned(told[ins], known[2][ins], recording.period)
                if turned is not None:
                    known[0].append(first * turned)
                    known[1].append(steady * turned)
                    break
            else:
                groups.append(([first], [steady], told))
    if not groups:
        raise EstimationError(f"{batch[0].label}: no whole period of {batch[0].period} samples is there")
    return [(np.concatenate(first), np.concatenate(steady)) for first, steady, _ in groups]


def _spans(recording: Recording) -> list[tuple[NDArray, NDArray]]:
    """First and steady periods of every span that holds a steady one."""
    n, out = recording.period, []
    for start, stop in recording.spans():
        count = (stop - start) // n
        skip = recording.drop_periods or int(count > 2)
        if count <= skip:
            continue
        piece = recording.data[:, start : start + count * n].reshape(-1, count, n).transpose(1, 0, 2)
        spectra = np.fft.rfft(piece, axis=-1) * (2.0 / n)
        out.append((spectra[:skip], spectra[skip:]))
    return out


def _turned(a: NDArray, b: NDArray, n: int) -> NDArray[np.complex128] | None:
    """Factor (n_f,) that turns the spectra `a` of inputs in time onto `b`, shapes (n_in, n_f); None where they are
    other signals.
    """
    strong = np.abs(b) > 0.01 * np.abs(b).max(axis=1, keepdims=True)
    unit = np.where(strong, a.conj() * b / np.maximum(np.abs(a) * np.abs(b), 1e-300), 0.0)
    unit[:, 0] = 0.0
    match = np.fft.irfft(unit.sum(axis=0), n)
    shift = int(np.argmax(match))
    if match[shift] * n / 2 < SAME * np.count_nonzero(unit):
        return None
    return np.exp(-2j * np.pi * np.arange(a.shape[1]) * shift / n)


def _excited(
    groups: Sequence[tuple[NDArray, NDArray]], ins: list[int], lines: NDArray | None, label: str
) -> NDArray[np.intp]:
    """Numbers of the excited lines."""
    n_lines = groups[0][1].shape[2]
    if lines is not None:
        chosen = np.unique(np.asarray(lines, int))
        if not chosen.size or chosen[0] < 0 or chosen[-1] >= n_lines:
            raise EstimationError(f"excited lines must lie between 0 and {n_lines - 1}, one at least")
        return chosen
    common = np.ones(n_lines, bool)
    for _, steady in groups:
        u = steady[:, ins]
        noise = np.var(u, axis=0) / max(len(u) - 1, 1)
        common &= excited_lines(u.mean(axis=0), noise)
    if not common.any():
        raise EstimationError(f"{label}: no line is excited well above the noise in every realisation")
    return np.flatnonzero(common)


def _detected(
    groups: Sequence[tuple[NDArray, NDArray]], ins: list[int], outs: list[int], on: NDArray, h: NDArray, power: NDArray
) -> tuple[dict[str, NDArray], dict[str, NDArray], dict[str, float]]:
    """Distortion on odd and even lines between the excited ones, noise taken out, as shares (n_f, n_out) of the power
    of a period on the excited lines around; what noise alone makes of each; and over how many lines that is correlated.
    """
    quiet = np.setdiff1d(np.arange(on[0], on[-1] + 1), on)
    out, chance, related = {}, {}, {}
    for name, parity in ((ODD, 1), (EVEN, 0)):
        at = quiet[quiet % 2 == parity]
        if at.size < FEWEST:
            continue
        through = np.empty((at.size, len(outs), len(ins)), complex)
        for o in range(len(outs)):
            for i in range(len(ins)):
                row = h[:, o, i]
                through[:, o, i] = np.interp(at, on, row.real) + 1j * np.interp(at, on, row.imag)
        beyond, unsure, weight = np.zeros((at.size, len(outs))), np.zeros((at.size, len(outs))), 0
        for _, steady in groups:
            if len(steady) < 2:
                continue
            u, y = (steady[:, rows][:, :, at].transpose(2, 0, 1) for rows in (ins, outs))
            e = left_of(u, y, through)
            mean = e.mean(axis=1)
            scatter = np.sum(np.abs(e - mean[:, None]) ** 2, axis=1) / (len(steady) - 1)
            beyond += len(steady) * (np.abs(mean) ** 2 - scatter / len(steady))
            unsure += scatter**2 * (1 + 1 / (len(steady) - 1))
            weight += len(steady)
        signal = np.exp([np.interp(at, on, np.log(np.maximum(row, 1e-300))) for row in power.T]).T * weight
        share, spread = share_of(beyond, signal), share_of(np.sqrt(unsure), signal)
        out[name] = np.stack([np.interp(on, at, row) for row in share.T], axis=1)
        chance[name] = np.stack([np.interp(on, at, row) for row in spread.T], axis=1)
        related[name] = max(1.0, on.size / at.size)
    return out, chance, related
