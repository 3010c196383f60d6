"""How a fitted model predicts: trimmed as it would be used, on lines and channels that it need not have seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit, fit
from labnnum.diagnosis.objective import Problem, frequency_spread
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.pool import what_of
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.search import broaden
from labnnum.diagnosis.task import choose_lines, data_of
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.mechanisms.base import Term

NODAL = 0.3
"""A response smaller than this part of what like sensors read is one beside a node: its error counts as theirs."""


def relative_error(measured: Frf, model: NDArray) -> float:
    """Relative RMS error over lines, root mean square over rows.

    A row's error is taken relative to its response, or to `NODAL` times the mean response of the sensors of its kind
    where that is more: a sensor beside a node of the modes reads little else than the model's ordinary errors.
    """
    e = np.sum(np.abs(measured.value - model) ** 2, axis=2)
    return float(np.sqrt(np.mean(e / _sizes(measured))))


def _sizes(frf: Frf) -> NDArray[np.float64]:
    """What each row's squared error is relative to, (n_out, n_in)."""
    turns = np.array([c.direction.lstrip("-").startswith("r") for c in frf.outputs])
    rise = np.array([MOTION_ORDER[c.quantity] for c in frf.outputs])
    weight = (2 * np.pi * frf.frequency) ** (2.0 * (2 - rise))[:, None]  # everything as acceleration
    own = np.sum(np.abs(frf.value) ** 2, axis=2)
    motion = np.sum(np.abs(frf.value) ** 2 * weight[:, None], axis=2)
    out = np.empty_like(own)
    for kind in (False, True):
        alike = turns == kind
        if alike.any():
            share = motion[alike] / np.maximum(motion[alike].mean(axis=0), 1e-300)
            out[alike] = own[alike] * np.maximum(1.0, NODAL**2 / np.maximum(share, 1e-30))
    return out


def errors_of(engine: Engine, made: Fit, train: Frf, test: Frf) -> tuple[float, float]:
    """Relative errors of a fitted model on the training and on the held-out FRFs."""
    return relative_error(train, predicted(engine, made, train)), relative_error(test, predicted(engine, made, test))


def foretold(engine: Engine, made: Fit, test: Frf, scatter: Scatter) -> float:
    """Chi-square of held-out FRFs under a fitted model, its ordinary errors of shapes and gains marginalised.

    It is the predictive score of the model as it stands: what shapes and gains of a sound bench scatter by counts for
    nothing, and a fault of one row among many, or of a few lines, is not lost in their errors. NaN where the held-out
    channels are not those of the fit.
    """
    if not _seen_by(engine, test):
        return float("nan")
    problem = Problem(engine, data_of(choose_lines(test), scatter), made.terms, scatter)
    return problem.marginal(made.point.vector())


def _seen_by(engine: Engine, frf: Frf) -> bool:
    """Whether FRFs have the outputs and inputs of an engine."""
    return what_of(frf.outputs) == what_of(engine.outputs) and what_of(frf.inputs) == what_of(engine.inputs)


def predicted(engine: Engine, made: Fit, frf: Frf) -> NDArray[np.complex128]:
    """FRFs of a fitted model on the lines and channels of `frf`, which need not be those it was fitted to."""
    s = float(frf.settings.get("window_decay", 0.0)) + 1j * frf.omega
    point = made.point
    if not _seen_by(engine, frf):
        other = Engine(engine.structure, frf.outputs, frf.inputs, engine.band)
        other.refine(engine.finer)
        if engine.coupling is not None:
            other.couple()
        terms, values = _carried_over(engine, other, made)
        point = replace(point, terms=values, size=np.zeros_like(point.size))
        return other.response(point, terms, s).value
    return engine.response(point, made.terms, s).value


def _carried_over(engine: Engine, other: Engine, made: Fit) -> tuple[tuple[Term, ...], NDArray]:
    """Terms and their values for other channels: a channel's fault goes where the channel goes, or is left out."""
    old = [c.name for c in (*engine.outputs, *engine.inputs)]
    new = [c.name for c in (*other.outputs, *other.inputs)]
    terms, values, at = [], [], 0
    for term in made.terms:
        p = made.point.terms[at : at + term.n]
        at += term.n
        if "channel" in term.data:
            name = old[term.data["channel"]]
            if name not in new:
                continue
            term = replace(term, data={"channel": new.index(name)})
        elif term.data.keys() & {"swap", "invert", "extra_mode"}:
            continue
        terms.append(term)
        values.append(p)
    return tuple(terms), np.concatenate([np.empty(0), *values])


def trimmed(engine: Engine, frf: Frf, made: Fit, scatter: Scatter) -> Fit:
    """The same model as it would be used: parameters, damping, terms as they are, weighted evenly in relative error.

    Its modal frequencies and loads may move within two standard deviations of what a sound model needs, no further.
    """
    use = replace(scatter, trim=2.0, damping=2.0)
    data = data_of(frf, replace(scatter, floor=0.03))
    terms = _fixed(made)
    plain = engine.start()
    starts = [made.point, replace(made.point, shift=plain.shift, size=plain.size)]
    starts.append(replace(starts[1], theta=engine.theta0))
    found = [replace(made, terms=terms, point=_within(engine, made.point, use))]
    for start in starts:
        rough = start.vector()
        for kappa in (0.015, 0.004):
            rough = fit(engine, broaden(engine, data, start, terms, kappa), terms, use, rough, steps=8).point.vector()
        found += [fit(engine, data, terms, use, x, steps=25) for x in (start.vector(), rough)]
    return min(found, key=lambda f: relative_error(frf, predicted(engine, f, frf)))


def _within(engine: Engine, point: Point, use: Scatter) -> Point:
    """The point, its modal frequencies and loads within what a sound model needs."""
    middle, far, most = engine.start().shift, use.trim * frequency_spread(engine, use), use.trim * use.residue
    return replace(point, shift=np.clip(point.shift, middle - far, middle + far), size=np.clip(point.size, -most, most))


def _fixed(made: Fit) -> tuple[Term, ...]:
    """The fit's terms with their parameters held at the fitted values."""
    out, at = [], 0
    for term in made.terms:
        held = []
        for q, v in zip(term.parameters, made.point.terms[at : at + term.n], strict=True):
            reach = 1e-12 * max(abs(v), 1e-300)
            held.append(replace(q, lower=v - reach, upper=v + reach, nominal=v))
        out.append(replace(term, parameters=tuple(held)))
        at += term.n
    return tuple(out)
