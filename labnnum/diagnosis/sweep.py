"""Responses with one more term added at many values of its parameters, sharing what does not depend on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis import sums
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.point import Point
from labnnum.errors import ModelError
from labnnum.mechanisms.base import Term


def _or_nothing(engine: Engine, point: Point, terms: Sequence[Term], s: NDArray) -> NDArray[np.complex128]:
    """FRFs with `terms`, or without the last where its size is beyond what the model can hold."""
    try:
        return engine.response(point, terms, s).value
    except ModelError:
        held = point.terms[: point.terms.size - terms[-1].n]
        return engine.response(replace(point, terms=held), terms[:-1], s).value


def sweep(
    engine: Engine, point: Point, term: Term, starts: NDArray, s: NDArray, held: Sequence[Term] = ()
) -> NDArray[np.complex128]:
    """FRFs with `term` at each of `starts` (n_starts, n_parameters) added: shape (n_starts, n_out, n_in, n_f).

    `point` is of the model with the terms `held`. What does not depend on the new term is computed once.
    """
    terms = [*held, term]

    def at(p: NDArray) -> Point:
        both = np.concatenate([point.terms, np.asarray(p, float)])
        return replace(point, terms=both)

    k = term.width
    if k == 0:
        return np.stack([_or_nothing(engine, at(p), terms, s) for p in starts])
    one = engine.evaluation(point, held, s).joined(term)
    x, h, z, gw = one.ingredients(k)
    g = engine.grid(term, starts, s)  # (n, k, k, f)
    if k == 1:
        force = (-g[:, 0, 0] / (1 + gw[0, 0] * g[:, 0, 0]))[:, None, None] * z  # (n, k, i, f)
    else:
        loop = np.matmul(np.moveaxis(gw, 2, 0), np.moveaxis(g, 3, 1)) + np.eye(k)  # (n, f, k, k)
        motion = np.linalg.solve(loop, np.broadcast_to(np.moveaxis(z, 2, 0), (*loop.shape[:3], z.shape[1])))
        force = -np.moveaxis(np.matmul(np.moveaxis(g, 3, 1), motion), 1, 3)
    value = one.to_channels(sums.forced(x, np.ascontiguousarray(h), np.ascontiguousarray(force)))
    return value + engine.mesh_share(point, held, s, one.to_channels(x[None])[0]) if engine.finer else value
