"""shear-rotary: shear flexibility and rotary inertia that an Euler-Bernoulli beam leaves out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.axial_preload import bent
from labnnum.mechanisms.base import TRANSLATIONS, Mechanism, Place, Site, Term
from labnnum.mechanisms.changes import Change
from labnnum.mechanisms.geometry import element_gain, element_stiffness
from labnnum.parameters import Parameter

RATIO = 3.12
"""E / kappa G of a solid rectangular section of metal: 2 (1 + 0.3) 6/5."""


@final
@dataclass(frozen=True, eq=False)
class Thickness(Change):
    """Timoshenko's terms of slender elements whose own matrices leave them out.

    K_e = EI/L b b' + 12 EI/L^3 a a' / (1 + Phi), Phi = 12 r^2 (E / kappa G) / L^2; the mass is that of the same shapes,
    whose sections turn less than their line slopes (Przemieniecki, 1968, sections 5.6 and 11.8);
    r^2 = 2 t c / (1 + E / kappa G).
    """

    shear: NDArray[np.float64]
    """12 EI/L^3 a a' of each element, (n_e, n, n)."""

    gain: NDArray[np.float64]
    """Relative change of each element's stiffness with each parameter, (n_e, n_theta)."""

    lengths: NDArray[np.float64]
    turning: NDArray[np.float64]
    """Mass per r^2: coefficients of 1, Phi and Phi^2 over (1 + Phi)^2 of each element, (3, n_e, n, n)."""

    moving: NDArray[np.float64]
    """The same of the mass that moves across, in kg: (3, n_e, n, n)."""

    coarse: NDArray[np.float64]
    """Mass per Phi that a sheared element of two nodes lacks beside a finer mesh, (n_e, n, n): see `coarse_mass`."""

    wave: float
    """c = sqrt(EI / rho A), m^2/s."""

    def _phi(self, p: NDArray) -> tuple[NDArray, NDArray, float]:
        slope = 2 * self.wave / (1 + RATIO)  # r^2 per unit of t
        per = 12 * slope * RATIO / self.lengths**2
        return per * p[0], per, slope

    def _scale(self, change: NDArray) -> NDArray:
        return 1.0 + self.gain @ change if self.gain.shape[1] else np.ones(len(self.gain))

    @staticmethod
    def _sum(parts: NDArray, weights: NDArray) -> NDArray[np.float64]:
        """Sum over elements of the three coefficients (3, n_e, n, n) times their weights (3, n_e)."""
        return np.einsum("ae,aeij->ij", weights, parts, optimize=True)

    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """Rotary inertia, how sheared shapes carry their mass, and what shear takes from the stiffness."""
        phi, _, slope = self._phi(p)
        loss = np.tensordot(-phi / (1 + phi) * self._scale(change), self.shear, 1)
        powers = np.stack([phi**0, phi, phi**2]) / (1 + phi) ** 2
        bare = np.stack([phi**0, 0 * phi, 0 * phi])
        mass = slope * p[0] * self._sum(self.turning, powers) + self._sum(self.moving, powers - bare)
        return mass + np.tensordot(phi, self.coarse, 1), loss

    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """To the shear time."""
        phi, per, slope = self._phi(p)
        powers = np.stack([phi**0, phi, phi**2]) / (1 + phi) ** 2
        slopes = per * (np.stack([0 * phi, phi**0, 2 * phi]) / (1 + phi) ** 2 - 2 * powers / (1 + phi))
        mass = slope * self._sum(self.turning, powers + p[0] * slopes) + self._sum(self.moving, slopes)
        mass += np.tensordot(per, self.coarse, 1)
        return [(mass, np.tensordot(-per / (1 + phi) ** 2 * self._scale(change), self.shear, 1))]

    def structure_derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """The elements' stiffness follows the parameters."""
        phi, _, _ = self._phi(p)
        zero = np.zeros(self.shear.shape[1:])
        return [(zero, np.tensordot(-phi / (1 + phi) * g, self.shear, 1)) for g in self.gain.T]

    def again(self, site: Site) -> Thickness | None:
        """Of the same elements."""
        return thickness_of(site)


@final
@dataclass(frozen=True)
class ShearRotary(Mechanism):
    r"""A beam's cross-sections shear, and their turning has inertia.

    To first order in the radius of gyration r, waves of number b obey w^2 = w_EB^2 / (1 + b^2 r^2 (1 + E / kappa G)) =
    w_EB^2 / (1 + 2 t w_EB), w_EB = b^2 sqrt(EI / rho A), with the time
    t = r^2 (1 + E / kappa G) / (2 sqrt(EI / rho A)).
    Only t can be told from bending; E / kappa G is taken as that of a solid rectangular section.
    """

    id = "shear-rotary"
    domain = "modal"
    title = "shear and rotary inertia of the beam"
    equation = "w^2 = w_EB^2 / (1 + 2 t w_EB), t = r^2 (1 + E / kappa G) / (2 sqrt(EI / rho A))"
    shows = "modes fall progressively with their number"
    told_apart = "an error of E moves all modes by one factor"
    symbol = "sheared section"
    reference = "Timoshenko (1921); Huang (1961)"

    def terms(self, site: Site) -> Iterable[Term]:
        """The whole structure, where its nodes lie on one straight line and move across it."""
        made = thickness_of(site) if in_line(site) else None
        if made is None:
            return
        scale = 1.0 / float(site.omega.max())
        parameter = Parameter("shear_time", 0.0, 0.0, 2 * scale, "s")
        starts = (scale * np.array([0.002, 0.006, 0.02, 0.05, 0.15, 0.4]))[:, None]
        yield Term(self, Place("global", "structure"), (parameter,), starts, data={"change": made})


def thickness_of(site: Site) -> Thickness | None:
    """Timoshenko's terms for the elements of a straight beam; None if the matrices do not show any."""
    n = site.stiffness.shape[0]
    shears, gains, lengths, turning, moving, coarse = [], [], [], [], [], []
    density, waves = _line_density(site), []
    for a, b in site.mesh:
        found = element_stiffness(site, a, b) if a in site.nodes and b in site.nodes else None
        if found is None or density <= 0:
            continue
        arm = np.subtract(site.nodes[b], site.nodes[a])
        length = float(np.linalg.norm(arm))
        index, k, directions = found
        sideways = [a for a, x in zip(TRANSLATIONS, arm, strict=True) if abs(x) < 0.1 * length]
        across = next((i for i, d in enumerate(directions) if d in sideways and k[i, i] > 0), None)
        turn, move, lack = (bent(site, a, b, of(length)) for of in (rotary_mass, sideways_mass, coarse_mass))
        if across is None or turn is None or move is None or lack is None or not turn.any():
            continue
        whole = np.zeros((n, n))
        whole[np.ix_(index, index)] = np.outer(k[:, across], k[across]) / k[across, across]
        shears.append(whole)
        gains.append(element_gain(site, a, b))
        lengths.append(length)
        waves.append(np.sqrt(k[across, across] * length**3 / 12 / density))
        turning.append(density * turn)
        moving.append(density * move)
        coarse.append(density * lack[0])
    if not shears:
        return None
    gain = np.array(gains).reshape(len(shears), -1)
    masses = [np.moveaxis(np.array(m), 0, 1) for m in (turning, moving)]
    return Thickness(
        np.array(shears), gain, np.array(lengths), masses[0], masses[1], np.array(coarse), float(np.median(waves))
    )


def rotary_mass(length: float) -> NDArray[np.float64]:
    """Coefficients of 1, Phi and Phi^2 over (1 + Phi)^2 of the rotary inertia, (3, 4, 4), per rho A r^2.

    Over w and theta at either end; Przemieniecki (1968), section 11.8.
    """
    h = length
    parts = [
        [[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)]],
        [[0, -15 * h, 0, -15 * h], [-15 * h, 5 * h**2, 15 * h, -5 * h**2]],
        [[0, 0, 0, 0], [0, 10 * h**2, 0, 5 * h**2]],
    ]
    return np.array([_mirrored(np.array(p, float)) for p in parts]) / (30 * h)


def sideways_mass(length: float) -> NDArray[np.float64]:
    """The same of the mass that moves across, (3, 4, 4), per rho A."""
    h = length
    parts = [
        [[78, 11 * h, 27, -6.5 * h], [11 * h, 2 * h**2, 6.5 * h, -1.5 * h**2]],
        [[147, 19.25 * h, 63, -15.75 * h], [19.25 * h, 3.5 * h**2, 15.75 * h, -3.5 * h**2]],
        [[70, 8.75 * h, 35, -8.75 * h], [8.75 * h, 1.75 * h**2, 8.75 * h, -1.75 * h**2]],
    ]
    return np.array([_mirrored(np.array(p, float)) for p in parts]) * h / 210


def coarse_mass(length: float) -> NDArray[np.float64]:
    """What a finer mesh of sheared elements carries more than one element of that length, (1, 4, 4), per rho A Phi.

    On waves of number b the element's squared frequencies lie (Phi / 144) (b h)^4 above those of a beam without a mesh,
    beyond what an element without shear has wrong; so much its curvature is loaded. Ours: the factor was read off the
    dispersion of an endless row of elements, where it holds to the lowest order in b h and Phi.
    """
    turned = np.array([0.0, -1.0, 0.0, 1.0])
    return np.array([length**3 / 144 * np.outer(turned, turned)])


def _mirrored(upper: NDArray) -> NDArray[np.float64]:
    """The rows of the first end (2, 4), and those of the second, which sees the element from the other side."""
    flip = np.diag([1.0, -1.0])
    own, across = upper[:, :2], upper[:, 2:]
    return np.block([[own, across], [across.T, flip @ own @ flip]])


def _line_density(site: Site) -> float:
    """Mass per length, in kg/m: what a node carries in a translation over the length that it stands for.

    Of elements whose mass couples their ends it is seen without what stands on the nodes, 9/70 of the element's.
    """
    reach: dict[str, float] = {}
    coupled: list[float] = []
    for a, b in site.mesh:
        if a in site.nodes and b in site.nodes:
            length = float(np.linalg.norm(np.subtract(site.nodes[b], site.nodes[a])))
            reach[a], reach[b] = reach.get(a, 0.0) + length / 2, reach.get(b, 0.0) + length / 2
            coupled += _coupled(site, a, b, length)
    if coupled:
        return float(np.median(coupled))
    held = {n for pair in site.mesh if set(pair) & set(site.supports) for n in pair}
    out = []
    for axis in TRANSLATIONS:
        rows = {n: site.dofs[f"{n}:{axis}"] for n in reach if f"{n}:{axis}" in site.dofs}
        together = sum(rows.values(), np.zeros(site.mass.shape[0]))
        out += [float(v @ site.mass @ together) / reach[n] for n, v in rows.items() if n not in held]
    return float(np.median(out)) if out else 0.0


def _coupled(site: Site, a: str, b: str, length: float) -> list[float]:
    """Mass per length of an element by what its consistent mass couples its ends with, across it."""
    arm = np.subtract(site.nodes[b], site.nodes[a])
    out = []
    for axis, along in zip(TRANSLATIONS, arm, strict=True):
        rows = [site.dofs.get(f"{n}:{axis}") for n in (a, b)]
        if rows[0] is None or rows[1] is None or abs(along) > 0.1 * length:
            continue
        tied = float(rows[0] @ site.mass @ rows[1])
        if tied > 1e-6 * float(rows[0] @ site.mass @ rows[0]):
            out.append(tied / length * 70 / 9)
    return out


def in_line(site: Site) -> bool:
    """Whether the nodes lie on a straight line and the degrees of freedom bend it."""
    if len(site.nodes) < 3:
        return False
    xyz = np.array(list(site.nodes.values()), float)
    xyz = xyz - xyz.mean(axis=0)
    _, size, direction = np.linalg.svd(xyz)
    if size[0] == 0 or size[1] > 1e-6 * size[0]:
        return False
    axes = {d.split(":")[1] for d in site.dofs}
    across = [a for i, a in enumerate("xyz") if abs(direction[0][i]) < 0.5]
    return any(a in axes for a in across) and any(a in axes for a in ("rx", "ry", "rz"))
