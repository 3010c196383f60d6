"""Soak: a device in real time, the disk loaded, H1 and snapshots going along, every sample accounted for by a counter.

    python benchmarks/soak.py --minutes 10 --channels 16 --rate 48000 --load

One channel carries the number of each frame. After the run the session is read back: each frame that the device
delivered must be there once, in its place; frames that were lost must be those that the blocks say.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from drivers.block import Block
from drivers.digitiser import Digitiser
from drivers.simulated import Drive, Input, Player, SimulatedBench, Source, plant
from labnnum.estimators import Welch, h1
from labnnum.recording import Channel
from labnnum.structures.chain import Chain, Link
from sessions.recorder import Recorder
from sessions.snapshot import curves, scope_view
from sessions.store import create_session, open_session

BLOCK = 2048


class Counter(Source):
    """Plays the number of each frame."""

    def render(self, first, frames, oversample, rate):
        return first + np.arange(frames * oversample) / oversample


def device(channels: int, rate: float, real_time: bool, buffer: float = 10.0) -> tuple[SimulatedBench, list[Channel]]:
    """A chain with an accelerometer on every mass, a force, and the counter as a monitor."""
    n = channels - 2
    links = [Link("0", "ground", 1e7, 50.0)] + [Link(str(i), str(i + 1), 1e7, 50.0) for i in range(n - 1)]
    chain = Chain(masses={str(i): 0.5 for i in range(n)}, links=tuple(links))
    force = Channel("force", "force", "reference", "0", "x", sensitivity=1.0)
    names = [Channel("counter", "voltage", "monitor"), force]
    names += [Channel(f"a{i}", node=str(i), direction="x", sensitivity=1.0) for i in range(n)]
    inputs = [Input(c, bits=0, full_scale=1e12, noise=0.0 if c.role == "monitor" else 0.01) for c in names]
    drives = [Drive(Channel("none", "force", "reference", "0", "x"), gain=0.0), Drive(force)]
    player = Player()
    player.play(np.random.default_rng(0).standard_normal(2**18), repeat=True)
    bench = SimulatedBench(
        plant(chain, [], inputs, drives), inputs, [Counter(), player], rate,
        block=BLOCK, oversample=1, real_time=real_time, buffer=buffer,
    )  # fmt: skip
    return bench, names


class Ready(Digitiser):
    """Delivers prepared blocks as fast as they are taken."""

    def __init__(self, blocks: list[Block], rate: float, total: int) -> None:
        self._blocks, self._rate, self._total = blocks, rate, total

    @property
    def n_channels(self):
        return self._blocks[0].data.shape[0]

    @property
    def rate(self):
        return self._rate

    def open(self): ...

    def start(self):
        self._n = 0

    def stop(self): ...

    def read(self, timeout=5.0):
        if self._n == self._total:
            return None
        block = self._blocks[self._n % len(self._blocks)]
        self._n += 1
        return Block(block.data, (self._n - 1) * BLOCK, time.time())


@dataclass
class Watch:
    """What is noted during the run."""

    stored: list[float] = field(default_factory=list)
    handled: list[float] = field(default_factory=list)
    memory: list[float] = field(default_factory=list)
    skipped: int = 0
    snapshots: int = 0
    late: float = 0.0


class TimedSink:
    """A run that notes when each block is safe."""

    def __init__(self, run, watch: Watch, rate: float) -> None:
        self._run, self._watch, self._rate = run, watch, rate

    def append(self, block):
        at = self._run.append(block)
        self._watch.stored.append(time.time() - block.time - block.n_frames / self._rate)
        return at


def resident() -> float:
    """Resident memory, MiB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def soak(digitiser: Digitiser, names: list[Channel], path: Path, seconds: float) -> tuple[Watch, float, dict]:
    """Record, estimate and draw for so long; what was noted, s it took, and the session's account."""
    watch, frames = Watch(), round(seconds * digitiser.rate)
    with create_session(path) as session:
        run = session.start_run(names, digitiser.rate, label="soak")
        live = Welch(4096).start(tuple(names), digitiser.rate)
        began, due, sampled = time.perf_counter(), 0.0, 0.0
        with digitiser, Recorder(digitiser, TimedSink(run, watch, digitiser.rate)) as recorder:
            for one in recorder:
                if one.broken:
                    live.gap()
                live.add(one.block.data)
                watch.skipped += one.skipped
                watch.handled.append(time.time() - one.block.time - one.block.n_frames / digitiser.rate)
                now = time.perf_counter()
                if now >= due:
                    due = now + 0.1
                    watch.snapshots += 1
                    scope_view(tuple(names), digitiser.rate, one.block.data)
                    if live.n_segments:
                        curves(h1(live.spectra()))
                if now >= sampled:
                    sampled = now + 1.0
                    watch.memory.append(resident())
                if one.at + one.block.n_frames >= frames:
                    break
            account = {"stored": recorder.stored, "lost": recorder.lost, "overflows": recorder.overflows}
        took = time.perf_counter() - began
        watch.late = max(took - account["stored"] / digitiser.rate, 0.0)
        run.finish()
    return watch, took, account


def verify(path: Path) -> dict[str, int]:
    """Read the session back: frames stored, frames whose counter is wrong, frames missing that no block owns up to."""
    wrong = unexplained = 0
    with open_session(path) as session:
        run = session.runs[0]
        blocks, expected = run.blocks, 0
        for row in blocks:
            at, n, start = int(row["at"]), int(row["frames"]), int(row["start"])
            counter = run.raw(at, at + n)[0]
            wrong += int(np.count_nonzero(counter != start + np.arange(n)))
            unexplained += abs(start - expected - int(row["lost"]))
            expected = start + n
        return {"frames": run.n_samples, "wrong": wrong, "unexplained": unexplained, "lost": int(blocks["lost"].sum())}


def percentiles(values: list[float]) -> dict[str, float]:
    """Milliseconds."""
    a = 1e3 * np.array(values)
    return {f"p{q:g}": round(float(np.percentile(a, q)), 2) for q in (50, 95, 99, 99.9, 100)}


def histogram(values: list[float]) -> str:
    """Latencies in powers of two of a millisecond."""
    a = 1e3 * np.array(values)
    edges = [0, 1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, np.inf]
    counts, _ = np.histogram(np.clip(a, 0, None), edges)
    rows = zip(edges[:-1], edges[1:], counts, strict=True)
    return "\n".join(f"  {a:6g} - {b:6g} ms {n:8d} {'#' * round(60 * n / counts.max())}" for a, b, n in rows if n)


def load(folder: Path) -> subprocess.Popen:
    """A process that writes and forces the disk without end."""
    code = (
        "import os, sys\n"
        "part = os.urandom(2**20)\n"
        "while True:\n"
        "    with open(sys.argv[1], 'wb') as f:\n"
        "        for _ in range(64):\n"
        "            f.write(part); f.flush(); os.fsync(f.fileno())\n"
    )
    return subprocess.Popen([sys.executable, "-c", code, str(folder / "load.bin")])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=1.0)
    parser.add_argument("--channels", type=int, default=16)
    parser.add_argument("--rate", type=float, default=48000.0)
    parser.add_argument("--buffer", type=float, default=10.0, help="s that the device holds: rig.toml's default")
    parser.add_argument("--load", action="store_true", help="load the disk meanwhile")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench, names = device(args.channels, args.rate, real_time=True, buffer=args.buffer)
        noise = load(folder) if args.load else None
        try:
            watch, _, account = soak(bench, names, folder / "soak.h5", 60 * args.minutes)
        finally:
            if noise is not None:
                noise.kill()
                noise.wait()
        checked = verify(folder / "soak.h5")
        (folder / "soak.h5").unlink()
        factor = real_time_factor(args.channels, args.rate, folder)
    settled = watch.memory[len(watch.memory) // 5 :]
    told = {
        "minutes": args.minutes, "channels": args.channels, "rate": args.rate, "disk_loaded": args.load,
        "account": account, "read_back": checked, "snapshots": watch.snapshots, "live_skipped": watch.skipped,
        "to_disk_ms": percentiles(watch.stored), "to_estimate_ms": percentiles(watch.handled),
        "memory_MiB": {
            "after_a_fifth": round(settled[0], 1), "end": round(settled[-1], 1), "most": round(max(settled), 1),
        },
        "device_late_s": round(watch.late, 3),
        "real_time_factor": factor,
    }  # fmt: skip
    if args.json:
        print(json.dumps(told))
        return
    for key, value in told.items():
        print(f"{key}: {value}")
    print("from the last frame of a block to the disk:")
    print(histogram(watch.stored))


def real_time_factor(channels: int, rate: float, folder: Path, seconds: float = 60.0) -> dict[str, float]:
    """How many times faster than real time blocks are stored, and stored and estimated from."""
    bench, names = device(channels, rate, real_time=False)
    bench.start()
    blocks = [bench.read() for _ in range(16)]
    out = {}
    for key, estimate in (("stored", False), ("stored_and_H1", True)):
        total = round(seconds * rate / BLOCK)
        ready = Ready(blocks, rate, total)
        path = folder / f"{key}.h5"
        with create_session(path) as session:
            run = session.start_run(names, rate)
            live = Welch(4096).start(tuple(names), rate)
            began = time.perf_counter()
            with Recorder(ready, run) as recorder:
                for one in recorder:
                    if estimate:
                        live.add(one.block.data)
            if estimate:
                h1(live.spectra())
            out[key] = round(total * BLOCK / rate / (time.perf_counter() - began), 2)
        path.unlink()
    return out


if __name__ == "__main__":
    main()
