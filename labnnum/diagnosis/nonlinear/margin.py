"""How far the first choice among single laws stands before the others: each fitted by simulation to the same runs."""

from __future__ import annotations

from dataclasses import replace

from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.study import FINE, LONG, Bench, Tried
from labnnum.diagnosis.scatter import Scatter


def single_laws(found: NonlinearAnswer, scatter: Scatter, lines: int = FINE) -> list[NonlinearAnswer]:
    """The answer with one law alone, for each law that was a candidate at the first selection, best first.

    Every candidate is fitted by simulation here, those too that the search had left where the recovered motion put
    them, so that `labnnum.diagnosis.nonlinear.predict.response` tells what each predicts of a record that no fit saw.

    Parameters
    ----------
    found : NonlinearAnswer
    scatter : Scatter
        Of the base model, as in the diagnosis.
    lines : int
        Lines of a run that are fitted.

    Returns
    -------
    list of NonlinearAnswer
        `laws` holds the one law; laws that come to no steady state are left out.
    """
    study = found.study
    bench = Bench(study.engine, study.point, study.runs, scatter, ()).on(lines)
    best: dict[str, Tried] = {}
    for t in study.tried:
        best.setdefault(t.mechanism, t)
    fitted = [bench.carry_on(t, LONG) if t.simulated else bench.simulate(t, LONG) for t in best.values()]
    done = sorted((t for t in fitted if t is not None), key=lambda t: t.cost)
    return [replace(found, laws=(t,)) for t in done]
