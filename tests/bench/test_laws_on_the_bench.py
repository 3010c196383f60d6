"""Nonlinear laws that the bench's own model file holds: measured as if they had been written into the rig."""

import numpy as np
import pytest
from typer.testing import CliRunner

from sessions.bench import measure
from sessions.cli import app
from sessions.rig import parse_rig
from sessions.store import open_session

from .rigs import shaker_rig, two_masses

ODD = ("drop_periods = 1", "drop_periods = 1\nodd = true\ndetection = 4")
QUIET = ("[simulated.channel.a2]\nnoise = 0.01\n", "")
RANGE = ("sensitivity = 0.1", "sensitivity = 0.01")
LEVELS = ("levels = [0.5, 2.0]", "levels = [8.0]")
JOINT = 'place = { kind = "joint", id = "1", to = "2" }'
MODAL = """
[structure]
kind = "modal"
[[structure.mode]]
frequency = 60.0
damping_ratio = 0.02
shape = {"1:x" = 0.5, "2:x" = 0.9}
[[structure.mode]]
frequency = 130.0
damping_ratio = 0.02
shape = {"1:x" = 0.5, "2:x" = -0.7}
"""
CUBIC = ("cubic-stiffness", "k3 = 2e13", [("cubic", {"k3": 2e13})])
PLAY = ("clearance", "k = 3e5, g = 4e-6", [("clearance", {"k": 3e5, "gap": 4e-6})])
SLIDER = ("stick-slip", "k_t = 1e5, F_s = 1.0", [("jenkins", {"k": 1e5, "force": 1.0})])
HELD = (
    "stick-slip", "k_t = 1e5, F_s = 1.0, held = 1",
    [("jenkins", {"k": 1e5, "force": 1.0}), ("clearance", {"k": -1e5, "gap": 0.0})],
)  # fmt: skip
SPREAD = (
    "stick-slip", "k_t = 1e5, F_s = 1.0, spread = 0.5, sliders = 2",
    [("jenkins", {"k": 5e4, "force": 0.375}), ("jenkins", {"k": 5e4, "force": 0.625})],
)  # fmt: skip


def entry(name, parameters):
    return f'\n[[mechanism]]\nid = "{name}"\nvariant = "x"\n{JOINT}\nparameters = {{ {parameters} }}\n'


def rig_of(folder, model, elements=()):
    """The shaker rig on a model, noise-free, at one level with lines left out, and elements of the rig's own."""
    folder.mkdir()
    rig = shaker_rig(folder, ODD, QUIET, RANGE, LEVELS)
    (folder / "model.toml").write_text(model)
    text = (folder / "rig.toml").read_text()
    for law, parameters in elements:
        values = ", ".join(f"{k} = {v!r}" for k, v in parameters.items())
        text += f'[[simulated.element]]\nlaw = "{law}"\nat = "2:x"\nto = "1:x"\nparameters = {{ {values} }}\n'
    rig.path.write_text(text)
    return parse_rig(text, rig.path)


def measured(rig):
    """Force and response of the run at its level, whole periods of 1024 frames."""
    path = rig.path.parent / "out.h5"
    assert measure(rig, path).complete
    with open_session(path) as session:
        run = next(r for r in session.runs if r.level == 8.0)
        return run.read(run.hits[0].stop - 4 * 1024, run.hits[0].stop)


def distortion(read):
    """Power of the response on the odd lines that nothing drives, over that on those that are driven."""
    spectrum = np.abs(np.fft.rfft(read.reshape(2, 4, 1024).mean(axis=1)))
    odd = np.arange(7, 349, 2)
    on = spectrum[0, odd] > 0.1 * spectrum[0, odd].max()
    return np.sum(spectrum[1, odd][~on] ** 2) / np.sum(spectrum[1, odd][on] ** 2)


@pytest.mark.parametrize("base", [two_masses(), MODAL], ids=["chain", "modal"])
@pytest.mark.parametrize("law", [CUBIC, PLAY, SLIDER, HELD, SPREAD], ids=["cubic", "play", "slider", "held", "spread"])
def test_a_law_of_the_model_acts_as_the_same_law_of_the_rig(tmp_path, base, law):
    """The model's law feels 2 less 1 (`to` less `id`), the rig's `at` less `to`."""
    name, parameters, elements = law
    inside = measured(rig_of(tmp_path / "inside", base + entry(name, parameters)))
    beside = measured(rig_of(tmp_path / "beside", base, elements))
    np.testing.assert_array_equal(inside, beside)
    without = distortion(measured(rig_of(tmp_path / "without", base)))
    assert without < 1e-8
    assert distortion(inside) > 1e3 * without


def test_the_bench_measures_what_simulate_writes(tmp_path):
    """The waveform is the same, so that the periods are, at the force that the bench came to."""
    rig = rig_of(tmp_path / "bench", two_masses() + entry("cubic-stiffness", "k3 = 1e12"))
    bench = measured(rig)
    words = [
        "simulate", rig.path.parent / "model.toml", "-o", tmp_path / "run.h5", "--excitation", "multisine", "--rate",
        1024, "--period", 1024, "--periods", 4, "--detection", 4, "--low", 5, "--high", 350, "--drive", "1:x",
        "--response", "2:x", "--level", repr(float(bench[0].std())),
    ]  # fmt: skip
    result = CliRunner().invoke(app, [str(w) for w in words])
    assert result.exit_code == 0, (result.output, result.exception)
    with open_session(tmp_path / "run.h5") as session:
        written = session.recordings()[0].data
    spectra = [np.fft.rfft(d.reshape(2, 4, 1024).mean(axis=1)) for d in (bench, written)]
    lines = np.arange(1, 350)
    line = lines[np.argmax(np.abs(spectra[0][0, lines]))]
    # the bench begins elsewhere in the period: a delay, which the driven lines of the force tell
    driven = np.abs(spectra[0][0]) > 0.1 * np.abs(spectra[0][0, line])
    delays = np.arange(0, 1024, 1 / 16)
    cross = (spectra[0][0] * spectra[1][0].conj())[driven]
    turn = np.exp(-2j * np.pi * np.outer(delays, np.flatnonzero(driven)) / 1024)
    delay = delays[np.argmax((turn.conj() @ cross).real)]
    moved = spectra[1] * np.exp(-2j * np.pi * np.arange(513) * delay / 1024)
    error = np.linalg.norm((moved - spectra[0])[:, lines], axis=1) / np.linalg.norm(spectra[0][:, lines], axis=1)
    assert error.max() < 2e-3, error
