"""Places that move alike in every mode that the data see: a law at one does the same as at another."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.locate import ROUNDING, Spot
from labnnum.mechanisms.base import Place

SAME = 0.005
"""Difference of two motions, below which nothing tells them apart: a third of the ordinary error of shapes."""
SEEN = 0.015
"""Difference of what sensors see of a force at either, at half the band's lines, below which neither do they: the
ordinary error of shapes. Where the first mode answers a hundred times as much as the others it alone makes the motion,
and places on opposite ends of a beam move alike."""
LINES = 200
"""Lines of the band that are looked at."""

Equals = dict[tuple[Place, str], tuple[Place, ...]]
"""Other places that move as a place does along an axis."""


def distinct(engine: Engine, every: Sequence[Spot]) -> tuple[list[Spot], Equals]:
    """The spots of which no two move alike, the first of such a group each; and the places of the others.

    The storeys of a frame sway as one: a spring to the ground at either end of a beam, or at its middle, does the same.
    Modes count as they answer a force within the band at most, and what sensors see counts at every line: a law pushes
    on all modes.
    """
    state = engine.state(engine.theta0)
    weight = _answers(state.omega, engine.zeta0, engine.band)
    kept: list[Spot] = []
    motions: list[NDArray[np.float64]] = []
    seen: list[NDArray[np.complex128]] = []
    over = _lines(state.omega, engine.zeta0, engine.band)[:, :, None] * np.hstack([state.out, state.load])
    n_out = state.out.shape[1]
    equal: dict[tuple[Place, str], list[Place]] = {}
    shapes = [state.shape.T @ s.column for s in every]
    responses = [np.einsum("m,fmc->fc", shape, over) for shape in shapes]
    heard = [float(np.linalg.norm(r[:, :n_out])) / max(float(np.linalg.norm(s.column)), 1e-300)
             for r, s in zip(responses, every, strict=True)]  # fmt: skip
    for s, shape, response, much in zip(every, shapes, responses, heard, strict=True):
        if much <= ROUNDING * max(heard):
            continue
        motion = weight * shape
        size = float(np.linalg.norm(motion))
        near = [min(np.linalg.norm(motion - m), np.linalg.norm(motion + m)) / max(size, 1e-300) for m in motions]
        like = [i for i, apart in enumerate(near) if apart < SAME and _apart(response, seen[i], n_out) < SEEN]
        at = min(like, key=lambda i: near[i], default=-1)
        if at >= 0:
            others = equal.setdefault((kept[at].place, kept[at].axis), [])
            if s.place != kept[at].place and s.place not in others:
                others.append(s.place)
            continue
        kept.append(s)
        motions.append(motion)
        seen.append(response)
    return kept, {where: tuple(others) for where, others in equal.items()}


def others_of(equal: Equals, spot: Spot) -> tuple[Place, ...]:
    """Other places that move as a spot does, in either sense."""
    return equal.get(spot.where, ())


def _answers(omega: NDArray, zeta: NDArray, band: tuple[float, float]) -> NDArray[np.float64]:
    """Largest receptance of each mode at frequencies of the band, (n_modes,)."""
    near = np.clip(omega, *band)
    return 1.0 / np.abs(omega**2 - near**2 + 2j * zeta[: omega.size] * omega * near)


def _lines(omega: NDArray, zeta: NDArray, band: tuple[float, float]) -> NDArray[np.complex128]:
    """Receptance of each mode at lines of the band, (n_lines, n_modes)."""
    w = np.linspace(*band, LINES)[:, None]
    return 1.0 / (omega**2 - w**2 + 2j * zeta[: omega.size] * omega * w)


def _apart(one: NDArray, other: NDArray, n_out: int) -> float:
    """Relative difference of two responses (n_lines, n_out + n_in) in either sense, at half the lines: of what sensors
    see of a force, or of what an input moves, whichever is more.
    """
    parts = [(a, b) for a, b in ((one[:, :n_out], other[:, :n_out]), (one[:, n_out:], other[:, n_out:])) if a.size]
    sizes = [np.maximum(np.linalg.norm(a, axis=1), 1e-300) for a, _ in parts]
    return min(
        max(float(np.median(np.linalg.norm(a + sign * b, axis=1) / s)) for (a, b), s in zip(parts, sizes, strict=True))
        for sign in (-1, 1)
    )
