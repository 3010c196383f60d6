"""Sliders that stick at the quietest level: a linear spring there, which the base must not be made to imitate.

A spring in series with a slider that holds is part of the structure. A base fitted to that level without it takes
parameters of another structure, and along the motion that such a base recovers no law fits. Here the base is fitted
to the quietest level together with a linear spring at the place: what comes out is the slider's own spring and the
base as it is without it, and the force at the highest level shows the limit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit, fit
from labnnum.diagnosis.nonlinear.bench import Bench, Tried
from labnnum.diagnosis.nonlinear.locate import Lead, Recovered
from labnnum.diagnosis.nonlinear.march import N_P
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.start import LADDER
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.search import broaden
from labnnum.mechanisms.base import Group, Term
from labnnum.mechanisms.ground_stiffness import GroundStiffness
from labnnum.mechanisms.laws import Spring
from labnnum.parameters import Parameter

FACTORS = (1.0, 2.0)
"""Springs that are tried, of the one that the recovered force shows along the recovered motion: a motion that is
recovered with errors makes a spring look softer."""
LIMITS = (1.0, 1.4)
"""Limits of the slider that are tried, of the RMS of the force at the highest level: a square wave, a sine."""
NEAR = 3.0
"""Cost, of the least that a law alone leaves, the base held, below which a place is carried on."""
MOST = 400
"""Lines of the quietest run that are fitted."""


def stuck(bench: Bench, quiet: int, found: Sequence[Recovered], most: int, steps: int) -> list[Tried]:
    """Sliders on a spring, simulated from a base that was fitted to the quietest run beside that spring; best first.

    Parameters
    ----------
    quiet : int
        Number of the run that distorts least.
    found : sequence of Recovered
        Forces and motions that the nominal model shows; the `most` places whose force explains most distortion are
        tried.
    steps : int
        Of each fit.
    """
    run = bench.runs[quiet]
    if run.open:
        return []
    data = quiet_data(run, bench.scatter)
    high = int(np.argmax([r.level for r in bench.runs]))
    begun: list[list[Tried]] = []
    for q in sorted(found, key=lambda q: -q.share)[:most]:
        k = -float(np.linalg.lstsq(np.stack([q.z[quiet], q.v[quiet]], axis=1), q.f[quiet], rcond=None)[0][0])
        if k <= 0:
            continue
        point = beside_spring(bench.engine, data, q, k, bench.scatter).point
        x = np.concatenate([point.theta, point.shift, point.log_zeta, point.size])
        force = float(np.sqrt(np.mean(q.f[high] ** 2)))
        made = [_law(bench, x, q, point.terms[0], limit * force, steps) for limit in LIMITS]
        best = min((t for t in made if t is not None), key=lambda t: t.cost, default=None)
        if best is not None:
            smooth = rounded(bench, best, steps)
            begun.append([t for t in (best, smooth) if t is not None])
    least = min((t.cost for pair in begun for t in pair), default=0.0)
    near = [t for pair in begun if min(t.cost for t in pair) < NEAR * least for t in pair]
    return sorted((bench.carry_on(t, steps, last=False) for t in near), key=lambda t: t.cost)


def _law(bench: Bench, x: NDArray, q: Recovered, k: float, limit: float, steps: int) -> Tried | None:
    p = np.zeros(N_P)
    p[:2] = k, limit
    return bench.law_alone(x, Lead(q.spot, "stick-slip", p, q.gain), steps)


def rounded(bench: Bench, slider: Tried, steps: int) -> Tried | None:
    """Hysteresis in place of a slider, the base as it stands: one that lets go bit by bit, because it is distributed
    or has rounded corners, softens long before its limit.
    """
    p, _ = slider.made.law(0)
    start = np.zeros(N_P)
    start[:4] = p[0], p[1] / max(p[0], 1e-300), 1.0, 0.5
    lead = Lead(slider.spot, "hysteresis", start, slider.lead.gain)
    return bench.law_alone(slider.made.x[: slider.made.n_base], lead, steps)


def quiet_data(run: Run, scatter: Scatter) -> Data:
    """FRFs of a run on its excited lines, as the linear fit takes them."""
    at = np.flatnonzero(run.excited & run.compared)
    if at.size > MOST:
        at = at[np.unique(np.linspace(0, at.size - 1, MOST).round().astype(int))]
    s = np.asarray(run.decay + 2j * np.pi * run.frequency[at], complex)
    noise = np.where(np.isfinite(run.noise), run.noise, 0.0)[:, at]
    sigma = np.sqrt(noise) / np.abs(run.u[at])
    return Data(s, (run.y[:, at] / run.u[at])[:, None], sigma[:, None]).with_floor(scatter.floor)


def beside_spring(engine: Engine, data: Data, q: Recovered, k: float, scatter: Scatter) -> Fit:
    """The base and a linear spring at a place fitted together, down a ladder of broadenings; the best end."""
    ends: list[Fit] = []
    for factor in FACTORS:
        term = _spring(q.spot.column[:, None], q, factor * k)
        start = engine.start((term,), [factor * k])
        rungs = [broaden(engine, data, start, (term,), kappa) for kappa in LADDER]
        for first in (0, len(rungs) - 1):
            x = start.vector()
            for rung in rungs[first:]:
                x = fit(engine, rung, (term,), scatter, x, steps=8, tolerance=1.0).point.vector()
            ends.append(fit(engine, data, (term,), scatter, x, steps=20, tolerance=1.0))
    return min(ends, key=lambda f: f.objective)


def _spring(column: NDArray, q: Recovered, k: float) -> Term:
    amount = Parameter("k", k, 0.01 * k, 100 * k, "N/m")
    return Term(GroundStiffness(), q.spot.place, (amount,), np.array([[k]]), (Group(Spring(), column, 0),))
