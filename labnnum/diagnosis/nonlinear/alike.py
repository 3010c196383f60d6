"""Places that move alike in every mode that the data see: a law at one does the same as at another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.locate import Spot
from labnnum.mechanisms.base import Place

SAME = 0.005
"""Difference of two motions, below which nothing tells them apart: a third of the ordinary error of shapes."""

Equals = dict[tuple[Place, str], tuple[Place, ...]]
"""Other places that move as a place does along an axis."""


def distinct(engine: Engine, every: Sequence[Spot]) -> tuple[list[Spot], Equals]:
    """The spots of which no two move alike, the first of such a group each; and the places of the others.

    The storeys of a frame sway as one: a spring to the ground at either end of a beam, or at its middle, does the same.
    Modes count as they answer a force within the band at most.
    """
    state = engine.state(engine.theta0)
    weight = _answers(state.omega, engine.zeta0, engine.band)
    kept: list[Spot] = []
    motions: list[NDArray[np.float64]] = []
    equal: dict[tuple[Place, str], list[Place]] = {}
    for s in every:
        motion = weight * (state.shape.T @ s.column)
        size = float(np.linalg.norm(motion))
        near = [min(np.linalg.norm(motion - m), np.linalg.norm(motion + m)) / max(size, 1e-300) for m in motions]
        at = int(np.argmin(near)) if near else -1
        if at >= 0 and near[at] < SAME:
            others = equal.setdefault((kept[at].place, kept[at].axis), [])
            if s.place != kept[at].place and s.place not in others:
                others.append(s.place)
            continue
        kept.append(s)
        motions.append(motion)
    return kept, {where: tuple(others) for where, others in equal.items()}


def others_of(equal: Equals, spot: Spot) -> tuple[Place, ...]:
    """Other places that move as a spot does, in either sense."""
    return equal.get((spot.place, spot.axis.lstrip("-")), ())


def _answers(omega: NDArray, zeta: NDArray, band: tuple[float, float]) -> NDArray[np.float64]:
    """Largest receptance of each mode at frequencies of the band, (n_modes,)."""
    near = np.clip(omega, *band)
    return 1.0 / np.abs(omega**2 - near**2 + 2j * zeta[: omega.size] * omega * near)
