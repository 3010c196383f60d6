"""H1 and coherence of many responses, timed beside scipy and pyFRF in the same run, and compared with them.

    python benchmarks/estimation.py --seconds 60 --responses 8 --repeats 3 [--json]

Every contender estimates H1 and coherence of all responses to one force, Hann window, half overlap, from the same
samples in memory (pyFRF takes no mean out of the segments, the others do). Times are processor seconds of one
thread (set OMP_NUM_THREADS=1), the best of the repeats, taken in turns so that other load strikes all alike; they
are given over that of one scipy.signal.csd per channel.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable

import numpy as np
import scipy.signal as ss

from labnnum.estimators import H1
from labnnum.recording import Channel, Recording
from labnnum.spectra import Welch

Estimate = tuple[np.ndarray, np.ndarray]


def make(seconds: float, rate: float, responses: int, seed: int) -> np.ndarray:
    """Force and responses of two modes each, with noise."""
    rng = np.random.default_rng(seed)
    force = rng.standard_normal(int(seconds * rate))
    rows = [force]
    for k in range(responses):
        radius, angle = 0.97, 0.1 + 0.15 * k
        y = ss.lfilter([1.0], [1, -2 * radius * np.cos(angle), radius**2], force)
        rows.append(y + 0.1 * y.std() * rng.standard_normal(force.size))
    return np.array(rows)


def loop_csd(data: np.ndarray, rate: float, n: int) -> Estimate:
    """What a scipy user writes first: csd and coherence channel by channel."""
    options = {"fs": rate, "window": "hann", "nperseg": n}
    power = ss.welch(data[0], **options)[1]
    h = [ss.csd(data[0], row, **options)[1] / power for row in data[1:]]
    gamma = [ss.coherence(data[0], row, **options)[1] for row in data[1:]]
    return np.array(h), np.array(gamma)


def loop_csd_only(data: np.ndarray, rate: float, n: int) -> Estimate:
    """One csd for each response and nothing else: the unit of the times."""
    h = [ss.csd(data[0], row, fs=rate, window="hann", nperseg=n)[1] for row in data[1:]]
    return np.array(h), np.empty(0)


def vector_csd(data: np.ndarray, rate: float, n: int) -> Estimate:
    """scipy, vectorised over the responses."""
    options = {"fs": rate, "window": "hann", "nperseg": n}
    power = ss.welch(data, **options)[1]
    cross = ss.csd(data[:1], data[1:], **options)[1]
    return cross / power[0], np.abs(cross) ** 2 / (power[0] * power[1:])


def batched(data: np.ndarray, rate: float, n: int) -> Estimate:
    """All segments in one transform, by numpy alone: the fastest way that needs no thought for memory."""
    view = np.lib.stride_tricks.sliding_window_view(data, n, axis=-1)[:, :: n // 2]
    x = np.fft.rfft((view - view.mean(axis=-1, keepdims=True)) * ss.get_window("hann", n), axis=-1)
    cross = np.einsum("sf,csf->cf", x[0].conj(), x)
    power = np.einsum("csf,csf->cf", x.conj(), x).real
    return cross[1:] / power[0], np.abs(cross[1:]) ** 2 / (power[0] * power[1:])


def pyfrf(data: np.ndarray, rate: float, n: int) -> Estimate:
    from pyFRF import FRF

    frf = FRF(
        int(rate), exc=data[0][None, None], resp=data[1:][None], exc_type="f", resp_type="d",
        frf_estimator="H1", window="hann", nperseg=n, noverlap=n // 2, fft_len=n, copy=False,
    )  # fmt: skip
    return frf.get_FRF(frf_form="receptance")[:, 0], frf.get_coherence()


def recorded(data: np.ndarray, rate: float) -> Recording:
    channels = (Channel("f", "force", "reference"), *(Channel(f"x{k}", "displacement") for k in range(len(data) - 1)))
    return Recording(channels, data, rate)


def labnnum(recording: Recording, rate: float, n: int) -> Estimate:
    frf = H1(Welch(n))(recording)
    assert frf.coherence is not None
    return frf.value[:, 0], frf.coherence


CONTENDERS: dict[str, Callable[..., Estimate]] = {
    "scipy csd, one per channel (no coherence)": loop_csd_only,
    "scipy csd and coherence, one per channel": loop_csd,
    "scipy csd, vectorised": vector_csd,
    "one batched numpy FFT": batched,
    "pyFRF": pyfrf,
    "labnnum": labnnum,
}


def compare(data: np.ndarray, rate: float, n: int) -> dict[str, float]:
    """Largest difference of H1 from scipy's, over the largest H1."""
    reference, gamma = vector_csd(data, rate, n)
    out = {}
    for name, contender in CONTENDERS.items():
        if contender is loop_csd_only:
            continue
        h, coherence = contender(recorded(data, rate) if contender is labnnum else data, rate, n)
        lines = min(h.shape[-1], reference.shape[-1])
        gap = np.abs(h[:, 1:lines] - reference[:, 1:lines]).max() / np.abs(reference).max()
        out[name] = float(gap)
        out[name + ", coherence"] = float(np.abs(coherence[:, 1:lines] - gamma[:, 1:lines]).max())
    return out


def race(data: np.ndarray, rate: float, n: int, repeats: int) -> dict[str, float]:
    best = dict.fromkeys(CONTENDERS, np.inf)
    recording = recorded(data, rate)
    for _ in range(repeats):
        for name, contender in CONTENDERS.items():
            source = recording if contender is labnnum else data
            start = time.process_time()
            contender(source, rate, n)
            best[name] = min(best[name], time.process_time() - start)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=51200.0)
    parser.add_argument("--responses", type=int, default=8)
    parser.add_argument("--segments", type=int, nargs="+", default=[2048, 4096, 16384, 51200])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    data = make(args.seconds, args.rate, args.responses, args.seed)
    result = {"difference from scipy": compare(data[:, : 40 * 2048], args.rate, 2048), "times": {}}
    for n in args.segments:
        best = race(data, args.rate, n, args.repeats)
        unit = best["scipy csd, one per channel (no coherence)"]
        result["times"][n] = {k: {"seconds": v, "ratio": v / unit} for k, v in best.items()}
    if args.json:
        print(json.dumps(result, indent=1))
        return
    for name, value in result["difference from scipy"].items():
        print(f"difference from scipy  {name:52s} {value}")
    for n, times in result["times"].items():
        for name, entry in times.items():
            print(f"n_segment {n:6d}  {name:44s} {entry['seconds']:7.3f} s  {entry['ratio']:5.2f}")


if __name__ == "__main__":
    main()
