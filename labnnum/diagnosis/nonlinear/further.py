"""One more law beside those that were found: the best that any place's remaining force asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, cost
from labnnum.diagnosis.nonlinear.effort import tired
from labnnum.diagnosis.nonlinear.explore import LAWS
from labnnum.diagnosis.nonlinear.fitting import Made, fit
from labnnum.diagnosis.nonlinear.force import YIELDING
from labnnum.diagnosis.nonlinear.laws import NAMES
from labnnum.diagnosis.nonlinear.leads import OWN, general_lead, law_leads, ranked
from labnnum.diagnosis.nonlinear.lines import Lines, choose_lines
from labnnum.diagnosis.nonlinear.locate import Background, Lead, Spot, recover
from labnnum.diagnosis.nonlinear.orbit import Orbit, Tie
from labnnum.diagnosis.nonlinear.problem import Acting, Joint, steps_of
from labnnum.diagnosis.nonlinear.receptance import per_place
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.scatter import Scatter
from labnnum.errors import EstimationError, ModelError

GAIN = 0.1
"""Share of what the laws so far leave beyond noise that one more must remove."""


def further(
    study: Study, first: Tried, spots: Sequence[Spot], scatter: Scatter, alarm: float, lines: int = 250, *,
    general: bool = False, own: bool = False, promise: float = 0.1, worth: float = GAIN,
) -> Tried | None:  # fmt: skip
    """One more law beside those of `first`: the best that any spot's remaining force asks for, fitted with them.

    Parameters
    ----------
    general : bool
        Whether the general law is tried, instead of named ones, at the places that act already.
    own : bool
        Whether of its terms only those are tried that are laws of the catalogue, as such.
    promise : float
        Part of the excess over noise that a law must promise to remove along the recovered motion to be fitted.
    worth : float
        Part of it that the law must remove once fitted.

    Returns
    -------
    Tried or None
        Its `made` holds the laws so far and the new one; None where none gains `alarm` and is worth it.
    """
    engine, point, runs = study.engine, study.point, study.runs
    chosen = [choose_lines(r, lines, scatter.floor) for r in runs]
    held = first.made.terms
    joint = Joint(engine, point, runs, held, scatter, chosen)
    try:
        made = fit(joint, first.made.x, first.made.orbits, steps=2)
        background = Background(joint, made.x, made.orbits)
    except (EstimationError, ModelError, np.linalg.LinAlgError):
        return None  # a steady state that hardly settles tells of no other law
    here = [s for s in spots if any(np.array_equal(np.abs(s.column), np.abs(t.column)) for t in held)]
    found = ranked(background, [recover(joint, made.x, point, s, made.orbits) for s in (here if general else spots)])
    leads: list[Lead] = []
    most = 3 if general else asked(runs)
    for q in found[:most] if general else [*found[:most], *(q for q in found[most:] if q.spot in here)]:
        wanted = general_lead(background, q) if general else None
        if own and wanted is not None:
            leads += law_leads(background, q, [name for i, name in OWN.items() if wanted.p[i]])
        else:
            leads += law_leads(background, q, LAWS) if wanted is None else [wanted]
    excess = max(1.0, made.data_part / made.count)
    least = max(alarm * excess, promise * (made.objective - made.count))
    leads = sorted((lead for lead in leads if not _again(lead, held)), key=lambda lead: -lead.gain)
    leads = [q for q in leads if q.gain > least] or _outstanding(leads, max(alarm * excess, LESS * least))
    best: Tried | None = None
    for lead in leads[:1] if general else _distinct(leads)[:TRIED]:
        more = Joint(engine, point, runs, [*held, lead.acting()], scatter, chosen)
        x = with_one_more(made, lead, engine)
        start = [_with_one_more(o) for o in made.orbits]
        try:
            one = fit(more, x, start, steps=8)
        except (EstimationError, ModelError, np.linalg.LinAlgError):
            continue
        tried = Tried(lead, one, cost(one, lead.mechanism))
        if best is None or tried.cost < best.cost:
            best = tried
    if best is None:
        return None
    excess = max(1.0, best.made.data_part / best.made.count)
    gain = (made.objective - best.cost) / excess
    left = max(made.objective - made.count, 1.0) / excess
    return best if gain > max(alarm, worth * left) else None


def _outstanding(leads: Sequence[Lead], least: float) -> list[Lead]:
    """The best lead if it promises `least`, and far more than any at another place."""
    if not leads or leads[0].gain < least:
        return []
    others = [q.gain for q in leads if q.spot.place != leads[0].spot.place]
    return list(leads[:1]) if leads[0].gain > OUTSTANDING * max(others, default=0.0) else []


def _distinct(leads: Sequence[Lead]) -> list[Lead]:
    """The leads without those of the kind of an earlier one at its place."""
    out: list[Lead] = []
    for lead in leads:
        if not any(o.spot.place == lead.spot.place and alike(o.mechanism, lead.mechanism) for o in out):
            out.append(lead)
    return out


def asked(runs: Sequence[Run]) -> int:
    """Places at which a second law is asked for, in the order of what a force there explains."""
    return min(max(SAMPLES // sum(r.period for r in runs), ASKED[0]), ASKED[1])


ASKED, SAMPLES = (3, 16), 1_000_000
"""Places at which a second law is asked for, least and most; and samples of all runs together that so many may have.

How much a force explains tells little of where the second law acts, while the first has bent the base; and with two
sensors any two forces explain all. Laws tell, and those take a moment to ask where runs are short.
"""
LESS, OUTSTANDING = 1 / 3, 2.0
"""Part of the promise that is asked for of a lead which promises this many times what any at another place does: a
corner that is seldom reached shows along a motion that the first law has bent as a small part of what it is.
"""
TRIED = 3
"""Second laws that are fitted beside the first."""


def _again(lead: Lead, held: Sequence[Acting]) -> bool:
    """Whether a law of the same kind acts at the lead's place already: two of them say that it is neither."""
    here = [t.mechanism for t in held if np.array_equal(np.abs(t.column), np.abs(lead.spot.column))]
    return any(alike(lead.mechanism, m) for m in here)


def alike(a: str, b: str) -> bool:
    """Whether two laws at one place are of a kind."""
    return NAMES.get(a, a) == NAMES.get(b, b) or (a in YIELDING and b in YIELDING)


def with_one_more(made: Made, lead: Lead, engine: Engine) -> NDArray[np.float64]:
    """The vector of a fit with one more law, whose place moves as the base says."""
    base, laws = made.x[: made.n_base], made.x[made.n_base :]
    return np.concatenate([base, np.zeros(per_place(engine)), laws, lead.p[: lead.acting().n]])


def _with_one_more(o: Orbit | None) -> Orbit | None:
    """The orbit with a further force that is still zero."""
    if o is None:
        return None
    zero = np.zeros_like(o.force[:1])
    return Orbit(
        o.x, np.append(o.f, 0.0), np.vstack([o.memory, np.zeros_like(o.memory[:1])]), np.vstack([o.force, zero]),
        np.hstack([o.time, np.zeros((o.time.shape[0], 1))]),
        np.concatenate([o.motion, np.zeros((o.motion.shape[0], 1, 2))], axis=1), o.closing, tie=_free(o.tie),
    )  # fmt: skip


def _free(tie: Tie | None) -> Tie | None:
    """The tie with one more place, which it leaves alone."""
    if tie is None:
        return None
    zero = np.zeros((tie.motion.shape[0], 1, 2))
    return replace(tie, motion=np.concatenate([tie.motion, zero], axis=1), dashpot=np.append(tie.dashpot, 0.0))


LITTLE = 0.02
"""Chi-square per value below which a law is spared however sure it is: what marches and bases have wrong by a tenth of
the noise has a shape too."""


def needed(study: Study, laws: Sequence[Tried], scatter: Scatter, alarm: float, lines: int = 250) -> list[Tried]:
    """The laws of a chain without those that it can spare, each fitted with those before it.

    A law is spared where the others, fitted again, lose less than `alarm` without it, or next to nothing a value. The
    last fit of the chain that is left holds all of its laws, the one that is missed most first.
    """
    chosen = [choose_lines(r, lines, scatter.floor) for r in study.runs]
    fine = not tired()
    every = [replace(t, last=fine or t.last) for t in laws[-1].made.terms]
    steps = steps_of(every)  # for the others too, where one that asks for fine ones is left out

    def fitted(start: Tried, terms: Sequence[int]) -> Made | None:
        some = [replace(start.made.terms[i], last=fine or start.made.terms[i].last, steps=steps) for i in terms]
        joint = Joint(study.engine, study.point, study.runs, some, scatter, chosen)
        try:
            return fit(joint, _vector(start.made, terms), _orbits(start.made, terms), steps=10)
        except (EstimationError, np.linalg.LinAlgError):
            return None

    kept = [i for i in range(len(laws)) if acts(laws[-1].made, i)]
    last = laws[-1]
    whole = fitted(last, kept) if kept else None
    if whole is None:
        return list(laws)
    last = replace(last, made=whole)
    missed: dict[int, float] = {}
    while len(kept) > 1:
        without: dict[int, Made] = {}
        for i in kept:
            made = fitted(last, [j for j in range(len(last.made.terms)) if kept[j] != i])
            if made is not None:
                without[i] = made
        excess = max(1.0, last.made.data_part / last.made.count)
        missed = {i: (m.objective - last.made.objective) / excess for i, m in without.items()}
        if not missed:
            break
        least = min(missed, key=lambda i: missed[i])
        much = max(GAIN * max(last.made.objective - last.made.count, 0.0) / excess, LITTLE * last.made.count)
        if missed[least] > max(alarm, much):
            break
        kept.remove(least)
        last = replace(last, made=without[least])
    order = sorted(range(len(kept)), key=lambda j: -missed.get(kept[j], 0.0))
    out = []
    for n in range(1, len(order)):
        made = fitted(last, order[:n])
        if made is None:
            return list(laws)
        out.append(Tried(laws[kept[order[n - 1]]].lead, made, cost(made, laws[kept[order[n - 1]]].mechanism)))
    made = fitted(last, order)
    if made is None:
        return list(laws)
    out.append(Tried(laws[kept[order[-1]]].lead, made, cost(made, laws[kept[order[-1]]].mechanism)))
    out[-1] = finished(study, out[-1], scatter, chosen)
    return out


def acts(made: Made, i: int) -> bool:
    """Whether the i-th law has any strength; of the general law any term may hold it."""
    p = made.law(i)[0]
    return bool(np.any(p != 0.0)) if made.terms[i].mechanism == "general" else p[0] != 0.0


def finished(study: Study, last: Tried, scatter: Scatter, lines: Sequence[Lines]) -> Tried:
    """The last fit of a chain followed to its end, with finer steps and the slopes that standard deviations need."""
    bench = Bench(study.engine, study.point, study.runs, scatter, tuple(lines))
    return bench.carry_on(last, FINISH, always=True, last=not tired() or any(t.last for t in last.made.terms))


FINISH = 12
"""Steps of the last fit of several laws: one that ends early leaves their parameters where they began."""


def _vector(made: Made, terms: Sequence[int]) -> NDArray[np.float64]:
    """The fit's vector with the laws `terms` only, in that order."""
    m = (made.n_base - made.bare) // max(len(made.terms), 1)
    base = made.x[: made.n_base]
    motions = base[made.bare :].reshape(-1, m)[list(terms)].reshape(-1)
    cuts = made.n_base + np.cumsum([0, *(t.n for t in made.terms)])
    return np.concatenate([base[: made.bare], motions, *(made.x[cuts[i] : cuts[i + 1]] for i in terms)])


def _orbits(made: Made, terms: Sequence[int]) -> list[Orbit | None]:
    """The fit's orbits with the forces `terms` only."""
    at = list(terms)

    def some(o: Orbit) -> Orbit:
        tie = None if o.tie is None else replace(o.tie, motion=o.tie.motion[:, at], dashpot=o.tie.dashpot[at])
        return Orbit(o.x, o.f[at], o.memory[at], o.force[at], o.time[:, at], o.motion[:, at], o.closing, tie=tie)

    return [None if o is None else some(o) for o in made.orbits]
