"""Which cases a suite holds: drawn from its seed alone, before anything is computed."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng

from labnnum.errors import ConfigError
from sessions.prove.cases import BESIDE_LAWS, KINDS, LAWS, Case, conceal, fits, measure
from sessions.prove.truth.channels import CHANNEL
from sessions.prove.truth.nonlinear import NONLINEAR, OUTSIDE_LAWS
from sessions.prove.truth.outside import OUTSIDE
from sessions.prove.truth.physics import STRUCTURAL

SHARES = {
    "linear": {"null": 0.22, "structure": 0.36, "channel": 0.15, "outside": 0.13, "double": 0.14},
    "nonlinear": {"null": 0.2, "nonlinear": 0.46, "channel": 0.04, "outside": 0.14, "double": 0.16},
}
"""Part of each family of cases in each suite."""

LINEAR = {
    "chain": {"multisine": 0.55, "random": 0.2, "hammer": 0.2, "frf": 0.05},
    "base-beam": {"multisine": 0.7, "random": 0.25, "frf": 0.05},
    "free-beam": {"multisine": 0.4, "random": 0.15, "hammer": 0.4, "frf": 0.05},
    "frame": {"multisine": 0.35, "random": 0.15, "hammer": 0.45, "frf": 0.05},
}
SHAKEN = {"multisine": 0.65, "random": 0.2, "sweep": 0.15}
BOTH = {"multisine": 0.5, "random": 0.15, "sweep": 0.1, "hammer": 0.25}
EXCITATIONS = {
    "linear": LINEAR,
    "nonlinear": {"chain": BOTH, "base-beam": SHAKEN, "free-beam": BOTH, "frame": BOTH},
}
"""How often each excitation is used on each kind of structure."""

Stage = dict[str, dict[str, float]]
SPAN = 100_000
"""Seeds of cases that belong to one seed of a suite."""


@dataclass(frozen=True)
class Ticket:
    """All that fixes one case."""

    name: str
    seed: int
    family: str
    kind: str
    faults: tuple[str, ...]
    severities: tuple[float, ...]
    excitation: str

    @property
    def lawful(self) -> bool:
        """Whether a nonlinear law acts in it."""
        return bool(set(self.faults) & set(LAWS))

    def conceal(self) -> Case:
        """The truth of this case, without samples."""
        return conceal(self.seed, self.kind, self.faults, self.severities, self.excitation, name=self.name)

    def measured(self) -> Case:
        """The case with its session measured."""
        return measure(self.conceal())

    def alone(self, i: int) -> Ticket:
        """The same structure with fault number `i` only, at the place that it has when it is drawn first."""
        return replace(self, faults=(self.faults[i],), severities=(self.severities[i],))

    def truth(self) -> dict[str, Any]:
        """What the sealed file holds of this case."""
        return {**self.conceal().truth, "family": self.family, "ticket": asdict(self)}


def draw(cases: int, seed: int, suite: str = "linear") -> tuple[Ticket, ...]:
    """Tickets of a suite, in a random order that depends on `seed` alone.

    Families come in fixed shares and mechanisms in turn, so that a suite of a few hundred cases has some of each.
    Seeds 0 to 999 are for development; a proof uses 1000 and above.
    """
    if cases < 1:
        raise ConfigError(f"--cases {cases} must be at least 1")
    if seed < 0:
        raise ConfigError(f"--seed {seed} must not be negative")
    rng = default_rng([seed, 977])
    families = [f for f, share in shares(suite).items() for _ in range(round(share * cases))]
    families = (families + ["null"] * cases)[:cases]
    order = rng.permutation(cases)
    turns = {family: turn(family, suite, rng) for family in shares(suite)}
    count = dict.fromkeys(turns, 0)
    out: list[Ticket | None] = [None] * cases
    stage = EXCITATIONS[suite]
    for at, family in zip(order, families, strict=True):
        faults = turns[family][count[family] % len(turns[family])]
        count[family] += 1
        out[at] = _ticket(f"case{at + 1:04d}", seed * SPAN + int(at), family, faults, stage)
    return tuple(t for t in out if t is not None)


def shares(suite: str) -> dict[str, float]:
    """Shares of the families of a suite; ConfigError if there is no such suite."""
    if suite not in SHARES:
        raise ConfigError(f"suite {suite!r} is not one of {', '.join(SHARES)}")
    return SHARES[suite]


def turn(family: str, suite: str, rng: Generator) -> list[tuple[str, ...]]:
    """Sets of faults of a family, in the order in which they are dealt."""
    if family == "null":
        return [()]
    if family == "double":
        pairs = _pairs(suite)
        return [pairs[i] for i in rng.permutation(len(pairs))]
    names = {
        "structure": [*STRUCTURAL, "drift"],
        "channel": list(CHANNEL),
        "nonlinear": list(NONLINEAR),
        "outside": list(OUTSIDE if suite == "linear" else OUTSIDE_LAWS),
    }[family]
    return [(names[i],) for i in rng.permutation(len(names))]


def _pairs(suite: str) -> list[tuple[str, ...]]:
    """Pairs of faults of the catalogue that can stand on one bench; in the nonlinear suite one is always a law."""
    if suite == "linear":
        inside = [*STRUCTURAL, *CHANNEL, "drift"]
        return [(a, b) for a in inside for b in inside if a != b and _together(a, b, suite)]
    partners = [p for p in BESIDE_LAWS if p not in OUTSIDE_LAWS]
    return [(a, b) for a in NONLINEAR for b in sorted(partners) if a != b and _together(a, b, suite)]


def _together(a: str, b: str, suite: str) -> bool:
    return any(fits(a, kind, e) and fits(b, kind, e) for kind in KINDS for e in EXCITATIONS[suite][kind])


def _ticket(name: str, seed: int, family: str, faults: tuple[str, ...], stage: Stage) -> Ticket:
    rng = default_rng([seed, 31])
    kind, excitation = _stage(rng, faults, stage)
    low, high = {"double": (0.55, 0.95), "outside": (0.4, 1.0)}.get(family, (0.0, 1.0))
    severities = tuple(float(rng.uniform(low, high)) for _ in faults)
    return Ticket(name, seed, family, kind, faults, severities, excitation)


def _stage(rng: Generator, faults: tuple[str, ...], stage: Stage) -> tuple[str, str]:
    """A kind of structure and an excitation on which all the faults make sense."""
    while True:
        kind = KINDS[int(rng.integers(len(KINDS)))]
        chances = stage[kind]
        excitation = str(rng.choice(list(chances), p=np.array(list(chances.values()))))
        if all(fits(f, kind, excitation) for f in faults):
            return kind, excitation
