"""Fill a real file system while recording and count what is lost: it must be nothing that was acknowledged.

    mkdir small && mount -t tmpfs -o size=3m tmpfs small            # or any small disk that holds nothing else
    python benchmarks/disk_full.py small --times 200 --seed 1

Each time a filler of random size leaves some room, a session is recorded until the store says that the disk is full,
and is then read back while the disk is still full; then the filler goes, and the same session is taken up again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
from pathlib import Path

import numpy as np
from kill import CHANNELS, block

from labnnum.errors import LabnnumError, StoreError
from sessions.store import Session, create_session, open_session

BLOCKS = 100_000


def fill(folder: Path, room: int) -> Path:
    """A file that leaves `room` bytes of the file system."""
    filler = folder / "filler"
    free = shutil.disk_usage(folder).free
    with filler.open("wb") as file:
        file.write(bytes(max(free - room, 0)))
    return filler


def record(session: Session, rng: random.Random, acknowledged: list[list[int]]) -> None:
    """Append to a new run until the store refuses; samples and hits that it acknowledged are kept up to date."""
    run = session.start_run(CHANNELS, 1000.0)
    at = hits = 0
    done = [at, hits]
    acknowledged.append(done)
    for _ in range(BLOCKS):
        at = run.append(block(at, rng.choice([64, 256, 1000])))
        done[:] = [at, hits]
        if rng.random() < 0.3:
            hits = run.add_hit(at - 64, at, True, "reason") + 1
            done[:] = [at, hits]


def lost(path: Path, acknowledged: list[list[int]]) -> int:
    """Runs of which less is there than was acknowledged, or with samples that are not what was written."""
    wrong = 0
    with open_session(path) as session:
        runs = list(session.runs)
        for number, (samples, hits) in enumerate(acknowledged):
            if number >= len(runs) or runs[number].n_samples < samples or len(runs[number].hits) < hits:
                wrong += samples > 0 or hits > 0
                continue
            raw = runs[number].raw()
            wrong += not np.array_equal(raw[0], np.arange(raw.shape[1]))
    return wrong


def once(folder: Path, seed: int) -> dict[str, int | str]:
    """One full disk: what was lost, while full and after there was room again."""
    rng = random.Random(seed)
    path = folder / "s.h5"
    filler = fill(folder, rng.randrange(0, 400_000))
    out: dict[str, int | str] = {"refused": 0, "created": 0, "lost": 0, "unreadable": 0, "finding": "", "blocks": 0}
    acknowledged: list[list[int]] = []
    for turn in range(2):
        try:
            sync = rng.choice([0.0, 0.02, 1.0, None])
            session = open_session(path, "a", sync=sync) if path.exists() else create_session(path, sync=sync)
            out["created"] = 1
            try:
                record(session, rng, acknowledged)
            finally:
                session.close()
        except StoreError as error:
            out["refused"] = int(out["refused"]) + 1
            if "full" not in str(error) and "No space" not in str(error):
                out["finding"] = str(error)
        try:
            if path.exists():
                out["lost"] = int(out["lost"]) + lost(path, acknowledged)
        except (LabnnumError, OSError) as error:
            out["unreadable"] = int(out["unreadable"]) + 1
            out["finding"] = f"turn {turn}: {type(error).__name__}: {error}"
        if turn == 0:
            os.truncate(filler, max(filler.stat().st_size - 300_000, 0))
    out["blocks"] = sum(a[0] for a in acknowledged)
    for left in folder.iterdir():
        left.unlink()
    return out


def main() -> int:
    """Print what was lost; status 1 if anything was."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a small file system that holds nothing")
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if any(args.folder.iterdir()) or shutil.disk_usage(args.folder).total > 64 << 20:
        parser.error(f"{args.folder}: must be an empty file system of 64 MiB at most")
    total = {"times": args.times, "refused": 0, "created": 0, "lost": 0, "unreadable": 0, "blocks": 0}
    findings = []
    for k in range(args.times):
        one = once(args.folder, args.seed * 100_003 + k)
        for key in ("refused", "created", "lost", "unreadable", "blocks"):
            total[key] += int(one[key])
        findings += [f"{k}: {one['finding']}"] if one["finding"] else []
    if args.json:
        print(json.dumps({**total, "findings": findings}))
    else:
        print(
            f"the disk was full {total['refused']} times in {total['times']} recordings: of {total['blocks']} samples"
            f" acknowledged {total['lost']} runs lost any, {total['unreadable']} sessions unreadable"
        )
        print("\n".join(findings))
    return 1 if total["lost"] or total["unreadable"] else 0


if __name__ == "__main__":
    sys.exit(main())
