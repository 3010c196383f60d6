"""The decision: from a selection of mechanisms to a verdict, and everything that supports it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import Fit, fit
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.prediction import errors_of, foretold, predicted, relative_error, trimmed
from labnnum.diagnosis.runs import nonlinear_signs
from labnnum.diagnosis.scale import with_scale
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.task import Candidate, Selection, choose_lines, dispersion, settled
from labnnum.diagnosis.unnamed import told_all
from labnnum.diagnosis.verdict import Alternative, Diagnosis, Limits, Named
from labnnum.diagnosis.words import next_experiment, summarise
from labnnum.diagnosis.worth import Judge, alarmed, improves, missing, one_law, spoilt, worthwhile
from labnnum.frf import Frf
from labnnum.mechanisms.base import Place, Term

SURE = 2.0
"""Gain of what is named, of the gain that an alarm needs: one sound structure in twenty gains that, and one in a
hundred a name."""
TOLD = 2.0
"""Deviations below which the strength of a law is not told from nothing."""
HELD = "several laws hold the place alike, and of none the strength is told: there it may be any other"
CHANGES = 0.1
"""Change of the FRFs with level, relative and beyond noise, that no sound structure shows."""


def same_answer(a: Term, b: Term) -> bool:
    """Whether two terms are one answer: the same mechanism at the same place, whatever the variant."""
    return a.mechanism.id == b.mechanism.id and a.place == b.place


def decide(
    engine: Engine, train: Frf, test: Frf, selection: Selection, scatter: Scatter, limits: Limits,
    observations: Sequence[Observation], general: Sequence[Term], gated: tuple[Named, ...] = (),
    raw: tuple[Frf, Frf] | None = None,
) -> Diagnosis:  # fmt: skip
    """The diagnosis that a selection ends in.

    Parameters
    ----------
    train, test : Frf
        What was fitted, and what no fit saw.
    selection : Selection
    observations : sequence of Observation
    general : sequence of Term
        The unnamed laws, for the report.
    gated : tuple of Named
        What was named before any fit.
    raw : (train, test), optional
        The FRFs before a drift was taken back: what the base model has to explain.
    """
    base = selection.chain[0]
    stage = selection.stages[0] if selection.stages else ()
    data, sharp = selection.data, selection.scatter
    lines = choose_lines(train, 400)  # here every peak must be met, whatever the number of rows
    measured = all(o.kind != "frf" for o in observations)
    plain_base = trimmed(engine, lines, base.fit, scatter)
    base_error = errors_of(engine, plain_base, train, test)
    selection = whole = alarmed(selection, limits, data, base_error[1])
    selection, plain_final, extended_error = worthwhile(
        engine,
        lines,
        data,
        selection,
        limits,
        scatter,
        (plain_base, base_error),
        Judge(lambda made: errors_of(engine, made, train, test), lambda made: foretold(engine, made, test, sharp)),
    )
    final = selection.chain[-1]
    score = (foretold(engine, base.fit, test, sharp), foretold(engine, final.fit, test, sharp))
    verdict, named, reason = _verdict(engine, selection, limits, data, measured, scatter)
    if named and not improves(selection, len(named), limits, data, base_error[1], extended_error[1], score):
        verdict, named, reason = (
            "unexplained",
            (),
            f"the best name, {named[0].term.mechanism.id} at {named[0].place},"
            " does not improve the prediction of data held out enough",
        )
    if len(named) > 1 and one_law(engine, lines, selection, limits, scatter, data, train, test, extended_error[1]):
        verdict, named, reason = (
            "unexplained",
            (),
            "one law at one place, which has no name, predicts as well as several",
        )
    if verdict == "unexplained" and not missing(engine, lines, selection, limits, scatter, data, train, test,
                                                 base_error, extended_error, measured, score):  # fmt: skip
        last = whole.chain[-1].fit  # several that were not worth their names may still predict what the base does not
        if (
            len(whole.chain) <= len(selection.chain)
            or errors_of(engine, trimmed(engine, lines, last, scatter), train, test)[1] > limits.doubt * base_error[1]
        ):
            verdict = "consistent"
    located = _located(selection)
    assert test.variance is not None
    noise = float(np.sqrt(np.mean(np.sum(test.variance, axis=2) / np.sum(np.abs(test.value) ** 2, axis=2))))
    if verdict == "consistent" and measured and base_error[1] > max(limits.sound, 3 * noise):
        verdict = "unexplained"
        reason = f"the updated model misses the data held out by {base_error[1]:.0%}, and nothing tried explains it"
    nonlinear = nonlinear_signs(observations)
    changes = nonlinear["level_dependence"]
    if verdict == "consistent" and changes is not None and changes > CHANGES:
        verdict = "unexplained"
        reason = f"the FRFs change by {changes:.0%} with level, which no linear structure does, and nothing explains it"
    besides = reason if gated and verdict == "unexplained" else ""
    told = bool(named)
    if gated:
        named = (*gated, *named)
        verdict = "measurement-fault" if named[0].term.mechanism.domain == "channel" else "missing-physics"
    place = named[0].place if named else None
    if verdict == "unexplained":
        place = selection.chain[1].last.place if reason == HELD else _best_place(selection, limits)
    alternatives = _alternatives(engine, stage, final, test, limits, named)
    source = final if told else base
    n = engine.theta0.size
    std = np.sqrt(np.diag(source.fit.covariance)[:n])
    if verdict == "consistent" and _moved(engine, base.fit):
        verdict = "parameters"
    if not told:
        extended_error = base_error
    if raw is not None:
        base_error = errors_of(engine, trimmed(engine, choose_lines(raw[0], 400), base.fit, scatter), *raw)
    detail = {
        "engine": engine, "data": data, "train": train, "test": test, "base": plain_base,
        "final": plain_final if told else plain_base, "selection": selection, "general": general, "reason": reason,
        "bayes": source.fit, "base_bayes": base.fit, "besides": besides,
    }  # fmt: skip
    shown = Diagnosis(
        verdict, named, place, alternatives, located, 1.0 / max(len(train.outputs) * len(train.inputs), 1), base_error,
        extended_error, noise, nonlinear, "", "", source.fit.point.theta, std,
        np.exp(source.fit.point.log_zeta), detail,
    )  # fmt: skip
    return replace(shown, next_experiment=next_experiment(shown, observations), summary=summarise(shown, observations))


def _moved(engine: Engine, made: Fit) -> bool:
    """Whether the data asked for parameters other than nominal, beyond two of their standard deviations."""
    n = engine.theta0.size
    std = np.sqrt(np.diag(made.covariance)[:n])
    return bool(np.any(np.abs(made.point.theta - engine.theta0) > 2 * std))


def _verdict(
    engine: Engine, selection: Selection, limits: Limits, data: Data, measured_noise: bool, scatter: Scatter
) -> tuple[str, tuple[Named, ...], str]:
    base, final = selection.chain[0], selection.chain[-1]
    if len(selection.chain) == 1:
        if spoilt(selection, limits, data):
            return "unexplained", (), "one channel or support that does something else explains what the model leaves"
        return "consistent", (), "no term gains more than a sound structure's scatter"
    stage, best = selection.stages[0], selection.chain[1]
    excess = dispersion(best.fit, data)
    if (base.cost - min(final.cost, best.cost)) / max(excess, 1.0) < SURE * limits.alarm:
        return (
            "unexplained",
            (),
            "the best name gains little more than scatter alone gives one sound structure in twenty",
        )
    total = (base.fit.objective - min(final.fit.objective, best.fit.objective)) / max(excess, 1.0)
    lead = _lead(engine, data, selection.scatter, stage, best, limits.name * excess) / excess
    law = selection.general
    if law is not None and len(selection.chain) == 2:
        behind = (best.cost - law.cost) / max(excess, 1.0)
        all_of_it = told_all(law, selection.chain, data, limits)  # and the name leaves more than a sound structure does
        if behind > (limits.alarm if all_of_it else max(limits.alarm, limits.behind * total * min(excess, 1.0))):
            return "unexplained", (), "a general law at one place explains far more than any named mechanism"
    elif law is not None:
        # beside one law that explains all several names must be clearly the simpler, beside another not clearly worse
        lead_over = limits.name if law.last.groups and settled(law.fit, data, limits) else -limits.name
        if (law.cost - final.cost) / max(excess, 1.0) < lead_over:
            return (
                "unexplained",
                (),
                "one law at one place, which has no name, explains it as well as several",
            )
    left = final.fit.objective / (2 * data.value.size)
    if measured_noise and left > limits.misfit and final.fit.objective > limits.remains * base.fit.objective:
        return "unexplained", (), "what the best mechanism leaves is far more than noise"
    answers = [(c.last.mechanism.id, c.last.place) for c in selection.chain[1:]]
    if len(set(answers)) < len(answers):
        return "unexplained", (), "it takes one mechanism twice at one place: the law there is another"
    whole = {node for _, p in answers for node in (p.id, p.to) if node is not None}
    if len(answers) > 2 and len(whole) <= 2 and all(p.kind != "channel" for _, p in answers):
        return "unexplained", (), "it takes several mechanisms between two nodes: the law there is another"
    if len(answers) > 2 and not settled(final.fit, data, limits):
        return "unexplained", (), "three mechanisms leave more than a sound structure does: they may stand for another"
    if lead < limits.name and len(selection.chain) == 2:
        return "unexplained", (), "two mechanisms explain it equally well"
    named = []
    for i, candidate in enumerate(selection.chain[1:]):
        rivals = selection.stages[i]
        named.append(named_of(final.fit, i + len(base.terms), _confidence(rivals, candidate), scatter))
    if len(named) == 1 and _any_strength(named[0], stage, best, limits.name * excess):
        return "unexplained", (), HELD
    verdict = "measurement-fault" if named[0].term.mechanism.domain == "channel" else "missing-physics"
    return verdict, tuple(named), ""


def _any_strength(named: Named, stage: Sequence[Candidate], best: Candidate, enough: float) -> bool:
    """Whether nothing of a law is told from nothing, and another law at its place explains as much: whatever holds a
    place far tighter than the structure does leaves the same response.
    """
    if told_at_all(named):
        return False
    return any(
        c.last.place == best.last.place
        and c.last.mechanism.id != best.last.mechanism.id
        and c.cost - best.cost < enough
        for c in stage
    )


def told_at_all(named: Named) -> bool:
    """Whether some parameter of a mechanism is told from nothing; one that has none is."""
    return not named.value.size or bool(np.any(np.abs(named.value) >= TOLD * named.std))


def _lead(
    engine: Engine, data: Data, scatter: Scatter, stage: Sequence[Candidate], best: Candidate, enough: float
) -> float:
    """How far the best stands before the next at another place; rivals are looked at while they tie."""
    for c in sorted((c for c in stage if c.last.place != best.last.place), key=lambda c: c.cost):
        if c.cost - best.cost >= enough or not _one_thing(engine, data, scatter, best, c):
            return c.cost - best.cost
    return np.inf


def _one_thing(engine: Engine, data: Data, scatter: Scatter, a: Candidate, b: Candidate) -> bool:
    """Whether two candidates that share a node are one thing under two names, such as the last spring of a chain and
    the wall that it is held by: fitted to the response of the other, one leaves less than two deviations.
    """
    nodes = [{c.last.place.id, c.last.place.to} - {None} for c in (a, b)]
    if "channel" in (a.last.place.kind, b.last.place.kind) or not nodes[0] & nodes[1]:
        return False
    value = engine.response(b.fit.point, b.fit.terms, data.s).value
    start = a.fit.point.vector()
    made = fit(engine, replace(data, value=value), a.fit.terms, scatter, start, steps=20, tolerance=0.01)
    return made.data_part < 4.0


def _confidence(stage: Sequence[Candidate], best: Candidate) -> float:
    """Posterior share of the best among all fitted candidates, each weighing exp(-cost / 2)."""
    answers: dict[tuple[str, Place], float] = {}
    for c in stage:
        key = (c.last.mechanism.id, c.last.place)
        answers[key] = min(answers.get(key, np.inf), c.cost)
    key = (best.last.mechanism.id, best.last.place)
    mine = answers[key] = min(answers.get(key, np.inf), best.cost)  # it may have been fitted after the stage
    weights = np.exp(-np.clip((np.array(list(answers.values())) - mine) / 2, -50, 700))
    return float(1.0 / weights.sum())


def named_of(made: Fit, i: int, confidence: float, scatter: Scatter) -> Named:
    """The i-th term of a fit, with its parameters and their standard deviations."""
    first = made.n_theta + sum(t.n for t in made.terms[:i])
    term = made.terms[i]
    at = slice(first, first + term.n)
    value, std = made.point.vector()[at], np.sqrt(np.diag(made.covariance)[at])
    return Named(term, value, with_scale(term.parameters, value, std, scatter.residue), confidence)


def _best_place(selection: Selection, limits: Limits) -> Place | None:
    """Where most is missing; None where nothing that acts at a place gains more than scatter does."""
    base, law = selection.chain[0], selection.general
    near = min((c.cost for c in (*selection.chain[:2], law) if c is not None), default=np.inf)
    if selection.free is not None and selection.free.cost < near:
        return selection.free.last.place
    if len(selection.chain) < 2:
        if law is not None and base.cost - law.cost > limits.alarm:
            return law.last.place
        least = limits.alarm / base.fit.objective
        return next((place for place, share in _located(selection) if share > least), None)
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
        error = relative_error(test, predicted(engine, c.fit, test))
        if c is best:
            why = "comes nearest of all that were tried, and is not enough for a name"
        elif gap < limits.name:
            why = f"explains the data as well as {best.last.mechanism.id} at {best.last.place} (chi-square + {gap:.1f})"
        else:
            why = f"leaves {gap:.0f} more in chi-square than {best.last.mechanism.id} at {best.last.place}"
        out.append(Alternative(c.last, error, c.cost, why))
        if len(out) == 6:
            break
    return tuple(out)
