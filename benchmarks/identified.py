"""Laws concealed on structures of which no model is given: the base is identified from the quietest level.

    python benchmarks/identified.py --cases 40 --seed 1

Chains of three to five masses with random springs, masses and dashpots, driven at one mass by multisines at four
levels; accelerometers on the driven mass and on both ends of the place. One law at a random place, or none; its
strength is drawn by what it does at the loudest level. The truth marches with `labnnum.nonlinear`, which the
diagnosis does not use, at 32 times the recorder's rate. A chain with a mode that hardly moves the driven mass is drawn
again: nobody can identify it from there.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator, default_rng

from labnnum.diagnosis import diagnose, observe_all
from labnnum.errors import EstimationError, ModelError
from labnnum.identification import identify
from labnnum.nonlinear import Element, NonlinearSimulation
from labnnum.recording import Channel, Recording
from labnnum.response import modes
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from labnnum.system import system

PERIOD, FINE, LEVELS, PERIODS = 1024, 32, (1.0, 5.0, 12.0, 25.0), 7
NAMES = {
    "cubic": "cubic-stiffness", "quadratic": "quadratic-stiffness", "one-sided-gap": "one-sided-gap",
    "clearance": "clearance", "quadratic-damping": "quadratic-damping", "jenkins": "stick-slip",
    "bouc-wen": "hysteresis", "spread": "stick-slip", "none": "nothing",
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A chain, where it is driven, and what is concealed at which place."""

    structure: Chain
    drive: str
    place: tuple[str, str | None]
    law: str
    elements: tuple[Element, ...]
    parameters: dict[str, float]
    rate: float
    noise: float


def drawn(rng: Generator) -> Case:
    """A case whose modes all move the driven mass, and whose law does not carry it off."""
    while True:
        case = _drawn(rng)
        try:
            y = _marched(case, _multisine(rng, case, LEVELS[-1]))
        except ModelError:
            continue
        if np.isfinite(y).all():
            return case


def _drawn(rng: Generator) -> Case:
    while True:
        n = int(rng.integers(3, 6))
        k, m = rng.uniform(600, 1600, n), rng.uniform(0.7, 1.4, n)
        pairs = [("1", "ground"), *((str(i), str(i + 1)) for i in range(1, n))]
        links = tuple(Link(a, b, float(x), float(0.004 * x)) for (a, b), x in zip(pairs, k, strict=True))
        chain = Chain({str(i + 1): float(x) for i, x in enumerate(m)}, links)
        drive = int(rng.integers(0, n))
        found = modes(chain, chain.nominal)
        if np.abs(found.shape[drive]).min() > 0.15 and np.diff(found.frequency).min() > 0.3:
            break
    spot = int(rng.integers(0, 2 * n - 1))
    place = (str(spot + 1), None) if spot < n else (str(spot - n + 1), str(spot - n + 2))
    rate = 4.5 * float(found.frequency[-1])
    noise = float(10 ** rng.uniform(-3, -2))
    law = str(rng.choice(list(NAMES)))
    bare = Case(chain, str(drive + 1), place, law, (), {}, rate, noise)
    column = _column(bare)
    z = _marched(bare, _multisine(rng, bare, LEVELS[-1]), column)[-1]
    size, stiff = float(np.abs(z).max()), float(k.mean())
    part, share = float(rng.uniform(0.25, 1.0)), float(rng.uniform(0.2, 0.6))
    speed = float(np.abs(np.gradient(z)).max() * rate * FINE)
    told = {
        "cubic": {"k3": part * stiff / size**2},
        "quadratic": {"k2": 0.4 * part * stiff / size},
        "one-sided-gap": {"k": part * stiff, "g": share * size},
        "clearance": {"k": part * stiff, "g": share * size},
        "quadratic-damping": {"c2": 0.02 * part * stiff / speed},
        "jenkins": {"k_t": part * stiff, "F_s": share * part * stiff * size},
        "spread": {"k_t": part * stiff, "F_s": share * part * stiff * size, "spread": float(rng.uniform(0.5, 1.0))},
        "bouc-wen": {"k": part * stiff, "limit": share * size, "n": 2.0, "beta_share": 0.6},
        "none": {},
    }[law]
    return Case(chain, str(drive + 1), place, law, _elements(law, column, told), told, rate, noise)


def _elements(law: str, column: np.ndarray, p: dict[str, float]) -> tuple[Element, ...]:
    if law == "none":
        return ()
    if law == "spread":
        odds = 1 + p["spread"] * np.linspace(-1, 1, 25)[1::2]
        return tuple(Element("jenkins", column, (p["k_t"] / 12, p["F_s"] / 12 * float(o))) for o in odds)
    if law == "bouc-wen":
        n, share, limit = p["n"], p["beta_share"], p["limit"]
        return (Element(law, column, (p["k"], share / limit**n, (1 - share) / limit**n, n)),)
    return (Element(law, column, tuple(p.values())),)


def _column(case: Case) -> np.ndarray:
    a, b = case.place
    row = case.structure.participation(f"{a}:x", case.structure.nominal)
    return row if b is None else case.structure.participation(f"{b}:x", case.structure.nominal) - row


def _multisine(rng: Generator, case: Case, level: float) -> np.ndarray:
    top = int(0.3 * PERIOD)
    lines = np.arange(5, top, 2)
    on = lines[rng.random(lines.size) > 0.2]
    out = np.zeros(PERIOD // 2 + 1, complex)
    out[on] = np.exp(2j * np.pi * rng.random(on.size)) * level * np.sqrt(2 / on.size)
    return out


def _marched(case: Case, spectrum: np.ndarray, seen: np.ndarray | None = None) -> np.ndarray:
    """One period of the accelerations at the sensors, and of the motion `seen`, at FINE times the rate."""
    n = PERIOD * FINE
    one = np.fft.irfft(np.pad(spectrum, (0, n // 2 - PERIOD // 2)) * n / 2, n)
    s = case.structure
    force = Channel("f", "force", "reference", case.drive, "x")
    plant = system(s, s.nominal, _sensors(case) if seen is None else _everything(s), [force])
    march = NonlinearSimulation(plant, case.elements, 1 / (case.rate * FINE))
    y = march.run(np.tile(one, PERIODS)[None])[:, (PERIODS - 2) * n : (PERIODS - 1) * n]
    return y if seen is None else (seen @ y)[None]


def _everything(s: Chain) -> list[Channel]:
    return [Channel(f"x{d}", "displacement", "response", d.partition(":")[0], "x") for d in s.dofs]


def _sensors(case: Case) -> tuple[Channel, ...]:
    nodes = sorted({case.drive, *(p for p in case.place if p is not None)})
    return tuple(Channel(f"a{i}", "acceleration", "response", i, "x") for i in nodes)


def measured(case: Case, rng: Generator) -> list[Recording]:
    """Two realisations of four periods at each level, through the recorder's filter, with noise as at the quietest."""
    out, floor = [], None
    force = Channel("f", "force", "reference", case.drive, "x")
    for level in LEVELS:
        for number in range(2):
            u = _multisine(rng, case, level)
            y = np.fft.rfft(_marched(case, u), axis=1)[:, : PERIOD // 2 + 1] / (PERIOD * FINE)
            y = np.fft.irfft(y * PERIOD, PERIOD, axis=1)
            floor = case.noise * y.std(axis=1, keepdims=True) if floor is None else floor
            data = np.tile(np.vstack([np.fft.irfft(u * PERIOD / 2, PERIOD), y]), 4)
            data[1:] += floor * rng.standard_normal((len(y), data.shape[1]))
            label = f"level {level:g} run {number + 1}"
            out.append(Recording((force, *_sensors(case)), data, case.rate, period=PERIOD, label=label))
    return out


def judged(case: Case, rng: Generator) -> tuple[str, str, bool, list[float], float]:
    """What is concealed, what was said, whether that is right, relative errors of parameters, processor seconds."""
    begun = time.process_time()
    observations = observe_all(measured(case, rng))
    begun = time.process_time() - begun
    where = f"ground {case.place[0]}" if case.place[1] is None else f"joint {case.place[0]}-{case.place[1]}"
    truth = "nothing" if case.law == "none" else f"{NAMES[case.law]} at {where}"
    start = time.process_time()
    try:
        base = identify(observations[0].frf, 40).structure
    except EstimationError as error:
        return truth, f"no base: {error}", False, [], begun
    nodes = [c.node for c in _sensors(case)]
    places = {"nodes": nodes, "elements": [(a, b) for i, a in enumerate(nodes) for b in nodes[i + 1 :]], "supports": []}
    found = diagnose(base, observations, places=places)
    seconds = time.process_time() - start
    said = ", ".join(f"{n.term.mechanism.id} at {n.place}" for n in found.named) or found.verdict
    right = said == truth or (case.law == "none" and found.verdict in ("consistent", "parameters"))
    off = []
    if right and found.named:
        told = {p.name: v for p, v in zip(found.named[0].term.parameters, found.named[0].value, strict=True)}
        off = [abs(told[n] / v - 1) for n, v in case.parameters.items() if n in told and n not in ("n", "beta_share")]
    return truth, f"{said} (base {100 * base.error:.2g} %)", right, off, seconds


def main() -> None:
    """Print each case and how many were right."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    a = parser.parse_args()
    count, errors, seconds = 0, [], []
    for i in range(a.cases):
        rng = default_rng([a.seed, i])
        case = drawn(rng)
        truth, said, right, off, cpu = judged(case, rng)
        count += right
        errors += off
        seconds.append(cpu)
        worst = f", parameters within {100 * max(off):.1f} %" if off else ""
        print(f"{i + 1:3d} {'ok' if right else 'NO'}  {truth}: {said}{worst}; {cpu:.0f} s", flush=True)
    print(f"right {count} of {a.cases}; parameters off by {100 * np.median(errors or [np.nan]):.2g} % in the median;"
          f" {np.median(seconds):.1f} s a case")  # fmt: skip


if __name__ == "__main__":
    main()
