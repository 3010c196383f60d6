"""Cost of exact derivatives in the march of the nonlinear diagnosis, beside that of finite differences.

    python benchmarks/tangents.py

A chain of twelve masses with one law and with two, a multisine of 8192 samples: one march with as many tangents as a
fit carries, and as many marches of the same length without any, which differences ask for. Processor time, the best of
five runs. The derivative to the first law's first parameter is compared with a central difference of steady states.
"""

from __future__ import annotations

import time
from functools import partial

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.force import CODES, N_P
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.steady import Steady
from labnnum.recording import Channel
from labnnum.structures import Chain
from labnnum.structures.chain import Link

MASSES, RATE, PERIOD, REPEATS, CHANGE = 12, 40.0, 8192, 5, 1e-4
LAWS = {"cubic": (3e4,), "stick-slip": (400.0, 6.0)}
TANGENTS = (10, 40, 80)


def chain() -> Chain:
    """Masses on equal springs, tied to the ground at one end."""
    links = [Link("1", "ground", 1000.0, 4.0)] + [Link(str(i), str(i + 1), 1000.0, 4.0) for i in range(1, MASSES)]
    return Chain({str(i + 1): 1.0 for i in range(MASSES)}, tuple(links))


def bench(names: list[str]) -> tuple[Base, Steady, np.ndarray]:
    """Base model, solver and parameters for these laws, each between two masses."""
    outputs = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 4, 9))
    force = Channel("f", "force", "reference", "3", "x")
    engine = Engine(chain(), outputs, (force,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    columns = np.zeros((MASSES, len(names)))
    parameters = np.zeros((len(names), N_P))
    for i, name in enumerate(names):
        columns[2 * i + 1, i], columns[2 * i + 2, i] = -1.0, 1.0
        parameters[i, : len(LAWS[name])] = LAWS[name]
    lines = PERIOD // 2 + 1
    base = Base(engine, engine.start(), columns, 2 * np.pi * np.arange(lines) * RATE / PERIOD)
    rng = np.random.default_rng(1)
    spectrum = np.zeros(lines, complex)
    on = np.arange(PERIOD // 80, 3 * PERIOD // 10, 2)
    spectrum[on] = np.exp(2j * np.pi * rng.random(on.size)) * 25.0 * np.sqrt(2 / on.size)
    none = np.zeros((3, lines))
    run = Run(RATE, PERIOD, spectrum, none + 0j, none, spectrum != 0, 1.0, "run", outputs, force, 1)
    return base, Steady(run, np.array([CODES[n] for n in names]), 2), parameters


def cpu(work) -> float:
    """Processor seconds of the quickest of a few runs."""
    best = np.inf
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return best


def compared(names: list[str]) -> None:
    """Print the ratios for these laws, and how far the derivatives are from differences."""
    base, solver, p = bench(names)
    k = len(names)
    r = base.at(base.start())
    orbit = solver.settle(r, p, solver.guess(r, np.zeros((solver.n, k))), 25, 1e-8)
    made = solver.prepare(r)
    source = solver.source(r, made, orbit.source)
    plain = cpu(lambda: solver._march(made, source, p, orbit))
    rng = np.random.default_rng(0)
    for n in TANGENTS:
        ds = rng.standard_normal((solver.n, k, 2, n), np.float32)
        full = cpu(partial(solver._march, made, source, p, orbit, ds=ds))
        print(f"{' and '.join(names):>22} {n:9d} {full / plain:32.1f} {full / plain / (n + 1):20.3f}")
    vary = np.zeros((k, k, N_P))
    vary[np.arange(k), np.arange(k), 0] = p[:, 0]
    none = np.zeros((0, k, solver.lines)), np.zeros((0, k, k, solver.lines))
    _, slopes = solver.slopes(r, p, orbit, none, vary)
    ends = []
    for sign in (1, -1):
        moved = p.copy()
        moved[0, 0] *= 1 + sign * CHANGE
        ends.append(solver.settle(r, moved, orbit, 25, 1e-9).force)
    difference = ((ends[0] - ends[1]) / (2 * CHANGE))[:, r.lines]
    error = np.linalg.norm(slopes.force[0] - difference) / np.linalg.norm(difference)
    print(f"{'':>22} derivative to the first parameter, from a central difference: {error:.1e}")


def main() -> None:
    """Print all of it."""
    print(f"{'laws':>22} {'tangents':>9} {'one march with, of one without':>32} {'of as many marches':>20}")
    for names in (["cubic"], ["stick-slip"], ["cubic", "stick-slip"]):
        compared(names)


if __name__ == "__main__":
    main()
