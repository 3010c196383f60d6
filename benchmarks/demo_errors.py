"""Are the demo's standard deviations honest? Its errors in standard deviations, over many seeds.

    python benchmarks/demo_errors.py --seeds 10

Each seed draws other true parameters, another excitation and other noise. Were the errors normal with the stated
standard deviations, their RMS would be 1 within 1/sqrt(2 n), and one in 370 would exceed 3.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np

from sessions.demo import run_demo


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--seeds", type=int, default=10, help="how many")
    options.add_argument("--first", type=int, default=0, help="the first seed")
    options.add_argument("--json", action="store_true", help="print the result as JSON and nothing else")
    given = options.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as place:
        for seed in range(given.first, given.first + given.seeds):
            done = run_demo(Path(place), seed)
            true = np.array([done.truth[p.name] for p in done.estimate.parameters])
            rows.append((done.estimate.value - true) / done.estimate.std)
            names = [p.name for p in done.estimate.parameters]
            if not given.json:
                shown = "  ".join(f"{n} {z:+.2f}" for n, z in zip(names, rows[-1], strict=True))
                print(f"seed {seed}: {shown}  chi2 {done.estimate.chi2:.2f}", flush=True)
    z = np.array(rows)
    rms = np.sqrt((z**2).mean(axis=0))
    summary = {
        "seeds": given.seeds,
        "rms": dict(zip(names, rms.round(3).tolist(), strict=True)),
        "rms_all": round(float(np.sqrt((z**2).mean())), 3),
        "largest": round(float(np.abs(z).max()), 2),
        "beyond_three": int((np.abs(z) > 3).sum()),
        "of": z.size,
    }
    print(json.dumps(summary) if given.json else f"errors in standard deviations: {summary}")


if __name__ == "__main__":
    main()
