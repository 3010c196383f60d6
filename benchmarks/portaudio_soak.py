"""Soak through real PortAudio: four channels of a sound server recorded for minutes, every sample accounted for.

    python benchmarks/portaudio_soak.py --minutes 3 --load

A process of its own plays into a null sink; each frame carries its number, in digits to base 4096 that 32-bit floats
hold exactly, and two more channels are made from it. Another null-sink monitor feeds the recorder, which stores and
estimates as in a measurement. Read back, every frame must follow the one before, or a block must own up to the gap.
Needs pulseaudio, libportaudio2 and libasound2-plugins.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from soak import histogram, load, percentiles, soak

from drivers.audio import AudioDigitiser, find_device, portaudio
from drivers.simulated.sound_server import SoundServer
from labnnum.recording import Channel
from sessions.store import open_session

BASE = 4096
NAMES = [
    Channel("low", "voltage", "reference"),
    *(Channel(n, "voltage", "response") for n in ("high", "seven", "back")),
]


def frames(first: int, n: int) -> np.ndarray:
    """Frames first ... first + n - 1 of the counting signal, shape (n, 4)."""
    k = np.arange(first, first + n)
    return np.stack([k % BASE, k // BASE % BASE, 7 * k % BASE, BASE - 1 - k % BASE], axis=1) / BASE


def play(environment: dict[str, str], rate: int, latency: float, pipe) -> None:
    """Count into the sink until told to end; then say how often the output ran dry."""
    os.environ.update(environment)
    state = {"at": 1, "dry": 0}

    def fill(out, n, timing, status):
        state["dry"] += bool(status.output_underflow)
        out[:] = frames(state["at"], n)
        state["at"] += n

    stream = portaudio().OutputStream(
        samplerate=rate,
        device=find_device("pulse", "output"),
        channels=4,
        dtype="float32",
        latency=latency,
        callback=fill,
    )
    with stream:
        pipe.send("playing")
        pipe.recv()
    pipe.send(state)


def verify(path: Path) -> dict[str, int]:
    """Read the session back: frames, silent ones, wrong ones, and gaps that no block owns up to.

    No frame of the count is silent on all channels: silence is what the sound server plays before it begins and where
    the player ran dry.
    """
    with open_session(path) as session:
        run = session.runs[0]
        told = {"frames": run.n_samples, "silent": 0, "wrong": 0, "gaps": 0, "unexplained_gaps": 0}
        told["lost"] = int(run.blocks["lost"].sum())
        expected, broken_before = None, False
        for row in run.blocks:
            at, n = int(row["at"]), int(row["frames"])
            data = np.round(run.raw(at, at + n) * BASE).astype(np.int64)
            number = data[0] + BASE * data[1]
            heard = data.any(axis=0)
            told["silent"] += int(np.count_nonzero(~heard))
            if not heard.any():
                broken_before |= bool(row["overflow"]) or bool(row["lost"])
                continue
            number, data = number[heard], data[:, heard]
            steps = np.flatnonzero(np.diff(number) != 1)
            told["wrong"] += int(np.count_nonzero(data != np.round(frames_of(number) * BASE)))
            told["unexplained_gaps"] += steps.size
            told["gaps"] += steps.size
            if expected is not None and number[0] != expected:
                told["gaps"] += 1
                owned = number[0] - expected == int(row["lost"]) or bool(row["overflow"]) or broken_before
                told["unexplained_gaps"] += not owned
            expected, broken_before = int(number[-1]) + 1, bool(row["overflow"])
        return told


def frames_of(number: np.ndarray) -> np.ndarray:
    """What the four channels of these frames must hold, shape (4, n)."""
    return np.stack([number % BASE, number // BASE % BASE, 7 * number % BASE, BASE - 1 - number % BASE]) / BASE


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--rate", type=int, default=48000)
    parser.add_argument("--latency", type=float, default=0.2, help="s that PortAudio may gather")
    parser.add_argument("--load", action="store_true", help="load the disk meanwhile")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if lacking := SoundServer.missing():
        raise SystemExit(f"portaudio_soak: {lacking}")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    with tempfile.TemporaryDirectory() as name, SoundServer(rate=args.rate) as server:
        path = Path(name) / "soak.h5"
        environment = server.environment("answer", "answer")
        player = context.Process(target=play, args=(environment, args.rate, args.latency, theirs), daemon=True)
        player.start()
        ours.recv()
        os.environ.update(environment)
        noise = load(Path(name)) if args.load else None
        digitiser = AudioDigitiser("pulse", args.rate, [1, 2, 3, 4], block=2048, latency=args.latency)
        try:
            began = time.perf_counter()
            watch, took, account = soak(digitiser, NAMES, path, 60 * args.minutes)
        finally:
            if noise is not None:
                noise.kill()
                noise.wait()
        ours.send("end")
        played = ours.recv()
        player.join()
        checked = verify(path)
    settled = watch.memory[len(watch.memory) // 5 :]
    told = {
        "minutes": args.minutes, "channels": 4, "rate": args.rate, "disk_loaded": args.load,
        "account": account, "read_back": checked, "player_ran_dry": played["dry"],
        "clock_ppm": round(digitiser.clock.drift_ppm, 1), "clock_error_ppm": round(digitiser.clock.error_ppm, 1),
        "notes": digitiser.notes, "live_skipped": watch.skipped,
        "to_disk_ms": percentiles(watch.stored), "to_estimate_ms": percentiles(watch.handled),
        "memory_MiB": {
            "after_a_fifth": round(settled[0], 1), "end": round(settled[-1], 1), "most": round(max(settled), 1),
        },
        "took_s": round(time.perf_counter() - began, 1), "recording_s": round(took, 1),
    }  # fmt: skip
    if args.json:
        print(json.dumps(told))
        return
    for key, value in told.items():
        print(f"{key}: {value}")
    print("from the last frame of a block to the disk:")
    print(histogram(watch.stored))


if __name__ == "__main__":
    main()
