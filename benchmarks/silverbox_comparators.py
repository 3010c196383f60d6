"""Black boxes on the Silverbox, simulated (not one step ahead) on the same data as `labnnum prove real`.

    python benchmarks/silverbox_comparators.py RECORDINGS/silverbox/SNLS80mV.mat

Fitted to multisines 1 to 8 of the ten, judged on the arrow and on multisines 9 and 10, all in mV RMS; the first 50
samples of each test start the models from the measurement and are not counted:

- linear ARX, polynomial NARX (all products up to degree 3) and the Duffing form y, y^3 by least squares one step ahead
- a multilayer perceptron NARX (scikit-learn, 30 units, one seed), one step ahead
- the Duffing form refined on its simulated error (Levenberg-Marquardt), which is what a grey box does

The polynomial and neural forms see the same lags. scikit-learn is needed for the perceptron only.
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
