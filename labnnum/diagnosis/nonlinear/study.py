"""Which nonlinear law acts, and where: leads from recovered forces, joint fits of the best, general law beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.fit import Scatter
from labnnum.diagnosis.nonlinear.laws import SHAPES
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.locate import (
    Background,
    Lead,
    Recovered,
    Spot,
    general_lead,
    law_leads,
    ranked,
    recover,
)  # fmt: skip
from labnnum.diagnosis.nonlinear.march import N_P
from labnnum.diagnosis.nonlinear.problem import Joint, Made, fit
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.errors import EstimationError

LAWS = (
    "cubic-stiffness", "quadratic-stiffness", "quadratic-damping", "coulomb-friction", "one-sided-gap", "clearance",
    "stick-slip",
)  # fmt: skip
"""Laws that are regressed on the recovered motion; hysteresis starts from stick-slip."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A law at a spot, fitted; `cost` its objective plus the price of its parameters."""

    lead: Lead
    made: Made
    cost: float

    @property
    def spot(self) -> Spot:
        """Where."""
        return self.lead.spot

    @property
    def mechanism(self) -> str:
        """Its id."""
        return self.lead.mechanism

    def same(self, other: Tried) -> bool:
        """Whether both are one answer."""
        return self.mechanism == other.mechanism and self.spot.place == other.spot.place


@dataclass(frozen=True, eq=False)
class Study:
    """What the search found: candidates best first, the general law, the base model fitted to the same runs."""

    engine: Engine
    point: Point
    runs: tuple[Run, ...]
    base: Made
    quiet: Made
    tried: tuple[Tried, ...]
    general: Tried | None
    recovered: tuple[Recovered, ...]

    @property
    def best(self) -> Tried:
        """The candidate that costs least."""
        return self.tried[0]


ROUGH = 4
"""Steps of the first fits, on two runs, from two starts."""
ENOUGH = 1.15
"""Chi-square per value at which a law leaves nothing for a general one to explain."""

POOR = 1.3
"""Chi-square per value above which other laws and places are tried."""
NEAREST = 5
"""Spots whose recovered motion is asked for every law."""

SPRINGY = ("stick-slip", "coulomb-friction")
"""Laws that are a spring, or a lock, where the motion is small."""

PRICE = 4.0
"""Price of one parameter of a law, in chi-square."""


def cost(made: Made, mechanism: str) -> float:
    """Objective plus the price of the law's parameters; what hysteresis only shapes is not counted."""
    n = 2 if mechanism == "hysteresis" else len(SHAPES[mechanism].names)
    if mechanism == "general":
        n = int(np.count_nonzero(made.x[made.n_base :]))
    return made.objective + PRICE * (n + (1 if mechanism == "hysteresis" else 0))


def search(
    engine: Engine, point: Point, runs: Sequence[Run], quiet: int, spots: Sequence[Spot], scatter: Scatter,
    *, lines: int = 160, progress: Callable[[str], None] = lambda text: None,
) -> Study | None:  # fmt: skip
    """Fit the base, locate, regress, and fit the best laws by simulation.

    Parameters
    ----------
    runs : sequence of Run
        Training runs at their levels.
    quiet : int
        Number of the one that distorts least.
    spots : sequence of Spot
    """
    alone = Joint(engine, point, [runs[quiet]], (), scatter, [choose_lines(runs[quiet], 2 * lines, scatter.floor)])
    calm = fit(alone, alone.start(), [None], steps=15)
    chosen = [choose_lines(r, lines, scatter.floor) for r in runs]
    plain = Joint(engine, point, runs, (), scatter, chosen)
    base = fit(plain, plain.start(calm.x), [None] * len(runs), steps=12)
    background = Background(plain, calm.x[: plain.n_base])
    progress("locating")
    found = ranked(background, [recover(plain, calm.x, point, s) for s in spots])
    leads: list[Lead] = []
    for q in found[:NEAREST]:
        leads += law_leads(background, q, LAWS)
    leads.sort(key=lambda lead: -lead.gain)
    if not leads:
        return None
    progress("fitting nonlinear laws")
    tried = _fits(engine, point, runs, scatter, chosen, calm, leads)
    if not tried:
        return None
    best = tried[0].made
    plain_enough = best.data_part < ENOUGH * best.count
    law = None
    if not plain_enough:
        general = sorted((general_lead(background, q) for q in found[:NEAREST]), key=lambda lead: -lead.gain)
        law = _general(engine, point, runs, scatter, chosen, tried[0].made, general, tried)
    return Study(engine, point, tuple(runs), base, calm, tuple(tried), law, tuple(found))


def of_known(
    engine: Engine, point: Point, runs: Sequence[Run], quiet: int, known: Sequence[Lead], scatter: Scatter,
    lines: int = 250,
) -> Study | None:  # fmt: skip
    """The laws that a model holds already, fitted with the base; None where they do not settle."""
    chosen = [choose_lines(r, lines, scatter.floor) for r in runs]
    plain = Joint(engine, point, runs, (), scatter, chosen)
    base = fit(plain, plain.start(), [None] * len(runs), steps=12)
    joint = Joint(engine, point, runs, [lead.acting() for lead in known], scatter, chosen)
    try:
        made = fit(joint, joint.start(), [None] * len(runs), steps=8, exact=False)
    except (EstimationError, np.linalg.LinAlgError):
        return None
    tried = Tried(known[0], made, cost(made, known[0].mechanism))
    return Study(engine, point, tuple(runs), base, base, (tried,), None, ())


def _fit_one(
    engine: Engine, point: Point, runs: Sequence[Run], scatter: Scatter, chosen, x: NDArray, lead: Lead, steps: int
) -> Tried | None:
    joint = Joint(engine, point, runs, [lead.acting()], scatter, chosen)
    best: Made | None = None
    starts = [x]
    if lead.mechanism in SPRINGY:  # what the base took for its own may be the law's
        fresh = x.copy()
        n, m = engine.theta0.size, engine.band_modes.size
        fresh[:n], fresh[n : n + m] = engine.theta0, 0.0
        fresh[n + 2 * m : n + 3 * m] = 0.0
        starts.append(fresh)
    if lead.mechanism == "stick-slip" and joint.n_base == x.size + engine.band_modes.size:
        starts.append(softened(joint, x, lead))
    for start in starts:
        try:
            made = fit(joint, joint.start(start), [None] * len(runs), steps=steps, exact=False)
        except (EstimationError, np.linalg.LinAlgError):
            continue
        if best is None or made.objective < best.objective:
            best = made
    return None if best is None else Tried(lead, best, cost(best, lead.mechanism))


def softened(joint: Joint, x: NDArray, lead: Lead) -> NDArray[np.float64]:
    """The base without the spring of a slider that sticks at low levels, to first order: that spring it holds twice."""
    n, b = joint.engine.theta0.size, joint.engine.band_modes
    r = next(iter(joint.receptances(joint.start(x)[: joint.start(x).size]).values()))
    out = x.copy()
    less = 0.5 * lead.p[0] * r.w[0, b] ** 2 / r.omega[b] ** 2
    out[n : n + b.size] -= np.minimum(less, SOFTER)
    return out


SOFTER = 0.05
"""Fall of a frequency at most when a base is set free of what sticks."""


def _carry_on(
    engine: Engine, point: Point, runs: Sequence[Run], scatter: Scatter, chosen, tried: Tried, steps: int, *,
    always: bool = False,
) -> Tried:  # fmt: skip
    joint = Joint(engine, point, runs, tried.made.terms, scatter, chosen)
    orbits = tried.made.orbits if len(tried.made.orbits) == len(runs) else [None] * len(runs)
    try:
        made = fit(joint, tried.made.x, orbits, steps=steps, exact=False, always=always)
    except (EstimationError, np.linalg.LinAlgError):
        return tried
    return Tried(tried.lead, made, cost(made, tried.mechanism))


def _onto(t: Tried, engine: Engine, point: Point, runs: Sequence[Run], scatter: Scatter, chosen) -> Tried | None:
    """A fit to some runs taken to all."""
    p, _ = t.made.law(0)
    full = np.zeros(N_P)
    full[: p.size] = p
    lead = replace(t.lead, p=full)
    return _fit_one(engine, point, runs, scatter, chosen, t.made.x[: t.made.n_base], lead, 1)


def _shortlist(leads: Sequence[Lead], part: float, most: int) -> list[Lead]:
    """Leads with at least `part` of the best one's gain: each law at its best spot, each spot with its best law."""
    out: list[Lead] = []
    laws: set[str] = set()
    places: set[tuple] = set()
    for lead in leads:
        if lead.mechanism == "hysteresis" or lead.gain < part * leads[0].gain or len(out) == most:
            continue
        here = (lead.spot.place, lead.spot.axis.lstrip("-"))
        if lead.mechanism in laws and here in places:
            continue
        laws.add(lead.mechanism)
        places.add(here)
        out.append(lead)
    return out


CLOSE = 0.85
"""Part of the best lead's gain above which another may turn out better when it is fitted,"""
FAR = 0.3
"""and where the best leaves much unexplained."""


def _fits(
    engine: Engine, point: Point, runs: Sequence[Run], scatter: Scatter, chosen, calm: Made, leads: Sequence[Lead]
) -> list[Tried]:
    """Leads fitted, best first: roughly to the lowest and the highest run, then the best to all."""
    ends = sorted({0, len(runs) - 1})
    two, thin = [runs[i] for i in ends], [chosen[i] for i in ends]

    def rough(some: Sequence[Lead]) -> list[Tried]:
        made = [_fit_one(engine, point, two, scatter, thin, calm.x, lead, ROUGH) for lead in some]
        return sorted((t for t in made if t is not None), key=lambda t: t.cost)

    first = _shortlist(leads, CLOSE, 4)
    tried = rough(first)
    if not tried or tried[0].made.data_part > POOR * tried[0].made.count:
        more = [lead for lead in _shortlist(leads, FAR, 8) if not any(lead is known for known in first)]
        tried = sorted([*tried, *rough(more)], key=lambda t: t.cost)
    if not tried:
        return []
    best = _best_on_all(engine, point, runs, scatter, chosen, tried)
    if best is None:
        return []
    done = [best, *_at_its_place(engine, point, runs, scatter, chosen, best, leads)]
    ratio = best.made.count / tried[0].made.count
    known = {(t.mechanism, t.spot.place, t.spot.axis) for t in done}
    rest = [replace(t, cost=t.cost * ratio) for t in tried if (t.mechanism, t.spot.place, t.spot.axis) not in known]
    done.sort(key=lambda t: t.cost)
    front = [_carry_on(engine, point, runs, scatter, chosen, t, 8) if not t.made.converged else t for t in done[:2]]
    return sorted([*front, *done[2:], *rest], key=lambda t: t.cost)


def _best_on_all(
    engine: Engine, point: Point, runs: Sequence[Run], scatter: Scatter, chosen, tried: Sequence[Tried]
) -> Tried | None:
    """The best of rough fits on all runs: the second too where it is near."""
    near = [t for t in tried[:2] if t.cost < 1.5 * tried[0].cost]
    onto = [_onto(t, engine, point, runs, scatter, chosen) for t in near]
    done = [_carry_on(engine, point, runs, scatter, chosen, t, 8) for t in onto if t is not None]
    return min(done, key=lambda t: t.cost) if done else None


def _at_its_place(
    engine: Engine, point: Point, runs: Sequence[Run], scatter: Scatter, chosen, best: Tried, leads: Sequence[Lead]
) -> list[Tried]:  # fmt: skip
    """The best place with other laws that its motion asks for, and hysteresis beside stick-slip."""
    poor = best.made.data_part > POOR * best.made.count
    here = [lead for lead in leads if lead.spot.place == best.spot.place and lead.mechanism != "hysteresis"]
    own = max((lead.gain for lead in here), default=0.0)
    part = FAR if poor else CLOSE
    more = [
        lead for lead in here
        if lead.mechanism != best.mechanism and (lead.gain > part * own or (poor and lead.mechanism in SPRINGY))
    ]  # fmt: skip
    base = best.made.x[: best.made.n_base]
    out = [_fit_one(engine, point, runs, scatter, chosen, base, lead, 5) for lead in more[:4]]
    slips = [t for t in (best, *out) if t is not None and t.mechanism == "stick-slip"]
    if slips and (poor or slips[0] is best):
        p, _ = slips[0].made.law(0)
        start = np.zeros(N_P)
        start[:4] = p[0], p[1] / p[0], 2.0, 0.5
        lead = Lead(slips[0].spot, "hysteresis", start, slips[0].lead.gain)
        out.append(_fit_one(engine, point, runs, scatter, chosen, slips[0].made.x[: best.made.n_base], lead, 12))
    return [t for t in out if t is not None]


def engine_size(made: Made) -> int:
    """Length of the base part of a fit's vector."""
    return made.n_base


def _general(
    engine: Engine, point: Point, runs: Sequence[Run], scatter: Scatter, chosen, best: Made,
    general: Sequence[Lead], tried: Sequence[Tried],
) -> Tried | None:  # fmt: skip
    """The general law, fitted at the best candidate's spot from its base, and at its own best spot."""
    own = next((g for g in general if g.spot.place == tried[0].spot.place and g.gain > 0), None)
    leads = [g for g in general[:2] if g.gain > 0]
    if own is not None and own not in leads:
        leads.append(own)
    out = [_fit_one(engine, point, runs, scatter, chosen, best.x[: best.n_base], g, 8) for g in leads]
    found = [t for t in out if t is not None]
    return min(found, key=lambda t: t.cost) if found else None


def at_places(
    study: Study, tried: Tried, spots: Sequence[Spot], scatter: Scatter, lines: int = 220, most: int = 4
) -> list[Tried]:
    """The winning law at its rivals' spots, each fitted: places that explain as well are named beside it."""
    chosen = [choose_lines(r, lines, scatter.floor) for r in study.runs]
    p, _ = tried.made.law(0)
    full = np.zeros(N_P)
    full[: p.size] = p
    out = []
    for s in spots[:most]:
        lead = replace(tried.lead, spot=s, p=full)
        one = _fit_one(
            study.engine, study.point, study.runs, scatter, chosen, tried.made.x[: tried.made.n_base], lead, 3
        )
        if one is not None:
            out.append(one)
    return out


FINE = 350
"""Lines of a run on which the best laws are told apart, and their gain over the base is judged."""


def base_again(study: Study, scatter: Scatter, lines: int = FINE) -> Made:
    """The base fitted to as many lines as the best laws are: gains are differences on the same data."""
    chosen = [choose_lines(r, lines, scatter.floor) for r in study.runs]
    plain = Joint(study.engine, study.point, study.runs, (), scatter, chosen)
    return fit(plain, study.base.x, [None] * len(study.runs), steps=6)


def refined(study: Study, scatter: Scatter, more: Sequence[Tried], lines: int = FINE, most: int = 2) -> list[Tried]:
    """All candidates, best first, the `most` best fitted on more lines so that near ones are told apart.

    Costs of the others are raised by what the best's own rose with the lines: they stay comparable.
    """
    everyone = sorted((t for t in [*study.tried, *more] if np.isfinite(t.cost)), key=lambda t: t.cost)
    if not everyone:
        return []
    front: list[Tried] = []
    for t in everyone:
        if not any(t.same(o) for o in front):
            front.append(t)
    limit = everyone[0].cost * 3 + 1e3
    chosen = [choose_lines(r, lines, scatter.floor) for r in study.runs]
    done = [
        _carry_on(study.engine, study.point, study.runs, scatter, chosen, t, 4)
        for t in front[:most]
        if t is front[0] or t.cost < limit
    ]
    best = min(done, key=lambda t: t.cost)
    sure = _carry_on(study.engine, study.point, study.runs, scatter, chosen, best, 2, always=True)
    done = [sure if t is best else t for t in done]
    best = sure
    ratio = best.made.count / everyone[0].made.count
    rest = [replace(t, cost=t.cost * ratio) for t in front if not any(t.same(o) for o in done)]
    return sorted([*done, *rest], key=lambda t: t.cost)
