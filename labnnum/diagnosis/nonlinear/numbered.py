"""How many sliders stand side by side, where that shows.

Each lets go at once: a loop of three has three corners, and many that stand for them leave a percent or so of it, which
a quiet measurement tells, and have other strengths.
"""

from __future__ import annotations

from dataclasses import replace

from labnnum.diagnosis.nonlinear.bench import Bench, Tried, of_fit
from labnnum.mechanisms.stick_slip import SLIDERS

FEWER = (2, 3, 4, 5, 6)
"""Numbers of sliders that are tried in place of many."""
CLEARLY = 1.05
"""Cost of many sliders, of that of fewer, up to which they are left as many."""


def numbered(bench: Bench, many: Tried, steps: int) -> Tried | None:
    """Sliders that are fewer than `many`, fitted in so many steps from where those are, if they leave clearly less.

    The first and the last to let go begin where those of the many are.
    """
    lead = of_fit(many)
    if lead.mechanism != "sliders" or lead.p[3] or many.more:
        return None
    made = []
    for n in FEWER:
        p = lead.p.copy()
        p[2:4] = min(p[2] * (1 - 1 / SLIDERS) / (1 - 1 / n), 1.0), n
        made.append(bench.again(many.made.x[: many.made.n_base], many, replace(lead, p=p), steps))
    best = min((t for t in made if t is not None), key=lambda t: t.cost, default=None)
    return best if best is not None and best.cost * CLEARLY < many.cost else None
