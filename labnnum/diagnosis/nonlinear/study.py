"""Which nonlinear law acts, and where: what came nearest along the motion, simulated, and told apart on more lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, loudest, of_fit, tried_fit
from labnnum.diagnosis.nonlinear.effort import tired
from labnnum.diagnosis.nonlinear.explore import (
    LAWS,
    LINES,
    LONG,
    MISLED,
    NEAR,
    NOISY,
    STRAINED,
    Prospect,
    engine_start,
    looked,
    nearest,
)
from labnnum.diagnosis.nonlinear.fitting import Made, fit
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.laws import SHAPES
from labnnum.diagnosis.nonlinear.leads import general_lead, named_like, unnamed_like
from labnnum.diagnosis.nonlinear.locate import Background, Lead, Spot
from labnnum.diagnosis.nonlinear.loosen import in_step, in_step_already, tied
from labnnum.diagnosis.nonlinear.numbered import numbered
from labnnum.diagnosis.nonlinear.problem import KINKED, Joint, reduced, steps_of
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.stuck import rounded, spread
from labnnum.diagnosis.nonlinear.tempered import contest
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Place

ENOUGH = 1.15
"""Chi-square per value at which a law leaves nothing for a general one to explain."""
PROMISING = 0.85
"""Part of the best lead's gain above which another is simulated from where it stands."""


def search(
    seen: Prospect, progress: Callable[[str], None] = lambda text: None, *, unsure: bool = False
) -> Study | None:  # fmt: skip
    """The laws that came nearest along the recovered motion, fitted by simulation; a general law beside them.

    Where the base is `unsure` of motions that no sensor sees, as one that was identified is, so is what is recovered
    through it: the best leads are then simulated from where the score left them, too.
    """
    progress("fitting nonlinear laws")
    bench = seen.bench
    tried = simulated(bench, seen.near, None if unsure else seen.calm.x)
    tried = tried if unsure else with_rounded(bench, tried)
    if unsure and seen.leads:
        top = max(lead.gain for lead in seen.leads)
        some = [lead for lead in seen.leads if lead.gain > PROMISING * top and lead.mechanism != "hysteresis"]
        starts = (seen.calm.x, engine_start(bench.joint([])))
        straight = [bench.direct(starts, lead, LONG) for lead in sorted(some, key=lambda lead: -lead.gain)[:FRONT]]
        tried = sorted([*tried, *(t for t in straight if t is not None)], key=lambda t: t.cost)
    if not tried:
        return None
    pairs: tuple[Tried, ...] = ()
    if not (unsure or seen.sought or tired()) and tried[0].made.data_part > DOUBTFUL * tried[0].made.count:
        tried, pairs = contested(seen, tried, progress)
    best = tried[0].made
    law = None
    if best.data_part > ENOUGH * best.count:
        background = Background(bench.joint([]), seen.near[0].made.x[: seen.calm.n_base])
        general = [general_lead(background, q) for q in nearest(seen.recovered)]
        law = _general(bench, tried[0], general)
    return Study(
        bench.engine, bench.point, bench.runs, seen.base, seen.calm, tuple(tried), law, seen.recovered, pairs=pairs
    )  # fmt: skip


DOUBTFUL = 3.0
"""Chi-square per value that the best law leaves above which laws are sought from the quietest level's base, too."""


def contested(
    seen: Prospect, tried: list[Tried], progress: Callable[[str], None]
) -> tuple[list[Tried], tuple[Tried, ...]]:  # fmt: skip
    """The laws that were simulated, best first, and those that win from the base of the quietest level with a tolerance
    on every line first, which hold where the motion that is recovered misleads; and pairs of which that holds.
    """
    near, pairs = _from_afar(seen, progress)
    return plainer(sorted([*tried, *near], key=lambda t: t.cost)), pairs


def from_afar(seen: Prospect, progress: Callable[[str], None]) -> Prospect:
    """What the motions promise with the laws that win so, where none that was followed along the motion comes near."""
    near, pairs = _from_afar(seen, progress)
    return replace(seen, near=tuple(sorted([*seen.near, *near], key=lambda t: t.cost)), pairs=pairs or seen.pairs)


def _from_afar(seen: Prospect, progress: Callable[[str], None]) -> tuple[list[Tried], tuple[Tried, ...]]:
    bench = seen.bench
    plain = bench.joint([])
    x = engine_start(plain) if seen.misled else seen.calm.x
    look = partial(looked, plain, spots=[q.spot for q in seen.recovered])
    if seen.seen is not None and np.array_equal(seen.seen[0], x):
        _, found, leads = seen.seen
    else:
        found, leads = look(x)
    bent = seen.misled or seen.calm.prior_part > STRAINED * plain.n_base
    firm = () if bent else explained(bench, x)
    held = contest(replace(bench, firm=firm), x, found, LAWS, leads, progress, look)
    return with_rounded(bench, list(held.near)), held.pairs


def explained(bench: Bench, x: NDArray) -> tuple[int, ...]:
    """Numbers of the runs of which the base vector `x` alone leaves noise."""
    out = []
    for i, (run, lines) in enumerate(zip(bench.runs, bench.lines, strict=True)):
        one = replace(bench, runs=(run,), lines=(lines,)).joint([])
        r, b = one.parts(one.start(x), [None])
        if reduced(r, b)[0] < ALONE * r.size:
            out.append(i)
    return tuple(out)


ALONE = 1.3
"""Chi-square per value up to which the base alone explains a run."""


def of_known(
    engine: Engine, point: Point, runs: Sequence[Run], quiet: int, known: Sequence[Lead], scatter: Scatter,
    lines: int = 250,
) -> Study | None:  # fmt: skip
    """The laws that a model holds already, fitted with the base; None where they do not settle."""
    bench = Bench(engine, point, tuple(runs), scatter, ()).on(lines)
    plain = bench.joint([])
    base = fit(plain, plain.start(), [None] * len(runs), steps=12)
    joint = bench.joint(known)
    tried = tried_fit(joint, joint.start(), [None] * len(runs), known[0], 8)
    return None if tried is None else Study(engine, point, tuple(runs), base, base, (tried,), None, ())


FRONT = 4
"""Follows that are simulated, at most,"""
UNNAMED_FRONT = 2
"""and of laws that have no name;"""
FAR_FRONT = (2, 1)
"""the same where none comes near the noise."""
CLOSE = 1.5
"""Cost, of the least, below which a follow may turn out better when it is simulated."""


def simulated(bench: Bench, near: Sequence[Tried], calm: NDArray | None = None) -> list[Tried]:
    """The follows that came nearest fitted by simulation, then the others as they are.

    Where a simulation leaves too much, with finer steps too, and from the base of the quietest level, `calm` if given:
    a law may bend the base along the motion, and a strong one holds it so.
    """
    out: list[Tried] = []
    free: list[tuple[int, Tried]] = []
    best = np.inf
    again = 0
    far = near[0].made.data_part > NOISY * near[0].made.count
    most = FAR_FRONT if far else (FRONT, UNNAMED_FRONT)
    for t in near:
        enough = sum(o.simulated for o in out)
        alike = sum(o.simulated for o in out if o.named == t.named)
        level = CLOSE * (near[0].cost if _elsewhere(t, out) else min(best, near[0].cost))
        if alike >= most[0 if t.named else 1] or (enough and t.cost > level and t.cost > best):
            out.append(t)
            continue
        racing = bench.against(*(o for o in out if o.simulated))
        one = t if t.simulated else in_step(racing, t, LONG)
        if one is None:
            continue
        if calm is not None and not t.simulated and _bent(bench, one):
            other = racing.direct((calm,), of_fit(t), LONG, soften=False)
            one = one if other is None or other.cost > one.cost else other
        if calm is not None and _coarse(one) and again < FINELY and (t.simulated or t.cost < AGREES * one.cost):
            again += 1
            one = finely(bench, t, one)
        if one.named and not (t.simulated or in_step_already(one)):
            free.append((len(out), t))
        out.append(one)
        best = min(best, one.cost)
    level = CLOSE * min((t.cost for t in out), default=np.inf)
    if any(t.simulated and in_step_already(t) and t.cost < level for t in out) and not tired():
        for i, t in free:  # what was simulated freely has been judged by more
            if out[i].cost < level:
                out[i] = tied(bench, t, out[i]) or out[i]
    if not any(t.simulated for t in out):
        return []
    return plainer(sorted(out, key=lambda t: t.cost))


def _elsewhere(t: Tried, done: Sequence[Tried]) -> bool:
    """Whether a follow with a name is at a place at which none was simulated, and not more than one other place had its
    turn: what is left along the motion is compared with what others leave along theirs, not with a simulation.
    """
    places = {o.spot.place for o in done if o.simulated}
    return t.named and not t.simulated and t.spot.place not in places and len(places) < PLACES


PLACES = 2
"""Places at which the follows that came nearest are simulated, though a simulation elsewhere leaves far less."""

PLAINER = 1.05
"""Cost, of that of sliders whose limits are spread, up to which one slider is preferred to them, and dry friction to
what yields after next to no stroke."""


def plainer(tried: list[Tried]) -> list[Tried]:
    """The candidates without sliders whose limits are spread where one slider at that place does as well."""
    one = {t.spot.place: t.cost for t in reversed(tried) if t.mechanism == "stick-slip" and t.simulated}

    def surely(t: Tried) -> bool:
        most = t.cost + SURELY if t.made.data_part < ENOUGH * t.made.count else np.inf
        return one.get(t.spot.place, np.inf) > min(PLAINER * t.cost, most)

    return [t for t in tried if t.mechanism != "sliders" or surely(t)]


SURELY = 100.0
"""Chi-square that sliders whose limits are spread must explain more than one does, where they leave noise alone."""


FINELY, AGREES = 2, 0.5
"""Laws with corners that leave too much, of those that are simulated, which are simulated with finer steps too; and the
part of what a simulation leaves below which the motion that is measured says that the law explains more."""


def finely(bench: Bench, t: Tried, one: Tried) -> Tried:
    """A law that was followed, `t`, and simulated, `one`, simulated again with finer steps; the better of both."""
    again = one if t.simulated else bench.simulate(t, LONG, last=True)
    other = bench.carry_on(one, LONG, last=True) if again is None or _coarse(again) else again
    return min((x for x in (again, other) if x is not None), key=lambda x: x.cost)


def with_rounded(bench: Bench, tried: list[Tried]) -> list[Tried]:
    """The simulated laws, best first, with many sliders and hysteresis where one of their kind is the best and leaves
    more than noise: asked before anything is sought elsewhere, they may leave nothing for it.
    """
    best = tried[0] if tried else None
    if best is None or best.mechanism not in SLIDING or not best.simulated:
        return tried
    if best.made.data_part < ENOUGH * best.made.count:
        return tried
    have = {o.mechanism for o in tried if o.spot.place == best.spot.place and o.simulated}
    bench = bench.against(best)
    made: list[Tried | None] = []
    if best.name == "stick-slip" and "hysteresis" not in have:
        made.append(rounded(bench, best, LONG))
    if "sliders" not in have:
        made.append(spread(bench, best, LONG))
    more = [bench.carry_on(t, LONG, last=True) for t in made if t is not None]
    return plainer(sorted([*tried, *more], key=lambda t: t.cost))


SLIDING = ("stick-slip", "hysteresis", "sliders")
"""Laws that yield, at once or bit by bit."""


def corners(study: Study, tried: Sequence[Tried], scatter: Scatter, poor: float) -> Tried:
    """The best law; where it has corners and leaves more than `poor` times the noise, with finer steps."""
    best = tried[0]
    kinked = SHAPES[best.mechanism].law in KINKED and not best.made.terms[0].last
    if not kinked or not best.simulated or best.made.data_part < poor * best.made.count:
        return best
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE)
    finer = bench.carry_on(best, LONG, last=True)
    return finer if finer.cost < best.cost else best


BEGINNING, STRONGER = 6, (1.15, 1.35)
"""Steps of a law's fits from the calm base, of which the best is carried on; and by how much it is raised there."""
THOROUGH = 25
"""Steps of such a fit at most."""


def anew(study: Study, tried: Sequence[Tried], scatter: Scatter) -> Tried:
    """The best law; where it leaves more than noise, fitted again from the base of the quietest level."""
    best = tried[0]
    misled = study.quiet.data_part > MISLED * study.quiet.count  # then that base is another structure's
    if misled or not (best.simulated and best.named and best.made.data_part < NOISY * best.made.count):
        return best
    return from_calm(Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE), study.quiet.x, best)


def _bent(bench: Bench, one: Tried) -> bool:
    """Whether a simulated law leaves more than noise of periodic runs."""
    return one.named and one.made.data_part > UNSURE * one.made.count and all(r.lasting for r in bench.runs)


def from_calm(bench: Bench, calm: NDArray, one: Tried) -> Tried:
    """A simulated law that leaves more than noise of periodic runs, fitted again from the base of the quietest level,
    if that is better.

    On the way to a strong law's parameters the base bends, and the law then holds it so: here the law is fitted first
    while the base is held, and from the parameters that it has come to, and more of it.
    """
    if not _bent(bench, one):
        return one
    own = of_fit(one)
    held = bench.law_alone(calm, own, LONG)
    leads = [own, *(replace(own, p=_stronger(own, by)) for by in STRONGER), *([] if held is None else [of_fit(held)])]
    begun = [bench.against(one).again(calm, one, lead, BEGINNING) for lead in leads]
    near = min((t for t in begun if t is not None), key=lambda t: t.cost, default=None)
    if near is None or near.cost > NEAR * one.cost:
        return one
    made = bench.carry_on(near, THOROUGH, always=True, last=one.made.terms[0].last)
    return made if made.cost < one.cost else one


def _stronger(lead: Lead, by: float) -> NDArray[np.float64]:
    """The lead's parameters with its strength, and the limit of a force, raised."""
    p = lead.p.copy()
    p[0] *= by
    if SHAPES[lead.mechanism].law in ("stick-slip", "sliders"):
        p[1] *= by
    return p


def _coarse(t: Tried) -> bool:
    """Whether the steps may be what a simulated law leaves."""
    return t.simulated and SHAPES[t.mechanism].law in KINKED and t.made.data_part > COARSE * t.made.count


COARSE = 3.0
"""Chi-square per value that a law with corners leaves above which its steps are suspected."""


def _general(bench: Bench, best: Tried, leads: Sequence[Lead]) -> Tried | None:
    """The general law where it promises most and at the best candidate's spot, followed, and the better simulated."""
    leads = sorted((lead for lead in leads if lead.gain > 0), key=lambda lead: -lead.gain)
    own = next((g for g in leads if g.spot.place == best.spot.place), None)
    bench = bench.against(best)
    some = leads[:2] if own is None or own in leads[:2] else [*leads[:2], own]
    made = [bench.follow(best.made.x[: best.made.n_base], g, LONG) for g in some]
    near = sorted((t for t in made if t is not None), key=lambda t: t.cost)
    done = [in_step(bench, t, LONG) for t in near[:1]]
    return next((t for t in done if t is not None), None)


def at_places(
    study: Study, best: Tried, spots: Sequence[Spot | Lead], scatter: Scatter, lines: int = LINES
) -> list[Tried]:  # fmt: skip
    """The winning law at other spots, or with other parameters: followed, and simulated where that comes near.

    Where the winner leaves more than noise, so does the motion that is recovered through its base: what does not come
    near along it is then simulated as the winner stands.
    """
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(lines).against(best)
    x = best.made.x[: best.made.n_base]
    unsure = best.simulated and best.named and best.made.data_part > UNSURE * best.made.count
    out: list[Tried] = []
    for s in spots:
        lead = replace(of_fit(best), spot=s) if isinstance(s, Spot) else s
        one = bench.follow(x, lead, LONG)
        if one is not None and one.cost < CLOSE * best.cost:
            one = in_step(bench, one, LONG)
        elif unsure:
            one = bench.direct((x[: best.made.bare],), lead, LONG, soften=False) or one
        out += [one] if one is not None else []
    return out


UNSURE = 3.0
"""Chi-square per value that the winner leaves above which it is fitted anew, and the motion recovered through its base
is not relied on."""
FINER = 0.1
"""Part of what the base leaves below which a law is worth finer steps; they move the limit of dry friction."""
FINE = 350
"""Lines of a run on which the best laws are told apart, and their gain over the base is judged."""


def base_again(study: Study, scatter: Scatter, lines: int = FINE) -> Made:
    """The base fitted to as many lines as the best laws are: gains are differences on the same data."""
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(lines)
    return fit(bench.joint([]), study.base.x, [None] * len(study.runs), steps=6)


def refined(study: Study, scatter: Scatter, more: Sequence[Tried], lines: int = FINE, most: int = 2) -> list[Tried]:
    """All candidates, best first, the `most` best fitted on more lines so that near ones are told apart.

    Costs of the others are raised by what the best's own rose with the lines: they stay comparable.
    """
    everyone = sorted((t for t in [*study.tried, *more] if np.isfinite(t.cost)), key=lambda t: t.cost)
    front: list[Tried] = []
    for t in everyone:
        if not any(t.same(o) for o in front):
            front.append(t)
    shown = [t for t in front if t.simulated]
    if not shown:
        return []
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(lines)
    limit = shown[0].cost * 3 + 1e3
    kept = [*shown[:most], *[t for t in shown if t.named][:1]]  # the best name too, to be told from what has none
    kept = [t for i, t in enumerate(kept) if t not in kept[:i] and (t is shown[0] or t.cost < limit)]
    base = study.base.data_part / study.base.count
    last = shown[0].made.data_part < FINER * base * shown[0].made.count
    finer = any(t.made.terms[0].last for t in kept)  # then all that are compared with it

    def fine(t: Tried) -> bool:
        return last or (finer and t.mechanism != "coulomb-friction")

    long = [fine(t) and (_coarse(t) or not t.made.terms[0].last) for t in kept]
    done = [bench.carry_on(t, LONG if far else 4, last=fine(t)) for t, far in zip(kept, long, strict=True)]
    best = min(done, key=lambda t: t.cost)
    if not np.isfinite(best.cost):
        return []
    sure = bench.carry_on(best, 2, always=True, last=fine(best))
    done = [sure if t is best else t for t in done]
    ratio = sure.made.count / shown[0].made.count
    rest = [raised(t, ratio) for t in front if not any(t.same(o) for o in done)]
    near = sorted((t for t in rest if t.simulated and t.cost < BESIDE * sure.cost), key=lambda t: t.cost)
    for t in near[:most] if ratio > 1 else ():  # raised costs are not sure enough to tell these
        one = bench.carry_on(t, 4, last=fine(t))
        done.append(one)
        rest = [o for o in rest if not one.same(o)]
    ahead = sorted([*done, *(t for t in rest if t.simulated)], key=lambda t: t.cost)
    return [ahead[0], *sorted([*ahead[1:], *(t for t in rest if not t.simulated)], key=lambda t: t.cost)]


def raised(t: Tried, ratio: float) -> Tried:
    """A candidate with what its fit left raised to `ratio` times as many values, but for the base's price."""
    made = t.made
    more = replace(
        made, objective=ratio * made.objective, data_part=ratio * made.data_part, count=round(ratio * made.count)
    )  # fmt: skip
    return replace(t, made=more, cost=ratio * t.cost)


BESIDE = 1.01
"""Cost, of the best one's on more lines, below which another that was raised to as many is fitted on them too."""
HALVED, MOVED = 2, 0.01
"""How often the steps of the best law's march are halved at most, and the change of what it leaves, of that, from which
it is worth another fit."""


def fine_enough(study: Study, best: Tried, scatter: Scatter) -> Tried:
    """The best law fitted with shorter and shorter steps, until those leave as much with the same parameters, or more
    after the fit: then it is another steady state that was followed.
    """
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE)
    for _ in range(HALVED if best.simulated and best.made.terms[0].last else 0):
        terms = [replace(t, steps=2 * steps_of(best.made.terms)) for t in best.made.terms]
        joint = Joint(bench.engine, bench.point, bench.runs, terms, scatter, bench.lines)
        orbits = joint.settle(best.made.x, best.made.orbits, LONG)
        left = reduced(*joint.parts(best.made.x, orbits))[0]
        if abs(left - best.made.data_part) < MOVED * best.made.data_part:
            break
        finer = tried_fit(joint, best.made.x, orbits, best.lead, LONG, always=True, more=best.more)
        if finer is None or finer.cost > best.cost:
            break
        best = finer
    return best


def kindred(study: Study, tried: Sequence[Tried], best: Tried, scatter: Scatter) -> list[Tried]:
    """The law, and in its place, where it yields, hysteresis or sliders whose limits are spread; the best first.

    One that yields at once and leaves noise needs no other; what yields bit by bit has two names, and both are asked.
    So they are at other places where one that yields came as near, and the places are told apart by the form that
    leaves least at each: one slider tells them apart worse than what is there, if that yields bit by bit.
    """
    own = _forms(study, best, scatter)
    near: dict[Place, Tried] = {}
    if own[0][0].mechanism in SLIDING and not best.more:
        for t in sorted(tried, key=lambda t: t.cost):
            soft = t.mechanism in SLIDING and t.simulated and t.cost < CLOSELY * best.cost
            if soft and t.spot.place != best.spot.place:
                near.setdefault(t.spot.place, t)
    forms = [own, *(_forms(study, t, scatter) for t in list(near.values())[:PLACES])]
    return [t for front, _ in sorted(forms, key=lambda f: f[1]) for t in front]


CLOSELY = 1.05
"""Cost, of the best law's, up to which what yields at another place is asked in all its forms."""


def _forms(study: Study, best: Tried, scatter: Scatter) -> tuple[list[Tried], float]:
    """The forms of a law that yields, the one to be named first; and what the nearest leaves and costs, a value."""
    soft = best.mechanism in SLIDING and best.simulated and not best.more
    if not soft:
        return [best], best.cost / best.made.count
    far = {o.mechanism for o in study.tried if o.simulated and o.spot.place == best.spot.place and _behind(o, best)}
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE).against(best)
    made = [
        rounded(bench, best, BEGINNING) if best.mechanism != "hysteresis" and "hysteresis" not in far else None,
        spread(bench, best, BEGINNING) if best.mechanism != "sliders" and "sliders" not in far else None,
    ]
    made += [_dry(bench, best), _single(bench, best)]
    steps = steps_of([*best.made.terms, *(t.made.terms[0] for t in made if t is not None)])
    kin = [finely_carried(bench, t, steps) for t in made if t is not None and not _behind(t, best)]
    least = min(t.cost / t.made.count for t in [best, *kin])
    front = plainer(sorted([best, *kin], key=lambda t: t.cost))
    front = [*counted(bench, front[0]), *front]
    dry = [t for t in front if t.mechanism == "coulomb-friction" and t.cost < PLAINER * front[0].cost]
    return dry or front, least


def counted(bench: Bench, best: Tried) -> list[Tried]:
    """Sliders whose limits are spread, if they leave more than noise, as so many as explain clearly more."""
    if best.mechanism != "sliders" or best.made.data_part < ENOUGH * best.made.count:
        return []
    one = numbered(bench, best, BEGINNING)
    return [] if one is None else [finely_carried(bench, one, steps_of(best.made.terms))]


DRY = 0.05
"""Elastic stroke of what yields, of its largest motion, below which it is tried as dry friction, which has none."""


def _dry(bench: Bench, best: Tried) -> Tried | None:
    """Dry friction in place of what yields after next to no stroke."""
    p = of_fit(best).p
    stroke, force = (p[1], p[0] * p[1]) if best.mechanism == "hysteresis" else (p[1] / p[0], p[1])
    top = max((float(np.max(np.abs(o.motion[:, 0, 0]))) for o in best.made.orbits if o is not None), default=0.0)
    if not 0 < stroke < DRY * top:
        return None
    lead = Lead(best.spot, "coulomb-friction", np.eye(N_P)[0] * force, best.lead.gain)
    return bench.both(best.made.x[: best.made.bare], [lead], LONG)


NARROW = 0.1
"""Spread of sliders' limits below which one slider is tried in their place."""


def _single(bench: Bench, best: Tried) -> Tried | None:
    """One slider in place of many that let go at nearly the same force, with as fine steps."""
    p = of_fit(best).p
    if best.mechanism != "sliders" or p[2] > NARROW:
        return None
    lead = Lead(best.spot, "stick-slip", np.concatenate([p[:2], np.zeros(N_P - 2)]), best.lead.gain)
    joint = bench.joint_of([replace(lead.acting(), last=True, steps=steps_of(best.made.terms))])
    return tried_fit(joint, joint.start(best.made.x[: best.made.n_base]), [None] * len(bench.runs), lead, LONG)


def _behind(t: Tried, best: Tried) -> bool:
    """Whether a fit, on other lines perhaps, is so far behind the best that it need not be carried on."""
    return t.cost / t.made.count > NEAR * best.cost / best.made.count


def finely_carried(bench: Bench, t: Tried, steps: float) -> Tried:
    """A simulated fit carried on with as many steps to a period."""
    terms = [replace(one, last=True, steps=steps) for one in t.made.terms]
    joint = Joint(bench.engine, bench.point, bench.runs, terms, bench.scatter, bench.lines)
    return tried_fit(joint, t.made.x, t.made.orbits, t.lead, LONG, more=t.more) or t


def named_kin(study: Study, best: Tried, scatter: Scatter) -> list[Tried]:
    """The law, and the others with a name that are like it and were not simulated at its place; the best first."""
    loud = loudest(best, study.runs) if best.simulated and best.named else None
    if loud is None or best.more or best.mechanism not in LAWS:
        return [best]
    here = [t for t in study.tried if t.simulated and t.spot.place == best.spot.place]
    done = {t.mechanism for t in here if not _behind(t, best)} | {best.mechanism}
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE).against(best)
    made: list[Tried] = []
    for lead in named_like(best.lead, loud, [m for m in LAWS if m not in done]):
        one = bench.direct((best.made.x[: best.made.n_base],), lead, BEGINNING, soften=False)
        if one is not None and not _behind(one, best):
            made.append(bench.carry_on(one, LONG, last=best.made.terms[0].last))
    return sorted([best, *made], key=lambda t: t.cost)


def nameless_kin(study: Study, best: Tried, scatter: Scatter) -> Tried | None:
    """A law without a name that is like the best one, simulated in its place.

    Along a motion that the wrong law has shaped such a one may promise little: z|z| looks like play, and simulated from
    where the play ended it explains what that leaves.
    """
    if not (best.simulated and best.named) or best.more or not all(best.made.orbits):
        return None
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(FINE).against(best)
    loud = loudest(best, study.runs)
    assert loud is not None
    made: list[Tried] = []
    for lead in unnamed_like(best.lead, loud):
        one = bench.direct((best.made.x[: best.made.n_base],), lead, BEGINNING)
        if one is not None and not _behind(one, best):
            one = bench.carry_on(one, LONG, last=False)
        made += [one] if one is not None else []
    return min(made, key=lambda t: t.cost, default=None)
