"""How often a measurement that should not be trusted is flagged, and how often a sound one is.

Measurements are made from chains whose updater is trained as usual: sound ones, ones with a parameter outside its
bounds, from a structure with a spring too many, and with channels that were mixed up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError
from labnnum.frf import Frf
from labnnum.parameters import Estimate, Parameter, truncated_samples
from labnnum.recording import Channel
from labnnum.response import frf
from labnnum.structures.chain import GROUND, Chain, Link
from labnnum.structures.examples import EXAMPLES, Example
from labnnum.updating import Updater
from sessions.reproduce.networks import Say

NOISE = 0.01
STRUCTURES = ("truck", "kabe-damped", "yang-brown-high")

KINDS: dict[str, str] = {
    "sound": "drawn from the prior",
    "range 10 %": "one parameter a tenth of its range outside its bounds",
    "range 25 %": "one parameter a quarter of its range outside its bounds",
    "spring": "a spring too many, a fifth of the median stiffness, where no updated spring is",
    "swapped": "two responses under each other's name",
    "gain": "one response 10 % too large",
    "polarity": "one response with its sign inverted",
    "missing": "one response not measured",
}
"""Kind of measurement -> what is done to it."""


@dataclass(frozen=True, eq=False)
class Bench:
    """A chain with its channels and the updater trained for them."""

    name: str
    chain: Chain
    example: Example
    updater: Updater

    def measured(self, chain: Chain, theta: NDArray, rng: np.random.Generator) -> Frf:
        """FRF of a chain with noise, on the updater's channels."""
        e, lines = self.example, self.updater.frequency
        value = frf(chain, theta, lines, e.outputs, e.inputs)
        scatter = NOISE * np.abs(value)
        error = (rng.standard_normal(value.shape) + 1j * rng.standard_normal(value.shape)) * scatter / np.sqrt(2)
        return Frf(lines, value + error, e.outputs, e.inputs, variance=scatter**2)


def bench(name: str, samples: int, say: Say) -> Bench:
    """A chain of the examples with a clean updater of `samples` samples."""
    e = EXAMPLES[name]()
    assert isinstance(e.structure, Chain)
    lines = np.unique(np.concatenate([np.linspace(b.low, b.high, 60) for b in e.bands]))
    updater = Updater.train(
        e.structure, e.bands, e.outputs, e.inputs, lines, samples=samples,
        progress=lambda done, total: say(f"{name}: training", done, total),
    )  # fmt: skip
    return Bench(name, e.structure, e, updater)


def flags(sets: int, seed: int, say: Say, structures: tuple[str, ...] = STRUCTURES) -> dict[str, Any]:
    """Counts for every structure and kind of measurement, ready for JSON.

    Parameters
    ----------
    sets : int
        Measurements of each kind.
    seed : int
    """
    out: dict[str, Any] = {"sets": sets, "noise": NOISE, "seed": seed, "kinds": KINDS, "structures": {}}
    for name in structures:
        made = bench(name, EXAMPLES[name]().samples, say)
        rows = {}
        for number, kind in enumerate(KINDS):
            rng = np.random.default_rng([seed, number])
            rows[kind] = _counted(made, kind, sets, rng)
            say(f"{name}: {kind}", number + 1, len(KINDS))
        out["structures"][name] = rows
    return out


def _counted(made: Bench, kind: str, sets: int, rng: np.random.Generator) -> dict[str, Any]:
    network = either = refused = 0
    worst = 0.0
    thetas = truncated_samples(made.chain.parameters, rng.random((sets, len(made.chain.parameters))))
    for theta in thetas:
        measurement, truth = _SPOIL[kind](made, theta, rng)
        try:
            estimate = made.updater.estimate(measurement)
        except ChannelError:
            refused += 1
            continue
        seen = any(w.startswith("outside the training range") for w in estimate.warnings)
        doubted = any(w.startswith("misfit") or "ended at its bound" in w for w in estimate.warnings)
        network += seen
        either += seen or doubted
        if not (seen or doubted):
            worst = max(worst, _in_deviations(estimate, truth))
    return {
        "sets": sets, "refused": refused, "flagged_by_network": network, "flagged": either + refused,
        "worst_unflagged_in_std": worst,
    }  # fmt: skip


def _in_deviations(estimate: Estimate, truth: NDArray) -> float:
    return float((np.abs(estimate.value - truth) / estimate.std).max())


Spoilt = tuple[Frf, NDArray]


def _sound(made: Bench, theta: NDArray, rng: np.random.Generator) -> Spoilt:
    return made.measured(made.chain, theta, rng), theta


def _outside(share: float) -> Callable[[Bench, NDArray, np.random.Generator], Spoilt]:
    def spoil(made: Bench, theta: NDArray, rng: np.random.Generator) -> Spoilt:
        which = int(rng.integers(theta.size))
        p: Parameter = made.chain.parameters[which]
        reach = share * (p.upper - p.lower)
        moved = theta.copy()
        moved[which] = p.upper + reach if rng.random() < 0.5 else p.lower - reach
        return made.measured(made.chain, moved, rng), moved

    return spoil


def _spring(made: Bench, theta: NDArray, rng: np.random.Generator) -> Spoilt:
    """Not beside a spring that is updated: the estimate would rightly absorb it."""
    known = {p.name: p.nominal for p in made.chain.parameters}
    links = made.chain.links
    stiffness = [known[k.stiffness] if isinstance(k.stiffness, str) else float(k.stiffness) for k in links]
    taken = {frozenset((k.a, k.b)) for k in links if isinstance(k.stiffness, str)}
    free = [p for p in combinations([*made.chain.masses, GROUND], 2) if frozenset(p) not in taken]
    a, b = free[int(rng.integers(len(free)))]
    extra = Link(a, b, 0.2 * float(np.median(stiffness)))
    return made.measured(replace(made.chain, links=(*made.chain.links, extra)), theta, rng), theta


def _turned(made: Bench, theta: NDArray, rng: np.random.Generator, turn: Callable[[NDArray, int, int], None]) -> Spoilt:
    found = made.measured(made.chain, theta, rng)
    value, variance = np.array(found.value), np.array(found.variance)
    one, other = rng.choice(len(value), 2, replace=False)
    for a in (value, variance):
        turn(a, int(one), int(other))
    return replace(found, value=value, variance=variance), theta


def _swapped(made: Bench, theta: NDArray, rng: np.random.Generator) -> Spoilt:
    def turn(a: NDArray, one: int, other: int) -> None:
        a[[one, other]] = a[[other, one]]

    return _turned(made, theta, rng, turn)


def _gain(made: Bench, theta: NDArray, rng: np.random.Generator) -> Spoilt:
    def turn(a: NDArray, one: int, other: int) -> None:
        del other
        a[one] *= 1.1 if np.iscomplexobj(a) else 1.1**2

    return _turned(made, theta, rng, turn)


def _polarity(made: Bench, theta: NDArray, rng: np.random.Generator) -> Spoilt:
    def turn(a: NDArray, one: int, other: int) -> None:
        del other
        a[one] *= -1.0 if np.iscomplexobj(a) else 1.0

    return _turned(made, theta, rng, turn)


def _missing(made: Bench, theta: NDArray, rng: np.random.Generator) -> Spoilt:
    found = made.measured(made.chain, theta, rng)
    gone = int(rng.integers(len(found.outputs)))
    kept = [i for i in range(len(found.outputs)) if i != gone]
    outputs: tuple[Channel, ...] = tuple(found.outputs[i] for i in kept)
    variance = np.asarray(found.variance)[kept]
    return Frf(found.frequency, found.value[kept], outputs, found.inputs, variance=variance), theta


_SPOIL: dict[str, Callable[[Bench, NDArray, np.random.Generator], Spoilt]] = {
    "sound": _sound,
    "range 10 %": _outside(0.10),
    "range 25 %": _outside(0.25),
    "spring": _spring,
    "swapped": _swapped,
    "gain": _gain,
    "polarity": _polarity,
    "missing": _missing,
}


def flags_table(found: dict[str, Any]) -> str:
    """Text: share flagged by the network's check, and by it or the refinement (misfit, or a parameter at its bound)."""
    noise, sets = 100 * found["noise"], found["sets"]
    lines = [f"Flags at {noise:g} % noise, {sets} measurements of each kind (seed {found['seed']})"]
    for name, rows in found["structures"].items():
        lines += ["", name, f"{'kind':12}{'network':>10}{'either':>10}{'refused':>10}   worst unflagged (std)"]
        for kind, row in rows.items():
            n = row["sets"]
            lines.append(
                f"{kind:12}{100 * row['flagged_by_network'] / n:9.1f}%{100 * row['flagged'] / n:9.1f}%"
                f"{100 * row['refused'] / n:9.1f}%   {row['worst_unflagged_in_std']:.3g}"
            )
    return "\n".join(lines) + "\n"
