"""Local rational FRFs beside scipy's Welch H1 on the same records: error near resonances, over the record's length.

    python benchmarks/local.py [--seed 1]

The record is a stretch of the response of four lightly damped modes (two of them close) to noise that began long
before, or to a sweep from rest that still rings at the end; noise of a thousandth of the response is added. scipy's
segments are a fifteenth of the record, as long as thirty averages leave, or a fourth. Errors are the median over the
lines where the exact FRF is above ten times its level between the modes, relative.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import scipy.signal as ss

from labnnum.local import local_frf
from labnnum.recording import Channel, Recording

RATE = 1000.0
OMEGA = 2 * np.pi * np.array([50.0, 53.0, 120.0, 300.0])
ZETA, SHARE = np.array([0.01, 0.008, 0.01, 0.005]), np.array([1.0, -0.7, 0.5, 1.0])
CHANNELS = (Channel("f", "force", "reference"), Channel("a", "acceleration", "response"))


def exact(frequency: np.ndarray) -> np.ndarray:
    """Accelerance of the four modes."""
    s = 2j * np.pi * frequency
    modes = [a * s**2 / (s**2 + 2 * z * w * s + w**2) for a, z, w in zip(SHARE, ZETA, OMEGA, strict=True)]
    return np.sum(modes, axis=0)


def record(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """Force and response, (2, n)."""
    total = 4 * n
    line = np.fft.rfftfreq(total, 1 / RATE)
    if kind == "noise":
        force = np.fft.irfft(np.where(line < 420, np.fft.rfft(rng.standard_normal(total)), 0))
        at = slice(total // 2, total // 2 + n)
    else:
        t = np.arange(n) / RATE
        force = np.zeros(total)
        force[:n] = np.sin(2 * np.pi * (10 * t + 390 * t**2 / 2 / t[-1]))
        at = slice(0, n)
    answer = np.fft.irfft(np.fft.rfft(force) * exact(line))[at]
    return np.vstack([force[at], answer + 1e-3 * answer.std() * rng.standard_normal(n)])


def error(frequency: np.ndarray, value: np.ndarray) -> float:
    """Median relative error near the resonances."""
    truth = exact(frequency)
    near = (frequency > 20) & (frequency < 390) & (np.abs(truth) > 10)
    return float(np.median(np.abs(value[near] - truth[near]) / np.abs(truth[near])))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    rng = np.random.default_rng(parser.parse_args().seed)
    print("kind   samples   decay times   local     Welch 1/15   Welch 1/4    time, of Welch 1/15")
    for kind in ("noise", "sweep"):
        for n in (8192, 16384, 65536):
            data = record(kind, n, rng)
            start = time.process_time()
            frf = local_frf(Recording(CHANNELS, data, RATE))
            own = time.process_time() - start
            cells, peer = [], 0.0
            for share in (15, 4):
                start = time.process_time()
                segment = int(2 ** np.floor(np.log2(n / share)))
                f, cross = ss.csd(data[0], data[1], fs=RATE, nperseg=segment)
                cells.append(error(f, cross / ss.welch(data[0], fs=RATE, nperseg=segment)[1]))
                peer = peer or time.process_time() - start
            decays = n / RATE * ZETA[0] * OMEGA[0]
            print(
                f"{kind:6} {n:7d} {decays:11.0f}     {error(frf.frequency, frf.value[0, 0]):8.2%}"
                f"   {cells[0]:8.2%}   {cells[1]:8.2%}    {own / peer:8.1f}"
            )


if __name__ == "__main__":
    main()
