"""Adaptive control in simulated real time: the truck drifts, every block updates the model, and the gain follows.

The loop stays closed while it is identified. Wheel force and a dither on the actuator are multisines; in the second
half of a block the dither changes its sign, so that two experiments tell the FRF from the wheel from that of the
actuator, whatever the controller does meanwhile:

    (Y1, Y2) = (G_P, G_u) [[P1, P2], [U1, U2]]    at every line

The second experiment is the mean of the ones before and after the first: what drifts evenly is then the same in both.
The network answers from G_P, least squares refine it, and a new regulator and observer take over.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from labnnum.control import decay, modulus_margin, observer_feedback
from labnnum.frf import Frf
from labnnum.parameters import bounds
from labnnum.structures.examples import EXAMPLES, truck
from labnnum.updating import Updater
from labnnum.updating.refine import refine
from sessions.reproduce.control import Gains, gains, system, weights
from sessions.reproduce.networks import Say

RATE = 1000.0
"""Samples a second of the controller."""

PERIOD = 10.0
"""Seconds of the multisines: lines 0.1 Hz apart."""

FORCE, DITHER = 100.0, 40.0
"""RMS of the wheel's force and of the dither, N."""

SENSOR = 3e-6
"""RMS of the noise of the seat's displacement sensor, m."""

FLOOR = 0.01
"""Relative error granted to the model's FRF: the truck moves on while it is measured."""

MEASURED = 0.375
"""Share of a block that has passed at the middle of its first half's measurement, the second of its four periods."""

OMEGA = np.geomspace(2.0, 200.0, 1500)


@dataclass(frozen=True, eq=False)
class Block:
    """One block of the walk.

    Parameters
    ----------
    end : float
        Seconds since the start.
    truth, estimate, std : ndarray, shape (n_parameters,)
        Truth at the middle of what was measured, which is when the first half of the block was; the deviations hold
        what the parameters move during that period.
    fixed, adaptive : (decay in 1/s, modulus margin)
        Of the nominal gain and of the one in force after the block, on the truth at its end; the margin of an unstable
        loop is 0.
    latency : dict of stage -> seconds
    warnings : tuple of str
    """

    end: float
    truth: NDArray[np.float64]
    estimate: NDArray[np.float64]
    std: NDArray[np.float64]
    fixed: tuple[float, float]
    adaptive: tuple[float, float]
    latency: dict[str, float]
    warnings: tuple[str, ...]


def truth_at(share: float) -> NDArray[np.float64]:
    """The truck's parameters at a share of the walk: drivers change, springs age, dashpots warm."""
    low, high = bounds(truck().parameters)
    driver = 0.5 if share < 0.25 else 0.2 if share < 0.6 else 0.85
    place = np.array([
        driver, 0.5 - 0.35 * np.sin(2 * np.pi * share), 0.5 - 0.4 * share, 0.5 + 0.3 * np.sin(np.pi * share),
        0.5 - 0.3 * np.sin(np.pi * share),
    ])  # fmt: skip
    return low + place * (high - low)


def drift(blocks: int, seed: int, say: Say, ratio: float = 1e-2, samples: int = 2000) -> list[Block]:
    """The walk through a drift, `blocks` blocks of four periods each.

    Parameters
    ----------
    blocks : int
    seed : int
    ratio : float
        R/Q.
    samples : int
        Training samples of the network.
    """
    w = weights(ratio)
    updater = _updater(samples, seed, say)
    plant = _Plant(seed)
    nominal = gains(truck().nominal, w)
    g, out = nominal, []
    before = [plant.run(nominal, -1.0, lambda _: truth_at(0.0)) for _ in range(2)][-1]
    for number in range(blocks):
        halves = [before]
        for half, sign in enumerate((1.0, -1.0)):
            settling, measured = (partial(_truth_in, number, 2 * half + period, blocks) for period in (0, 1))
            plant.run(g, sign, settling)  # for the transient of the new gain, or of the new sign, to die out
            halves.append(plant.run(g, sign, measured))
        before = halves[-1]
        found, std, warnings, latency = _updated(updater, halves)
        if out:
            std = with_drift(std, found, out[-1].estimate)
        begin = time.perf_counter()
        g = gains(np.clip(found, *_reach()), w)
        latency["gains"] = time.perf_counter() - begin
        after = system(truth_at((number + 1) / blocks))
        out.append(Block(
            (number + 1) * 4 * PERIOD, truth_at((number + MEASURED) / blocks), found, std, _stability(after, nominal),
            _stability(after, g), latency, warnings,
        ))  # fmt: skip
        say("drifting", number + 1, blocks)
    return out


def with_drift(std: NDArray, found: NDArray, before: NDArray) -> NDArray[np.float64]:
    """Deviations (n_parameters,) of a block with what the parameters move while they are measured.

    A refinement knows noise and the model's error line by line, and takes the parameters as constant. What moves evenly
    from the estimate of the block `before` to the one `found` covers a quarter of that way during the period in which
    it is measured, and is spread evenly over it: a deviation of that quarter over the root of twelve.

    Examples
    --------
    >>> with_drift(np.array([3.0, 3.0]), np.array([10.0, 10.0]), np.array([10.0, 10.0 - 16 * 12**0.5]))
    array([3., 5.])
    """
    return np.hypot(std, (found - before) / 4 / np.sqrt(12))


def _truth_in(number: int, period: int, blocks: int, share: float) -> NDArray[np.float64]:
    """The truth at a share of one of the four periods of a block."""
    return truth_at((number + (period + share) / 4) / blocks)


def _reach() -> tuple[NDArray, NDArray]:
    """Values that a controller is made for: somewhat beyond the bounds."""
    low, high = bounds(truck().parameters)
    return low - 0.2 * (high - low), high + 0.2 * (high - low)


def _stability(plant: Any, g: Gains) -> tuple[float, float]:
    rate = decay(observer_feedback(plant, g.model, g.K, g.L))
    return rate, modulus_margin(plant, g.model, g.K, g.L, OMEGA) if rate > 0 else 0.0


def _updater(samples: int, seed: int, say: Say) -> Updater:
    e = EXAMPLES["truck"]()
    lines = _lines()
    return Updater.train(
        e.structure, e.bands, e.outputs[:1], e.inputs, lines, samples=samples, centres=400, noise=0.01, seed=seed,
        features="score", progress=lambda done, total: say("training", done, total),
    )  # fmt: skip


def _lines() -> NDArray[np.float64]:
    return np.arange(12, 70) / PERIOD


class _Plant:
    """The simulated truck with sensor, controller and excitation; it keeps its state from one period to the next."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.n = round(PERIOD * RATE)
        self.wheel, self.dither = self._multisine(FORCE), self._multisine(DITHER)
        self.x, self.observer = np.zeros(6), np.zeros(6)

    def _multisine(self, rms: float) -> NDArray[np.float64]:
        lines, t = _lines(), np.arange(self.n) / RATE
        phase = self.rng.uniform(0, 2 * np.pi, lines.size)
        wave = np.cos(2 * np.pi * np.outer(t, lines) + phase).sum(axis=1)
        return rms * wave / np.sqrt((wave**2).mean())

    def run(self, g: Gains, sign: float, truth: Callable[[float], NDArray]) -> tuple[NDArray, NDArray, NDArray]:
        """One period: wheel force, actuator force and measured seat, each (n,)."""
        k, gain = g.K[0], g.L[:, 0]
        believed = g.model.A - np.outer(gain, g.model.C[0]) - np.outer(g.model.B[:, 0], k)
        step, taken = _discrete(believed, np.column_stack([gain, g.model.B[:, 0]]))
        noise = SENSOR * self.rng.standard_normal(self.n)
        actuator, seat = np.empty(self.n), np.empty(self.n)
        every = round(RATE)
        for i in range(self.n):
            if i % every == 0:
                plant = system(truth(i / self.n))
                moves, pushed = _discrete(plant.A, np.column_stack([plant.G, plant.B]))
            seat[i] = self.x[2] + noise[i]
            actuator[i] = -k @ self.observer + sign * self.dither[i]
            self.x = moves @ self.x + pushed @ np.array([self.wheel[i], actuator[i]])
            self.observer = step @ self.observer + taken @ np.array([seat[i], sign * self.dither[i]])
        return self.wheel, actuator, seat


def _discrete(a: NDArray, b: NDArray) -> tuple[NDArray, NDArray]:
    """Exact steps of 1/RATE with inputs held."""
    n, m = b.shape
    whole = linalg.expm(np.block([[a, b], [np.zeros((m, n + m))]]) / RATE)
    return whole[:n, :n], whole[:n, n:]


def _updated(
    updater: Updater, halves: list[tuple[NDArray, NDArray, NDArray]]
) -> tuple[NDArray, NDArray, tuple[str, ...], dict[str, float]]:
    """Parameters from three experiments (-, +, -), with the seconds that each stage took."""
    marks = [time.perf_counter()]
    frf = _measured(updater, halves)
    marks.append(time.perf_counter())
    first = updater.predict(updater.features(updater.frequency, frf.value))
    marks.append(time.perf_counter())
    found = refine(updater.structure, frf, first, bands=updater.bands, view=None, floor=FLOOR)
    marks.append(time.perf_counter())
    stages: dict[str, float] = dict(zip(("frf", "network", "refinement"), np.diff(marks).tolist(), strict=True))
    return found.value, found.std, found.warnings, stages


def _measured(updater: Updater, halves: list[tuple[NDArray, NDArray, NDArray]]) -> Frf:
    """FRF from the wheel, with the loop closed and forces held between samples."""
    lines = updater.frequency
    at = np.round(lines * PERIOD).astype(int)
    early, first, late = (np.array([np.fft.rfft(wave)[at] for wave in half]) for half in halves)
    p, u, y = np.moveaxis(np.stack([first, (early + late) / 2]), 0, -1)
    inverse = np.linalg.inv(np.stack([p, u], axis=1))
    value = np.einsum("fk,fkj->fj", y, inverse)[:, 0]
    n = round(PERIOD * RATE)
    variance = n * SENSOR**2 * (np.abs(inverse[:, :, 0]) ** 2 * (1.0, 0.5)).sum(axis=1)
    held = np.exp(-1j * np.pi * lines / RATE) * np.sinc(lines / RATE)  # what holding does to a force
    e = EXAMPLES["truck"]()
    return Frf(lines, (value / held)[None, None], e.outputs[:1], e.inputs,
               variance=(variance / np.abs(held) ** 2)[None, None], settings={"periodic": True})  # fmt: skip
