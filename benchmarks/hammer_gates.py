"""How often the hammer gates are wrong: false alarms on clean hits, misses on faulty ones, beside pyFRF's checks.

    python benchmarks/hammer_gates.py --hits 2000 --seed 1 [--tips] [--recordings DIR] [--json]

Hits are simulated by code that shares nothing with the gates: pulses of five families, 0.2 to 5 ms, skewed and with
shoulders, on a structure of random modes; force sensor and anti-alias ringing, white noise, hum, offset, 12 to 24
bits or none. Faults: a second pulse of a fifth to all of the main one, before or after it; clipping of any
channel at 50 to 95 % of its peak (an amplifier's, before noise and converter, or the converter's own).
Rates come with 95 % Clopper-Pearson limits. With --tips so many hits are drawn of each kind for each hammer tip of the
simulated bench, pulses as long as the tip's give or take 15 %. With --recordings, real clean hits are swept too, as
they are and with the same faults added.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.signal import butter, fftconvolve, sosfilt
from scipy.stats import beta

from drivers.simulated import TIPS
from labnnum.hammer import HitSettings, hit_verdicts

FAMILIES = ("half-sine", "haversine", "hertz", "gamma", "triangle")


def pulse(kind: str, u: np.ndarray) -> np.ndarray:
    """Pulse of unit length in u, of unit height."""
    inside = (u > 0) & (u < 1)
    v = np.clip(u, 0, 1)
    shape = {
        "half-sine": np.sin(np.pi * v),
        "haversine": np.sin(np.pi * v) ** 2,
        "hertz": np.sin(np.pi * v) ** 1.5,
        "gamma": (v / 0.3) ** 1.5 * np.exp(1.5 * (1 - v / 0.3)) * np.clip(5 * (1 - v), 0, 1),
        "triangle": np.minimum(v / 0.4, (1 - v) / 0.6),
    }[kind]
    return np.where(inside, shape, 0.0)


def main_force(rng: np.random.Generator, t: np.ndarray, start: float, length: float) -> np.ndarray:
    kind = FAMILIES[rng.integers(len(FAMILIES))]
    force = pulse(kind, (t - start) / length)
    if rng.random() < 0.3:
        force += rng.uniform(0.05, 0.3) * pulse("haversine", (t - start - 0.45 * length) / (0.7 * length))
    return force / force.max()


def structure(rng: np.random.Generator, rate: float, n_out: int) -> tuple[np.ndarray, np.ndarray]:
    count = rng.integers(3, 9)
    frequency = np.sort(rng.uniform(30, 0.35 * rate, count) * rng.uniform(0.1, 1, count)) + 20
    damping = np.exp(rng.uniform(np.log(0.003), np.log(0.05), count))
    poles = 2 * np.pi * frequency * (-damping + 1j)
    return poles, rng.standard_normal((n_out, count)) * frequency


def respond(force: np.ndarray, rate: float, poles: np.ndarray, residues: np.ndarray) -> np.ndarray:
    n = force.size
    s = 2j * np.pi * np.fft.rfftfreq(2 * n, 1 / rate)
    h = -(np.abs(s) ** 2) * sum(
        r[:, None] * (1j / (s - p) - 1j / (s - np.conj(p))) / abs(p) for p, r in zip(poles, residues.T, strict=True)
    )
    return np.fft.irfft(h * np.fft.rfft(force, 2 * n), 2 * n, axis=-1)[..., :n]


def sensor(rng: np.random.Generator, force: np.ndarray, rate: float, length: float) -> np.ndarray:
    """Ringing of the force sensor (up to a tenth of the peak) and of the anti-alias filter."""
    out = force.copy()
    if rng.random() < 0.7:
        low, high = min(2.5 / length, 0.3 * rate), 0.42 * rate
        f = rng.uniform(low, high)
        t = np.arange(force.size) / rate
        decay = 2 * np.pi * f * rng.uniform(0.01, 0.08)
        ring = np.exp(-decay * t) * np.sin(2 * np.pi * f * t)
        tail = fftconvolve(force, ring)[: force.size]
        out += tail / np.abs(tail).max() * rng.uniform(0.0, 0.1)
    if rng.random() < 0.5:
        out = sosfilt(butter(8, 0.8, output="sos"), out)
    return out


def simulate(
    rng: np.random.Generator, fault: str, limit: float = 0.2, lengths: tuple[float, float] = (0.2e-3, 5e-3)
) -> dict:
    """One hit: force and responses, and what is wrong with it; the pulse lasts between `lengths`, in s."""
    rate = float(rng.choice([25600.0, 51200.0]))
    n = int(rng.choice([8192, 16384, 32768]))
    t = np.arange(n) / rate
    length = np.exp(rng.uniform(np.log(lengths[0]), np.log(lengths[1])))
    start = rng.uniform(0.002, 0.02)
    force = main_force(rng, t, start, length)
    if fault == "double":
        share, width = rng.uniform(limit, 1.0), length * rng.uniform(0.85, 1.4)
        room = (n / rate - start - 4 * length) * 0.9
        gap = min(np.exp(rng.uniform(np.log(1.3 * length), np.log(0.2))), room)
        first = rng.random() < 0.15 and start > 1.5 * width + 0.002
        at = start - rng.uniform(1.2, 1.4) * width if first else start + gap
        force = force + share * pulse(FAMILIES[rng.integers(len(FAMILIES))], (t - at) / width)
    force *= np.exp(rng.uniform(np.log(5), np.log(2000)))
    poles, residues = structure(rng, rate, int(rng.integers(1, 4)))
    signals = [sensor(rng, force, rate, length), *respond(force, rate, poles, residues)]
    full_scale = {}
    clipped = -1
    for k, x in enumerate(signals):
        names = ("force", "response 1", "response 2", "response 3")
        peak = np.abs(x).max()
        noise = peak * np.exp(rng.uniform(np.log(2e-5), np.log(0.02)))
        noisy = x + noise * rng.standard_normal(n) + rng.uniform(0, 0.01) * peak * np.sin(2 * np.pi * 50 * t + k)
        top = np.abs(noisy).max() * rng.uniform(1.05, 4)
        signals[k] = noisy
        full_scale[names[k]] = top
    if fault == "clip":
        clipped = int(rng.integers(len(signals)))
        rail = np.abs(signals[clipped]).max() * rng.uniform(0.5, 0.95)
        lost = np.abs(signals[clipped]) >= rail
        signals[clipped] = np.clip(signals[clipped], -rail, rail)
        full_scale[names[clipped]] = rail
        run = max((b - a for a, b in _runs(lost)), default=0)
    else:
        run = 0
    bits = int(rng.choice([0, 12, 16, 24]))
    for k, x in enumerate(signals):
        if bits:
            step = full_scale[names[k]] / 2 ** (bits - 1)
            signals[k] = np.round(x / step) * step
        signals[k] = signals[k] * 1.0
    return {
        "force": signals[0], "responses": np.array(signals[1:]), "rate": rate, "length": length, "run": run,
        "full_scale": full_scale, "clipped": clipped, "bits": bits,
    }  # fmt: skip


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def judge(hit: dict, known_range: bool) -> dict[str, bool]:
    rules = HitSettings(full_scale=hit["full_scale"] if known_range else {})
    verdicts = hit_verdicts(hit["force"], hit["responses"], hit["rate"], rules)
    return {name: not all(v.ok for v in verdicts if v.name == name) for name in ("double hit", "overload", "pulse")}


def judge_pyfrf(hit: dict) -> dict[str, bool]:
    from pyFRF import FRF

    n = hit["force"].size
    frf = FRF(round(hit["rate"]), fft_len=n)
    return {
        "double hit": bool(np.any(frf._is_double_impact(hit["force"]))),
        "overload": bool(frf._is_overflow(hit["force"]) or np.any(frf._is_overflow(hit["responses"][None]))),
        "pulse": False,
    }


def interval(wrong: int, total: int) -> tuple[float, float]:
    """95 % Clopper-Pearson limits of a rate."""
    low = beta.ppf(0.025, wrong, total - wrong + 1) if wrong else 0.0
    high = beta.ppf(0.975, wrong + 1, total - wrong) if wrong < total else 1.0
    return float(low), float(high)


def rate_of(wrong: int, total: int) -> dict:
    low, high = interval(wrong, total)
    return {"wrong": wrong, "of": total, "rate": wrong / total if total else float("nan"), "limits": [low, high]}


def sweep(hits: int, seed: int, lengths: tuple[float, float] = (0.2e-3, 5e-3)) -> dict:
    rng = np.random.default_rng(seed)
    counts: dict[str, list[int]] = {}

    def note(key: str, wrong: bool) -> None:
        entry = counts.setdefault(key, [0, 0])
        entry[0] += wrong
        entry[1] += 1

    for _ in range(hits):
        hit = simulate(rng, "none", lengths=lengths)
        for judged, who in ((judge(hit, False), "labnnum"), (judge_pyfrf(hit), "pyFRF")):
            note(f"{who}: false alarm, double hit", judged["double hit"])
            note(f"{who}: false alarm, overload", judged["overload"])
            note(f"{who}: false alarm, any", any(judged.values()))
        hit = simulate(rng, "double", lengths=lengths)
        note("labnnum: missed double hit", not judge(hit, False)["double hit"])
        note("pyFRF: missed double hit", not judge_pyfrf(hit)["double hit"])
        hit = simulate(rng, "clip", lengths=lengths)
        note("labnnum: missed clipping, range known", not judge(hit, True)["overload"])
        if hit["run"] >= 3:
            note("labnnum: missed clipping of 3 samples or more, range unknown", not judge(hit, False)["overload"])
            note("pyFRF: missed clipping of 3 samples or more", not judge_pyfrf(hit)["overload"])
        else:
            note("labnnum: missed clipping of 1 or 2 samples, range unknown", not judge(hit, False)["overload"])
    return {key: rate_of(*pair) for key, pair in counts.items()}


def real_hits(folder: Path, seed: int, repeats: int) -> dict:
    """Real clean hits as they are, then with second pulses (the hit's own force, delayed) and clipping added."""
    rng = np.random.default_rng(seed)
    wrong = {"clean": 0, "double": 0, "clip": 0}
    totals = 0
    files = sorted((folder / "hammer_hits").glob("measurements_*.npy"))
    for path in files:
        t, force, response = np.load(path)
        rate = 1 / float(t[1] - t[0])
        hit = {"force": force, "responses": response[None], "rate": rate, "full_scale": {}}
        wrong["clean"] += any(judge(hit, False).values())
        for _ in range(repeats):
            shift = int(rng.integers(15, force.size // 2))
            share = rng.uniform(0.2, 1.0)
            second = force + share * np.concatenate([np.zeros(shift), force[:-shift]])
            wrong["double"] += not judge(hit | {"force": second}, False)["double hit"]
            which = "force" if rng.random() < 0.5 else "responses"
            rail = rng.uniform(0.5, 0.9) * np.abs(hit[which]).max()
            run = max(b - a for a, b in _runs(np.abs(np.ravel(hit[which])) >= rail))
            if run >= 3:
                totals += 1
                wrong["clip"] += not judge(hit | {which: np.clip(hit[which], -rail, rail)}, False)["overload"]
    total = len(files) * repeats
    return {
        "real hits: false alarm": rate_of(wrong["clean"], len(files)),
        "real hits with a second pulse: missed": rate_of(wrong["double"], total),
        "real hits clipped at 50 to 90 %, 3 samples or more: missed": rate_of(wrong["clip"], totals),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hits", type=int, default=500, help="hits of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recordings", type=Path, help="folder that holds hammer_hits/")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tips", nargs="*", choices=TIPS, help="so many hits for each hammer tip, or for those named")
    args = parser.parse_args()
    shown = {}
    for title, found in parts(args):
        named = {f"{title}{key}": entry for key, entry in found.items()}
        shown |= named
        for key, entry in ({} if args.json else named).items():
            low, high = entry["limits"]
            told = f"{key:92s} {entry['wrong']:5d} of {entry['of']:5d} = {entry['rate']:7.2%}  [{low:.2%}, {high:.2%}]"
            print(told, flush=True)
    if args.json:
        print(json.dumps(shown, indent=1))


def parts(args: argparse.Namespace) -> Iterator[tuple[str, dict]]:
    """What was asked for, part by part: a title and its rates."""
    if args.tips is None:
        yield "", sweep(args.hits, args.seed)
    else:
        for tip in args.tips or TIPS:
            length = TIPS[tip][0]
            seed = args.seed + list(TIPS).index(tip)
            yield f"{tip}, {1e3 * length:g} ms: ", sweep(args.hits, seed, (0.85 * length, 1.15 * length))
    if args.recordings:
        yield "", real_hits(args.recordings, args.seed, 20)


if __name__ == "__main__":
    main()
