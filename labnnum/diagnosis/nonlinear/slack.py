"""Tolerances on every line, relative to the response around it, and what is carried from one to the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from labnnum.diagnosis.nonlinear.bench import Bench, Tried
from labnnum.diagnosis.nonlinear.laws import SHAPES
from labnnum.diagnosis.nonlinear.lines import NEAR, Lines
from labnnum.diagnosis.nonlinear.problem import KINKED
from labnnum.diagnosis.nonlinear.run import Run

LADDER = (0.3, 0.1, 0.03, 0.01)
"""Tolerances, relative to the response around a line, from the widest on."""
CLOSELY = 30.0
"""Part of the tolerance to which a steady state is followed;"""
ROUGHLY = 3.0
"""the same where a law is only looked at."""
BRIEF, STEPS, LAST = 3, 6, 12
"""Steps of the first fit of a law, of one with a tolerance, and of the one without."""
SETTLED = 20
"""Steps at most of the fits with the widest tolerance: from there on a law must not be far off."""
UNFIT = 1.0
"""Chi-square per value that the base alone leaves with the widest tolerance that is asked for."""
PAYS = 4.0
"""Price of the base, of its entries, from which on a law has bent it."""
FAR = 3.0
"""Cost, of the least, above which a law is not carried on."""
BEGUN, CARRIED, ENDED = 6, 3, 2
"""Laws that are fitted with the widest tolerance, with the next, and to the end, at most;"""
BOTH = 10
"""and with the widest one where two bases show them."""


def slackened(bench: Bench, slack: float) -> Bench:
    """The bench with a tolerance of `slack` of the response around each line of the runs that do not hold the base."""
    pairs = enumerate(zip(bench.runs, bench.lines, strict=True))
    lines = tuple(own if i in bench.firm else _slackened(run, own, slack) for i, (run, own) in pairs)
    return replace(bench, lines=lines, closing=bench.closing if bench.firm else max(bench.closing, slack / CLOSELY))


def _slackened(run: Run, lines: Lines, slack: float) -> Lines:
    """Lines with the tolerance; those that are not excited have the part of it that their own response asks for, and
    of the widest as much as the excited ones, since a law of another size distorts otherwise.
    """
    power = np.abs(run.seen(run.y)) ** 2
    near = max(NEAR, int(2 * slack * np.median(lines.at)))
    around = uniform_filter1d(power, near, axis=1, mode="nearest")
    quiet = np.flatnonzero(run.quiet)
    if quiet.size:
        own = uniform_filter1d(power[:, quiet], max(NEAR, near * quiet.size // run.u.size), axis=1, mode="nearest")
        around[:, quiet] = np.maximum(own, (slack / LADDER[0]) ** 2 * around[:, quiet])
    return Lines(lines.at, np.hypot(lines.sigma, slack * np.sqrt(around[:, lines.at])), lines.windowed)


ROUGH = 0.1
"""Tolerance below which laws with jumps or corners are simulated with fine steps: what coarse ones have wrong would
bend the base."""


def sharp(t: Tried) -> bool:
    """Whether the force of one of its laws jumps or has corners."""
    laws = [lead.mechanism for lead in (t.lead, *t.more)]
    return any(law == "coulomb-friction" or SHAPES[law].law in KINKED for law in laws)


def within(one: Tried, most: float) -> bool:
    """Whether a law leaves less than `most` a value and bends no base."""
    return one.made.data_part < most * one.made.count and one.made.prior_part < PAYS * one.made.n_base


def nearest_of(tried: list[Tried], most: int, far: float = FAR) -> list[Tried]:
    """The best, as far as they are near the first."""
    tried = sorted(tried, key=lambda t: t.cost)
    return [t for t in tried[:most] if t.cost < far * tried[0].cost]
