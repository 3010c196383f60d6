"""Relative errors of a fit over training and held-out runs, and the noise that no model can explain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Study, Tried
from labnnum.diagnosis.nonlinear.follow import along, marched_from
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.suspect import heard
from labnnum.diagnosis.nonlinear.tie import tightness
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.scatter import Scatter


def noise_of(observations: Sequence[Observation]) -> float:
    """Relative RMS that noise alone leaves of the responses that are believed."""
    parts = []
    for o in observations:
        assert o.run is not None
        parts.append(np.mean(o.run.unsure[heard(o.run)]))
    return float(np.sqrt(np.mean(parts)))


def settled_on(
    found: Study, best: Tried, train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter
) -> tuple[Joint, tuple[NDArray, list[Any]]]:
    """The best law's steady states on training and held-out runs."""
    runs = [o.run for o in (*train, *test) if o.run is not None]
    joint = Joint(
        found.engine, found.point, runs, best.made.terms, scatter, [choose_lines(r, 300, scatter.floor) for r in runs]
    )
    known = list(best.made.orbits)
    start = [*known, *_begun(joint, best.made.x, len(known), tightness(known))]
    return joint, (best.made.x, joint.settle(best.made.x, start, 12))


def _begun(joint: Joint, x: NDArray, first: int, tight: float | None) -> list[Orbit | None]:
    """Where the march over the runs from `first` on begins: at the law's force along the motion that they show.

    A law that softens or sticks may have other steady states, to which a march from nothing would go; noise is
    brought into step with the motion, and held in it as tightly as the training runs are.
    """
    rest = joint.over(range(first, len(joint.runs)))
    if not joint.k or not rest.runs or (tight is None and not all(r.lasting for r in rest.runs)):
        return [None] * len(rest.runs)
    marched = marched_from(rest, x, along(rest, x), tight)
    return [None if o is None or not np.isfinite(o.time).all() else o for o in marched]


def shown_error(joint: Joint, x: NDArray, orbits: Sequence[Any], n_train: int) -> float:
    """Relative RMS error over the runs held out with the laws' forces along the motion that these show; NaN where that
    motion is not known.

    Next to a jump a steady state that the structure was in may be one that its model does not have, or does not stay
    in, at parameters within their errors: a simulation then ends in another, which says little about the law.
    """
    shown = _begun(joint, x, n_train, tightness(orbits[:n_train])) if joint.k else []
    if not shown or any(o is None for o in shown):
        return float("nan")
    return errors_of(joint, x, [*orbits[:n_train], *shown], n_train)[1]


def base_errors(
    found: Study, train: Sequence[Observation], test: Sequence[Observation], x: NDArray, scatter: Scatter
) -> tuple[float, float]:
    """Of the base model alone, at the vector `x`."""
    joint = alone(found, train, test, scatter)
    return errors_of(joint, x, [None] * len(joint.runs), len(train))


def alone(found: Study, train: Sequence[Observation], test: Sequence[Observation], scatter: Scatter) -> Joint:
    """The objective of the base model alone over training and held-out runs."""
    runs = [o.run for o in (*train, *test) if o.run is not None]
    return Joint(found.engine, found.point, runs, (), scatter, [choose_lines(r, 300, scatter.floor) for r in runs])


def foretold(joint: Joint, x: NDArray, orbits: Sequence[Any], n_train: int) -> tuple[float, int]:
    """Chi-square of the runs held out, quiet lines among theirs, and of how many values.

    Sensors' ordinary errors are taken from the training runs; without runs held out both are those of the training.
    """
    parts = _left(joint, x, orbits, n_train)
    chosen = list(zip(joint.runs, parts, strict=True))[n_train:] or list(zip(joint.runs, parts, strict=True))
    kept = [part[heard(run)] for run, part in chosen]
    return float(sum(np.sum(part**2) for part in kept)), int(sum(part.size for part in kept))


def _left(joint: Joint, x: NDArray, orbits: Sequence[Any], n_train: int) -> list[NDArray[np.float64]]:
    """Whitened residuals of each run, sensors' ordinary errors as the training runs show them taken off."""
    r, b = joint.parts(x, orbits)
    cuts = np.cumsum([2 * lines.at.size for lines in joint.lines])
    own = slice(0, cuts[n_train - 1])
    gram = np.matmul(b[..., own], b[..., own].transpose(0, 2, 1)) + np.eye(b.shape[1])
    size = np.linalg.solve(gram, np.matmul(b[..., own], r[:, own, None]))
    return np.split(r - np.matmul(b.transpose(0, 2, 1), size)[..., 0], cuts[:-1], axis=1)


def errors_of(joint: Joint, x: NDArray, orbits: Sequence[Any], n_train: int) -> tuple[float, float]:
    """Relative RMS errors over training and held-out runs; sensors' ordinary errors are taken from the training."""
    each = []
    for run, lines, part in zip(joint.runs, joint.lines, _left(joint, x, orbits, n_train), strict=True):
        spread = np.tile(lines.sigma, 2) / np.sqrt(2.0)
        power = np.sum(np.abs(run.seen(run.y)[:, lines.at]) ** 2, axis=1)
        each.append(np.mean((np.sum((part * spread) ** 2, axis=1) / power)[heard(run)]))
    train, test = each[:n_train], each[n_train:] or each[:n_train]
    return float(np.sqrt(np.mean(train))), float(np.sqrt(np.mean(test)))
