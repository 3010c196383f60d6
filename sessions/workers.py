"""Where training FRFs are computed: here, in processes of this machine, or on a dask cluster."""

from __future__ import annotations

import os
from collections.abc import Generator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import get_context

from labnnum.errors import ConfigError


@contextmanager
def executor(workers: int = 1, scheduler: str = "") -> Generator[Executor | None]:
    """What computes blocks: None (this process), a pool of processes, or the cluster of a dask scheduler.

    Raises
    ------
    ConfigError
        If `workers` is less than 1, dask is not installed, or no scheduler answers at the address.
    """
    if scheduler:
        with _cluster(scheduler) as pool:
            yield pool
        return
    if workers < 1:
        raise ConfigError(f"--workers {workers}: give 1 or more")
    if workers == 1:
        yield None
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_one_thread) as pool:
        yield pool


def _one_thread() -> None:
    """Workers share the cores already: their linear algebra takes one thread each."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


@contextmanager
def _cluster(address: str) -> Generator[Executor]:
    try:
        client_of = import_module("distributed").Client  # an extra, typed by nobody who has not installed it
    except ImportError:
        raise ConfigError("--scheduler needs the extra dask: pip install 'labnnum[dask]'") from None
    try:
        client = client_of(address, timeout="10s")
    except (OSError, TimeoutError) as error:
        raise ConfigError(f"--scheduler {address}: no scheduler answers there ({error})") from None
    with client:
        yield client.get_executor(pure=False)
