"""Estimates from periodic excitation: mean over periods, noise per line, and distortion over realisations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording
from labnnum.spectra import line_frequencies, pool

EXCITED_SHARE = 0.03
"""A line is excited if its amplitude reaches this share of the largest within `NEIGHBOURS` lines, and that one the
same share of the largest of all."""

NEIGHBOURS = 8

EXCITED_SNR = 20.0
"""... and its power this multiple of the noise, averaged over as many neighbours."""


@dataclass(frozen=True, eq=False)
class PeriodicSpectra:
    """The mean period of every channel as complex amplitudes, with the noise that the periods' scatter shows.

    Parameters
    ----------
    frequency : ndarray, shape (n_f,)
        Hz: multiples of rate / period, from 0.
    spectrum : ndarray, shape (n_ch, n_f)
        Complex amplitudes: a cosine of amplitude A and phase p is A exp(ip); the line at 0 holds the mean.
        Phase counts from the start of the first usable period.
    noise_variance : ndarray, shape (n_ch, n_f)
        E|noise|^2 of `spectrum`, that is, of the mean; NaN from a single period.
    noise_covariance : ndarray, shape (n_ch, n_ch, n_f)
        E[noise_i conj(noise_j)] of `spectrum`; its diagonal is `noise_variance`.
    n_periods : int
        Periods averaged.
    channels : tuple of Channel
    rate : float
        Samples per second.
    period : int
        Samples.
    level : float
        As the recording's.
    label : str
    """

    frequency: NDArray[np.float64]
    spectrum: NDArray[np.complex128]
    noise_variance: NDArray[np.float64]
    noise_covariance: NDArray[np.complex128]
    n_periods: int
    channels: tuple[Channel, ...]
    rate: float
    period: int
    level: float = float("nan")
    label: str = "recording"

    @property
    def inputs(self) -> tuple[int, ...]:
        """Rows of the references and base motions."""
        return tuple(i for i, c in enumerate(self.channels) if c.role in ("reference", "base"))

    @property
    def outputs(self) -> tuple[int, ...]:
        """Rows of the responses."""
        return tuple(i for i, c in enumerate(self.channels) if c.role == "response")

    def index(self, name: str) -> int:
        """Row of the channel called `name`; ChannelError listing what there is."""
        for i, channel in enumerate(self.channels):
            if channel.name == name:
                return i
        raise ChannelError(f"{self.label}: no channel {name!r}; there are {', '.join(c.name for c in self.channels)}")

    def mean_period(self) -> NDArray[np.float64]:
        """The mean period in time, shape (n_ch, period), in the channels' units."""
        scaled = self.spectrum * (self.period / 2)
        scaled[:, 0] *= 2
        if self.period % 2 == 0:
            scaled[:, -1] *= 2
        return np.fft.irfft(scaled, self.period, axis=-1)

    def excited(self) -> NDArray[np.bool_]:
        """Lines that the inputs drive on purpose, shape (n_f,): see `excited_lines`."""
        rows = list(self.inputs)
        return excited_lines(self.spectrum[rows], self.noise_variance[rows])


def periodic_spectra(recording: Recording) -> PeriodicSpectra:
    r"""Mean period of every channel (monitors too) and the noise of that mean, from the scatter of the periods.

    Each contiguous span loses its first `drop_periods` periods; further spans are aligned with the first by the
    circular shift that matches their input, since a gap may have lost any number of samples.

    Parameters
    ----------
    recording : Recording
        With `period` set.

    Raises
    ------
    EstimationError
        The recording has no period, no whole period is left, or its spans hold different periodic signals.
    ChannelError
        A channel is constant or not finite.

    Notes
    -----
    .. math:: \bar X = \frac{1}{P} \sum_p X_p, \quad
       \hat\sigma^2_{\bar X} = \frac{1}{P (P - 1)} \sum_p |X_p - \bar X|^2

    References
    ----------
    Pintelon and Schoukens (2012), System identification, section 2.5.

    Examples
    --------
    >>> t = np.arange(64)
    >>> force = Channel("f", "force", "reference")
    >>> r = Recording((force,), 3 * np.cos(2 * np.pi * 2 * t / 16)[None], rate=16.0, period=16)
    >>> s = periodic_spectra(r)
    >>> s.n_periods, float(round(abs(s.spectrum[0, 2]), 12))
    (4, 3.0)
    """
    pool(recording)
    periods = _periods(recording)
    n = recording.period
    transforms = np.fft.rfft(periods, axis=-1) * (2.0 / n)
    transforms[..., 0] /= 2
    if n % 2 == 0:
        transforms[..., -1] /= 2
    mean = transforms.mean(axis=0)
    count = transforms.shape[0]
    scatter = transforms - mean
    if count > 1:
        covariance = np.einsum("pif,pjf->ijf", scatter, scatter.conj()) / (count * (count - 1))
    else:
        covariance = np.full((mean.shape[0], *mean.shape), np.nan + 0j)
    return PeriodicSpectra(
        frequency=line_frequencies(n, recording.rate),
        spectrum=mean,
        noise_variance=np.einsum("iif->if", covariance).real.copy(),
        noise_covariance=covariance,
        n_periods=count,
        channels=recording.channels,
        rate=recording.rate,
        period=n,
        level=recording.level,
        label=recording.label,
    )


def _periods(recording: Recording) -> NDArray[np.float64]:
    n, skip = recording.period, recording.drop_periods
    if n < 2:
        raise EstimationError(
            f"{recording.label}: period is {n} samples: set the period of the excitation, or use H1(Welch(...))"
        )
    pieces: list[NDArray] = []
    for start, stop in recording.spans():
        count = (stop - start) // n - skip
        if count < 1:
            continue
        first = start + skip * n
        piece = recording.data[:, first : first + count * n].reshape(-1, count, n).transpose(1, 0, 2)
        pieces.append(_aligned(piece, pieces[0], recording) if pieces else piece)
    if not pieces:
        raise EstimationError(
            f"{recording.label}: no span holds {skip + 1} periods of {n} samples"
            f" (drop_periods {skip}); record longer or lower drop_periods"
        )
    return np.concatenate(pieces)


def _aligned(piece: NDArray, first: NDArray, recording: Recording) -> NDArray:
    """`piece` rolled so that its inputs match those of `first`; both (n_periods, n_ch, period)."""
    rows = list(recording.inputs) or list(range(piece.shape[1]))
    a = np.fft.rfft(first[:, rows].mean(axis=0), axis=-1)
    b = np.fft.rfft(piece[:, rows].mean(axis=0), axis=-1)
    a[:, 0] = b[:, 0] = 0
    power = np.sqrt(np.sum(np.abs(a) ** 2, axis=1) * np.sum(np.abs(b) ** 2, axis=1))
    match = np.fft.irfft(np.sum(a * b.conj() / power[:, None], axis=0), recording.period)
    shift = int(np.argmax(match))
    full = match[shift] * recording.period / (2 * len(rows))
    if full < 0.8:
        raise EstimationError(
            f"{recording.label}: its spans hold different periodic signals (they match to {max(full, 0):.0%});"
            " make each realisation a recording of its own"
        )
    return np.roll(piece, shift, axis=-1)


def excited_lines(amplitude: NDArray, noise_variance: NDArray) -> NDArray[np.bool_]:
    """Lines driven on purpose, shape (n_f,), told from detection lines, from pick-up out of the band and from noise.

    A line counts if any input drives it: with an amplitude of `EXCITED_SHARE` or more of the largest within
    `NEIGHBOURS` lines, which itself is as large a share of the largest of all, and with `EXCITED_SNR` times the
    noise. The line at 0 never does. Give the lines yourself where the excitation falls by more than 30 dB.

    Parameters
    ----------
    amplitude, noise_variance : ndarray, shape (n_in, n_f)
    """
    from scipy.ndimage import maximum_filter1d, uniform_filter1d

    size = np.abs(amplitude).astype(float)
    size[:, 0] = 0
    width = 2 * NEIGHBOURS + 1
    around = maximum_filter1d(size, width, axis=-1, mode="nearest")
    clear = (size >= EXCITED_SHARE * around) & (around >= EXCITED_SHARE * size.max(axis=-1, keepdims=True))
    noise = uniform_filter1d(np.nan_to_num(noise_variance), width, axis=-1, mode="nearest")
    return ((size > 0) & clear & (size**2 >= EXCITED_SNR * noise)).any(axis=0)


@dataclass(frozen=True, eq=False)
class RobustFrf:
    """FRFs from periodic realisations, with what is noise and what is nonlinear distortion told apart.

    Parameters
    ----------
    frf : Frf
        The mean over realisations; its variance is the total one (noise and stochastic distortion).
    noise_variance : ndarray, shape (n_out, n_in, n_f)
        E|dH|^2 of the mean by noise alone; NaN from single periods.
    distortion_variance : ndarray, shape (n_out, n_in, n_f)
        E|dH|^2 of *one* realisation by stochastic nonlinear distortion, 0 where the noise explains all;
        NaN from a single realisation.
    realisations : tuple of PeriodicSpectra
    """

    frf: Frf
    noise_variance: NDArray[np.float64]
    distortion_variance: NDArray[np.float64]
    realisations: tuple[PeriodicSpectra, ...]


def periodic(recordings: Recording | Sequence[Recording], lines: NDArray | None = None) -> Frf:
    """FRFs on the excited lines of periodic excitation, with variance per line; see `robust`.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Each a realisation at the same level, with `period` set; as many as inputs at least.
    lines : array_like of int, optional
        Excited lines, as multiples of rate / period; found from the inputs if not given.
    """
    return robust(recordings, lines).frf


def robust(recordings: Recording | Sequence[Recording], lines: NDArray | None = None) -> RobustFrf:
    r"""FRFs from periodic realisations by the robust method: noise and nonlinear distortion per line.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Realisations (other random phases, same level and amplitudes) with `period` set.
    lines : array_like of int, optional
        Excited lines, as multiples of rate / period; found from the inputs if not given.

    Returns
    -------
    RobustFrf
        `frf.coherence` is what the same number of averages with this variance would show, None where no
        variance is known (one period of one realisation).

    Raises
    ------
    EstimationError
        Levels, periods or excited lines differ, there are fewer realisations than inputs, or no line is excited.

    Notes
    -----
    With one input, over M realisations of P periods,

    .. math:: G = \frac{1}{M} \sum_m Y_m / U_m, \quad
       \sigma^2_{tot} = \frac{\sum_m |Y_m/U_m - G|^2}{M (M - 1)}, \quad
       \sigma^2_{NL} = M (\sigma^2_{tot} - \sigma^2_n)

    and the noise of each realisation from the periods' scatter,
    sigma_n^2 = (s_Y^2 + |G|^2 s_U^2 - 2 Re(s_YU conj(G))) / |U|^2. With several inputs G is the least squares
    solution over realisations, line by line.

    References
    ----------
    Pintelon and Schoukens (2012), System identification, section 4.3.1.
    """
    batch = pool(recordings)
    _require_alike(batch)
    spectra = tuple(periodic_spectra(r) for r in batch)
    ins, outs = list(spectra[0].inputs), list(spectra[0].outputs)
    if not ins or not outs:
        missing = "an input (role 'reference' or 'base')" if not ins else "a response (role 'response')"
        raise ChannelError(f"{batch[0].label}: no channel is {missing}")
    if len(batch) < len(ins):
        raise EstimationError(
            f"{len(ins)} inputs need at least {len(ins)} realisations as separate recordings; there are {len(batch)}"
        )
    chosen = _chosen_lines(spectra, lines)
    u = np.stack([s.spectrum[ins][:, chosen] for s in spectra])
    y = np.stack([s.spectrum[outs][:, chosen] for s in spectra])
    value, inverse = _solve(u, y)
    noise = _noise_variance(spectra, value, inverse, chosen)
    total, distortion = _scatter(u, y, value, inverse, noise)
    return RobustFrf(_frf(spectra, chosen, value, total, u), noise, distortion, spectra)


def _require_alike(batch: Sequence[Recording]) -> None:
    first = batch[0]
    for other in batch[1:]:
        if other.period != first.period:
            raise EstimationError(f"{other.label}: period {other.period} differs from {first.period} of {first.label}")
        if np.isfinite(first.level) and np.isfinite(other.level) and other.level != first.level:
            raise EstimationError(
                f"{other.label}: level {other.level:g} differs from {first.level:g} of {first.label}; average each"
                " level on its own"
            )


def _chosen_lines(spectra: Sequence[PeriodicSpectra], lines: NDArray | None) -> NDArray[np.intp]:
    n_lines = spectra[0].frequency.size
    if lines is not None:
        chosen = np.unique(np.asarray(lines, int))
        if not chosen.size or chosen[0] < 0 or chosen[-1] >= n_lines:
            raise EstimationError(f"excited lines must lie between 0 and {n_lines - 1}, one at least")
        return chosen
    common = np.logical_and.reduce([s.excited() for s in spectra])
    if not common.any():
        raise EstimationError(
            f"{spectra[0].label}: no line is excited well above the noise in every realisation; is the period"
            f" {spectra[0].period} samples?"
        )
    return np.flatnonzero(common)


def _solve(u: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """G (n_out, n_in, n_f) and each realisation's weights W (n_f, M, n_in), G = sum_m Y_m W_m."""
    if u.shape[1] == 1:
        if not np.abs(u).all():
            raise EstimationError("an input has no amplitude on a chosen line")
        weights = (1 / (u[:, 0] * u.shape[0])).T[:, :, None]
    else:
        stacked = u.transpose(2, 1, 0)
        if np.linalg.cond(stacked).max() > 1e8:
            raise EstimationError("the realisations' inputs are linearly dependent: give each input its own phases")
        weights = np.linalg.pinv(stacked)
    return np.einsum("mof,fmi->oif", y, weights), weights


def _noise_variance(
    spectra: Sequence[PeriodicSpectra], value: NDArray, weights: NDArray, chosen: NDArray
) -> NDArray[np.float64]:
    ins, outs = list(spectra[0].inputs), list(spectra[0].outputs)
    total = np.zeros(value.shape)
    for m, s in enumerate(spectra):
        c = s.noise_covariance[..., chosen]
        residual = np.stack([c[o, o].real for o in outs])
        residual = residual - 2 * np.einsum("oif,oif->of", value.conj(), c[np.ix_(outs, ins)]).real
        residual = residual + np.einsum("oif,ijf,ojf->of", value, c[np.ix_(ins, ins)], value.conj()).real
        total += np.maximum(residual, 0)[:, None] * np.abs(weights[:, m].T[None]) ** 2
    return total


def _scatter(
    u: NDArray, y: NDArray, value: NDArray, weights: NDArray, noise: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Total variance of the mean, and the distortion's of one realisation."""
    count, n_in = u.shape[:2]
    if count <= n_in:
        return noise, np.full(noise.shape, np.nan)
    if n_in == 1:
        each = y / u[:, :1] - value[:, 0]
        total = (np.sum(np.abs(each) ** 2, axis=0) / (count * (count - 1)))[:, None]
    else:
        left = y - np.einsum("oif,mif->mof", value, u)
        power = np.sum(np.abs(left) ** 2, axis=0) / (count - n_in)
        total = power[:, None] * np.sum(np.abs(weights) ** 2, axis=1).T[None]
    return total, np.maximum(count * (total - np.nan_to_num(noise)), 0)


def _frf(spectra: Sequence[PeriodicSpectra], chosen: NDArray, value: NDArray, variance: NDArray, u: NDArray) -> Frf:
    first = spectra[0]
    ins = list(first.inputs)
    averages = float(sum(s.n_periods for s in spectra))
    known = np.isfinite(variance).all()
    step = first.rate / first.period
    return Frf(
        frequency=first.frequency[chosen],
        value=value,
        outputs=tuple(first.channels[o] for o in first.outputs),
        inputs=tuple(first.channels[i] for i in ins),
        coherence=_equivalent_coherence(value, variance, averages) if known else None,
        variance=variance if known else None,
        n_averages=averages,
        estimator="periodic",
        settings={
            "window": "boxcar", "n_segment": first.period, "overlap": 0.0, "rate": first.rate, "window_decay": 0.0,
            "periodic": True, "n_realisations": len(spectra),
        },
        input_spectrum=np.einsum("mif,mjf->ijf", u.conj(), u) / (2 * step * len(spectra)),
        input_condition=None if len(ins) == 1 else np.linalg.cond(u.transpose(2, 1, 0)),
    )  # fmt: skip


def _equivalent_coherence(value: NDArray, variance: NDArray, averages: float) -> NDArray[np.float64]:
    """Coherence at which `averages` averages have this variance, the worst over inputs, shape (n_out, n_f)."""
    size = np.abs(value) ** 2
    noise = averages * variance
    share = np.divide(size, size + noise, out=np.zeros(size.shape), where=size + noise > 0)
    return share.min(axis=1)
