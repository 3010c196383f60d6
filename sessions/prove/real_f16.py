"""The ground vibration test of an F-16: a base from the lowest level, diagnosis on three levels, a fourth withheld."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis import Diagnosis, Observation
from labnnum.diagnosis.nonlinear.identified import own_scatter
from labnnum.diagnosis.nonlinear.joined import Predicted, predictions, records
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.errors import EstimationError
from labnnum.peaks import peak
from labnnum.structures.modal import ModalStructure
from sessions.prove.real_figures import levels_figure, withheld_figure
from sessions.prove.real_rows import Row, said

LEVELS, HELD = (1, 3, 7), 5
"""Levels that are fitted to and the one that no fit sees."""
BAND = (2.5, 14.0)
"""Hz, of the identification; the excitation covers 2 to 15 Hz."""
TORSION = (6.8, 7.6)
"""Hz, where the peak of the wing's torsion is looked for."""


def f16(data: Path, examples: Path, out: Path, progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Rows of the comparison: verdict, place, errors at the withheld level, the torsion mode over the levels."""
    from sessions.diagnose import observations_of, run_observed, write_answer
    from sessions.identify import identify_files
    from sessions.model import read_model

    def observed(kind: str, level: int, channels: str) -> Observation:
        return observations_of([data / f"F16Data_{kind}_Level{level}.mat"], examples / channels)[0]

    base = out / "base.toml"
    found = identify_files([data / "F16Data_FullMSine_Level1.mat"], base, examples / "channels.toml", *BAND)
    sine = {i: observed("FullMSine", i, "channels.toml") for i in (*LEVELS, HELD)}
    sweep = {i: observed("SineSw", i, "sweep.channels.toml") for i in (*LEVELS, HELD)}
    model = read_model(base)
    train = [*(sine[i] for i in LEVELS), *(sweep[i] for i in LEVELS)]
    d = run_observed(train, model, [sine[HELD]], progress=progress)
    write_answer(out, model, d)
    rows = [
        Row("F-16", "base of level 1: modes, error", f"{len(found['modes'])}, {found['error']:.3f}"),
        Row("F-16", "verdict", said(d), "clearance and friction at the payload joint"),
        Row(
            "F-16",
            "place",
            f"{d.place}" if d.place else "none",
            "the joint of wing tip and payload: 2 - 3 (acc2, acc3)",
        ),
    ]
    rows += [Row("F-16", f"share of the distortion's timing, {p}", f"{s:.3f}") for p, s in d.located[:4]]
    for n in d.named:
        for p, value, std in zip(n.term.parameters, n.value, n.std, strict=True):
            rows.append(Row("F-16", f"{n.term.mechanism.id} {p.name}, {p.unit}", f"{value:.4g} +- {std:.2g}"))
    if "nonlinear" in d.detail and isinstance(model.structure, ModalStructure):
        rows += _errors(d, model.structure.error, (0.9 * BAND[0], 1.05 * BAND[1]), sine, sweep, out, progress)
    return rows


def _errors(
    d: Diagnosis, error: float, span: tuple[float, float], sine: dict[int, Observation],
    sweep: dict[int, Observation], out: Path, progress: Callable[[str], None],
) -> list[Row]:  # fmt: skip
    """Errors of the withheld level sensor by sensor, and the torsion mode, measured and simulated."""
    from dataclasses import replace

    progress("simulating the levels")
    answer, scatter = d.detail["nonlinear"], own_scatter(error)

    def periodic(i: int) -> Run:
        run = sine[i].run
        assert run is not None
        inside = (run.frequency >= span[0]) & (run.frequency <= span[1])
        return replace(run, miss=error, use=inside)

    runs = {("multisine", i): periodic(i) for i in sine}
    runs |= {("sweep", i): records([o], span, error)[0] for i, o in sweep.items()}
    train = [k for k in runs if k[1] != HELD]
    test = [k for k in runs if k[1] == HELD]
    linear, extended = (
        dict(zip((*train, *test), predictions(answer, [runs[k] for k in train], [runs[k] for k in test], scatter,
                                              linear=flag), strict=True))
        for flag in (True, False)
    )  # fmt: skip
    for kind in ("multisine", "sweep"):
        shown = [k for k in sorted(runs) if k[0] == kind]
        names = [f"level {i}" + (", withheld" if i == HELD else "") for _, i in shown]
        levels_figure(out / f"{kind}.svg", [linear[k] for k in shown], [extended[k] for k in shown], names)
    torsion = {k: _torsion(extended[k]) for k in sorted(runs)}
    peaks = {
        kind: [
            (runs[kind, i].level, at[0][0], at[1][0], i == HELD)
            for i in sorted((*LEVELS, HELD))
            if (at := torsion[kind, i]) is not None
        ]
        for kind in ("multisine", "sweep")
    }
    withheld_figure(out / "withheld.svg", linear["multisine", HELD], extended["multisine", HELD],
                    f"level {HELD}, multisine, withheld", peaks)  # fmt: skip
    rows = []
    low = sine[LEVELS[0]].run
    high = sine[HELD].run
    if low is not None and high is not None:
        rows.append(Row("F-16", f"level {HELD} multisine, relative error of the measured FRF of level 1",
                        _listed(_carried(low, high, span))))  # fmt: skip
    for kind, i in (*test, *train):
        own, plain = extended[(kind, i)].error, linear[(kind, i)].error
        held = " (withheld)" if i == HELD else ""
        rows.append(Row("F-16", f"level {i} {kind}{held}, relative error, base of level 1", _listed(plain)))
        asked = "a third of what the FRFs of level 1 leave" if i == HELD else ""
        rows.append(Row("F-16", f"level {i} {kind}{held}, relative error, extended", _listed(own), asked=asked))
    for kind, i in sorted(runs):
        rows.append(Row("F-16", f"torsion, level {i} {kind}, Hz and damping: measured; simulated",
                        _told(torsion[kind, i])))  # fmt: skip
    return rows


def _carried(low: Run, high: Run, span: tuple[float, float]) -> NDArray[np.float64]:
    """Errors of the FRFs measured at one level on another's responses."""
    at = low.excited & high.excited & (low.frequency >= span[0]) & (low.frequency <= span[1])
    missed = high.y[:, at] - low.y[:, at] / low.u[at] * high.u[at]
    return np.sqrt(np.sum(np.abs(missed) ** 2, axis=1) / np.sum(np.abs(high.y[:, at]) ** 2, axis=1))


def _listed(values: Sequence[float] | NDArray) -> str:
    return ", ".join(f"{v:.3f}" for v in values)


Peak = tuple[float, float]
"""Frequency in Hz and damping ratio."""


def _torsion(p: Predicted) -> tuple[Peak, Peak] | None:
    """The torsion mode at the last sensor, measured and simulated; None where either shows no peak."""
    try:
        seen, made = (peak(p.frequency, y[-1] / p.input, *TORSION) for y in (p.measured, p.made))
    except EstimationError:
        return None
    return (seen, made) if all(TORSION[0] <= f <= TORSION[1] for f, _ in (seen, made)) else None


def _told(found: tuple[Peak, Peak] | None) -> str:
    return "no peak" if found is None else "; ".join(f"{f:.3f} Hz {100 * z:.2f} %" for f, z in found)
