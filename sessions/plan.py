"""Plan: how to measure a structure, proposed from its model: rate, lines, durations, levels, tip, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.simulated import TIPS, blow
from labnnum.errors import ModelError
from labnnum.hammer import force_reach
from labnnum.recording import Channel, Role
from labnnum.response import frf, modes
from labnnum.structures.base import Structure
from sessions.toml_write import dumps

Purpose = Literal["update", "diagnosis"]
Excitation = Literal["multisine", "random", "hammer", "stepped sine"]

RATES = (256, 512, 1024, 2048, 2560, 4096, 5120, 8000, 10240, 12800, 16000, 25600, 32000, 44100, 48000, 96000, 192000)
"""Sample rates of usual devices, Hz."""

LINES = {"multisine": 3.0, "random": 8.0, "hammer": 2.0, "stepped sine": 3.0}
"""Lines per half-power bandwidth: noise leaks through windows, whole periods and decayed hits do not."""

HALF_OVERLAP = 1.85
"""Independent averages per segment length with a Hann window and half overlap (Welch 1967)."""

SETTLED = math.log(1e3)
"""Nepers after which a transient is 0.1 %."""


@dataclass(frozen=True)
class Wishes:
    """What the person asked for.

    Parameters
    ----------
    excitation : str
    purpose : {"update", "diagnosis"}
        Diagnosis wants several levels, odd lines with detection lines, and several realisations.
    low, high : float or None
        Band in Hz; from the model's bands or modes if None.
    rate : float or None
        Samples per second of the device, if it is settled.
    damping : float
        Ratio taken for modes that the model leaves undamped.
    error : float
        Relative random error of |H| to reach where the coherence is `coherence`.
    coherence : float
    top : float
        Highest level, RMS in N or m/s^2 (peak N for a hammer).
    limit : float or None
        Peak response in m/s^2 that sensors take; lowers the highest level.
    """

    excitation: Excitation = "multisine"
    purpose: Purpose = "update"
    low: float | None = None
    high: float | None = None
    rate: float | None = None
    damping: float = 0.005
    error: float = 0.02
    coherence: float = 0.95
    top: float = 1.0
    limit: float | None = None


@dataclass(frozen=True)
class Proposal:
    """A plan: tables for a rig.toml, their reasons, and what it costs.

    Parameters
    ----------
    tables : mapping
        [device] rate, [excitation], [processing], and [trigger] and [plan] for a hammer.
    reasons : tuple of str
        One line for each choice, with its figure.
    seconds : float
        Time to measure, without setting up.
    modes : tuple of (frequency Hz, damping ratio)
        In the band.
    """

    tables: Mapping[str, Mapping[str, Any]]
    reasons: tuple[str, ...]
    seconds: float
    modes: tuple[tuple[float, float], ...]

    @property
    def toml(self) -> str:
        """The tables as they stand in a rig.toml, after their reasons."""
        head = "".join(f"# {r}\n" for r in self.reasons)
        return f"{head}\n{dumps({k: dict(v) for k, v in self.tables.items()})}"


def propose(structure: Structure, theta: NDArray, bands: Sequence[Any] = (), wishes: Wishes | None = None) -> Proposal:
    """A plan for a structure.

    Parameters
    ----------
    structure : Structure
    theta : ndarray, shape (n_parameters,)
    bands : sequence of Band
        Those that an updater uses.
    wishes : Wishes, optional

    Raises
    ------
    ModelError
        If the model is a rigid body, no mode lies in the band, or a hammer is asked for and the model is driven by its
        base.
    """
    w = wishes or Wishes()
    if structure.base and w.excitation == "hammer":
        raise ModelError(
            f"structure.base is {structure.base!r}: the model is driven by its base, and a hammer applies forces; leave"
            " out structure.base, or ask for another excitation"
        )
    found = _modes(structure, theta, w)
    low, high, why = _band(found, bands, w)
    inside = [(f, z) for f, z in found if low <= f <= high]
    if not inside:
        raise ModelError(
            f"no mode of the model lies between {low:g} and {high:g} Hz; the lowest is {found[0][0]:.4g} Hz"
        )
    facts = _Facts(tuple(inside), low, high, *_rate(high, w))
    reasons = [why, f"rate {facts.rate:g} Hz: {facts.rate_why}", _narrowest(facts)]
    make = {"multisine": _periodic, "random": _noise, "hammer": _hammer, "stepped sine": _stepped}[w.excitation]
    tables, more, seconds = make(facts, w)
    level_table, level_why = _levels(structure, theta, facts, w)
    tables["excitation"] = {**tables["excitation"], **level_table}
    reasons += [*more, *level_why]
    runs = max(len(level_table.get("levels", [0])), 1) * tables["excitation"].get("realisations", 1)
    ordered = {
        k: tables[k] for k in ("device", "excitation", "trigger", "quality", "plan", "processing") if k in tables
    }
    return Proposal(ordered, tuple(reasons), seconds * runs, tuple(inside))


@dataclass(frozen=True)
class _Facts:
    modes: tuple[tuple[float, float], ...]
    low: float
    high: float
    rate: float
    rate_why: str

    @property
    def bandwidth(self) -> float:
        """Narrowest half-power bandwidth, Hz."""
        return min(2 * z * f for f, z in self.modes)

    @property
    def decay(self) -> float:
        """Slowest decay rate, 1/s."""
        return min(2 * np.pi * f * z for f, z in self.modes)


def _modes(structure: Structure, theta: NDArray, w: Wishes) -> list[tuple[float, float]]:
    found = modes(structure, theta)
    flexible = found.frequency > 0
    if not flexible.any():
        raise ModelError("the model only moves as a rigid body: no mode tells which band to measure")
    ratio = np.where(found.damping_ratio > 0, found.damping_ratio, w.damping)
    return [(float(f), float(z)) for f, z in zip(found.frequency[flexible], ratio[flexible], strict=True)]


def _band(found: list[tuple[float, float]], bands: Sequence[Any], w: Wishes) -> tuple[float, float, str]:
    if bands:
        low, high = min(b.low for b in bands), max(b.high for b in bands)
        why = f"band {low:.4g} to {high:.4g} Hz: the model's bands"
    else:
        high = 1.2 * found[min(3, len(found) - 1)][0]
        low, why = 0.5 * found[0][0], f"band up to {high:.4g} Hz: the model's first {min(4, len(found))} modes"
    if w.low is not None or w.high is not None:
        low, high = w.low if w.low is not None else low, w.high if w.high is not None else high
        why = f"band {low:.4g} to {high:.4g} Hz: as you asked"
    return low, high, why


def _rate(high: float, w: Wishes) -> tuple[float, str]:
    if w.rate is not None:
        share = high / w.rate
        note = "" if share <= 0.43 else "; converters are not flat above 0.43 of it: lower the band or raise the rate"
        return w.rate, f"the device's, the band ends at {share:.2f} of it{note}"
    wanted = 2.56 * high
    rate = next((r for r in RATES if r >= wanted), RATES[-1])
    return float(rate), f"2.56 times the highest frequency is {wanted:.4g} Hz"


def _narrowest(facts: _Facts) -> str:
    f, z = min(facts.modes, key=lambda m: m[0] * m[1])
    return f"narrowest half-power bandwidth {facts.bandwidth:.3g} Hz, at {f:.4g} Hz with damping {100 * z:.2g} %"


def _block(facts: _Facts, lines: float) -> int:
    """Samples so that `lines` lines fall into the narrowest bandwidth: a power of two."""
    return 2 ** math.ceil(math.log2(facts.rate * lines / facts.bandwidth))


def _averages(w: Wishes) -> int:
    """Independent averages for the random error wanted (Bendat and Piersol 2010, table 9.6)."""
    return max(2, math.ceil((1 - w.coherence) / (w.coherence * 2 * w.error**2)))


def _lines_why(facts: _Facts, block: int, kind: str) -> str:
    per = facts.bandwidth * block / facts.rate
    return f"{block} samples, lines {facts.rate / block:.3g} Hz apart: {per:.2g} lines in it, {LINES[kind]:g} wanted"


def _periodic(facts: _Facts, w: Wishes) -> tuple[dict[str, Any], list[str], float]:
    diagnosis = w.purpose == "diagnosis"
    block = _block(facts, LINES["multisine"] * (2 if diagnosis else 1))
    drop = max(1, math.ceil(SETTLED / facts.decay * facts.rate / block))
    periods = 8 if diagnosis else max(4, math.ceil(_averages(w) / 4))
    excitation = {
        "kind": "multisine", "low": _round(facts.low), "high": _round(facts.high), "period": block,
        "periods": periods, "drop_periods": drop, "realisations": 2 if diagnosis else 1,
        "odd": diagnosis, "detection": 4 if diagnosis else 0,
    }  # fmt: skip
    why = [
        f"period of {_lines_why(facts, block, 'multisine')}" + (" (odd lines only)" if diagnosis else ""),
        f"{drop} period(s) dropped: the slowest transient falls to 0.1 % in {SETTLED / facts.decay:.2g} s",
    ]
    if diagnosis:
        why.append("odd lines with one in four withheld tell odd from even distortion; 2 realisations, 8 periods")
    else:
        why.append(f"{periods} periods: their scatter is the noise of each line")
    return _tables(facts, excitation, {"estimator": "periodic"}), why, (periods + drop) * block / facts.rate


def _noise(facts: _Facts, w: Wishes) -> tuple[dict[str, Any], list[str], float]:
    block, averages = _block(facts, LINES["random"]), _averages(w)
    seconds = math.ceil(averages * block / facts.rate / HALF_OVERLAP)
    excitation = {"kind": "random", "low": _round(facts.low), "high": _round(facts.high), "duration": float(seconds)}
    settle = max(0.5, SETTLED / facts.decay)
    excitation["settle"] = _round(settle)
    why = [
        f"segments of {_lines_why(facts, block, 'random')}, for a window leaks",
        f"{averages} averages: random error {w.error:.1%} of |H| where the coherence is {w.coherence:g}",
    ]
    processing = {"estimator": "H1", "window": "hann", "segment": block, "overlap": 0.5}
    return _tables(facts, excitation, processing), why, seconds + settle


def _hammer(facts: _Facts, w: Wishes) -> tuple[dict[str, Any], list[str], float]:
    needed = math.log(20) / facts.decay
    longest = 20.0
    length = min(max(needed, LINES["hammer"] / facts.bandwidth / 2), longest)
    decay = 0.0 if length >= needed else (math.log(20) - facts.decay * length) / length
    tip, reach = _tip(facts.high)
    hits = min(max(3, math.ceil(_averages(w) / 4)), 10)
    excitation = {"kind": "hammer", "low": _round(facts.low), "high": _round(facts.high)}
    tables = _tables(facts, excitation, {"estimator": "H1", **({"decay": _round(decay)} if decay else {})})
    tables["trigger"] = {
        "level": _round(0.05 * w.top),
        "pre": _round(max(0.01, 48 / facts.rate)),
        "duration": _round(length),
    }
    tables["quality"] = {"reach": _round(facts.high)}
    tables["plan"] = {"hits": hits}
    why = [
        f"{length:.2g} s a hit: the slowest mode falls to 5 % in {needed:.2g} s",
        f"tip: {tip}, its force spectrum has dropped by 20 dB at {reach:.4g} Hz only",
        f"{hits} hits at each point",
    ]
    if decay:
        why.append(f"an exponential window of {decay:.3g} 1/s for the rest; its damping is taken out again")
    return tables, why, hits * (length + 1.0)


def _stepped(facts: _Facts, w: Wishes) -> tuple[dict[str, Any], list[str], float]:
    lines, spacing, apart = _tones(facts)
    settle = SETTLED / facts.decay
    excitation = {
        "kind": "stepped sine", "low": _round(facts.low), "high": _round(facts.high), "lines": lines,
        "spacing": spacing, "settle": _round(settle), "cycles": 20,
        "directions": ["up", "down"] if w.purpose == "diagnosis" else ["up"],
    }  # fmt: skip
    passes = len(excitation["directions"])
    tone = 2 * (settle + 0.15) + 25 / (0.5 * (facts.low + facts.high))
    why = [
        f"{lines} tones, {apart} apart: {LINES['stepped sine']:g} in the half-power bandwidth of every mode",
        f"{settle:.2g} s before each: the slowest transient falls to 0.1 %",
        f"{passes * lines * tone:.0f} s a level: a band around one mode (--low, --high), or a multisine, takes less",
    ]
    return _tables(facts, excitation, {}), why, passes * lines * tone


def _tones(facts: _Facts) -> tuple[int, str, str]:
    """How many tones resolve every mode, their spacing (whichever law needs fewer), and how far apart they are."""
    wanted = LINES["stepped sine"]
    even = math.ceil((facts.high - facts.low) / facts.bandwidth * wanted) + 1
    if facts.low > 0:
        ratio = 1 + min(2 * z for f, z in facts.modes) / wanted
        growing = math.ceil(math.log(facts.high / facts.low) / math.log(ratio)) + 1
        if growing < even:
            return max(growing, 20), "log", f"{100 * ((facts.high / facts.low) ** (1 / (growing - 1)) - 1):.2g} %"
    return max(even, 20), "linear", f"{(facts.high - facts.low) / (max(even, 20) - 1):.3g} Hz"


def _tables(facts: _Facts, excitation: dict[str, Any], processing: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {"device": {"rate": facts.rate}, "excitation": excitation}
    return {**out, "processing": processing} if processing else out


def _tip(high: float) -> tuple[str, float]:
    """The softest tip whose force reaches the band's end."""
    reaches = {}
    for name in TIPS:
        rate = 400 / TIPS[name][0]
        t = np.arange(4096) / rate
        reaches[name] = force_reach(blow(name, 1e-3, 1.0).force(t), rate)
    enough = [name for name in reversed(TIPS) if reaches[name] >= high]
    best = enough[0] if enough else max(reaches, key=lambda n: reaches[n])
    return best, reaches[best]


def _levels(structure: Structure, theta: NDArray, facts: _Facts, w: Wishes) -> tuple[dict[str, Any], list[str]]:
    if w.excitation == "hammer":
        return {}, []
    per = _response(structure, theta, facts)
    top = w.top
    unit = "m/s^2" if structure.base else "N"
    why = [f"a level of 1 {unit} RMS gives up to {per:.3g} m/s^2 RMS"]
    if w.limit is not None and 4.5 * per * top > w.limit:
        top = w.limit / (4.5 * per)
        why.append(f"highest level {top:.3g} {unit}: peaks of 4.5 RMS stay below {w.limit:g} m/s^2")
    if w.purpose == "diagnosis":
        levels = [_round(top * k) for k in (0.1, 0.3162, 1.0)]
        why.append("three levels, 10 dB apart: what changes with level is not linear")
        return {"levels": levels}, why
    return {"levels": [_round(top)]}, why


def _response(structure: Structure, theta: NDArray, facts: _Facts) -> float:
    """RMS acceleration of the place that moves most, per unit RMS of flat excitation."""
    places = [d for d in structure.dofs if d.partition(":")[2] in ("x", "y", "z")]
    outputs = [_channel(d, "acceleration", "response") for d in places]
    if structure.base:
        drive = Channel("base", "acceleration", "base", "", structure.base)
    else:
        drive = _channel(places[-1], "force", "reference")
    step = min(facts.bandwidth / 4, (facts.high - facts.low) / 400)
    lines = np.linspace(facts.low, facts.high, min(int((facts.high - facts.low) / step) + 1, 20000))
    value = frf(structure, theta, lines, outputs, [drive])
    return float(np.sqrt(np.mean(np.abs(value[:, 0]) ** 2, axis=-1)).max())


def _channel(dof: str, quantity: str, role: Role) -> Channel:
    node, _, direction = dof.partition(":")
    return Channel(f"{quantity} {dof}", quantity, role, node, direction)


def _round(value: float) -> float:
    return float(f"{value:.3g}")
