"""The Silverbox, an electronic Duffing oscillator: diagnosed from multisines, judged on a record that outgrows them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.errors import FileError
from labnnum.recording import Recording
from labnnum.structures.modal import ModalStructure
from sessions.exchange import read_any
from sessions.model import Model
from sessions.prove.real_figures import filter_figure, record_figure
from sessions.prove.real_rows import Row, said

FIRST = 50
"""Samples after which a start from another state than rest is forgotten."""


def _rms(x: NDArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def silverbox(data: Path, examples: Path, out: Path, progress: Callable[[str], None] = lambda text: None) -> list[Row]:
    """Rows of the comparison: base model from the quiet start of the arrow, diagnosis on multisines, both simulated."""
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
    d = run_files([file], model, (), examples / "multisine.channels.toml", progress=progress)
    write_answer(out, model, d)
    rows = [Row("Silverbox", "verdict", said(d), "a Duffing oscillator: cubic hardening, a small even part")]
    rows += [
        Row("Silverbox", f"{n.term.mechanism.id} {p.name}", f"{v:.4g} +- {s:.2g}")
        for n in d.named
        for p, v, s in zip(n.term.parameters, n.value, n.std, strict=True)
    ]
    answer = d.detail.get("nonlinear")
    if answer is None:
        return rows
    every = [r for r in _recordings(file, examples / "channels.toml")]
    progress("fitting each law alone")
    rows += _margin(answer, model, next(r for r in every if r.label.endswith("multisine 10")))
    rows += _filter_rows(answer, out)
    for label in ("arrow", "multisine 10"):
        progress(f"simulating {label}")
        one = next(r for r in every if r.label.endswith(label))
        run = padded(one, ARROW) if label == "arrow" else padded(one, 205.0, 0.0)
        measured = one.data[one.outputs[0]]
        made = {name: response(answer, run, linear=name == BASE)[0, : measured.size] for name in (BASE, LAWS_IN)}
        for name in made:
            rows += _errors(f"{label}, {name}", measured, made[name], *PUBLISHED.get((label, name), ("", "")))
        if label == "arrow":
            begun = started(answer, one, ARROW, FIRST, offset=made[LAWS_IN].mean())[0]
            rows += _errors(f"arrow, {LAWS_IN}, started from its first {FIRST} samples", measured, begun,
                            *PUBLISHED["arrow", LAWS_IN])  # fmt: skip
        left = 1e3 * (measured - made[LAWS_IN])[FIRST:]
        parts = ", ".join(f"{_rms(part - part.mean()):.2f}" for part in np.array_split(left, 6))
        rows.append(Row("Silverbox", f"{label}, extended, six parts in turn, mV RMS", parts))
        record_figure(out / f"{label.replace(' ', '-')}.svg", one.rate, measured, made[BASE], made[LAWS_IN], "V")
    return rows


ARROW = 220.0
"""Hz, up to which the arrow is excited."""
BASE, LAWS_IN = "linear base", "extended"
PUBLISHED = {
    ("arrow", BASE): ("best linear model of second order 14.3", ""),
    ("arrow", LAWS_IN): (
        "Duffing of six parameters 0.385; a NARX example 4.15; best black boxes, polynomial nonlinear state space"
        " (PNLSS) among them, about 0.26",
        "0.30",
    ),
    ("multisine 10", LAWS_IN): ("Duffing of six parameters 0.30", "0.28"),
}
"""mV RMS that others report, and that was asked for, by record and model."""
COMPARATORS = (
    "Silverbox: `python benchmarks/silverbox_comparators.py DIR/silverbox/SNLS80mV.mat` runs peers on the same data"
    " (linear ARX, Duffing, polynomial NARX, a perceptron, sparse identification); their figures are in"
    " examples/recordings/silverbox/README.md. PNLSS (Paduart et al., Automatica 46, 2010) was not run."
)
"""Where the peers that were run here are."""


def _errors(what: str, measured: NDArray, made: NDArray, published: str, asked: str) -> list[Row]:
    """RMS errors in mV of a simulated record: as it is; its mean taken off as the recording's was; and the same without
    the first samples.
    """
    left = 1e3 * (measured - made)
    level = left - left.mean()
    rest = left[FIRST:] - left[FIRST:].mean()
    return [
        Row("Silverbox", f"{what}, mV RMS", f"{_rms(left):.3f}", published, asked),
        Row("Silverbox", f"{what}, mean left out", f"{_rms(level):.3f}"),
        Row("Silverbox", f"{what}, first {FIRST} samples and mean left out", f"{_rms(rest):.3f}"),
    ]


def _filter_rows(found: NonlinearAnswer, out: Path) -> list[Row]:
    """Where the recorder's filter is 3 dB down, and the figure that shows it; none where none was found."""
    if found.recorder is None:
        return []
    filter_figure(out / "filter.svg", found.recorder)
    seen = found.recorder.seen
    rows = [Row("Silverbox", "harmonics above the band: coherence with those predicted", f"{seen.coherence:.3f}")]
    for name, (value, std, unit) in (
        found.named[-1]
        .term.mechanism.derived(found.recorder.fault.term, found.recorder.value, found.recorder.std)
        .items()
    ):
        rows.append(Row("Silverbox", f"recording-filter {name}, {unit}", f"{value:.4g} +- {std:.2g}"))
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
    rows = [Row("Silverbox", "first selection, one law alone, multisine 10, mV RMS", each)]
    if len(left) > 1:
        what = f"margin of the first choice, {left[0][1]} before {left[1][1]}"
        rows.append(Row("Silverbox", what, f"{left[1][0] / left[0][0]:.2f}", asked="2.5"))
    return rows


def _recordings(file: Path, channels: Path) -> list[Recording]:
    found = read_any(file, channels)
    if not isinstance(found, list):
        raise FileError(f"{file}: holds FRFs, not recordings")
    return found
