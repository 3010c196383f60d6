"""What benchmarks/updater.py times against size: FRFs of training sets, and growth with every dimension."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from labnnum.parameters import Parameter, bounds
from labnnum.structures.chain import GROUND, Chain, Link
from labnnum.structures.examples import EXAMPLES, force_at, motion_of
from labnnum.updating.batch import FrfBatch
from labnnum.updating.features import LogBands
from labnnum.updating.fitting import fit_tuned
from labnnum.updating.training import Disturbance, draw


def best(work: Callable[..., object], *given: object, repeats: int = 3) -> float:
    """Least processor seconds of the repeats: what other programs do on the machine hardly counts."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        work(*given)
        times.append(time.process_time() - begin)
    return min(times)


def truck_case(outputs: int = 1):
    e = EXAMPLES["truck"]()
    lines = np.unique(np.concatenate([np.linspace(b.low, b.high, 60) for b in e.bands]))
    return e, lines, FrfBatch.of(e.structure, lines, e.outputs[:outputs], e.inputs)


def rows(features, lines, batch, theta, noise=0.0, first=0):
    out = [
        features(lines, Disturbance(noise).on(batch.frf(theta[i : i + 256]), 0, first + i))
        for i in range(0, len(theta), 256)
    ]
    return np.vstack(out)


def product_rate(n: int = 1200) -> float:
    """Floating point operations a second of this machine's matrix product, one thread."""
    a = np.random.default_rng(0).random((n, n))
    return 2 * n**3 / best(np.matmul, a, a)


def frfs() -> list[dict]:
    """Training FRFs of the truck, of Yang's ladder and of the frame: dense solves against ours."""
    sizes = (("truck", 800, 180, 20), ("yang-brown-low", 828, 240, 10), ("frame", 1200, 400, 2))
    return [_compared(*one) for one in sizes]


def _compared(name: str, sets: int, n_lines: int, few: int) -> dict:
    """Dense solves of a few sets, scaled up to all; ours of all."""
    e = EXAMPLES[name]()
    lines = np.linspace(min(b.low for b in e.bands), max(b.high for b in e.bands), n_lines)
    theta = draw(e.structure.parameters, sets, "sobol", 0, 0.05)
    batch = FrfBatch.of(e.structure, lines, e.outputs, e.inputs)
    naive = best(_naive, e, theta[:few], lines, repeats=2) * sets / few
    stacked = best(_stacked, e, theta[:few], lines, repeats=2) * sets / few
    prepared = best(FrfBatch.of, e.structure, lines, e.outputs, e.inputs, repeats=1)
    ours = best(_in_blocks, batch, theta)
    got, exact = batch.frf(theta[:few]), _stacked(e, theta[:few], lines)
    size = np.maximum(np.abs(exact), 1e-3 * np.abs(exact).max(axis=-1, keepdims=True))
    written = 16 * np.prod(batch.shape) * sets / ours
    return {
        "structure": name, "sets": sets, "lines": n_lines, "naive_s": naive, "batched_solve_s": stacked, "ours_s": ours,
        "prepare_s": prepared, "ratio": naive / ours, "ratio_to_batched": stacked / ours,
        "share_of_memory_copy": written / _copy_rate(), "error": float((np.abs(got - exact) / size).max()),
        "engine": type(batch.engine).__name__,
    }  # fmt: skip


def _in_blocks(batch: FrfBatch, theta: np.ndarray) -> None:
    for start in range(0, len(theta), 128):
        batch.frf(theta[start : start + 128])


def _copy_rate(n: int = 1 << 24) -> float:
    """Bytes a second that this machine copies."""
    a = np.ones(n)
    return a.nbytes / best(np.copy, a)


def _dense(e, theta):
    m = e.structure.matrices(theta)
    rows = np.array([c.sign * e.structure.participation(c.dof, theta) for c in e.outputs])
    loads = np.array([c.sign * e.structure.participation(c.dof, theta) for c in e.inputs]).T
    return m, rows, loads


def _naive(e, thetas, lines):
    """One solve for each frequency and set, as it is first written."""
    order = {"displacement": 0, "velocity": 1, "acceleration": 2}
    out = []
    for theta in thetas:
        m, r, b = _dense(e, theta)
        h = [r @ np.linalg.solve(m.K + 1j * w * m.C + 1j * m.D - w**2 * m.M, b) for w in 2 * np.pi * lines]
        power = np.array([order[c.quantity] for c in e.outputs])[:, None, None]
        out.append(np.moveaxis(np.array(h), 0, -1) * (2j * np.pi * lines) ** power)
    return np.array(out)


def _stacked(e, thetas, lines):
    """numpy's batched solve over all frequencies of a set."""
    order = {"displacement": 0, "velocity": 1, "acceleration": 2}
    w = (2 * np.pi * lines)[:, None, None]
    out = []
    for theta in thetas:
        m, r, b = _dense(e, theta)
        h = r @ np.linalg.solve(m.K + 1j * w * m.C + 1j * m.D - w**2 * m.M, b)
        power = np.array([order[c.quantity] for c in e.outputs])[:, None, None]
        out.append(np.moveaxis(h, 0, -1) * (2j * np.pi * lines) ** power)
    return np.array(out)


def chain_of(n: int, free: int = 2) -> Chain:
    """n masses in a row, the first `free` springs free."""
    links = [
        Link(GROUND, "0", "k0"),
        *(Link(str(i), str(i + 1), f"k{i + 1}" if i + 1 < free else 1e4, 1.0) for i in range(n - 1)),
    ]
    parameters = tuple(Parameter(f"k{i}", 1e4, 7e3, 1.3e4) for i in range(free))
    return Chain({str(i): 1.0 for i in range(n)}, tuple(links), parameters)


def growth() -> list[dict]:
    """Seconds against size, with the exponent of a power law fitted to the larger half."""
    out = []

    def sweep(what: str, sizes: tuple[int, ...], work: Callable[[int], Callable[[], object]]) -> None:
        seconds = [best(work(n)) for n in sizes]
        half = len(sizes) // 2
        slope = np.polyfit(np.log(sizes[half:]), np.log(seconds[half:]), 1)[0]
        out.append({"against": what, "sizes": list(sizes), "seconds": seconds, "exponent": float(slope)})

    lines = np.linspace(0.5, 8.0, 200)

    def made(n, free=2, f=lines):
        structure = chain_of(n, free)
        batch = FrfBatch.of(structure, f, (motion_of(str(n - 1)),), (force_at("0"),))
        low, high = bounds(structure.parameters)
        theta = low + (high - low) * np.random.default_rng(0).random((512, free))
        return lambda: batch.frf(theta)

    sweep("degrees of freedom (512 sets, 200 lines)", (4, 8, 16, 24), lambda n: made(n))
    sweep("lines (512 sets, 8 degrees of freedom)", (200, 400, 800, 1600), lambda n: made(8, 2, np.linspace(0.5, 8, n)))
    sweep("parameters (512 sets, 16 degrees of freedom)", (2, 4, 6, 8), lambda n: made(16, n))

    e, f, batch = truck_case()
    features = LogBands(tuple(e.bands))
    theta = draw(e.structure.parameters, 3200, "sobol", 0, 0.05)
    x = rows(features, f, batch, theta)
    sweep("samples (tuned network, every sample a centre)", (400, 800, 1600, 3200),
          lambda n: lambda: fit_tuned(x[:n], theta[:n]))  # fmt: skip
    return out


def draw_growth(found: list[dict], folder: Path) -> None:
    """Time against size on logarithmic axes, with the fitted power law."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    for axis, one in zip(figure.subplots(2, 2).ravel(), found, strict=True):
        size, seconds = np.array(one["sizes"], float), np.array(one["seconds"])
        half = len(size) // 2
        level = np.exp(np.mean(np.log(seconds[half:]) - one["exponent"] * np.log(size[half:])))
        axis.loglog(size, seconds, "o", color="black")
        axis.loglog(size, level * size ** one["exponent"], label=f"exponent {one['exponent']:.2f}")
        axis.set(xlabel=one["against"], ylabel="seconds")
        axis.legend()
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "growth.svg")
