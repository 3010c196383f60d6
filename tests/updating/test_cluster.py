"""A training set on a dask cluster: the bits of one process, also when a worker is killed midway."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from labnnum.updating.training import make_training_set
from labnnum.updating.updater import training_plan
from sessions.workers import executor

from .cases import LINES, truck

pytest.importorskip("distributed")

CLUSTER = """
import sys
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, *(w.pid for w in cluster.workers.values()), flush=True)
        sys.stdin.read()
"""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Address of a scheduler in a process of its own, and the processes of its two workers."""
    place = tmp_path_factory.mktemp("cluster")
    (place / "cluster.py").write_text(CLUSTER)
    with (place / "log").open("w") as log:
        running = subprocess.Popen(
            [sys.executable, "cluster.py"],
            cwd=place,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
    with running:
        address, *workers = running.stdout.readline().split() or [""]
        assert address, (place / "log").read_text()
        yield address, [int(w) for w in workers]
        running.stdin.close()
        running.wait(30)


@pytest.fixture(scope="module")
def plan():
    structure, outputs, inputs, bands = truck()
    return training_plan(structure, bands, outputs, inputs, LINES, samples=3200, seed=4, noise=0.01)


def test_two_workers_give_the_bits_of_one_process_and_one_of_them_may_die(cluster, plan):
    address, workers = cluster
    assert len(workers) == 2
    alone = make_training_set(plan).features
    with executor(scheduler=address) as pool:
        assert np.array_equal(make_training_set(plan, block=256, executor=pool).features, alone)
    alive = [workers[0]]

    def progress(done, total):
        if alive and 0 < done < total:
            os.kill(alive.pop(), signal.SIGKILL)

    with executor(scheduler=address) as pool:
        found = make_training_set(plan, block=32, executor=pool, progress=progress)
    assert not alive
    assert np.array_equal(found.features, alone)
