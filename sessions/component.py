"""Component tests of files: force against imposed motion, the law that ties them, with intervals."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from labnnum.component import EXPLAINED, Fitted, identify_component, relative_error
from labnnum.component_intervals import beside_viscous
from labnnum.component_laws import LAWS, ComponentTest, force
from labnnum.component_loops import reversal_travel, steady_cycles, work_per_cycle
from labnnum.errors import ChannelError, EstimationError
from labnnum.recording import Recording
from sessions.component_figures import loops_figure
from sessions.exchange import load_recordings

VISCOUS = "viscous"
"""Law that every answer is compared with."""


def read_tests(
    files: Sequence[Path], channels: Path | None = None, motion: str = "", opposing: str = ""
) -> list[ComponentTest]:
    """Component tests in sessions or files of other programs; every stretch without a break is one.

    The first cycle of the motion does not count: in it laws with memory find their state. Where no channel measures
    velocity, the motion is differentiated (Savitzky and Golay 1964, cubic, over a twenty-fifth of a cycle).

    Parameters
    ----------
    files : sequence of Path
    channels : Path, optional
        channels.toml of files of another program.
    motion, opposing : str
        Names of the channels of motion and force; needed only where several measure a displacement or a force.

    Raises
    ------
    ChannelError
        If no channel, or more than one, is a displacement or a force.
    EstimationError
        If a stretch holds fewer than two cycles.
    """
    out = []
    for file in files:
        for r in load_recordings([file], channels):
            z, f = _channel(r, "displacement", motion, "--motion"), _channel(r, "force", opposing, "--force")
            v = next((i for i, c in enumerate(r.channels) if c.quantity == "velocity"), None)
            spans = list(r.spans())
            for k, (a, b) in enumerate(spans):
                label = r.label if len(spans) == 1 else f"{r.label}, part {k + 1}"
                out.append(_test(r.data[:, a:b], z, f, v, r.rate, r.period, label))
    return out


def _channel(r: Recording, quantity: str, name: str, option: str) -> int:
    if name:
        at = r.index(name)
        if r.channels[at].quantity != quantity:
            raise ChannelError(
                f"{r.label}: channel {name!r} is a {r.channels[at].quantity}; {option} takes a {quantity}"
            )
        return at
    every = [i for i, c in enumerate(r.channels) if c.quantity == quantity]
    found = [i for i in every if r.channels[i].role != "monitor"] or every
    if len(found) == 1:
        return found[0]
    names = ", ".join(r.channels[i].name for i in found)
    why = f"{names} are each a {quantity}; say which by {option}" if found else f"no channel is a {quantity}"
    raise ChannelError(f"{r.label}: {why}")


def _test(
    data: NDArray[np.float64], z: int, f: int, v: int | None, rate: float, period: int, label: str
) -> ComponentTest:
    cycle = period or cycle_of(data[z])
    if data.shape[1] < 2 * cycle:
        raise EstimationError(f"{label}: fewer than two cycles of motion, of which the first is left out")
    window = max(2 * (cycle // 50) + 1, 5)
    speed = data[v] if v is not None else savgol_filter(data[z], window, 3, deriv=1, delta=1 / rate)
    return ComponentTest(data[z], speed, data[f], cycle, cycle, label)


def cycle_of(z: NDArray[np.float64]) -> int:
    """Samples in a cycle of a motion (n,): the median time between its upward passages of the middle, which count
    only once it was a quarter of its stroke away on either side; n where there are fewer than two.
    """
    middle = 0.5 * (z.max() + z.min())
    away = np.flatnonzero(np.abs(z - middle) > 0.25 * np.ptp(z) / 2)
    side = np.sign(z[away] - middle)
    up = np.flatnonzero((side[:-1] < 0) & (side[1:] > 0))
    if up.size < 2:
        return z.size
    passed = []
    for a, b in zip(away[up], away[up + 1], strict=True):
        at = a + int(np.flatnonzero(z[a : b + 1] >= middle)[0])
        passed.append(at - (z[at] - middle) / (z[at] - z[at - 1]))
    return max(round(float(np.median(np.diff(passed)))), 2)


@dataclass(frozen=True, eq=False)
class ComponentAnswer:
    """Laws of a component, the named one first, and the tests with their force as it opposes the motion.

    `turned` tells that the recorded force had the other sign and was turned.
    """

    fits: list[Fitted]
    tests: list[ComponentTest]
    held_out: list[ComponentTest]
    turned: bool

    @property
    def named(self) -> Fitted:
        """The law that is named."""
        return self.fits[0]

    def of(self, law: str) -> Fitted:
        """The fit of a law."""
        return next(f for f in self.fits if f.law == law)


def identify_tests(
    tests: Sequence[ComponentTest],
    held_out: Sequence[ComponentTest] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> ComponentAnswer:
    """Laws fitted to tests and judged on those held out; a force that drives the motion is turned first."""
    turned = sum(np.sum(t.f[:-1] * np.diff(t.z)) for t in tests) < 0
    if turned:
        tests, held_out = ([replace(t, f=-t.f) for t in some] for some in (tests, held_out))
    return ComponentAnswer(identify_component(tests, held_out, progress), list(tests), list(held_out), bool(turned))


def content_of(found: ComponentAnswer) -> dict[str, Any]:
    """What component.json holds."""
    best, viscous = found.named, found.of(VISCOUS)
    coefficient, half = beside_viscous(best.law, best.value, found.tests)
    return {
        "schema": 1,
        "law": best.law if best.held_out <= EXPLAINED else None,
        "nearest": best.law,
        "judged_on": "held-out tests" if found.held_out else "the tests fitted to",
        "parameters": {
            name: {"value": value, "std": std, "half_90": width, "unit": unit}
            for (name, unit), value, std, width in zip(LAWS[best.law], best.value, best.std, best.half, strict=True)
        },
        "derived": {
            name: {"value": value, "std": std, "half_90": width, "unit": unit}
            for name, unit, value, std, width in best.derived
        },
        "viscous_beside": {"value": coefficient, "half_90": half, "unit": "N*s/m"},
        "laws": [{"law": f.law, "error": f.error, "held_out": f.held_out} for f in found.fits],
        "tests": [
            _row(t, best, viscous, held) for some, held in ((found.tests, False), (found.held_out, True)) for t in some
        ],
        "force_turned": found.turned,
    }


def _row(test: ComponentTest, best: Fitted, viscous: Fitted, held: bool) -> dict[str, Any]:
    made, plain = force(best.law, best.value, test), force(viscous.law, viscous.value, test)
    size = 0.5 * float(np.median(np.abs(test.f[steady_cycles(test)[0]])))
    return {
        "test": test.label,
        "held_out": held,
        "error": relative_error(best.law, best.value, [test]),
        "error_viscous": relative_error(viscous.law, viscous.value, [test]),
        "work_J": work_per_cycle(test, test.f),
        "work_law_J": work_per_cycle(test, made),
        "work_viscous_J": work_per_cycle(test, plain),
        "half_travel_m": reversal_travel(test, test.f, size),
        "half_travel_law_m": reversal_travel(test, made, size),
    }


def write_component(out: Path, found: ComponentAnswer, titles: Sequence[str] = ()) -> dict[str, Any]:
    """component.json and loops.svg in the folder `out`; the content of the former."""
    out.mkdir(parents=True, exist_ok=True)
    content = content_of(found)
    text = json.dumps(_plain(content), indent=1)
    (out / "component.json").write_text(text + "\n", encoding="utf-8")
    every = [*found.tests, *found.held_out]
    shown = [found.named] + ([found.of(VISCOUS)] if found.named.law != VISCOUS else [])
    laws = [(f.law, [force(f.law, f.value, t) for t in every]) for f in shown]
    names = titles or [
        f"{Path(t.label).stem}{', held out' if i >= len(found.tests) else ''}" for i, t in enumerate(every)
    ]
    loops_figure(out / "loops.svg", every, laws, names)
    return content


def _plain(value: Any) -> Any:
    """`value` with numbers that JSON has no word for as null."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
