"""What a loop of force and motion shows by itself: work per cycle and travel at a reversal."""

from __future__ import annotations

import numpy as np

from labnnum.component_laws import ComponentTest, Vector

STEADY = 0.98
"""Part of the largest stroke from which a cycle counts as steady."""


def steady_cycles(test: ComponentTest) -> list[slice]:
    """Cycles (a sample more than a cycle, so that each closes) whose stroke is the largest of the test, within 2 %;
    all that counts as one where the motion has no cycle.
    """
    n = test.cycle
    if not 1 < n < test.z.size:
        return [slice(test.start, test.z.size)]
    whole = [slice(i, i + n + 1) for i in range(0, test.z.size - n, n)]
    stroke = np.array([np.ptp(test.z[s]) for s in whole])
    return [s for s, size in zip(whole, stroke, strict=True) if size >= STEADY * stroke.max()]


def work_per_cycle(test: ComponentTest, f: Vector) -> float:
    """Work (J) that a force f (n,) takes out of the motion in a steady cycle, the mean over them."""
    return float(np.mean([np.trapezoid(f[s], test.z[s]) for s in steady_cycles(test)]))


def reversal_travel(test: ComponentTest, f: Vector, size: float) -> float:
    """Motion (m) from the last sample with a force beyond `size` (N) to the first beyond it the other way.

    The mean over the reversals of the steady cycles; NaN if there is none.
    """
    at = steady_cycles(test)
    part = slice(at[0].start, at[-1].stop)
    z, f = test.z[part], f[part]
    beyond = np.flatnonzero(np.abs(f) > size)
    sign = np.sign(f[beyond])
    turned = np.flatnonzero(sign[1:] != sign[:-1])
    if not turned.size:
        return float("nan")
    return float(np.mean(np.abs(z[beyond[turned + 1]] - z[beyond[turned]])))
