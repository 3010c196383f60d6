r"""Component tests: which law ties a force to an imposed motion, without any structure around it.

Every law is simulated along the measured motion and fitted to the measured force by least squares; they compete on
data that no fit saw. Dry friction behind play is a spring in series with a slider, the spring reaching nothing
within +- b/2 of the slider:

.. math:: f = k \, \mathrm{dz}(z - m, b/2), \quad |f| \le F, \quad \dot m = 0 \text{ while } |f| < F

References
----------
W. D. Iwan, "A distributed-element model for hysteresis and its steady-state dynamic response", J. Applied Mechanics
33, 1966.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from labnnum.errors import EstimationError

LAWS: dict[str, tuple[tuple[str, str], ...]] = {
    "viscous": (("c", "N*s/m"),),
    "quadratic-damping": (("c2", "N*s^2/m^2"),),
    "cubic-stiffness": (("k3", "N/m^3"),),
    "coulomb-friction": (("F", "N"),),
    "clearance": (("k", "N/m"), ("g", "m")),
    "stick-slip": (("k_t", "N/m"), ("F_s", "N")),
    "stick-slip with clearance": (("k_t", "N/m"), ("F_s", "N"), ("backlash", "m")),
}
"""Laws that compete, with their parameters and units."""


@dataclass(frozen=True, eq=False)
class Test:
    """Motion z (m), its rate v (m/s) and the force that opposes it f (N), each (n,); steady from `start` on."""

    z: NDArray[np.float64]
    v: NDArray[np.float64]
    f: NDArray[np.float64]
    start: int = 0
    label: str = ""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A law with its parameters and standard deviations; relative RMS errors on the data fitted to and held out.

    The standard deviations come from fits to each test on its own, where there are several.
    """

    law: str
    value: NDArray[np.float64]
    std: NDArray[np.float64]
    error: float
    held_out: float


@njit(cache=True)
def _slide(z, k, limit, play):  # pragma: no cover - compiled
    out = np.empty(z.size)
    m = z[0]
    for i in range(z.size):
        d = z[i] - m
        if d > play:
            f = k * (d - play)
            if f > limit:
                f = limit
                m = z[i] - play - limit / k
        elif d < -play:
            f = k * (d + play)
            if f < -limit:
                f = -limit
                m = z[i] + play + limit / k
        else:
            f = 0.0
        out[i] = f
    return out


def force(law: str, p: Sequence[float] | NDArray, test: Test) -> NDArray[np.float64]:
    """Force of a law along the motion of a test, shape (n,)."""
    z, v = np.ascontiguousarray(test.z), test.v
    if law == "viscous":
        return p[0] * v
    if law == "quadratic-damping":
        return p[0] * v * np.abs(v)
    if law == "cubic-stiffness":
        return p[0] * z**3
    if law == "coulomb-friction":
        return p[0] * np.sign(v)
    if law == "clearance":
        return p[0] * np.sign(z) * np.maximum(np.abs(z) - p[1], 0)
    if law == "stick-slip":
        return _slide(z, max(p[0], 1e-9), p[1], 0.0)
    if law == "stick-slip with clearance":
        return _slide(z, max(p[0], 1e-9), p[1], 0.5 * p[2])
    raise EstimationError(f"component law {law!r} is not one of {', '.join(LAWS)}")


def identify_component(tests: Sequence[Test], held_out: Sequence[Test] = ()) -> list[Fitted]:
    """Every law fitted to `tests`, the best on `held_out` first.

    Raises
    ------
    EstimationError
        If no test is given.
    """
    if not tests:
        raise EstimationError("no component test was given")
    out = []
    for law in LAWS:
        value = _fit(law, tests)
        each = np.array([_fit(law, [t], value) for t in (*tests, *held_out)])
        n = len(each)
        std = each.std(axis=0, ddof=1) / np.sqrt(n) if n > 1 else np.full(value.size, np.nan)
        error = _error(law, value, tests)
        out.append(Fitted(law, value, std, error, _error(law, value, held_out) if held_out else error))
    return sorted(out, key=lambda f: f.held_out)


def _error(law: str, p: NDArray, tests: Sequence[Test]) -> float:
    parts = [np.sum((t.f - force(law, p, t))[t.start :] ** 2) / np.sum(t.f[t.start :] ** 2) for t in tests]
    return float(np.sqrt(np.mean(parts)))


def _fit(law: str, tests: Sequence[Test], near: NDArray | None = None) -> NDArray[np.float64]:
    """Least squares over the tests, from a grid where no start is given."""
    from scipy.optimize import minimize

    n = len(LAWS[law])
    top = max(float(np.max(np.abs(t.z))) for t in tests)
    size = float(np.sqrt(np.mean([np.mean(t.f**2) for t in tests])))
    if n == 1:
        unit = [force(law, [1.0], t)[t.start :] for t in tests]
        weight = [1.0 / np.sum(t.f[t.start :] ** 2) for t in tests]
        along = sum(w * (u @ t.f[t.start :]) for w, u, t in zip(weight, unit, tests, strict=True))
        return np.array([along / sum(w * (u @ u) for w, u in zip(weight, unit, strict=True))])
    scale = {"clearance": [size / top, top], "stick-slip": [size / top, size]}.get(law, [size / top, size, top])

    def left(x: NDArray) -> float:
        return _error(law, np.exp(np.clip(x, -12, 12)) * scale, tests)

    starts = [np.log(near / scale)] if near is not None else _grid(law)
    found = []
    for x in starts:
        simplex = np.vstack([x, x + 0.4 * np.eye(n)])
        options = {"xatol": 1e-3, "fatol": 1e-5, "initial_simplex": simplex, "maxfev": 400}
        found.append(minimize(left, x, method="Nelder-Mead", options=options))
    best = min(found, key=lambda f: f.fun)
    return np.exp(np.clip(best.x, -12, 12)) * scale


def _grid(law: str) -> list[NDArray[np.float64]]:
    if law == "clearance":
        return [np.log([k, g]) for k in (1.0, 5.0) for g in (0.1, 0.6)]
    if law == "stick-slip":
        return [np.log([k, 1.0]) for k in (1.0, 5.0, 30.0)]
    return [np.log([k, 1.0, b]) for k in (3.0, 20.0) for b in (0.1, 0.4, 0.8)]
