"""A training set on a dask cluster of two local workers beside one process: the same bits, and a worker killed midway.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/cluster.py [--samples 20000]

Needs the extra dask. The structure is the frame of 96 degrees of freedom, whose FRFs cost most. Dask's workers give
freed memory back to the system at once, which makes arrays of megabytes twice as slow; here they keep it.
"""

from __future__ import annotations

import argparse
import os
import signal
import time

import numpy as np

from labnnum.structures.examples import EXAMPLES
from labnnum.updating.training import TrainingPlan, make_training_set
from labnnum.updating.updater import training_plan
from sessions.workers import executor

KEEP = {f"distributed.nanny.pre-spawn-environ.MALLOC_{name}_": 1 << 28 for name in ("TRIM_THRESHOLD", "MMAP_THRESHOLD")}
"""Settings of dask: workers keep up to 256 MiB of freed memory."""


def frame_plan(samples: int) -> TrainingPlan:
    e = EXAMPLES["frame"]()
    lines = np.unique(np.concatenate([np.linspace(b.low, b.high, 130) for b in e.bands]))
    return training_plan(e.structure, e.bands, e.outputs, e.inputs, lines, samples=samples, noise=0.01)


def on_cluster(plan: TrainingPlan, address: str, kill: int | None = None) -> tuple[np.ndarray, float]:
    """Features, and seconds; `kill` is the process that dies after the first block."""
    begin = time.perf_counter()
    left = [kill]

    def progress(done: int, total: int) -> None:
        if left[0] is not None and 0 < done < total:
            os.kill(left[0], signal.SIGKILL)
            left[0] = None

    with executor(scheduler=address) as pool:
        found = make_training_set(plan, executor=pool, block=1024, progress=progress)
    return found.features, time.perf_counter() - begin


def main() -> None:
    import dask
    from distributed import Client, LocalCluster

    dask.config.set(KEEP)
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("--samples", type=int, default=20_000)
    told = reader.parse_args()
    plan = frame_plan(told.samples)
    begin = time.perf_counter()
    alone = make_training_set(plan, block=1024).features
    seconds = time.perf_counter() - begin
    print(f"one process: {seconds:.1f} s")
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        features, both = on_cluster(plan, cluster.scheduler_address)
        print(f"two workers: {both:.1f} s, speed-up {seconds / both:.2f}, same bits: {np.array_equal(alone, features)}")
        victim = next(iter(client.run(os.getpid).values()))
        features, killed = on_cluster(plan, cluster.scheduler_address, victim)
        print(f"a worker killed midway: {killed:.1f} s, same bits: {np.array_equal(alone, features)}")


if __name__ == "__main__":
    main()
