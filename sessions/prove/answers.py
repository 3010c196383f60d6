"""One answer against one truth: same place, same mechanism, with every equivalence written out.

Places. A node, the ground at a node and the support at a node are one place (the mechanism says which). An element
and a joint between the same two nodes are one place, whichever node comes first. `global` and `system` are one
place. Two exchanged channels are named by either, the other in `to` or left out. Nothing else is the same; a
neighbour is wrong, and is counted apart as "adjacent".

Mechanisms. The same id, or one that no measurement of the band could tell from it: what the truth lists under
`accept` (an oscillator tuned above the band is an added mass; a channel turned round is a gain of -1; a stiffer
spring between a chain's mass and its wall is a spring from the mass to the ground; a softer one is a wall that
gives), and the converse for a declared oscillator that is tuned above the band where the truth is an added mass.

Values. A constant that changes sign with the sense of the motion is turned round where the answer names a joint's nodes
in the other order; at the ground and in the same order it is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

NOTHING_WRONG = ("consistent", "parameters")
ALIASES: dict[str, tuple[str, ...]] = {
    "m": ("m", "mass"),
    "k": ("k", "stiffness"),
    "c": ("c", "damping"),
    "f": ("f", "frequency"),
    "zeta": ("zeta", "damping_ratio"),
    "eta": ("eta", "loss_factor", "loss"),
    "T": ("T", "tension"),
    "tau": ("tau", "delay"),
    "f_c": ("f_c", "corner"),
    "k1": ("k1",),
    "k_theta": ("k_theta", "stiffness"),
}
"""Names under which an answer may give a concealed parameter, besides its own."""
SENSED = ("quadratic-stiffness",)
"""Laws whose constant changes sign with the sense of the motion that they see."""


@dataclass(frozen=True)
class Judged:
    """What one answer was worth.

    `names` holds for every mechanism that the answer names whether it is one of the concealed ones; `errors` the
    relative error and the standardised error (NaN without a standard deviation) of every parameter that both give.
    """

    case: str
    verdict: str
    alarm: bool
    named: bool
    place_right: bool
    adjacent: bool
    name_right: bool
    both_right: bool
    names: tuple[bool, ...]
    found: tuple[bool, ...]
    said: str
    ratio: float
    errors: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def spot(place: Mapping[str, Any] | None) -> tuple[Any, ...]:
    """A place as something that compares equal where two places are one."""
    if not place:
        return ("nowhere",)
    kind, name, to = place.get("kind"), str(place.get("id")), place.get("to")
    if kind in ("node", "ground", "support"):
        return ("point", name)
    if kind in ("element", "joint"):
        return ("pair", frozenset((name, str(to))))
    if kind == "channel":
        return ("channel", name)
    return ("whole",) if kind in ("global", "system") else ("unknown", kind, name)


def same_place(answer: Mapping[str, Any] | None, fault: Mapping[str, Any]) -> bool:
    """Whether an answered place is the fault's, or one that counts as it."""
    if not answer:
        return False
    spots = [spot(fault["place"]), *(spot(p) for p in fault.get("places", ()))]
    if spot(answer) not in spots:
        return False
    other = answer.get("to")
    if spot(answer)[0] == "channel" and other is not None:
        return ("channel", str(other)) in spots
    return True


def adjacent(answer: Mapping[str, Any] | None, fault: Mapping[str, Any]) -> bool:
    """Whether an answered place touches the fault's without being it: they share a node."""
    if not answer or same_place(answer, fault):
        return False
    nodes = [_nodes(answer), _nodes(fault["place"])]
    return bool(nodes[0] & nodes[1])


def _nodes(place: Mapping[str, Any]) -> set[str]:
    kind = spot(place)[0]
    if kind == "point":
        return {str(place["id"])}
    return {str(place["id"]), str(place["to"])} if kind == "pair" else set()


def same_mechanism(answer: Mapping[str, Any], fault: Mapping[str, Any], band: tuple[float, float]) -> bool:
    """Whether an answered entry {"place", "mechanism"} names the fault's physics."""
    mechanism = answer.get("mechanism") or {}
    name = mechanism.get("id")
    if name == fault["mechanism"]:
        return True
    for accepted, place in fault.get("accept", ()):
        if name == accepted and spot(answer.get("place")) == spot(place):
            return name != "channel-gain" or _negative(mechanism)
    if name == "attached-oscillator" and fault["mechanism"] == "added-mass":
        tuned = _parameter(mechanism, "f")
        return tuned is not None and tuned[0] > 1.5 * band[1] and same_place(answer.get("place"), fault)
    return False


def _negative(mechanism: Mapping[str, Any]) -> bool:
    """Whether a declared gain turns the channel round; taken so where no value is given."""
    values = {k: v.get("value") for k, v in (mechanism.get("parameters") or {}).items()}
    if "gain_error" in values:
        return values["gain_error"] < -1
    return values.get("a", values.get("gain", -1.0)) < 0


def _parameter(mechanism: Mapping[str, Any], name: str) -> tuple[float, float] | None:
    """Value and standard deviation under any of its names; None if the answer does not give it."""
    given = mechanism.get("parameters") or {}
    for alias in ALIASES.get(name, (name,)):
        entry = given.get(alias)
        if entry and entry.get("value") is not None:
            std = entry.get("std")
            return float(entry["value"]), float("nan") if std is None else float(std)
    return None


def entries(diagnosis: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The answer's mechanisms, first and further, each with its place; empty if it names none."""
    first = {"place": diagnosis.get("place"), "mechanism": diagnosis.get("mechanism")}
    every = [first, *(diagnosis.get("further") or [])]
    return [e for e in every if (e.get("mechanism") or {}).get("id")]


def first_place(diagnosis: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The answer's first choice of a place: the one it declares, else the best it located."""
    if diagnosis.get("place"):
        return diagnosis["place"]
    located = diagnosis.get("located") or []
    return located[0].get("place") if located else None


def judge(truth: Mapping[str, Any], diagnosis: Mapping[str, Any]) -> Judged:
    """What an answer is worth for a case, without asking whether the fault was visible."""
    faults = truth["faults"]
    band = tuple(truth["band"])
    named = entries(diagnosis)
    place = first_place(diagnosis)
    right = [[same_mechanism(e, f, band) for f in faults] for e in named]
    whole = [
        [r and _placed(e, f) for r, f in zip(row, faults, strict=True)] for e, row in zip(named, right, strict=True)
    ]
    errors: dict[str, tuple[float, float]] = {}
    for entry, row in zip(named, whole, strict=True):
        for ok, fault in zip(row, faults, strict=True):
            if ok:
                errors.update(parameter_errors(entry, fault))
    verdict = str(diagnosis.get("verdict"))
    return Judged(
        case=str(truth["case"]),
        verdict=verdict,
        alarm=verdict not in NOTHING_WRONG,
        named=bool(named),
        place_right=any(same_place(place, f) or _accepted_place(place, f) for f in faults),
        adjacent=any(adjacent(place, f) for f in faults),
        name_right=bool(right) and any(right[0]),
        both_right=bool(whole) and any(whole[0]),
        names=tuple(any(row) for row in right),
        found=tuple(any(row[i] for row in right) for i in range(len(faults))),
        said=describe(diagnosis),
        ratio=held_out_ratio(diagnosis),
        errors=errors,
    )


def _placed(entry: Mapping[str, Any], fault: Mapping[str, Any]) -> bool:
    return same_place(entry.get("place"), fault) or _accepted_place(entry.get("place"), fault)


def _accepted_place(place: Mapping[str, Any] | None, fault: Mapping[str, Any]) -> bool:
    return bool(place) and spot(place) in [spot(p) for _, p in fault.get("accept", ())]


def parameter_errors(answer: Mapping[str, Any], fault: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Relative and standardised error of every parameter that both the truth and an answered entry give."""
    out = {}
    for name, true in fault["parameters"].items():
        given = _parameter(answer["mechanism"], name)
        if given is None or true["value"] == 0:
            continue
        value = given[0]
        if fault["mechanism"] in SENSED:
            sense = _sense(answer.get("place") or {}, fault["place"], true)
            value = sense * value if sense else abs(value) * (1 if true["value"] > 0 else -1)
        wrong = value - true["value"]
        out[f"{fault['mechanism']}.{name}"] = (
            wrong / abs(true["value"]),
            wrong / given[1] if given[1] > 0 else float("nan"),
        )
    return out


def _sense(answer: Mapping[str, Any], place: Mapping[str, Any], true: Mapping[str, Any]) -> int:
    """1 where an answer sees the truth's motion, -1 where the reversed one, 0 where the truth does not tell.

    A joint's motion is that of its second node less that of its first. It does not tell of angles, whose sense the
    user's model may take the other way, nor of places that move alike, in either sense.
    """
    if spot(answer) != spot(place) or "of the angle" in true.get("unit", ""):
        return 0
    return -1 if spot(place)[0] == "pair" and str(answer["id"]) != str(place["id"]) else 1


def held_out_ratio(diagnosis: Mapping[str, Any]) -> float:
    """Held-out error of the base over that of the extended model; NaN where one is missing."""
    fit = diagnosis.get("fit") or {}
    base, extended = ((fit.get(k) or {}).get("held_out") for k in ("base", "extended"))
    return float(base) / float(extended) if base and extended else float("nan")


def describe(diagnosis: Mapping[str, Any]) -> str:
    """The answer in a few words, for the list of failures."""
    parts = [f"{e['mechanism']['id']} at {_written(e.get('place'))}" for e in entries(diagnosis)]
    if not parts:
        parts = [f"at {_written(first_place(diagnosis))}"] if first_place(diagnosis) else []
    return "; ".join([str(diagnosis.get("verdict")), *parts])


def _written(place: Mapping[str, Any] | None) -> str:
    if not place:
        return "no place"
    to = place.get("to")
    return f"{place.get('kind')} {place.get('id')}" + (f"-{to}" if to else "")
