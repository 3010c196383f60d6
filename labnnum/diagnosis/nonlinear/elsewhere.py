"""Where else the force of a law would do as well: one force, tried at every place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, of_fit
from labnnum.diagnosis.nonlinear.laws import SHAPES
from labnnum.diagnosis.nonlinear.lines import LINES
from labnnum.diagnosis.nonlinear.locate import Background, Lead, Spot
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import ROTATIONS

MOTIONLESS = 100.0
"""Size of a force, of the least at a spot of that kind, from which on the spot hardly moves where others do."""


def as_well(found: Study, best: Tried, every: Sequence[Spot], scatter: Scatter) -> list[tuple[float, Lead]]:
    """What the force of a law removes of chi-square at every other spot, of what it does where the law was found, and
    the law there; most first.

    The force is that which the law's own motion makes; its size at a spot is free, and so are the base, from the
    quietest level's, and its ordinary errors. Where one mode makes the force, any place that moves in that mode has the
    same but for its size, and drives the other modes otherwise: what is recovered place by place does not tell that.
    The parameters are those that make the same of the motion there.
    """
    bench = Bench(found.engine, found.point, found.runs, scatter, ()).on(LINES)
    return answered(bench, found.quiet.x, best, every)


def answered(bench: Bench, x: NDArray, best: Tried, every: Sequence[Spot]) -> list[tuple[float, Lead]]:
    """The same over the bench's runs and lines, the base begun from the vector `x`."""
    plain = bench.joint([])
    x = plain.start(x[: plain.n_base])
    background = Background(plain, x)
    own = replace(best.spot, axis=best.spot.axis.lstrip("-"))
    others = [s for s in every if (s.place, s.axis) != (own.place, own.axis)]
    made = [_removed(background, c) for c in _answers(plain, x, best, [own, *others])]
    lead, least = of_fit(best), max(made[0][0], 1e-300)
    turns = [s.axis in ROTATIONS for s in others]
    sizes = {kind: min(abs(m[1]) for m, t in zip(made[1:], turns, strict=True) if t == kind) for kind in set(turns)}
    out = [
        (gain / least, moved_to(lead, s, size))
        for (gain, size), s, kind in zip(made[1:], others, turns, strict=True)
        if abs(size) < MOTIONLESS * sizes[kind]
    ]
    return sorted(out, key=lambda row: -row[0])


def moved_to(lead: Lead, spot: Spot, size: float) -> Lead:
    """A law at a spot where its force is `size` times as large and the motion as many times smaller."""
    p = lead.p.copy()
    grows = np.array(SHAPES[lead.mechanism].grows)
    p[: grows.size] *= abs(size) ** -grows.astype(float)
    turned = size < 0
    if lead.mechanism == "quadratic-stiffness" and turned:
        p[0] = -p[0]
    axis = "-" + spot.axis if turned and lead.mechanism == "one-sided-gap" else spot.axis
    return replace(lead, spot=replace(spot, axis=axis), p=p)


def _removed(background: Background, column: NDArray) -> tuple[float, float]:
    """What a column (n_out, N) removes of chi-square, and its size."""
    gram, along = background.moments(column[None])
    if gram[0, 0] <= 1e-9 * float(np.sum(column * column)):
        return 0.0, np.inf
    return float(along[0] ** 2 / gram[0, 0]), float(along[0] / gram[0, 0])


TOGETHER = 4
"""Spots whose receptances are made at once: what they do to each other comes with them, and is not asked for."""


def _answers(plain: Joint, x: NDArray, best: Tried, spots: Sequence[Spot]) -> NDArray[np.float64]:
    """Whitened responses (n_spots, n_out, N) to the law's force at each spot."""
    parts = [spots[a : a + TOGETHER] for a in range(0, len(spots), TOGETHER)]
    return np.concatenate([_some(plain, x, best, part) for part in parts])


def _some(plain: Joint, x: NDArray, best: Tried, spots: Sequence[Spot]) -> NDArray[np.float64]:
    columns = np.array([s.column for s in spots]).T
    made: dict = {}
    for key in plain.bases:
        omega = 2 * np.pi * np.arange(key[0] // 2 + 1) * key[1] / key[0]
        need = np.unique(np.concatenate([a.need for r, a in zip(plain.runs, plain.lines, strict=True) if r.key == key]))
        base = Base(plain.engine, plain.point, columns, omega, key[2], need)
        full = base.start()
        full[: x.size] = x
        made[key] = base.at(full)
    out = []
    for run, lines, orbit in zip(plain.runs, plain.lines, best.made.orbits, strict=True):
        assert orbit is not None
        r, at = made[run.key], lines.need
        here = r.index(at)
        answers = r.lift[:, None, here] * r.h[..., here] * orbit.force[0, at]
        out.append(plain._real(lines.seen(np.moveaxis(answers, 1, 0))))
    return np.concatenate(out, axis=-1)
