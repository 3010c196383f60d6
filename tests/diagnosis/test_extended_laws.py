"""A model file that holds a nonlinear law: every command reads it, and the diagnosis knows what it holds."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import ConfigError
from labnnum.nonlinear import LAWS
from sessions.cli import app
from sessions.model import read_model
from sessions.store import open_session

MODEL = """
[structure]
kind = "chain"
[[structure.mass]]
node = "1"
mass = 2.0
[[structure.mass]]
node = "2"
mass = 1.0
[[structure.link]]
between = ["1", "ground"]
stiffness = "k1"
damping = 20.0
[[structure.link]]
between = ["1", "2"]
stiffness = 5e5
damping = 10.0
[[parameter]]
name = "k1"
nominal = 8e5
lower = 6e5
upper = 1e6
[[band]]
low = 25.0
high = 190.0
"""
LAW = """
[[mechanism]]
id = "cubic-stiffness"
variant = "x"
place = { kind = "joint", id = "1", to = "2" }
parameters = { k3 = { value = 2e11, std = 1e9, unit = "N/m^3" } }
"""
SHAKEN = [
    "--excitation", "multisine", "--rate", "1024", "--period", "1024", "--periods", "3", "--detection", "4", "--low",
    "20", "--high", "200", "--level", "1", "--level", "3", "--level", "10", "--drive", "1:x", "--response", "1:x",
    "--response", "2:x", "--noise", "1e-4", "--realisations", "2",
]  # fmt: skip
ENTRIES = {
    "cubic-stiffness": {"k3": 2e11},
    "quadratic-stiffness": {"k2": 2e8},
    "one-sided-gap": {"k": 1e5, "g": 1e-5},
    "clearance": {"k": 1e5, "g": 1e-5},
    "coulomb-friction": {"F": 0.1},
    "quadratic-damping": {"c2": 100.0},
    "stick-slip": {"k_t": 1e5, "F_s": 0.1},
    "hysteresis": {"k": 1e5, "limit": 1e-5, "n": 1.5, "beta_share": 0.6},
}


def run(*words):
    result = CliRunner().invoke(app, [str(w) for w in words])
    assert result.exit_code == 0, (result.output, result.exception)
    return result.stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("extended")
    (path / "plain.toml").write_text(MODEL)
    (path / "law.toml").write_text(MODEL + LAW)
    run("simulate", path / "law.toml", *SHAKEN, "-o", path / "run.h5")
    return path


@pytest.mark.parametrize("name", sorted(ENTRIES))
def test_each_law_of_a_file_becomes_an_element(name, tmp_path):
    values = ", ".join(f"{k} = {v!r}" for k, v in ENTRIES[name].items())
    entry = f'[[mechanism]]\nid = "{name}"\nvariant = "x"\nplace = {{ kind = "ground", id = "2" }}\n'
    (tmp_path / "model.toml").write_text(f"{MODEL}\n{entry}parameters = {{ {values} }}\n")
    structure = read_model(tmp_path / "model.toml").structure
    (element,) = structure.law_elements()
    assert len(element.parameters) == len(LAWS[element.law])
    np.testing.assert_array_equal(element.column, [0.0, 1.0])
    assert [p.name for p in structure.parameters] == ["k1"]  # what acts as nothing in an FRF is not updated


def test_the_simulated_session_holds_the_law(folder):
    odd = np.arange(1, 200, 2)
    share = {}
    with open_session(folder / "run.h5") as session:
        for r in session.recordings():
            spectrum = np.abs(np.fft.rfft(r.data.reshape(3, 3, 1024).mean(axis=1)))
            on = spectrum[0, odd] > 0.1 * spectrum[0].max()
            share[r.level] = np.sum(spectrum[1, odd][~on] ** 2) / np.sum(spectrum[1, odd][on] ** 2)
    assert share[10.0] > 100 * share[1.0] > 0


def test_the_diagnosis_knows_the_law_that_the_model_holds(folder):
    without = json.loads(
        run("diagnose", folder / "run.h5", "--model", folder / "plain.toml", "-o", folder / "a", "--json")
    )
    assert without["mechanism"]["id"] == "cubic-stiffness"
    held = json.loads(
        run("diagnose", folder / "run.h5", "--model", folder / "a/extended.toml", "-o", folder / "b", "--json")
    )
    assert held["verdict"] in ("consistent", "parameters"), held["summary"]
    assert held["fit"]["extended"]["held_out"] < 0.3 * without["fit"]["base"]["held_out"]
    assert held["summary"].startswith("With what it holds (cubic-stiffness at joint 1-2) the model explains the data")
    assert "cubic-stiffness" in (folder / "b/extended.toml").read_text()  # it is not lost on the way


def test_other_commands_read_it(folder):
    assert len(json.loads(run("modes", folder / "law.toml", "--json"))["modes"]) == 2
    run("frf", folder / "run.h5")
    run("train", folder / "law.toml", "--frf", folder / "run.h5", "--samples", 200, "-o", folder / "updater.h5")
    run("update", folder / "run.h5", "--updater", folder / "updater.h5")
    run("report", folder / "run.h5", "-o", folder / "report.html")
    assert (folder / "report.html").stat().st_size > 1000


SLIDERS = """
[[mechanism]]
id = "stick-slip"
variant = "x"
place = { kind = "joint", id = "1", to = "2" }
parameters = { k_t = 1e5, F_s = 0.1, spread = 0.8, sliders = %s }
"""


def test_sliders_of_a_file_are_as_many_as_it_says(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(MODEL + SLIDERS % "5")
    law = read_model(path).structure.laws[0]
    elements = law.term.mechanism.elements(law.term, [p.nominal for p in law.parameters])
    assert [e.law for e in elements] == ["jenkins"] * 5
    assert sum(e.parameters[0] for e in elements) == pytest.approx(1e5)
    assert sum(e.parameters[1] for e in elements) == pytest.approx(0.1)


@pytest.mark.parametrize("many", ["0", "2.5", "9"])
def test_a_number_of_sliders_that_cannot_be_is_refused(tmp_path, many):
    path = tmp_path / "model.toml"
    path.write_text(MODEL + SLIDERS % many)
    with pytest.raises(ConfigError, match=f"'sliders' is {many}; give a whole number, 1 to 8"):
        read_model(path)


def test_a_law_without_a_direction_names_the_key(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text(MODEL + SLIDERS.replace('variant = "x"\n', "") % "5")
    with pytest.raises(ConfigError, match=r"'stick-slip' at joint 1-2: key variant is missing"):
        read_model(path)
