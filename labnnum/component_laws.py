r"""Laws that tie a force to an imposed motion.

Dry friction behind play is a spring in series with a slider, the spring reaching nothing within +- b/2 of the slider:

.. math:: f = k \, \mathrm{dz}(z - m, b/2), \quad |f| \le F, \quad \dot m = 0 \text{ while } |f| < F

References
----------
W. D. Iwan, "A distributed-element model for hysteresis and its steady-state dynamic response", J. Applied Mechanics
33, 1966.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from labnnum.errors import EstimationError

Vector = NDArray[np.float64]

LAWS: dict[str, tuple[tuple[str, str], ...]] = {
    "viscous": (("c", "N*s/m"),),
    "quadratic-damping": (("c2", "N*s^2/m^2"),),
    "cubic-stiffness": (("k3", "N/m^3"),),
    "coulomb-friction": (("F", "N"),),
    "viscous with spring": (("c", "N*s/m"), ("k", "N/m")),
    "clearance": (("k", "N/m"), ("g", "m")),
    "stick-slip": (("k_t", "N/m"), ("F_s", "N")),
    "stick-slip with clearance": (("k_t", "N/m"), ("F_s", "N"), ("backlash", "m")),
}
"""Laws that compete, with their parameters and units."""

LINEAR = ("viscous", "quadratic-damping", "cubic-stiffness", "coulomb-friction", "viscous with spring")
"""Laws that are linear in their parameters: the best fit is one formula."""

DERIVED: dict[str, tuple[tuple[str, str, Callable[[Vector], float]], ...]] = {
    "stick-slip": (
        ("half travel", "m", lambda p: p[1] / p[0]),
        ("full travel", "m", lambda p: 2 * p[1] / p[0]),
    ),
    "stick-slip with clearance": (
        ("half travel", "m", lambda p: p[2] + p[1] / p[0]),
        ("full travel", "m", lambda p: p[2] + 2 * p[1] / p[0]),
    ),
}
"""What follows from a law's parameters: the motion at a reversal from half (from all) of the friction force to as much
the other way, which is play and elastic stroke together."""


@dataclass(frozen=True, eq=False)
class ComponentTest:
    """Motion z (m), its rate v (m/s) and the force that opposes it f (N), each (n,).

    Parameters
    ----------
    start : int
        First sample that counts: before it a law with memory finds its state.
    cycle : int
        Samples in a cycle of the motion; 0 if it has none.
    label : str
        For messages.
    """

    z: Vector
    v: Vector
    f: Vector
    start: int = 0
    cycle: int = 0
    label: str = ""

    def __post_init__(self) -> None:
        for name in ("z", "v", "f"):
            x = np.ascontiguousarray(getattr(self, name), dtype=float)
            object.__setattr__(self, name, x)
            what = {"z": "motion", "v": "velocity", "f": "force"}[name]
            if x.shape != (np.size(self.z),):
                raise EstimationError(
                    f"{self.label or 'test'}: {what} has shape {x.shape}, the motion {np.size(self.z)}"
                )
            if not np.isfinite(x).all():
                raise EstimationError(f"{self.label or 'test'}: {what} is not finite")
            if np.ptp(x[self.start :]) == 0.0:
                raise EstimationError(f"{self.label or 'test'}: {what} is constant from sample {self.start} on")

    @property
    def counted(self) -> slice:
        """Samples that count."""
        return slice(self.start, None)


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


def force(law: str, p: Sequence[float] | Vector, test: ComponentTest) -> Vector:
    """Force of a law along the motion of a test, shape (n,); EstimationError if `LAWS` has no such law."""
    z, v = test.z, test.v
    if law == "viscous":
        return p[0] * v
    if law == "quadratic-damping":
        return p[0] * v * np.abs(v)
    if law == "cubic-stiffness":
        return p[0] * z**3
    if law == "coulomb-friction":
        return p[0] * np.sign(v)
    if law == "viscous with spring":
        return p[0] * v + p[1] * z
    if law == "clearance":
        return p[0] * np.sign(z) * np.maximum(np.abs(z) - p[1], 0)
    if law == "stick-slip":
        return _slide(z, max(p[0], 1e-9), p[1], 0.0)
    if law == "stick-slip with clearance":
        return _slide(z, max(p[0], 1e-9), p[1], 0.5 * p[2])
    raise EstimationError(f"component law {law!r} is not one of {', '.join(LAWS)}")


def sensitivity(law: str, p: Vector, test: ComponentTest) -> Vector:
    """Derivatives of the counted force by the parameters, shape (n, n_parameters), by central differences."""
    columns = []
    for i, value in enumerate(p):
        step = 1e-4 * abs(value) or 1e-12
        up, down = (np.where(np.arange(p.size) == i, value + s, p) for s in (step, -step))
        columns.append((force(law, up, test) - force(law, down, test))[test.counted] / (2 * step))
    return np.stack(columns, axis=1)
