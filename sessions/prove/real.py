"""The real recordings by others: identified, diagnosed and simulated by the tool as it is, beside published figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.component import LAWS, Test, identify_component
from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.errors import FileError
from labnnum.recording import Recording
from labnnum.structures.modal import ModalStructure
from sessions.exchange import read_any
from sessions.model import Model
from sessions.prove.real_f16 import f16
from sessions.prove.real_figures import filter_figure, record_figure
from sessions.prove.real_rows import Row, said

SETS = ("silverbox", "f16", "friction_damper")
"""Recordings that are run, folders of the recordings' directory."""


def run_real(
    recordings: Path, examples: Path, out: Path, only: Sequence[str] = SETS,
    progress: Callable[[str], None] = lambda text: None,
) -> list[Row]:  # fmt: skip
    """Every set that is there, one after another; rows of the table.

    Parameters
    ----------
    recordings : Path
        Folder with one folder a set, see docs/nonlinear.md for the public sources.
    examples : Path
        Folder of the channels.toml files, examples/recordings.

    Raises
    ------
    FileError
        If none of the sets is there.
    """
    found = [name for name in only if (recordings / name).is_dir()]
    if not found:
        raise FileError(f"{recordings}: holds none of the folders {', '.join(only)}")
    rows: list[Row] = []
    for name in found:
        progress(name)
        rows += RUNS[name](recordings / name, examples / name, out / name)
    return rows


FIRST = 50
"""Samples after which a start from another state than rest is forgotten."""


def _rms(x: NDArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def silverbox(data: Path, examples: Path, out: Path) -> list[Row]:
    """Base model from the quiet start of the arrow, diagnosis on multisines, simulation of the arrow."""
    from labnnum.diagnosis.nonlinear.begun import started
    from labnnum.diagnosis.nonlinear.predict import padded, response
    from sessions.diagnose import run as run_files
    from sessions.diagnose import write_answer
    from sessions.identify import identify_files
    from sessions.model import read_model

    file = data / "SNLS80mV.mat"
    base = out / "base.toml"
    identify_files([file], base, examples / "start.channels.toml", 5.0, 200.0, modes=1)
    model = read_model(base)
    d = run_files([file], model, (), examples / "multisine.channels.toml")
    write_answer(out, model, d)
    rows = [Row("Silverbox", "verdict", said(d), "cubic hardening, small even part")]
    rows += [
        Row("Silverbox", f"{n.term.mechanism.id} {p.name}", f"{v:.4g} +- {s:.2g}", "")
        for n in d.named
        for p, v, s in zip(n.term.parameters, n.value, n.std, strict=True)
    ]
    answer = d.detail.get("nonlinear")
    if answer is None:
        return rows
    every = [r for r in _recordings(file, examples / "channels.toml")]
    rows += _margin(answer, model, next(r for r in every if r.label.endswith("multisine 10")))
    rows += _filter_rows(answer, out)
    for label, published in (("arrow", "linear 14.3, Duffing 0.385, NARX 4.15, black boxes 0.26"),
                             ("multisine 10", "Duffing 0.30")):  # fmt: skip
        one = next(r for r in every if r.label.endswith(label))
        run = padded(one, ARROW) if label == "arrow" else padded(one, 205.0, 0.0)
        measured = one.data[one.outputs[0]]
        made = {name: response(answer, run, linear=name == BASE)[0, : measured.size] for name in (BASE, LAWS_IN)}
        for name in made:
            rows += _errors(f"{label}, {name}", measured, made[name], published)
        if label == "arrow":
            begun = started(answer, one, ARROW, FIRST, offset=made[LAWS_IN].mean())[0]
            rows += _errors(f"arrow, {LAWS_IN}, started from its first {FIRST} samples", measured, begun, published)
        left = 1e3 * (measured - made[LAWS_IN])[FIRST:]
        parts = ", ".join(f"{_rms(part - part.mean()):.2f}" for part in np.array_split(left, 6))
        rows.append(Row("Silverbox", f"{label}, extended, six parts in turn, mV RMS", parts, ""))
        record_figure(out / f"{label}.svg", one.rate, measured, made[BASE], made[LAWS_IN], "V")
    return rows


ARROW = 220.0
"""Hz, up to which the arrow is excited."""
BASE, LAWS_IN = "linear base", "extended"


def _errors(what: str, measured: NDArray, made: NDArray, published: str) -> list[Row]:
    """RMS errors in mV of a simulated record: as it is; its mean taken off as the recording's was; and the same without
    the first samples.
    """
    left = 1e3 * (measured - made)
    level = left - left.mean()
    rest = left[FIRST:] - left[FIRST:].mean()
    return [
        Row("Silverbox", f"{what}, mV RMS", f"{_rms(left):.3f}", published),
        Row("Silverbox", f"{what}, mean left out", f"{_rms(level):.3f}", published),
        Row("Silverbox", f"{what}, first {FIRST} samples and mean left out", f"{_rms(rest):.3f}", published),
    ]


def _filter_rows(found: NonlinearAnswer, out: Path) -> list[Row]:
    """Where the recorder's filter is 3 dB down, and the figure that shows it; none where none was found."""
    if found.recorder is None:
        return []
    filter_figure(out / "filter.svg", found.recorder)
    seen = found.recorder.seen
    rows = [Row("Silverbox", "harmonics above the band: coherence with those predicted", f"{seen.coherence:.3f}", "")]
    for name, (value, std, unit) in (
        found.named[-1]
        .term.mechanism.derived(found.recorder.fault.term, found.recorder.value, found.recorder.std)
        .items()
    ):
        rows.append(Row("Silverbox", f"recording-filter {name}, {unit}", f"{value:.4g} +- {std:.2g}", ""))
    return rows


def _margin(found: NonlinearAnswer, model: Model, held: Recording) -> list[Row]:
    """What each single law leaves of a multisine that none was fitted to, and the runner-up's error over the best's."""
    from labnnum.diagnosis.nonlinear.identified import own_scatter
    from labnnum.diagnosis.nonlinear.laws import NAMES
    from labnnum.diagnosis.nonlinear.margin import single_laws
    from labnnum.diagnosis.nonlinear.predict import padded, response

    error = model.structure.error if isinstance(model.structure, ModalStructure) else 0.0
    run, measured = padded(held, 205.0, 0.0), held.data[held.outputs[0]]
    least: dict[str, float] = {}
    for one in single_laws(found, own_scatter(error)):
        made = response(one, run)[0, : measured.size]
        name = NAMES.get(one.laws[0].mechanism, one.laws[0].mechanism)
        least[name] = min(1e3 * _rms(measured - made), least.get(name, np.inf))
    left = sorted((value, name) for name, value in least.items())
    each = ", ".join(f"{name} {value:.3f}" for value, name in left)
    rows = [Row("Silverbox", "first selection, one law alone, multisine 10, mV RMS", each, "")]
    if len(left) > 1:
        what = f"margin of the first choice, {left[0][1]} before {left[1][1]}"
        rows.append(Row("Silverbox", what, f"{left[1][0] / left[0][0]:.2f}", "asked for 2.5"))
    return rows


def _recordings(file: Path, channels: Path) -> list[Recording]:
    found = read_any(file, channels)
    if not isinstance(found, list):
        raise FileError(f"{file}: holds FRFs, not recordings")
    return found


INCH, KIP = 0.0254, 4448.2216152605


def damper_tests(data: Path) -> list[Test]:
    """Component tests of the friction damper, in SI units, the first cycle left out of the errors."""
    import json

    out = []
    for file in sorted(data.glob("*.json")):
        content = json.loads(file.read_text(encoding="utf-8"))
        rows = np.array(content["data"], float)
        hertz = float(file.stem.split("_")[1].split("Hz")[0])
        skip = max(round(1024 / hertz / 256), 1)
        cycle = round(1024 / hertz / skip)
        z, f, v = rows[::skip, 1] * INCH, rows[::skip, 2] * KIP, rows[::skip, 3] * INCH
        out.append(Test(z, v, f, cycle, file.stem))
    if not out:
        raise FileError(f"{data}: holds no .json file")
    return out


def friction_damper(data: Path, examples: Path, out: Path) -> list[Row]:
    """Laws of force and motion fitted to the slow tests, judged on the others."""
    tests = damper_tests(data)
    slow = [t for t in tests if "_0.5Hz" in t.label or "_1Hz" in t.label]
    train, held = slow[::2] or tests, [t for t in slow if not any(t is s for s in slow[::2])] or tests
    fits = identify_component(train, held)
    best = fits[0]
    rows = [Row("friction damper", "law", best.law, "dry friction with backlash")]
    for (name, unit), value, std in zip(LAWS[best.law], best.value, best.std, strict=True):
        note = "about 7 mm of lost motion in all" if name == "backlash" else ""
        rows.append(Row("friction damper", f"{name}, {unit}", f"{value:.4g} +- {std:.2g}", note))
    if best.law == "stick-slip with clearance":
        lost = best.value[2] + 2 * best.value[1] / best.value[0]
        rows.append(
            Row("friction damper", "lost motion at reversal, play and elastic, mm", f"{1e3 * lost:.2f}", "about 7")
        )
    for f in fits:
        rows.append(Row("friction damper", f"held-out relative error, {f.law}", f"{f.held_out:.3f}", ""))
    return rows


RUNS: dict[str, Callable[[Path, Path, Path], list[Row]]] = {
    "silverbox": silverbox,
    "f16": f16,
    "friction_damper": friction_damper,
}


def as_dicts(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """For --json."""
    return [r.__dict__ for r in rows]
