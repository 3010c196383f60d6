"""The demo: the dissertation's beam, measured on the simulated bench and updated, the way a user would do it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labnnum.errors import FileError
from labnnum.frf import Frf
from labnnum.parameters import Estimate, truncated_samples
from labnnum.updating.updater import Updater
from sessions.bench import measure
from sessions.devices import model_text
from sessions.model import Model, read_model
from sessions.report.page import write_report
from sessions.rig import read_rig
from sessions.starters import write_starter
from sessions.updaters import load_updater, save_updater
from sessions.updating import choose_frf, run_update, store

STEPS = ("setting up", "measuring", "training the updater", "updating", "writing the report")

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Demo:
    """What the demo made.

    Parameters
    ----------
    folder : Path
        rig.toml, model.toml, beam.h5 and beam.html.
    updater : Path
        Trained once, used by every later demo in the same place.
    estimate : Estimate
    truth : dict
        Parameter name -> value that the simulated beam really had.
    frf : Frf
    """

    folder: Path
    updater: Path
    estimate: Estimate
    truth: dict[str, float]
    frf: Frf

    @property
    def session(self) -> Path:
        """The measurement with everything that came of it."""
        return self.folder / "beam.h5"

    @property
    def report(self) -> Path:
        """The page to look at."""
        return self.folder / "beam.html"

    def as_dict(self) -> dict[str, dict[str, dict[str, float | str]]]:
        """What `labnnum demo --json` prints."""
        found = self.estimate.as_dict()
        return {"parameters": {name: {"true": true, **found[name]} for name, true in self.truth.items()}}


def run_demo(place: Path, seed: int = 0, samples: int = 1000, say: Say = lambda _: None) -> Demo:
    """Measure the dissertation's beam on the simulated bench, update its model, write the report.

    Parameters
    ----------
    place : Path
        Folder that holds the updater and a folder for each demo; made if need be.
    seed : int
        Draws the true parameters from their prior, the excitation and the noise.
    samples : int
        Parameter sets to train on, where there is no updater yet.
    say : callable
        Told what is done next.
    """
    say(STEPS[0])
    folder = _free(place, seed)
    write_starter(folder, "simulated", "beam", seed=seed)
    model = read_model(folder / "model.toml")
    truth = draw_truth(model, seed)
    with (folder / "rig.toml").open("a", encoding="utf-8") as rig_file:
        rig_file.writelines(f"{name} = {value!r}\n" for name, value in truth.items())
    say(STEPS[1])
    rig = read_rig(folder / "rig.toml")
    measure(rig, folder / "beam.h5", model_text=model_text(rig))
    measured = choose_frf(folder / "beam.h5")
    updater = place / "beam-updater.h5"
    if not updater.exists():
        say(STEPS[2])
        save_updater(updater, train_updater(model, measured.frf, samples, seed), model)
    say(STEPS[3])
    load_updater(updater, model.structure)
    done = run_update(measured, updater, folder / "model.toml")
    store(folder / "beam.h5", done, truth)
    say(STEPS[4])
    write_report(folder / "beam.h5", folder / "beam.html")
    return Demo(folder, updater, done.estimate, truth, measured.frf)


def draw_truth(model: Model, seed: int) -> dict[str, float]:
    """Parameter name -> value, drawn from the prior."""
    parameters = model.structure.parameters
    uniform = np.random.default_rng(seed).random((1, len(parameters)))
    return {p.name: float(v) for p, v in zip(parameters, truncated_samples(parameters, uniform)[0], strict=True)}


def train_updater(model: Model, frf: Frf, samples: int, seed: int) -> Updater:
    """An updater for measurements like `frf`."""
    return Updater.train(
        model.structure, model.bands, frf.outputs, frf.inputs, frf.frequency, samples=samples, seed=seed, like=frf
    )


def _free(place: Path, seed: int) -> Path:
    """A folder that is not there yet: nothing is written over."""
    for number in range(1, 10_000):
        folder = place / (f"seed-{seed}" if number == 1 else f"seed-{seed}-{number}")
        if not folder.exists():
            return folder
    raise FileError(f"{place}: is full of demos; delete some")
