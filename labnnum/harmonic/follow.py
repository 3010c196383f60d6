"""A curve of periodic responses followed by its arc length around folds (Keller 1977).

The length is that of the motions (laws' and outputs', each over its own size at the moment) and of the frequency over
its range, so that resonances are resolved where no law acts as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError

if TYPE_CHECKING:
    from labnnum.harmonic.balance import Balance, HarmonicBalance

LEAST = 1e-7
"""Shortest step."""
FLOOR = 0.05
"""Size of a motion, of the largest that it has had, below which steps are not shortened for it."""
TURN = 0.7
"""Cosine between two tangents below which a step was too long, if it was longer than `KINK`."""
KINK = 1e-3


class _Metric:
    """What lengths are measured by: motions over their sizes, the frequency over its range."""

    def __init__(self, rows: int, harmonics: int, span: float) -> None:
        self.top, self.size, self.span, self.m = np.zeros(rows), np.ones(rows), span, 2 * harmonics + 1

    def see(self, motion: NDArray) -> None:
        now = np.linalg.norm(motion, axis=1)
        self.top = np.maximum(self.top, now)
        floor = np.maximum(FLOOR * self.top, 1e-6 * self.top.max())
        self.size = np.where(floor > 0, now + floor, 1.0)

    def over(self, flat: NDArray) -> NDArray:
        """Slopes of motions, (r m, ...), over their sizes."""
        return flat / np.repeat(self.size, self.m)[(slice(None), *([None] * (flat.ndim - 1)))]


def follow(
    balance: HarmonicBalance, begun: tuple[NDArray, float, Balance], high: float, step: float, most: int
) -> Iterator[tuple[NDArray, float, Balance]]:
    """Forces x (g, m), omega in rad/s and the equation there, point by point from the one that is `begun` to `high`."""
    x, omega, b = begun
    metric = _Metric(len(b.motion), balance.harmonics, high - omega)
    yield x, omega, b
    metric.see(b.motion)
    direction = _tangent(b, metric, None)
    length, count = step / 4, 1
    while omega < high:
        if count >= most:
            raise EstimationError(
                f"the curve of responses has not reached {high / (2 * np.pi):g} Hz within {most} points; it stands at"
                f" {omega / (2 * np.pi):g} Hz: take longer steps, or more points"
            )
        found = _step(balance, x, omega, b, direction, metric, length)
        if found is not None:
            new_x, new_omega, new_b, rounds = found
            turned = _tangent(new_b, metric, direction)
            if turned[2] < TURN and length > KINK:
                found = None
        if found is None:
            length /= 2
            if length < LEAST:
                raise EstimationError(
                    f"the curve of responses cannot be followed beyond {omega / (2 * np.pi):g} Hz: take fewer harmonics"
                    " or another force"
                )
            continue
        x, omega, b = new_x, new_omega, new_b
        count += 1
        yield x, omega, b
        metric.see(b.motion)
        direction = _tangent(b, metric, direction)
        if rounds <= 4:
            length = min(1.5 * length, step)


def _tangent(b: Balance, metric: _Metric, before: tuple | None) -> tuple[NDArray, float, float, NDArray]:
    """Unit tangent: its part in x, in omega; the cosine to the one before; itself in the metric."""
    n = b.residual.size
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = b.jacobian, b.to_omega
    if before is None:
        whole[n, n] = 1.0
    else:
        moved = before[3]
        whole[n, :n] = moved[:-1] @ metric.over(b.motion_to_x)
        whole[n, n] = moved[:-1] @ metric.over(b.motion_to_omega) + moved[-1] / metric.span
    right = np.zeros(n + 1)
    right[n] = 1.0
    try:
        t = np.linalg.solve(whole, right)
    except np.linalg.LinAlgError:
        t = np.linalg.svd(whole[:n])[2][-1]
    moved = np.append(metric.over(b.motion_to_x @ t[:n] + b.motion_to_omega * t[n]), t[n] / metric.span)
    size = np.linalg.norm(moved)
    t, moved = t / size, moved / size
    cosine = 1.0 if before is None else float(moved @ before[3] / np.linalg.norm(before[3]))
    if cosine < 0:
        t, moved, cosine = -t, -moved, -cosine
    return t[:n], float(t[n]), cosine, moved


def _step(
    balance: HarmonicBalance, x: NDArray, omega: float, b: Balance, direction: tuple, metric: _Metric, length: float
) -> tuple[NDArray, float, Balance, int] | None:
    """The point `length` further on along the tangent, on the plane across it; None where it is not found."""
    along, to_omega, _, moved = direction
    x0, w0, flat0 = x, omega, b.motion.ravel()
    x, omega = x0 + length * along.reshape(x0.shape), w0 + length * to_omega
    n = x0.size
    for rounds in range(1, 13):
        if omega <= 0:
            return None
        now = balance.evaluate(x, omega)
        off = moved[:-1] @ metric.over(now.motion.ravel() - flat0) + moved[-1] * (omega - w0) / metric.span - length
        if now.small and abs(off) <= 1e-6 * length + 1e-12:
            return x, omega, now, rounds
        whole = np.zeros((n + 1, n + 1))
        whole[:n, :n], whole[:n, n] = now.jacobian, now.to_omega
        whole[n, :n] = moved[:-1] @ metric.over(now.motion_to_x)
        whole[n, n] = moved[:-1] @ metric.over(now.motion_to_omega) + moved[-1] / metric.span
        try:
            change = np.linalg.solve(whole, np.append(now.residual, off))
        except np.linalg.LinAlgError:
            return None
        if not np.isfinite(change).all():
            return None
        x, omega = x - change[:n].reshape(x.shape), omega - change[n]
    return None
