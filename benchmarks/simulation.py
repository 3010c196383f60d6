"""Speed and error of nonlinear time simulation beside bare compiled loops and scipy's integrator.

    OMP_NUM_THREADS=1 python benchmarks/simulation.py

One chain of six masses with one law between two of them, driven by smooth noise that begins gently. For each law:

- labnnum's march, which goes to where the law changes within a step;
- the bound: the same 2 x 2 blocks, the same polynomial of the input, and the law written out by hand in one compiled
  loop that asks for no memory, forces straight over the step and nothing sought within it: less is hardly done;
- classical Runge-Kutta 4 on the twelve states, as a C program would do it;
- scipy's solve_ivp (RK45, rtol 1e-6), over a tenth of the time. Of dry friction, which sticks, there is none.

The error is against the march at sixteen times the rate, whose own is far below (`tests/bench/test_events.py` measures
it against located events). Speed is of processor time, the best of several runs in turn, so that ratios stand in other
work's presence.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from labnnum.nonlinear import Element, NonlinearSimulation, part_of_limit
from labnnum.recording import Channel
from labnnum.simulation import blocks, hold_weights
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from labnnum.system import System, system

MASSES, K, C, RATE, SECONDS, FINE = 6, 1000.0, 1.0, 200.0, 40.0, 16
REPEATS, ORDER = 7, 8
LAWS: dict[str, tuple[float, ...]] = {
    "cubic": (3e4,),
    "one-sided-gap": (2e3, 0.02),
    "coulomb": (5.0,),
    "jenkins": (2e3, 8.0),
    "bouc-wen": (2e3, 30.0, 30.0, 1.0),
}
CODES = {name: code for code, name in enumerate(LAWS)}


def chain() -> Chain:
    """Six masses, tied to the ground at one end."""
    links = [Link("1", "ground", K, C)] + [Link(str(i), str(i + 1), K, C) for i in range(1, MASSES)]
    return Chain({str(i + 1): 1.0 for i in range(MASSES)}, tuple(links))


def force(seed: int = 0) -> np.ndarray:
    """Noise below 12 Hz that begins gently, at the highest rate that is compared."""
    n = int(RATE * SECONDS) * FINE
    spectrum = np.zeros(n // 2 + 1, complex)
    top = int(12.0 * SECONDS)
    rng = np.random.default_rng(seed)
    spectrum[1:top] = rng.standard_normal(top - 1) + 1j * rng.standard_normal(top - 1)
    made = np.fft.irfft(spectrum, n)
    return 10.0 * made / made.std() * (1.0 - np.exp(-((np.arange(n) / (RATE * FINE)) ** 8)))


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _bound(code, T, U, zs, vs, before, after, gz, gv, f, out, p, row):
    """Modal blocks with one law at the end of each step; no call but dry friction's, which is compiled into it."""
    order, _, m = U.shape
    q, u = np.zeros(m), np.zeros(m)
    last, place, held, was = 0.0, 0.0, 0.0, 0.0
    for n in range(f.size - order + 1):
        y, z, v = 0.0, 0.0, 0.0
        for b in range(m):
            y += row[b] * q[b]
            one = T[0, b] * q[b] + T[1, b] * u[b] + before[0, b] * last
            two = T[2, b] * q[b] + T[3, b] * u[b] + before[1, b] * last
            for j in range(order):
                one += U[j, 0, b] * f[n + j]
                two += U[j, 1, b] * f[n + j]
            q[b], u[b] = one, two
            z += zs[b] * one
            v += vs[b] * two
        out[n] = y
        new = 0.0
        if code == 0:
            new = last
            for _ in range(20):
                at = z + gz * new
                change = (new + p[0] * at * at * at) / (1.0 + 3.0 * p[0] * at * at * gz)
                new -= change
                if abs(change) <= 1e-13 * abs(new):
                    break
        elif code == 1:
            new = -p[0] * (z - p[1]) / (1.0 + p[0] * gz) if z > p[1] else 0.0
        elif code == 2:
            new = -p[0] * part_of_limit(v, gv * p[0], was)
            was = v + gv * new
        elif code == 3:
            new = -p[0] * (z - place) / (1.0 + p[0] * gz)
            if abs(new) > p[1]:
                new = p[1] if new > 0.0 else -p[1]
                place = z + gz * new + new / p[0]
        else:
            h = held
            for _ in range(20):
                moved, middle = z - gz * p[0] * h - place, 0.5 * (h + held)
                sense = 1.0 if moved * middle > 0.0 else -1.0
                better = held + moved * (1.0 - (p[1] * sense + p[2]) * abs(middle))
                if abs(better - h) <= 1e-12 * abs(better):
                    break
                h = better
            place, held, new = z - gz * p[0] * h, h, -p[0] * h
        for b in range(m):
            q[b] += after[0, b] * new
            u[b] += after[1, b] * new
        last = new


@njit(cache=True, error_model="numpy")
def _runge_kutta(code, a, f, dt, p, out):
    """Classical Runge-Kutta with nothing around it; a slider's place moves at the end of a step."""
    n = a.shape[0]
    half = n // 2
    y, x, k = np.zeros(n + 1), np.zeros(n + 1), np.zeros((4, n + 1))
    place = 0.0
    for step in range(f.size - 1):
        out[step] = y[0]
        for stage in range(4):
            part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            for i in range(n + 1):
                x[i] = y[i] + (dt * part * k[stage - 1, i] if stage else 0.0)
            z, v, g = x[2] - x[1], x[half + 2] - x[half + 1], 0.0
            if code == 0:
                g = p[0] * z * z * z
            elif code == 1:
                g = p[0] * (z - p[1]) if z > p[1] else 0.0
            elif code == 2:
                g = p[0] if v > 0.0 else (-p[0] if v < 0.0 else 0.0)
            elif code == 3:
                g = min(max(p[0] * (z - place), -p[1]), p[1])
            else:
                g = p[0] * x[n]
                k[stage, n] = v - p[1] * abs(v) * x[n] - p[2] * v * abs(x[n])
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += a[i, j] * x[j]
                k[stage, i] = total
            k[stage, half + 1] += g
            k[stage, half + 2] -= g
            k[stage, half] += (1 - part) * f[step] + part * f[step + 1]
        for i in range(n + 1):
            y[i] += dt * (k[0, i] + 2 * k[1, i] + 2 * k[2, i] + k[3, i]) / 6
        if code == 3:
            z = y[2] - y[1]
            place = min(max(place, z - p[1] / p[0]), z + p[1] / p[0])
    out[-1] = y[0]


def bound(made: System, column: np.ndarray, law: str, step: float) -> Callable[[np.ndarray], np.ndarray]:
    """The bare loop on the blocks of `made`, whose modes are not coupled."""
    seen = np.vstack([made.displacement, column])
    none, load = np.zeros_like(seen), np.column_stack([made.load, column])
    split = blocks(System(made.M, made.C, made.K, load, seen, none, none, np.zeros((2, 2))))
    rates = blocks(System(made.M, made.C, made.K, load, none, seen, none, np.zeros((2, 2))))
    m = len(split.A)
    transition, weight = hold_weights(split.A, split.B[:, :, :1], step, ORDER)
    straight = hold_weights(split.A, split.B[:, :, 1:], step, 2)[1][:, :, 0]
    before, after = (np.ascontiguousarray(straight[..., j].T) for j in (0, 1))
    z, v = split.out.reshape(2, m, 2)[1, :, 0], rates.out.reshape(2, m, 2)[1, :, 1]
    T, U = np.ascontiguousarray(transition.reshape(m, 4).T), np.ascontiguousarray(weight[:, :, 0].transpose(2, 1, 0))
    row = np.ascontiguousarray(split.out.reshape(2, m, 2)[0, :, 0])
    p = np.array([*LAWS[law], 0.0])
    z, v = np.ascontiguousarray(z), np.ascontiguousarray(v)
    ahead = np.zeros(ORDER // 2 - 1)

    def run(f: np.ndarray) -> np.ndarray:
        f = np.concatenate([ahead, f])
        out = np.empty(f.size - ORDER + 1)
        _bound(CODES[law], T, U, z, v, before, after, float(z @ after[0]), float(v @ after[1]), f, out, p, row)
        return out

    return run


def slopes(made: System, law: str, fine: np.ndarray) -> Callable:
    """The right-hand side for solve_ivp, with the law's own state last."""
    state = np.block([[np.zeros((MASSES, MASSES)), np.eye(MASSES)], [-made.K, -made.C]])
    times, p = np.arange(fine.size) / (RATE * FINE), LAWS[law]

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        z, v = y[2] - y[1], y[MASSES + 2] - y[MASSES + 1]
        own, g = 0.0, y[-1]
        if law == "cubic":
            g = p[0] * z**3
        elif law == "one-sided-gap":
            g = p[0] * max(z - p[1], 0.0)
        elif law == "jenkins":
            own = p[0] * v if abs(g) < p[1] or g * v < 0 else 0.0
        else:
            g = p[0] * y[-1]
            own = v - p[1] * abs(v) * y[-1] - p[2] * v * abs(y[-1])
        out = np.append(state @ y[:-1], own)
        out[MASSES + 1] += g
        out[MASSES + 2] -= g
        out[MASSES] += np.interp(t, times, fine)
        return out

    return slope


def timed(runs: dict[str, Callable[[], np.ndarray]]) -> dict[str, tuple[np.ndarray, float]]:
    """What each run gives and the best of its processor times, all of them taken in turn."""
    out = {name: (run(), np.inf) for name, run in runs.items()}
    for _ in range(REPEATS):
        for name, run in runs.items():
            begin = time.process_time()
            run()
            out[name] = (out[name][0], min(out[name][1], time.process_time() - begin))
    return out


def compared(law: str, made: System, column: np.ndarray, fine: np.ndarray) -> None:
    """Print the rows of one law."""
    rate, element = RATE * FINE, [Element(law, column, LAWS[law])]
    state = np.block([[np.zeros((MASSES, MASSES)), np.eye(MASSES)], [-made.K, -made.C]])
    truth = NonlinearSimulation(made, element, 1 / rate).run(fine[None])[0]
    runs: dict[str, Callable[[], np.ndarray]] = {}
    for every in (FINE, FINE // 4):
        here, step = np.ascontiguousarray(fine[::every]), every / rate
        march, bare = NonlinearSimulation(made, element, step), bound(made, column, law, step)

        def marched(march=march, here=here) -> np.ndarray:
            march.reset()
            return march.run(here[None])[0]

        def stepped(here=here, step=step) -> np.ndarray:
            out = np.empty(here.size)
            _runge_kutta(CODES[law], state, here, step, np.array([*LAWS[law], 0.0]), out)
            return out

        runs |= {
            f"labnnum, {1 / step:g} Hz": marched,
            f"bound, {1 / step:g} Hz": lambda bare=bare, here=here: bare(here),
            f"Runge-Kutta 4, {1 / step:g} Hz": stepped,
        }
    found = timed(runs)
    if law != "coulomb":
        grid = np.arange(int(RATE * SECONDS / 10)) / RATE
        begin, start = time.process_time(), np.zeros(2 * MASSES + 1)
        y = solve_ivp(slopes(made, law, fine), (0, grid[-1]), start, t_eval=grid, rtol=1e-6, atol=1e-9).y[0]
        found["solve_ivp RK45"] = (y, time.process_time() - begin)
    for name, (y, took) in found.items():
        there = truth[:: FINE // 4] if "800" in name else truth[::FINE]
        n = min(there.size, y.size) - ORDER
        error = np.linalg.norm(y[:n] - there[:n]) / np.linalg.norm(there[:n])
        least = found["bound, 800 Hz" if "800" in name else "bound, 200 Hz"]
        ratio = (took / y.size) / (least[1] / least[0].size)
        print(f"{law:15}{name:24}{y.size / took:14,.0f}{ratio:12.2f}{error:12.1e}", flush=True)


def main() -> None:
    """Print the table."""
    made = system(chain(), np.zeros(0), [Channel("x", "displacement", "response", "1", "x")],
                  [Channel("f", "force", "reference", "1", "x")])  # fmt: skip
    column = np.zeros(MASSES)
    column[1], column[2] = -1.0, 1.0
    print(f"{'law':15}{'':24}{'samples a s':>14}{'of bound':>12}{'error':>12}")
    for law in LAWS:
        compared(law, made, column, force())


if __name__ == "__main__":
    main()
