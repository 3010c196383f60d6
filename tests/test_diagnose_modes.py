"""Diagnosis from natural frequencies: what a model misses, what would explain it, and what cannot be told apart."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import FileError, ModelError
from labnnum.response import modes
from sessions.cli import app
from sessions.diagnose_modes import diagnose_modal_file, diagnose_modes, is_modal_table, read_modal_table
from sessions.modal_fit import candidates, fit_modes
from sessions.model import parse_model, read_model

SHEAR = Path(__file__).resolve().parents[1] / "examples" / "recordings" / "four_dof" / "shear.toml"
STIFFNESS = (9000.0, 7000.0, 10500.0, 8000.0)


def building(added=0.0):
    """Four storeys of unlike stiffness, whose top block weighs `added` kg more."""
    text = SHEAR.read_text()
    for k in STIFFNESS:
        text = text.replace('stiffness = "k"', f"stiffness = {k}", 1)
    masses = text.replace("mass = 0.1122", 'mass = "m"', 3).replace("mass = 0.1122", f"mass = {0.1122 + added}")
    parameter = '[[parameter]]\nname = "m"\nnominal = 0.1122\nlower = 0.09\nupper = 0.14\nstd = 0.01\nunit = "kg"'
    head, _, tail = masses.partition("[[parameter]]")
    return parse_model(f"{head}{parameter}\n{tail[tail.index('[[band]]') :]}", SHEAR)


def repeats(model, scatter=1e-3, n=40, theta=None):
    rng = np.random.default_rng(3)
    exact = modes(model.structure, model.structure.nominal if theta is None else theta, 4).frequency
    return exact * (1 + scatter * rng.standard_normal((n, 4)))


def test_a_model_that_holds_is_consistent_and_a_wrong_parameter_is_one():
    model = read_model(SHEAR)
    assert diagnose_modes(repeats(model), model)["verdict"] == "consistent"
    moved = diagnose_modes(repeats(model, theta=[9800.0]), model)
    assert moved["verdict"] == "parameters"
    assert moved["parameters"]["k"]["value"] == pytest.approx(9800.0, rel=2e-3)


def test_a_heavier_top_is_named_with_its_mass_where_storeys_differ():
    said = diagnose_modes(repeats(building(0.05)), building())
    mechanism = said["mechanism"]
    assert said["verdict"] == "missing-physics"
    assert mechanism["id"] == "added-mass"
    assert said["place"]["id"] == "4"
    mass = mechanism["parameters"]["mass"]
    assert abs(mass["value"] - 0.05) < 3 * mass["std"]
    assert said["fit"]["extended"]["held_out"] < 0.2 * said["fit"]["base"]["held_out"]


def test_a_uniform_chain_cannot_tell_a_heavy_top_from_a_soft_foot():
    """Read from the top, masses between springs are springs between masses: the spectra are the same."""
    model = read_model(SHEAR)
    text = SHEAR.read_text()
    at = text.rindex("mass = 0.1122")
    heavy = parse_model(text[:at] + "mass = 0.16" + text[at + len("mass = 0.1122") :], SHEAR)
    said = diagnose_modes(repeats(heavy), model)
    near = {(a["mechanism"], a["place"]["id"]) for a in said["alternatives"] if a["tie"]}
    assert said["verdict"] == "unexplained"
    assert ("added-mass", "4") in near
    assert {"support-compliance", "joint-stiffness"} & {m for m, _ in near}


def test_what_is_missing_is_told_mode_by_mode_with_its_scatter():
    model = read_model(SHEAR)
    table = repeats(model, 2e-3, 100)
    said = diagnose_modes(table, model)
    for i, mode in enumerate(said["modes"]):
        assert mode["measured_hz"] == pytest.approx(table[:, i].mean())
        assert 1e-4 < mode["std_of_mean"] < 3e-4
        low, high = mode["repeats_90"]
        assert low < mode["missing"] < high


def test_every_candidate_moves_a_frequency_and_nests():
    model = read_model(SHEAR)
    terms = candidates(model)
    assert {"added-mass", "ground-stiffness", "joint-stiffness"} <= {t.mechanism.id for t in terms}
    measured = modes(model.structure, [9000.0], 4).frequency
    base = fit_modes(model.structure, None, measured, np.full(4, 0.003))
    for term in terms:
        fit = fit_modes(model.structure, term, measured, np.full(4, 0.003))
        assert fit.chi2 <= base.chi2 + 1e-6


def test_the_four_storeys_miss_what_a_single_factor_cannot_give(recordings, tmp_path):
    table = recordings / "four_dof" / "measurements_br_freq_hz.csv"
    said = diagnose_modal_file(table, SHEAR, tmp_path)
    assert said["verdict"] == "unexplained"
    assert said["repeats"] == 100
    missing = [m["missing"] / m["std_of_mean"] for m in said["modes"]]
    assert max(missing[:2]) < -10
    assert min(missing[2:]) > 10
    page = (tmp_path / "diagnosis.html").read_text(encoding="utf-8")
    assert "Mode by mode" in page
    assert "<svg" in page
    again = read_model(tmp_path / "extended.toml")
    stated = [p["value"] for p in said["parameters"].values()]
    np.testing.assert_allclose(again.structure.nominal, stated)


def test_tables_are_told_from_other_files(tmp_path):
    table, other = tmp_path / "a.csv", tmp_path / "b.csv"
    table.write_text("run,f1,f2\n1,2.0,3.0\n2,2.1,nan\n")
    other.write_text("time,force\n0,1\n")
    assert is_modal_table(table)
    assert not is_modal_table(other)
    assert not is_modal_table(tmp_path / "absent.csv")
    assert read_modal_table(table).tolist() == [[2.0, 3.0]]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("1,2.0,x\n", "line 2"),
        ("1,3.0,2.0\n", "ascend"),
        ("1,2.0\n", "2 positive"),
        ("1,-2.0,3.0\n", "positive"),
        ("", "no repeats"),
    ],
)
def test_bad_tables_are_refused(tmp_path, rows, words):
    path = tmp_path / "bad.csv"
    path.write_text(f"run,f1,f2\n{rows}")
    with pytest.raises(FileError, match=words):
        read_modal_table(path)


FREE = """
[structure]
kind = "chain"
mass = [{ node = "1", mass = 1.0 }, { node = "2", mass = 2.0 }, { node = "3", mass = "m" }, { node = "4", mass = 1.4 }]
link = [
    { between = ["1", "2"], stiffness = 4000.0 },
    { between = ["2", "3"], stiffness = "k" },
    { between = ["3", "4"], stiffness = 5000.0 },
]
[[parameter]]
name = "k"
nominal = 3000.0
lower = 2000.0
upper = 4000.0
std = 150.0
[[parameter]]
name = "m"
nominal = 1.0
lower = 0.5
upper = 1.5
std = 0.01
"""


def free_table(path, text, rows=12, scatter=5e-4):
    """A table of the frequencies of a free structure that a test on soft springs gives: without its rigid motion."""
    model = parse_model(text, path)
    found = modes(model.structure, model.structure.nominal).frequency
    repeated = found[found > 0] * (1 + scatter * np.random.default_rng(0).standard_normal((rows, 3)))
    path.write_text("f1,f2,f3\n" + "\n".join(",".join(f"{f:.9g}" for f in row) for row in repeated) + "\n")
    return found


def test_a_free_structure_is_compared_without_its_rigid_motion(tmp_path):
    (tmp_path / "free.toml").write_text(FREE)
    found = free_table(tmp_path / "f.csv", FREE)
    assert found[0] == 0
    given = ["diagnose", str(tmp_path / "f.csv"), "--model", str(tmp_path / "free.toml"), "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(app, given)
    assert result.exit_code == 0, result.output
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert said["verdict"] == "consistent"
    assert max(abs(m["missing"]) for m in said["modes"]) < 1e-3
    assert len(said["modes"]) == 3


def test_what_is_added_to_a_free_structure_is_fitted_without_its_rigid_motion(tmp_path):
    model = parse_model(FREE, tmp_path / "free.toml")
    measured = free_table(tmp_path / "f.csv", FREE.replace("mass = 1.4", "mass = 1.7"))[1:]
    base = fit_modes(model.structure, None, measured, np.full(3, 0.001))
    terms = candidates(model)
    fits = [fit_modes(model.structure, term, measured, np.full(3, 0.001)) for term in terms]
    assert all(f.chi2 <= base.chi2 + 1e-6 for f in fits)
    mass = fits[[(t.mechanism.id, t.place.id) for t in terms].index(("added-mass", "4"))]
    assert mass.value[0] == pytest.approx(0.3, rel=0.05)
    assert np.abs(mass.missing).max() < 1e-3 < np.abs(base.missing).max()


def test_more_frequencies_than_the_model_has_modes_are_refused(tmp_path):
    (tmp_path / "free.toml").write_text(FREE)
    (tmp_path / "f.csv").write_text("f1,f2,f3,f4\n5,9,12,15\n")
    with pytest.raises(ModelError, match="4 natural frequencies were measured, but the model has only 3 modes"):
        diagnose_modal_file(tmp_path / "f.csv", tmp_path / "free.toml", tmp_path / "out")
