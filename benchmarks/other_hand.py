"""Diagnoses of cases by another hand than the concealed suites': masses and a beam, marched by code of their own.

    python benchmarks/other_hand.py [NAME ...]

Classical Runge-Kutta at forty to eighty steps a sample, a linear-phase filter down to the recorder's rate, noise on
sensors and force, gains a few tenths of a percent off, masses and springs that differ from the nominal model's. Levels
are recorded once, as on a bench, and not twice as in the suites. Like cases showed what the tool had wrong,
so that this is no blind test.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.signal import chirp, fftconvolve, firwin, resample_poly
from scipy.signal.windows import tukey

from labnnum.diagnosis import diagnose, observe_all
from labnnum.parameters import Parameter
from labnnum.recording import Channel, Recording
from labnnum.structures import Beam, Chain
from labnnum.structures.base import Structure
from labnnum.structures.beam import Lump
from labnnum.structures.chain import Link
from labnnum.structures.quantities import modal
from labnnum.structures.section import Section

CUBIC, PLAY, STOP, SLIDER, DRY, DRAG, KNEES, EVEN, Z2V = range(9)
"""Laws, by number in the march."""
KEEP = 4
"""Steps of the march between samples that are kept."""


@njit
def _force(kind, p, z, v, held):
    if kind == CUBIC:
        return p[0] * z**3
    if kind == PLAY:
        return p[0] * (z - min(max(z, -p[1]), p[1]))
    if kind == STOP:
        return p[0] * max(z - p[1], 0.0)
    if kind == SLIDER:
        return held
    if kind == DRY:
        return p[0] * np.tanh(v / p[1])
    if kind == DRAG:
        return p[0] * v * abs(v)
    if kind == EVEN:
        return p[0] * z * z
    if kind == Z2V:
        return p[0] * z * z * v
    low, knee = (p[2], p[3]) if v > 0.0 else (p[0], p[1])  # a shock absorber
    fast = max(abs(v) - knee, 0.0)
    return np.sign(v) * (low * (abs(v) - fast) + p[4] * fast)


@njit
def _march(u, dt, inverse, damping, stiffness, load, ways, kinds, p, out):
    """Motion, speed and acceleration in out (n / KEEP, 3, dofs) under the force u (2 n + 1), two samples a step."""
    dofs, laws = load.size, kinds.size
    x, v, held = np.zeros(dofs), np.zeros(dofs), np.zeros(laws)
    a = np.zeros((5, dofs))  # the first row stays zero
    for k in range((u.size - 1) // 2):
        for stage in range(4):
            part = (0.0, 0.5, 0.5, 1.0)[stage] * dt
            xs = x + part * v + part * 0.5 * dt * a[max(stage - 1, 0)]
            vs = v + part * a[stage]
            r = load * u[2 * k + (stage + 1) // 2] - damping @ vs - stiffness @ xs
            for j in range(laws):
                r -= ways[j] * _force(kinds[j], p[j], ways[j] @ xs, ways[j] @ vs, held[j])
            a[stage + 1] = inverse @ r
        if k % KEEP == 0:
            out[k // KEEP, 0], out[k // KEEP, 1], out[k // KEEP, 2] = x, v, a[1]
        step = dt * v + dt * dt / 6 * (a[1] + a[2] + a[3])
        for j in range(laws):
            if kinds[j] == SLIDER:
                held[j] = min(max(held[j] + p[j, 0] * (ways[j] @ step), -p[j, 1]), p[j, 1])
        x += step
        v += dt / 6 * (a[1] + 2 * a[2] + 2 * a[3] + a[4])


@dataclass(frozen=True)
class Plant:
    """What is measured: mass, damping and stiffness matrices, where the force acts, and the laws with their ways."""

    mass: NDArray
    damping: NDArray
    stiffness: NDArray
    load: NDArray
    laws: tuple[tuple[int, tuple[float, ...], NDArray], ...] = ()

    def respond(self, u: NDArray, rate: float, over: int) -> NDArray[np.float64]:
        """Motion, speed and acceleration (3, dofs, n) at the samples of a force u (n,) that begins and ends at rest."""
        pad = 256
        fine = resample_poly(np.pad(u, pad), 2 * over, 1, window=("kaiser", 12.0))
        fine = fine[2 * over * pad : 2 * over * (pad + u.size) + 1]
        kinds = np.array([law[0] for law in self.laws], np.int64)
        p, ways = np.zeros((kinds.size, 5)), np.zeros((kinds.size, self.load.size))
        for j, (_, values, way) in enumerate(self.laws):
            p[j, : len(values)], ways[j] = values, way
        out = np.zeros((u.size * over // KEEP, 3, self.load.size))
        inverse = np.linalg.inv(self.mass)
        _march(fine, 1 / rate / over, inverse, self.damping, self.stiffness, self.load, ways, kinds, p, out)
        return decimated(np.moveaxis(out, 0, 2), over // KEEP)


def decimated(x: NDArray, q: int) -> NDArray[np.float64]:
    """Every q-th sample of x (..., n) behind a filter of linear phase whose delay is taken off."""
    taps = firwin(2 * q * 96 + 1, 0.92 / q, window=("kaiser", 9.0))
    return fftconvolve(x, taps.reshape((1,) * (x.ndim - 1) + (-1,)), mode="same", axes=-1)[..., ::q]


# -------------------------------------------------------------------- masses

MASSES = {3: (2.0, 1.5, 1.0), 4: (1.5, 1.2, 1.0, 0.8)}
SPRINGS = {3: (20e3, 15e3, 10e3), 4: (25e3, 16e3, 14e3, 9e3)}


def masses(n: int, laws, *, drive: int = 0, ratio: float = 0.01, seed: int = 2) -> Plant:
    """A chain on the ground, masses 0.4 % and springs 2 % off their nominal values."""
    rng = np.random.default_rng(seed)
    m = np.array(MASSES[n]) * (1 + 0.004 * rng.standard_normal(n))
    k = np.array(SPRINGS[n]) * (1 + 0.02 * rng.standard_normal(n))
    down = np.eye(n) - np.eye(n, k=-1)
    stiffness = down.T @ np.diag(k) @ down
    square, shapes = eigh(stiffness, np.diag(m))
    some = ratio * (1 + 0.2 * rng.standard_normal(n))
    back = np.diag(m) @ shapes
    return Plant(np.diag(m), back @ np.diag(2 * some * np.sqrt(square)) @ back.T, stiffness, np.eye(n)[drive], laws)


def way(n: int, i: int, j: int | None = None) -> NDArray[np.float64]:
    """Motion of mass i, or of it over mass j."""
    return np.eye(n)[i] - (0.0 if j is None else np.eye(n)[j])


def chain(n: int, ratio: float = 0.01) -> Structure:
    """Its nominal model; springs may be 5 % off."""
    links = [Link("1", "ground", "k1", 0.0), *(Link(str(i - 1), str(i), f"k{i}", 0.0) for i in range(2, n + 1))]
    prior = [Parameter(f"k{i}", k, 0.7 * k, 1.3 * k, "N/m", std=0.05 * k) for i, k in enumerate(SPRINGS[n], 1)]
    mass = {str(i): m for i, m in enumerate(MASSES[n], 1)}
    return Chain(mass, tuple(links), tuple(prior), damping=modal(ratio))


@dataclass
class Signal:
    """A multisine, noise, bursts of it or a sweep, of RMS one, in a band (Hz)."""

    kind: str
    rate: float = 256.0
    low: float = 2.0
    high: float = 38.0
    period: int = 2048
    periods: int = 8
    seconds: float = 80.0

    def draw(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """One realisation."""
        if self.kind == "multisine":  # odd lines, of four one left out
            at = np.arange(1, self.period // 2, 2)
            at = at[(at * self.rate / self.period >= self.low) & (at * self.rate / self.period <= self.high)]
            at = np.delete(at, 4 * np.arange(at.size // 4) + rng.integers(0, 4, at.size // 4))
            spectrum = np.zeros(self.period // 2 + 1, complex)
            spectrum[at] = np.exp(2j * np.pi * rng.random(at.size))
            one = np.fft.irfft(spectrum, self.period)
            return np.tile(one / one.std(), self.periods)
        n = int(self.seconds * self.rate)
        t = np.arange(n) / self.rate
        if self.kind == "sweep":
            end = self.seconds - 6.0
            return chirp(t, self.low, end, self.high, "logarithmic") * np.clip(t, 0, 1) * (t < end)
        spectrum = np.fft.rfft(rng.standard_normal(n))
        f = np.fft.rfftfreq(n, 1 / self.rate)
        spectrum[(f < self.low) | (f > self.high)] = 0.0
        u = np.fft.irfft(spectrum, n)
        if self.kind == "bursts":
            every, on = int(8 * self.rate), int(5 * self.rate)
            u *= np.tile(np.pad(tukey(on, 0.1), (0, every - on)), n // every)
        return u / u.std()


def recorded(plant: Plant, signal: Signal, levels, sensors, *, over: int = 40, row: int = 2, seed: int = 5):
    """A recording a level; `row` 2 is acceleration, 1 speed. Sensors read up to 0.3 % too much or too little."""
    rng = np.random.default_rng(seed)
    n = plant.load.size
    drive = str(int(np.argmax(plant.load)) + 1)
    quantity = ("displacement", "velocity", "acceleration")[row]
    channels = [Channel("force", "force", "reference", drive, "x")]
    channels += [Channel(f"s{i + 1}", quantity, "response", str(i + 1), "x") for i in sensors]
    gain = 1 + 0.003 * rng.uniform(-1, 1, n)
    made = []
    for level in levels:
        u = level * signal.draw(rng)
        made.append(np.vstack([u, (gain[:, None] * plant.respond(u, signal.rate, over)[row])[list(sensors)]]))
    top = made[-1].std(axis=1, keepdims=True) * np.array([5e-4, *[1e-3] * len(sensors)])[:, None]
    period, drop = (signal.period, 3) if signal.kind == "multisine" else (0, 0)
    return [
        Recording(
            tuple(channels), data + top * rng.standard_normal(data.shape), signal.rate, period=period,
            drop_periods=drop, level=level, label=f"level {level:g}",
        )
        for level, data in zip(levels, made, strict=True)
    ]  # fmt: skip


# -------------------------------------------------------------------- a beam under hits

LUMPS = {"6": 0.005, "10": 0.005, "13": 0.005}


def beam() -> Structure:
    """Half a metre of aluminium, clamped, with three accelerometers of five grams, in twelve elements."""
    section = Section(E="E", rho=2700.0, width=0.03, height=0.005)
    prior = (Parameter("E", 69e9, 0.8 * 69e9, 1.2 * 69e9, "Pa", std=0.05 * 69e9),)
    lumps = tuple(Lump(n, m) for n, m in LUMPS.items())
    return Beam(0.5, section, 12, supports_at={"1": "clamped"}, lumps=lumps, parameters=prior, damping=modal(0.01))


def hits(peaks, stop: bool) -> list[Recording]:
    """Five hits a level on node 7; the beam in 48 elements of its own, ten modes, a stop behind a gap at the tip."""
    n, h = 48, 0.5 / 48
    bend = 1.02 * 69e9 * 0.03 * 0.005**3 / 12 / h**3
    heavy = 1.004 * 2700 * 0.03 * 0.005 * h / 420
    stiff = bend * np.array(
        [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h], [-12, -6 * h, 12, -6 * h],
         [6 * h, 2 * h * h, -6 * h, 4 * h * h]]
    )  # fmt: skip
    inert = heavy * np.array(
        [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h * h, 13 * h, -3 * h * h], [54, 13 * h, 156, -22 * h],
         [-13 * h, -3 * h * h, -22 * h, 4 * h * h]]
    )  # fmt: skip
    K, M = np.zeros((2 * n + 2, 2 * n + 2)), np.zeros((2 * n + 2, 2 * n + 2))
    for e in range(n):
        here = slice(2 * e, 2 * e + 4)
        K[here, here] += stiff
        M[here, here] += inert
    for node, mass in LUMPS.items():
        M[8 * (int(node) - 1), 8 * (int(node) - 1)] += mass
    square, shapes = eigh(K[2:, 2:], M[2:, 2:])
    at = {node: shapes[8 * (int(node) - 1) - 2, :10] for node in (*LUMPS, "7")}
    omega = np.sqrt(square[:10])
    ratios = np.array([0.012, 0.008, 0.007, 0.007, 0.008, *[0.01] * 5])
    laws = ((STOP, (4000.0, 8e-4), at["13"]),) if stop else ()
    plant = Plant(np.eye(10), np.diag(2 * ratios * omega), np.diag(square[:10]), at["7"], laws)
    rng = np.random.default_rng(3)
    channels = (Channel("hammer", "force", "reference", "7", "z"),)
    channels += tuple(Channel(f"a{node}", "acceleration", "response", node, "z") for node in LUMPS)
    out, t = [], np.arange(6 * 2048) / 2048
    for peak in peaks:
        for hit in range(5):
            long = 0.004 * (1 + 0.05 * rng.standard_normal())
            blow = np.sin(np.pi * np.clip((t - 0.1) / long, 0, 1)) ** 1.3 * peak * (1 + 0.12 * rng.standard_normal())
            blow = fftconvolve(blow, firwin(193, 0.9, window=("kaiser", 9.0)), mode="same")
            y = plant.respond(blow, 2048.0, 16)[2]
            rows = np.array([at[node] @ y for node in LUMPS])
            data = np.vstack([blow + 3e-3 * rng.standard_normal(t.size), rows + 0.02 * rng.standard_normal(rows.shape)])
            out.append(Recording(channels, data, 2048.0, level=peak, label=f"{peak:g} N, hit {hit + 1}"))
    return out


# -------------------------------------------------------------------- cases

Answer = tuple[str, str]
LEVELS = (1.0, 3.0, 9.0)


@dataclass(frozen=True)
class Case:
    """What is there (mechanism and place, none in a sound structure; no mechanism outside the catalogue)."""

    there: tuple[Answer, ...]
    model: Callable[[], Structure]
    recordings: Callable[[], list[Recording]]


def _of_masses(n: int, laws, signal: Signal, levels, sensors=None, row: int = 2, drive: int = 0, ratio: float = 0.01):
    sensors = range(n) if sensors is None else sensors
    over = 80 if any(law[0] == PLAY for law in laws) else 40
    return (
        lambda: chain(n, ratio),
        lambda: recorded(masses(n, laws, drive=drive, ratio=ratio), signal, levels, sensors, over=over, row=row),
    )


MULTISINE, NOISE = Signal("multisine"), Signal("noise")
BETWEEN = "joint 2-3"
CUBE, PLAYS = (CUBIC, (4e8,), way(3, 2, 1)), (PLAY, (4000.0, 5e-4), way(3, 1))
CASES = {
    "cubic, two levels": Case((("cubic-stiffness", BETWEEN),), *_of_masses(3, (CUBE,), MULTISINE, (0.7, 7.0))),
    "play, two levels": Case(
        (("clearance", "ground 2"),), *_of_masses(3, (PLAYS,), MULTISINE, (1.5, 11.0), ratio=0.03)
    ),
    "play, a mass without a sensor": Case(
        (("clearance", "ground 2"),),
        *_of_masses(3, ((PLAY, (4000.0, 6e-4), way(3, 1)),), MULTISINE, LEVELS, sensors=(0, 2)),
    ),
    "stop under hits": Case((("one-sided-gap", "ground 13"),), beam, lambda: hits((2.0, 8.0, 30.0), True)),
    "cubic and dry, noise": Case(
        (("cubic-stiffness", BETWEEN), ("coulomb-friction", "ground 1")),
        *_of_masses(3, (CUBE, (DRY, (0.5, 2e-4), way(3, 0))), NOISE, (0.7, 2.2, 7.0)),
    ),
    "shock absorber": Case(
        (("", "joint 1-2"),),
        *_of_masses(3, ((KNEES, (8.0, 0.05, 24.0, 0.03, 3.0), way(3, 1, 0)),), MULTISINE, LEVELS),
    ),
    "z^2 z'": Case((("", BETWEEN),), *_of_masses(3, ((Z2V, (4e6,), way(3, 2, 1)),), MULTISINE, (0.7, 2.2, 7.0))),
    "slider, bursts": Case(
        (("stick-slip", BETWEEN),),
        *_of_masses(4, ((SLIDER, (8000.0, 1.2), way(4, 2, 1)),), Signal("bursts", high=45.0), LEVELS),
    ),
    "drag, sweep": Case(
        (("quadratic-damping", "ground 1"),),
        *_of_masses(3, ((DRAG, (60.0,), way(3, 0)),), Signal("sweep"), (0.6, 2.0, 6.0), row=1, drive=2),
    ),
    "dry, multisine": Case(
        (("coulomb-friction", "ground 4"),),
        *_of_masses(4, ((DRY, (0.7, 2e-4), way(4, 3)),), MULTISINE, (1.5, 4.5, 14.0), sensors=(0, 1, 3)),
    ),
    "even spring, one level": Case(
        (("quadratic-stiffness", "ground 3"),), *_of_masses(3, ((EVEN, (2.5e5,), way(3, 2)),), MULTISINE, (4.0,))
    ),
    "sound, multisine": Case((), *_of_masses(3, (), MULTISINE, LEVELS)),
    "sound, hits": Case((), beam, lambda: hits((2.0, 8.0, 30.0), False)),
    "sound, bursts": Case((), *_of_masses(4, (), Signal("bursts", high=45.0), LEVELS)),
}


def judged(case: Case, d) -> str:
    """Whether an answer is right, in a word."""
    named = {(n.term.mechanism.id, str(n.place)) for n in d.named}
    if not case.there:
        return "right" if d.verdict in ("consistent", "parameters") else "false alarm"
    there = {a for a in case.there if a[0]}
    if not there:
        return "right" if not named and str(d.place) == case.there[0][1] else "wrong"
    if named == there:
        return "right"
    if named:
        return "wrong"
    return "place right, no name" if str(d.place) in [place for _, place in there] else "no name, wrong place"


def main() -> None:
    asked = sys.argv[1:] or list(CASES)
    for name in asked:
        case = CASES[name]
        recordings = case.recordings()
        began = time.process_time()
        d = diagnose(case.model(), observe_all(recordings))
        spent = time.process_time() - began
        print(f"{name}: {judged(case, d)} ({spent:.0f} s)\n    {d.summary}", flush=True)


if __name__ == "__main__":
    main()
