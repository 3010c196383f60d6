"""Diagnosis: what did the model leave out? From observations and a structure to a verdict that can be checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Data, Fit, Scatter, fit
from labnnum.diagnosis.gates import drifted, pass_gates
from labnnum.diagnosis.linear import Candidate, Selection, choose_lines, data_of, dispersion, select, settled
from labnnum.diagnosis.observe import Observation, pool
from labnnum.diagnosis.places import all_terms, places_of
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.search import broaden
from labnnum.diagnosis.verdict import Alternative, Diagnosis, Limits, Named
from labnnum.diagnosis.words import next_experiment, summarise
from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.mechanisms import CATALOGUE
from labnnum.mechanisms.base import Mechanism, Place, Term
from labnnum.mechanisms.extended import ExtendedStructure
from labnnum.mechanisms.local_law import LocalLaw, PairLaw
from labnnum.mechanisms.loose import LooseChannel, LooseSupport
from labnnum.structures.base import Structure

if TYPE_CHECKING:
    from labnnum.diagnosis.nonlinear.locate import Lead

UNNAMED: tuple[Mechanism, ...] = (LocalLaw(), PairLaw(), LooseChannel(), LooseSupport())
"""What may be missing without having a name."""


def diagnose(
    structure: Structure,
    observations: Sequence[Observation],
    held_out: Sequence[Observation] = (),
    *,
    places: Mapping[str, Sequence] | None = None,
    span: tuple[float, float] | None = None,
    scatter: Scatter | None = None,
    limits: Limits | None = None,
    catalogue: Sequence[Mechanism] = CATALOGUE,
    progress: Callable[[str], None] = lambda text: None,
    nonlinear: bool = True,
) -> Diagnosis:
    """Verdict on whether `structure` explains the observations, and if not, what is missing and where.

    Parameters
    ----------
    structure : Structure
        The nominal model; its parameters are updated with their priors.
    observations : sequence of Observation
        Training runs, see `labnnum.diagnosis.observe`.
    held_out : sequence of Observation
        Runs that no fit sees; where there are none, one run of several, or every fourth stretch of lines.
    places : mapping, optional
        The model's [places]: nodes, elements, supports.
    span : (low, high), optional
        Lines outside it, in Hz, are left out: where the model is not meant to hold.
    scatter : Scatter, optional
        Ordinary errors of a sound model and bench.
    limits : Limits, optional
        Thresholds of the decision.
    nonlinear : bool
        Whether nonlinear signs are looked for (periodic runs), and their law taken out before the linear search.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ModelError
        If the structure lacks a measured degree of freedom.
    """
    scatter, limits = scatter or Scatter(), limits or Limits()
    gate = pass_gates(observations)
    progress("estimating")
    train, test = _split(gate.usable, held_out)
    if span is not None:
        train, test = train.lines(*span), test.lines(*span)
    if train.frequency.size < 8:
        raise EstimationError(f"only {train.frequency.size} lines are left to compare the model with; 8 are needed")
    band = (float(train.omega[0]), float(train.omega[-1]))
    if len(train.inputs) > len(train.outputs):
        scatter = by_hand(scatter)
    inner, initial = _taken_apart(structure, train)
    engine = Engine(inner, train.outputs, train.inputs, band)
    where = places_of(engine, places)
    moving = drifted(engine, gate.usable)
    if nonlinear and not initial and moving is None:  # a change within the run stands on quiet lines as well
        from labnnum.diagnosis.nonlinear.merge import nonlinear_first

        again = partial(
            diagnose, structure, places=places, span=span, scatter=scatter, limits=limits, catalogue=catalogue,
            progress=progress, nonlinear=False,
        )  # fmt: skip
        whole = nonlinear_first(
            engine, gate, observations, held_out, where, scatter, limits, span, again, progress, _known(structure)
        )  # fmt: skip
        if whole is not None:
            return whole
    _, terms = all_terms(engine, where, catalogue)
    _, general = all_terms(engine, where, UNNAMED if catalogue else ())
    measured = all(o.kind != "frf" for o in observations)
    selection = select(
        engine, train, terms, general, scatter, limits, measured_noise=measured, initial=initial, progress=progress
    )
    progress("weighing the answer")
    gated = (*gate.named, *((moving,) if moving else ()))
    return _decide(engine, train, test, selection, scatter, limits, observations, general, gated)


def by_hand(scatter: Scatter) -> Scatter:
    """Scatter of a roving hammer: each input is a hit by hand, some millimetres off and not quite along its axis."""
    return replace(
        scatter, gain=max(scatter.gain, 0.1), shape=max(scatter.shape, 0.05), residue=max(scatter.residue, 0.05)
    )


def _taken_apart(structure: Structure, train: Frf) -> tuple[Structure, list[tuple[Term, NDArray]]]:
    """An extended structure as its inner one and the terms that it holds; any other as it is."""
    if not isinstance(structure, ExtendedStructure):
        return structure, []
    names = [c.name for c in (*train.outputs, *train.inputs)]
    initial = []
    for added in structure.added:
        term = added.term
        if term.place.kind == "channel":
            if term.place.id not in names:
                continue
            at = names.index(term.place.id)
            if term.variant == "inverted":
                term = replace(term, data={"invert": at})
            elif term.place.to in names:
                term = replace(term, data={"swap": (at, names.index(term.place.to))})
            else:
                term = replace(term, data={"channel": at})
        initial.append((term, np.array([p.nominal for p in added.parameters])))
    return structure.inner, initial


def _known(structure: Structure) -> list[Lead]:
    """Nonlinear laws that the structure holds."""
    from labnnum.diagnosis.nonlinear.locate import Lead, Spot
    from labnnum.diagnosis.nonlinear.march import N_P

    out = []
    for law in structure.laws if isinstance(structure, ExtendedStructure) else ():
        p = np.zeros(N_P)
        p[: len(law.parameters)] = [q.nominal for q in law.parameters]
        term, column = law.term, np.asarray(law.term.data["column"], float)
        reverse = term.variant.startswith("-")
        out.append(Lead(Spot(term.place, term.variant, -column if reverse else column), term.mechanism.id, p, 0.0))
    return out


# -------------------------------------------------------------------- data


def _split(observations: Sequence[Observation], held_out: Sequence[Observation]) -> tuple[Frf, Frf]:
    """Training and held-out FRFs."""
    if held_out:
        return pool(observations), pool(held_out)
    if len(observations) > 1:
        kept = _kept_back(observations)
        rest = [o for i, o in enumerate(observations) if i not in kept]
        return pool(rest), pool([observations[i] for i in sorted(kept)])
    frf = observations[0].frf
    if frf.frequency.size < 24:
        return frf, frf
    block = max(frf.frequency.size // 60, 1)
    back = (np.arange(frf.frequency.size) // block) % 4 == 2
    return frf.at(~back), frf.at(back)


def _kept_back(observations: Sequence[Observation]) -> set[int]:
    """Numbers of the runs held out: the last of each level that was repeated, else the last run."""
    groups: dict[int, list[int]] = {}
    for i, o in enumerate(observations):
        key = round(10 * np.log10(o.level)) if np.isfinite(o.level) and o.level > 0 else 0
        groups.setdefault(key, []).append(i)
    repeated = [g[-1] for g in groups.values() if len(g) > 1]
    return set(repeated) if repeated else {len(observations) - 1}


def relative_error(measured: NDArray, model: NDArray) -> float:
    """Relative RMS error over lines, root mean square over rows."""
    m = measured.reshape(-1, measured.shape[-1])
    e = (measured - model).reshape(m.shape)
    return float(np.sqrt(np.mean(np.sum(np.abs(e) ** 2, axis=1) / np.sum(np.abs(m) ** 2, axis=1))))


def _errors(engine: Engine, made: Fit, train: Frf, test: Frf) -> tuple[float, float]:
    return tuple(relative_error(f.value, predicted(engine, made, f)) for f in (train, test))  # type: ignore[return-value]


def predicted(engine: Engine, made: Fit, frf: Frf) -> NDArray[np.complex128]:
    """FRFs of a fitted model on the lines and channels of `frf`, which need not be those it was fitted to."""
    s = float(frf.settings.get("window_decay", 0.0)) + 1j * frf.omega
    point = made.point
    if [c.name for c in frf.inputs] != [c.name for c in engine.inputs] or len(frf.outputs) != len(engine.outputs):
        other = Engine(engine.structure, frf.outputs, frf.inputs, engine.band)
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
    none = np.zeros_like(made.point.shift)
    starts = [made.point, replace(made.point, shift=none, size=none)]
    starts.append(replace(starts[1], theta=engine.theta0))
    found = [replace(made, terms=terms, point=_within(made.point, use))]
    for start in starts:
        rough = start.vector()
        for kappa in (0.015, 0.004):
            rough = fit(engine, broaden(engine, data, start, terms, kappa), terms, use, rough, steps=8).point.vector()
        found += [fit(engine, data, terms, use, x, steps=25) for x in (start.vector(), rough)]
    return min(found, key=lambda f: relative_error(frf.value, predicted(engine, f, frf)))


def _within(point: Point, use: Scatter) -> Point:
    """The point, its modal frequencies and loads within what a sound model needs."""
    reach = use.trim * np.array([use.frequency, use.residue])
    return replace(
        point, shift=np.clip(point.shift, -reach[0], reach[0]), size=np.clip(point.size, -reach[1], reach[1])
    )


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


# -------------------------------------------------------------------- decision


def same_answer(a: Term, b: Term) -> bool:
    """Whether two terms are one answer: the same mechanism at the same place, whatever the variant."""
    return a.mechanism.id == b.mechanism.id and a.place == b.place


def _decide(
    engine: Engine, train: Frf, test: Frf, selection: Selection, scatter: Scatter, limits: Limits,
    observations: Sequence[Observation], general: Sequence[Term], gated: tuple[Named, ...] = (),
) -> Diagnosis:  # fmt: skip
    base = selection.chain[0]
    stage = selection.stages[0] if selection.stages else ()
    data = data_of(choose_lines(train), scatter)
    lines = choose_lines(train, 400)  # here every peak must be met, whatever the number of rows
    measured = all(o.kind != "frf" for o in observations)
    plain_base = trimmed(engine, lines, base.fit, scatter)
    base_error = _errors(engine, plain_base, train, test)
    selection = _alarmed(selection, limits, data, base_error[1])
    selection, plain_final, extended_error = _worthwhile(
        engine,
        lines,
        data,
        selection,
        limits,
        scatter,
        (plain_base, base_error),
        lambda made: _errors(engine, made, train, test),
    )
    final = selection.chain[-1]
    verdict, named, reason = _verdict(selection, limits, data, measured)
    if named and not _improves(selection, len(named), limits, data, base_error[1], extended_error[1]):
        verdict, named, reason = (
            "unexplained",
            (),
            f"the best name, {named[0].term.mechanism.id} at {named[0].place},"
            " does not improve the prediction of data held out enough",
        )
    if len(named) > 1 and _one_law(engine, lines, selection, limits, scatter, data, train, test, extended_error[1]):
        verdict, named, reason = (
            "unexplained",
            (),
            "one law at one place, which has no name, predicts as well as several",
        )
    if verdict == "unexplained" and not _missing(engine, lines, selection, limits, scatter, data, train, test,
                                                 base_error, extended_error, measured):  # fmt: skip
        verdict = "consistent"
    located = _located(selection)
    noise = float(np.sqrt(np.mean(np.sum(test.variance, axis=2) / np.sum(np.abs(test.value) ** 2, axis=2))))  # pyright: ignore[reportArgumentType, reportCallIssue]
    if verdict == "consistent" and measured and base_error[1] > max(limits.sound, 3 * noise):
        verdict = "unexplained"
        reason = f"the updated model misses the data held out by {base_error[1]:.0%}, and nothing tried explains it"
    if gated:
        named = (*gated, *named)
        verdict = "measurement-fault" if named[0].term.mechanism.domain == "channel" else "missing-physics"
    place = named[0].place if named else None
    if verdict == "unexplained":
        place = _best_place(selection)
    alternatives = _alternatives(engine, stage, final, test, limits, named)
    source = final if named else base
    n = engine.theta0.size
    std = np.sqrt(np.diag(source.fit.covariance)[:n])
    if verdict == "consistent" and _moved(engine, base.fit):
        verdict = "parameters"
    if len(named) == len(gated):
        extended_error = base_error
    detail = {
        "engine": engine, "data": data, "train": train, "test": test, "base": plain_base,
        "final": plain_final if named else plain_base, "selection": selection, "general": general, "reason": reason,
        "bayes": source.fit, "base_bayes": base.fit,
    }  # fmt: skip
    nonlinear = _nonlinear(observations)
    shown = Diagnosis(
        verdict, named, place, alternatives, located, 1.0 / max(len(train.outputs) * len(train.inputs), 1), base_error,
        extended_error, noise, nonlinear, "", "", source.fit.point.theta, std,
        np.exp(source.fit.point.log_zeta), detail,
    )  # fmt: skip
    return replace(shown, next_experiment=next_experiment(shown, observations), summary=summarise(shown))


def _improves(
    selection: Selection, n: int, limits: Limits, data: Data, base_error: float, extended_error: float
) -> bool:
    """Whether `n` names are worth it: the prediction is better, or a misfit that no sound model has is gone.

    A fault of a few lines, such as an appendage's notch, hardly shows in an error over all lines.
    """
    if extended_error <= limits.improve**n * base_error:
        return True
    base, final = selection.chain[0].fit, selection.chain[-1].fit
    evident = base.objective > limits.misfit * 2 * data.value.size and settled(final, data, limits)
    return evident and extended_error <= 1.05 * base_error


def _one_law(
    engine: Engine, lines: Frf, selection: Selection, limits: Limits, scatter: Scatter, data: Data, train: Frf,
    test: Frf, error: float,
) -> bool:  # fmt: skip
    """Whether one unnamed local law explains the data, and predicts nearly as well as several names do."""
    law = selection.general
    if law is None or not law.last.groups or not settled(law.fit, data, limits):
        return False
    return error > limits.improve_further * _errors(engine, trimmed(engine, lines, law.fit, scatter), train, test)[1]


def _alarmed(selection: Selection, limits: Limits, data: Data, error: float) -> Selection:
    """The selection without its chain where the first gain is too small for how well the base predicts already.

    What a sound model leaves of the data is smooth, and some mechanism always explains a part of it: that gain is
    discounted where the base predicts well. What the base had to ask of modal frequencies and loads counts in full.
    """
    if len(selection.chain) < 2:
        return selection
    base, first = selection.chain[:2]
    asked = max(base.fit.prior_part - first.fit.prior_part, 0.0)
    smooth = (base.cost - first.cost - asked) / max(dispersion(first.fit, data), 1.0)
    enough = smooth / max(1.0, limits.plain / max(error, 1e-9)) + asked >= limits.alarm
    return selection if enough else replace(selection, chain=(base,))


def _worthwhile(
    engine: Engine, lines: Frf, data: Data, selection: Selection, limits: Limits, scatter: Scatter,
    base: tuple[Fit, tuple[float, float]], errors: Callable[[Fit], tuple[float, float]],
) -> tuple[Selection, Fit, tuple[float, float]]:  # fmt: skip
    """The chain as far as each further mechanism improves the prediction; its model as used, and its errors."""
    chain = list(selection.chain[:1])
    base_terms = chain[0].terms
    idle: list[bool] = []
    plain, error = base
    tried = [(c, trimmed(engine, lines, c.fit, scatter)) for c in selection.chain[1:]]
    for i, (_, made) in enumerate(tried):
        told, passed = errors(made), i + 1 - len(idle)
        if i and told[1] > min(limits.improve_further**passed * error[1], limits.improve ** (i + 1) * base[1][1]):
            continue  # a later one may show what this one began
        idle += [False] * (passed - 1) + [told[1] > 0.95 * error[1]]
        chain += [c for c, _ in tried[len(chain) - 1 : i + 1]]
        plain, error = made, told
    alone = [True] * (len(idle) - 1) + [False]
    for drop in (alone, [*idle[:-1], False]) if len(chain) > 2 else ():
        if not any(drop):
            continue
        leaner = _without(engine, data, chain, drop, scatter)
        made = trimmed(engine, lines, leaner.fit, scatter)
        told = errors(made)
        if told[1] <= 1.1 * error[1]:
            kept = [i for i, dropped in enumerate(drop) if not dropped]
            stages = tuple(selection.stages[i] for i in kept)
            steps = [_cut(leaner, len(base_terms) + i + 1) for i in range(len(kept))]
            return replace(selection, chain=(chain[0], *steps[:-1], leaner), stages=stages), made, told
    return replace(selection, chain=tuple(chain), stages=selection.stages[: max(len(chain) - 1, 1)]), plain, error


def _without(
    engine: Engine, data: Data, chain: Sequence[Candidate], drop: Sequence[bool], scatter: Scatter
) -> Candidate:
    """The last model without the terms marked in `drop`, one flag a step of the chain, fitted anew."""
    last, n = chain[-1], len(chain[0].terms)
    terms, values, at = [], [], 0
    for i, term in enumerate(last.terms):
        p = last.fit.point.terms[at : at + term.n]
        at += term.n
        if i < n or not drop[i - n]:
            terms.append(term)
            values.append(p)
    point = replace(last.fit.point, terms=np.concatenate([np.empty(0), *values]))
    made = fit(engine, data, terms, scatter, point.vector(), steps=25)
    return Candidate(tuple(terms), made, last.cost)


def _cut(candidate: Candidate, n: int) -> Candidate:
    """The candidate with its first `n` terms named, its fit as it is."""
    return replace(candidate, terms=candidate.terms[:n])


def _missing(
    engine: Engine, lines: Frf, selection: Selection, limits: Limits, scatter: Scatter, data: Data, train: Frf,
    test: Frf, base_error: tuple[float, float], extended_error: tuple[float, float], measured: bool,
) -> bool:  # fmt: skip
    """Whether something is missing though it has no name: the base is far off, or some extension predicts better."""
    if measured and selection.chain[0].fit.objective > limits.misfit * 2 * data.value.size:
        return True
    if extended_error[1] < limits.doubt * base_error[1]:
        return True
    law = selection.general
    if law is None:
        return False
    return _errors(engine, trimmed(engine, lines, law.fit, scatter), train, test)[1] < limits.doubt * base_error[1]


def _moved(engine: Engine, made: Fit) -> bool:
    """Whether the data asked for parameters other than nominal, beyond two of their standard deviations."""
    n = engine.theta0.size
    std = np.sqrt(np.diag(made.covariance)[:n])
    return bool(np.any(np.abs(made.point.theta - engine.theta0) > 2 * std))


def _verdict(
    selection: Selection, limits: Limits, data: Data, measured_noise: bool
) -> tuple[str, tuple[Named, ...], str]:
    base, final = selection.chain[0], selection.chain[-1]
    if len(selection.chain) == 1:
        return "consistent", (), "no term gains more than a sound structure's scatter"
    stage, best = selection.stages[0], selection.chain[1]
    excess = dispersion(best.fit, data)
    total = (base.fit.objective - min(final.fit.objective, best.fit.objective)) / excess
    lead = _lead(stage, best) / excess
    law = selection.general
    if law is not None and len(selection.chain) == 2:
        if (best.cost - law.cost) / max(excess, 1.0) > max(limits.alarm, limits.behind * total):
            return "unexplained", (), "a general law at one place explains far more than any named mechanism"
    elif law is not None and (final.cost - law.cost) / max(excess, 1.0) > limits.name:
        return "unexplained", (), "one law at one place, which has no name, explains it better than several that have"
    left = final.fit.objective / (2 * data.value.size)
    if measured_noise and left > limits.misfit and final.fit.objective > limits.remains * base.fit.objective:
        return "unexplained", (), "what the best mechanism leaves is far more than noise"
    answers = [(c.last.mechanism.id, c.last.place) for c in selection.chain[1:]]
    if len(set(answers)) < len(answers):
        return "unexplained", (), "it takes one mechanism twice at one place: the law there is another"
    whole = {node for _, p in answers for node in (p.id, p.to) if node is not None}
    if len(answers) > 2 and len(whole) == 2 and all(p.kind != "channel" for _, p in answers):
        return "unexplained", (), "it takes several mechanisms between two nodes: the law there is another"
    if lead < limits.name and len(selection.chain) == 2:
        return "unexplained", (), "two mechanisms explain it equally well"
    named = []
    for i, candidate in enumerate(selection.chain[1:]):
        rivals = selection.stages[i]
        named.append(_named(final.fit, i + len(base.terms), _confidence(rivals, candidate)))
    verdict = "measurement-fault" if named[0].term.mechanism.domain == "channel" else "missing-physics"
    return verdict, tuple(named), ""


def _lead(stage: Sequence[Candidate], best: Candidate) -> float:
    """How far the best stands before the next at another place."""
    others = [c.cost for c in stage if c.last.place != best.last.place]
    return min(others) - best.cost if others else np.inf


def _confidence(stage: Sequence[Candidate], best: Candidate) -> float:
    """Posterior share of the best among all fitted candidates, each weighing exp(-cost / 2)."""
    answers: dict[tuple[str, Place], float] = {}
    for c in stage:
        key = (c.last.mechanism.id, c.last.place)
        answers[key] = min(answers.get(key, np.inf), c.cost)
    mine = answers[(best.last.mechanism.id, best.last.place)]
    weights = np.exp(-np.clip((np.array(list(answers.values())) - mine) / 2, -50, 700))
    return float(1.0 / weights.sum())


def _named(made: Fit, i: int, confidence: float) -> Named:
    first = made.n_theta + sum(t.n for t in made.terms[:i])
    term = made.terms[i]
    at = slice(first, first + term.n)
    return Named(term, made.point.vector()[at], np.sqrt(np.diag(made.covariance)[at]), confidence)


def _best_place(selection: Selection) -> Place | None:
    law = selection.general
    if len(selection.chain) < 2:
        found = _located(selection)
        return found[0][0] if found else None
    best = selection.chain[1]
    if law is not None and law.cost < best.cost:
        return law.last.place
    return best.last.place


def _located(selection: Selection) -> tuple[tuple[Place, float], ...]:
    """Places by the share of the base's objective that the best term there removes."""
    total = selection.chain[0].fit.objective
    rows = [(p, max(g, 0.0) / total) for p, g in selection.gains.items()]
    return tuple(sorted(rows, key=lambda row: -row[1])[:10])


def _alternatives(
    engine: Engine, stage: Sequence[Candidate], final: Candidate, test: Frf, limits: Limits, named: Sequence[Named]
) -> tuple[Alternative, ...]:
    out: list[Alternative] = []
    if not stage:
        return ()
    best = stage[0]
    for c in stage:
        if any(same_answer(c.last, n.term) for n in named) or any(same_answer(c.last, a.term) for a in out):
            continue
        gap = c.cost - best.cost
        error = relative_error(test.value, predicted(engine, c.fit, test))
        if gap < limits.name:
            why = f"explains the data as well as {best.last.mechanism.id} at {best.last.place} (chi-square + {gap:.1f})"
        else:
            why = f"leaves {gap:.0f} more in chi-square than {best.last.mechanism.id} at {best.last.place}"
        out.append(Alternative(c.last, error, c.cost, why))
        if len(out) == 6:
            break
    return tuple(out)


def _nonlinear(observations: Sequence[Observation]) -> dict[str, float | None]:
    """Level dependence and distortion over all runs; None where the excitation cannot tell."""
    odd = [float(np.max(o.distortion["odd"])) for o in observations if "odd" in o.distortion]
    even = [float(np.max(o.distortion["even"])) for o in observations if "even" in o.distortion]
    return {
        "level_dependence": level_dependence(observations),
        "odd_distortion_db": max(odd) if odd else None,
        "even_distortion_db": max(even) if even else None,
    }


def level_dependence(observations: Sequence[Observation]) -> float | None:
    """Relative RMS change of the FRFs from the lowest to the highest level, noise taken out; None with one level."""
    known = sorted((o for o in observations if np.isfinite(o.level) and o.level > 0), key=lambda o: o.level)
    if len(known) < 2 or known[-1].level < 1.2 * known[0].level:
        return None
    low, high = known[0].frf, known[-1].frf
    shared, i, j = np.intersect1d(np.round(low.frequency, 6), np.round(high.frequency, 6), return_indices=True)
    if shared.size < 8:
        return None
    a, b = low.value[..., i], high.value[..., j]
    noise = 0.0
    for frf, at in ((low, i), (high, j)):
        if frf.variance is not None:
            noise = noise + np.sum(frf.variance[..., at])
    power = max(float(np.sum(np.abs(a - b) ** 2) - noise), 0.0)
    return float(np.sqrt(power / np.sum(np.abs(a) ** 2)))
