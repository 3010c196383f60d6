"""General local laws: a smooth dynamic stiffness without a name, which says where and how well, not what.

Linear in its coefficients over a basis of springs, dashpots, masses, losses and relaxations, it comes close to any
passive local physics that varies smoothly in the band. No named mechanism can explain much less than it does at the
right place; where the best named one stays well behind, what is there is not in the catalogue.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS, Group, Mechanism, Place, Site, Term
from labnnum.mechanisms.laws import Law, Local, Spring
from labnnum.mechanisms.local_dashpot import relative
from labnnum.parameters import Parameter

RELAXATIONS = (1.0, 0.15, 6.0)
"""Corner frequencies over the middle of the band; together they come close to any loss that creeps."""

N_BASIS = 6 + len(RELAXATIONS)


@final
@dataclass(frozen=True)
class GeneralLaw(Law):
    """g = sum c_b g_b(s / w0): 1, s, s^2, i, s^3, s^4 and relaxations, w0 the middle of the band in rad/s."""

    middle: float = 1.0
    inertial: bool = False
    names: tuple[str, ...] = tuple(f"c{i}" for i in range(N_BASIS))
    units: tuple[str, ...] = ("N/m",) * N_BASIS

    def basis(self, s: NDArray) -> NDArray:
        """Shape (N_BASIS, n_f)."""
        x = s / self.middle
        smooth = [np.ones_like(x), x, x**2, 1j + 0 * x, x**3 / 3, x**4 / 9]
        return np.stack([*smooth, *(x / (corner + x) for corner in RELAXATIONS)])

    def value(self, s: NDArray, p: NDArray) -> NDArray:
        """g(s)."""
        return np.asarray(p) @ self.basis(s)

    def derivative(self, s: NDArray, p: NDArray) -> NDArray:
        """The basis itself."""
        return self.basis(s)

    def local(self, p: NDArray) -> Local:
        """A general law is for location; it has no matrices."""
        raise TypeError("a general local law says where, and is not a model to simulate")


@final
@dataclass(frozen=True)
class LocalLaw(Mechanism):
    """Any smooth dynamic stiffness at one motion."""

    id = "local-law"
    title = "something without a name"
    equation = "f = Z(s) u"
    shows = "whatever it does"
    told_apart = "named mechanisms need fewer parameters"
    symbol = "question mark"
    reference = "Ibrahim (1977); D'Ambrogio and Fregolent (1990)"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each translation of each node (absolute and relative to the base), each relative motion along elements."""
        for node in site.free_nodes:
            for axis in TRANSLATIONS:
                column = site.rows(node, (axis,))
                if column.size:
                    yield from self._term(site, Place("node", node), column, axis, site.rigid is not None)
        for a, b in site.elements:
            for axis in TRANSLATIONS + ROTATIONS:
                column = relative(site, a, b, axis)
                if column is not None:
                    yield from self._term(site, Place("element", a, b), column, axis, False)

    def _term(self, site: Site, place: Place, column: NDArray, axis: str, both: bool) -> Iterable[Term]:
        for inertial in (False, True) if both else (False,):
            law = GeneralLaw(float(np.sqrt(site.omega.min() * site.omega.max())), inertial)
            scale = site.scale(law, column, np.zeros(N_BASIS), 0)
            if not np.isfinite(scale):
                continue
            parameters = tuple(Parameter(n, 0.0, -1e3 * scale, 1e3 * scale, "N/m") for n in law.names)
            sizes = scale * np.array([0.01, 0.1])
            starts = np.array([x * sign * row for row in np.eye(N_BASIS)[:3] for x in sizes for sign in (1, -1)])
            starts = np.vstack([starts, [x * np.eye(N_BASIS)[3] for x in sizes]])
            yield Term(
                self, place, parameters, starts, (Group(law, column, 0),), axis + (" absolute" if inertial else "")
            )


POLES = 14
"""Pairs of poles by which a free law follows the band,"""
BEYOND = (0.6, 1.3)
"""from below its lowest mode to above its highest."""


@final
@dataclass(frozen=True)
class FreeStiffness(Law):
    """A general law and wide resonances side by side over the band, in rad/s: any stiffness that varies no faster than
    their distance, a delay's too.
    """

    low: float = 1.0
    high: float = 2.0
    inertial: bool = False
    names: tuple[str, ...] = tuple(f"c{i}" for i in range(N_BASIS + 2 * POLES))
    units: tuple[str, ...] = ("N/m",) * (N_BASIS + 2 * POLES)

    def basis(self, s: NDArray) -> NDArray:
        """Shape (N_BASIS + 2 POLES, n_f)."""
        at = np.linspace(BEYOND[0] * self.low, BEYOND[1] * self.high, POLES)[:, None]
        wide = at[1] - at[0]
        near, mirror = wide / (s + wide - 1j * at), wide / (s + wide + 1j * at)
        smooth = GeneralLaw(float(np.sqrt(self.low * self.high))).basis(s)
        return np.concatenate([smooth, near + mirror, 1j * (near - mirror)])

    def value(self, s: NDArray, p: NDArray) -> NDArray:
        """g(s)."""
        return np.asarray(p) @ self.basis(s)

    def derivative(self, s: NDArray, p: NDArray) -> NDArray:
        """The basis itself."""
        return self.basis(s)

    def local(self, p: NDArray) -> Local:
        """A free law is for location; it has no matrices."""
        raise TypeError("a free law says where, and is not a model to simulate")


@final
@dataclass(frozen=True)
class FreeLaw(Mechanism):
    """Any dynamic stiffness at one motion, however it varies: what tells the place where no smooth law comes near."""

    id = "free-law"
    title = "something without a name that varies within the band"
    equation = "f = Z(s) u"
    shows = "whatever it does"
    told_apart = "named mechanisms need far fewer parameters"
    symbol = "question mark"
    reference = "Ibrahim (1977); D'Ambrogio and Fregolent (1990)"

    def terms(self, site: Site) -> Iterable[Term]:
        """The motions of a `LocalLaw`."""
        low, high = float(site.omega.min()), float(site.omega.max())
        n = N_BASIS + 2 * POLES
        for t in LocalLaw().terms(site):
            law = FreeStiffness(low, high, t.groups[0].law.inertial)
            scale = t.parameters[0].upper / 1e3
            parameters = tuple(Parameter(name, 0.0, -1e4 * scale, 1e4 * scale, "N/m") for name in law.names)
            starts = np.zeros((1, n))
            yield Term(self, t.place, parameters, starts, (Group(law, t.groups[0].columns, 0),), t.variant)


@final
@dataclass(frozen=True)
class PairMatrix(Law):
    """Any 2 x 2 dynamic stiffness of the form K + C x + M x^2, x = s / w0, symmetric or not."""

    middle: float = 1.0
    inertial: bool = False
    names: tuple[str, ...] = tuple(f"{kind}{i}{j}" for kind in "kcm" for i in (1, 2) for j in (1, 2))
    units: tuple[str, ...] = ("N/m",) * 12

    @property
    def joint(self) -> bool:
        """It couples its two columns."""
        return True

    def value(self, s: NDArray, p: NDArray) -> NDArray:
        """Shape (2, 2, n_f)."""
        return np.tensordot(np.asarray(p), self.derivative(s, p), 1)

    def derivative(self, s: NDArray, p: NDArray) -> NDArray:
        """Shape (12, 2, 2, n_f)."""
        x = s / self.middle
        out = np.zeros((3, 2, 2, 2, 2, s.size), complex)
        for kind, power in enumerate((np.ones_like(x), x, x**2)):
            for i in range(2):
                for j in range(2):
                    out[kind, i, j, i, j] = power
        return out.reshape(12, 2, 2, s.size)

    def local(self, p: NDArray) -> Local:
        """A general law is for location; it has no matrices."""
        raise TypeError("a general pair law says where, and is not a model to simulate")


@final
@dataclass(frozen=True)
class PairLaw(Mechanism):
    """Any second-order coupling of two neighbouring nodes: levers, gyroscopes, whatever pulls on both."""

    id = "pair-law"
    title = "something without a name between two nodes"
    equation = "f = (K + C s + M s^2) (u_a, u_b)"
    shows = "whatever it does"
    told_apart = "a law of the stretch alone needs one column"
    symbol = "question mark"
    reference = "D'Ambrogio and Fregolent (1990)"

    def terms(self, site: Site) -> Iterable[Term]:
        """The motions of both nodes of each element, axis by axis."""
        for a, b in site.elements:
            for axis in TRANSLATIONS + ROTATIONS:
                columns = np.hstack([site.rows(a, (axis,)), site.rows(b, (axis,))])
                if columns.shape[1] != 2:
                    continue
                law = PairMatrix(float(np.sqrt(site.omega.min() * site.omega.max())))
                scale = site.scale(Spring(), columns, np.zeros(1), 0)
                if not np.isfinite(scale):
                    continue
                parameters = tuple(Parameter(n, 0.0, -1e3 * scale, 1e3 * scale, "N/m") for n in law.names)
                single = np.eye(12)
                lever = single[[0, 1, 2, 3]].sum(axis=0)
                skew = single[5] - single[6]
                rows = [lever, skew, -skew, *single[:4], *single[8:]]
                starts = np.array([x * scale * row for row in rows for x in (0.02, 0.3)])
                yield Term(self, Place("element", a, b), parameters, starts, (Group(law, columns, 0),), axis)
