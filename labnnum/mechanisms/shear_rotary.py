"""shear-rotary: shear flexibility and rotary inertia that an Euler-Bernoulli beam leaves out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.axial_preload import geometric_stiffness
from labnnum.mechanisms.base import TRANSLATIONS, Change, Mechanism, Place, Site, Term
from labnnum.mechanisms.geometry import element_gain, element_stiffness
from labnnum.parameters import Parameter

RATIO = 3.12
"""E / kappa G of a solid rectangular section of metal: 2 (1 + 0.3) 6/5."""


@final
@dataclass(frozen=True, eq=False)
class Thickness(Change):
    """Timoshenko's terms of slender elements whose own matrices leave them out.

    K_e = EI/L b b' + 12 EI/L^3 a a' / (1 + Phi), Phi = 12 r^2 (E / kappa G) / L^2, and M += rho A r^2 times the
    geometric stiffness of unit tension (Przemieniecki, 1968, sections 5.6 and 11.4); r^2 = 2 t c / (1 + E / kappa G).
    """

    shear: NDArray[np.float64]
    """12 EI/L^3 a a' of each element, (n_e, n, n)."""

    gain: NDArray[np.float64]
    """Relative change of each element's stiffness with each parameter, (n_e, n_theta)."""

    lengths: NDArray[np.float64]
    turning: NDArray[np.float64]
    """rho A times the geometric stiffness of all elements, (n, n)."""

    wave: float
    """c = sqrt(EI / rho A), m^2/s."""

    def _phi(self, p: NDArray) -> tuple[NDArray, NDArray, float]:
        slope = 2 * self.wave / (1 + RATIO)  # r^2 per unit of t
        per = 12 * slope * RATIO / self.lengths**2
        return per * p[0], per, slope

    def _scale(self, change: NDArray) -> NDArray:
        return 1.0 + self.gain @ change if self.gain.shape[1] else np.ones(len(self.gain))

    def matrices(self, p: NDArray, change: NDArray) -> tuple[NDArray, NDArray]:
        """Rotary inertia, and what shear takes from the stiffness."""
        phi, _, slope = self._phi(p)
        loss = np.tensordot(-phi / (1 + phi) * self._scale(change), self.shear, 1)
        return slope * p[0] * self.turning, loss

    def derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """To the shear time."""
        phi, per, slope = self._phi(p)
        return [(slope * self.turning, np.tensordot(-per / (1 + phi) ** 2 * self._scale(change), self.shear, 1))]

    def structure_derivatives(self, p: NDArray, change: NDArray) -> list[tuple[NDArray, NDArray]]:
        """The elements' stiffness follows the parameters."""
        phi, _, _ = self._phi(p)
        zero = np.zeros_like(self.turning)
        return [(zero, np.tensordot(-phi / (1 + phi) * g, self.shear, 1)) for g in self.gain.T]


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
    shears, gains, lengths, rigidities = [], [], [], []
    turning = np.zeros((n, n))
    for a, b in site.mesh:
        found = element_stiffness(site, a, b)
        bent = geometric_stiffness(site, a, b)
        if found is None or bent is None or not bent.any():
            continue
        arm = np.subtract(site.nodes[b], site.nodes[a])
        length = float(np.linalg.norm(arm))
        index, k, directions = found
        sideways = [a for a, x in zip(TRANSLATIONS, arm, strict=True) if abs(x) < 0.1 * length]
        across = next((i for i, d in enumerate(directions) if d in sideways and k[i, i] > 0), None)
        if across is None:
            continue
        whole = np.zeros((n, n))
        whole[np.ix_(index, index)] = np.outer(k[:, across], k[across]) / k[across, across]
        shears.append(whole)
        gains.append(element_gain(site, a, b))
        lengths.append(length)
        rigidities.append(k[across, across] * length**3 / 12)
        turning += bent
    density = _line_density(site)
    if not shears or density <= 0:
        return None
    wave = float(np.sqrt(np.median(rigidities) / density))
    gain = np.array(gains).reshape(len(shears), -1)
    return Thickness(np.array(shears), gain, np.array(lengths), density * turning, wave)


def _line_density(site: Site) -> float:
    """Mass per length, in kg/m: what a node carries in a translation over the length that it stands for."""
    reach: dict[str, float] = {}
    for a, b in site.mesh:
        if a in site.nodes and b in site.nodes:
            half = float(np.linalg.norm(np.subtract(site.nodes[b], site.nodes[a]))) / 2
            reach[a], reach[b] = reach.get(a, 0.0) + half, reach.get(b, 0.0) + half
    held = {n for pair in site.mesh if set(pair) & set(site.supports) for n in pair}
    out = []
    for axis in TRANSLATIONS:
        rows = {n: site.dofs[f"{n}:{axis}"] for n in reach if f"{n}:{axis}" in site.dofs}
        together = sum(rows.values(), np.zeros(site.mass.shape[0]))
        out += [float(v @ site.mass @ together) / reach[n] for n, v in rows.items() if n not in held]
    return float(np.median(out)) if out else 0.0


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
