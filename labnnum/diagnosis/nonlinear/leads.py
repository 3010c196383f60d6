"""What laws promise along the recovered motion: general ones, those of one term, and each of the catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.laws import SHAPES, candidates, force_along, general_basis
from labnnum.diagnosis.nonlinear.locate import (
    Background,
    Beside,
    Lead,
    Recovered,
    Spot,
    lengths,
    spectra_of,
    through,
)
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.problem import Joint


def law_column(joint: Joint, found: Recovered, mechanism: str, p: NDArray, sign: float) -> NDArray[np.float64]:
    """Whitened response (n_out, N) to a law of parameters `p` along the recovered motion."""
    shape = SHAPES[mechanism]
    forces = [
        force_along(shape, sign * z, sign * v, p, around=run.lasting) * sign
        for run, z, v in zip(joint.runs, found.z, found.v, strict=True)
    ]
    return through(joint, found, spectra_of(joint, forces))


MOST_GENERAL = 3
"""Terms of the general law that are kept."""


class _General:
    """Products of the general law's columns at a spot, a spring and a dashpot first."""

    def __init__(self, background: Background, found: Recovered, dry: bool) -> None:
        z_top, v_top = found.top, float(max(np.max(np.abs(v)) for v in found.v))
        self.scale = np.maximum(np.abs(general_basis(np.array([z_top]), np.array([v_top])))[:, 0], 1e-300)
        bases = [general_basis(z, v) / self.scale[:, None] for z, v in zip(found.z, found.v, strict=True)]
        if dry:
            bases = [np.vstack([g, np.sign(v)]) for g, v in zip(bases, found.v, strict=True)]
        self.n = bases[0].shape[0]
        columns = companion_columns(background, found)
        for i in range(self.n):
            columns.append(through(background.joint, found, spectra_of(background.joint, [g[i] for g in bases])))
        self.gram, self.along = background.moments(np.array(columns))

    def scored(self, used: list[int]) -> tuple[NDArray, float]:
        """Sizes of the columns `used` and what they remove."""
        at = np.ix_(used, used)
        d = lengths(self.gram[at])
        size = np.linalg.pinv(self.gram[at] / np.outer(d, d), rcond=1e-10) @ (self.along[used] / d) / d
        return size, float(size @ self.along[used])

    def best(self, least: float, objective: float) -> tuple[list[int], NDArray, float]:
        """Terms one by one while each removes `least` of what the others leave of `objective`, and 20."""
        chosen: list[int] = []
        size, gain = np.zeros(0), self.scored([0, 1])[1]
        while len(chosen) < MOST_GENERAL:
            trials = [i for i in range(self.n) if i not in chosen]
            each = [self.scored([0, 1, *(j + 2 for j in [*chosen, i])]) for i in trials]
            best = int(np.argmax([g for _, g in each]))
            if each[best][1] - gain < max(least * (objective - gain), 20.0 * (least > 0)):
                break
            chosen.append(trials[best])
            size, gain = each[best]
            size = size[2:]
        return chosen, size, gain - self.scored([0, 1])[1]

    def alone(self, spot: Spot) -> list[Lead]:
        """Every term of `UNNAMED` by itself, best first."""
        out, beside = [], self.scored([0, 1])[1]
        for i in UNNAMED:
            size, gain = self.scored([0, 1, i + 2])
            p = np.zeros(N_P)
            p[i] = size[2] / self.scale[i]
            out.append(Lead(spot, "general", p, gain - beside))
        return sorted(out, key=lambda lead: -lead.gain)


UNNAMED = (0, 3, 5, 6, 7, 8, 9)
"""Terms of the general law that are no law of the catalogue."""
ALIKE = 0.9
"""Correlation of a law's force with that of one without a name, along its own motion, from which that one is tried."""
OWN = {1: "quadratic-stiffness", 2: "cubic-stiffness", 4: "quadratic-damping"}
"""Those that are, and which."""
FOREMOST = 2
"""Of them, those of each spot that compete with the named laws."""


def unnamed_like(lead: Lead, orbit: Orbit, alike: float = ALIKE) -> list[Lead]:
    """Laws of one term without a name whose force along a law's orbit has a correlation of `alike` or more with the
    law's; the most alike first.
    """
    out: list[tuple[float, Lead]] = []
    force, terms = -orbit.time[:, 0], general_basis(*orbit.motion[:, 0].T)
    for i in UNNAMED:
        along, size = float(force @ terms[i]), float(terms[i] @ terms[i])
        if along**2 > alike**2 * size * float(force @ force) > 0:
            p = np.zeros(N_P)
            p[i] = along / size
            out.append((-(along**2) / size, Lead(lead.spot, "general", p, 0.0)))
    return [q for _, q in sorted(out, key=lambda row: row[0])]


def named_like(lead: Lead, orbit: Orbit, mechanisms: Sequence[str], alike: float = ALIKE) -> list[Lead]:
    """The other named laws whose force along a law's orbit has a correlation of `alike` or more with the law's, with
    the gap, the slip and the strength that make it so; the most alike first.
    """
    out: list[tuple[float, Lead]] = []
    force, (z, v) = -orbit.time[:, 0], orbit.motion[:, 0].T
    whole = float(force @ force)
    for mechanism in (m for m in mechanisms if m != lead.mechanism and whole > 0):
        shape = SHAPES[mechanism]
        best: tuple[float, Lead] | None = None
        for side in (1.0, -1.0) if mechanism == "one-sided-gap" else (1.0,):
            for unit in candidates(shape, float(np.max(np.abs(z)))):
                made = side * force_along(shape, side * z, side * v, unit, around=False)
                along, size = float(force @ made), float(made @ made)
                if along**2 <= alike**2 * size * whole or (shape.positive and along <= 0):
                    continue
                value = unit.copy()
                value[0] = along / size
                if shape.law == "stick-slip":
                    value[1] = value[0] * unit[1]
                spot = lead.spot if side > 0 else replace(lead.spot, axis=_opposite(lead.spot.axis))
                if best is None or along**2 / size > best[0]:
                    best = (along**2 / size, Lead(spot, mechanism, value, lead.gain))
        out += [best] if best is not None else []
    return [q for _, q in sorted(out, key=lambda row: -row[0])]


def _opposite(axis: str) -> str:
    """The other sense of an axis."""
    return axis[1:] if axis.startswith("-") else "-" + axis


def ranked(background: Background, found: Sequence[Recovered]) -> list[Recovered]:
    """Spots by what the general law, dry friction among its terms, removes there; the best first."""
    out = []
    for q in found:
        general = _General(background, q, True)
        gain = general.best(0.0, background.objective)[2]
        out.append(replace(q, gain=gain, unnamed=tuple(general.alone(q.spot)[:FOREMOST])))
    return sorted(out, key=lambda q: -q.gain)


def general_lead(background: Background, found: Recovered) -> Lead:
    """The general law along the recovered motion: its terms one by one while each removes a tenth of what is left."""
    made = _General(background, found, False)
    chosen, size, gain = made.best(0.1, background.objective)
    p = np.zeros(N_P)
    p[chosen] = size / made.scale[chosen]
    return Lead(found.spot, "general", p, gain if chosen else 0.0)


def companion_columns(background: Background, found: Recovered) -> list[NDArray[np.float64]]:
    """Spring and dashpot at the spot, which the base model may have wrong."""
    return [through(background.joint, found, spectra_of(background.joint, rows)) for rows in (found.z, found.v)]


def companions(background: Background, found: Recovered) -> Beside:
    """Scores beside a spring and a dashpot at the spot."""
    return background.beside(np.array(companion_columns(background, found)))


def law_leads(background: Background, found: Recovered, mechanisms: Sequence[str]) -> list[Lead]:
    """The best of each law along the recovered motion, a spring and a dashpot beside it."""
    beside = companions(background, found)
    out = []
    for mechanism in mechanisms:
        shape = SHAPES[mechanism]
        best: Lead | None = None
        for side in (1.0, -1.0) if mechanism == "one-sided-gap" else (1.0,):
            for unit in candidates(shape, found.top):
                size, gain = beside.single(law_column(background.joint, found, mechanism, unit, side))
                if shape.positive and size <= 0:
                    continue
                value = unit.copy()
                value[0] = size
                if shape.law == "stick-slip":
                    value[1] = size * unit[1]
                spot = found.spot
                if side < 0:
                    spot = Spot(spot.place, "-" + spot.axis, spot.column)
                gain -= beside.gain
                if best is None or gain > best.gain:
                    best = Lead(spot, mechanism, value, gain)
        if best is not None:
            out.append(best)
    slip = next((lead for lead in out if lead.mechanism == "stick-slip"), None)
    if slip is not None:
        p = np.zeros(N_P)
        p[:4] = slip.p[0], slip.p[1] / slip.p[0], 1.5, 0.5
        out.append(Lead(slip.spot, "hysteresis", p, slip.gain))
    return out
