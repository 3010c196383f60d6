"""Forward selection of linear terms: base fit, search, full fits of the leads, and again on what is left."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit, changes_of, fit
from labnnum.diagnosis.objective import Problem, frequency_spread
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.race import stage_of
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.search import broaden, direction_score, thin
from labnnum.diagnosis.sharpen import USUAL, sharpened
from labnnum.diagnosis.task import (
    OFF,
    Candidate,
    Selection,
    Task,
    among,
    choose_lines,
    count,
    data_of,
    dispersion,
    settled,
    simplest,
    winner_base,
    with_terms,
)
from labnnum.diagnosis.unnamed import freely, told_all, told_by, unnamed
from labnnum.diagnosis.verdict import Limits
from labnnum.errors import ModelError
from labnnum.frf import Frf
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.changes import Freed

LADDER = (0.05, 0.015, 0.005, 0.0015)
"""Relative half-widths to which resonances are broadened on the way from a rough start to the lines themselves."""


def base_fit(task: Task, held: Sequence[Term], start: Point) -> Fit:
    """The structure as it is, its parameters, damping and ordinary errors fitted."""
    x = start.vector()
    found = [task.down(held, x, first) for first in range(len(task.ladder) + 1)]
    best = min(found, key=lambda f: f.objective)
    if best.prior_part > OFF * (best.point.shift.size + best.point.theta.size):
        best = min([best, *(task.down(held, p, 0) for p in _corners(task.engine, x))], key=lambda f: f.objective)
    typical = np.full_like(best.point.log_zeta, np.median(best.point.log_zeta))
    x = replace(best.point, log_zeta=typical).vector()
    again = fit(task.engine, task.coarse, held, task.scatter, x, steps=40)
    return task.refined(min(best, again, key=lambda f: f.objective), steps=40)


def _corners(engine: Engine, x: NDArray) -> list[NDArray[np.float64]]:
    """Starts with one of the structure's parameters two deviations off, up and down."""
    out = []
    for i, p in enumerate(engine.structure.parameters):
        for step in (2.0, -2.0):
            y = x.copy()
            y[i] = np.clip(y[i] + step * p.spread, p.lower, p.upper)
            out.append(y)
    return out


AT_ODDS = 3.0
"""Chi-square per value beyond which a fit does not tell whether a finer mesh would do better."""


def settle_mesh(task: Task, made: Fit) -> Fit:
    """The fit anew under the task's errors, as the model is and as a finer mesh answers; the engine keeps the better.

    Where neither fits, it allows for both.
    """
    engine, start = task.engine, made.point

    def fitted(finer: bool | None, points: Sequence[Point]) -> Fit:
        engine.refine(finer)
        fits = [fit(engine, task.data, made.terms, task.scatter, p.vector(), steps=40) for p in points]
        return min(fits, key=lambda f: f.objective)

    if not engine.mesh_shift.any():
        return fitted(False, [start])
    engine.refine(True)
    fine = fitted(True, [start, _shared_out(task, made)])
    coarse = fitted(False, [start])
    best = min(fine, coarse, key=lambda f: f.objective)
    if best.data_part > AT_ODDS * 2 * task.data.value.size:
        return fitted(None, [start])
    engine.refine(best is fine)
    return best


def _shared_out(task: Task, made: Fit) -> Point:
    """The fit's point with its frequencies where they are, what the mesh moves them by in the offsets, and the rest in
    the parameters as far as they explain it.
    """
    engine, point = task.engine, made.point
    slopes = engine.state(point.theta, changes_of(made)).d_log[: point.theta.size, engine.band_modes]
    spread = np.array([p.spread for p in engine.structure.parameters])
    weight = 1.0 / frequency_spread(engine, task.scatter)
    a = np.vstack([(slopes * weight).T, np.diag(1.0 / spread)])
    rhs = np.concatenate([(point.shift - engine.mesh_shift) * weight, (engine.theta0 - point.theta) / spread])
    step = np.linalg.lstsq(a, rhs, rcond=None)[0]
    problem, x = Problem(engine, task.data, made.terms, task.scatter), point.vector()
    ahead = replace(point, theta=point.theta + step, shift=point.shift - step @ slopes)
    return point.with_vector(problem.clip(problem.centred(x, ahead.vector())))


LOOSE = Scatter(
    frequency=0.02, damping=1.5, residue=0.2, shape=0.15, gain=0.2, phase=0.1, complexity=0.1, remainder=0.5
)
"""Errors so large that only what no mode can follow is left: how much noise FRFs hold whose noise nobody measured."""


def with_noise_found(task: Task, held: Sequence[Term], start: Point) -> Data:
    """The data with `sigma` raised to what the structure's modes leave when they may have any frequency and shape."""
    made = base_fit(replace(task, scatter=LOOSE, wide=LOOSE), held, start)
    return replace(task.data, sigma=task.data.sigma * np.sqrt(max(dispersion(made, task.data), 1.0)))


def select(
    engine: Engine, frf: Frf, terms: Sequence[Term], general: Sequence[Term], scatter: Scatter, limits: Limits,
    *, measured_noise: bool = True, initial: Sequence[tuple[Term, NDArray]] = (), depth: int = 3, width: int = 8,
    beside: bool = False, hint: bool = False, free: Sequence[Term] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Selection:  # fmt: skip
    """Add the best term while it pays (`limits`), `depth` at most.

    Parameters
    ----------
    frf : Frf
        Training data with variance; lines are thinned here.
    terms : sequence of Term
        The catalogue at its places.
    general : sequence of Term
        General local laws, for location and for the decision to abstain.
    measured_noise : bool
        Whether the variance was measured; if not, it is raised to what a loose fit leaves.
    initial : sequence of (Term, values)
        Mechanisms that the model holds already.
    width : int
        Leads of each score that get a full fit.
    beside : bool
        Whether something was found already, so that a base that explains what is left ends the search as one with a
        mechanism does.
    hint : bool
        Whether the search ends where one mechanism leaves far more than noise.
    free : sequence of Term
        Free laws, for the place of what neither names nor general laws come near.
    """
    lines = choose_lines(frf)
    data = data_of(lines, scatter)
    held = tuple(t for t, _ in initial)
    start = engine.start(held, np.concatenate([np.empty(0), *(p for _, p in initial)]))
    ladder = tuple(broaden(engine, data, start, held, k) for k in LADDER)
    counts = Counter(t.mechanism.id for t in terms)
    coarse = thin(data, data.s.size * 2 // 5)
    by_hand = len(frf.inputs) > len(frf.outputs)
    told_apart = measured_noise and not by_hand  # else noise, or where each hit went, hides how large errors are
    task = Task(engine, data, coarse, (*ladder, coarse), scatter, scatter, limits, counts, told_apart)
    if not measured_noise:
        progress("estimating the noise")
        data = with_noise_found(task, held, start)
        task = replace(task, data=data, coarse=thin(data, data.s.size * 2 // 5))
    progress("fitting the model as it is")
    base = base_fit(task, held, start)
    given = data
    if told_apart:
        task = sharper(task, lines, data, base, explained=False)
        data = task.data
    base = settle_mesh(task, base)
    chain = [Candidate(held, base, base.objective)]
    stages: list[tuple[Candidate, ...]] = []
    law: Candidate | None = None
    laws: list[Candidate] = []
    gains: dict[Place, float] = {}
    for stage in range(depth):
        left = still_open(terms, chain[-1].terms)
        told = stage > 0 and told_all(law, chain, data, limits)
        if (stage or beside) and not told and finished(task, left, chain[-1]):
            break
        if stage and hint and far(chain[-1], data):
            break
        progress(f"searching the catalogue for mechanism {stage + 1}")
        found = stage_of(task, left, chain[-1], width)
        if not found:
            break
        if stage == 1:
            alone = _in_its_place(task, found, chain[-1])
            if alone is not None:
                chain[-1], stages = alone, [_order(alone, stages[0])]
                left = still_open(terms, alone.terms)
                told = told_all(law, chain, data, limits)
                if not told and finished(task, left, alone):
                    break
                found = stage_of(task, left, alone, width)
        stages.append(tuple(found))
        if stage == 0:
            laws = unnamed(task, general, chain[0], found[0])
            law = laws[0] if laws else None
            if law is not None and found[0].cost - law.cost > limits.name:
                found = among(found, told_by(task, left, chain[0], law))
            if told_apart:
                leader, finer = min([*found, *laws], key=lambda c: c.cost).fit, engine.finer
                task = sharper(task, lines, given, leader)
                settle_mesh(task, leader)
                if engine.finer is not finer and task.data is data:
                    data = replace(data)
            if task.data is not data:
                data = task.data
                found, laws = (sorted((_anew(task, c) for c in part), key=lambda c: c.cost) for part in (found, laws))
                law = laws[0] if laws else None
                chain = [_anew(task, chain[0])]
            if told_apart:
                chain = [_beside(task, chain[0], [*found[:2], *laws[:1]])]
                base = chain[0].fit
            stages[-1] = tuple(found)
            for c in [*found, *laws]:
                place = c.last.place
                gains[place] = max(gains.get(place, 0.0), base.objective - c.cost)
        found = [c for c in found if not (stage and slight(c, task))]
        best = simplest(found, limits) if found else chain[-1]
        excess = max(dispersion(best.fit, data), 1.0)
        gain = (chain[-1].cost - best.cost) / excess
        if not found or gain < (limits.alarm if stage == 0 else limits.further):
            break
        if told and law is not None and best.cost > law.cost - limits.name:
            break  # two names are believed beside one law that explains all where they say it more simply
        if stage and law is not None and law.fit.data_part < FAR * best.fit.data_part:
            break  # a third will not do what two are so far from
        chain.append(best)
    if len(chain) > 2:
        progress("looking again at what came first")
        chain, stages = _revisited(task, terms, chain, stages[: len(chain) - 1], width)
    near = [c for c in (chain[-1], law) if c is not None]
    there = None if any(settled(c.fit, task.data, limits) for c in near) else freely(task, free, chain[0], laws)
    return Selection(tuple(chain), tuple(stages), law, gains, task.scatter, task.data, there)


MUCH = 10.0
"""Chi-square per value above which a model leaves far more than noise."""


def far(c: Candidate, data: Data) -> bool:
    """Whether a model leaves so much that it says nothing."""
    return c.fit.data_part > MUCH * 2 * data.value.size


FAR = 0.1
"""Part of what two names leave, below which a law that leaves so little is where the search for a third ends."""


SAME = 0.15
"""Relative change of every kind of error below which a scatter is left as it is."""


def sharper(task: Task, lines: Frf, given: Data, made: Fit, *, explained: bool = True) -> Task:
    """The task with the ordinary errors that a fit supports; as it is where they are nearly those that it has."""
    found = sharpened(task.engine, lines, made, task.wide, given, explained=explained)
    if task.scatter is not task.wide:
        ratios = [getattr(found, k) / getattr(task.scatter, k) for k in USUAL]
        if max(abs(np.log(ratios))) < SAME:
            return task
    data = data_of(lines, found)
    return replace(task, scatter=found, data=data, coarse=thin(data, data.s.size * 2 // 5))


def _beside(task: Task, base: Candidate, found: Sequence[Candidate]) -> Candidate:
    """The base, fitted also from where its rivals have put everything that it has: none may gain by a better start."""
    starts = [winner_base(base, c).fit.point for c in found]
    made = [fit(task.engine, task.data, base.terms, task.scatter, p.vector(), steps=20) for p in starts]
    best = min([base.fit, *made], key=lambda f: f.objective)
    return task.priced(base.terms, best)


WORSE = 2.0
"""How many times what it left before a fit leaves under sharper errors that has not found its way."""


def _anew(task: Task, c: Candidate) -> Candidate:
    """A candidate fitted to the task's data under its errors; down the broadened peaks too where one that left little
    leaves `WORSE` from where it stood.
    """
    x = c.fit.point.vector()
    made = fit(task.engine, task.data, c.terms, task.scatter, x, steps=12)
    worse = made.data_part > WORSE * c.fit.data_part and not settled(made, task.data, task.limits)
    if worse and not far(c, task.data):
        down = [task.refined(task.down(c.terms, x, rung)) for rung in (1, 2, len(task.ladder) - 1)]
        made = min([made, *down], key=lambda f: f.objective)
    return task.priced(c.terms, made)


def _in_its_place(task: Task, found: Sequence[Candidate], first: Candidate) -> Candidate | None:
    """The best second mechanism without the first, where it does better alone than the first did: that had only been
    found because the second was out of reach from where the base stood.
    """
    alone = []
    for c in found[:2]:
        n = len(c.terms)
        with suppress(ModelError):  # there may be no structure that has the second alone
            alone.append(with_terms(task, c, (*range(n - 2), n - 1)))
    best = min(alone, key=lambda c: c.cost, default=first)
    return best if best.cost < first.cost - task.limits.name else None


def _order(first: Candidate, others: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """The first, then the others, each term once."""
    return (first, *(c for c in others if c.last is not first.last))


def _revisited(
    task: Task, terms: Sequence[Term], chain: list[Candidate], stages: list[tuple[Candidate, ...]], width: int
) -> tuple[list[Candidate], list[tuple[Candidate, ...]]]:
    """The chain with each mechanism but the last searched anew beside those that came after it.

    What was named while another was missing may have stood in for both.
    """
    held, last, found_anew = len(chain[0].terms), chain[-1], False
    for _ in range(len(stages) - 1):
        try:
            before = with_terms(task, last, (*range(held), *range(held + 1, len(last.terms))))  # the eldest goes
        except ModelError:
            break
        found = stage_of(task, still_open(terms, before.terms), before, width)
        if not found or found[0].cost > last.cost - task.limits.name:
            break
        last, stages, found_anew = found[0], [*stages[1:], tuple(found)], True
    if not found_anew:
        return chain, stages
    steps = [with_terms(task, last, range(held + i + 1)) for i in range(len(stages) - 1)]
    return [chain[0], *steps, last], stages


def still_open(terms: Sequence[Term], held: Sequence[Term]) -> list[Term]:
    """Terms that may still join: what a support has let go cannot be let go again."""
    gone = {t.place for t in held if isinstance(t.whole, Freed)}
    return [t for t in terms if not (isinstance(t.fitted.whole, Freed) and t.place in gone)]


SLIGHT = 3.0
"""Standard deviations of what sound parts differ by, within which a further one that does is no fault."""


def slight(c: Candidate, task: Task) -> bool:
    """Whether the last term is an element or a mass that differs by no more than those of sound structures do."""
    last, sound = c.last, task.wide
    p = c.fit.point.terms[c.fit.point.terms.size - last.n :]
    if last.parameters and last.parameters[0].name == "relative_change":
        return abs(p[0]) < SLIGHT * sound.stiffness
    if last.mechanism.id != "added-mass" or not last.sought.groups:
        return False
    moved = last.sought.groups[0].columns
    own = np.einsum("nk,nm,mk->k", moved, np.real(task.engine.structure.matrices(task.engine.theta0).M), moved)
    return abs(p[0]) < SLIGHT * sound.mass * own.min(initial=np.inf)


def finished(task: Task, terms: Sequence[Term], last: Candidate) -> bool:
    """Whether the model explains the data, and no step along any term's signature promises a mechanism more."""
    if not settled(last.fit, task.data, task.limits):
        return False
    x = last.fit.point.vector()
    leads = direction_score(task.engine, task.coarse, task.scatter, terms, x, last.terms)
    most = max((lead.gain - task.limits.parameter * count(lead.term) for lead in leads), default=0.0)
    return most < 0.5 * task.limits.further  # a score at first order, beside what a fit may gain
