"""The updater beside its peers on the same data, in one run: accuracy, training time, estimate time, failures.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/updater.py [--parts accuracy speed frfs growth] [--json]

accuracy  truck, five parameters, one FRF, 800 clean samples and 1 % noise at estimation: our network, the same refined,
          the dissertation's, RBFInterpolator, a Gaussian process, a multilayer perceptron, penalty function, output
          error and least squares from nominal values. A failure lies beyond eight deviations of the bound.
speed     solving for 800, 3000 and 30,000 samples (800 centres for the last); one estimate; a batch; refined.
frfs      FRFs of a training set: one dense solve for each frequency and set, numpy's batched solve, and ours.
growth    time against samples, degrees of freedom, frequencies and parameters, with fitted exponents.

Times are processor seconds of one thread (pin them, as above), the best of several repeats. The machine's own matrix
product and copy are timed beside, so that a time can be read as a share of what it can do.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable

import numpy as np
from scipy import linalg
from scipy.interpolate import RBFInterpolator

from labnnum.frf import Frf
from labnnum.parameters import Parameter, bounds, truncated_samples
from labnnum.structures.chain import GROUND, Chain, Link
from labnnum.structures.examples import EXAMPLES, force_at, motion_of
from labnnum.updating import fitting
from labnnum.updating.batch import FrfBatch
from labnnum.updating.compiled import compiled
from labnnum.updating.features import BandIntegrals, LogBands
from labnnum.updating.fitting import fit_printed, fit_tuned, principal_components
from labnnum.updating.kernels import kernel_values, squared_distances
from labnnum.updating.many import bound_deviations, refine_many
from labnnum.updating.peers import output_error, penalty
from labnnum.updating.regression import BLOCK, triangle
from labnnum.updating.training import Disturbance, draw

NOISE = 0.01


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


def accuracy(sets: int) -> list[dict]:
    """Errors of every method on the same noisy FRFs, networks trained on the same clean samples."""
    e, lines, batch = truck_case()
    free = e.structure.parameters
    theta = draw(free, 800, "sobol", 0, 0.05)
    truth = truncated_samples(free, np.random.default_rng(1).random((sets, len(free))))
    clean = batch.frf(truth)
    noisy = Disturbance(NOISE).on(clean, 0, 10**7)
    log, plain = LogBands(tuple(e.bands)), BandIntegrals(tuple(e.bands))
    x, xp = rows(log, lines, batch, theta), rows(plain, lines, batch, theta)
    bound = bound_deviations(batch, truth, NOISE)
    shift, scale = theta.mean(axis=0), theta.std(axis=0)
    y = (theta - shift) / scale
    origin, turn = principal_components(x)
    z = (x - origin) @ turn
    out = []

    def add(name: str, train: Callable[[], Callable], seen: Callable, of=clean, number: int = sets) -> None:
        begin = time.process_time()
        model = train()
        trained = time.process_time() - begin
        begin = time.process_time()
        found = {kind: model(seen(value[:number])) for kind, value in (("clean", of), ("noisy", noisy))}
        each = (time.process_time() - begin) / (2 * number)
        row = {"method": name, "train_s": trained, "estimate_us": 1e6 * each, "sets": number}
        for kind, answer in found.items():
            error = np.abs(answer - truth[:number])
            row[f"{kind}_mean"] = float((100 * error / truth[:number]).mean())
            row[f"{kind}_max"] = float((100 * error / truth[:number]).max())
        off = np.abs(found["noisy"] - truth[:number]) > 8 * bound[:number] + 1e-8 * truth[:number]
        row["beyond_8_bounds"] = int(off.any(axis=1).sum())
        out.append(row)

    def inputs(value):
        return log(lines, value)

    def projected(value):
        return (log(lines, value) - origin) @ turn

    add("our network", lambda: fit_tuned(x, theta), inputs)
    add("our network, refined", lambda: _refined(batch, fit_tuned(x, theta), log, lines), lambda v: v)
    add("as printed", lambda: fit_printed(xp, theta, gamma=None), lambda v: plain(lines, v))
    for kernel in ("thin_plate_spline", "cubic"):
        add(f"RBFInterpolator, {kernel}", lambda k=kernel: _unscaled(RBFInterpolator(z, y, kernel=k), shift, scale),
            projected)  # fmt: skip
    add("Gaussian process", lambda: _process(z, y, shift, scale), projected)
    add("multilayer perceptron", lambda: _perceptron(z, y, shift, scale), projected)
    nominal = e.structure.nominal
    add("least squares from nominal", lambda: (lambda v: refine_many(batch, v, np.repeat(nominal[None], len(v), 0),
                                                                     reach=2.0).value), lambda v: v)  # fmt: skip
    few = min(sets, 100)
    for name, method in (("penalty function", penalty), ("output error", output_error)):
        add(name, lambda m=method: _one_by_one(m, e, lines), lambda v: v, number=few)
    mean = 100 * np.sqrt(2 / np.pi) * bound / truth
    out.append({"method": "bound", "noisy_mean": float(mean.mean())})
    return out


def _refined(batch, network, features, lines):
    return lambda value: refine_many(batch, value, network(features(lines, value)), reach=2.0).value


def _unscaled(model, shift, scale):
    return lambda z: shift + scale * model(z)


def _process(z, y, shift, scale):
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    kernel = ConstantKernel(10.0, (1e-3, 1e6)) * RBF(np.full(z.shape[1], 5.0), (0.1, 1e4)) + WhiteKernel(
        1e-6, (1e-12, 1)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _unscaled(GaussianProcessRegressor(kernel).fit(z, y).predict, shift, scale)


def _perceptron(z, y, shift, scale):
    from sklearn.neural_network import MLPRegressor

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = MLPRegressor(hidden_layer_sizes=(64, 64), solver="lbfgs", max_iter=3000, alpha=1e-7, random_state=0).fit(
            z, y
        )
    return _unscaled(made.predict, shift, scale)


def _one_by_one(method, e, lines):
    def run(value):
        frfs = (Frf(lines, h, e.outputs[:1], e.inputs, variance=(NOISE * np.abs(h)) ** 2) for h in value)
        return np.array([method(e.structure, f, bands=e.bands).value for f in frfs])

    return run


def speed() -> list[dict]:
    """Seconds of solving, microseconds of an estimate."""
    e, lines, batch = truck_case()
    features = LogBands(tuple(e.bands))
    theta = draw(e.structure.parameters, 30_000, "sobol", 0, 0.05)
    x = rows(features, lines, batch, theta)
    tuned = fit_tuned(x[:800], theta[:800])
    z, y = tuned.inputs(x), (theta - theta.mean(axis=0)) / theta.std(axis=0)
    rate = _product_rate()
    out: list[dict] = []
    for n in (800, 3000):
        seconds = best(_weights, z[:n], y[:n])
        out.append({"what": f"weights, {n} samples, each a centre", "seconds": seconds,
                    "with_leave_one_out": best(fitting._solve_interpolant, z[:n], y[:n], "gaussian", 1, 1e-10),
                    "share_of_matrix_product": n**3 / 3 / seconds / rate})  # fmt: skip
    for degree in (1, 2):
        width = 800 + fitting.tail_terms(z[:1], degree).shape[1]
        seconds = best(_triangle, z, y, degree, repeats=1)
        whole = best(fitting._solve_least_squares, z, y, z[:800], "gaussian", degree, repeats=1)
        out.append({"what": f"weights, 30000 samples on 800 centres, degree {degree}", "seconds": seconds,
                    "with_ridge_and_leave_one_out": whole,
                    "share_of_matrix_product": 2 * len(z) * width**2 / seconds / rate})  # fmt: skip
    out.append({"what": "scales by leave-one-out, 400 samples", "seconds": best(fitting.tune_scales, z[:400], y[:400],
                                                                              "gaussian", 1, repeats=1)})  # fmt: skip
    return out + _answers(e, lines, batch, features, theta, x, tuned)


def _triangle(z: np.ndarray, y: np.ndarray, degree: int) -> np.ndarray:
    """QR of 30,000 rows in blocks."""
    slices = [slice(start, start + BLOCK) for start in range(0, len(z), BLOCK)]
    rows = (
        np.hstack([fitting.tail_terms(z[s], degree), kernel_values("gaussian", squared_distances(z[s], z[:800])), y[s]])
        for s in slices
    )
    width = 800 + y.shape[1] + fitting.tail_terms(z[:1], degree).shape[1]
    return triangle(rows, np.zeros((width, width)))


def _weights(z: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Kernel matrix, Cholesky and solution."""
    matrix = np.exp(-0.5 * fitting.squared_distances(z, z))
    matrix[np.diag_indices_from(matrix)] += 1e-10
    return linalg.cho_solve(linalg.cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False), y)


def _answers(e, lines, batch, features, theta, x, tuned) -> list[dict]:
    one, quick = x[5], compiled(tuned)
    quick(one)
    value = Disturbance(NOISE).on(batch.frf(theta[:1000]), 0, 0)
    start, single = tuned(features(lines, value)), value[:1]
    return [
        {"what": "one estimate, compiled", "us": 1e6 * best(_repeat, quick, one, 2000) / 2000},
        {"what": "one estimate, numpy", "us": 1e6 * best(_repeat, tuned, one, 500) / 500},
        {"what": "features of one FRF", "us": 1e6 * best(_repeat, lambda v: features(lines, v), single, 300) / 300},
        {"what": "batch of 20000", "per_second": 20_000 / best(tuned, x[:20_000])},
        {"what": "refined, 1000 at once", "us": 1e6 * best(_refine, batch, value, start) / 1000},
        {"what": "refined, one", "us": 1e6 * best(_repeat, lambda s: _refine(batch, single, s), start[:1], 20) / 20},
    ]  # fmt: skip


def _refine(batch, value, start):
    """Steps until one is below 1e-5 of the prior's spread; the next would be below 1e-9."""
    return refine_many(batch, value, start, tolerance=1e-5)


def _repeat(work, given, times):
    for _ in range(times):
        work(given)


def _product_rate(n: int = 1200) -> float:
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
        theta = low + (high - low) * np.random.default_rng(0).random((64, free))
        return lambda: batch.frf(theta)

    sweep("degrees of freedom (64 sets, 200 lines)", (4, 8, 16, 24), lambda n: made(n))
    sweep("lines (64 sets, 8 degrees of freedom)", (200, 400, 800, 1600), lambda n: made(8, 2, np.linspace(0.5, 8, n)))
    sweep("parameters (64 sets, 16 degrees of freedom)", (2, 4, 6, 8), lambda n: made(16, n))

    e, f, batch = truck_case()
    features = LogBands(tuple(e.bands))
    theta = draw(e.structure.parameters, 3200, "sobol", 0, 0.05)
    x = rows(features, f, batch, theta)
    sweep("samples (tuned network, every sample a centre)", (400, 800, 1600, 3200),
          lambda n: lambda: fit_tuned(x[:n], theta[:n]))  # fmt: skip
    return out


PARTS: dict[str, Callable[[], list[dict]]] = {"speed": speed, "frfs": frfs, "growth": growth}


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("--parts", nargs="+", default=["accuracy", *PARTS], choices=["accuracy", *PARTS])
    reader.add_argument("--sets", type=int, default=1000, help="verification sets of the accuracy part")
    reader.add_argument("--json", action="store_true")
    told = reader.parse_args()
    found = {p: accuracy(told.sets) if p == "accuracy" else PARTS[p]() for p in told.parts}
    if told.json:
        print(json.dumps(found))
        return
    for part, table in found.items():
        print(f"\n{part}")
        for row in table:
            print("  " + "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))


if __name__ == "__main__":
    main()
