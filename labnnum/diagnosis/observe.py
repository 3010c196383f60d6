"""What a diagnosis looks at: FRFs with their noise from any excitation, and the signs that no FRF shows.

From periodic recordings: the mean over periods, noise per line, distortion on lines that were not excited, and the
change from the first to the last period. From random or hammer recordings: H1 with its random error. From any
recording: runs of samples at the end of a channel's range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.hits import without_offset
from labnnum.diagnosis.nonlinear.run import Run, run_of
from labnnum.diagnosis.rails import Clip, clipping, rails_of
from labnnum.diagnosis.shared import covering, input_noise
from labnnum.errors import ChannelError, EstimationError
from labnnum.frf import Frf
from labnnum.recording import Recording

SHARP = 0.5
"""Change of log power from line to line above which a resonance is not resolved."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One run: its FRFs on the excited lines, and its side evidence.

    `level` is the RMS of the input; `distortion` per output the ratio in dB of what stands on odd and on even
    detection lines to what stands on excited lines, each beside the noise there; `drift` the largest standardised
    change between the first and the second half; `clipped` channel -> share of samples at the rail.
    """

    frf: Frf
    level: float
    label: str
    kind: str
    distortion: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    drift: float = 0.0
    drift_slope: Frf | None = None
    clipped: dict[str, Clip] = field(default_factory=dict)
    peaks: dict[str, float] = field(default_factory=dict)
    """Channel -> largest magnitude, in its SI unit."""
    run: Run | None = None
    """Spectra of a periodic run, for the nonlinear diagnosis."""
    recordings: tuple[Recording, ...] = ()
    """What was recorded, for the same."""
    order: tuple[int, ...] = ()
    """Which of the session's recordings these are, in the order in which they were made; empty if not known."""


def observe(recording: Recording, lead: int | None = None) -> Observation:
    """The observation of one recording; its kind follows from `period` and from what its input is (`is_hit`).

    `lead`: samples of rest before a record that does not repeat (`local_frf`); by itself it says how many if None.
    """
    recording.require_finite()
    if not recording.inputs or not recording.outputs:
        raise ChannelError(f"{recording.label}: a diagnosis needs a reference or base channel and a response")
    if is_hit(recording):
        return observe_hits([recording])
    recording = longest_stretch(recording)
    x = used(recording)
    repeats = x.shape[1] // recording.period if recording.period else 1
    heard = [(c.name, row) for c, row in zip(recording.channels, x, strict=True) if c.role != "monitor"]
    clipped = {name: clipping(row, repeats) for name, row in heard}
    clipped = {n: c for n, c in clipped.items() if c.score > 0}
    level = float(np.sqrt(np.mean(x[recording.inputs[0]] ** 2)))
    made = _periodic(recording) if recording.period else _random(recording, lead)
    peaks = {name: float(np.max(np.abs(row))) for name, row in heard}
    return replace(made, level=level, clipped=clipped, peaks=peaks)


# -------------------------------------------------------------------- periodic


def steady_periods(recording: Recording) -> NDArray:
    """Steady periods, shape (n_periods, n_channels, period)."""
    n = recording.period
    out = []
    for start, stop in recording.spans():
        first = start + recording.drop_periods * n
        for at in range(first, stop - n + 1, n):
            out.append(recording.data[:, at : at + n])
    if not out:
        raise EstimationError(
            f"{recording.label}: no whole period of {n} samples is left after dropping {recording.drop_periods}"
        )
    return np.array(out)


def excited_lines(spectrum: NDArray, noise: NDArray) -> NDArray[np.bool_]:
    """Lines (n_f,) that the excitation holds: well above the noise and above their neighbourhood's detection lines."""
    from scipy.ndimage import maximum_filter1d

    size = np.abs(spectrum)
    size[0] = 0
    around = maximum_filter1d(size, 41)
    return (size > 0.05 * around) & (size > _least(size)) & (size > 4 * noise)


GAP = 5.0
"""Ratio between two neighbours in the order of size that parts excited lines from what the structure puts on others."""


def _least(size: NDArray) -> float:
    """Amplitude from which a line counts as excited: a thousandth of the largest, or above the widest gap.

    The force that a shaker feels holds the structure's harmonics and the mains, far below what was played.
    """
    top = float(size.max())
    order = np.sort(size[size > 1e-3 * top])
    if order.size < 2:
        return 1e-3 * top
    ratio = order[1:] / order[:-1]
    widest = int(np.argmax(ratio))
    above = np.sum(order[widest + 1 :] ** 2) / np.sum(order**2)
    return float(order[widest] * 1.01) if ratio[widest] > GAP and above > 0.99 else 1e-3 * top


def smooth(variance: NDArray, width: int = 31) -> NDArray[np.float64]:
    """Running mean of variances over their last axis."""
    from scipy.ndimage import uniform_filter1d

    mean = uniform_filter1d(variance, min(width, max(variance.shape[-1] // 4, 1)), axis=-1, mode="nearest")
    return np.maximum(mean, 0.0)  # the running sum may end a rounding below zero


def _periodic(recording: Recording) -> Observation:
    x = steady_periods(recording)
    n_periods, _, n = x.shape
    spectra = np.fft.rfft(x, axis=2) * (2 / n)
    mean = spectra.mean(axis=0)
    frequency = np.arange(mean.shape[1]) * recording.rate / n
    inputs, outputs = list(recording.inputs), list(recording.outputs)
    if len(inputs) > 1:
        raise EstimationError(f"{recording.label}: a periodic run has one input at a time, not {len(inputs)}")
    u, y = mean[inputs[0]], mean[outputs]
    if n_periods > 1:
        each = spectra - mean
        noise_u = smooth(np.mean(np.abs(each[:, inputs[0]]) ** 2, axis=0) / (n_periods - 1))
    else:
        noise_u = np.full(u.size, (1e-4 * np.abs(u).max()) ** 2)
    on = excited_lines(u.copy(), np.sqrt(noise_u))
    on[0] = False
    if not on.any():
        raise EstimationError(f"{recording.label}: channel {recording.channels[inputs[0]].name!r} excites no line")
    h = y[:, on] / u[on]
    if n_periods > 1:
        error = each[:, outputs][:, :, on] - h * each[:, inputs[0]][:, None, on]
        variance = np.mean(np.abs(error) ** 2, axis=0) / (n_periods - 1) / np.abs(u[on]) ** 2
        variance = 0.5 * variance + 0.5 * smooth(variance, 9)
        samples = error / (np.sqrt(n_periods - 1) * u[on])
        raised = covering(h, variance, input_noise(h, samples, variance, np.abs(u[on]) ** 2))
    else:
        raised = None
        variance = noise_from_smoothness(frequency[on], h)
    drift, slope = _drift(spectra, inputs, outputs, on, h) if n_periods >= 4 else (0.0, None)
    made = Frf(
        frequency[on], h[:, None], tuple(recording.channels[i] for i in outputs),
        (recording.channels[inputs[0]],), None, variance[:, None], float(n_periods), "periodic",
        {"period": n, "rate": recording.rate, "n_periods": n_periods}, shared=_above(raised, variance),
    )  # fmt: skip
    slope_frf = None if slope is None else replace(made, value=slope[:, None], variance=None)
    return Observation(
        made,
        0.0,
        recording.label,
        "periodic",
        _distortion(mean, noise_u, inputs, outputs, on, h, spectra),
        drift,
        slope_frf,
        run=run_of(
            spectra, on, inputs, outputs, recording.rate, n, float(np.sqrt(np.sum(np.abs(u) ** 2) / 2)),
            recording.label, recording.channels,
        ),
        recordings=(recording,),
    )  # fmt: skip


def _above(raised: NDArray | None, variance: NDArray) -> NDArray[np.float64] | None:
    """Factor (n_out, 1, n_f) by which variances (n_out, n_f) were raised."""
    return None if raised is None else np.maximum(raised / np.maximum(variance, 1e-300), 1.0)[:, None]


def _drift(spectra: NDArray, inputs: list[int], outputs: list[int], on: NDArray, h: NDArray) -> tuple[float, NDArray]:
    """Change of the FRFs from the first to the second half of the run: excess variance ratio, and the change."""
    half = spectra.shape[0] // 2
    parts = []
    for chunk in (spectra[:half], spectra[-half:]):
        m = chunk.mean(axis=0)
        parts.append(m[outputs][:, on] / m[inputs[0]][on])
    change = parts[1] - parts[0]
    each = spectra[:, outputs][:, :, on] / spectra[:, inputs[0]][:, None, on]
    within = 0.0
    for chunk in (each[:half], each[-half:]):
        step = np.diff(chunk, axis=0)
        within = within + np.sum(np.abs(step) ** 2, axis=0) / 2 / max(step.shape[0], 1) / 2
    expected = within * 2 / half
    ratio = float(np.sum(np.abs(change) ** 2 / np.maximum(smooth(expected), 1e-300)) / change.size)
    return ratio, change


def _distortion(
    mean: NDArray,
    noise_u: NDArray,
    inputs: list[int],
    outputs: list[int],
    on: NDArray,
    h: NDArray,
    spectra: NDArray,
) -> dict[str, NDArray[np.float64]]:
    """Per output: odd and even distortion in dB under the excited lines, and in dB above the noise."""
    lines = np.flatnonzero(on)
    inside = np.zeros(on.size, bool)
    inside[lines[0] : lines[-1] + 1] = True
    off = inside & ~on
    odd = off & (np.arange(on.size) % 2 == 1)
    even = off & (np.arange(on.size) % 2 == 0)
    n_periods = spectra.shape[0]
    out: dict[str, NDArray[np.float64]] = {}
    y = mean[outputs]
    u = mean[inputs[0]]
    grid = np.arange(on.size)
    through = np.array([np.interp(grid, lines, row.real) + 1j * np.interp(grid, lines, row.imag) for row in h])
    rest = y - through * u
    signal = np.mean(np.abs(y[:, on]) ** 2, axis=1)
    for name, where in (("odd", odd), ("even", even)):
        if np.count_nonzero(where) < 4:
            continue
        power = np.mean(np.abs(rest[:, where]) ** 2, axis=1)
        out[name] = 10 * np.log10(np.maximum(power / signal, 1e-30))
        if n_periods > 1:
            each = spectra[:, outputs] - y
            error = (each - through * (spectra[:, inputs[0]] - u)[:, None])[:, :, where]
            noise = np.mean(np.abs(error) ** 2, axis=(0, 2)) / (n_periods - 1)
            out[name + "_over_noise"] = 10 * np.log10(np.maximum(power, 1e-300) / np.maximum(noise, 1e-300))
            noise = np.mean(np.abs(each[:, :, where]) ** 2, axis=(0, 2)) / (n_periods - 1)
            raw = np.mean(np.abs(y[:, where]) ** 2, axis=1)
            out[name + "_raw_over_noise"] = 10 * np.log10(np.maximum(raw, 1e-300) / np.maximum(noise, 1e-300))
            of_input = np.mean(np.abs(u[where]) ** 2) / max(float(np.mean(noise_u[where])), 1e-300)
            out[name + "_input_over_noise"] = np.array([10 * np.log10(max(of_input, 1e-30))])
    return out


# -------------------------------------------------------------------- hits and random


PULSE, PIECE = 100, 20
"""Part of a record, and of one that was cut into pieces, that holds most of a blow's energy."""


def is_hit(recording: Recording) -> bool:
    """Whether the input is short pulses: one in a record, or one in most of the pieces that breaks cut it into."""
    if recording.period or len(recording.inputs) != 1:
        return False
    part = PIECE if recording.breaks else PULSE
    pulses = [_is_pulse(recording.data[recording.inputs[0], a:b], part) for a, b in recording.spans()]
    return 2 * sum(pulses) > len(pulses)


ABOVE = 8.0
"""A blow's height over the RMS of what lies outside that part: a million samples of noise reach five."""


def _is_pulse(x: NDArray, part: int) -> bool:
    """Whether a `part` of the samples (n,) holds four fifths of their energy, or one peak alone stands far above noise:
    of a light blow in a long record noise may hold as much energy.
    """
    energy = (x - np.median(x)) ** 2
    some = max(x.size // part, 8)
    if np.sort(energy)[::-1][:some].sum() > 0.8 * energy.sum():
        return True
    top = int(np.argmax(energy))
    rest = np.delete(energy, np.s_[max(top - some // 2, 0) : top + some // 2])
    return bool(rest.size and energy[top] > max(ABOVE**2 * rest.mean(), 4.0 * rest.max()))


def used(recording: Recording) -> NDArray[np.float64]:
    """Samples (n_channels, n) that may be used, one span after the other."""
    return np.concatenate([recording.data[:, a:b] for a, b in _spans(recording)], axis=1)


def _spans(recording: Recording) -> list[tuple[int, int]]:
    spans = list(recording.spans())
    if not spans:
        raise EstimationError(f"{recording.label}: all of it is excluded, expected samples that may be used")
    return spans


def longest_stretch(recording: Recording) -> Recording:
    """What is used of a record that neither repeats nor holds hits: its longest span, whatever lies beside it left out,
    such as what was recorded before the level was reached.
    """
    if recording.period:
        return recording
    start, stop = max(_spans(recording), key=lambda span: span[1] - span[0])
    if (start, stop) == (0, recording.n_samples):
        return recording
    over = ((c, max(a, start) - start, min(b, stop) - start) for c, a, b in recording.overloads)
    return replace(
        recording, data=recording.data[:, start:stop], breaks=(), excluded=(),
        overloads=tuple((c, a, b) for c, a, b in over if a < b),
    )  # fmt: skip


def observe_hits(recordings: Sequence[Recording], length: int | None = None) -> Observation:
    """One observation of the hits of one level: H1 over all, seen through an exponential window.

    Each contiguous span is a hit. The window brings the response down to a hundredth at the end of the record; what
    it does to the FRF is exact, a shift of i omega to i omega + decay, and is recorded as "window_decay"; how many
    seconds the records begin before the blow as "lead".
    """
    first = recordings[0]
    x, spectra, decay = hit_spectra(recordings, length)
    n = x.shape[2]
    u, y = spectra[:, first.inputs[0]], spectra[:, list(first.outputs)]
    lead = float(np.median(np.argmax(np.abs(x[:, first.inputs[0]]), axis=1))) / first.rate
    power = np.sum(np.abs(u) ** 2, axis=0)
    h = np.sum(y * np.conj(u)[:, None], axis=0) / power
    frequency = np.arange(n // 2 + 1) * (first.rate / n)
    if len(x) >= 3:
        left = y - h * u[:, None]
        variance = smooth(np.sum(np.abs(left) ** 2, axis=0) / (len(x) - 1), 9) / power
        samples = left * np.sqrt(len(x) / (len(x) - 1) / power)
        raised = _above(covering(h, variance, input_noise(h, samples, variance, power)), variance)
    else:
        raised = None
        variance = noise_from_smoothness(frequency, h)
    keep = (frequency > 0) & (power > 1e-3 * power.max())
    frf = Frf(
        frequency[keep], h[:, None][..., keep], tuple(first.channels[i] for i in first.outputs),
        (first.channels[first.inputs[0]],), None, variance[:, None][..., keep], float(len(x)), "H1",
        {"window_decay": decay, "rate": first.rate, "n_segment": n, "lead": lead},
        shared=None if raised is None else raised[..., keep],
    )  # fmt: skip
    level = float(np.median(np.max(np.abs(x[:, first.inputs[0]]), axis=1)))
    clipped, peaks = rails_of(recordings)
    return Observation(
        _heard(frf), level, first.label, "hammer", clipped=clipped, peaks=peaks, recordings=tuple(recordings)
    )  # fmt: skip


def roving(groups: Sequence[Sequence[Recording]]) -> Observation:
    """One observation of hits at several points, a group each, of the same responses: an input a point.

    The inputs are called by their channel and point. Levels are not told apart, and with several inputs neither a
    nonlinear law nor a drift is sought.
    """
    length = min(b - a for g in groups for r in g for a, b in r.spans())
    every = [observe_hits(g, length) for g in groups]
    common = reduce(np.intersect1d, [o.frf.frequency for o in every])
    if common.size < 8:
        raise EstimationError(f"{every[0].label}: hits at several points have only {common.size} lines in common")
    frfs = [o.frf.at(np.isin(o.frf.frequency, common)) for o in every]
    struck = tuple(replace(f.inputs[0], name=f"{f.inputs[0].name} {f.inputs[0].dof}") for f in frfs)
    variance = np.concatenate([f.variance for f in frfs if f.variance is not None], axis=1)
    raised = [np.ones(f.value.shape) if f.shared is None else f.shared for f in frfs]
    frf = replace(
        frfs[0], inputs=struck, value=np.concatenate([f.value for f in frfs], axis=1), variance=variance,
        n_averages=min(f.n_averages for f in frfs), shared=np.concatenate(raised, axis=1),
    )  # fmt: skip
    clipped, peaks = rails_of([r for g in groups for r in g])
    level = float(np.median([o.level for o in every]))
    return Observation(frf, level, every[0].label, "hammer", clipped=clipped, peaks=peaks)


def hit_spectra(recordings: Sequence[Recording], length: int | None = None) -> tuple[NDArray, NDArray, float]:
    """Hits (n_hits, n_channels, n) without offsets, their spectra through an exponential window, its decay in 1/s.

    n is the `length` that is given, or that of the shortest hit.
    """
    first = recordings[0]
    pieces = [r.data[:, a:b] for r in recordings for a, b in r.spans()]
    n = min(p.shape[1] for p in pieces) if length is None else length
    x = np.stack([without_offset(p[:, :n], first.inputs[0]) for p in pieces])
    decay = np.log(100.0) * first.rate / n
    return x, np.fft.rfft(x * np.exp(-decay * np.arange(n) / first.rate), axis=2) / first.rate, float(decay)


def observe_all(recordings: Sequence[Recording]) -> list[Observation]:
    """Observations of several recordings: hits of one level together, or all of a hammer that roves; every other
    recording on its own.
    """
    out: list[Observation] = []
    hits: list[tuple[int, Recording]] = []
    others: list[tuple[int, Recording]] = []
    for i, r in enumerate(recordings):
        hit = r.inputs and r.outputs and is_hit(r.require_finite())
        (hits if hit else others).append((i, r if hit else longest_stretch(r)))
    leads = _leads([r for _, r in others])
    out += [replace(observe(r, lead), order=(i,)) for (i, r), lead in zip(others, leads, strict=True)]
    points: dict[tuple[str, ...], list[Recording]] = {}
    for _, r in hits:
        points.setdefault(tuple(r.channels[i].dof for i in r.inputs), []).append(r)
    sensors = {tuple((r.channels[i].name, r.channels[i].dof) for i in r.outputs) for _, r in hits}
    if len(points) > 1 and len(sensors) == 1:
        return [*out, roving(list(points.values()))]
    for some in _set_ups(hits):
        length = min(b - a for _, r in some for a, b in r.spans())  # one window for all, as one model sees them
        for group in _levels(some):
            seen = observe_hits([r for _, r in group], length)
            out.append(replace(seen, order=tuple(i for i, _ in group)))
    return out


def _set_ups(hits: Sequence[tuple[int, Recording]]) -> list[list[tuple[int, Recording]]]:
    """Hits, with their numbers, by what was measured where, and how often."""
    groups: dict[tuple, list[tuple[int, Recording]]] = {}
    for i, r in hits:
        key = tuple((c.name, c.role, c.dof, c.sign, c.quantity) for c in r.channels)
        groups.setdefault((r.rate, key), []).append((i, r))
    return list(groups.values())


def _leads(recordings: Sequence[Recording]) -> list[int]:
    """Samples of rest before each record: as many before all that are as long, so that their FRFs share lines."""
    from labnnum.rest import lead_of

    alike: dict[tuple[int, float], list[Recording]] = {}
    for r in recordings:
        alike.setdefault((r.n_samples, r.rate), []).append(r)
    every = {key: lead_of(some) if all(not r.period for r in some) else 0 for key, some in alike.items()}
    return [every[r.n_samples, r.rate] for r in recordings]


def _levels(hits: Sequence[tuple[int, Recording]]) -> list[list[tuple[int, Recording]]]:
    """Hits, with their numbers, in groups whose peak forces lie within a factor of two of each other's first."""
    peaks = {i: float(np.max(np.abs(r.data[r.inputs[0]]))) for i, r in hits}
    groups: list[list[tuple[int, Recording]]] = []
    for one in sorted(hits, key=lambda hit: peaks[hit[0]]):
        if groups and peaks[one[0]] <= 2.0 * peaks[groups[-1][0][0]]:
            groups[-1].append(one)
        else:
            groups.append([one])
    return groups


def _random(recording: Recording, lead: int | None = None) -> Observation:
    """Local FRFs of the whole record; of several inputs H1 over Hann segments as long as leave thirty averages."""
    from labnnum.estimators import H1
    from labnnum.local import local_frf_with_errors
    from labnnum.spectra import Welch

    longest = max(stop - start for start, stop in recording.spans())
    if len(recording.inputs) == 1 and longest > ENOUGH:
        made, errors, power = local_frf_with_errors(recording, lead=lead)
        assert made.variance is not None
        h, v = made.value[:, 0], made.variance[:, 0]
        v = 0.5 * v + 0.5 * smooth(v, 5)  # few degrees of freedom
        raised = covering(h, v, input_noise(h, errors, v, power))
        made = replace(made, variance=v[:, None], shared=_above(raised, v))
        return Observation(_heard(made, 10.0), 0.0, recording.label, "random", recordings=(recording,))
    n = int(2 ** np.floor(np.log2(max(longest / 15, 64))))
    made = H1(Welch(n, window="hann", overlap=0.5))(recording)
    keep = _driven(made)
    frf = _trusted(_with_noise(made.at(keep)))
    return Observation(frf, 0.0, recording.label, "random", recordings=(recording,))


ENOUGH = 2048
"""Samples above which a record has local FRFs: some sixty lines."""


def _driven(frf: Frf) -> NDArray[np.bool_]:
    """Lines with input power within 40 dB of the strongest, zero left out."""
    keep = frf.frequency > 0
    if frf.input_spectrum is not None:
        power = np.real(np.einsum("iif->f", frf.input_spectrum))
        keep &= power > 1e-4 * power.max()
    return keep


def _with_noise(frf: Frf) -> Frf:
    if frf.variance is not None and np.isfinite(frf.variance).all():
        return frf
    rows = frf.value.reshape(-1, frf.frequency.size)
    return replace(frf, variance=noise_from_smoothness(frf.frequency, rows).reshape(frf.value.shape))


def observe_frf(frf: Frf, label: str = "FRF") -> Observation:
    """The observation of FRFs that came without time signals."""
    usable = frf.frequency > 0
    return Observation(_trusted(_with_noise(frf.at(usable))), float("nan"), label, "frf")


def _heard(frf: Frf, least: float = 3.0) -> Frf:
    """Without the lines where noise drowns every row: those where half of the rows are below `least` deviations."""
    assert frf.variance is not None
    ratio = np.abs(frf.value) / np.maximum(np.sqrt(frf.variance), 1e-300)
    keep = np.median(ratio.reshape(-1, frf.frequency.size), axis=0) > least
    return frf.at(keep) if np.count_nonzero(keep) >= 24 else frf


def _trusted(frf: Frf) -> Frf:
    """Without lines that say nothing (noise in every row) or that leak (a resonance sharper than the lines resolve).

    A periodic excitation has no leakage and keeps all its lines; here a resonance whose power changes by more than
    `SHARP` nepers from one line to the next was seen through a record too short for it.
    """
    h = np.abs(frf.value.reshape(-1, frf.frequency.size))
    assert frf.variance is not None
    noise = np.sqrt(frf.variance.reshape(h.shape))
    heard = np.median(h / np.maximum(noise, 1e-300), axis=0) > 5.0
    power = np.mean((h / np.median(h, axis=1, keepdims=True)) ** 2, axis=0)
    step = np.abs(np.diff(np.log(power + 1e-300)))
    sharp = (np.maximum(np.append(step, 0), np.append(0, step)) > SHARP) & (power > 4.0)
    from scipy.ndimage import binary_dilation

    near: NDArray[np.bool_] = np.asarray(binary_dilation(sharp, iterations=1), bool)
    keep = heard & np.logical_not(near)
    return frf.at(np.asarray(keep)) if np.count_nonzero(keep) >= 24 else frf


def noise_from_smoothness(frequency: NDArray, h: NDArray) -> NDArray[np.float64]:
    """Variance of each value, shape (rows, n_f), from the fourth differences of neighbours, which smooth FRFs lack.

    The local median over 41 lines is used, so that a resonance of a few lines does not count as noise.
    """
    from scipy.ndimage import median_filter

    if frequency.size < 12:
        return np.full(h.shape, (0.01 * np.abs(h).max()) ** 2)
    weights = np.array([1.0, -4, 6, -4, 1])
    rough = np.abs(np.apply_along_axis(lambda row: np.convolve(row, weights, "same"), -1, h)) ** 2 / 70.0
    rough[:, :2], rough[:, -2:] = rough[:, 2:3], rough[:, -3:-2]
    local = np.stack([median_filter(row, min(41, row.size // 2 * 2 - 1), mode="nearest") for row in rough]) / np.log(2)
    return np.maximum(local, (1e-5 * np.abs(h)) ** 2 + 1e-300)
