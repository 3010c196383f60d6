"""What a diagnosis answers: the verdict, and everything that supports it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.creep import Creep
from labnnum.mechanisms.base import Place, Term


@dataclass(frozen=True, slots=True)
class Limits:
    """Thresholds on gains of the objective (chi-squares); set on nulls, see `docs/diagnosis-method.md`.

    alarm: gain of the best term above which a sound structure is doubted.
    name: lead of the best name over the best at another place.
    further: gain of a second or third mechanism.
    parameter: price of one more parameter.
    behind: how far a named term may stay behind the general local law, as a share of the total gain.
    misfit: objective per value above which nothing is called explained.
    improve: part of the base's held-out error that the extended model must fall below for a name; its square for
        two, and so on.
    improve_further: the same for each further mechanism after the one before.
    foreseen: part of the held-out chi-square to which a further mechanism may bring it instead.
    doubt: the same for "unexplained".
    sound: held-out error that no sound model leaves, unless noise makes a third of it.
    unsettled: chi-square per value of the best explanation above which something is still missing.
    remains: part of the base's objective that is no misfit, however far it stands above the noise.
    """

    alarm: float = 36.0
    name: float = 8.0
    further: float = 40.0
    parameter: float = 4.0
    behind: float = 0.05
    misfit: float = 1.5
    improve: float = 0.6
    improve_further: float = 0.8
    foreseen: float = 0.9
    doubt: float = 0.75
    remains: float = 5e-5
    sound: float = 0.15
    unsettled: float = 1.1


@dataclass(frozen=True, eq=False)
class Named:
    """A mechanism at a place with its estimated parameters."""

    term: Term
    value: NDArray[np.float64]
    std: NDArray[np.float64]
    confidence: float

    @property
    def place(self) -> Place:
        """Where."""
        return self.term.place

    def as_dict(self) -> dict[str, Any]:
        """The `mechanism` object of diagnosis.json."""
        parameters = {
            p.name: {"value": float(v), "std": float(s), "unit": p.unit}
            for p, v, s in zip(self.term.parameters, self.value, self.std, strict=True)
        }
        for name, (v, s, unit) in self.term.mechanism.derived(self.term, self.value, self.std).items():
            parameters[name] = {"value": v, "std": s, "unit": unit}
        sense = self.term.mechanism.sense(self.term, self.value)
        return {
            "id": self.term.mechanism.id,
            "sense": sense,
            "confidence": round(float(self.confidence), 4),
            "parameters": parameters,
        }


@dataclass(frozen=True, eq=False)
class Alternative:
    """A candidate that lost, and why."""

    term: Term
    held_out_error: float
    objective: float
    why_not: str

    def as_dict(self) -> dict[str, Any]:
        """One entry of `alternatives`."""
        return {
            "place": self.term.place.as_dict(),
            "mechanism": self.term.mechanism.id,
            "held_out_error": _finite(self.held_out_error),
            "why_not": self.why_not,
        }


def _finite(x: float) -> float | None:
    return float(x) if np.isfinite(x) else None


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Verdict, place, mechanisms, losers, location, errors before and after, and the next experiment."""

    verdict: str
    named: tuple[Named, ...]
    place: Place | None
    alternatives: tuple[Alternative, ...]
    located: tuple[tuple[Place, float], ...]
    chance: float
    base_error: tuple[float, float]
    extended_error: tuple[float, float]
    noise_floor: float
    nonlinear: dict[str, Any]
    next_experiment: str
    summary: str
    theta: NDArray[np.float64]
    theta_std: NDArray[np.float64]
    damping: NDArray[np.float64]
    detail: dict[str, Any] = field(default_factory=dict)

    @property
    def creep(self) -> Creep | None:
        """How the natural frequencies went during the session, where a drift was followed."""
        return next((n.term.data["creep"] for n in self.named if "creep" in n.term.data), None)

    @property
    def held_apart(self) -> bool:
        """Whether the errors called held out are of data that no fit saw; else they are of those that were fitted.

        The linear search always holds some out; a nonlinear one may not, and its errors are told unless the fault is
        one of the measurement beside which no law was named.
        """
        found = self.detail.get("nonlinear")
        linear = found is None or (self.verdict == "measurement-fault" and not found.named)
        return linear or bool(found.held_out)

    def as_dict(self) -> dict[str, Any]:
        """The content of diagnosis.json, schema 1."""
        apart = "held out" if self.held_apart else "fitted, since no run was held out"
        first = self.named[0] if self.named else None
        return {
            "schema": 1,
            "verdict": self.verdict,
            "place": self.place.as_dict() if self.place else None,
            "mechanism": first.as_dict() if first else None,
            "further": [{"place": n.place.as_dict(), "mechanism": n.as_dict()} for n in self.named[1:]],
            "alternatives": [a.as_dict() for a in self.alternatives],
            "located": [{"place": p.as_dict(), "share": round(float(s), 4)} for p, s in self.located],
            "chance_share": round(float(self.chance), 4),
            "fit": {
                "metric": f"relative RMS error of the response, {apart}",
                "base": {"train": _finite(self.base_error[0]), "held_out": _finite(self.base_error[1])},
                "extended": {"train": _finite(self.extended_error[0]), "held_out": _finite(self.extended_error[1])},
                "noise_floor": _finite(self.noise_floor),
            },
            "nonlinear": self.nonlinear,
            "next_experiment": self.next_experiment,
            "summary": self.summary,
        }
