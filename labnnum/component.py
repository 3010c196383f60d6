"""Component tests: which law ties a force to an imposed motion, without any structure around it.

Every law of `labnnum.component_laws` is simulated along the measured motion and fitted to the measured force by least
squares; they compete on data that no fit saw.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labnnum.component_intervals import intervals
from labnnum.component_laws import LAWS, LINEAR, ComponentTest, Vector, force
from labnnum.errors import EstimationError

FURTHER = 0.97
"""A law with more parameters must lower the error held out to this part, as a further law of a diagnosis must."""
EXPLAINED = 0.5
"""A law that leaves more than this part of the force is no answer."""
EXACT = 1e-3
"""Relative error below which laws fit alike: no force is measured better."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """A law fitted to component tests.

    Parameters
    ----------
    law : str
        A key of `LAWS`.
    value, std, half : ndarray, shape (n_parameters,)
        Parameters, their standard deviations, and half the width of their 90 % intervals
        (`labnnum.component_intervals`).
    derived : tuple of (name, unit, value, std, half)
        What `DERIVED` makes of them.
    error, held_out : float
        Relative RMS error of the force on the tests fitted to, and on those held out (on those fitted to if none is).
    """

    law: str
    value: Vector
    std: Vector
    half: Vector
    derived: tuple[tuple[str, str, float, float, float], ...]
    error: float
    held_out: float


def identify_component(
    tests: Sequence[ComponentTest],
    held_out: Sequence[ComponentTest] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> list[Fitted]:
    """Every law fitted to `tests`, the one that is named first, then the others by their error on `held_out`.

    Named is the law with the fewest parameters among those that come within 3 % of the least error (`FURTHER`): a law
    that holds another one, with play that turns out as nothing say, fits as well and is not the simpler answer.

    Raises
    ------
    EstimationError
        If no test is given.
    """
    if not tests:
        raise EstimationError("no component test was given")
    out = []
    for law in LAWS:
        progress(law)
        value = fit(law, tests)
        each = np.array([fit(law, [t], value) for t in tests])
        std, half, derived = intervals(law, value, tests, each)
        error = relative_error(law, value, tests)
        judged = relative_error(law, value, held_out) if held_out else error
        out.append(Fitted(law, value, std, half, derived, error, judged))
    out.sort(key=lambda f: f.held_out)
    enough = max(out[0].held_out / FURTHER, EXACT)
    named = min((f for f in out if f.held_out <= enough), key=lambda f: (f.value.size, f.held_out))
    return [named, *(f for f in out if f is not named)]


def relative_error(law: str, p: Sequence[float] | Vector, tests: Sequence[ComponentTest]) -> float:
    """RMS error of the force over its own RMS, of several tests their root mean square."""
    parts = []
    for t in tests:
        f = t.f[t.counted]
        parts.append(np.sum((f - force(law, p, t)[t.counted]) ** 2) / np.sum(f**2))
    return float(np.sqrt(np.mean(parts)))


def fit(law: str, tests: Sequence[ComponentTest], near: Vector | None = None) -> Vector:
    """Parameters (n_parameters,) of the least mean square error over the tests, relative to each one's force.

    Parameters
    ----------
    near : ndarray, shape (n_parameters,), optional
        Where to begin; a grid if None.
    """
    if law in LINEAR:
        return _formula(law, tests)
    from scipy.optimize import minimize

    n = len(LAWS[law])
    top = max(float(np.max(np.abs(t.z))) for t in tests)
    size = float(np.sqrt(np.mean([np.mean(t.f**2) for t in tests])))
    scale = {"clearance": [size / top, top], "stick-slip": [size / top, size]}.get(law, [size / top, size, top])

    def left(x: Vector) -> float:
        return relative_error(law, np.exp(np.clip(x, -12, 12)) * scale, tests)

    def searched(x: Vector, wide: float, fine: float) -> tuple[float, Vector]:
        simplex = np.vstack([x, x + wide * np.eye(n)])
        options = {"xatol": fine, "fatol": 1e-2 * fine, "initial_simplex": simplex, "maxfev": 400}
        found = minimize(left, x, method="Nelder-Mead", options=options)
        return float(found.fun), found.x

    starts = [np.clip(np.log(near / scale), -12, 12)] if near is not None else _grid(law)
    _, best = min((searched(x, 0.4, 1e-3) for x in starts), key=lambda f: f[0])
    _, best = searched(best, 0.02, 1e-6)
    return np.exp(np.clip(best, -12, 12)) * scale


def _formula(law: str, tests: Sequence[ComponentTest]) -> Vector:
    n = len(LAWS[law])
    rows, right = [], []
    for t in tests:
        size = np.sqrt(np.sum(t.f[t.counted] ** 2))
        rows.append(np.stack([force(law, unit, t)[t.counted] for unit in np.eye(n)], axis=1) / size)
        right.append(t.f[t.counted] / size)
    basis, target = np.concatenate(rows), np.concatenate(right)
    scale = np.sqrt(np.sum(basis**2, axis=0))
    return np.linalg.lstsq(basis / scale, target, rcond=None)[0] / scale


def _grid(law: str) -> list[Vector]:
    if law == "clearance":
        return [np.log([k, g]) for k in (1.0, 5.0) for g in (0.1, 0.6)]
    if law == "stick-slip":
        return [np.log([k, 1.0]) for k in (1.0, 5.0, 30.0)]
    return [np.log([k, 1.0, b]) for k in (3.0, 20.0) for b in (0.1, 0.4, 0.8)]
