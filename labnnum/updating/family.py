"""A structure's matrices for many parameter sets at once: polynomials in the parameters, found by probing.

Most structures depend on their parameters through few smooth terms (a spring is linear, an element's stiffness goes
with 1/L^3). The terms are found as Chebyshev polynomials that reproduce `Structure.matrices` to rounding; where a
structure is not of that kind, `MatrixFamily.of` gives None and nothing is approximated.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from labnnum.parameters import bounds
from labnnum.structures.base import Structure

_REACH = 0.1
"""Share of the range by which the polynomials reach beyond the bounds."""

_HIGHEST = 16
_MOST = 512
_TOLERANCE = 2e-12
_KINDS = 4


@dataclass(frozen=True, eq=False)
class MatrixFamily:
    """Entries of M, C, K and D as polynomials of the parameters.

    Parameters
    ----------
    size : int
        Number of coordinates.
    centre, half : ndarray, shape (n_parameters,)
        Of the range that was probed.
    powers : ndarray of int, shape (n_terms, n_parameters)
        Chebyshev degrees of each term.
    places : tuple of ndarray, each (n_entries, 2)
        Rows and columns (lower triangle) of the entries of M, C, K and D that are not zero.
    coefficients : tuple of ndarray, each (n_terms, n_entries)
    """

    size: int
    centre: NDArray[np.float64]
    half: NDArray[np.float64]
    powers: NDArray[np.int64]
    places: tuple[NDArray[np.int64], ...]
    coefficients: tuple[NDArray[np.float64], ...]

    @classmethod
    def of(cls, structure: Structure, seed: int = 0) -> MatrixFamily | None:
        """The family of a structure; None where polynomials do not reproduce its matrices."""
        low, high = bounds(structure.parameters)
        centre, half = (low + high) / 2, (high - low) / 2 * (1 + 2 * _REACH)
        probe = _Probe(structure, centre, half)
        degrees = probe.degrees(np.random.default_rng(seed))
        if degrees is None:
            return None
        made = (
            _on_grid(cls, probe, degrees) if np.prod(degrees + 1.0) <= _MOST else _by_pairs(cls, probe, degrees, seed)
        )
        return made if made is not None and probe.reproduced(made, np.random.default_rng(seed + 1)) else None

    def terms(self, theta: NDArray) -> NDArray[np.float64]:
        """Values of the polynomials, shape (n, n_terms)."""
        return self._product(self._values(theta))

    def term_slopes(self, theta: NDArray) -> NDArray[np.float64]:
        """Their derivatives to each parameter, shape (n_parameters, n, n_terms)."""
        values, t = self._values(theta), (theta - self.centre) / self.half
        out = []
        for j in range(t.shape[1]):
            rows = list(values)
            rows[j] = _chebyshev_slopes(t[:, j], values[j].shape[1]) / self.half[j]
            out.append(self._product(rows))
        return np.array(out).reshape(t.shape[1], len(t), len(self.powers))

    def entries(self, theta: NDArray) -> tuple[NDArray[np.float64], ...]:
        """Entries of M, C, K and D, each (n, n_entries)."""
        terms = self.terms(theta)
        return tuple(terms @ c for c in self.coefficients)

    def dense(self, theta: NDArray) -> tuple[NDArray[np.float64], ...]:
        """M, C, K and D, each (n, size, size)."""
        return tuple(self.filled(kind, e) for kind, e in enumerate(self.entries(theta)))

    def filled(self, kind: int, entries: NDArray) -> NDArray[np.float64]:
        """Full symmetric matrices of entries (..., n_entries) of kind 0 (M) to 3 (D)."""
        out = np.zeros((*entries.shape[:-1], self.size, self.size))
        i, j = self.places[kind].T
        out[..., i, j] = entries
        out[..., j, i] = entries
        return out

    def varies(self) -> tuple[NDArray[np.bool_], ...]:
        """Which entries depend on any parameter."""
        constant = (self.powers == 0).all(axis=1)
        return tuple(np.any(c[~constant] != 0, axis=0) for c in self.coefficients)

    def _values(self, theta: NDArray) -> list[NDArray]:
        t = (np.asarray(theta, float) - self.centre) / self.half
        return [_chebyshev(t[:, j], int(self.powers[:, j].max(initial=0))) for j in range(t.shape[1])]

    def _product(self, values: list[NDArray]) -> NDArray[np.float64]:
        n = len(values[0]) if values else 1
        out = np.ones((n, len(self.powers)))
        for j, rows in enumerate(values):
            if self.powers[:, j].any() or rows.shape[1] == 1:
                out *= rows[:, self.powers[:, j]]
        return out


def _chebyshev(t: NDArray, degree: int) -> NDArray[np.float64]:
    """T_0 to T_degree, shape (t.size, degree + 1), by their recurrence."""
    out = np.ones((t.size, degree + 1))
    if degree:
        out[:, 1] = t
    for d in range(2, degree + 1):
        out[:, d] = 2 * t * out[:, d - 1] - out[:, d - 2]
    return out


def _chebyshev_slopes(t: NDArray, n: int) -> NDArray[np.float64]:
    out = np.zeros((t.size, n))
    for degree in range(1, n):
        out[:, degree] = chebyshev.chebval(t, chebyshev.chebder(np.eye(degree + 1)[degree]))
    return out


class _Probe:
    """Lower triangles of a structure's matrices at points of the cube [-1, 1]^p."""

    def __init__(self, structure: Structure, centre: NDArray, half: NDArray) -> None:
        self.structure, self.centre, self.half = structure, centre, half
        self.symmetric = True
        first = structure.matrices(centre)
        self.size = first.M.shape[0]
        self.rows, self.columns = np.tril_indices(self.size)
        flat = self.at(np.zeros(centre.size))
        parts = flat.reshape(_KINDS, -1)
        self.scale = np.repeat(np.maximum(np.abs(parts).max(axis=1), 1e-300), parts.shape[1])

    def at(self, t: NDArray) -> NDArray[np.float64]:
        m = self.structure.matrices(self.centre + t * self.half)
        for a in (m.M, m.C, m.K, m.D):
            self.symmetric &= bool(np.abs(a - a.T).max(initial=0.0) <= 1e-12 * np.abs(a).max(initial=0.0))
        return np.concatenate([a[self.rows, self.columns] for a in (m.M, m.C, m.K, m.D)])

    def degrees(self, rng: np.random.Generator) -> NDArray[np.int64] | None:
        """Chebyshev degree that each parameter needs alone, about a random point; None above `_HIGHEST`."""
        out = []
        for j in range(self.centre.size):
            base = rng.uniform(-0.7, 0.7, self.centre.size)
            found = self._degree(j, base)
            out.append(found)
        return None if None in out or not self.symmetric else np.array(out, int)

    def _degree(self, j: int, base: NDArray) -> int | None:
        nodes = chebyshev.chebpts1(_HIGHEST + 2)
        values = []
        for node in nodes:
            t = base.copy()
            t[j] = node
            values.append(self.at(t) / self.scale)
        c = np.linalg.solve(chebyshev.chebvander(nodes, _HIGHEST + 1), np.array(values))
        size = np.abs(c).max(axis=1)
        needed = int(np.flatnonzero(size > _TOLERANCE / 4).max(initial=0))
        return needed if needed <= _HIGHEST else None

    def reproduced(self, family: MatrixFamily, rng: np.random.Generator, points: int = 6) -> bool:
        """Whether the polynomials give the matrices to rounding at random points."""
        for _ in range(points):
            t = rng.uniform(-1, 1, self.centre.size)
            dense = family.dense((self.centre + t * self.half)[None])
            flat = np.concatenate([a[0][self.rows, self.columns] for a in dense])
            if np.abs((flat - self.at(t)) / self.scale).max() > 50 * _TOLERANCE:
                return False
        return True


def _on_grid(cls: type[MatrixFamily], probe: _Probe, degrees: NDArray) -> MatrixFamily | None:
    """Interpolation on the tensor grid of Chebyshev points."""
    nodes = [chebyshev.chebpts1(d + 1) for d in degrees]
    grid = np.array([probe.at(np.array(t)) for t in product(*nodes)])
    c = grid.reshape(*(d + 1 for d in degrees), -1)
    for j, points in enumerate(nodes):
        inverse = np.linalg.inv(chebyshev.chebvander(points, points.size - 1))
        c = np.moveaxis(np.tensordot(inverse, c, axes=(1, j)), 0, j)
    powers = np.array(list(product(*(range(d + 1) for d in degrees))), np.int64).reshape(-1, degrees.size)
    return _pruned(cls, probe, powers, c.reshape(len(powers), -1))


def _by_pairs(cls: type[MatrixFamily], probe: _Probe, degrees: NDArray, seed: int) -> MatrixFamily | None:
    """Many parameters: powers of each alone and products of two, by least squares at random points."""
    n = degrees.size
    unit = np.eye(n, dtype=np.int64)
    powers = [np.zeros(n, np.int64), *(d * unit[j] for j in range(n) for d in range(1, degrees[j] + 1))]
    powers += [unit[i] + unit[j] for i, j in combinations(np.flatnonzero(degrees), 2)]
    t = np.random.default_rng(seed).uniform(-1, 1, (len(powers) + len(powers) // 2 + 4, n))
    rows = np.array([[np.prod(np.cos(k * np.arccos(x))) for k in powers] for x in t])
    c = np.linalg.lstsq(rows, np.array([probe.at(x) for x in t]), rcond=None)[0]
    return _pruned(cls, probe, np.array(powers), c)


def _pruned(cls: type[MatrixFamily], probe: _Probe, powers: NDArray, c: NDArray) -> MatrixFamily | None:
    """The family without the terms and entries that vanish; None if a matrix was not symmetric."""
    if not probe.symmetric:
        return None
    c = np.where(np.abs(c) > 1e-14 * probe.scale, c, 0.0)
    alive = np.asarray(c.any(axis=1))
    alive[:1] = True
    parts = np.split(c[alive], _KINDS, axis=1)
    kept = [p.any(axis=0) for p in parts]
    places = tuple(np.stack([probe.rows[k], probe.columns[k]], axis=1) for k in kept)
    coefficients = tuple(np.ascontiguousarray(p[:, k]) for p, k in zip(parts, kept, strict=True))
    return cls(probe.size, probe.centre, probe.half, powers[alive], places, coefficients)
