"""Speed of nonlinear time simulation: the bench's march beside scipy.solve_ivp and a bare compiled Runge-Kutta loop.

    python benchmarks/simulation.py

One chain of six masses with a cubic spring between two of them, driven by noise held between samples. All three run
the same seconds; the error of each is against the march at sixteen times the rate. Speed is of processor time, the best
of five runs, so that other work on the machine counts little.
"""

from __future__ import annotations

import time

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from labnnum.nonlinear import Element, NonlinearSimulation
from labnnum.recording import Channel
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from labnnum.system import system

MASSES, K, C, K3, RATE, SECONDS = 6, 1000.0, 1.0, 3e4, 200.0, 40.0
REPEATS = 5


def chain() -> Chain:
    """Six masses, tied to the ground at one end."""
    links = [Link("1", "ground", K, C)] + [Link(str(i), str(i + 1), K, C) for i in range(1, MASSES)]
    return Chain({str(i + 1): 1.0 for i in range(MASSES)}, tuple(links))


def force(seed: int = 0) -> np.ndarray:
    """Smooth noise below 12 Hz, at the highest rate that is compared."""
    n = int(RATE * SECONDS) * 16
    spectrum = np.zeros(n // 2 + 1, complex)
    top = int(12.0 * SECONDS)
    rng = np.random.default_rng(seed)
    spectrum[1:top] = rng.standard_normal(top - 1) + 1j * rng.standard_normal(top - 1)
    made = np.fft.irfft(spectrum, n)
    return 10.0 * made / made.std()


@njit(cache=True)
def _bare(a: np.ndarray, f: np.ndarray, dt: float, k3: float) -> np.ndarray:
    """Classical Runge-Kutta with nothing around it: what a C loop would do."""
    n = a.shape[0]
    out = np.zeros(f.size)
    y = np.zeros(n)
    k = np.zeros((4, n))
    for step in range(f.size - 1):
        out[step] = y[0]
        for stage in range(4):
            part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            x = y if stage == 0 else y + dt * part * k[stage - 1]
            u = (1 - part) * f[step] + part * f[step + 1]
            z = x[2] - x[1]
            g = k3 * z**3
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += a[i, j] * x[j]
                k[stage, i] = total
            half = n // 2
            k[stage, half + 1] += g
            k[stage, half + 2] -= g
            k[stage, half] += u
        y = y + dt * (k[0] + 2 * k[1] + 2 * k[2] + k[3]) / 6
    out[-1] = y[0]
    return out


def main() -> None:
    """Print the table."""
    made = system(chain(), np.zeros(0), [Channel("x", "displacement", "response", "1", "x")],
                  [Channel("f", "force", "reference", "1", "x")])  # fmt: skip
    column = np.zeros(MASSES)
    column[1], column[2] = -1.0, 1.0
    element = [Element("cubic", column, (K3,))]
    fine = force()
    rate = RATE * 16
    truth = NonlinearSimulation(made, element, 1 / rate).run(fine[None])[0]
    state = np.block([[np.zeros((MASSES, MASSES)), np.eye(MASSES)], [-made.K, -made.C]])
    rows = []

    def add(name: str, run, every: int) -> None:
        out, took = run(), np.inf
        for _ in range(REPEATS):
            begin = time.process_time()
            run()
            took = min(took, time.process_time() - begin)
        there = truth[::every]
        n = min(there.size, out.size) - 8
        error = np.linalg.norm(out[:n] - there[:n]) / np.linalg.norm(there[:n])
        rows.append((name, out.size, out.size / took, error))

    for every in (16, 8):
        march = NonlinearSimulation(made, element, every / rate)

        def marched(march=march, every=every):
            march.reset()
            return march.run(fine[None, ::every])[0]

        add(f"labnnum, {rate / every:g} Hz", marched, every)
    for every in (16, 8):
        add(f"compiled Runge-Kutta 4, {rate / every:g} Hz",
            lambda every=every: _bare(state, fine[::every].copy(), every / rate, K3), every)  # fmt: skip
    grid = np.arange(int(RATE * SECONDS)) / RATE
    times = np.arange(fine.size) / rate

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        out = state @ y
        g = K3 * (y[2] - y[1]) ** 3
        out[MASSES + 1] += g
        out[MASSES + 2] -= g
        out[MASSES] += np.interp(t, times, fine)
        return out

    def adaptive():
        start = np.zeros(2 * MASSES)
        return solve_ivp(slope, (0, grid[-1]), start, t_eval=grid, rtol=1e-6, atol=1e-9).y[0]

    add("scipy solve_ivp RK45, rtol 1e-6", adaptive, 16)
    print(f"{'':36}{'samples':>9}{'samples a second':>19}{'relative error':>16}")
    for name, n, speed, error in rows:
        print(f"{name:36}{n:9d}{speed:19,.0f}{error:16.1e}")


if __name__ == "__main__":
    main()
