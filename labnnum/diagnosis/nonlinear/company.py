"""Rivals of the first of several laws, beside the others: alone they differ by less than what the others explain."""

from __future__ import annotations

from collections.abc import Sequence

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, leads_of, of_fits
from labnnum.diagnosis.nonlinear.explore import LONG
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.scatter import Scatter

CLOSE, MOST = 1.5, 3
"""Cost, of the first law's alone, below which another is asked for beside the others; and how many are."""


def beside_others(study: Study, laws: Sequence[Tried], scatter: Scatter, lines: int = 250) -> tuple[Tried, ...]:
    """The rivals of the first of `laws`, each in its place beside the others, fitted as the last of `laws` was.

    Parameters
    ----------
    laws : sequence of Tried
        A chain, the last fit of which holds all its laws.
    lines : int
        Lines of a run that were compared in that fit.

    Returns
    -------
    tuple of Tried
        Those whose steady states are found; none where there is one law only.
    """
    if len(laws) < 2:
        return ()
    first, last = laws[0], laws[-1]
    acting = {(t.name, t.spot.place) for t in laws}
    alone = next((t.cost / t.made.count for t in study.tried if t.same(first)), first.cost / first.made.count)
    rivals = [
        t for t in study.tried
        if t.named and t.simulated and not t.more and (t.name, t.spot.place) not in acting
        and t.cost / t.made.count < CLOSE * alone
    ]  # fmt: skip
    bench = Bench(
        study.engine, study.point, study.runs, scatter,
        tuple(choose_lines(r, lines, scatter.floor) for r in study.runs),
    )  # fmt: skip
    held = leads_of(laws)[1:]
    out: list[Tried] = []
    for t in rivals[:MOST]:
        own = of_fits(t)[0]
        one = bench.both(last.made.x[: last.made.bare], [own, *held], LONG)
        if one is not None:
            one = bench.carry_on(one, LONG, last=last.made.terms[0].last)
            out.append(one)
    return tuple(out)
