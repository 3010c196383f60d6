"""Cases: a drawn truth, the session measured on it, and the files that a user would hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any
from zlib import crc32

from numpy.random import Generator, default_rng

from labnnum.errors import ConfigError
from sessions.prove.folder import matrices as matrices
from sessions.prove.folder import write_case as write_case
from sessions.prove.truth.bench import Bench
from sessions.prove.truth.benches import BENCHES, base_beam, free_beam
from sessions.prove.truth.channels import CHANNEL
from sessions.prove.truth.nonlinear import NONLINEAR, OUTSIDE_LAWS
from sessions.prove.truth.outside import OUTSIDE, outside_possible
from sessions.prove.truth.physics import STRUCTURAL, band, drift, possible, thickness
from sessions.prove.truth.session import Plan, Run, draw_plan, holding, record
from sessions.prove.truth.state import Fault, State, sound

LAWS = {**NONLINEAR, **OUTSIDE_LAWS}
MAKERS = {**STRUCTURAL, **CHANNEL, "drift": drift, **OUTSIDE, **LAWS}
BESIDE_LAWS = {"support-compliance", "joint-stiffness", "axial-preload", "shear-rotary", *CHANNEL, *LAWS}
"""Faults that may stand beside a nonlinear law, which is marched in time with real modes."""
KINDS = tuple(BENCHES)
EXCITATIONS = ("multisine", "random", "sweep", "hammer", "frf")


@dataclass(frozen=True, eq=False)
class Case:
    """One concealed case: the truth, and the session measured on it."""

    name: str
    seed: int
    state: State
    plan: Plan
    runs: tuple[Run, ...]
    units: tuple[tuple[str, float], ...]
    native: bool = False
    """Whether model.toml describes a beam or frame in its own words, and not by matrices."""

    @property
    def truth(self) -> dict[str, Any]:
        """What the sealed file holds of this case."""
        return {
            "case": self.name,
            "seed": self.seed,
            "kind": self.state.bench.kind,
            "excitation": self.plan.excitation,
            "model": self.state.bench.kind.split("-")[-1] if self.native else "matrices",
            "faults": [asdict(f) for f in self.told],
            "theta": self.state.bench.theta,
            "sensors": len(self.state.bench.sensors),
            "elements": [list(e) for e in self.state.bench.elements],
            "supports": list(self.state.bench.feet),
            "band": list(band(self.state)),
            "snr_db": self.plan.snr,
        }

    @property
    def told(self) -> tuple[Fault, ...]:
        """The faults, with what no measurement of this session tells from a slider that it never makes slip."""
        rng = streams(self.seed, self.state.bench.kind)[2]
        holds = iter(holding(rng, self.state, draw_plan(rng, self.state, self.plan.excitation)))
        return tuple(_held(f) if f.mechanism in LAWS and next(holds) else f for f in self.state.faults)


def _held(fault: Fault) -> Fault:
    """A slider that never slips: a spring at its place, or at one that moves alike."""
    springs = tuple((_spring_at(place), place) for place in (fault.place, *fault.places))
    return replace(fault, accept=(*fault.accept, *springs))


def _spring_at(place: dict[str, Any]) -> str:
    return "ground-stiffness" if place["kind"] == "ground" else "joint-stiffness"


def streams(seed: int, kind: str) -> list[Generator]:
    """Independent generators for structure, damping, measurement and units: faulty twins share them all."""
    return [default_rng([seed, KINDS.index(kind), i]) for i in range(4)]


def fault_stream(seed: int, kind: str, fault: str) -> Generator:
    """Generator of one fault, the same whatever stands beside it."""
    return default_rng([seed, KINDS.index(kind), 4, crc32(fault.encode())])


def make_case(
    seed: int,
    kind: str,
    fault: str | tuple[str, ...] | None = None,
    severity: float | tuple[float, ...] = 0.7,
    excitation: str = "multisine",
    sensors: int | None = None,
    name: str = "case",
) -> Case:
    """A case on a drawn structure of one kind, with the named faults at the given severities.

    Parameters
    ----------
    seed : int
        Fixes everything. 0 to 999 are for development; proofs use 1000 and above.
    kind : str
        "chain", "base-beam", "free-beam" or "frame".
    fault : str, tuple of str or None
        Names of `MAKERS`; None for a sound structure.
    severity : float or tuple
        0 invisible to 1 gross.
    excitation : str
        One of `EXCITATIONS`; "frf" hands out FRFs only.
    sensors : int, optional
        How many; drawn if None.

    Raises
    ------
    ConfigError
        If a kind, fault or excitation is unknown, or makes no sense on this kind of structure.
    """
    return measure(conceal(seed, kind, fault, severity, excitation, sensors, name))


def conceal(
    seed: int,
    kind: str,
    fault: str | tuple[str, ...] | None = None,
    severity: float | tuple[float, ...] = 0.7,
    excitation: str = "multisine",
    sensors: int | None = None,
    name: str = "case",
) -> Case:
    """The truth of `make_case` before any sample is taken: quick, and all that a seal needs."""
    faults = () if fault in (None, "null") else (fault,) if isinstance(fault, str) else tuple(fault or ())
    severities = (severity,) * len(faults) if isinstance(severity, int | float) else tuple(severity)
    _check(kind, faults, excitation)
    of_structure, of_damping, of_runs, of_units = streams(seed, kind)
    bench = _bench(of_structure, kind, faults, severities, sensors)
    state = sound(of_damping, bench, excitation != "hammer", viscous=bool(set(faults) & set(LAWS)))
    state = replace(state, swept=excitation == "sweep")
    lawful_last = sorted(range(len(faults)), key=lambda i: faults[i] in LAWS)
    for i in lawful_last:  # a law is made to the structure that it acts on
        state = MAKERS[faults[i]](fault_stream(seed, kind, faults[i]), state, float(severities[i]))
    made = dict(zip(lawful_last, state.faults, strict=True))
    state = replace(state, faults=tuple(made[i] for i in range(len(faults))))
    plan, units = draw_plan(of_runs, state, excitation), _units(of_units, state)
    describable = list(bench.zones) == ["E"] or kind == "frame"
    native = describable and bool(of_units.random() < 0.5)
    return Case(name, seed, state, plan, (), units, native)


def sound_twin(case: Case, number: int) -> Case:
    """A sound structure of the same make: same model, sensors and excitation, other ordinary errors and damping."""
    bench, viscous = case.state.bench, bool(case.state.laws)
    rng = default_rng([case.seed, KINDS.index(bench.kind), 5, number])
    state = sound(rng, replace(bench, truth=bench.again(rng)), case.state.shaken, viscous)
    return replace(case, state=replace(state, swept=case.state.swept), runs=())


def measure(case: Case, level: float = 1.0, snr: float | None = None) -> Case:
    """The case with its session measured; its drive `level` times as strong, `snr` dB over noise if given."""
    of_runs = streams(case.seed, case.state.bench.kind)[2]
    plan = draw_plan(of_runs, case.state, case.plan.excitation)
    plan = replace(plan, levels=tuple(level * x for x in plan.levels), snr=plan.snr if snr is None else snr)
    return replace(case, plan=plan, runs=record(of_runs, case.state, plan))


def _check(kind: str, faults: tuple[str, ...], excitation: str) -> None:
    if kind not in BENCHES:
        raise ConfigError(f"kind {kind!r} is not one of {', '.join(BENCHES)}")
    if excitation not in EXCITATIONS:
        raise ConfigError(f"excitation {excitation!r} is not one of {', '.join(EXCITATIONS)}")
    if excitation == "hammer" and kind == "base-beam":
        raise ConfigError("a base-beam is shaken, not hit: use excitation multisine or random")
    for fault in faults:
        if fault not in MAKERS:
            raise ConfigError(f"fault {fault!r} is not one of {', '.join(MAKERS)}")
        if not fits(fault, kind, excitation):
            raise ConfigError(f"fault {fault!r} makes no sense on a {kind} with {excitation} excitation")
    if set(faults) & set(LAWS) and not set(faults) <= BESIDE_LAWS:
        odd = next(f for f in faults if f not in BESIDE_LAWS)
        raise ConfigError(f"fault {odd!r} cannot stand beside a nonlinear law")


def fits(fault: str, kind: str, excitation: str) -> bool:
    """Whether a fault makes sense on a kind of structure with an excitation."""
    if fault == "drift":
        return excitation in ("multisine", "hammer")
    if fault in ("channel-clipping", *LAWS) and excitation == "frf":
        return False
    return possible(fault, kind, excitation != "hammer") and outside_possible(fault, kind)


def _bench(
    rng: Generator, kind: str, faults: tuple[str, ...], severities: tuple[float, ...], sensors: int | None
) -> Bench:
    if "shear-rotary" in faults:
        thick = thickness(severities[faults.index("shear-rotary")])
        return {"base-beam": base_beam, "free-beam": free_beam}[kind](rng, sensors, thick)
    return BENCHES[kind](rng, sensors)


def _units(rng: Generator, state: State) -> tuple[tuple[str, float], ...]:
    """Unit that each channel is stored in, and how many SI units that is."""
    out: list[tuple[str, float]] = [("m/s^2", 1.0) if state.bench.base is not None else ("N", 1.0)]
    for sensor in state.bench.sensors:
        if sensor.order == 1:
            out.append(("mm/s", 1e-3))
        else:
            out.append(("g", 9.80665) if rng.random() < 0.15 else ("m/s^2", 1.0))
    return tuple(out)
