"""The diagnosis in words that a technician follows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labnnum.diagnosis.nonlinear.decision import strays
from labnnum.diagnosis.nonlinear.tie import tightness
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.verdict import Diagnosis

COARSE = 2e-3
"""Relative error of a frequency by the mesh alone, from which on it is worth a word."""


def summarise(d: Diagnosis) -> str:
    """One paragraph: verdict, place, mechanism with its parameters, what the fit gained, and a mesh that is coarse."""
    return _found(d) + _mesh(d)


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
        where = f" at {d.place}" if d.place else ""
        why = d.detail.get("reason") or "no mechanism of the catalogue explains it"
        return f"Something is missing{where}, and the data do not give it a name: {why}.{_equal(d)}"
    parts = []
    for n in d.named:
        sense = n.term.mechanism.sense(n.term, n.value)
        values = ", ".join(
            f"{p.name} {v:.4g}{f' ± {s:.2g}' if s else ''} {p.unit if p.unit != '1' else ''}".strip()
            for p, v, s in zip(n.term.parameters, n.value, n.std, strict=True)
        )
        named = n.term.mechanism.id + (f" ({sense})" if sense else "")
        parts.append(f"{named} at {n.place}" + (f": {values}" if values else ""))
    creep = d.creep
    told = ""
    if creep is not None:
        told = (
            f" From the first sample to the last all natural frequencies {'rose' if creep.change > 0 else 'fell'} by"
            f" {_percent(abs(creep.change))}; what else is said here holds for the middle of the session."
        )
    return (
        f"{'; and '.join(parts)}.{told} The held-out error falls from {_percent(d.base_error[1])} to"
        f" {_percent(d.extended_error[1])} (noise {_percent(d.noise_floor)})."
        f"{_astray(d)}{_in_step(d)}{_equal(d)}{_beside(d)}"
    )


def _equal(d: Diagnosis) -> str:
    """Places that nothing measured tells from that of a nonlinear law."""
    found = d.detail.get("nonlinear")
    laws = [n.place for n in d.named if n.term.mechanism.domain == "nonlinear"]
    place = laws[0] if laws else d.place
    if found is None or not found.equal or place is None or place != found.laws[0].spot.place:
        return ""
    *most, last = (str(p) for p in found.equal)
    others = f"{', '.join(most)} and {last}" if most else last
    verb = "move" if most else "moves"
    return f" In the modes of the band {others} {verb} as {place} does: no measurement there tells which of them it is."


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


def _percent(x: float) -> str:
    return f"{100 * x:.3g} %"


def next_experiment(d: Diagnosis, observations: Sequence[Observation]) -> str:
    """What to measure next; empty only when the verdict is certain."""
    levels = {round(o.level, 12) for o in observations}
    if d.verdict in ("consistent", "parameters"):
        if len(levels) < 2:
            return "One level cannot tell linear from nonlinear: repeat at two and at four times the level."
        return ""
    if d.verdict == "unexplained":
        rivals = [f"{a.term.mechanism.id} at {a.term.place}" for a in d.alternatives[:2]]
        if d.place is not None and d.place.kind != "channel":
            between = f" to tell {' from '.join(rivals)}" if len(rivals) == 2 else ""
            return f"Add a sensor at {d.place}{between}, and repeat at two further levels."
        return "Exchange the cable and the transducer of that channel and repeat."
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
        return f"Add a sensor at {first.place}: it tells {first.term.mechanism.id} from {rival}."
    return ""
