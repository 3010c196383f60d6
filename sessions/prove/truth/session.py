"""A measuring session on the concealed truth: runs at several levels, through the chain, to a user's samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sessions.prove.truth import channels, excite
from sessions.prove.truth.nonlinear import nonlinear, stretched, stroke
from sessions.prove.truth.physics import band
from sessions.prove.truth.respond import answers, steady
from sessions.prove.truth.state import State, plant

LEVELS = (0.1, 0.316, 1.0)
MOST_SAMPLES = 8192
LONGEST_RUN = 131072
MARGIN = 128
"""Samples for which a generator plays on after the digitiser has stopped."""


@dataclass(frozen=True)
class Plan:
    """How a session is run.

    Parameters
    ----------
    excitation : str
        "multisine", "random", "hammer", or "frf" where an analyser hands out nothing but FRFs.
    rate : float
        Samples per second.
    samples : int
        Samples of a period, of a random run, or of one hit.
    drop, keep : int
        Periods that are transient and that are kept.
    levels : tuple of float
        Relative levels of the runs.
    repeats : int
        Realisations, or hits, at each level.
    snr : float
        Signal over noise at the highest level, dB.
    bits : int
    """

    excitation: str
    rate: float
    samples: int
    drop: int
    keep: int
    levels: tuple[float, ...]
    repeats: int
    snr: float
    bits: int


@dataclass(frozen=True, eq=False)
class Run:
    """Samples of one run in SI units, shape (n_channels, n), and its relative level."""

    data: NDArray[np.float64]
    level: float


def draw_plan(rng: Generator, state: State, excitation: str) -> Plan:
    """Settings that a careful user would choose for this structure."""
    low, high = band(state)
    decay = 1 / (0.8 * state.bench.ratio * 2 * low)
    rate = float(np.ceil((4.0 if excitation == "hammer" else 2.7) * high))
    snr, bits = float(rng.uniform(50, 75)), int(rng.choice([16, 24]))
    if excitation in ("multisine", "frf"):
        samples = int(np.clip(2 ** round(np.log2(0.55 * decay * rate)), 1024, MOST_SAMPLES))
        drop = int(np.clip(np.ceil(1.3 * decay * rate / samples), 1, 5))
        return Plan(excitation, rate, samples, drop, 4, LEVELS, 2, snr, bits)
    levels = (0.3, 1.0) if rng.random() < 0.6 or state.laws else (1.0,)
    if excitation == "sweep":
        return Plan(excitation, rate, int(min(40 * decay * rate, LONGEST_RUN // 2)), 0, 0, (0.3, 1.0), 1, snr, bits)
    if excitation == "random":
        most = LONGEST_RUN // 2 if state.laws else LONGEST_RUN
        samples = int(min(60 * decay * rate, most))
        return Plan(excitation, rate, samples, 0, 0, levels, 1, snr, bits)
    samples = int(min(1.0 * decay * rate, LONGEST_RUN // 4))
    return Plan(excitation, rate, samples, 0, 0, levels, int(rng.integers(4, 7)), snr, bits)


def record(rng: Generator, state: State, plan: Plan) -> tuple[Run, ...]:
    """All runs of a session, in the order in which they were made."""
    raw = clean(rng, state, plan)
    peak = np.max([np.max(np.abs(run.data), axis=1) for run in raw], axis=0)
    names = state.channel_names()
    spoilt = []
    for run in raw:
        edges = ((0, run.data.shape[1]),)
        spoilt.append(replace(run, data=channels.spoil(state.channels, names, run.data, plan.rate, peak, edges)))
    top = [run.data for run in spoilt if run.level >= 0.99 * max(plan.levels)]
    rms = np.sqrt(np.mean([np.mean(d**2, axis=1) for d in top], axis=0))
    full = 1.3 * np.max([np.max(np.abs(run.data), axis=1) for run in spoilt], axis=0)
    for fault in state.channels:
        if fault.other == "converter":
            full[names.index(fault.channel)] = fault.value * peak[names.index(fault.channel)]
    calibration = 1 + 0.008 * rng.standard_normal(len(names))
    floor = rms * 10 ** (-plan.snr / 20) * np.exp(0.3 * rng.standard_normal(len(names)))
    return tuple(
        replace(run, data=channels.digitise(rng, run.data, calibration, floor, full, plan.bits)) for run in spoilt
    )


def from_rest_to_rest(rng: Generator, state: State, plan: Plan) -> list[NDArray[np.float64]]:
    """Runs that begin and end at rest, as exact sensors and the faulty channels deliver them, without noise."""
    ring = int(plan.rate / (0.8 * state.bench.ratio * 2 * band(state)[0]))
    shots = [_rung_out(shot, ring) for shot in SHOTS[plan.excitation](rng, state, plan)]
    raw = [run.data for run in _runs(state, plan, shots)]
    peak = np.max([np.max(np.abs(data), axis=1) for data in raw], axis=0)
    names = state.channel_names()
    return [channels.spoil(state.channels, names, data, plan.rate, peak, ((0, data.shape[1]),)) for data in raw]


@dataclass(frozen=True, eq=False)
class Shot:
    """What the generator or the hammer does in one run: a unit signal, its size, and the samples that are kept."""

    signal: NDArray[np.float64]
    size: float
    level: float
    start: int
    stop: int
    moment: float = 0.0


def clean(rng: Generator, state: State, plan: Plan) -> list[Run]:
    """What exact sensors would have seen, run by run."""
    if state.drift and plan.excitation == "multisine":
        return [replace(run, data=strength(state) * run.data) for run in _drifting(rng, state, plan)]
    return _runs(state, plan, SHOTS[plan.excitation](rng, state, plan))


def holding(rng: Generator, state: State, plan: Plan) -> list[bool]:
    """Whether each law is a slider on a spring that no run of the session makes slip: it is that spring then."""
    limits = np.array([stroke(term) for term in state.laws])
    if not np.isfinite(limits).any():
        return [False] * limits.size
    size = strength(state)
    shots = sorted(SHOTS[plan.excitation](rng, state, plan), key=lambda shot: -shot.size)
    holds = np.isfinite(limits)
    for shot in shots:
        holds &= stretched(state, size * shot.size * shot.signal, plan.rate) < limits
        if not holds.any():
            break
    return holds.tolist()


def _runs(state: State, plan: Plan, shots: list[Shot]) -> list[Run]:
    scale = strength(state)
    outputs = _answer_shots(state, plan, shots, scale)
    return [
        Run(np.vstack([scale * shot.size * shot.signal, out])[:, shot.start : shot.stop], shot.level)
        for shot, out in zip(shots, outputs, strict=True)
    ]


def _rung_out(shot: Shot, ring: int) -> Shot:
    """The same with its whole signal, then nothing for `ring` samples."""
    signal = np.concatenate([shot.signal, np.zeros(ring)])
    return replace(shot, signal=signal, start=0, stop=signal.size)


def strength(state: State) -> float:
    """RMS of the drive at the highest level: m/s^2 of the base, or N."""
    return 9.81 if state.bench.base is not None else 20.0


def _answer_shots(state: State, plan: Plan, shots: list[Shot], scale: float) -> list[NDArray[np.float64]]:
    full = (0.0, plan.rate / 2)
    if state.laws:
        return [nonlinear(state, scale * s.size * s.signal, plan.rate) for s in shots]
    if state.drift:
        made = [answers(plant(state, 1 + state.drift * s.moment), [s.signal], plan.rate, full)[0] for s in shots]
    else:
        different = list({id(s.signal): s.signal for s in shots}.values())
        known = dict(zip((id(x) for x in different), answers(plant(state), different, plan.rate, full), strict=True))
        made = [known[id(s.signal)] for s in shots]
    return [scale * s.size * y for s, y in zip(shots, made, strict=True)]


def _multisine(rng: Generator, state: State, plan: Plan) -> list[Shot]:
    n = plan.samples * (plan.drop + plan.keep)
    signals = [ramped(np.tile(p, plan.drop + plan.keep + 1)[: n + MARGIN]) for p in _periods(rng, state, plan)]
    return [Shot(signal, level, level, 0, n) for level in plan.levels for signal in signals]


def _periods(rng: Generator, state: State, plan: Plan) -> list[NDArray[np.float64]]:
    return [excite.odd_multisine(rng, plan.samples, plan.rate, band(state)) for _ in range(plan.repeats)]


def ramped(signal: NDArray) -> NDArray[np.float64]:
    """The signal switched on and off softly within `MARGIN` samples at its ends."""
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(MARGIN) + 0.5) / MARGIN)
    out = signal.copy()
    out[:MARGIN] *= rise
    out[-MARGIN:] *= rise[::-1]
    return out


def analyser(runs: tuple[Run, ...], plan: Plan) -> tuple[NDArray, NDArray, NDArray]:
    """Frequencies, FRFs (n_out, 1, n_f) and their variance as an analyser gives them: lines of the highest level."""
    run = runs[-1]
    kept = run.data[:, plan.drop * plan.samples :].reshape(len(run.data), plan.keep, plan.samples)
    spectrum = np.fft.rfft(kept, axis=2)
    mean = spectrum.mean(axis=1)
    lines = np.flatnonzero(np.abs(mean[0]) > 0.1 * np.max(np.abs(mean[0])))
    mean, spectrum = mean[:, lines], spectrum[:, :, lines]
    H = mean[1:] / mean[0]
    wrong = spectrum[1:] - H[:, None] * spectrum[0]
    noise = np.sum(np.abs(wrong) ** 2, axis=1) / (plan.keep - 1) / plan.keep
    return lines * plan.rate / plan.samples, H[:, None], (noise / np.abs(mean[0]) ** 2)[:, None]


def _drifting(rng: Generator, state: State, plan: Plan) -> list[Run]:
    """Period by period in the steady state of the moment: the creep is slow against the decay."""
    periods = _periods(rng, state, plan)
    order = [(level, i) for level in plan.levels for i in range(plan.repeats)]
    count = plan.drop + plan.keep
    moments = np.linspace(0, 1, len(order) * count)
    runs = []
    for r, (level, i) in enumerate(order):
        pieces = [
            steady(plant(state, 1 + state.drift * moments[r * count + p]), periods[i], plan.rate) for p in range(count)
        ]
        runs.append(Run(level * np.vstack([np.tile(periods[i], count), _blend(pieces)]), level))
    return runs


def _blend(pieces: list[NDArray]) -> NDArray[np.float64]:
    """Periods one after the other, each fading into the next without a jump."""
    fade = np.linspace(0, 1, pieces[0].shape[1], endpoint=False)
    later = [*pieces[1:], pieces[-1]]
    return np.concatenate([(1 - fade) * a + fade * b for a, b in zip(pieces, later, strict=True)], axis=1)


def _settle(state: State, plan: Plan) -> int:
    """Samples after which the beginning is forgotten, at most half a run."""
    low = band(state)[0]
    return min(int(1.3 * plan.rate / (0.8 * state.bench.ratio * 2 * low)), plan.samples // 2)


def _random(rng: Generator, state: State, plan: Plan) -> list[Shot]:
    settle = _settle(state, plan)
    n = plan.samples + settle
    return [
        Shot(ramped(excite.noise(rng, n + MARGIN, plan.rate, band(state))), level, level, settle, n)
        for level in plan.levels
    ]


def _sweep(rng: Generator, state: State, plan: Plan) -> list[Shot]:
    n = plan.samples
    signal = ramped(excite.chirp(n + MARGIN, plan.rate, band(state), down=bool(rng.random() < 0.5)))
    return [Shot(signal, level, level, 0, n) for level in plan.levels]


def _hammer(rng: Generator, state: State, plan: Plan) -> list[Shot]:
    high = band(state)[1]
    order = [level for level in plan.levels for _ in range(plan.repeats)]
    blows = [excite.pulse(rng, plan.samples, plan.rate, 8 / high, 1.15 * high) for _ in order]
    hard = np.exp(0.25 * rng.standard_normal(len(order)))
    last = max(len(order) - 1, 1)
    return [
        Shot(blow, level * h, level, 0, plan.samples, i / last)
        for i, (level, h, blow) in enumerate(zip(order, hard, blows, strict=True))
    ]


SHOTS: dict[str, Callable[[Generator, State, Plan], list[Shot]]] = {
    "multisine": _multisine,
    "frf": _multisine,
    "random": _random,
    "sweep": _sweep,
    "hammer": _hammer,
}
