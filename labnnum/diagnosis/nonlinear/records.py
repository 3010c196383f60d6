"""Runs from recordings that are not periodic: hits, stretches of noise, sweeps; and whether their FRFs change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d

from labnnum.diagnosis.hits import without_offset
from labnnum.diagnosis.nonlinear.floor import floor_of
from labnnum.diagnosis.nonlinear.moved import CHANCE, moved
from labnnum.diagnosis.nonlinear.repeated import AROUND, Difference, answers_apart, difference
from labnnum.diagnosis.nonlinear.run import Run, resampled
from labnnum.recording import Recording

if TYPE_CHECKING:
    from labnnum.diagnosis.observe import Observation

STRETCH = 32768
"""Samples of noise that are compared at most; as many others are held out."""
FORGOTTEN = 40.0
"""Decay times of the slowest mode, by the nominal damping, that a stretch of noise should last."""
SILENT = 1e-4
"""Power of the input, of its largest, below which a line counts as not excited."""
FAINT = 1e-2
"""The same of a hit, whose spectrum falls off slowly, or of a sweep after a time of rest: what drives little is
simulated, not compared."""
HEARD = 4.0
"""Power of the input, of the quietest stretch of its spectrum, below which a line holds noise and no excitation, where
that stretch is below `FAINT` of the loudest line: noise at 0.1 Hz would be a motion of metres."""
SAME = 0.02
"""Power of one half of a record, of that of the other, below which a line was left out: the record sweeps."""
RARE = 0.25
"""Part of the lines that differ from level to level below which they are few, and would be missed by chance."""
LEVELS = 1.3
"""Ratio of two levels above which they are two."""
HITS = 1
"""Hits of a level that are fitted, at most."""


@dataclass(frozen=True, eq=False)
class Split:
    """Observations with a run each, for the fit and held out; `whole` has every original once."""

    train: tuple[Observation, ...]
    test: tuple[Observation, ...]
    whole: tuple[Observation, ...]


def split(observations: Sequence[Observation], decay_time: float) -> Split:
    """Hits of every level but the last of each, stretches of noise, or three of four stretches of lines of a sweep.

    Parameters
    ----------
    decay_time : float
        Of the slowest mode in the band, s.
    """
    train: list[Observation] = []
    test: list[Observation] = []
    whole: list[Observation] = []
    usable = [o for o in observations if _fit_for_it(o)]
    apart = _apart(usable)
    for o in usable:
        own, held = _hits(o) if o.kind == "hammer" else _stretches(o, decay_time, apart)
        train += [replace(o, run=r, level=r.level) for r in own]
        test += [replace(o, run=r, level=r.level) for r in held]
        whole.append(o)
    return Split(tuple(train), tuple(test), tuple(whole))


def _fit_for_it(o: Observation) -> bool:
    """Whether it has samples, all of them the answers to one input."""
    return bool(o.recordings) and len(o.frf.inputs) == 1 and len(o.recordings[0].inputs) == 1


# -------------------------------------------------------------------- hits


def _hits(o: Observation) -> tuple[list[Run], list[Run]]:
    runs = hits_of(o)
    return (runs, []) if len(runs) == 1 else (runs[:-1][-HITS:], runs[-1:])


def hits_of(o: Observation) -> list[Run]:
    """Every hit of an observation as a run that begins at rest, under the exponential window of its FRF."""
    decay = float(o.frf.settings["window_decay"])
    n = int(o.frf.settings["n_segment"])
    out = []
    for recording in o.recordings:
        for a, b in recording.spans():
            if b - a < n:
                continue
            x = without_offset(recording.data[:, a : a + n], recording.inputs[0])
            spectra = np.fft.rfft(x * np.exp(-decay * np.arange(n) / recording.rate), axis=1) * (2 / n)
            white = _white(x, recording.inputs[0], decay / recording.rate)
            out.append(_made(recording, spectra, n, decay, False, recording.label, FAINT, white))
    return out


def _white(x: NDArray, i: int, fall: float) -> NDArray[np.float64]:
    """Noise of a hit's record x (n_channels, n) as power per line (n_channels,) under its window exp(-fall k), white
    and as loud as before the blow, that of the force, row i, as in its last half; infinite where there is too little.

    The force's pulse and what it excites may reach to the end of the spectrum, which then shows no noise alone.
    """
    n = x.shape[1]
    begin = int(np.argmax(np.abs(x[i]) > BEGINS * np.max(np.abs(x[i])))) * 2 // 3
    out = np.mean(x[:, :begin] ** 2, axis=1) if begin >= FEWEST else np.full(x.shape[0], np.inf)
    out[i] = min(out[i], np.mean(x[i, n // 2 :] ** 2))
    return out * np.sum(np.exp(-2 * fall * np.arange(n))) * (2 / n) ** 2


BEGINS, FEWEST = 0.02, 12
"""Part of a blow's peak at which it has begun, and samples before it that tell the noise."""
CLEARLY, STILL = 2.0, 1e-8
"""Times that noise by which the quietest stretch of a spectrum must exceed it to be no noise alone; and the part of
that stretch that is noise at least, where a converter shows none before the blow.
"""


# -------------------------------------------------------------------- noise and sweeps


def _apart(observations: Sequence[Observation]) -> Difference | None:
    """What records of the lowest and the highest level differ by; None where they do not hold one signal."""
    known = sorted((o for o in observations if o.kind != "hammer" and np.isfinite(o.level)), key=lambda o: o.level)
    if len(known) < 2 or known[-1].level < LEVELS * known[0].level:
        return None
    return difference(known[0].recordings[0], known[-1].recordings[0])


def _stretches(
    o: Observation, decay_time: float, apart: Difference | None = None
) -> tuple[list[Run], list[Run]]:  # fmt: skip
    recording = o.recordings[0]
    a, b = max(recording.spans(), key=lambda span: span[1] - span[0])
    half = (b - a) // 2
    if _sweeps(recording.data[recording.inputs[0], a:b]):
        lead = int(o.frf.settings.get("lead", 0))
        whole = stretch_of(recording, a, b, lead)
        lines = np.flatnonzero(whole.inside)
        back = np.zeros(whole.u.size, bool)
        block = max(lines.size // 60, 1)
        telling = np.zeros(whole.u.size, bool) if apart is None else apart.telling(whole.frequency) & whole.inside
        if telling.any() and np.count_nonzero(telling) < RARE * lines.size:
            whole, block = replace(whole, telling=telling), min(block, AROUND)  # some of them are to be held out
        back[lines] = (np.arange(lines.size) // block) % 4 == 2
        return [replace(whole, use=~back)], [replace(whole, use=back)]
    n = min(STRETCH, half, int(FORGOTTEN * decay_time * recording.rate))
    return [stretch_of(recording, a + half - n, a + half)], [stretch_of(recording, a + half, a + half + n)]


def stretch_of(recording: Recording, start: int, stop: int, lead: int = 0) -> Run:
    """The samples from `start` to `stop`, a few less where that makes the transform quick, after `lead` samples in
    which nothing moves.
    """
    n = _quick(stop - start + lead)
    x = recording.data[:, start : start + n - lead]
    weights = np.hanning(n + 1)[lead:-1]
    x = x - np.average(x, axis=1, weights=weights)[:, None]  # the plain mean holds waves cut off
    x = np.pad(x, ((0, 0), (lead, 0)))
    return _made(recording, np.fft.rfft(x, axis=1) * (2 / n), n, 0.0, True, recording.label, FAINT if lead else SILENT)


def _quick(n: int) -> int:
    """The largest even number up to `n` with small factors only."""
    for m in range(n // 2, 0, -1):
        if next_fast_len(m, real=True) == m:
            return 2 * m
    return n


def _sweeps(u: NDArray) -> bool:
    """Whether one half of a record leaves out lines that the other excites."""
    n = u.size // 2
    window = np.hanning(n)
    power = [np.abs(np.fft.rfft(part * window)) ** 2 for part in (u[:n], u[n : 2 * n])]
    smooth = [uniform_filter1d(p, max(p.size // 100, 1)) for p in power]
    on = smooth[0] + smooth[1] > 1e-2 * np.max(smooth[0] + smooth[1])
    left_out = np.minimum(*smooth) < SAME * np.maximum(*smooth)
    return bool(np.mean(left_out[on]) > 0.2)


def _made(
    recording: Recording, spectra: NDArray, n: int, decay: float, ends: bool, label: str, faint: float,
    most: NDArray | None = None,
) -> Run:  # fmt: skip
    """A run of spectra (n_channels, n_lines); lines count as driven above `faint` of the input's largest power. Noise
    is `most` a line (n_channels,) where the quietest of them hold far more.
    """
    i, outputs = recording.inputs[0], list(recording.outputs)
    u, y = spectra[i].copy(), spectra[outputs]
    lines = np.arange(u.size)
    run = Run(
        recording.rate, n, u, y, np.zeros(y.shape), lines > 0, 0.0, label,
        tuple(recording.channels[j] for j in outputs), recording.channels[i], 1, decay, ends,
    )  # fmt: skip
    wide = max(u.size // 400, 5)
    power = uniform_filter1d(np.abs(run.seen(u)) ** 2, wide, mode="nearest")
    quietest = floor_of(run.seen(spectra))
    if most is not None:
        quietest = np.where(quietest > CLEARLY * most, np.maximum(most, STILL * quietest), quietest)
    of_input, of_outputs = float(quietest[i]), quietest[outputs]
    least = HEARD * of_input if of_input < FAINT * power.max() else 0.0
    at = np.flatnonzero(power > max(SILENT * power.max(), least))
    driven = np.flatnonzero(power > max(faint * power.max(), least))
    on = np.zeros(u.size, bool)
    inside = (1, u.size - 1) if decay else (int(at[0]) + 1, int(at[-1]) - 1)  # with neighbours that the input holds too
    last = int(driven[-1] if decay else at[-1])  # what a window hides at a sweep's end drives it all the same
    on[max(int(driven[0]), inside[0]) : min(last, inside[1]) + 1] = True
    u[int(at[-1]) + 1 :] = 0.0
    if ends:
        u[: int(at[0])] = 0.0  # noise alone, which a free structure would take far
    seen = run.seen(y)
    through = uniform_filter1d(np.abs(seen) ** 2, wide, axis=1, mode="nearest") / np.maximum(power, 1e-300)
    noise = of_outputs[:, None] + np.where(on, through, 0.0) * of_input
    level = float(np.sqrt(np.sum(np.abs(u) ** 2) / 2))
    return resampled(replace(run, noise=noise, excited=on, level=level))


# -------------------------------------------------------------------- signs

SURE = 1.8
"""Mean power of an FRF's change from level to level, of what noise and leakage leave, beyond which it changes whatever
the change looks like; sound structures show 1.0 to 1.4, because variances of few averages are too small."""
LOUDER, NEIGHBOURS = 4.0, 24
"""Ratio of the noise that an FRF of the higher level holds to that of the lower, over so many lines that follow, from
which on the structure makes it: noise that was added is less of a larger response, and leakage as much."""


def changed(observations: Sequence[Observation]) -> bool:
    """Whether FRFs of hits or noise change with level in two channels at least (in one where there is one)."""
    known = [o for o in observations if _fit_for_it(o) and np.isfinite(o.level)]
    for kind in {o.kind for o in known}:
        same = sorted((o for o in known if o.kind == kind), key=lambda o: o.level)
        if len(same) > 1 and same[-1].level > LEVELS * same[0].level and _differ(same[0], same[-1]):
            return True
    return False


def _differ(low: Observation, high: Observation) -> bool:
    if [(c.name, c.dof) for c in low.frf.inputs] != [(c.name, c.dof) for c in high.frf.inputs]:
        return False  # a hammer that roves
    one, other = low.frf, high.frf
    _, i, j = np.intersect1d(np.round(one.frequency, 6), np.round(other.frequency, 6), return_indices=True)
    if i.size < 8 or one.value.shape[0] != other.value.shape[0] or one.variance is None or other.variance is None:
        return False
    a, b = one.value[:, 0, i], other.value[:, 0, j]
    variance = np.maximum(one.variance[:, 0, i] + other.variance[:, 0, j], 1e-300)
    sure = np.mean(np.abs(a - b) ** 2 / variance, axis=1) > SURE
    need = min(2, sure.size)
    if sure.sum() >= need:
        return True
    if low.kind == "hammer" or high.kind == "hammer":
        return False  # hits differ in where they fall: their FRFs change in modes even where nothing does
    if np.count_nonzero(_louder(one.variance[:, 0, i], other.variance[:, 0, j])) >= need:
        return True
    if answers_apart(low.recordings[0], high.recordings[0], need):
        return True
    return bool(np.sort(moved(one.frequency[i], a, b, variance))[need - 1] < need * CHANCE / sure.size)


def _louder(low: NDArray, high: NDArray) -> NDArray[np.bool_]:
    """Rows whose FRF is noisier at the higher level, by its variance (rows, n_lines), than any linear structure's."""
    n = low.shape[1] // NEIGHBOURS * NEIGHBOURS
    if not n:
        return np.zeros(low.shape[0], bool)
    a, b = (v[:, :n].reshape(v.shape[0], -1, NEIGHBOURS).mean(axis=2) for v in (low, high))
    return np.max(b / np.maximum(a, 1e-300), axis=1) > LOUDER
