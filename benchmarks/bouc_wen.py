"""The hysteretic benchmark of Noël and Schoukens: its equations, a base identified at a quiet level, and the diagnosis.

    python benchmarks/bouc_wen.py

m y'' + c y' + k y + z = u, z' = alpha y' - beta (gamma |y'| |z|^(nu-1) z + delta y' |z|^nu) with m 2 kg, c 10 N s/m,
k = alpha = 5e4 N/m, beta 1e3 1/m, gamma 0.8, delta -1.1 and nu 1, of the class in which loading stiffens. The truth is
integrated here by Runge and Kutta's method of fourth order at 15 kHz, and recorded at 750 Hz through an ideal filter.
Fitted are random-phase multisines of 5 to 150 Hz at four levels up to the benchmark's 50 N RMS, with noise of 8 nm to
8 um RMS; tested is `extended.toml` alone, simulated from another multisine of 50 N and from a sweep of 40 N, 20 to
50 Hz, without noise.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from numba import njit

from labnnum.diagnosis import observe_all
from labnnum.identification import identify
from labnnum.nonlinear import NonlinearSimulation
from labnnum.recording import Channel, Recording
from labnnum.system import system
from sessions.diagnose import run_observed, write_answer
from sessions.identify import tables_of
from sessions.model import read_model
from sessions.toml_write import dumps

M, C, K, ALPHA, BETA, GAMMA, DELTA = 2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1
RATE, FINE, PERIOD = 750.0, 20, 8192
LEVELS = (2.0, 10.0, 25.0, 50.0)
FORCE, MOTION = Channel("u", "force", "reference", "1", "x"), Channel("y", "displacement", "response", "1", "x")


@njit(cache=True)
def _rates(y, v, z, u, m, c, k, alpha, beta, gamma, delta):
    return v, (u - c * v - k * y - z) / m, alpha * v - beta * (gamma * abs(v) * z + delta * v * abs(z))


@njit(cache=True)
def _march(u, dt, p):
    """Positions (n,) under the force u (n,), from rest, which is a straight line between its samples."""
    m, c, k, alpha, beta, gamma, delta = p
    y = v = z = 0.0
    out = np.empty(u.size)
    for i in range(u.size):
        out[i] = y
        now, then = u[i], u[(i + 1) % u.size]
        half = 0.5 * (now + then)
        a = _rates(y, v, z, now, m, c, k, alpha, beta, gamma, delta)
        b = _rates(y + 0.5 * dt * a[0], v + 0.5 * dt * a[1], z + 0.5 * dt * a[2], half, m, c, k, alpha, beta, gamma,
                   delta)  # fmt: skip
        d = _rates(y + 0.5 * dt * b[0], v + 0.5 * dt * b[1], z + 0.5 * dt * b[2], half, m, c, k, alpha, beta, gamma,
                   delta)  # fmt: skip
        e = _rates(y + dt * d[0], v + dt * d[1], z + dt * d[2], then, m, c, k, alpha, beta, gamma, delta)
        y += dt / 6 * (a[0] + 2 * b[0] + 2 * d[0] + e[0])
        v += dt / 6 * (a[1] + 2 * b[1] + 2 * d[1] + e[1])
        z += dt / 6 * (a[2] + 2 * b[2] + 2 * d[2] + e[2])
    return out


def truth(u: np.ndarray) -> np.ndarray:
    """Positions (n,) of the system under the force u (n,), both at the fine rate."""
    return _march(u, 1 / (RATE * FINE), (M, C, K, ALPHA, BETA, GAMMA, DELTA))


def multisine(rng: np.random.Generator, rms: float) -> np.ndarray:
    """One period at the fine rate, of 5 to 150 Hz and random phases."""
    n = PERIOD * FINE
    f = np.arange(n // 2 + 1) * RATE / PERIOD
    on = (f >= 5) & (f <= 150)
    u = np.fft.irfft(np.where(on, np.exp(2j * np.pi * rng.random(f.size)), 0.0), n)
    return rms * u / u.std()


def swept(amplitude: float, low: float = 20.0, high: float = 50.0, per_minute: float = 10.0) -> np.ndarray:
    """A sine whose frequency rises evenly, at the fine rate."""
    seconds = 60 * (high - low) / per_minute
    t = np.arange(int(seconds * RATE * FINE)) / (RATE * FINE)
    return amplitude * np.sin(2 * np.pi * (low * t + (high - low) / (2 * seconds) * t**2))


def recorded(rng: np.random.Generator, rms: float, noise: float, number: int) -> Recording:
    """Four periods of a steady state, eight at the lowest level."""
    u = multisine(rng, rms)
    y = truth(np.tile(u, 3))[-u.size :]
    low = np.fft.rfft(y)[: PERIOD // 2 + 1] / FINE
    one = np.vstack([u[::FINE], np.fft.irfft(low, PERIOD)])
    data = np.tile(one, 8 if rms == LEVELS[0] else 4)
    data[1] += noise * rng.standard_normal(data.shape[1])
    return Recording((FORCE, MOTION), data, RATE, period=PERIOD, label=f"{rms:g} N, run {number}")


def simulated(folder: Path, u: np.ndarray) -> np.ndarray:
    """What extended.toml answers to the force u (n,) at the fine rate, from rest."""
    structure = read_model(folder / "extended.toml").structure
    plant = system(structure, structure.nominal, [MOTION], [FORCE])
    return NonlinearSimulation(plant, structure.law_elements(), 1 / (RATE * FINE)).run(u[None])[0]


def main() -> None:
    """What is said of the system at three levels of noise, and how far what is simulated is off."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    a = parser.parse_args()
    for noise in (8e-9, 8e-7, 8e-6):
        rng = np.random.default_rng([a.seed, int(1e9 * noise)])
        runs = observe_all([recorded(rng, level, noise, i + 1) for level in LEVELS for i in range(2)])
        begun = time.process_time()
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            found = identify(runs[0].frf, 40)
            tables = tables_of(found, runs[0].frf, (5.0, 150.0))
            (folder / "base.toml").write_text(dumps(tables), encoding="utf-8")
            model = read_model(folder / "base.toml")
            d = run_observed(runs, model)
            write_answer(folder, model, d)
            print(f"noise {1e6 * noise:g} um: {d.summary} ({time.process_time() - begun:.0f} s of processor time)")
            if not d.named:
                continue
            rng = np.random.default_rng([a.seed, 1])
            for what, u in (("multisine, 50 N", np.tile(multisine(rng, 50.0), 2)), ("sweep, 40 N", swept(40.0))):
                y, made = truth(u), simulated(folder, u)
                some = slice(u.size // 2 if what.startswith("multisine") else 0, None, FINE)
                off = np.sqrt(np.mean((made[some] - y[some]) ** 2))
                print(f"  {what}: {1e6 * off:.2f} um RMS of {1e6 * np.std(y[some]):.0f}")


if __name__ == "__main__":
    main()
