"""Detection limits: how strong a nonlinear law must be to be named, against the level of the drive and the noise.

The suites draw levels and noise as a careful user would choose them, so that nearly every law in them is found. Here
strength, level and noise are drawn apart and far down: the strength of each law down to where nothing shows, the drive
over 30 dB, the noise over 45 dB. Whether a law is named at its place is then a logistic function of their logarithms,

    logit P = a + b ln(measure) + c noise + d ln(level),

with slopes b and c that all laws share, and a and d of each law's own, as likely as normal priors and the answers make
them. The limit is the measure at P = 1/2; its interval follows from the curvature at the most likely point (Laplace).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray
from scipy.special import expit

from labnnum.errors import ConfigError, EstimationError
from sessions.prove import score, seal
from sessions.prove.answers import entries, judge
from sessions.prove.cases import KINDS, Case, measure
from sessions.prove.jobs import each
from sessions.prove.run import TOOL, answer, load
from sessions.prove.suite import SPAN, Ticket
from sessions.prove.truth.nonlinear import NONLINEAR

SUITE = "limits"
SEVERITY, NOISE, LEVEL = (-1.0, 1.0), (35.0, 80.0), (-30.0, 0.0)
"""What is drawn: severity, whose measure goes on below zero as it does above; response over noise and drive, dB."""
SHOWN = ((0.0, 40.0), (0.0, 60.0), (0.0, 80.0), (-20.0, 60.0))
"""Drive and response over noise, dB, for which limits are printed."""
NINETY = 1.6449

Step = Callable[[int, int], None]
"""Told how much is done, and how much there is."""


@dataclass(frozen=True)
class Probe(Ticket):
    """A case of which the level of the drive and the noise are told: `level` and `snr` in dB."""

    level: float = 0.0
    snr: float = 60.0

    def conceal(self) -> Case:
        """The truth of this case, without samples."""
        case = super().conceal()
        return replace(case, plan=replace(case.plan, snr=self.snr))

    def measured(self) -> Case:
        """The case with its session measured at its level and with its noise."""
        return measure(self.conceal(), 10 ** (self.level / 20), self.snr)


def draw(cases: int, seed: int) -> tuple[Probe, ...]:
    """Probes, the laws in turn on structures of every kind under multisines; depends on `seed` alone."""
    if cases < len(NONLINEAR):
        raise ConfigError(f"--cases {cases}: limits need at least one case of each of the {len(NONLINEAR)} laws")
    if seed < 0:
        raise ConfigError(f"--seed {seed} must not be negative")
    laws = list(NONLINEAR)
    out = []
    for i in range(cases):
        rng = default_rng([seed, 613, i])
        severity, snr, level = (float(rng.uniform(*span)) for span in (SEVERITY, NOISE, LEVEL))
        kind = KINDS[int(rng.integers(len(KINDS)))]
        law = laws[i % len(laws)]
        name = f"case{i + 1:04d}"
        out.append(
            Probe(name, seed * SPAN + i, "nonlinear", kind, (law,), (severity,), "multisine", level=level, snr=snr)
        )
    return tuple(out)


@dataclass(frozen=True)
class Seen:
    """One answered probe: the law, its measure at the full drive, drive and noise in dB, whether it was named."""

    law: str
    measure: float
    level: float
    snr: float
    found: bool


def run(
    out: Path,
    cases: int,
    seed: int,
    jobs: int = 1,
    tool: str = TOOL,
    step: Step = lambda done, total: None,
    ask: bool = True,
) -> dict[str, Any]:
    """Draw, seal, measure and diagnose; go on where an earlier call was stopped. Writes limits.json and limits.md.

    `ask` : whether the tool is asked about what has no answer yet.

    Raises
    ------
    ConfigError
        If `out` holds another suite.
    """
    load(tool)
    probes = draw(cases, seed)
    sha256 = seal.seal(out, SUITE, seed, probes, jobs)
    todo = [p for p in probes if not score.answer_path(out, p.name).parent.joinpath("time.json").is_file()]
    done = cases - len(todo)
    step(done, cases)
    for _ in each(partial(answer, out=out, keep=False, tool=tool), todo if ask else (), jobs):
        done += 1
        step(done, cases)
    return write(out, seed, sha256, read(out, probes))


def read(out: Path, probes: Sequence[Probe]) -> list[Seen]:
    """What became of each probe that has been tried."""
    truths = {c["case"]: c for c in seal.unseal(out)["cases"]}
    seen = []
    for p in probes:
        path = score.answer_path(out, p.name)
        if not path.parent.joinpath("time.json").is_file():
            continue
        fault = truths[p.name]["faults"][0]
        found = False
        if path.is_file():
            said = json.loads(path.read_text(encoding="utf-8"))
            named = entries(said)
            law = bool(named) and named[0]["mechanism"]["id"] in NONLINEAR
            found = law and judge(truths[p.name], said).both_right
        seen.append(Seen(p.faults[0], abs(float(fault["measure"])), p.level, p.snr, found))
    return seen


@dataclass(frozen=True, eq=False)
class Surface:
    """The fitted logistic surface: `point` (2 + 2 n,) is b, c, then a and d of every law; `spread` its covariance."""

    laws: tuple[str, ...]
    middle: NDArray[np.float64]
    point: NDArray[np.float64]
    spread: NDArray[np.float64]

    def limit(self, law: str, level: float, snr: float) -> tuple[float, float]:
        """Logarithm of the measure at which half are named, and its standard deviation (delta method)."""
        i = self.laws.index(law)
        x, y = (snr - MIDDLE) / DECADE, np.log(10) * level / 20
        b, c, (a, d) = self.point[0], self.point[1], self.point[2 + 2 * i : 4 + 2 * i]
        at = -(a + c * x + d * y) / b
        slope = np.zeros(self.point.size)
        slope[0], slope[1] = -at / b, -x / b
        slope[2 + 2 * i : 4 + 2 * i] = -1 / b, -y / b
        return float(self.middle[i] + at), float(np.sqrt(slope @ self.spread @ slope))

    def exponent(self, law: str) -> tuple[float, float]:
        """Power of the drive with which a law's share grows as the answers show it, d / b, and its deviation."""
        i = 3 + 2 * self.laws.index(law)
        slope = np.zeros(self.point.size)
        slope[0], slope[i] = -self.point[i] / self.point[0] ** 2, 1 / self.point[0]
        return float(self.point[i] / self.point[0]), float(np.sqrt(slope @ self.spread @ slope))


MIDDLE, DECADE = 60.0, 20.0
"""dB of response over noise at the middle of the fit, and that make one unit of it."""
PRIOR = {"b": (1.5, 1.0), "c": (1.5, 1.5), "a": (0.0, 6.0), "d": (0.0, 3.0)}
"""Mean and standard deviation of each parameter before any answer; it rises over two octaves of strength."""


def fit(seen: Sequence[Seen]) -> Surface:
    """The most likely logistic surface, by Newton's method.

    Raises
    ------
    EstimationError
        If there is nothing to fit.
    """
    if not seen:
        raise EstimationError("no probe has been answered: nothing tells a detection limit")
    laws = tuple(sorted({s.law for s in seen}))
    middle = np.array([np.mean([np.log(s.measure) for s in seen if s.law == law]) for law in laws])
    A = np.zeros((len(seen), 2 + 2 * len(laws)))
    for row, s in zip(A, seen, strict=True):
        i = laws.index(s.law)
        row[:2] = np.log(s.measure) - middle[i], (s.snr - MIDDLE) / DECADE
        row[2 + 2 * i : 4 + 2 * i] = 1.0, np.log(10) * s.level / 20
    y = np.array([s.found for s in seen], float)
    prior = [PRIOR["b"], PRIOR["c"], *(PRIOR[k] for _ in laws for k in ("a", "d"))]
    mean, size = np.array(prior).T
    p, hold = mean.copy(), np.diag(1 / size**2)
    for _ in range(100):
        guess = expit(A @ p)
        curve = (A * (guess * (1 - guess))[:, None]).T @ A + hold
        change = np.linalg.solve(curve, A.T @ (y - guess) - hold @ (p - mean))
        p = p + change * min(1.0, 2.0 / float(np.abs(change).max() + 1e-300))
        if np.abs(change).max() < 1e-10:
            break
    return Surface(laws, middle, p, np.linalg.inv(curve))


def write(out: Path, seed: int, sha256: str, seen: Sequence[Seen]) -> dict[str, Any]:
    """Write limits.json and limits.md into `out`; what limits.json holds."""
    surface = fit(seen)
    inside = {law: [s for s in seen if s.law == law] for law in surface.laws}
    rows = []
    for law, mine in inside.items():
        limits = [(*at, *surface.limit(law, *at)) for at in SHOWN]
        reach = (min(s.measure for s in mine), max(s.measure for s in mine))
        power, std = surface.exponent(law)
        rows.append(
            {
                "law": law,
                "n": len(mine),
                "named": sum(s.found for s in mine),
                "drawn": list(reach),
                "limits": [
                    {
                        "level_db": level,
                        "snr_db": snr,
                        "measure": float(np.exp(at)),
                        "factor": float(np.exp(NINETY * std)),
                    }
                    for level, snr, at, std in limits
                ],
                "exponent": power,
                "exponent_std": std,
            }
        )
    found = {"schema": 1, "suite": SUITE, "seed": seed, "sha256": sha256, "cases": len(seen), "laws": rows}
    found["per_20_db"] = float(np.exp(-surface.point[1] / surface.point[0]))
    (out / "limits.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (out / "limits.md").write_text(markdown(found), encoding="utf-8")
    return found


def columns() -> tuple[str, ...]:
    """Heads of the table."""
    at = (f"{level:g}, {-snr:g} dB" for level, snr in SHOWN)
    return ("law", "cases", "named", *at, "power of drive")


def lines(found: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of the table: measures at which half are named, with the factor either way of a 90 % interval."""
    return [
        (
            r["law"],
            str(r["n"]),
            str(r["named"]),
            *(_cell(x, r["drawn"]) for x in r["limits"]),
            f"{r['exponent']:.1f} ± {NINETY * r['exponent_std']:.1f}",
        )
        for r in found["laws"]
    ]


def _cell(limit: dict[str, Any], drawn: Sequence[float]) -> str:
    """One limit in a few words, or the end of what was drawn where it lies beyond."""
    if limit["measure"] < drawn[0]:
        return f"< {drawn[0]:.1g}"
    if limit["measure"] > drawn[1]:
        return f"> {drawn[1]:.1g}"
    return f"{limit['measure']:.2g} x/÷ {limit['factor']:.2g}"


def markdown(found: dict[str, Any]) -> str:
    """The limits as a page."""
    heads = columns()
    return "\n".join(
        [
            f"# Detection limits, seed {found['seed']}",
            "",
            f"{found['cases']} cases. Sealed truth SHA-256 `{found['sha256']}`.",
            "",
            "The measure of each law at the full drive (what it adds over what is there) at which half are named at",
            f"their place, by drive and noise. 20 dB less noise take it to {found['per_20_db']:.2f} of what it was.",
            "",
            "| " + " | ".join(heads) + " |",
            "|" + "---|" * len(heads),
            *("| " + " | ".join(row) + " |" for row in lines(found)),
            "",
        ]
    )
