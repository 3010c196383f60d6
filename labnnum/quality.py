"""Checks that act: each returns verdicts that name the channel, the band, the likely cause and the remedy.

Coherence and leakage of an FRF, dead or overloaded channels of a recording; the checks of single hammer hits stand
in `labnnum.hammer` and are offered here too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from labnnum.bands import Band
from labnnum.errors import BandError
from labnnum.frf import Frf
from labnnum.hammer import (
    HitSettings,
    best_hits,
    consistency_verdicts,
    find_pulse,
    force_reach,
    further_pulses,
    hit_transforms,
    hit_verdicts,
    overload_verdict,
    pairwise_coherence,
    signal_verdict,
)
from labnnum.leakage import WindowView, modal_frf
from labnnum.recording import Recording
from labnnum.verdict import Verdict

__all__ = [
    "HitSettings", "Resonance", "Verdict", "best_hits", "coherence_verdicts", "consistency_verdicts", "find_pulse",
    "force_reach", "further_pulses", "hit_transforms", "hit_verdicts", "leakage_verdicts", "overload_verdict",
    "pairwise_coherence", "recording_verdicts", "resonances", "signal_verdict",
]  # fmt: skip

WEAK_INPUT = 1e-3
"""Input density in a band, over its strongest elsewhere, from which excitation counts as low (-30 dB)."""

PEAK_LOSS = 0.05
"""Share by which leakage may lower a resonance peak."""

WIDE = 6.0
"""Half-power width in lines from which a window hardly widens a peak."""

SIDES = [0, 1, 3, 4]
"""Of five lines around a peak those beside it."""


def coherence_verdicts(frf: Frf, threshold: float, bands: Sequence[Band] = ()) -> list[Verdict]:
    """Mean coherence of each response in each band (or everywhere) against a threshold, with the likely cause.

    Parameters
    ----------
    frf : Frf
    threshold : float
        Between 0 and 1.
    bands : sequence of Band

    Returns
    -------
    list of Verdict
        One for each response and band; a single one, not ok, if coherence says nothing: after a single average,
        or where none came with imported FRFs.

    Raises
    ------
    BandError
        A band holds no line of the FRF.
    """
    silent = _no_coherence(frf, threshold)
    if silent is not None:
        return [silent]
    assert frf.coherence is not None
    ranges = [(b.low, b.high) for b in bands] or [(float(frf.frequency[0]), float(frf.frequency[-1]))]
    verdicts = []
    for low, high in ranges:
        mask = (frf.frequency >= low) & (frf.frequency <= high)
        if not mask.any():
            raise BandError(
                f"band {low:g} to {high:g} Hz holds no line of the FRF"
                f" ({frf.frequency[0]:g} to {frf.frequency[-1]:g} Hz)"
            )
        mean = frf.coherence[:, mask].mean(axis=1)
        for row, channel in enumerate(frf.outputs):
            name, where = channel.name, f"{low:g} to {high:g} Hz"
            if mean[row] >= threshold:
                reason = f"coherence of {name!r} from {where}: {mean[row]:.3f}"
                verdicts.append(Verdict("coherence", True, float(mean[row]), threshold, reason, name))
                continue
            cause = _cause(frf, row, mask, mean < threshold)
            reason = f"coherence of {name!r} from {where} is {mean[row]:.3f} < {threshold:g}: {cause}"
            verdicts.append(Verdict("coherence", False, float(mean[row]), threshold, reason, name))
    return verdicts


def _no_coherence(frf: Frf, threshold: float) -> Verdict | None:
    nan = float("nan")
    if frf.n_averages <= max(1, len(frf.inputs)):
        count = (
            "a single average" if frf.n_averages <= 1 else f"{frf.n_averages:g} averages of {len(frf.inputs)} inputs"
        )
        reason = f"{count}: coherence is 1 whatever the data; average more segments or hits"
        return Verdict("coherence", False, nan, threshold, reason)
    if frf.coherence is None:
        reason = f"this FRF ({frf.estimator}) carries no coherence; estimate it from recordings"
        return Verdict("coherence", False, nan, threshold, reason)
    if not np.isfinite(frf.coherence).all():
        return Verdict("coherence", False, nan, threshold, "the coherence is not finite; estimate the FRF again")
    return None


def _cause(frf: Frf, row: int, mask: NDArray, low: NDArray) -> str:
    """The likely cause of low coherence of response `row` on the lines of `mask`."""
    weak = _weak_input(frf, mask)
    if weak:
        return weak
    assert frf.coherence is not None
    lost = np.where(mask, 1 - frf.coherence[row], 0.0)
    leaky = [r for r in resonances(frf, row) if not r.ok and mask[r.line]]
    near = np.zeros(mask.size, bool)
    for r in leaky:
        near[max(0, r.line - 3) : r.line + 4] = True
    if leaky and lost[near].sum() > 0.5 * lost.sum():
        return "leakage at a resonance, " + leaky[int(np.argmax([lost[r.line] for r in leaky]))].text()
    size = np.abs(frf.value[row, :, mask]).max(axis=1)
    whole = np.abs(frf.value[row]).max(axis=0)
    small = size < max(0.1 * np.median(whole), 0.02 * whole.max())
    if lost[mask][small].sum() > 0.5 * lost.sum():
        return "the response is small here (antiresonance or below its noise); a more sensitive sensor helps"
    if low.all() and low.size > 1:
        return "every response shares it: noise on the force, a further input that is not measured, or nonlinearity"
    if low.size > 1:
        return "other responses are better: noise of this channel (cable, range, mounting)"
    return "noise of this channel, a further input that is not measured, or nonlinearity"


def _weak_input(frf: Frf, mask: NDArray) -> str:
    if frf.input_spectrum is None:
        return ""
    for k, channel in enumerate(frf.inputs):
        density = np.real(frf.input_spectrum[k, k])
        inside, strongest = float(np.median(density[mask])), float(density.max())
        if inside < WEAK_INPUT * strongest:
            below = 10 * np.log10(strongest / inside) if inside > 0 else np.inf
            return (
                f"low excitation: {channel.name!r} lies {below:.0f} dB under its strongest here;"
                " extend the excitation's band, or use a harder tip"
            )
    return ""


@dataclass(frozen=True)
class Resonance:
    """A resonance of one response, its true width as far as the window lets it show, and what leakage costs.

    Parameters
    ----------
    frequency : float
        Hz, of the largest line.
    line : int
        Its number in the FRF.
    bandwidth : float
        Estimated half-power bandwidth, in lines, with the window's own width taken out.
    peak : float
        Share of the true peak that the estimate shows.
    n_segment : int
        Samples of the segment that made it, 0 if unknown.
    needed : int
        Samples that lower the peak by `PEAK_LOSS` at most.
    """

    frequency: float
    line: int
    bandwidth: float
    peak: float
    n_segment: int
    needed: int

    @property
    def ok(self) -> bool:
        """Whether leakage lowers the peak by no more than `PEAK_LOSS`."""
        return self.peak >= 1 - PEAK_LOSS

    def text(self) -> str:
        """What was found and the remedy, in a line."""
        found = f"{self.frequency:.5g} Hz: {self.bandwidth:.2g} lines per half-power bandwidth, the peak reads"
        return f"{found} {1 - self.peak:.0%} low; raise n_segment from {self.n_segment} to {self.needed} or more"


def leakage_verdicts(frf: Frf, bands: Sequence[Band] = ()) -> list[Verdict]:
    """Lines per half-power bandwidth at every clear resonance, with the n_segment that would be enough.

    FRFs whose window is unknown, and those from whole periods, whole bursts or hits, which do not leak that way, give
    an empty list.
    """
    verdicts = []
    for row, channel in enumerate(frf.outputs):
        name = channel.name
        for r in resonances(frf, row):
            if bands and not any(r.frequency in b for b in bands):
                continue
            fine = f"{r.frequency:.5g} Hz: {r.bandwidth:.2g} lines per half-power bandwidth"
            reason = f"{name!r} at {fine if r.ok else r.text()}"
            verdicts.append(Verdict("leakage", r.ok, r.bandwidth, _enough(frf.settings["window"]), reason, name))
    return verdicts


def resonances(frf: Frf, row: int, prominence: float = 8.0) -> list[Resonance]:
    """Clear resonances of response `row`: peaks of the FRF that rise by `prominence` dB above noise and surroundings.

    A narrow peak is compared, by its highest line and two to either side, with one mode of known bandwidth and place
    between the lines seen through the same window; that gives the bandwidth also where the window hides most of it.
    Of a wide peak the half-power width is used.
    """
    name, n = frf.settings.get("window"), frf.settings.get("n_segment")
    whole = any(frf.settings.get(key) for key in ("periodic", "burst", "transient"))
    if whole or not isinstance(name, str) or not n or frf.frequency.size < 16:
        return []
    step = frf.settings["rate"] / n
    if not np.allclose(np.diff(frf.frequency), step, rtol=1e-6):
        return []
    size = np.abs(frf.value[row]).max(axis=0)
    level = 20 * np.log10(np.maximum(size, 1e-300 + 1e-12 * size.max()))
    enough = _enough(name)
    found = []
    for line in find_peaks(level, prominence=prominence)[0]:
        seen = _bandwidth(name, size, int(line))
        if seen is None:
            continue
        lines, share = seen
        needed = int(2 ** np.ceil(np.log2(n * enough / lines))) if lines < enough else int(n)
        found.append(Resonance(float(frf.frequency[line]), int(line), lines, share, int(n), needed))
    return found


def _bandwidth(name: str, size: NDArray, line: int) -> tuple[float, float] | None:
    """Own half-power bandwidth in lines, and share of the peak that is left, of the peak at `line`."""
    table = _modes(name)
    width = _half_power_width(size, line)
    if np.isfinite(width) and width > WIDE:
        lines = float(np.interp(width, table.width, table.bandwidth))
        return lines, float(np.interp(lines, table.bandwidth, table.peak))
    if not 2 <= line < size.size - 2:
        return None
    around = np.log(np.maximum(size[line - 2 : line + 3], 1e-300) / size[line])
    if around[1] > around[3]:
        around = around[::-1]
    best = int(np.argmin(np.sum((table.shape - around[SIDES]) ** 2, axis=1)))
    return float(table.shape_bandwidth[best]), float(table.shape_peak[best])


@lru_cache(maxsize=16)
def _enough(name: str) -> float:
    """Bandwidth in lines from which leakage lowers a peak by `PEAK_LOSS` at most."""
    table = _modes(name)
    return float(np.interp(1 - PEAK_LOSS, table.peak, table.bandwidth))


def _half_power_width(size: NDArray, line: int) -> float:
    """Width in lines between the points at 1/sqrt(2) of the peak; NaN if the peak does not fall so far."""
    level = size[line] / np.sqrt(2)
    left = np.flatnonzero(size[:line] < level)
    right = np.flatnonzero(size[line:] < level)
    if not left.size or not right.size:
        return float("nan")
    a, b = int(left[-1]), line + int(right[0])
    below = a + (level - size[a]) / (size[a + 1] - size[a])
    above = b - (level - size[b]) / (size[b - 1] - size[b])
    return float(above - below)


@dataclass(frozen=True, eq=False)
class _Modes:
    """One mode behind a window: width and share of the peak left over bandwidth (n,), and the five lines' shapes."""

    bandwidth: NDArray
    width: NDArray
    peak: NDArray
    shape: NDArray
    shape_bandwidth: NDArray
    shape_peak: NDArray


@lru_cache(maxsize=16)
def _modes(name: str) -> _Modes:
    """Modes of many bandwidths (in lines) at several places between two lines, seen through a window."""
    n, centre = 256, 64.0
    bandwidth = np.geomspace(0.05, 24, 49)
    offsets = np.linspace(0.0, 0.5, 6)
    lines = np.arange(24, 105)
    width, peak = np.empty((bandwidth.size, offsets.size)), np.empty((bandwidth.size, offsets.size))
    shape = np.empty((bandwidth.size, offsets.size, len(SIDES)))
    for refine, chosen in ((64, bandwidth < 0.5), (16, bandwidth >= 0.5)):
        view = WindowView(name, n, float(n), refine, lines=lines)
        for k in np.flatnonzero(chosen):
            poles = 2 * np.pi * (-bandwidth[k] / 2 + 1j * (centre + offsets))
            for m, pole in enumerate(poles):
                model = modal_frf(np.array([pole]), np.array([-1j]))
                size = np.abs(view.apply(model(view.frequency)))
                line = int(np.argmax(size))
                width[k, m] = _half_power_width(size, line)
                peak[k, m] = min(1.0, size[line] / abs(model(np.array([centre + offsets[m]]))[0]))
                around = np.log(size[line - 2 : line + 3] / size[line])
                shape[k, m] = (around[::-1] if around[1] > around[3] else around)[SIDES]
    return _Modes(
        bandwidth, np.maximum.accumulate(width.mean(axis=1)), np.maximum.accumulate(peak.mean(axis=1)),
        shape.reshape(-1, len(SIDES)), np.repeat(bandwidth, offsets.size), peak.reshape(-1),
    )  # fmt: skip


def recording_verdicts(recording: Recording, full_scale: dict[str, float] | None = None) -> list[Verdict]:
    """For every channel whether it is finite and alive and stays within its range; what is excluded is not judged.

    Parameters
    ----------
    recording : Recording
        Its `overloads`, as the instrument reported them, count too.
    full_scale : dict of str to float, optional
        End of range of channels in SI units, where known.
    """
    known = full_scale or {}
    keep = np.zeros(recording.n_samples, bool)
    for start, stop in recording.spans():
        keep[start:stop] = True
    verdicts = []
    for row, channel in enumerate(recording.channels):
        signal = recording.data[row][keep]
        if not signal.size:
            reason = f"{channel.name} has no sample that is not excluded"
            verdicts.append(Verdict("signal", False, 0.0, 1.0, reason, channel.name))
            continue
        alive = signal_verdict(signal, channel.name)
        verdicts.append(alive)
        if not alive.ok:
            continue
        reported = [(a, b) for c, a, b in recording.overloads if c == row and keep[a:b].any()]
        if reported:
            total = sum(b - a for a, b in reported)
            at = reported[0][0] / recording.rate
            reason = f"{channel.name} was overloaded for {total} samples, first at {at:.4g} s; lower its gain"
            verdicts.append(Verdict("overload", False, float(total), 0.0, reason, channel.name))
        else:
            verdicts.append(overload_verdict(signal, channel.name, known.get(channel.name), recording.rate))
    return verdicts
