"""How far leakage moves H1 of a lightly damped oscillator, and how much of that the window's view of it explains.

    python benchmarks/leakage.py --segments 100 --runs 40 --seed 1 [--json]

White force, no noise at all; H1 from each run is compared with the exact FRF and with the exact FRF seen through the
same window, on the lines within five half-power bandwidths (ten lines at least) of the resonance. "explained" is what
is left, in shares of the largest |H|: of one run (its random error), and of the mean over all runs with its own
standard error (what no averaging removes: the bias of a ratio of averages). Coherence falls though nothing is
nonlinear.
"""

from __future__ import annotations

import argparse
import json

import numpy as np
from scipy.signal import freqz, lfilter

from labnnum.estimators import H1
from labnnum.leakage import WindowView
from labnnum.recording import Channel, Recording
from labnnum.spectra import Welch

RATE, F0 = 512.0, 60.0
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"))


def one(rng: np.random.Generator, welch: Welch, segments: int, damping: float) -> tuple[np.ndarray, ...]:
    pole = 2 * np.pi * F0 * complex(-damping, np.sqrt(1 - damping**2)) / RATE
    a = np.real(np.poly(np.exp([pole, np.conj(pole)])))
    b = [0.0, np.exp(pole.real) * np.sin(pole.imag)]
    settle = int(12 / -pole.real)
    force = rng.standard_normal(segments * welch.hop + welch.n_segment + settle)
    data = np.stack([force, lfilter(b, a, force)])[:, settle:]
    reach = max(10 * RATE / welch.n_segment, 10 * damping * F0)
    frf = H1(welch)(Recording(CHANNELS, data, RATE)).lines(F0 - reach, F0 + reach)
    view = WindowView.on_lines(frf.settings, frf.frequency, refine=32)

    def model(f: np.ndarray) -> np.ndarray:
        return freqz(b, a, 2 * np.pi * f / RATE)[1]

    assert frf.coherence is not None
    return frf.value[0, 0], model(frf.frequency), view.apply(model(view.frequency)), frf.coherence[0]


def case(seed: int, welch: Welch, segments: int, runs: int, damping: float) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    results = [one(rng, welch, segments, damping) for _ in range(runs)]
    value = np.array([r[0] for r in results])
    exact, seen = results[0][1], results[0][2]
    top = np.abs(exact).max()
    mean = value.mean(axis=0)
    worst = int(np.argmax(np.abs(mean - seen)))
    return {
        "lines per bandwidth": 2 * damping * F0 * welch.n_segment / RATE,
        "bias of H1": float(np.abs(mean - exact).max() / top),
        "explained, one run": float(np.sqrt(np.mean(np.abs(value - seen) ** 2, axis=0)).max() / top),
        "explained, mean": float(np.abs(mean - seen)[worst] / top),
        "its standard error": float(np.sqrt(np.var(value[:, worst]) / runs) / top),
        "lowest coherence": float(np.mean([r[3].min() for r in results])),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--segments", type=int, default=100)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    result = {}
    for name, overlap in (("hann", 0.5), ("boxcar", 0.0), ("blackmanharris", 0.75)):
        for damping in (0.002, 0.005, 0.02):
            welch = Welch(1024, name, overlap, "none")
            result[f"{name}, damping {damping:.1%}"] = case(args.seed, welch, args.segments, args.runs, damping)
    if args.json:
        print(json.dumps(result, indent=1))
        return
    keys = list(next(iter(result.values())))
    print(" " * 30 + "".join(f"{k:>22s}" for k in keys))
    for name, row in result.items():
        print(f"{name:30s}" + "".join(f"{row[k]:22.4f}" for k in keys))


if __name__ == "__main__":
    main()
