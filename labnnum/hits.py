"""Spectra of hammer hits: one segment a hit, with the force gated and an exponential window recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.recording import Channel, Recording
from labnnum.spectra import CrossSum, Pairs, Spectra, Welch, line_frequencies, pool, pulse_place
from labnnum.windows import exponential_window, force_window


@dataclass(frozen=True)
class Hits:
    r"""Spectra of hammer hits, one segment a hit; call it with a recording whose hits are separated by breaks.

    Parameters
    ----------
    n_segment : int or None
        Samples of each hit that are used; None takes the shortest hit's.
    decay : float
        Decay rate, in 1/s, of an exponential window on force and response alike; it moves every pole by -decay,
        is recorded as "window_decay", and `labnnum.windows.added_damping` says what to take out again.
    force_gate : (before, after) or None
        Seconds of the force kept before and after its largest sample; outside it the force is set to zero.
    pretrigger : int
        Samples before the pulse whose mean is each channel's zero; 0 takes nothing out.
    pad : bool
        Fill a hit that is shorter than n_segment with zeros instead of raising.
    pairs : {"inputs", "all"}
        As for `Welch`.

    Notes
    -----
    The densities are the energy of a hit per Hz divided by its duration n_segment / rate, so that they compare
    with Welch's; FRFs do not depend on it.
    """

    n_segment: int | None = None
    decay: float = 0.0
    force_gate: tuple[float, float] | None = None
    pretrigger: int = 0
    pad: bool = False
    pairs: Pairs = "inputs"

    def __call__(self, recordings: Recording | Sequence[Recording]) -> Spectra:
        """Spectra averaged over every hit of every recording."""
        batch = pool(recordings)
        hits = [r.data[:, a:b] for r in batch for a, b in r.spans()]
        n = self._length([h.shape[1] for h in hits], batch[0].label)
        channels, rate = batch[0].channels, batch[0].rate
        rows = [i for i, c in enumerate(channels) if c.role != "monitor"]
        kept = tuple(channels[i] for i in rows)
        inputs = [i for i, c in enumerate(kept) if c.role in ("reference", "base")]
        total = CrossSum(len(kept), inputs if self.pairs == "inputs" and inputs else range(len(kept)), n // 2 + 1)
        for hit in hits:
            total.add(np.fft.rfft(self.prepare(hit[rows], kept, rate, n), axis=-1)[:, None], kept)
        settings = Welch(n, "boxcar", 0.0, "none").settings(rate)
        place = self.pretrigger or pulse_place(batch, n, n) or 0
        settings |= {"window_decay": float(self.decay), "transient": True, "pretrigger": int(place)}
        if self.force_gate:
            settings["force_gate"] = tuple(self.force_gate)
        cross = total.density(len(hits), rate * n, n, kept)
        return Spectra(line_frequencies(n, rate), cross, kept, float(len(hits)), len(hits), settings)

    def _length(self, lengths: Sequence[int], label: str) -> int:
        if not lengths:
            raise EstimationError(f"{label}: there is no hit: every sample is excluded")
        shortest, longest = min(lengths), max(lengths)
        if self.n_segment is None:
            if 2 * shortest < longest:
                raise EstimationError(
                    f"{label}: hit {lengths.index(shortest) + 1} has {shortest} samples, others {longest};"
                    " exclude it or give n_segment"
                )
            return shortest
        if self.n_segment < 2:
            raise EstimationError(f"n_segment is {self.n_segment}: it must be 2 samples or more")
        if self.n_segment > shortest and not self.pad:
            raise EstimationError(
                f"{label}: n_segment {self.n_segment} is longer than hit {lengths.index(shortest) + 1} of {shortest}"
                " samples; lower n_segment or set pad"
            )
        return self.n_segment

    def prepare(self, hit: NDArray, channels: Sequence[Channel], rate: float, n: int) -> NDArray[np.float64]:
        """One hit as it enters the transform: zeroed, gated, windowed, padded to n samples, shape (n_ch, n)."""
        signal = np.array(hit[:, :n], float)
        if self.pretrigger:
            signal -= signal[:, : self.pretrigger].mean(axis=1, keepdims=True)
        if self.force_gate:
            for row, channel in zip(signal, channels, strict=True):
                if channel.role == "reference":
                    row *= gate(row, rate, *self.force_gate)
        signal *= exponential_window(signal.shape[1], rate, self.decay)
        return np.pad(signal, ((0, 0), (0, n - signal.shape[1])))


def gate(force: NDArray, rate: float, before: float, after: float) -> NDArray[np.float64]:
    """Force window around the largest sample of `force`, from `before` to `after` seconds around it, shape (n,)."""
    peak = int(np.argmax(np.abs(force)))
    start, stop = peak - round(before * rate), peak + round(after * rate) + 1
    taper = max(1, round(after * rate / 8))
    return force_window(force.size, max(0, start), min(force.size, stop), taper)
