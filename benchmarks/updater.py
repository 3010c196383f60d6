"""The updater beside its peers on the same data, in one run: accuracy, training time, estimate time, failures.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/updater.py [--parts accuracy speed frfs growth]
        [--json] [--plots FOLDER]

accuracy  truck, five parameters, one FRF, 800 clean samples and 1 % noise at estimation: our network, the same refined,
          the dissertation's, RBFInterpolator, a Gaussian process, a multilayer perceptron, penalty function, output
          error and least squares from nominal values. A failure lies beyond eight deviations of the bound.
speed     solving for 800, 3000 and 30,000 samples (800 centres for the last); one estimate; a batch, by one thread and
          by two, without and with the second stage; refined, one alone (compiled) and a thousand together.
frfs      FRFs of a training set: one dense solve for each frequency and set, numpy's batched solve, and ours.
growth    time against samples, degrees of freedom, frequencies and parameters, with fitted exponents; --plots FOLDER
          draws them (growth.svg).

Times are processor seconds of one thread (pin them, as above), the best of several repeats; of two threads, seconds on
the clock. The machine's own matrix
product and copy are timed beside, so that a time can be read as a share of what it can do.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy import linalg
from scipy.interpolate import RBFInterpolator
from updater_sizes import best, draw_growth, frfs, growth, product_rate, rows, truck_case

from labnnum.frf import Frf
from labnnum.parameters import truncated_samples
from labnnum.updating import fitting
from labnnum.updating.compiled import compiled
from labnnum.updating.compiled_refine import compiled_refinement
from labnnum.updating.features import BandIntegrals, LogBands
from labnnum.updating.fitting import fit_printed, fit_tuned, principal_components
from labnnum.updating.kernels import kernel_values, squared_distances
from labnnum.updating.many import bound_deviations, refine_many
from labnnum.updating.network import RbfNetwork
from labnnum.updating.peers import output_error, penalty
from labnnum.updating.regression import BLOCK, triangle
from labnnum.updating.scores import ScoreBands, references
from labnnum.updating.training import Disturbance, draw

NOISE = 0.01


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
    rate = product_rate()
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
    alone = compiled_refinement(batch)
    alone(value[0], start[0])
    return [
        {"what": "one estimate, compiled", "us": 1e6 * best(_repeat, quick, one, 2000) / 2000},
        {"what": "one estimate, numpy", "us": 1e6 * best(_repeat, tuned, one, 500) / 500},
        {"what": "features of one FRF", "us": 1e6 * best(_repeat, lambda v: features(lines, v), single, 300) / 300},
        _rates("batch of 20000", tuned, x[:20_000]),
        *_second_stage(e, lines, batch, theta),
        {"what": "refined, 1000 at once", "us": 1e6 * best(_refine, batch, value, start) / 1000},
        {"what": "refined, one, compiled", "us": 1e6 * best(_each, alone, value, start) / 1000},
        {"what": "refined, one, vectorised",
         "us": 1e6 * best(_repeat, lambda s: _refine(batch, single, s), start[:1], 20) / 20},
    ]  # fmt: skip


def _second_stage(e, lines, batch, theta) -> list[dict]:
    """A network trained with noise on all samples and 800 centres: training as a whole, and its answers."""
    free = e.structure.parameters
    spread = np.array([p.spread for p in free])
    value, slope = batch.sensitivity(references(free))
    features = ScoreBands.at_references(tuple(e.bands), lines, value, slope, spread).spanned()
    x = rows(features, lines, batch, theta, NOISE)
    begin = time.process_time()
    network = fit_tuned(x, theta, centres=800, most=features.components)
    trained = time.process_time() - begin
    quick = compiled(network)
    quick(x[5])
    return [
        {"what": "network with noise, 30000 samples, whole training", "seconds": trained,
         "inputs": network.centres.shape[1], "second_stage_coefficients": network.gains[..., 0].size},
        {"what": "one estimate, second stage, compiled", "us": 1e6 * best(_repeat, quick, x[5], 2000) / 2000},
        _rates("batch of 20000, second stage", network, x[:20_000]),
    ]  # fmt: skip


def _rates(what: str, network: RbfNetwork, x: np.ndarray) -> dict:
    """Answers a second by one thread (of processor time) and by two (on the clock), and the share of matrix product."""
    one = best(network, x, repeats=5)
    with ThreadPoolExecutor(2) as pool:
        halves = np.array_split(x, 2)
        clock = []
        for _ in range(5):
            begin = time.perf_counter()
            list(pool.map(network, halves))
            clock.append(time.perf_counter() - begin)
    centres, inputs = network.centres.shape
    wide = centres * (inputs + 2 + network.n_outputs) + (1 + inputs) * network.n_outputs * (
        (1 + inputs) * (network.degree >= 0) + len(network.gains)
    )
    return {"what": what, "per_second": len(x) / one, "per_second_two_threads": len(x) / min(clock),
            "share_of_matrix_product": 2 * wide * len(x) / one / product_rate()}  # fmt: skip


def _each(refine, value, start):
    for v, s in zip(value, start, strict=True):
        refine(v, s)


def _refine(batch, value, start):
    """Steps until one is below 1e-5 of the prior's spread; the next would be below 1e-9."""
    return refine_many(batch, value, start, tolerance=1e-5)


def _repeat(work, given, times):
    for _ in range(times):
        work(given)


PARTS: dict[str, Callable[[], list[dict]]] = {"speed": speed, "frfs": frfs, "growth": growth}


def main() -> None:
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("--parts", nargs="+", default=["accuracy", *PARTS], choices=["accuracy", *PARTS])
    reader.add_argument("--sets", type=int, default=1000, help="verification sets of the accuracy part")
    reader.add_argument("--json", action="store_true")
    reader.add_argument("--plots", type=Path, help="folder for the plots of growth")
    told = reader.parse_args()
    found = {p: accuracy(told.sets) if p == "accuracy" else PARTS[p]() for p in told.parts}
    if told.plots is not None and "growth" in found:
        draw_growth(found["growth"], told.plots)
    if told.json:
        print(json.dumps(found))
        return
    for part, table in found.items():
        print(f"\n{part}")
        for row in table:
            print("  " + "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()))


if __name__ == "__main__":
    main()
