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
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.optimize import least_squares

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


def simulate(step: Callable[[NDArray], float], u: NDArray, y: NDArray) -> NDArray:
    """Free run from the first WARM samples."""
    out = y.copy()
    for t in range(WARM, u.size):
        x = np.concatenate([u[t : t - LAGS - 1 : -1], out[t - 1 : t - LAGS - 1 : -1]])
        out[t] = np.clip(step(x), -1.0, 1.0)
    return out


def rms(step: Callable[[NDArray], float], u: NDArray, y: NDArray) -> float:
    """Simulated error in mV RMS."""
    return 1e3 * float(np.sqrt(np.mean((simulate(step, u, y) - y)[WARM:] ** 2)))


def main() -> None:
    """One line a model."""
    u, y = data(sys.argv[1])
    spans = [slice(START + GAP * i, START + GAP * i + LENGTH) for i in range(10)]
    x = np.concatenate([regressors(u[s], y[s]) for s in spans[:8]])
    target = np.concatenate([y[s][LAGS:] for s in spans[:8]])
    tests = [slice(0, 40500), spans[8], spans[9]]
    columns = x.shape[1]
    cube = [*((i,) for i in range(columns)), (LAGS + 1,) * 2, (LAGS + 1,) * 3]

    def linear_in(terms: list[tuple[int, ...]]) -> Callable[[NDArray], float]:
        size = np.linalg.lstsq(product(x, terms), target, rcond=None)[0]
        return lambda one: float(product(one, terms) @ size)

    models: dict[str, Callable[[NDArray], float]] = {
        "linear ARX": linear_in(powers(columns, 1)),
        "Duffing form, one step ahead": linear_in(cube),
        "polynomial NARX, degree 3": linear_in(powers(columns, 3)),
    }
    models["Duffing form, simulated error"] = refined(cube, x, target, u, y, spans[:2])
    try:
        from sklearn.neural_network import MLPRegressor
    except ImportError:
        print("scikit-learn is not installed: no perceptron")
    else:
        scale = x.std(axis=0)
        net = MLPRegressor((30,), activation="tanh", solver="lbfgs", max_iter=2000, random_state=0, tol=1e-9)
        net.fit(x / scale, target / y.std())
        models["perceptron NARX, 30 units"] = perceptron(net.coefs_, net.intercepts_, scale, float(y.std()))
    print(f"{'model':32s} {'arrow':>8s} {'ms 9':>8s} {'ms 10':>8s}  mV RMS, simulated")
    for name, step in models.items():
        print(f"{name:32s} " + " ".join(f"{rms(step, u[s], y[s]):8.3f}" for s in tests), flush=True)


def perceptron(weights: list[NDArray], offsets: list[NDArray], scale: NDArray, size: float) -> Callable[..., float]:
    """One step of a net of one hidden layer."""
    first, second = weights
    return lambda one: float(np.tanh(one / scale @ first + offsets[0]) @ second[:, 0] + offsets[1][0]) * size


def refined(
    terms: list[tuple[int, ...]], x: NDArray, target: NDArray, u: NDArray, y: NDArray, spans: list[slice]
) -> Callable[[NDArray], float]:
    """The form's coefficients that minimise its simulated error on `spans`."""
    basis = product(x, terms)
    start = np.linalg.lstsq(basis, target, rcond=None)[0]
    scale = 1e-3 / np.sqrt(np.mean(basis**2, axis=0))

    def left(p: NDArray) -> NDArray:
        size = start + scale * p
        return np.concatenate([
            (simulate(lambda one: float(product(one, terms) @ size), u[s], y[s]) - y[s])[WARM::4] * 1e3 for s in spans
        ])  # fmt: skip

    size = start + scale * least_squares(left, np.zeros(len(terms)), max_nfev=12).x
    return lambda one: float(product(one, terms) @ size)


if __name__ == "__main__":
    main()
