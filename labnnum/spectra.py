"""Averaged auto- and cross-spectra: Welch's method, streaming, and one segment per hammer hit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError
from labnnum.recording import Channel, Recording
from labnnum.windows import effective_averages, window

Pairs = Literal["inputs", "all"]
Detrend = Literal["constant", "linear", "none"]
GROUP_BYTES = 2 << 20
"""Segments are transformed in groups of about this size, which a processor's cache holds."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Averaged one-sided spectral densities of all channels, kept with how they were made.

    Parameters
    ----------
    frequency : ndarray, shape (n_f,)
        Hz, from 0.
    cross : ndarray, shape (n_ch, n_ch, n_f)
        cross[i, j] is the average of conj(X_i) X_j, in unit_i unit_j / Hz; the autospectra stand on the
        diagonal. Pairs that were not asked for (`Welch.pairs`) hold NaN.
    channels : tuple of Channel
    n_averages : float
        Effective number of independent averages.
    n_segments : int
        Segments that were averaged.
    settings : mapping
        As `labnnum.frf.Frf.settings`.
    """

    frequency: NDArray[np.float64]
    cross: NDArray[np.complex128]
    channels: tuple[Channel, ...]
    n_averages: float
    n_segments: int
    settings: dict[str, Any] = field(default_factory=dict)

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
        known = ", ".join(c.name for c in self.channels)
        raise ChannelError(f"the spectra have no channel {name!r}; there are {known}")

    def auto(self, name: str | int) -> NDArray[np.float64]:
        """Autospectral density of one channel, unit^2/Hz, shape (n_f,)."""
        row = name if isinstance(name, int) else self.index(name)
        return self.cross[row, row].real


class Processor(Protocol):
    """What turns recordings into spectra: `Welch`, `Hits`, or the user's own."""

    def __call__(self, recordings: Recording | Sequence[Recording], /) -> Spectra:
        """Spectra averaged over all recordings."""
        ...


@dataclass(frozen=True)
class Welch:
    r"""Welch's averaged spectra; call it with a recording, or several, to get `Spectra`.

    Segments never cross a break or an excluded range of a recording, and any block size that a stream arrives
    in gives the same bits as one pass.

    Under a boxcar whole periods of a periodic recording, and whole bursts, do not leak: each stretch loses its
    `drop_periods`, or what comes before its first burst, and the settings say "periodic" or "burst".

    Parameters
    ----------
    n_segment : int
        Samples in a segment; lines are rate / n_segment apart.
    window : str
        One of `labnnum.windows.WINDOWS`.
    overlap : float
        Share of a segment that the next one repeats, 0 <= overlap < 1.
    detrend : {"constant", "linear", "none"}
        What is taken out of each segment before it is windowed.
    pairs : {"inputs", "all"}
        Which cross-spectra are averaged: those with the inputs (references and base), which FRFs need, or
        all. The others hold NaN. Without an input all are.

    Raises
    ------
    EstimationError
        A setting is impossible, no segment fits, or a single segment is to be averaged under a tapered
        window (with "boxcar", as for one transient, one segment is allowed and has no coherence).
    ChannelError
        A channel is constant or not finite; or the recordings' channels differ.

    Notes
    -----
    .. math:: S_{ij}(f) = \frac{2}{r \sum_n w_n^2} \frac{1}{K} \sum_k \overline{X_{i,k}(f)} X_{j,k}(f)

    with half of that at 0 and at half the sample rate r.

    References
    ----------
    Welch (1967); Bendat and Piersol (2010), section 11.5.

    Examples
    --------
    >>> import numpy as np
    >>> noise = np.random.default_rng(0).standard_normal((1, 8192))
    >>> s = Welch(256)(Recording((Channel("f", "force", "reference"),), noise, rate=512.0))
    >>> s.n_segments, round(s.n_averages, 1)
    (63, 59.7)
    """

    n_segment: int
    window: str = "hann"
    overlap: float = 0.5
    detrend: Detrend = "constant"
    pairs: Pairs = "inputs"

    def __post_init__(self) -> None:
        if not isinstance(self.n_segment, int | np.integer) or self.n_segment < 2:
            raise EstimationError(f"n_segment is {self.n_segment!r}: it must be a whole number of samples, 2 or more")
        if not 0 <= self.overlap < 1:
            raise EstimationError(f"overlap is {self.overlap}: it must be 0 or more and less than 1")
        if self.detrend not in ("constant", "linear", "none"):
            raise EstimationError(f"detrend is {self.detrend!r}: it must be 'constant', 'linear' or 'none'")
        if self.pairs not in ("inputs", "all"):
            raise EstimationError(f"pairs is {self.pairs!r}: it must be 'inputs' or 'all'")
        window(self.window, 1)

    @property
    def hop(self) -> int:
        """Samples from the start of one segment to the next."""
        return max(1, round(self.n_segment * (1 - self.overlap)))

    def settings(self, rate: float) -> dict[str, Any]:
        """The settings as `Spectra` and `Frf` carry them."""
        return {
            "window": self.window, "n_segment": int(self.n_segment), "overlap": float(self.overlap),
            "rate": float(rate), "detrend": self.detrend, "window_decay": 0.0,
        }  # fmt: skip

    def start(self, channels: Sequence[Channel], rate: float) -> Accumulator:
        """A running average for a stream of blocks of `channels`, in SI units, at `rate` samples per second."""
        return Accumulator(self, channels, rate)

    def __call__(self, recordings: Recording | Sequence[Recording]) -> Spectra:
        """Spectra averaged over every segment of every recording."""
        batch = pool(recordings)
        self._require_stretch(batch)
        running = self.start(batch[0].channels, batch[0].rate)
        for recording in batch:
            for start, stop in self.stretches(recording):
                running.add(recording.data[:, start:stop])
                running.gap()
        self._require_segments(running, batch)
        spectra = running.spectra()
        return replace(spectra, settings=spectra.settings | self._without_leakage(batch))

    def stretches(self, recording: Recording) -> Iterator[tuple[int, int]]:
        """Sample ranges (start, stop) that segments are cut from: spans past their transient, from a burst's start."""
        for start, stop in recording.spans():
            if self._repeats(recording):
                start += recording.drop_periods * recording.period
            elif self._bursts(recording):
                start = next((at for at in recording.bursts if at >= start), stop)
            if start < stop:
                yield start, stop

    def _repeats(self, recording: Recording) -> bool:
        """Whether every segment holds whole periods and nothing shapes it."""
        period = recording.period
        return self.window == "boxcar" and period > 0 and self.n_segment % period == 0

    def _bursts(self, recording: Recording) -> bool:
        """Whether every segment holds whole bursts with their silence."""
        burst = recording.burst
        return self.window == "boxcar" and burst > 0 and self.n_segment % burst == 0 and self.hop % burst == 0

    def _without_leakage(self, batch: Sequence[Recording]) -> dict[str, Any]:
        """What the settings say where the segments' ends cut nothing off, or only the decay of a hit."""
        if all(self._repeats(r) for r in batch):
            return {"periodic": True}
        if all(self._bursts(r) for r in batch):
            return {"burst": True}
        pulse = pulse_place(batch, self.n_segment, self.hop) if self.window == "boxcar" else None
        return {} if pulse is None else {"transient": True, "pretrigger": pulse}

    def _longest(self, batch: Sequence[Recording]) -> int:
        """Samples of the longest stretch."""
        return max((b - a for r in batch for a, b in self.stretches(r)), default=0)

    def _require_stretch(self, batch: Sequence[Recording]) -> None:
        longest, first = self._longest(batch), batch[0]
        if longest >= self.n_segment:
            return
        if self._repeats(first) and first.drop_periods:
            raise EstimationError(
                f"{first.label}: no span holds a segment of {self.n_segment} samples after its {first.drop_periods}"
                " transient periods; record longer or lower drop_periods"
            )
        if self._bursts(first):
            raise EstimationError(
                f"{first.label}: no span holds a segment of {self.n_segment} samples from the start of a burst;"
                " record longer"
            )
        raise EstimationError(
            f"{first.label}: n_segment {self.n_segment} is longer than the longest unbroken stretch of {longest}"
            f" samples; lower n_segment to {max(2, longest // 8)} or less"
        )

    def _require_segments(self, running: Accumulator, batch: Sequence[Recording]) -> None:
        if running.n_segments >= (1 if self.window == "boxcar" else 2):
            return
        raise EstimationError(
            f"{batch[0].label}: only one segment of {self.n_segment} fits, and one average has no coherence and no"
            f" error; lower n_segment to {max(2, self._longest(batch) // 8)} or less, or record longer"
        )


@lru_cache(maxsize=32)
def _window_of(name: str, n: int) -> NDArray[np.float64]:
    shape = window(name, n)
    shape.flags.writeable = False
    return shape


class Accumulator:
    """Running Welch average of a stream; `add` blocks of any size, `gap` where the stream is broken.

    Segments are transformed in groups whose borders depend on their place in the stream only, so that block
    sizes leave no trace in the result.
    """

    def __init__(self, welch: Welch, channels: Sequence[Channel], rate: float) -> None:
        self._welch = welch
        self._rate = float(rate)
        self._all = tuple(channels)
        self._rows = [i for i, c in enumerate(channels) if c.role != "monitor"]
        self.channels = tuple(self._all[i] for i in self._rows)
        if not self.channels:
            raise ChannelError("there is no channel to estimate from: all are monitors")
        inputs = [i for i, c in enumerate(self.channels) if c.role in ("reference", "base")]
        self._inputs = inputs if welch.pairs == "inputs" and inputs else list(range(len(self.channels)))
        n, count = int(welch.n_segment), len(self.channels)
        self._group = max(1, GROUP_BYTES // (8 * n * count))
        self._need = n + (self._group - 1) * welch.hop
        self._work = np.empty((count, self._group, n))
        self._pending = np.empty((count, self._need))
        self._fill = 0
        self._lines = np.empty((count, self._group, n // 2 + 1), complex)
        self._sum = CrossSum(count, self._inputs, n // 2 + 1)
        self._runs: list[int] = []
        self._run = 0

    @property
    def n_segments(self) -> int:
        """Whole segments so far; `spectra` averages all of them, those too that still wait for their group."""
        return sum(self._runs) + self._run + self._waiting

    def add(self, block: NDArray) -> None:
        """Continue the stream with samples of all channels, shape (n_channels, any), in SI units."""
        block = np.asarray(block)
        if block.ndim != 2 or block.shape[0] != len(self._all):
            raise ChannelError(f"a block of shape {block.shape} does not fit {len(self._all)} channels")
        at, total = 0, block.shape[1]
        step = self._group * self._welch.hop
        while self._fill + total - at >= self._need:
            if self._fill:
                at += self._take(block, at, self._need - self._fill)
                self._average(self._pending, None, self._group, self._sum)
                self._fill = self._need - step
                self._pending[:, : self._fill] = self._pending[:, step:].copy()
            else:
                self._average(block[:, at : at + self._need], self._rows, self._group, self._sum)
                at += step
            self._run += self._group
        if at < total:
            self._take(block, at, total - at)

    def _take(self, block: NDArray, at: int, count: int) -> int:
        self._pending[:, self._fill : self._fill + count] = block[self._rows, at : at + count]
        self._fill += count
        return count

    def gap(self) -> None:
        """Note that what comes next does not continue what came before: no segment will span the two."""
        self._run += self._rest(self._sum)
        if self._run:
            self._runs.append(self._run)
        self._run = 0
        self._fill = 0

    @property
    def _waiting(self) -> int:
        return max(0, (self._fill - int(self._welch.n_segment)) // self._welch.hop + 1)

    def _rest(self, into: CrossSum) -> int:
        waiting = self._waiting
        if waiting:
            self._average(self._pending[:, : self._fill], None, waiting, into)
        return waiting

    def _average(self, stretch: NDArray, rows: list[int] | None, count: int, into: CrossSum) -> None:
        n, hop = int(self._welch.n_segment), self._welch.hop
        segments = np.lib.stride_tricks.sliding_window_view(stretch, n, axis=-1)[:, ::hop][:, :count]
        work, lines = self._work[:, :count], self._lines[:, :count]
        if rows is not None and len(rows) < len(self._all):
            segments = segments[rows]
        shape = _window_of(self._welch.window, n)
        for signal, out in zip(segments, work, strict=True):
            remove_trend(signal, self._welch.detrend, out)
            out *= shape
        into.add(transform(work, lines), self.channels)

    def spectra(self) -> Spectra:
        """Spectra of all whole segments so far; the stream may go on afterwards."""
        total = self._sum.copy()
        runs = [*self._runs, self._run + self._rest(total)]
        n, hop = int(self._welch.n_segment), self._welch.hop
        shape = _window_of(self._welch.window, n)
        if not sum(runs):
            raise EstimationError(f"no segment of n_segment {n} samples is complete yet")
        return Spectra(
            frequency=line_frequencies(n, self._rate),
            cross=total.density(sum(runs), self._rate * float(shape @ shape), n, self.channels),
            channels=self.channels,
            n_averages=effective_averages(shape, hop, [k for k in runs if k]),
            n_segments=sum(runs),
            settings=self._welch.settings(self._rate),
        )


class CrossSum:
    """Sum of conj(X_i) X_j over segments, for chosen i and all j, and of all |X_j|^2."""

    def __init__(self, count: int, rows: Sequence[int], n_lines: int) -> None:
        self.rows = list(rows)
        self.rest = [j for j in range(count) if j not in self.rows]
        self.order = [*self.rows, *self.rest]
        self.total = np.zeros((len(self.rows), count, n_lines), complex)
        self.auto = np.zeros((len(self.rest), 2 * n_lines))
        self._scratch = np.empty((2, 0, n_lines), complex)

    def copy(self) -> CrossSum:
        """An independent copy."""
        twin = CrossSum(len(self.order), self.rows, self.total.shape[-1])
        twin.total, twin.auto = self.total.copy(), self.auto.copy()
        return twin

    def add(self, lines: NDArray[np.complex128], channels: Sequence[Channel]) -> None:
        """Add segments, shape (n_ch, n_segments, n_f); ChannelError where one is not finite."""
        bad = ~np.isfinite(lines[:, :, 0].real.sum(axis=1))
        if bad.any():
            name = channels[int(np.flatnonzero(bad)[0])].name
            raise ChannelError(f"channel {name!r} holds NaN or infinity; exclude that stretch of the recording")
        if self._scratch.shape[1:] != lines.shape[1:]:
            self._scratch = np.empty((2, *lines.shape[1:]), complex)
        first, product = self._scratch
        for k, row in enumerate(self.rows):
            np.conjugate(lines[row], out=first)
            for col in self.order[k:]:
                _add_sum(np.multiply(lines[col], first, out=product), self.total[k, col])
        for k, row in enumerate(self.rest):
            parts = lines[row].view(float)
            _add_sum(np.multiply(parts, parts, out=product.view(float)), self.auto[k])

    def density(self, count: int, power: float, n: int, channels: Sequence[Channel]) -> NDArray[np.complex128]:
        """One-sided densities, shape (n_ch, n_ch, n_f), NaN where no sum was kept."""
        size, n_lines = len(self.order), self.total.shape[-1]
        scale = np.full(n_lines, 2.0 / (power * count))
        scale[0] /= 2
        if n % 2 == 0:
            scale[-1] /= 2
        cross = np.empty((size, size, n_lines), complex)
        cross[np.ix_(self.rest, self.rest)] = np.nan
        for k, row in enumerate(self.rows):
            for col in self.order[k:]:
                np.multiply(self.total[k, col], scale, out=cross[row, col])
                np.conjugate(cross[row, col], out=cross[col, row])
            cross[row, row].imag = 0
        for k, row in enumerate(self.rest):
            cross[row, row] = self.auto[k].reshape(-1, 2).sum(axis=1) * scale
        for row, channel in enumerate(channels):
            if not cross[row, row, 1:].any():
                raise ChannelError(f"channel {channel.name!r} is constant; is its sensor connected?")
        return cross


def _add_sum(rows: NDArray, total: NDArray) -> None:
    """Add the sum of rows to total; may overwrite the rows."""
    if len(rows) > 8:
        total += np.add.reduce(rows, axis=0)
        return
    for row in rows[1:]:
        rows[0] += row
    total += rows[0]


_IN_PLACE = np.lib.NumpyVersion(np.__version__) >= "2.0.0"


def transform(segments: NDArray, out: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Real transforms along the last axis, written to `out`: fresh memory for each group costs more than the FFT."""
    if _IN_PLACE:
        return np.fft.rfft(segments, axis=-1, out=out)
    out[...] = np.fft.rfft(segments, axis=-1)
    return out


def line_frequencies(n: int, rate: float) -> NDArray[np.float64]:
    """Frequencies in Hz of the lines of n samples, shape (n // 2 + 1,)."""
    return np.asarray(np.arange(n // 2 + 1) * (rate / n), float)


def remove_trend(segments: NDArray, kind: Detrend, out: NDArray) -> None:
    """Write segments without their mean, or without their straight line, to `out`; along the last axis."""
    if kind == "none":
        out[...] = segments
        return
    np.subtract(segments, segments.mean(axis=-1, keepdims=True), out=out)
    if kind == "linear":
        n = out.shape[-1]
        ramp = np.arange(n) - (n - 1) / 2
        slope = np.sum(out * ramp, axis=-1, keepdims=True) / (ramp @ ramp)
        out -= slope * ramp


def pulse_place(batch: Sequence[Recording], n: int, hop: int) -> int | None:
    """Samples before the pulse, if every segment's inputs are one short pulse (19/20 of the energy in an eighth)."""
    places = []
    for recording in batch:
        for start, stop in recording.spans():
            for at in range(start, stop - n + 1, hop):
                for row in recording.inputs:
                    signal = recording.data[row, at : at + n] - np.median(recording.data[row, at : at + n])
                    peak = int(np.argmax(np.abs(signal)))
                    near = signal[max(0, peak - n // 16) : peak + n // 16 + 1]
                    if near @ near < 0.95 * (signal @ signal):
                        return None
                    places.append(peak)
    return min(places, default=None)


def pool(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    """Recordings as a list; an error if none, if channels or rates differ, or one is constant or not finite."""
    batch = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not batch:
        raise EstimationError("there is no recording to estimate from")
    first = batch[0]
    for other in batch:
        if not _alike(other.channels, first.channels):
            raise ChannelError(f"{other.label}: its channels differ from those of {first.label}; average them apart")
        if other.rate != first.rate:
            raise EstimationError(
                f"{other.label}: rate {other.rate:g} Hz differs from {first.rate:g} Hz of {first.label}"
            )
        _require_alive(other)
    return batch


def _alike(channels: Sequence[Channel], others: Sequence[Channel]) -> bool:
    """Whether channels hold the same signals, however their sensors were calibrated."""
    return [c.signal for c in channels] == [c.signal for c in others]


def _require_alive(recording: Recording) -> None:
    spans = list(recording.spans())
    for channel, row in zip(recording.channels, recording.data, strict=True):
        if channel.role == "monitor" or not spans:
            continue
        for start, stop in spans:
            if not np.isfinite(row[start:stop].sum()) and not np.isfinite(row[start:stop]).all():
                at = start + int(np.flatnonzero(~np.isfinite(row[start:stop]))[0])
                raise ChannelError(
                    f"{recording.label}: channel {channel.name!r} is not finite at sample {at};"
                    " exclude that stretch of the recording"
                )
        value = row[spans[0][0]]
        if all(_is_constant(row[a:b], value) for a, b in spans):
            raise ChannelError(
                f"{recording.label}: channel {channel.name!r} is constant ({value:g}); is its sensor connected?"
            )


def _is_constant(row: NDArray, value: float) -> bool:
    return not (row[:256] != value).any() and not (row != value).any()
