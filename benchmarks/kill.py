"""Kill a recording process at random moments and count what is lost: it must be nothing that was acknowledged.

    python benchmarks/kill.py --kills 200 --seed 1

Each child creates a session, appends blocks of a counter signal, adds hits, finishes, closes, reopens and goes on;
it reports every acknowledgement through a pipe. Half of the children do nearly nothing but create and close.
Needs fork (Linux, macOS).
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import struct
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from drivers.block import Block
from labnnum.errors import LabnnumError
from labnnum.recording import Channel
from sessions.store import create_session, open_session

CHANNELS = [Channel("f", "force", "reference", sensitivity=0.01), Channel("a", sensitivity=0.1)]
ACK = struct.Struct("<iiii")  # session number, run, samples, hits


def block(start: int, n: int) -> Block:
    """A block whose samples count: what is read back tells where it belongs."""
    count = np.arange(start, start + n, dtype=float)
    return Block(np.array([count, -count]), start, 0.0)


def record(folder: Path, pipe: int, seed: int) -> None:
    """Create, fill, close and reopen sessions until killed."""
    rng = random.Random(seed)
    brief = rng.random() < 0.5
    sync = rng.choice([0.0, 0.02, 1.0, None])
    for number in range(10**6):
        path = folder / f"s{number}.h5"
        session = create_session(path, "rig", "model", sync=sync)
        os.write(pipe, ACK.pack(number, 0, 0, 0))
        for index in range(1, 3):
            run = session.start_run(CHANNELS, 1000.0)
            os.write(pipe, ACK.pack(number, index, 0, 0))
            at = hits = 0
            for _ in range(2 if brief else rng.randrange(5, 60)):
                n = rng.choice([64, 256, 1000])
                at = run.append(block(at, n))
                os.write(pipe, ACK.pack(number, index, at, hits))
                if rng.random() < 0.3:
                    hits = run.add_hit(at - 64, at, rng.random() < 0.5, "reason") + 1
                    os.write(pipe, ACK.pack(number, index, at, hits))
            run.finish()
            session.close()
            session = open_session(path, "a", sync=sync)
        session.close()


def one_kill(folder: Path, seed: int) -> dict:
    """Fork, kill a random time after a random number of acknowledgements, and compare with what was acknowledged.

    Counting them, and not only the clock, lets the kills fall everywhere however busy the computer is; one in four
    falls at any moment of the first quarter of a second.
    """
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read)
        try:
            record(folder, write, seed)
        finally:
            os._exit(1)
    os.close(write)
    rng = random.Random(seed + 1)
    first = rng.random() < 0.25
    wanted, wait = (0, rng.uniform(0.0, 0.25)) if first else (rng.randrange(1, 120), rng.uniform(0.0, 0.02))
    data = b""
    with os.fdopen(read, "rb", buffering=0) as pipe:
        while len(data) < wanted * ACK.size and (more := pipe.read(ACK.size)):
            data += more
        time.sleep(wait)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        data += pipe.readall()
    acks = [ACK.unpack_from(data, i) for i in range(0, len(data) - len(data) % ACK.size, ACK.size)]
    return check(folder, acks)


def check(folder: Path, acks: list[tuple[int, int, int, int]]) -> dict:
    """Lost samples, sessions that fail to open, and whether plain h5py opens the last as it lies."""
    out = {"acks": len(acks), "lost": 0, "unreadable": 0, "foreign_unreadable": 0, "finding": ""}
    last = max((a[0] for a in acks), default=-1)
    paths = {int(p.stem[1:]): p for p in folder.glob("s*.h5")}
    out["lost"] += sum(1 for a in {a[0] for a in acks} if a not in paths)
    for number, path in paths.items():
        try:
            if number >= last:
                h5py.File(path, "r").close()
        except OSError:
            out["foreign_unreadable"] += 1
        expected = {(r, s, h) for n, r, s, h in acks if n == number and r}
        try:
            out["lost"] += _lost(path, expected)
        except (LabnnumError, OSError, KeyError) as error:
            out["unreadable"] += 1
            out["finding"] = f"{path.name}: {type(error).__name__}: {error}"
    return out


def _lost(path: Path, expected: set[tuple[int, int, int]]) -> int:
    lost = 0
    with open_session(path) as session:
        runs = {run.index: run for run in session.runs}
        for index, samples, hits in expected:
            run = runs.get(index)
            if run is None or run.n_samples < samples or len(run.hits) < hits:
                lost += 1
        for run in runs.values():
            raw = run.raw()
            if not np.array_equal(raw[0], np.arange(raw.shape[1])) or int(run.blocks["frames"].sum()) != raw.shape[1]:
                lost += 1
    return lost


def main() -> int:
    """Print what was lost; status 1 if anything was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    total = {"kills": args.kills, "acks": 0, "lost": 0, "unreadable": 0, "foreign_unreadable": 0}
    findings = []
    for k in range(args.kills):
        with tempfile.TemporaryDirectory() as folder:
            one = one_kill(Path(folder), args.seed * 100_003 + k)
        for key in ("acks", "lost", "unreadable", "foreign_unreadable"):
            total[key] += one[key]
        findings += [one["finding"]] if one["finding"] else []
    if args.json:
        print(json.dumps({**total, "findings": findings}))
    else:
        print(
            f"{total['kills']} kills, {total['acks']} acknowledgements: {total['lost']} lost,"
            f" {total['unreadable']} sessions unreadable; {total['foreign_unreadable']} not opened by plain h5py"
            " before recovery"
        )
        print("\n".join(findings))
    return 1 if total["lost"] or total["unreadable"] else 0


if __name__ == "__main__":
    sys.exit(main())
