r"""Stabilisation diagram: poles of common-denominator models of growing orders, and which of them repeat.

Physical poles come again at every order that is high enough; those that only fit noise wander. The models are fitted
in the z-domain by least squares (LSCF).

References
----------
P. Guillaume, P. Verboven, S. Vanlanduit, "Frequency-domain maximum likelihood identification of modal parameters with
confidence intervals", ISMA 23, 1998 (the LSCF estimator).
P. Verboven, "Frequency-domain system identification for modal analysis", VUB, 2002, chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FREQUENCY_STAYS, DAMPING_STAYS = 0.01, 0.2
"""Relative change from one order to the next up to which a frequency and a damping ratio count as stable."""
APART = 0.25
"""Half-power bandwidths by which two modes are apart at least."""


@dataclass(frozen=True, eq=False)
class Stabilisation:
    """Poles of every order.

    `order` (n,), `frequency` (n,) in Hz, `damping_ratio` (n,); `frequency_stays` (n,) where a pole of the order before
    has the same frequency, `damping_stays` (n,) where the one nearest in frequency has the same damping ratio, and
    `stable` (n,) where one has both.
    """

    order: NDArray[np.int64]
    frequency: NDArray[np.float64]
    damping_ratio: NDArray[np.float64]
    stable: NDArray[np.bool_]
    frequency_stays: NDArray[np.bool_]
    damping_stays: NDArray[np.bool_]


def stabilisation(omega: NDArray, value: NDArray, order: int, even: bool = False) -> Stabilisation:
    """Poles of common-denominator models of even orders from 4 to `order`, and which repeat from order to order.

    Parameters
    ----------
    omega : ndarray, shape (n_f,)
        Lines, in rad/s, ascending.
    value : ndarray, shape (n_out, n_f)
        Complex FRFs of one input, in whatever unit.
    order : int
        Highest order of the denominator.
    even : bool
        Weights of the lines, see `lscf`.
    """
    rows: list[tuple[int, float, float, bool, bool, bool]] = []
    before: list[tuple[float, float]] = []
    blocks = _Normal.of(omega, value, order, even) if even else None
    for n in range(4, order + 1, 2):
        found = lscf(omega, value, n) if blocks is None else blocks.poles(n)
        rows += [(n, f, z, *_stays(f, z, before)) for f, z in found]
        before = found
    n, f, z, both, own, damped = zip(*rows, strict=True) if rows else ((), (), (), (), (), ())
    flags = (np.array(x, bool) for x in (both, own, damped))
    return Stabilisation(np.array(n, int), np.array(f, float), np.array(z, float), *flags)


def _stays(f: float, z: float, before: list[tuple[float, float]]) -> tuple[bool, bool, bool]:
    """Whether a pole has one of the order before with the same of both, the same frequency, the same damping ratio."""

    def damped(y: float) -> bool:
        return abs(z - y) < DAMPING_STAYS * max(z, 1e-4)

    near = [(g, y) for g, y in before if abs(f - g) < FREQUENCY_STAYS * f]
    nearest = min(before, key=lambda p: abs(f - p[0]), default=None)
    return any(damped(y) for _, y in near), bool(near), nearest is not None and damped(nearest[1])


def lscf(omega: NDArray, value: NDArray, order: int, even: bool = False) -> list[tuple[float, float]]:
    """Frequency (Hz) and damping ratio of the decaying poles of one order, by least squares in the z-domain.

    Parameters
    ----------
    omega : ndarray, shape (n_f,)
    value : ndarray, shape (n_out, n_f)
    even : bool
        Weigh all lines of a response alike, as noise that is the same everywhere asks for; else by what is there, which
        finds small modes between large ones where noise is small.
    """
    return _Normal.of(omega, value, order, even).poles(order)


@dataclass(frozen=True, eq=False)
class _Normal:
    """Normal equations of the common-denominator model, for an order and all below: their leading blocks.

    `own`, `across` and `power` (n_out, order + 1, order + 1) are the products of numerator columns, of numerator with
    denominator columns and of these among themselves.
    """

    omega: NDArray[np.float64]
    step: float
    own: NDArray[np.float64]
    across: NDArray[np.float64]
    power: NDArray[np.float64]

    @classmethod
    def of(cls, omega: NDArray, value: NDArray, order: int, even: bool) -> _Normal:
        step = float(np.pi / (omega[-1] - omega[0]) * 0.95)
        z = np.exp(-1j * np.outer(np.arange(order + 1), (omega - omega[0]) * step))
        products = []
        for row in value:
            size = np.sqrt(np.mean(np.abs(row) ** 2))
            w = np.full(row.size, 1.0 / size) if even else 1.0 / (np.abs(row) + 0.05 * size)
            x, y = z * w, -z * (w * row)
            products.append([np.real(a.conj() @ b.T) for a, b in ((x, x), (x, y), (y, y))])
        own, across, power = (np.array(p) for p in zip(*products, strict=True))
        return cls(omega, step, own, across, power)

    def poles(self, order: int) -> list[tuple[float, float]]:
        """Frequency (Hz) and damping ratio of the decaying poles of an order."""
        n = order + 1
        total = np.zeros((n, n))
        for r, s, t in zip(self.own[:, :n, :n], self.across[:, :n, :n], self.power[:, :n, :n], strict=True):
            total += t - s.T @ np.linalg.solve(r + 1e-10 * np.trace(r) / n * np.eye(n), s)
        inner = np.linalg.lstsq(total[:-1, :-1], -total[:-1, -1], rcond=1e-12)[0]
        roots = np.roots(np.append(inner, 1.0)[::-1])
        roots = roots[np.abs(roots) > 0]
        s = -np.log(roots) / self.step
        poles = s.real + 1j * (s.imag + self.omega[0])
        out = []
        for p in poles:
            inside = self.omega[0] < p.imag < self.omega[-1]
            if p.real < 0 and inside and -p.real < 0.3 * abs(p):
                out.append((float(abs(p) / 2 / np.pi), float(-p.real / abs(p))))
        return sorted(out)


def stable_poles(diagram: Stabilisation, modes: int | None = None) -> NDArray[np.float64]:
    """(n, 2) frequency and damping ratio of the poles that repeat, the medians of their columns of the diagram.

    A column in which most orders have two poles or more holds as many modes: close ones, in order of frequency, if they
    are as far apart as modes can be told from one that moved between records.
    """
    pick = np.flatnonzero(diagram.stable)
    if not pick.size:
        return np.zeros((0, 2))
    order = pick[np.argsort(diagram.frequency[pick])]
    f = diagram.frequency[order]
    groups = np.split(order, np.flatnonzero(np.diff(f) > 1.5 * FREQUENCY_STAYS * f[:-1]) + 1)
    half = 0.25 * np.unique(diagram.order).size
    groups = [g for g in groups if g.size >= half] or [max(groups, key=len)]
    columns = [c for g in groups for c in _columns(diagram, g, half)]
    if modes is not None:
        columns = sorted(columns, key=len)[-modes:]
    out = [(np.median(diagram.frequency[c]), np.median(diagram.damping_ratio[c])) for c in columns]
    return np.array(sorted(out))


def _columns(diagram: Stabilisation, group: NDArray, least: float) -> list[NDArray]:
    """A group (n,) of poles in ascending frequency, apart by the number of poles that most of its orders have."""
    held = [group[diagram.order[group] == n] for n in np.unique(diagram.order[group])]
    sizes = np.array([h.size for h in held])
    count = int(np.sort(sizes)[(sizes.size - 1) // 2])
    alike = [h for h in held if h.size == count]
    if count < 2 or len(alike) < least:
        return [group]
    columns = np.array(alike).T
    f, z = (np.median(a[columns], axis=1) for a in (diagram.frequency, diagram.damping_ratio))
    return list(columns) if (np.diff(f) > APART * (2 * z * f).mean()).all() else [group]
