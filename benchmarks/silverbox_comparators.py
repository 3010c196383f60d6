"""Black boxes on the Silverbox, simulated (not one step ahead) on the same data as `labnnum prove real`.

    python benchmarks/silverbox_comparators.py RECORDINGS/silverbox/SNLS80mV.mat

Fitted to multisines 1 to 8 of the ten, judged on the arrow and on multisines 9 and 10, all in mV RMS; the first 50
samples of each test start the models from the measurement and are not counted:

- linear ARX, polynomial NARX (all products up to degree 3) and the Duffing form y, y^3 by least squares one step ahead
- a multilayer perceptron NARX (scikit-learn, 30 units, one seed), one step ahead
- the Duffing form refined on its simulated error (Levenberg-Marquardt), which is what a grey box does
- sparse identification, SINDy (Brunton, Proctor and Kutz 2016), as PySINDy has it: output and its derivative as the
  state, polynomials of degree 3 of state and input, sequentially thresholded least squares; each column of unit RMS,
  derivatives of the periodic records by Fourier's series. Fitted to multisines 1 to 7; the threshold shown is the one
  of fourteen that simulates multisine 8 best

The polynomial and neural forms see the same lags. scikit-learn is needed for the perceptron only, PySINDy for its own
row (`pip install -e ".[benchmark]"`); what is not installed is left out, and said.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import combinations_with_replacement

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.optimize import least_squares
from scipy.signal import resample_poly

Model = Callable[[NDArray, NDArray], NDArray]
"""From input and output (whose first WARM samples start it) to the simulated output."""

START, LENGTH, GAP, WARM = 40930, 8192, 8692, 50
LAGS = 3


def data(path: str) -> tuple[NDArray, NDArray]:
    """Input and output in V, means removed."""
    content = loadmat(path)
    u, y = np.ravel(content["V1"]).astype(float), np.ravel(content["V2"]).astype(float)
    return u - u.mean(), y - y.mean()


def regressors(u: NDArray, y: NDArray, n: int = LAGS) -> NDArray:
    """u(t) ... u(t - n), y(t - 1) ... y(t - n) for t >= n, shape (n_samples - n, 2 n + 1)."""
    at = np.arange(n, u.size)
    return np.column_stack([*(u[at - i] for i in range(n + 1)), *(y[at - i] for i in range(1, n + 1))])


def powers(columns: int, degree: int) -> list[tuple[int, ...]]:
    """Products of columns up to a degree, the constant included."""
    return [c for d in range(degree + 1) for c in combinations_with_replacement(range(columns), d)]


def product(x: NDArray, terms: list[tuple[int, ...]]) -> NDArray:
    """Every product along the last axis of x."""
    return np.stack([np.prod(x[..., list(t)], axis=-1) for t in terms], axis=-1)


@njit(cache=True)
def march(u, y, lags, table, size):  # pragma: no cover - compiled
    """Free run of a polynomial form from the first WARM samples; rows of `table` hold columns, -1 for none."""
    out = y.copy()
    x = np.empty(2 * lags + 1)
    for t in range(WARM, u.size):
        for i in range(lags + 1):
            x[i] = u[t - i]
        for i in range(lags):
            x[lags + 1 + i] = out[t - 1 - i]
        total = 0.0
        for row in range(table.shape[0]):
            value = size[row]
            for c in table[row]:
                if c >= 0:
                    value *= x[c]
            total += value
        out[t] = min(max(total, -1.0), 1.0)
    return out


def polynomial(terms: list[tuple[int, ...]], size: NDArray) -> Model:
    """Simulation of a polynomial form."""
    table = np.full((len(terms), 3), -1, np.int64)
    for row, t in enumerate(terms):
        table[row, : len(t)] = t
    return lambda u, y: march(u, y, LAGS, table, size)


def perceptron(weights: list[NDArray], offsets: list[NDArray], scale: NDArray, size: float) -> Model:
    """Simulation of a net with one hidden layer."""
    first, second = weights[0] / scale[:, None], weights[1][:, 0] * size

    def run(u: NDArray, y: NDArray) -> NDArray:
        out = y.copy()
        for t in range(WARM, u.size):
            x = np.concatenate([u[t : t - LAGS - 1 : -1], out[t - 1 : t - LAGS - 1 : -1]])
            out[t] = min(max(float(np.tanh(x @ first + offsets[0]) @ second + offsets[1][0] * size), -1.0), 1.0)
        return out

    return run


def rms(model: Model, u: NDArray, y: NDArray) -> float:
    """Simulated error in mV RMS."""
    return 1e3 * float(np.sqrt(np.mean((model(u, y) - y)[WARM:] ** 2)))


def refined(
    terms: list[tuple[int, ...]], start: NDArray, basis: NDArray, parts: list[tuple[NDArray, NDArray]]
) -> Model:
    """The form's coefficients that minimise its simulated error on `parts`."""
    scale = 1e-3 / np.sqrt(np.mean(basis**2, axis=0))

    def left(p: NDArray) -> NDArray:
        model = polynomial(terms, start + scale * p)
        return np.concatenate([(model(u, y) - y)[WARM:] * 1e3 for u, y in parts])

    return polynomial(terms, start + scale * least_squares(left, np.zeros(len(terms)), max_nfev=40).x)


TOP = 240.0
"""Hz, to which the records are differentiated: the excitation ends at 200 Hz, the converter's filter lies above."""
RATE = 1e7 / 2**14
FINER = 8
"""Input values between samples, interpolated as of a band-limited signal; two make a step of Runge and Kutta."""


def derivatives(y: NDArray, rate: float = RATE, top: float = TOP) -> tuple[NDArray, NDArray, NDArray]:
    """A periodic record below `top` and its first two derivatives, by its Fourier series."""
    line, spectrum = 2 * np.pi * np.fft.rfftfreq(y.size, 1 / rate), np.fft.rfft(y)
    spectrum = np.where(line <= 2 * np.pi * top, spectrum, 0)
    plain, first, second = (np.fft.irfft(spectrum * (1j * line) ** k, y.size) for k in range(3))
    return plain, first, second


@njit(cache=True)
def oscillate(y, v, u, h, powers, size):  # pragma: no cover - compiled
    """Runge and Kutta for y'' = polynomial(y, y', u); `u` holds FINER values a sample."""
    out = np.zeros(u.size // FINER)
    state, k = np.array([y, v]), np.zeros((4, 2))
    for t in range(out.size):
        out[t] = state[0]
        for step in range(FINER // 2):
            at = t * FINER + 2 * step
            if at + 2 >= u.size:
                break
            for stage in range(4):
                part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                x = state if stage == 0 else state + h * part * k[stage - 1]
                force = u[at + (0 if stage == 0 else (2 if stage == 3 else 1))]
                total = 0.0
                for row in range(size.size):
                    total += size[row] * x[0] ** powers[row, 0] * x[1] ** powers[row, 1] * force ** powers[row, 2]
                k[stage, 0], k[stage, 1] = x[1], total
            state = state + h * (k[0] + 2 * k[1] + 2 * k[2] + k[3]) / 6
            state = np.minimum(np.maximum(state, -1e3), 1e3)
    return out


def sparse(parts: list[tuple[NDArray, NDArray]]) -> Callable[[float], tuple[Model, int]]:
    """Threshold -> simulation of what PySINDy finds, and how many terms it keeps."""
    import pysindy

    rows = [(*derivatives(y), derivatives(u)[0]) for u, y in parts]
    length, force = (np.sqrt(np.mean(np.concatenate([r[i] for r in rows]) ** 2)) for i in (0, 3))
    speed = np.sqrt(np.mean(np.concatenate([r[1] for r in rows]) ** 2))
    pace = speed / length  # 1/s: time in these units makes every derivative of the state of order one
    state = [np.column_stack([r[0] / length, r[1] / speed]) for r in rows]
    slope = [np.column_stack([r[1] / speed, r[2] / speed / pace]) for r in rows]
    inputs = [r[3][:, None] / force for r in rows]

    def at(threshold: float) -> tuple[Model, int]:
        library = pysindy.PolynomialLibrary(degree=3)
        found = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=0.0, normalize_columns=True, max_iter=50),
            feature_library=library,
        )
        found.fit(state, t=pace / RATE, x_dot=slope, u=inputs)
        size = np.asarray(found.coefficients())[1]
        powers = np.asarray(library.powers_, np.int64)

        def run(u: NDArray, y: NDArray) -> NDArray:
            fine = resample_poly(u, FINER, 1, window=("kaiser", 12.0)) / force
            h = 2 * pace / RATE / FINER

            def missed(start: NDArray) -> NDArray:
                return oscillate(start[0], start[1], fine[: WARM * FINER], h, powers, size) - y[:WARM] / length

            start = least_squares(missed, np.array([y[0] / length, 0.0])).x
            made = oscillate(start[0], start[1], fine, h, powers, size)
            return np.clip(length * made, -1.0, 1.0)

        return run, int(np.count_nonzero(size))

    return at


def best_sparse(u: NDArray, y: NDArray, spans: list[slice]) -> tuple[str, Model]:
    """PySINDy at the threshold that simulates multisine 8 best."""
    at = sparse([(u[s], y[s]) for s in spans[:7]])
    rows = []
    for threshold in (0.0, *np.geomspace(0.01, 40.96, 13)):
        model, terms = at(float(threshold))
        rows.append((rms(model, u[spans[7]], y[spans[7]]), float(threshold), terms, model))
        print(f"    SINDy, threshold {threshold:.3g}: {terms} of 20 terms, multisine 8 {rows[-1][0]:.3f}", flush=True)
    _, threshold, terms, model = min(rows, key=lambda r: r[0])
    return f"PySINDy, {terms} terms ({threshold:.2g})", model


def main() -> None:
    """One line a model."""
    u, y = data(sys.argv[1])
    spans = [slice(START + GAP * i, START + GAP * i + LENGTH) for i in range(10)]
    x = np.concatenate([regressors(u[s], y[s]) for s in spans[:8]])
    target = np.concatenate([y[s][LAGS:] for s in spans[:8]])
    tests = [slice(0, 40500), spans[8], spans[9]]
    columns = x.shape[1]
    forms = {
        "linear ARX": powers(columns, 1),
        "Duffing form, one step ahead": [*((i,) for i in range(columns)), (LAGS + 1,) * 2, (LAGS + 1,) * 3],
        "polynomial NARX, degree 3": powers(columns, 3),
    }
    print(f"{'model':32s} {'arrow':>8s} {'ms 9':>8s} {'ms 10':>8s}  mV RMS, simulated")

    def show(name: str, model: Model) -> None:
        print(f"{name:32s} " + " ".join(f"{rms(model, u[s], y[s]):8.3f}" for s in tests), flush=True)

    for name, terms in forms.items():
        basis = product(x, terms)
        size = np.linalg.lstsq(basis, target, rcond=None)[0]
        show(name, polynomial(terms, size))
        if name.startswith("Duffing"):
            parts = [(u[s], y[s]) for s in spans[:8]]
            show("Duffing form, simulated error", refined(terms, size, basis, parts))
    try:
        show(*best_sparse(u, y, spans))
    except ImportError as error:
        print(f"{error.name} is not installed: no sparse identification")
    try:
        from sklearn.neural_network import MLPRegressor
    except ImportError:
        print("scikit-learn is not installed: no perceptron")
        return
    scale = x.std(axis=0)
    net = MLPRegressor(
        hidden_layer_sizes=(30,),
        activation="tanh",
        solver="lbfgs",
        max_iter=400,
        max_fun=10**6,
        random_state=0,
        tol=1e-9,
    )
    net.fit(x / scale, target / y.std())
    show("perceptron NARX, 30 units", perceptron(net.coefs_, net.intercepts_, scale, float(y.std())))


if __name__ == "__main__":
    main()
