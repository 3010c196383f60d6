"""The diagnosis in words that a technician follows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labnnum.diagnosis.caveats import asked, of_one_level, of_ringing, one_level
from labnnum.diagnosis.nonlinear.decision import KNOWN, strays
from labnnum.diagnosis.nonlinear.detect import restless
from labnnum.diagnosis.nonlinear.tie import tightness
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.verdict import Diagnosis
from labnnum.mechanisms.base import Place

COARSE = 2e-3
"""Relative error of a frequency by the mesh alone, from which on it is worth a word."""


def summarise(d: Diagnosis, observations: Sequence[Observation] = ()) -> str:
    """One paragraph: verdict, place, mechanism with its parameters, what the fit gained, a mesh that is coarse, runs
    that do not repeat, and what one level or records that end too soon cannot tell.
    """
    told = of_one_level(d, observations) + of_ringing(d, observations)
    return _found(d) + _mesh(d) + _restless(observations) + told


def _restless(observations: Sequence[Observation]) -> str:
    """Runs whose periods differ by more than sensors' noise."""
    moving = restless(observations)
    if not moving:
        return ""
    names = [f"{observations[i].label} (by {_percent(part)})" for i, part in moving.items()]
    one = len(names) == 1
    subject, rest = ("response", "s") if one else ("responses", "")
    return (
        f" The {subject} of {_listed(names)} differ{rest} from period to period by far more than the sensors' noise:"
        f" {'it has' if one else 'they have'} not settled, or wander{rest} between steady states."
    )


def _listed(names: Sequence[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last


def _mesh(d: Diagnosis) -> str:
    engine = d.detail.get("engine")
    if engine is None or not engine.finer:
        return ""
    moved = np.abs(engine.mesh_shift[np.isin(engine.band_modes, engine.seen_modes)]).max(initial=0.0)
    if moved < COARSE:
        return ""
    return (
        f" The mesh alone puts frequencies of the band up to {_percent(float(moved))} too high, as the data show; that"
        " is allowed for here, but not where the model's file is used: give it shorter elements."
    )


def _found(d: Diagnosis) -> str:
    known = d.detail.get("nonlinear")
    if d.verdict in ("consistent", "parameters") and known is not None and known.reason == KNOWN:
        laws = _listed([f"{t.name} at {t.spot.place}" for t in known.laws])
        apart = " on data held out" if d.held_apart else ""
        return (
            f"With what it holds ({laws}) the model explains the data to {_percent(d.extended_error[1])}{apart},"
            f" without it to {_percent(d.base_error[1])}; nothing else is missing."
        )
    if d.verdict == "consistent":
        return (
            f"The nominal model explains the data to {_percent(d.base_error[1])} on data held out; nothing is missing."
        )
    if d.verdict == "parameters":
        return (
            f"With its parameters updated the model explains the data to {_percent(d.base_error[1])} on data held out;"
            " no physics is missing."
        )
    if d.verdict == "unexplained":
        where = f" at {d.place}{_anywhere(d)}" if d.place else ""
        why = d.detail.get("reason") or "no mechanism of the catalogue explains it"
        return f"Something is missing{where}, and the data do not give it a name: {why}.{_equal(d)}"
    parts = []
    for n in d.named:
        sense = n.term.mechanism.sense(n.term, n.value)
        values = ", ".join(
            f"{p.name} {v:.4g}{f' ± {_two(s)}' if s else ''} {p.unit if p.unit != '1' else ''}".strip()
            for p, v, s in zip(n.term.parameters, n.value, n.std, strict=True)
            if p.name != "held"
        )
        if any(p.name == "held" and v for p, v in zip(n.term.parameters, n.value, strict=True)):
            values += " (beside a base that is taken to hold its spring, since it was identified at the quietest level)"
        named = n.term.mechanism.id + (f" ({sense})" if sense else "")
        parts.append(f"{named} at {n.place}" + (f": {values}" if values else ""))
    creep = d.creep
    told = ""
    if creep is not None:
        told = (
            f" From the first sample to the last all natural frequencies {'rose' if creep.change > 0 else 'fell'} by"
            f" {_percent(abs(creep.change))}; what else is said here holds for the middle of the session."
        )
    more = (_astray, _in_step, _equal, _undecided, _beside, _besides)
    return f"{'; and '.join(parts)}.{told} {_gained(d)}{''.join(say(d) for say in more)}"


MANY, ALIKE = 5, 1.5
"""Other places from which on it is said that many explain what is missing; and times what the best leaves, up to which
one does."""


def _anywhere(d: Diagnosis) -> str:
    """Whether many places explain what is missing as well as the one that is told: it may be spread over them all."""
    shares = {place: share for place, share in d.located if place != d.place}
    best = max((share for _, share in d.located), default=0.0)
    near = [p for p, share in shares.items() if 1 - share < ALIKE * (1 - best) and p.kind != "channel"]
    if len(near) < MANY:
        return ""
    return f", or at any of {len(near)} other places or more that explain as much of it, or spread over all of them"


def _gained(d: Diagnosis) -> str:
    """What the error was and is, and of which data."""
    if d.extended_error == d.base_error:
        left = f"{_percent(d.base_error[1])} (noise {_percent(d.noise_floor)})"
        return f"What is believed of the runs the model explains to {left}."
    of = "held-out error" if d.held_apart else "error of the runs, all of which were fitted,"
    change = f"from {_percent(d.base_error[1])} to {_percent(d.extended_error[1])} (noise {_percent(d.noise_floor)})"
    alone = "" if d.held_apart else " None was left to be held out: a second run of a level would judge the answer."
    return f"The {of} falls {change}.{alone}"


def _equal(d: Diagnosis) -> str:
    """Places that nothing measured tells from that of a nonlinear law."""
    found = d.detail.get("nonlinear")
    laws = [n.place for n in d.named if n.term.mechanism.domain == "nonlinear"]
    place = laws[0] if laws else d.place
    if found is None or not found.equal or place is None or place != found.laws[0].spot.place:
        return ""
    others = _listed([str(p) for p in found.equal])
    verb = "move" if len(found.equal) > 1 else "moves"
    return f" In the modes of the band {others} {verb} as {place} does: no measurement there tells which of them it is."


def _undecided(d: Diagnosis) -> str:
    """A further law of which more than one would do."""
    found = d.detail.get("nonlinear")
    if found is None or not (found.named and found.undecided):
        return ""
    some = " or ".join(f"{name} at {place}" for name, place in found.undecided)
    return f" Beside what is named acts {some}: the data do not tell which."


def _besides(d: Diagnosis) -> str:
    """What is missing beside what the gates found, and has no name."""
    why = d.detail.get("besides")
    return f" Beside it something is missing that the data do not give a name: {why}." if why else ""


def _in_step(d: Diagnosis) -> str:
    """Whether a response in noise was compared in step with the measured motion, not freely simulated."""
    found = d.detail.get("nonlinear")
    if found is None or not found.named or not tightness(found.laws[-1].made.orbits):
        return ""
    return (
        " Small errors grow in this response, so that no free simulation follows it for long: law and data were"
        " compared in step with the motion measured at the place, on data held out too."
    )


def _astray(d: Diagnosis) -> str:
    """Whether data held out show a steady state that the simulation does not stay in."""
    found = d.detail.get("nonlinear")
    if found is None or not found.named or not strays(found):
        return ""
    return (
        " On data held out the simulation goes to another steady state than the structure was in, as it may next to a"
        f" jump; along the motion that was measured the law leaves {_percent(found.shown)}."
    )


MUCH = 3.0
"""Chi-square per value that a nonlinear law leaves, above which something else may be missing beside it."""


def _left(d: Diagnosis) -> float:
    """Chi-square per value that the nonlinear laws leave; 0 where there are none."""
    found = d.detail.get("nonlinear")
    return 0.0 if found is None or not found.named else float(found.misfit)


def _beside(d: Diagnosis) -> str:
    """What a law that stands out still leaves."""
    left = _left(d)
    if left <= MUCH:
        return ""
    return (
        f" In chi-square it leaves {left:.3g} times what noise and ordinary errors do: something else may be missing"
        " beside it, and its parameters may be off by more than their deviations say."
    )


def _two(x: float) -> str:
    """A deviation to two digits: 120, and not 1.2e+02."""
    return f"{float(f'{x:.2g}'):g}"


def _percent(x: float) -> str:
    return f"{100 * x:.3g} %"


def next_experiment(d: Diagnosis, observations: Sequence[Observation]) -> str:
    """What to measure next; empty only when the verdict is certain."""
    moving = restless(observations)
    if moving and d.verdict not in ("consistent", "parameters"):
        first = _listed([observations[i].label for i in moving])
        settle = f"Let the response settle for longer before recording {first}, or change the level a little."
        return f"{settle} {_next(d, observations)}".strip() if d.verdict != "unexplained" else settle
    return asked(d, observations, _next(d, observations))


def _next(d: Diagnosis, observations: Sequence[Observation]) -> str:
    if d.verdict in ("consistent", "parameters"):
        if one_level(observations):
            return "One level cannot tell linear from nonlinear: repeat at two and at four times the level."
        return ""
    if d.verdict == "unexplained":
        if d.place is not None and d.place.kind == "channel":
            return "Exchange the cable and the transducer of that channel and repeat."
        return _nearer(d)
    first = d.named[0]
    if first.term.mechanism.id == "channel-clipping":
        return f"Give {first.place} a wider range, or drive less, and repeat the runs in which it clips."
    if first.term.mechanism.domain == "channel":
        return (
            f"Exchange the transducer and cable of {first.place} and repeat: the fault moves with them if it is theirs."
        )
    if _left(d) > MUCH:
        return (
            f"Repeat at lower levels, and with a sensor more at {first.place}: what is missing beside"
            f" {first.term.mechanism.id} shows best where that acts least."
        )
    if first.confidence < 0.95 and d.alternatives:
        a = d.alternatives[0]
        rival = f"{a.term.mechanism.id} at {a.term.place}"
        bare = _bare(d, first.place) or _bare(d, a.term.place)
        if a.term.place == first.place or not bare:
            told = f"how the response grows with level tells {first.term.mechanism.id} from {rival}"
            return f"Repeat at two further levels: {told}."
        return f"Add a sensor at {_nodes(bare)}: it tells {first.term.mechanism.id} from {rival}."
    return ""


def _nearer(d: Diagnosis) -> str:
    """What tells more of something that has no name: sensors where there are none, else levels."""
    repeat = "repeat at two further levels, one of them quieter than all"
    if d.place is None or d.place.kind in ("global", "system"):
        return f"Nothing tells where it acts: add sensors between those that are there, and {repeat}."
    rivals = d.alternatives[:2]
    apart = len(rivals) == 2 and rivals[0].term.place != rivals[1].term.place
    between = " from ".join(f"{a.term.mechanism.id} at {a.term.place}" for a in rivals)
    bare = _bare(d, d.place, *(a.term.place for a in rivals if apart))
    if bare:
        return f"Add a sensor at {_nodes(bare)}{f' to tell {between}' if apart else ''}, and {repeat}."
    return f"There are sensors at {d.place} already: {repeat}, and compare with a law of your own (--mechanism)."


def _bare(d: Diagnosis, *places: Place) -> list[str]:
    """Nodes of places that have no sensor."""
    engine = d.detail.get("engine")
    heard = {c.node for c in engine.outputs} if engine is not None else set()
    held = set(engine.structure.supports) if engine is not None else set()
    nodes = [n for p in places if p.kind not in ("channel", "global", "system") for n in (p.id, p.to) if n is not None]
    return [n for n in dict.fromkeys(nodes) if n not in heard and n not in held and n != "ground"]


def _nodes(names: Sequence[str]) -> str:
    return f"node{'s' if len(names) > 1 else ''} {_listed(names)}"
