"""Sliders that stick at the quietest level: a linear spring there, which the base must not be made to imitate.

A spring in series with a slider that holds is part of the structure. A base fitted to that level without it takes
parameters of another structure, and along the motion that such a base recovers no law fits. Here the base is fitted
to the quietest level together with a linear spring at the place: what comes out is the slider's own spring and the
base as it is without it, and the force at the highest level shows the limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit, fit
from labnnum.diagnosis.nonlinear.bench import Bench, Tried, leads_of
from labnnum.diagnosis.nonlinear.fitting import reduced
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead, Recovered, Spot, recover
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.start import LADDER
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.search import broaden
from labnnum.mechanisms.base import Group, Term
from labnnum.mechanisms.ground_stiffness import GroundStiffness
from labnnum.mechanisms.laws import Maxwell, Oscillator, Spring
from labnnum.parameters import Parameter

FACTORS = (1.0, 2.0)
"""Springs that are tried, of the one that the recovered force shows along the recovered motion: a motion that is
recovered with errors makes a spring look softer."""
OF_PLACE = (0.1, 0.5)
"""And of the stiffness that the structure itself shows between the ends of the place: a base whose stiffness is free
has taken the slider's spring for its own, and the recovered force shows nothing of it."""
LIMITS = (0.1, 0.2, 0.4, 0.7, 1.1, 1.6)
"""Limits of the slider that are looked at, of the spring's force at the RMS of the motion at the highest level."""
BEST = 2
"""Limits that are carried on, by what they leave."""
NEAR = 3.0
"""Cost, of the least that a law alone leaves, the base held, below which a place is carried on."""
ALONG = 4
"""Sliders, the best by what they leave with the base held, whose base is fitted too."""
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
    loud = replace(bench, runs=(bench.runs[high],), lines=(bench.lines[high],))
    begun: list[list[Tried]] = []
    for q in sorted(found, key=lambda q: -q.share)[:most]:
        k = -float(np.linalg.lstsq(np.stack([q.z[quiet], q.v[quiet]], axis=1), q.f[quiet], rcond=None)[0][0])
        point = beside_spring(bench.engine, data, q, k, bench.scatter).point
        x = np.concatenate([point.theta, point.shift, point.log_zeta, point.size, point.law[:1]])
        force = float(np.sqrt(np.mean(q.f[high] ** 2)))
        motion = float(np.sqrt(np.mean((q.z[high] - np.mean(q.z[high])) ** 2)))
        limits = [force, 1.4 * force, *(f * point.terms[0] * motion for f in LIMITS)]
        limits.sort(key=lambda limit: _left(loud, x, q, point.terms[0], limit))
        made = [_law(bench, x, q, point.terms[0], limit, steps) for limit in limits[:BEST]]
        best = min((t for t in made if t is not None), key=lambda t: t.cost, default=None)
        if best is not None:
            softer = rounded(bench, best, steps), spread(bench, best, steps)
            begun.append([t for t in (best, *softer) if t is not None])
    least = min((t.cost for pair in begun for t in pair), default=0.0)
    near = [t for pair in begun if min(t.cost for t in pair) < NEAR * least for t in pair]
    near = sorted(near, key=lambda t: t.cost)[:ALONG]
    return sorted((bench.carry_on(t, steps, last=False) for t in near), key=lambda t: t.cost)


COARSE = 160
"""Lines of a run by which a motion is recovered."""
LET_GO = (0.15, 0.4, 1.0)
"""Limits of a slider that a spring of the quietest level may be, of its force at the RMS of the motion at the highest
level;"""
MANY, APART = 0.4, 0.8
"""and the mean limit, of that, and the spread of the limits of many sliders: what yields bit by bit bends the base for
a single one, and does not come back from there."""
FULLY = 0.95
"""Spread of the limits of many sliders that hardly slip: the weakest let go at the force at the RMS of the motion."""


def sticking(
    bench: Bench, x: NDArray, every: Sequence[Spot], held: Sequence[Term], values: NDArray
) -> list[tuple[Lead, float]]:  # fmt: skip
    """Sliders that the springs may be which a structure holds because its quietest level shows them, without a limit,
    and the RMS of the motion of each at the highest level.

    Parameters
    ----------
    x : ndarray
        Base vector of the bench's engine at the quietest level.
    every : sequence of Spot
        Where a law may act.
    held : sequence of Term
        What the structure of the bench's engine holds.
    values : ndarray
        Parameters of all of these, one after the other.
    """
    bench = bench.on(COARSE)
    high = int(np.argmax([r.level for r in bench.runs]))
    out, at = [], 0
    for term in held:
        own = values[at : at + term.n]
        at += term.n
        groups = term.sought.groups  # none, where it changes the whole structure
        if own.size != 1 or own[0] <= 0 or not groups or not isinstance(groups[0].law, Spring):
            continue
        for spot, unit in springs_along(term, every):
            q = recover(bench.joint([]), x, bench.point, spot)
            p = np.zeros(N_P)
            p[0] = own[0] * unit
            out.append((Lead(spot, "stick-slip", p, q.gain), float(np.std(q.z[high]))))
    return out


def let_go(sliders: Sequence[tuple[Lead, float]], hardly: bool = False) -> tuple[tuple[Lead, ...], ...]:
    """Sliders, with the RMS of their motion, in several forms: limits of one, and many side by side; where they
    `hardly` slip many, of which the weakest alone do.
    """
    out = []
    for slider, motion in sliders:
        force = slider.p[0] * motion
        one = [("stick-slip", part * force, 0.0) for part in LET_GO]
        forms = [("sliders", force / (1 - FULLY), FULLY)] if hardly else [*one, ("sliders", MANY * force, APART)]
        for mechanism, limit, spread in forms:
            p = slider.p.copy()
            p[1:3] = limit, spread
            out.append((replace(slider, mechanism=mechanism, p=p),))
    return tuple(out)


def springs_along(term: Term, spots: Sequence[Spot]) -> list[tuple[Spot, float]]:
    """Spots between the ends of a term along whose motion it acts, or, of a whole element, along which alone it can be
    loaded; and the stiffness there that a unit of its parameter is, N/m or N m/rad.
    """
    spot = spot_along(term, spots)
    if spot is not None:
        return [(spot, unit_of(term, spot))]
    if len(term.sought.groups) != 1 or term.place.kind != "element":
        return []
    columns, out = term.sought.groups[0].columns, []
    for s in spots:
        if s.place.kind != "joint" or {s.place.id, s.place.to} != {term.place.id, term.place.to}:
            continue
        if s.column.shape == columns[:, 0].shape:
            load = np.linalg.lstsq(columns, s.column, rcond=None)[0]
            if np.linalg.norm(columns @ load - s.column) < BALANCED * np.linalg.norm(s.column):
                out.append((s, 1.0 / float(load @ load)))
    return out


BALANCED = 0.01
"""Part of two opposite forces or moments at the ends of an element that it may leave to others."""


def spot_along(term: Term, spots: Sequence[Spot]) -> Spot | None:
    """The spot whose motion a term acts on; None where it acts on several, or on no such motion."""
    if len(term.sought.groups) != 1 or term.sought.groups[0].columns.shape[1] != 1:
        return None
    column = term.sought.groups[0].columns[:, 0]
    for s in spots:
        size = np.linalg.norm(s.column) * np.linalg.norm(column)
        if s.column.shape == column.shape and abs(s.column @ column) > 0.99 * size:
            return s
    return None


ONE_LIMIT = 0.1
"""Spread of sliders' limits below which they are as well one slider."""


def unsprung(
    laws: Sequence[Tried], held: Sequence[Term], values: NDArray, spots: Sequence[Spot], lowest: float
) -> tuple[tuple[Lead, ...], ...]:
    """Laws that were found on a structure which holds mechanisms as laws of the structure alone: as they are, and with
    the stiffness with which it holds their places on top. None where it does not move alone as one of them does.

    Parameters
    ----------
    values : ndarray
        Parameters of all that is held, one after the other.
    spots : sequence of Spot
        Of the structure alone.
    lowest : float
        Lowest frequency that was measured, rad/s.
    """
    own = {(s.place, s.axis): s for s in spots}
    plain, stiffer = [], []
    for lead in leads_of(laws):
        spot = own.get(lead.spot.where)
        if spot is None:
            return ()
        spot = replace(spot, axis=lead.spot.axis)
        one = lead.mechanism == "sliders" and lead.p[2] < ONE_LIMIT
        plain.append(replace(lead, spot=spot, mechanism="stick-slip" if one else lead.mechanism))
        p = lead.p.copy()
        p[0] += held_by(held, values, spot, lowest)
        stiffer.append(replace(plain[-1], p=p))
    return tuple(plain), tuple(stiffer)


def held_by(held: Sequence[Term], values: NDArray, spot: Spot, lowest: float) -> float:
    """Stiffness with which what a structure holds holds the motion of a spot, N/m or N m/rad: a spring, what gives
    slowly, and an oscillator that hardly moves above its own frequency.

    Parameters
    ----------
    values : ndarray
        Parameters of all of it, one after the other.
    lowest : float
        Lowest frequency that was measured, rad/s.
    """
    k, at = 0.0, 0
    for term in held:
        own = values[at : at + term.n]
        at += term.n
        if spot_along(term, [spot]) is not None:
            k += _as_spring(term, own, lowest) * unit_of(term, spot)
    return float(k)


def _as_spring(term: Term, own: NDArray, lowest: float) -> float:
    """The parameter of the spring that a term is above a frequency in rad/s; zero where it is none."""
    law = term.sought.groups[0].law
    if isinstance(law, Spring) and own.size == 1:
        return float(own[0])
    if isinstance(law, Oscillator) and 2 * np.pi * own[1] < lowest:
        return float(own[0] * (2 * np.pi * own[1]) ** 2)
    return float(own[0]) if isinstance(law, Maxwell) and own[1] * lowest > 1 else 0.0


def unit_of(term: Term, spot: Spot) -> float:
    """Stiffness along the spot's motion that a unit of the term's parameter is, N/m or N m/rad: of a change of an
    element that is relative, the element's own.
    """
    columns = term.sought.groups[0].columns[:, 0]
    return float((columns @ columns) / (spot.column @ spot.column))


def _left(bench: Bench, x: NDArray, q: Recovered, k: float, limit: float) -> float:
    """Objective of a slider as it stands, over the bench's runs; infinite where no steady state is found."""
    p = np.zeros(N_P)
    p[:2] = k, limit
    joint = bench.joint([Lead(q.spot, "stick-slip", p, q.gain)])
    start = joint.start(x)
    orbits = joint.settle(start, [None] * len(bench.runs), 8)
    if any(o is None or not np.isfinite(o.closing) for o in orbits):
        return np.inf
    return reduced(*joint.parts(start, orbits))[0]


def _law(bench: Bench, x: NDArray, q: Recovered, k: float, limit: float, steps: int) -> Tried | None:
    p = np.zeros(N_P)
    p[:2] = k, limit
    return bench.law_alone(x, Lead(q.spot, "stick-slip", p, q.gain), steps)


def rounded(bench: Bench, slider: Tried, steps: int) -> Tried | None:
    """Hysteresis in place of a slider, the base as it stands: one that lets go bit by bit, because it is distributed
    or has rounded corners, softens long before its limit.
    """
    lead = smooth_of(slider.lead, slider.made.law(0)[0])
    return bench.law_alone(slider.made.x[: slider.made.n_base], lead, steps)


def smooth_of(slider: Lead, p: NDArray) -> Lead:
    """Hysteresis in place of a slider whose parameters are `p`."""
    start = np.zeros(N_P)
    start[:4] = p[0], p[1] / max(p[0], 1e-300), 1.0, 0.5
    return Lead(slider.spot, "hysteresis", start, slider.gain)


SPREAD = 0.8
"""Spread of limits from which one is sought."""


def spread(bench: Bench, slider: Tried, steps: int) -> Tried | None:
    """Sliders side by side in place of one, the base as it stands."""
    return bench.law_alone(slider.made.x[: slider.made.n_base], spread_lead(slider), steps)


def spread_lead(slider: Tried) -> Lead:
    """Sliders whose limits are spread about that of one, or of hysteresis."""
    return spread_of(slider.lead, slider.made.law(0)[0])


def spread_of(slider: Lead, p: NDArray) -> Lead:
    """The same for a law whose parameters are `p`."""
    start = np.zeros(N_P)
    start[:3] = p[0], p[0] * p[1] if slider.mechanism == "hysteresis" else p[1], SPREAD
    return Lead(slider.spot, "sliders", start, slider.gain)


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
    own = own_stiffness(engine, q.spot.column)
    for size in (*(f * k for f in FACTORS if k > 0), *(f * own for f in OF_PLACE)):
        term = _spring(q.spot.column[:, None], q, size)
        start = engine.start((term,), [size])
        rungs = [broaden(engine, data, start, (term,), kappa) for kappa in LADDER]
        for first in (0, len(rungs) - 1):
            x = start.vector()
            for rung in rungs[first:]:
                x = fit(engine, rung, (term,), scatter, x, steps=8, tolerance=1.0).point.vector()
            ends.append(fit(engine, data, (term,), scatter, x, steps=20, tolerance=1.0))
    return min(ends, key=lambda f: f.objective)


def own_stiffness(engine: Engine, column: NDArray) -> float:
    """Static stiffness in N/m or N m/rad that the elastic modes of the band show along `column`."""
    b = engine.band_modes
    made = engine.state(engine.theta0)
    return float(1.0 / max(np.sum((made.shape[:, b].T @ column) ** 2 / made.omega[b] ** 2), 1e-300))


def _spring(column: NDArray, q: Recovered, k: float) -> Term:
    amount = Parameter("k", k, 0.01 * k, 100 * k, "N/m")
    return Term(GroundStiffness(), q.spot.place, (amount,), np.array([[k]]), (Group(Spring(), column, 0),))
