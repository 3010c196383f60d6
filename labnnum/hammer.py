"""Checks of single hammer hits: double hits, overload, level, reach of the force, decay, and mutual coherence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import fftconvolve, find_peaks

from labnnum.clipping import clipped_runs, noise_level, runs
from labnnum.errors import EstimationError
from labnnum.verdict import Verdict

MARGIN = 0.65
"""A further pulse is called a hit from this share of `HitSettings.second_hit`: noise and width blur its size."""

OUTLIER = 5.5
"""Standard deviations of the filtered noise that a further pulse must exceed."""

SHORT = 0.55
"""A further pulse is also looked for with the main one shortened to this share: it may be another contact."""

RINGING = 0.7
"""A pulse beside which the force swings below zero by this share of it is ringing."""


@dataclass(frozen=True)
class HitSettings:
    """What a hit is held against.

    Parameters
    ----------
    second_hit : float
        A further pulse of this share of the largest makes a double hit.
    force_range : (low, high)
        Acceptable peak force, N.
    reach : float
        Frequency in Hz up to which the force must excite; 0 does not ask.
    reach_drop : float
        dB by which the force spectrum may have dropped there.
    settled : float
        Share of its peak that a response may still have in the last twentieth of the record; with an
        exponential window (`decay`) after it is applied.
    decay : float
        1/s, of the exponential window that will be used.
    full_scale : mapping of str to float
        End of range of channels, by name, in SI units, where known.
    """

    second_hit: float = 0.2
    force_range: tuple[float, float] = (0.0, float("inf"))
    reach: float = 0.0
    reach_drop: float = 20.0
    settled: float = 0.05
    decay: float = 0.0
    full_scale: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0 < self.second_hit < 1:
            raise EstimationError(f"second_hit is {self.second_hit}: it must lie between 0 and 1")
        if not 0 <= self.force_range[0] < self.force_range[1]:
            raise EstimationError(f"force_range {self.force_range} is empty: it needs 0 <= low < high, in N")


@dataclass(frozen=True)
class Pulse:
    """The main pulse of a hit: sample of its peak, sample range, peak (with sign), and noise of the force."""

    at: int
    start: int
    stop: int
    peak: float
    noise: float

    @property
    def length(self) -> int:
        """Samples in which the force exceeds a tenth of its peak."""
        return self.stop - self.start


def find_pulse(force: ArrayLike) -> Pulse:
    """The largest pulse of a force record, from where it exceeds a tenth of its peak to where it no longer does.

    Examples
    --------
    >>> f = np.zeros(100)
    >>> f[20:25] = [1, 3, 4, 2, 1]
    >>> find_pulse(f).length
    5
    """
    f = np.asarray(force, float)
    f = f - np.median(f)
    at = int(np.argmax(np.abs(f)))
    peak = float(f[at])
    above = np.abs(f) * (np.sign(f) == np.sign(peak)) >= 0.1 * abs(peak)
    start, stop = next((a, b) for a, b in runs(above) if a <= at < b) if peak else (at, at + 1)
    return Pulse(at, start, stop, peak, noise_level(f))


def further_pulses(force: ArrayLike, second_hit: float = 0.2) -> list[tuple[int, float]]:
    r"""Pulses besides the largest: (sample, share of the largest) of each, an empty list for a clean hit.

    Parameters
    ----------
    force : array_like, shape (n,)
        Force of one hit.
    second_hit : float
        Share of the largest pulse that must be found; what reaches `MARGIN` of it is listed.

    Notes
    -----
    Apart from the main pulse p the force is matched with p itself, which suppresses ringing of the sensor
    above the pulse's own frequencies and averages noise:

    .. math:: a(\tau) = \sum_t f(t + \tau)\, p(t) / \sum_t p^2(t)

    a is the size of a second pulse of the same shape (and of the same shape, shortened). It must stand out of
    the record's own noise as well, and have no swing of like size below zero beside it, as ringing has.
    A bump that merges with the main pulse counts if it rises by the same share from the valley between.

    Examples
    --------
    >>> t = np.arange(400)
    >>> bump = lambda at: np.where(abs(t - at) < 8, np.cos(np.pi * (t - at) / 16), 0)
    >>> further_pulses(bump(50)), len(further_pulses(bump(50) + 0.3 * bump(120)))
    ([], 1)
    """
    f = np.asarray(force, float)
    pulse = find_pulse(f)
    if not pulse.peak:
        return []
    f = (f - np.median(f)) / pulse.peak
    limit = MARGIN * second_hit
    found = _merged(f, pulse, limit)
    rest = f.copy()
    rest[_flanks(f, pulse)] = 0.0
    template = f[pulse.start : pulse.stop]
    found += _matched(rest, template, pulse, limit)
    if template.size >= 4:
        short = np.interp(np.linspace(0, template.size - 1, round(SHORT * template.size)), _index(template), template)
        found += _matched(rest, short, pulse, limit)
    return _distinct(found, template.size)


def _index(row: NDArray) -> NDArray[np.float64]:
    return np.arange(row.size, dtype=float)


def _flanks(f: NDArray, pulse: Pulse) -> slice:
    """The main pulse with its flanks, down to where they stop falling."""
    start, stop = pulse.start, pulse.stop
    while start > 0 and 0 < f[start - 1] < f[start]:
        start -= 1
    while stop < f.size and 0 < f[stop] < f[stop - 1]:
        stop += 1
    return slice(start, stop)


def _matched(rest: NDArray, template: NDArray, pulse: Pulse, limit: float) -> list[tuple[int, float]]:
    """Pulses of the template's shape in what the main pulse leaves; ringing, which swings below too, is no pulse."""
    size = fftconvolve(rest, template[::-1], mode="same") / (template @ template)
    away = np.ones(size.size, bool)
    away[max(0, pulse.start - pulse.length) : pulse.stop + pulse.length] = False
    spread = 1.4826 * np.median(np.abs(size[away])) if np.count_nonzero(away) > 16 else 0.0
    padded = np.concatenate([[0.0], size, [0.0]])
    peaks, _ = find_peaks(padded, height=max(limit, OUTLIER * spread), distance=max(1, template.size // 2))
    lead = template.size // 2 - int(np.argmax(template))
    reach = 2 * template.size
    found = []
    for peak in peaks - 1:
        around = size[max(0, peak - reach) : peak + reach + 1]
        if around.min() > -max(RINGING * size[peak], OUTLIER * spread):
            found.append((int(peak - lead), float(size[peak])))
    return found


def _distinct(found: list[tuple[int, float]], length: int) -> list[tuple[int, float]]:
    """The same pulses, each once: of those closer than a pulse's length the first found is kept."""
    kept: list[tuple[int, float]] = []
    for at, share in found:
        if all(abs(at - other) >= length for other, _ in kept):
            kept.append((at, share))
    return sorted(kept)


def _merged(f: NDArray, pulse: Pulse, limit: float) -> list[tuple[int, float]]:
    """Bumps inside the main pulse, after light smoothing."""
    body = f[max(0, pulse.start - 2) : pulse.stop + 2]
    width = max(1, round(0.15 * pulse.length))
    smooth = np.convolve(body, np.ones(width) / width, mode="same").clip(0)
    blur = OUTLIER * pulse.noise / abs(pulse.peak) / np.sqrt(width)
    rise = max(limit, blur)
    peaks, how = find_peaks(np.concatenate([[0.0], smooth, [0.0]]), prominence=rise)
    order = np.argsort(how["prominences"])[:-1]
    return [(int(peaks[i]) - 1 + max(0, pulse.start - 2), float(smooth[peaks[i] - 1])) for i in order]


def force_reach(force: ArrayLike, rate: float, drop: float = 20.0) -> float:
    """Frequency in Hz at which the spectrum of the main pulse first lies `drop` dB under its value near zero.

    Only the pulse is transformed, so that noise over the record does not hide the drop; half the sample rate if
    it never drops so far.
    """
    f = np.asarray(force, float)
    pulse = find_pulse(f)
    margin = pulse.length // 2
    start, stop = max(0, pulse.start - margin), min(f.size, pulse.stop + margin)
    size = max(4096, 8 * (stop - start))
    spectrum = np.abs(np.fft.rfft((f - np.median(f))[start:stop], size))
    under = np.flatnonzero(spectrum < spectrum[0] * 10 ** (-drop / 20))
    return float(under[0] * rate / size) if under.size else rate / 2


def hit_verdicts(
    force: ArrayLike,
    responses: ArrayLike,
    rate: float,
    settings: HitSettings | None = None,
    names: Sequence[str] = (),
) -> list[Verdict]:
    """Every check of one hit, passed or not; the hit is good if all are.

    Parameters
    ----------
    force : array_like, shape (n,)
        Force of one hit with some samples before the pulse, N.
    responses : array_like, shape (n_out, n)
        Responses sampled with it.
    rate : float
        Samples per second.
    settings : HitSettings, optional
    names : sequence of str
        Of the force, then of the responses; "force", "response 1", ... if not given.

    Returns
    -------
    list of Verdict
        "signal" per channel (finite, alive), "overload" per channel, then "pulse", "double hit", "level", "reach"
        (if asked for) and "decay" per response. If a channel is dead or not finite, the checks end there.

    Raises
    ------
    EstimationError
        Shapes or names do not fit.
    """
    rules = settings or HitSettings()
    f = np.asarray(force, float)
    x = np.atleast_2d(np.asarray(responses, float))
    if f.ndim != 1 or x.shape[1:] != f.shape or f.size < 16:
        raise EstimationError(
            f"a hit of force {f.shape} and responses {x.shape}: they need the same samples, 16 or more"
        )
    labels = tuple(names) or ("force", *(f"response {k + 1}" for k in range(x.shape[0])))
    if len(labels) != x.shape[0] + 1:
        raise EstimationError(f"{len(labels)} names for a force and {x.shape[0]} responses")
    rows = [f, *x]
    verdicts = [signal_verdict(row, label) for row, label in zip(rows, labels, strict=True)]
    if not all(verdicts):
        return verdicts
    verdicts += [overload_verdict(r, c, rules.full_scale.get(c), rate) for r, c in zip(rows, labels, strict=True)]
    pulse = find_pulse(f)
    verdicts += [_pulse_verdict(f, pulse, rate, labels[0]), _double_verdict(f, rate, rules, labels[0])]
    verdicts.append(_level_verdict(pulse, rules, labels[0]))
    if rules.reach:
        verdicts.append(_reach_verdict(f, rate, rules, labels[0]))
    return verdicts + [_decay_verdict(r, c, pulse, rate, rules) for r, c in zip(x, labels[1:], strict=True)]


def signal_verdict(signal: NDArray, channel: str) -> Verdict:
    """Whether a channel is finite and not constant."""
    bad = np.flatnonzero(~np.isfinite(signal))
    if bad.size:
        reason = f"{channel} is not finite at sample {int(bad[0])}: check the connection and record again"
        return Verdict("signal", False, float(bad.size), 0.0, reason, channel)
    if np.ptp(signal) == 0:
        reason = f"{channel} is constant ({signal[0]:g}): is its sensor connected and powered?"
        return Verdict("signal", False, 0.0, 0.0, reason, channel)
    return Verdict("signal", True, 0.0, 0.0, f"{channel} is finite and alive", channel)


def overload_verdict(signal: NDArray, channel: str, full_scale: float | None = None, rate: float = 1.0) -> Verdict:
    """Whether a channel reached the end of its range: longest run of samples at the rail."""
    found = clipped_runs(signal, full_scale)
    longest = max((b - a for a, b in found), default=0)
    if not found:
        return Verdict("overload", True, 0.0, 0.0, f"{channel} stays within its range", channel)
    total = sum(b - a for a, b in found)
    reason = (
        f"{channel} is clipped: {total} samples at the rail, {longest} in a row, first at {found[0][0] / rate:.4g} s;"
        " lower its gain or raise its range"
    )
    return Verdict("overload", False, float(longest), 0.0, reason, channel)


def _pulse_verdict(f: NDArray, pulse: Pulse, rate: float, channel: str) -> Verdict:
    clear = abs(pulse.peak) / pulse.noise if pulse.noise else np.inf
    if clear < 10:
        reason = f"{channel} holds no pulse: its peak is {clear:.1f} times its noise; hit harder or lower the range"
        return Verdict("pulse", False, float(clear), 10.0, reason, channel)
    if pulse.start == 0:
        reason = f"{channel}'s pulse starts before the record; raise the pre-trigger"
        return Verdict("pulse", False, 0.0, 1.0, reason, channel)
    if pulse.stop == f.size:
        reason = f"{channel}'s pulse does not end within the record; lengthen the record"
        return Verdict("pulse", False, 0.0, 1.0, reason, channel)
    reason = f"one pulse of {pulse.length / rate * 1e3:.3g} ms, {clear:.3g} times the noise"
    return Verdict("pulse", True, float(clear), 10.0, reason, channel)


def _double_verdict(f: NDArray, rate: float, rules: HitSettings, channel: str) -> Verdict:
    found = further_pulses(f, rules.second_hit)
    if not found:
        return Verdict("double hit", True, 0.0, rules.second_hit, "the force has a single pulse", channel)
    at, share = max(found, key=lambda item: item[1])
    reason = (
        f"double hit: a further pulse of {share:.0%} of the largest at {at / rate:.4g} s;"
        " use a lighter tip or hammer, or hit where the structure does not come back"
    )
    return Verdict("double hit", False, share, rules.second_hit, reason, channel)


def _level_verdict(pulse: Pulse, rules: HitSettings, channel: str) -> Verdict:
    low, high = rules.force_range
    peak = abs(pulse.peak)
    if peak < low:
        return Verdict(
            "level", False, peak, low, f"{channel} peaks at {peak:.3g} N, below {low:g} N: hit harder", channel
        )
    if peak > high:
        return Verdict(
            "level", False, peak, high, f"{channel} peaks at {peak:.3g} N, above {high:g} N: hit softer", channel
        )
    return Verdict("level", True, peak, low, f"{channel} peaks at {peak:.3g} N", channel)


def _reach_verdict(f: NDArray, rate: float, rules: HitSettings, channel: str) -> Verdict:
    reach = force_reach(f, rate, rules.reach_drop)
    if reach >= rules.reach:
        reason = f"the force excites up to {reach:.4g} Hz (-{rules.reach_drop:g} dB)"
        return Verdict("reach", True, reach, rules.reach, reason, channel)
    reason = (
        f"the force has dropped by {rules.reach_drop:g} dB at {reach:.4g} Hz, and {rules.reach:g} Hz are wanted:"
        " use a harder tip or a lighter hammer"
    )
    return Verdict("reach", False, reach, rules.reach, reason, channel)


def _decay_verdict(x: NDArray, channel: str, pulse: Pulse, rate: float, rules: HitSettings) -> Verdict:
    last = max(8, x.size // 20)
    centred = x - np.median(x)
    noise = noise_level(x) ** 2
    excess = np.var(x[-last:]) - noise
    # the variance of so few samples of noise strays, and the level from the quietest quarter lies a little low
    blur = (0.25 + OUTLIER * np.sqrt(2 / last)) * noise
    tail = np.sqrt(excess) if excess > blur else 0.0
    left = float(tail * np.sqrt(2) / np.abs(centred).max() * np.exp(-rules.decay * (x.size - pulse.at) / rate))
    if left <= rules.settled:
        return Verdict("decay", True, left, rules.settled, f"{channel} has decayed to {left:.1%} of its peak", channel)
    length = (x.size - pulse.at) / rate
    sigma = rules.decay + np.log(left / rules.settled) / length
    reason = (
        f"{channel} still has {left:.0%} of its peak at the end of the record: lengthen the record, or use an"
        f" exponential window of decay {sigma:.3g} 1/s"
    )
    return Verdict("decay", False, left, rules.settled, reason, channel)


def hit_transforms(hits: Sequence[ArrayLike], mask: ArrayLike | None = None) -> NDArray[np.complex128]:
    """Transforms of hits of equal length, each (n_ch, n) with the force first, shape (n_hits, n_ch, n_lines)."""
    spectra = np.fft.rfft(np.stack([np.asarray(h, float) for h in hits]), axis=-1)
    return spectra if mask is None else spectra[..., np.asarray(mask)]


def pairwise_coherence(transforms: NDArray) -> NDArray[np.float64]:
    r"""Mean coherence of each response over each pair of hits, shape (n_hits, n_hits, n_out).

    Parameters
    ----------
    transforms : ndarray, shape (n_hits, 1 + n_out, n_lines)
        From `hit_transforms`, on the lines of the band of interest; the force first.

    Notes
    -----
    Two identical measurements give 1, unrelated ones 0.5 on average. Mean over lines of

    .. math:: \gamma_{ab}^2 = \frac{|\bar F_a X_a + \bar F_b X_b|^2}{(|F_a|^2 + |F_b|^2)(|X_a|^2 + |X_b|^2)}
    """
    force, response = transforms[:, :1], transforms[:, 1:]
    cross = force.conj() * response
    f2, x2 = np.abs(force) ** 2, np.abs(response) ** 2
    out = np.ones((len(force), len(force), response.shape[1]))
    for a in range(len(force)):
        for b in range(a):
            bottom = (f2[a] + f2[b]) * (x2[a] + x2[b])
            top = np.abs(cross[a] + cross[b]) ** 2
            share = np.divide(top, bottom, out=np.zeros(bottom.shape), where=bottom > 0)
            out[a, b] = out[b, a] = share.mean(axis=-1)
    return out


def consistency_verdicts(transforms: NDArray, threshold: float = 0.9, names: Sequence[str] = ()) -> list[list[Verdict]]:
    """For each hit and response, whether it agrees with the other hits: median pairwise coherence.

    Parameters
    ----------
    transforms : ndarray, shape (n_hits, 1 + n_out, n_lines)
        As for `pairwise_coherence`.
    threshold : float
    names : sequence of str
        Of the responses.

    Returns
    -------
    list of list of Verdict
        One list a hit. A single hit agrees with nothing: its verdicts are not ok and say so.
    """
    n_hits, n_out = transforms.shape[0], transforms.shape[1] - 1
    labels = tuple(names) or tuple(f"response {k + 1}" for k in range(n_out))
    if n_hits < 2:
        reason = "a single hit cannot be compared: record at least two"
        return [
            [Verdict("consistency", False, float("nan"), threshold, reason, c) for c in labels] for _ in range(n_hits)
        ]
    pairs = pairwise_coherence(transforms)
    every = []
    for k in range(n_hits):
        share = np.median(np.delete(pairs[k], k, axis=0), axis=0)
        every.append([_consistency(float(v), threshold, c, k) for v, c in zip(share, labels, strict=True)])
    return every


def _consistency(share: float, threshold: float, channel: str, hit: int) -> Verdict:
    if share >= threshold:
        return Verdict(
            "consistency", True, share, threshold, f"hit {hit + 1} agrees on {channel} ({share:.3f})", channel
        )
    reason = (
        f"hit {hit + 1} disagrees with the others on {channel} (pairwise coherence {share:.2f} < {threshold:g}):"
        " was it struck at another point or angle?"
    )
    return Verdict("consistency", False, share, threshold, reason, channel)


def best_hits(transforms: NDArray, count: int) -> list[int]:
    """The `count` hits that agree best with one another: numbers in ascending order.

    Hits are taken out one by one, each time the one whose mean pairwise coherence with the rest is lowest.
    """
    if not 1 <= count <= transforms.shape[0]:
        raise EstimationError(f"cannot choose {count} of {transforms.shape[0]} hits")
    pairs = pairwise_coherence(transforms).mean(axis=-1)
    kept = list(range(transforms.shape[0]))
    while len(kept) > count:
        mean = pairs[np.ix_(kept, kept)].mean(axis=1)
        kept.pop(int(np.argmin(mean)))
    return kept
