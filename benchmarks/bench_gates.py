"""Hammer gates behind the whole simulated bench: tips, bounces, rails, and converters whose filters ring.

    python benchmarks/bench_gates.py --seconds 60

Unlike hammer_gates.py, whose hits are drawn one by one, these are found by the trigger in a running stream, with the
anti-alias filters, steps and rails of the inputs in between. One input in two is set so that hard blows clip it.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace

import numpy as np
from hammer_gates import judge_pyfrf
from scipy.stats import beta

from drivers.simulated import TIPS, Drive, Input, Operator, SimulatedBench, plant
from drivers.trigger import Trigger
from labnnum.hammer import HitSettings, hit_verdicts
from labnnum.recording import Channel
from labnnum.structures.chain import Chain, Link

FORCE = Channel("force", "force", "reference", "1", "x")
TIP = Channel("tip", node="1", direction="x")
BLOCK = 8192
KINDS = ("false", "double missed", "clipped missed")
COUNTED = ("hits", "clean", "double", "clipped", *KINDS, *(f"pyFRF {kind}" for kind in KINDS))


def interval(k: int, n: int) -> str:
    """k of n with its 95 % interval (Clopper and Pearson 1934)."""
    low = beta.ppf(0.025, k, n - k + 1) if k else 0.0
    high = beta.ppf(0.975, k + 1, n - k) if k < n else 1.0
    return f"{k} of {n} ({low:.2%} - {high:.2%})"


def stream(
    tip: str, rate: float, seconds: float, seed: int, clip: str
) -> tuple[Operator, np.ndarray, dict[str, float]]:
    """A person hitting for so long: who struck what, volts, and the ranges."""
    rng = np.random.default_rng(seed)
    f0, zeta = rng.uniform(60, 0.1 * rate), rng.uniform(0.01, 0.03)
    k = (2 * np.pi * f0) ** 2
    structure = Chain(masses={"1": 1.0}, links=(Link("1", "ground", k, 2 * zeta * np.sqrt(k)),))
    person = Operator(tip, 1.0, 100.0, double=0.4, overload=0.2, seed=seed)
    ranges = {"force": 1000.0, "tip": 2000.0}
    noise = {"force": rng.uniform(0.02, 0.3), "tip": rng.uniform(0.02, 0.3)}
    if clip == "force":
        ranges["force"] = 150.0
    inputs = [Input(c, noise=noise[c.name], bits=24, full_scale=ranges[c.name]) for c in (FORCE, TIP)]
    bench = _read(structure, inputs, person, rate, seconds, seed)
    if clip == "response":
        hard = np.abs(bench[1]).max()
        ranges["tip"] = float(0.45 * hard)
        inputs[1] = replace(inputs[1], full_scale=ranges["tip"])
        bench = _read(structure, inputs, person, rate, seconds, seed)
    return person, bench, ranges


def _read(structure, inputs, person, rate, seconds, seed) -> np.ndarray:
    made = plant(structure, [], inputs, [Drive(FORCE)])
    bench = SimulatedBench(made, inputs, [person], rate, block=BLOCK, oversample=4, seed=seed)
    bench.start()
    return np.hstack([bench.read().data for _ in range(round(seconds * rate / BLOCK))])


def judge(tip: str, rate: float, seconds: float, seed: int, clip: str, count: dict[str, int]) -> None:
    """Count false alarms and misses of one stream."""
    person, data, ranges = stream(tip, rate, seconds, seed, clip)
    rules = HitSettings(full_scale=ranges)
    detector = Trigger(10.0, round(0.01 * rate), round(0.6 * rate)).start()
    for event in detector.feed(data[0]):
        hit = min(person.hits, key=lambda h: abs(h.time - event.at / rate))
        x = data[:, event.start : event.stop]
        railed = any(np.abs(row).max() >= 0.999 * ranges[n] for row, n in zip(x, ("force", "tip"), strict=True))
        bad = {v.name for v in hit_verdicts(x[0], x[1:], rate, rules, ("force", "tip")) if not v.ok}
        peer = judge_pyfrf({"force": x[0], "responses": x[1:], "rate": rate})
        count["hits"] += 1
        if not hit.again and not railed:
            count["clean"] += 1
            count["false"] += bool(bad)
            count["pyFRF false"] += any(peer.values())
        if hit.again:
            count["double"] += 1
            count["double missed"] += "double hit" not in bad
            count["pyFRF double missed"] += not peer["double hit"]
        if railed:
            count["clipped"] += 1
            count["clipped missed"] += "overload" not in bad
            count["pyFRF clipped missed"] += not peer["overload"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="of hitting for each stream")
    parser.add_argument("--streams", type=int, default=3, help="for each tip and rate")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--tips", nargs="*", choices=TIPS, default=[], help="those named only")
    args = parser.parse_args()
    told = {}
    for tip in args.tips or TIPS:
        number = list(TIPS).index(tip)
        count = dict.fromkeys(COUNTED, 0)
        for rate in (25600.0, 51200.0):
            for k in range(args.streams):
                seed = args.seed + 100_000 * number + 1000 * k + int(rate)
                judge(tip, rate, args.seconds, seed, ("none", "force", "response")[k % 3], count)
        told[tip] = count
    if args.json:
        print(json.dumps(told))
        return
    print(f"{'tip':12} {'pulse':>8}  {'by':8} {'false alarms':>28} {'doubles missed':>28} {'clipped missed':>28}")
    told["all"] = {k: sum(c[k] for c in told.values()) for k in COUNTED}
    for tip, c in told.items():
        length = f"{1e3 * TIPS[tip][0]:5.1f} ms" if tip in TIPS else ""
        for who, key in (("labnnum", ""), ("pyFRF", "pyFRF ")):
            kinds = (("false", "clean"), ("double missed", "double"), ("clipped missed", "clipped"))
            row = [interval(c[key + wrong], c[of]) for wrong, of in kinds]
            print(f"{tip:12} {length:>8}  {who:8} " + " ".join(f"{r:>28}" for r in row))


if __name__ == "__main__":
    main()
