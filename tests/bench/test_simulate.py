"""labnnum simulate: sessions whose estimates are those of the model within their stated random error."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.estimators import H1, Hits, Welch, periodic
from labnnum.response import frf
from sessions.cli import app
from sessions.model import read_model
from sessions.store import open_session

from .rigs import two_masses

K1 = """
[[parameter]]
name = "k1"
nominal = 8e5
lower = 6e5
upper = 1e6
"""
CHAIN = two_masses(first="k1", damping=(20.0, 10.0)) + K1


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(CHAIN)
    return path


def run(*words):
    return CliRunner().invoke(app, ["simulate", *map(str, words)])


ESTIMATORS = {
    "random": H1(Welch(4096)),
    "burst-random": H1(Welch(2048, "boxcar", 0.0)),
    "multisine": periodic,
    "periodic-random": periodic,
    "sweep": periodic,
    "hammer": H1(Hits()),
}


@pytest.mark.parametrize("excitation", sorted(ESTIMATORS))
def test_estimates_are_the_models_within_their_random_error(model, tmp_path, excitation):
    out = tmp_path / "run.h5"
    words = [model, "-o", out, "--excitation", excitation, "--rate", 1024, "--duration", 16]
    words += ["--noise", 0.01, "--bits", 16, "--set", "k1=7.5e5", "--seed", 3, "--low", 2, "--high", 400, "--json"]
    words += ["--period", 2048, "--hits", 12]
    result = run(*words)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["parameters"] == {"k1": 7.5e5}
    with open_session(out) as session:
        recordings = session.recordings()
        assert session.model_text == CHAIN
    estimate = ESTIMATORS[excitation](recordings)
    lines = (estimate.frequency > 20) & (estimate.frequency < 350)
    f = estimate.frequency[lines]
    exact = frf(read_model(model).structure, [7.5e5], f, estimate.outputs, estimate.inputs)
    z = (estimate.value[:, :, lines] - exact) / np.sqrt(estimate.variance[:, :, lines])
    spread = np.sqrt(np.mean(np.abs(z) ** 2))
    assert 0.8 < spread < 1.35
    assert recordings[0].level == (100.0 if excitation == "hammer" else 1.0)


def test_levels_and_realisations_are_runs_with_their_own_noise(model, tmp_path):
    out = tmp_path / "run.h5"
    words = [model, "-o", out, "--excitation", "multisine", "--rate", 512, "--period", 512, "--periods", 2]
    result = run(*words, "--level", 1, "--level", 2, "--realisations", 2, "--detection", 4, "--noise", 0.05)
    assert result.exit_code == 0, result.output
    with open_session(out) as session:
        recordings = session.recordings()
    assert [r.level for r in recordings] == [1.0, 1.0, 2.0, 2.0]
    assert {r.period for r in recordings} == {512}
    forces = np.array([r.data[0] for r in recordings])
    np.testing.assert_allclose(np.sqrt(np.mean(forces**2, axis=1)), [1, 1, 2, 2], rtol=0.01)
    assert np.linalg.matrix_rank(forces) == 4
    lines = np.abs(np.fft.rfft(forces[0].reshape(2, 512).mean(axis=0)))
    assert lines[2:200:2].max() < 0.1 * lines[1:200:2].max()


def test_same_seed_same_session(model, tmp_path):
    data = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        out = tmp_path / f"{name}.h5"
        assert run(model, "-o", out, "--rate", 512, "--duration", 4, "--noise", 0.1, "--seed", seed).exit_code == 0
        with open_session(out) as session:
            data.append(session.recordings()[0].data)
    np.testing.assert_array_equal(data[0], data[1])
    assert np.abs(data[0] - data[2]).max() > 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--excitation", "bang"], "expected one of random"),
        (["--drive", "base"], "no base excitation"),
        (["--drive", "9:x"], "no degree of freedom"),
        (["--response", "9:x"], "no degree of freedom"),
        (["--set", "k1"], "NAME=VALUE"),
        (["--set", "k9=1"], "the model has k1"),
        (["--low", "900"], "half the sample rate"),
    ],
)
def test_bad_words(model, tmp_path, words, message):
    out = tmp_path / "run.h5"
    result = run(model, "-o", out, "--rate", 512, "--duration", 2, *words)
    assert result.exit_code != 0
    assert message in str(result.exception)


def test_a_nonlinear_force_shows_on_the_detection_lines(model, tmp_path):
    words = ["--excitation", "multisine", "--rate", 1024, "--period", 1024, "--periods", 2, "--detection", 4]
    words += ["--high", 200, "--level", 1, "--level", 10, "--drive", "1:x", "--response", "2:x"]
    for name, more in (("linear", []), ("cubic", ["--nonlinear", "cubic 2:x 1:x k3=2e11"])):
        result = run(model, "-o", tmp_path / f"{name}.h5", *words, *more)
        assert result.exit_code == 0, result.output
    share = {}
    for name in ("linear", "cubic"):
        with open_session(tmp_path / f"{name}.h5") as session:
            for r in session.recordings():
                spectrum = np.abs(np.fft.rfft(r.data.reshape(2, 2, 1024).mean(axis=1)))
                odd = np.arange(1, 200, 2)
                excited = spectrum[0, odd] > 0.1 * spectrum[0].max()
                power = spectrum[1, odd] ** 2
                share[name, r.level] = power[~excited].sum() / power[excited].sum()
    assert share["linear", 10.0] < 1e-8
    assert share["cubic", 10.0] > 3e3 * share["cubic", 1.0] > 0  # odd distortion: 20 dB up make 40 dB of it
    bad = run(model, "-o", tmp_path / "bad.h5", "--nonlinear", "cubic 2:x k=1")
    assert "needs the parameters k3" in str(bad.exception)
