"""`labnnum prove dissertation`: the dissertation's own structures, with what its models left out concealed in them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import default_rng

from labnnum.errors import ConfigError
from sessions.prove.answers import describe, held_out_ratio, judge
from sessions.prove.cases import Case, sound_twin
from sessions.prove.folder import write_case
from sessions.prove.jobs import each
from sessions.prove.measures import VISIBLE, plain
from sessions.prove.referee import misfit
from sessions.prove.run import TOOL, load
from sessions.prove.truth.dissertation import EFFECTS, Effect
from sessions.prove.truth.session import draw_plan, record
from sessions.prove.visible import TWINS, null_median

SNR, BITS = 60.0, 16


def case_of(effect: Effect) -> Case:
    """The concealed case of an effect, measured: random excitation for the beam, a hammer for the frame."""
    rng = default_rng([6, effect.seed])
    state = effect.state()
    excitation = "random" if effect.structure == "beam" else "hammer"
    plan = replace(draw_plan(rng, state, excitation), snr=SNR, bits=BITS)
    units = tuple((unit, 1.0) for unit in _units(effect))
    return Case(effect.name, effect.seed, state, plan, record(rng, state, plan), units)


def _units(effect: Effect) -> tuple[str, ...]:
    n = len(effect.state().bench.sensors)
    return ("m/s^2" if effect.structure == "beam" else "N", *(["m/s^2"] * n))


def visibility(case: Case) -> float:
    """The referee's chi2 of the case over that of sound twins, or of its kind where that is more."""
    sound = float(np.median([misfit(sound_twin(case, i)) for i in range(TWINS)]))
    return misfit(case) / max(sound, _of_kind(case.state.bench.kind))


@cache
def _of_kind(kind: str) -> float:
    return null_median(kind)


def answer(effect: Effect, out: Path, tool: str = TOOL) -> dict[str, Any]:
    """Write the case into `out`, have it diagnosed there if it was not yet, and say what the answer was worth."""
    case = case_of(effect)
    recordings = write_case(case, out / "cases" / effect.name)
    target = out / "answers" / effect.name
    target.mkdir(parents=True, exist_ok=True)
    if not (target / "diagnosis.json").is_file():
        load(tool)(recordings, out / "cases" / effect.name / "model.toml", target)
    said = json.loads((target / "diagnosis.json").read_text(encoding="utf-8"))
    return _row(effect, case, said, visibility(case))


def _row(effect: Effect, case: Case, said: dict[str, Any], visible: float) -> dict[str, Any]:
    truth = {**case.truth, "family": "structure"}
    judged = judge(json.loads(json.dumps(truth)), said)
    fault = case.state.faults[0] if case.state.faults else None
    if fault is None:
        right = not judged.alarm
    elif fault.inside:
        right = judged.both_right
    else:
        right = not judged.named and (judged.alarm or visible <= VISIBLE)
    errors = {name: error for name, (error, _) in judged.errors.items()}
    return {
        "case": effect.name,
        "concealed": asdict(fault) if fault else None,
        "what": (effect.make.__doc__ or "").splitlines()[0],
        "said": describe(said),
        "right": right,
        "base_over_extended": plain(held_out_ratio(said)),
        "parameter_errors": errors,
        "visibility": visible,
        "fit": said.get("fit"),
    }


def run(
    out: Path,
    jobs: int = 1,
    tool: str = TOOL,
    names: Sequence[str] = (),
    step: Callable[[int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """Every effect (or those named) concealed, diagnosed and judged; rows in the order of `EFFECTS`, kept in `out`."""
    unknown = set(names) - {e.name for e in EFFECTS}
    if unknown:
        raise ConfigError(f"case {min(unknown)!r} is not one of {', '.join(e.name for e in EFFECTS)}")
    todo = [e for e in EFFECTS if not names or e.name in names]
    rows: dict[str, dict[str, Any]] = {}
    for effect, row in each(partial(answer, out=out, tool=tool), todo, jobs):
        rows[effect.name] = row
        found = [rows[e.name] for e in todo if e.name in rows]
        (out / "dissertation.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        if step is not None:
            step(len(rows), len(todo))
    return [rows[e.name] for e in todo]
