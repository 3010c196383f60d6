"""The table of measures: what is counted, over which cases, and what is to be reached."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sessions.prove.answers import Judged
from sessions.prove.intervals import Share, count, half_point

VISIBLE = 3.0
"""Times the null median that the base model's held-out chi2 must exceed."""
NINETY = 1.6449


@dataclass(frozen=True)
class Scored:
    """One case with its truth, what the answer was worth, how visible each fault was, and the time it took.

    `visibility` is the updated base model's chi2 over the null median of its kind of structure, by the referee;
    `alone` the same for every fault on its own; `error` says why there is no answer.
    """

    truth: Mapping[str, Any]
    judged: Judged | None
    visibility: float
    alone: tuple[float, ...]
    seconds: float
    error: str = ""

    @property
    def family(self) -> str:
        """null, structure, channel, nonlinear, outside or double."""
        return str(self.truth["family"])

    @property
    def visible(self) -> bool:
        """Whether the faults show at all."""
        return self.visibility > VISIBLE

    @property
    def both_visible(self) -> bool:
        """Whether every fault would show on its own."""
        return self.visible and all(v > VISIBLE for v in self.alone)

    @property
    def group(self) -> str:
        """Which row of the table the place counts in: nonlinear, channel or linear."""
        mechanism = str(self.truth["faults"][0]["mechanism"]) if self.truth["faults"] else ""
        if self.family == "nonlinear":
            return "nonlinear"
        return "channel" if mechanism.startswith("channel-") else "linear"


@dataclass(frozen=True)
class Measure:
    """One row of the table: its value with interval, what is to be reached, and whether it is.

    `reached` is None where there was nothing to count.
    """

    name: str
    goal: str
    shown: str
    value: float
    reached: bool | None
    share: Share | None = None

    def as_dict(self) -> dict[str, Any]:
        """As score.json holds it."""
        out: dict[str, Any] = {
            "name": self.name,
            "goal": self.goal,
            "value": plain(self.value),
            "reached": self.reached,
        }
        if self.share is not None:
            out |= {"k": self.share.k, "n": self.share.n, "interval": list(self.share.interval)}
        return out


def plain(value: float) -> float | None:
    """The value as JSON takes it: None for NaN."""
    return None if np.isnan(value) else float(value)


def at_most(name: str, flags: Sequence[bool], limit: float) -> Measure:
    """A rate that must not pass `limit`."""
    share = count(flags)
    return Measure(
        name, f"<= {100 * limit:g} %", str(share), share.value, share.value <= limit if share.n else None, share
    )


def at_least(name: str, flags: Sequence[bool], limit: float) -> Measure:
    """A rate that must reach `limit`."""
    share = count(flags)
    return Measure(
        name, f">= {100 * limit:g} %", str(share), share.value, share.value >= limit if share.n else None, share
    )


def table(cases: Sequence[Scored]) -> list[Measure]:
    """All measures of a suite; a case without an answer counts as one that says nothing."""
    nulls = _answers(cases, lambda c: c.family == "null")
    inside = [c for c in cases if c.family in ("structure", "channel", "nonlinear") and c.visible]
    outside = [c for c in cases if c.family == "outside" and c.visible]
    doubles = [c for c in cases if c.family == "double" and c.both_visible]
    out = [
        at_most("false alarm on nulls", [j.alarm for j in nulls], 0.05),
        at_most("a null given a name", [j.named for j in nulls], 0.01),
    ]
    for group, limit in (("nonlinear", 0.97), ("channel", 0.95), ("linear", 0.85)):
        flags = [says(c, "place_right") for c in inside if c.group == group]
        if flags or group != "nonlinear":
            out.append(at_least(f"place, first choice, visible: {group}", flags, limit))
    named = [c.judged for c in inside if c.judged and c.judged.named]
    out += [
        at_least("right among the names declared, visible", [j.name_right for j in named], 0.97),
        at_least("name and place right among the names declared", [j.both_right for j in named], 0.90),
        at_least("declared at all, visible, in the catalogue", [says(c, "named") for c in inside], 0.85),
        at_most("outside the catalogue, falsely named", [says(c, "named") for c in outside], 0.05),
        at_least('outside, "unexplained" at the right place', [_unexplained(c) for c in outside], 0.85),
        at_least("two at once: both named", [_found(c, all) for c in doubles], 0.60),
        at_least("two at once: first named is one of them", [says(c, "name_right") for c in doubles], 0.90),
    ]
    further = count([_wrong_further(j) for j in named])
    out.append(Measure("a further name that is wrong, one fault", "-", str(further), further.value, None, further))
    return out + improvement(inside + doubles) + parameters(inside) + times(cases)


def _wrong_further(judged: Judged) -> bool:
    """Whether a second or third name is wrong, or the first right name comes with one too many."""
    return sum(judged.names) < len(judged.names) and len(judged.names) > 1


def _answers(cases: Sequence[Scored], keep: Callable[[Scored], bool]) -> list[Judged]:
    return [c.judged for c in cases if keep(c) and c.judged is not None]


def says(case: Scored, what: str) -> bool:
    """Whether a property of `Judged` holds; a case without an answer has none."""
    return case.judged is not None and bool(getattr(case.judged, what))


def _unexplained(case: Scored) -> bool:
    return case.judged is not None and case.judged.verdict == "unexplained" and case.judged.place_right


def _found(case: Scored, how: Callable[[Sequence[bool]], bool]) -> bool:
    return case.judged is not None and bool(case.judged.found) and how(case.judged.found)


def improvement(cases: Sequence[Scored]) -> list[Measure]:
    """Held-out error of the base over that of the extended model, where a name was declared."""
    ratios = np.array([c.judged.ratio for c in cases if c.judged and c.judged.named], float)
    ratios = ratios[np.isfinite(ratios)]
    if not ratios.size:
        return [Measure("held-out error, base over extended", ">= 5, never < 0.95", "none", float("nan"), None)]
    middle, worst = float(np.median(ratios)), float(ratios.min())
    shown = f"median {middle:.2f}, least {worst:.2f} ({ratios.size} cases)"
    return [
        Measure(
            "held-out error, base over extended", ">= 5, never < 0.95", shown, middle, middle >= 5 and worst >= 0.95
        )
    ]


def parameters(cases: Sequence[Scored]) -> list[Measure]:
    """Relative error of the named mechanisms' parameters, and how often their 90 % intervals hold the truth."""
    errors = [e for c in cases if c.judged for e in c.judged.errors.values()]
    relative = np.abs([e[0] for e in errors])
    standard = np.abs([e[1] for e in errors])
    standard = standard[np.isfinite(standard)]
    middle = float(np.median(relative)) if relative.size else float("nan")
    shown = f"median {100 * middle:.2f} % ({relative.size} values)" if relative.size else "none"
    held = count([bool(x <= NINETY) for x in standard])
    reached = 0.85 <= held.value <= 0.95 if held.n else None
    return [
        Measure("parameter error, named", "median <= 3 %", shown, middle, middle <= 0.03 if relative.size else None),
        Measure("90 % intervals that hold the truth", "85 to 95 %", str(held), held.value, reached, held),
    ]


def times(cases: Sequence[Scored]) -> list[Measure]:
    """Processor seconds a case."""
    seconds = np.array([c.seconds for c in cases if c.judged is not None], float)
    seconds = seconds[np.isfinite(seconds)]
    if not seconds.size:
        return []
    middle, most = (float(x) for x in np.percentile(seconds, [50, 95]))
    shown = f"median {middle:.2f} s, 95 % {most:.2f} s"
    return [Measure("processor time a case", "median <= 5 s, 95 % <= 30 s", shown, middle, middle <= 5 and most <= 30)]


@dataclass(frozen=True)
class Limit:
    """Detection limit of one mechanism: severity, and its own measure, at which half are named rightly."""

    mechanism: str
    n: int
    visible: int
    named: int
    severity: float
    measure: float
    measure_of: str

    def as_dict(self) -> dict[str, Any]:
        """As score.json holds it."""
        out = self.__dict__ | {"severity": plain(self.severity), "measure": plain(self.measure)}
        return dict(out)


def limits(cases: Sequence[Scored]) -> list[Limit]:
    """Detection limit of every mechanism of the catalogue that stood alone in a case."""
    single = [c for c in cases if c.family in ("structure", "channel", "nonlinear")]
    out = []
    for mechanism in sorted({c.truth["faults"][0]["mechanism"] for c in single}):
        group = [c for c in single if c.truth["faults"][0]["mechanism"] == mechanism]
        faults = [c.truth["faults"][0] for c in group]
        found = [says(c, "name_right") for c in group]
        at = half_point([f["severity"] for f in faults], found)
        kinds = {f["measure_of"] for f in faults}
        one = len(kinds) == 1
        out.append(
            Limit(
                mechanism,
                len(group),
                sum(c.visible for c in group),
                sum(found),
                at,
                _measure_at(faults, at) if one else float("nan"),
                next(iter(kinds)) if one else "",
            )
        )
    return out


def _measure_at(faults: Sequence[Mapping[str, Any]], severity: float) -> float:
    """The measure that belongs to a severity, on the line through all cases of the mechanism."""
    x = np.array([f["severity"] for f in faults])
    y = np.log([max(abs(f["measure"]), 1e-12) for f in faults])
    if np.isnan(severity) or np.ptp(x) < 1e-6:
        return float("nan")
    slope, start = np.polyfit(x, y, 1)
    return float(np.exp(start + slope * severity))
