"""Faults that are judged before any model is fitted: a channel that clips, a structure that drifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.creep import LEAST, take_back
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.railed import railed
from labnnum.diagnosis.rails import Clip
from labnnum.diagnosis.verdict import Named
from labnnum.frf import Frf
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.channel_clipping import ChannelClipping
from labnnum.mechanisms.drift import Drift
from labnnum.parameters import Parameter

LOUD_DB = 12.0
"""Odd distortion above noise that counts as distorted."""
QUIET_DB = 6.0
"""Odd distortion above noise that counts as clean, over many lines."""
PILED = 8.0
"""Excess of samples at the rail over those just inside it that counts without distortion lines;"""
OFTEN_PILED, TIMES = 2.0, 12
"""that of noise or a sweep that comes to the rail this often: peaks of its own end at different readings, and of a
sweep that swells and fades a quarter as many lie at its end as just inside."""
CHANGED = 1.25
"""Ratio of the change within a run to what its periods' scatter allows; sound runs scatter about 1."""
SURELY, FAR_CHANGED = 3.0, 2.0
"""Standard deviations of a drift's size from which on it is one: halves may differ by what moves no frequency; and the
ratio from which on they count as a drift whatever its size."""
BESIDE = 10.0
"""Ratio of the change of the FRFs between levels to that within runs, above which a drift is beside the point."""


@dataclass(frozen=True, eq=False)
class Gate:
    """What the gates found, and the observations that remain fit for a linear model."""

    named: tuple[Named, ...]
    usable: tuple[Observation, ...]
    distorted: bool
    """Distortion in more than one channel: the structure itself may be nonlinear."""


def pass_gates(observations: Sequence[Observation]) -> Gate:
    """Judge clipping; runs in which a channel clips are left out, or that channel where it clips in all of them."""
    clips = beyond([clipped_channel(o) for o in observations], observations)
    at_rail = False
    if not any(clips):
        clips = railed(observations)
        at_rail = any(clips)
    if not any(clips):
        clips = bent_channel(observations)
    names = [c for c in clips if c]
    distorted = any(_spread_distortion(o) for o, c in zip(observations, clips, strict=True) if not c)
    if not names:
        return Gate((), tuple(observations), distorted)
    name = max(dict.fromkeys(names), key=names.count)
    affected = [o for o, c in zip(observations, clips, strict=True) if c == name]
    level = min(o.peaks.get(name, np.nan) for o in affected)
    unit = next(c.unit for o in affected for c in (*o.frf.outputs, *o.frf.inputs) if c.name == name)
    parameter = Parameter("rail", level, 0.0, np.inf, unit)
    term = Term(ChannelClipping(), Place("channel", name), (parameter,), np.zeros((0, 1)))
    found = Named(term, np.array([level]), np.array([0.01 * level]), 0.99)
    every = list(zip(observations, clips, strict=True))
    clean = [o for o, c in every if not c] or [o for o, c in every if c != name]
    without = [made for o in observations if (made := _without(o, name)) is not None]
    needed = at_rail or _others_change(name, clean, affected)
    if not clean or (needed and len(without) == len(observations) and len(without[0].frf.outputs) > 1):
        clean = without  # a law needs the loud runs more than one channel of them
    return Gate((found,), tuple(clean or observations), distorted)


def _others_change(name: str, clean: Sequence[Observation], affected: Sequence[Observation]) -> bool:
    """Whether other channels too respond otherwise in the runs in which one clips than in the others."""
    if not clean:
        return False
    low = min(clean, key=lambda o: o.level)
    changes = [change_of_rows(low.frf, o.frf) for o in affected]
    rows = np.array([c.name != name for c in low.frf.outputs])
    return any(c is not None and bool((c[1][rows] > BENT).any()) for c in changes)


def _often(clip: Clip, o: Observation) -> bool:
    """Whether noise comes to the end of a channel's range again and again."""
    return o.kind == "random" and clip.times >= TIMES


def clipped_channel(o: Observation) -> str:
    """Name of the channel that clips in this run; empty if none does.

    With detection lines: odd distortion on that channel while all others are clean, or distortion of the measured
    input that no response shows. Without: samples that pile up at the rail.
    """
    odd = o.distortion.get("odd_over_noise")
    outputs = [c.name for c in o.frf.outputs]
    if odd is not None:
        loud = np.flatnonzero(odd > LOUD_DB)
        raw = o.distortion["odd_raw_over_noise"]
        if float(o.distortion["odd_input_over_noise"][0]) > LOUD_DB and (raw < QUIET_DB).all() and loud.size:
            return o.frf.inputs[0].name
        if loud.size == 1 and len(outputs) > 1 and (np.delete(odd, loud[0]) < QUIET_DB).all():
            return outputs[int(loud[0])]
        if loud.size == 0:
            return ""
    piled = {n: c.score for n, c in o.clipped.items() if c.score >= (OFTEN_PILED if _often(c, o) else PILED)}
    if len(piled) == 1 or (piled and odd is None):
        return max(piled, key=lambda n: piled[n])
    return ""


RAIL = 1.1
"""Ratio of a channel's highest reading to that of a run, above which the rail is not where that run ends."""
ONE_RAIL = 1.005
"""And the same of two runs that clip, above which they do not end at one rail."""
BENT = 0.02
"""Relative change of one channel's FRFs with level, beyond noise, that counts where no other channel changes by"""
OTHERS = 0.1
"""this part of it: a structure that changes with level changes them all."""
CERTAIN = 4.0
"""Deviations of the power of the noise that such a change must exceed: one drowned line may hold most of it."""


def bent_channel(observations: Sequence[Observation]) -> list[str]:
    """Run by run, the channel that does not read in proportion there: its FRFs alone differ from those of the lowest
    level; empty elsewhere. Hits and noise hold no lines that would show the distortion itself.
    """
    none = [""] * len(observations)
    known = [o for o in observations if np.isfinite(o.level) and o.level > 0]
    if len(known) != len(observations) or len(known) < 2 or len(known[0].frf.outputs) < 2:
        return none
    if any(o.kind == "periodic" for o in observations):  # their quiet lines say it better
        return none
    if not all(o.peaks for o in observations):  # FRFs from which a law's share was taken: they show what that has wrong
        return none
    low = min(known, key=lambda o: o.level)
    changes: list[NDArray[np.float64]] = []
    for o in observations:
        change = np.zeros((2, len(low.frf.outputs))) if o is low else change_of_rows(low.frf, o.frf)
        if change is None:
            return none
        changes.append(change)
    likely, sure = max(changes, key=lambda c: np.max(c[1]))
    row = int(np.argmax(sure))
    if sure[row] < BENT or (np.delete(likely, row) > OTHERS * sure[row]).any():
        return none
    name = low.frf.outputs[row].name
    clips = [name if sure[row] > BENT else "" for _, sure in changes]
    return none if _as_free(name, clips, observations) else clips


def beyond(clips: Sequence[str], observations: Sequence[Observation]) -> list[str]:
    """Clipped channels, run by run, less those that have no rail: they read higher in another run than where they are
    said to clip, end at different readings in the runs in which they do, or are held back no more than the others.
    """
    out = list(clips)
    for name in {n for n in clips if n}:
        ends = [o.peaks.get(name, np.nan) for n, o in zip(clips, observations, strict=True) if n == name]
        top = max(o.peaks.get(name, 0.0) for o in observations)
        if min(ends) < top / RAIL or max(ends) > ONE_RAIL * min(ends) or _as_free(name, clips, observations):
            out = ["" if n == name else n for n in out]
    return out


HELD_BACK = {"hammer": 0.98, "random": 1.0, "periodic": 0.995}
"""Growth of a clipped channel's peaks from a quieter run, of the others' in the middle, that it stays below. Peaks of
hits follow their force; those of noise follow chance within some percent, and a rail holds back far more. Those of
periods follow the input where it is the same but for its size (`SAME_INPUT`)."""
SAME_INPUT = 0.999
"""Correlation of two inputs' spectra from which they are one."""


def _as_free(name: str, clips: Sequence[str], observations: Sequence[Observation]) -> bool:
    """Whether a channel's peaks grow from a quieter run to those in which it is said to clip as the others' do."""
    known = [(c, o) for c, o in zip(clips, observations, strict=True) if o.kind in HELD_BACK]
    loud = [o for c, o in known if c == name]
    quiet = [o for c, o in known if c != name]
    for high in loud:
        for low in (o for o in quiet if o.level < high.level and o.kind == high.kind and _same_input(o, high)):
            growth = {c: high.peaks[c] / low.peaks[c] for c in high.peaks if low.peaks.get(c)}
            others = [g for c, g in growth.items() if c != name]
            held = HELD_BACK[high.kind]
            if name in growth and len(others) >= 2 and growth[name] > held * float(np.median(others)):
                return True
    return False


def _same_input(low: Observation, high: Observation) -> bool:
    """Whether two periodic runs have one input but for its size; other runs are compared as they are."""
    if low.kind != "periodic":
        return True
    if low.run is None or high.run is None or low.run.u.size != high.run.u.size:
        return False
    a, b = low.run.u, high.run.u
    return bool(abs(np.vdot(a, b)) > SAME_INPUT * np.linalg.norm(a) * np.linalg.norm(b))


def change_of_rows(low: Frf, high: Frf) -> NDArray[np.float64] | None:
    """Relative RMS difference of the FRFs of two runs on lines that both have, noise taken out, and what is left of
    it with `CERTAIN` deviations of that noise's power taken out as well, (2, n_out); None where they have other
    channels, or fewer than eight lines in common.
    """
    shared, i, j = np.intersect1d(np.round(low.frequency, 6), np.round(high.frequency, 6), return_indices=True)
    same = [c.name for c in low.outputs] == [c.name for c in high.outputs] and len(low.inputs) == len(high.inputs)
    if not same or shared.size < 8 or low.variance is None or high.variance is None:
        return None
    a, b = low.value[..., i], high.value[..., j]
    each = low.variance[..., i] + high.variance[..., j]
    power = np.sum(np.abs(a - b) ** 2, axis=(1, 2)) - np.sum(each, axis=(1, 2))
    chance = CERTAIN * np.sqrt(np.sum(each**2, axis=(1, 2)))  # exponential: as large as its mean
    size = np.sum(np.abs(a) ** 2, axis=(1, 2))
    return np.sqrt(np.maximum(np.stack([power, power - chance]), 0.0) / size)


def _spread_distortion(o: Observation) -> bool:
    odd, even = o.distortion.get("odd_over_noise"), o.distortion.get("even_over_noise")
    rows = [d for d in (odd, even) if d is not None]
    return any(np.count_nonzero(d > LOUD_DB) >= max(1, min(2, d.size)) for d in rows)


def _without(o: Observation, name: str) -> Observation | None:
    keep = [i for i, c in enumerate(o.frf.outputs) if c.name != name]
    if len(keep) == len(o.frf.outputs) or not keep:
        return None

    cut = o.frf.rows(keep)
    slope = None if o.drift_slope is None else o.drift_slope.rows(keep)
    distortion = {k: v[keep] if v.size == len(o.frf.outputs) else v for k, v in o.distortion.items()}
    run = o.run and replace(o.run, y=o.run.y[keep], noise=o.run.noise[keep], outputs=cut.outputs)
    rows = tuple(r.select([c.name for c in r.channels if c.name != name]) for r in o.recordings)
    clipped, peaks = ({n: v for n, v in known.items() if n != name} for known in (o.clipped, o.peaks))
    return replace(
        o, frf=cut, run=run, recordings=rows, drift_slope=slope, distortion=distortion, clipped=clipped, peaks=peaks
    )


def drifted(
    observations: Sequence[Observation], held_out: Sequence[Observation] = ()
) -> tuple[Named | None, list[Observation], list[Observation]]:
    """Drift, and the observations as of one moment of the session.

    A trend of the periods or hits is one (see `labnnum.diagnosis.creep`), and so are runs whose halves differ beyond
    their scatter; these stay as they are.
    """
    same = None, list(observations), list(held_out)
    if _distorts(observations):
        return same
    creep, still, later = take_back(observations, held_out)
    if creep is not None:
        named = _drift(2 * creep.change, 2 * creep.std, 0.999)
        return replace(named, term=replace(named.term, data={"creep": creep})), still, later
    ratios = [o.drift for o in observations if o.drift > 0]
    if not ratios or float(np.median(ratios)) < CHANGED or _level_outweighs(observations):
        return same
    sizes, stds = np.transpose([_stiffness_change(o) for o in observations if o.drift_slope is not None])
    value, std = float(np.mean(sizes)), float(np.sqrt(np.sum(stds**2))) / sizes.size
    if sizes.size > 1:
        std = max(std, float(np.std(sizes, ddof=1) / np.sqrt(sizes.size)))
    if float(np.median(ratios)) < FAR_CHANGED and abs(value) < max(SURELY * std, 2 * LEAST):
        return same  # the halves differ by a little, and by something else than stiffness
    return _drift(value, std, float(min(0.999, 1 - np.exp(-3 * (np.median(ratios) - 1))))), same[1], same[2]


def _drift(value: float, std: float, confidence: float) -> Named:
    parameter = Parameter("relative_change", 0.0, -1.0, 10.0)
    term = Term(Drift(), Place("global", "structure"), (parameter,), np.zeros((0, 1)))
    return Named(term, np.array([value]), np.array([std]), confidence)


def _distorts(observations: Sequence[Observation]) -> bool:
    """Whether two channels (one of one) distort far more than a change within the run can.

    A response that changes by d over n periods holds, in the mean over periods, a ramp of d / n: on lines that were not
    excited that leaves (d / n)^2 / 12 of the power on the others at most (the sum of a ramp's Fourier coefficients). A
    structure whose distortion is beyond (d / n)^2 is nonlinear, and may well answer with periods that differ.
    """
    for o in observations:
        periods = o.frf.n_averages
        if o.drift_slope is None or not periods >= 1:
            continue
        step = 2 * np.linalg.norm(o.drift_slope.value, axis=(1, 2)) / np.linalg.norm(o.frf.value, axis=(1, 2)) / periods
        far = np.zeros(step.size, bool)
        for name in ("odd", "even"):
            if name + "_over_noise" in o.distortion:
                far |= (10 ** (o.distortion[name] / 10) > step**2) & (o.distortion[name + "_over_noise"] > LOUD_DB)
        if np.count_nonzero(far) >= min(2, far.size):
            return True
    return False


def _level_outweighs(observations: Sequence[Observation]) -> bool:
    """Whether the FRFs change with level far more than they do within any run: a strained joint may creep a little."""
    known = [o for o in observations if o.drift_slope is not None and np.isfinite(o.level) and o.level > 0]
    known.sort(key=lambda o: o.level)
    if len(known) < 2 or known[-1].level < 1.3 * known[0].level:
        return False
    low, high = known[0].frf, known[-1].frf
    if low.value.shape != high.value.shape or not np.allclose(low.frequency, high.frequency):
        return False
    size = np.linalg.norm(low.value)
    within = max(
        (np.linalg.norm(o.drift_slope.value) / np.linalg.norm(o.frf.value) for o in known if o.drift_slope is not None),
        default=np.inf,
    )
    return bool(np.linalg.norm(high.value - low.value) / size > BESIDE * within)


def _stiffness_change(o: Observation) -> tuple[float, float]:
    """Relative change of all stiffness over the run, and its standard deviation by what a stretch leaves of the halves'
    difference: the halves differ by half of the change, and frequency by half of that.

    The measured FRF's own derivative to a common stretch of frequency stands for the model's.
    """
    assert o.drift_slope is not None
    h, change = o.frf.value, o.drift_slope.value
    omega = o.frf.omega
    stretch = -np.gradient(h, omega, axis=2) * omega
    weight = np.ones_like(np.abs(h)) if o.frf.variance is None else 1.0 / np.maximum(o.frf.variance, 1e-300)
    size = np.sum(weight * np.abs(stretch) ** 2)
    part = np.sum(weight * np.real(np.conj(stretch) * change)) / size
    left = np.sum(weight * np.abs(change - part * stretch) ** 2) / max(2 * change.size - 1, 1)
    return float(4 * part), float(4 * np.sqrt(left / size))
