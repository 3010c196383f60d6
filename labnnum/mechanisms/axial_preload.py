"""axial-preload: tension or compression along the structure (geometric stiffness)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import SIZES, TRANSLATIONS, Mechanism, Place, Site, Term, amount
from labnnum.mechanisms.changes import Change
from labnnum.mechanisms.geometry import AXES, dof_rows
from labnnum.mechanisms.laws import Spring


@final
@dataclass(frozen=True, eq=False)
class Tension(Change):
    """K += T K_G."""

    geometric: NDArray[np.float64]

    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """No mass, and the tension's stiffness."""
        return np.zeros_like(self.geometric), p[0] * self.geometric

    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """To the tension."""
        return [(np.zeros_like(self.geometric), self.geometric)]

    def again(self, site: Site) -> Tension:
        """Of the same line of elements."""
        return Tension(line_stiffness(site))


@final
@dataclass(frozen=True)
class AxialPreload(Mechanism):
    """K += T K_G, K_G the consistent geometric stiffness of the elements in line."""

    id = "axial-preload"
    title = "tension or compression along the structure"
    equation = "f = T K_G u"
    shows = "low modes shift most, their shapes kept"
    told_apart = "support-compliance lowers only, and bends the shapes at the clamp"
    symbol = "arrows along the axis"
    reference = "Przemieniecki (1968), section 15.2"

    def terms(self, site: Site) -> Iterable[Term]:
        """The whole line of elements at once, where nodes have coordinates."""
        total = line_stiffness(site)
        value, vector = np.linalg.eigh(total)
        keep = value > 1e-9 * max(value.max(initial=0.0), 1e-300)
        if not keep.any() or value.max() <= 0:
            return
        scale = site.scale(Spring(("tension",), ("N",)), vector[:, keep] * np.sqrt(value[keep]), np.zeros(1), 0)
        if not np.isfinite(scale):
            return
        parameter = amount("tension", "N", scale, lower=-1.5 * scale)  # it buckles about there
        starts = scale * np.concatenate([SIZES, [3.0], -SIZES[:-1], [-0.5, -0.7, -0.85]])[:, None]
        yield Term(self, Place("global", "structure"), (parameter,), starts, data={"change": Tension(total)})

    def sense(self, term: Term, p: np.ndarray) -> str | None:
        """Either "tension" or "compression"."""
        return "tension" if p[0] >= 0 else "compression"


def line_stiffness(site: Site) -> np.ndarray:
    """Geometric stiffness (n, n) of all elements under unit tension."""
    total = np.zeros_like(site.stiffness)
    for a, b in site.mesh:
        part = geometric_stiffness(site, a, b)
        if part is not None:
            total += part
    return total


def geometric_stiffness(site: Site, a: str, b: str) -> np.ndarray | None:
    """Geometric stiffness (n, n) of a straight beam element under unit tension; a string without rotations."""
    if a not in site.nodes or b not in site.nodes:
        return None
    h = float(np.linalg.norm(np.subtract(site.nodes[b], site.nodes[a])))
    if h == 0:
        return None
    beam = np.array(
        [
            [36, 3 * h, -36, 3 * h],
            [3 * h, 4 * h**2, -3 * h, -(h**2)],
            [-36, -3 * h, 36, -3 * h],
            [3 * h, -(h**2), -3 * h, 4 * h**2],
        ]
    ) / (30 * h)
    string = np.zeros((4, 4))
    string[np.ix_([0, 2], [0, 2])] = np.array([[1, -1], [-1, 1]]) / h
    found = bent(site, a, b, beam[None], string[None])
    return None if found is None else found[0]


def bent(site: Site, a: str, b: str, beam: np.ndarray, string: np.ndarray | None = None) -> np.ndarray | None:
    """Matrices (k, 4, 4) over deflection and slope at either end, in both planes that bend: (k, n, n).

    Where the nodes have no rotation `string` stands for `beam`, or nothing. None where a node's place is not known.
    """
    if a not in site.nodes or b not in site.nodes:
        return None
    arm = np.array(site.nodes[b], float) - np.array(site.nodes[a], float)
    length = float(np.linalg.norm(arm))
    if length == 0:
        return None
    axis = arm / length
    ra, rb = dof_rows(site, a), dof_rows(site, b)
    out = np.zeros((len(beam), *site.stiffness.shape))
    for i, along in enumerate(TRANSLATIONS):
        across = np.eye(3)[i] - axis[i] * axis
        if np.linalg.norm(across) < 0.99:
            continue
        turn = np.cross(np.eye(3)[i], axis)  # rotation w/ slope du_i/ds = -turn . theta
        spin = AXES[3 + int(np.argmax(np.abs(turn)))]
        sign = -float(turn[int(np.argmax(np.abs(turn)))])
        entries = [(ra.get(along), 0, 1.0), (ra.get(spin), 1, sign), (rb.get(along), 2, 1.0), (rb.get(spin), 3, sign)]
        has_turn = ra.get(spin) is not None or rb.get(spin) is not None
        k = beam if has_turn else string
        if k is None:
            continue
        for row, i1, s1 in entries:
            for column, i2, s2 in entries:
                if row is not None and column is not None:
                    out[:, row, column] += s1 * s2 * k[:, i1, i2]
    return out
