"""support-compliance: a clamp that gives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import (
    ROTATIONS,
    SIZES,
    TRANSLATIONS,
    Group,
    Held,
    Mechanism,
    Place,
    Site,
    Term,
    scalar_term,
)
from labnnum.mechanisms.changes import Freed
from labnnum.mechanisms.geometry import dof_rows
from labnnum.mechanisms.laws import Release, Spring
from labnnum.parameters import Parameter

FARTHEST = 300.0
"""Bound of a compliance, in units of the one that changes some mode's squared frequency by itself at first order."""
GROSS = np.array([0.01, 0.05, 0.2, 1.0, 4.0, 15.0])
"""Sizes of a search for two compliances at once; clamps of beams may give far more than first order tells."""


@final
@dataclass(frozen=True)
class SupportCompliance(Mechanism):
    """The clamped motion q gets a compliance c: Z -= Z_fs c / (1 + c Z_ss) Z_sf."""

    id = "support-compliance"
    title = "clamp that gives"
    equation = "q = c f_support"
    shows = "all modes fall, the low ones most"
    told_apart = "an error of E or of the length moves all modes by one factor"
    symbol = "clamp with spring"
    reference = "Ewins (2000), section 5.7; Rixen (2004)"

    def terms(self, site: Site) -> Iterable[Term]:
        """Each held axis of each support, pairs that load each other, or a changed stiffness where it is elastic."""
        for support in site.supports:
            place = Place("support", support)
            for axis in dof_rows(site, support):
                unit = "N*m/rad" if axis in ROTATIONS else "N/m"
                law = Spring(("stiffness",), (unit,))
                term = scalar_term(self, site, place, law, site.rows(support, (axis,)), positive=False, variant=axis)
                if term is not None:
                    yield term
            if support in site.held:
                yield from self._released(site, place, site.held[support])

    def _released(self, site: Site, place: Place, held: Held) -> Iterable[Term]:
        scales = [_scale(site, held, i) for i in range(len(held.axes))]
        moving = [i for i, scale in enumerate(scales) if np.isfinite(scale)]
        for i in moving:
            yield _term(self, site, place, held, (i,), scales, np.append(SIZES, [3.0, 10.0])[:, None])
        for i in moving:
            for j in moving:
                if held.axes[i] in TRANSLATIONS and held.axes[j] in ROTATIONS and _tied(held, i, j):
                    sizes = np.array([[a, b] for a in GROSS for b in GROSS])
                    yield _term(self, site, place, held, (i, j), scales, sizes)


def _scale(site: Site, held: Held, i: int) -> float:
    """Compliance that changes some mode's squared frequency by 100 % at first order, as a first guess."""
    load = (site.omega**2 * (held.load[:, i] @ site.shape)) ** 2
    most = float(np.max(load / site.omega**2, initial=0.0))
    return 1.0 / most if most > 0 else np.inf


def _tied(held: Held, i: int, j: int) -> bool:
    """Whether two held motions load each other's inertia, short of being one."""
    m = held.mass
    return bool(0.05 < abs(m[i, j]) / np.sqrt(m[i, i] * m[j, j]) < 0.9995)


def _term(
    mechanism: Mechanism, site: Site, place: Place, held: Held, axes: tuple[int, ...], scales: Sequence[float],
    sizes: np.ndarray,
) -> Term:  # fmt: skip
    pick = list(axes)
    turning = [held.axes[i] in ROTATIONS for i in pick]
    units = tuple("rad/(N*m)" if turn else "m/N" for turn in turning)
    names = tuple("compliance_turn" if turn else "compliance" for turn in turning)
    own = np.ix_(pick, pick)
    law = Release(held.stiffness[own], held.mass[own], names, units)
    scale = np.array([scales[i] for i in pick])
    parameters = tuple(Parameter(n, 0.0, 0.0, FARTHEST * x, u) for n, x, u in zip(names, scale, units, strict=True))
    free = tuple(held.axes[i] for i in pick)
    variant = " and ".join(free)
    static, load = held.static[:, pick], held.load[:, pick]
    group = Group(law, load, 0, held.gain, static, held.own_load[pick])
    change = Freed(law, site, place.id, free, static, load, held.own_load[pick], held.gain)
    sought = Term(mechanism, place, parameters, sizes * scale, (group,), variant)
    sought.data["fitted"] = Term(mechanism, place, parameters, sizes * scale, (), variant, {"change": change})
    sought.data["fitted"].data["sought"] = sought
    return sought
