"""shear-rotary: shear flexibility and rotary inertia that an Euler-Bernoulli beam leaves out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import Mechanism, Place, Site, Term
from labnnum.parameters import Parameter


@final
@dataclass(frozen=True)
class ShearRotary(Mechanism):
    r"""Each elastic mode of a beam falls in proportion to its own frequency.

    For waves of number b on a beam, w_EB = b^2 sqrt(EI / rho A), and to first order in the radius of gyration r
    w^2 = w_EB^2 / (1 + b^2 r^2 (1 + E / kappa G)) = w_EB^2 / (1 + 2 t w_EB), with the time
    t = r^2 (1 + E / kappa G) / (2 sqrt(EI / rho A)).
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
        if not in_line(site):
            return
        scale = 1.0 / float(site.omega.max())
        parameter = Parameter("shear_time", 0.0, 0.0, 2 * scale, "s")
        starts = (scale * np.array([0.002, 0.006, 0.02, 0.05, 0.15, 0.4]))[:, None]
        yield Term(self, Place("global", "structure"), (parameter,), starts, data={"shear": True})


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
