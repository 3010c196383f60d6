"""labnnum curve: a model file's laws followed over frequency, swept, written, and told in words."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.errors import ConfigError, EstimationError, FileError, ModelError
from labnnum.harmonic import HarmonicBalance
from labnnum.recording import Channel
from labnnum.response import frf
from sessions.cli import app
from sessions.model import read_model

MODEL = """
[structure]
kind = "chain"
mass = [{ node = "1", mass = 2.0 }, { node = "2", mass = 1.0 }]
link = [
  { between = ["1", "ground"], stiffness = "k", damping = 1.5 },
  { between = ["1", "2"], stiffness = 2000.0, damping = 0.8 },
]
[[parameter]]
name = "k"
nominal = 3000.0
lower = 2000.0
upper = 4000.0
"""
LAW = """
[[mechanism]]
id = "cubic-stiffness"
variant = "x"
place = { kind = "joint", id = "1", to = "2" }
parameters = { k3 = 1e6 }
"""
ASKED = ("--drive", "2:x", "--force", 4.0, "--low", 4.5, "--high", 5.0, "--harmonics", 7)


def run(*words):
    return CliRunner().invoke(app, [str(w) for w in words])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("curve")
    (path / "law.toml").write_text(MODEL + LAW)
    (path / "plain.toml").write_text(MODEL)
    return path


@pytest.fixture(scope="module")
def whole(folder):
    done = run("curve", folder / "law.toml", *ASKED, "-o", folder / "curve.npz", "--json")
    assert done.exit_code == 0, (done.output, done.exception)
    with np.load(folder / "curve.npz") as read:
        return json.loads(done.stdout), dict(read)


def test_the_curve_is_that_of_harmonic_balance(folder, whole):
    told, read = whole
    exact = HarmonicBalance(read_model(folder / "law.toml").structure, "2:x", 4.0, harmonics=7).curve(4.5, 5.0)
    np.testing.assert_allclose(read["harmonics"], exact.harmonics, rtol=1e-9)
    assert read["outputs"].tolist() == ["2:x"]
    assert told["folds"] == pytest.approx([exact.frequency[i] for i in exact.folds])
    assert len(told["folds"]) >= 2
    assert not read["stable"].all()
    low, high = told["unstable"][0]
    assert low < high
    assert told["peaks"][0]["amplitude"] == pytest.approx(np.abs(read["harmonics"][:, 0, 1]).max())


def test_a_sweep_jumps_where_its_branch_ends(folder, whole):
    told, _ = whole
    found = {}
    for way in ("forward", "backward"):
        path = folder / f"{way}.csv"
        done = run("curve", folder / "law.toml", *ASKED, "--sweep", way, "--lines", 101, "-o", path)
        assert done.exit_code == 0, (done.output, done.exception)
        assert "folds at" in done.stdout
        head, *rows = path.read_text().splitlines()
        assert head.split(",")[:3] == ["frequency [Hz]", "2:x mean [m]", "2:x h1 [m]"]
        found[way] = np.array([[float(v) for v in row.split(",")] for row in rows])
    frequency, up, down = found["forward"][:, 0], found["forward"][:, 2], found["backward"][:, 2]
    apart = frequency[~np.isclose(up, down, rtol=1e-6)]
    assert apart.size > 3
    assert min(told["folds"]) - 0.006 < apart.min()
    assert apart.max() < max(told["folds"]) + 0.006
    assert (up[np.isin(frequency, apart)] > down[np.isin(frequency, apart)]).all()  # the spring hardens


def test_a_model_without_laws_gives_its_receptance(folder):
    done = run(
        "curve", folder / "plain.toml", *ASKED[:-2], "--harmonics", 1, "--response", "1:x", "-o", folder / "a.csv"
    )
    assert done.exit_code == 0, (done.output, done.exception)
    assert "the structure is linear" in done.stdout
    read = np.loadtxt(folder / "a.csv", delimiter=",", skiprows=1)
    structure = read_model(folder / "plain.toml").structure
    channels = Channel("u", "displacement", "response", "1", "x"), Channel("f", "force", "reference", "2", "x")
    exact = 4.0 * frf(structure, structure.nominal, read[:, 0], channels[:1], channels[1:])[0, 0]
    np.testing.assert_allclose(read[:, 4], np.abs(exact), rtol=1e-6)
    np.testing.assert_allclose(read[:, 5], np.degrees(np.angle(exact)), atol=1e-4)
    assert (read[:, 1] == 1).all()


@pytest.mark.parametrize(
    ("words", "error", "said"),
    [
        (("--sweep", "up"), ConfigError, "expected forward or backward"),
        (("--drive", "7:x"), ModelError, "7:x"),
        (("--drive", ""), ConfigError, "--drive is missing"),
        (("--lines", 1), ConfigError, "expected 2 or more"),
        (("--force", -1), EstimationError, "positive number"),
        (("--high", 1), EstimationError, "high end must lie above"),
    ],
)
def test_what_cannot_be_is_refused_and_writes_nothing(folder, words, error, said):
    done = run("curve", folder / "law.toml", *ASKED, *words, "-o", folder / "none.csv")
    assert isinstance(done.exception, error)
    assert said in str(done.exception)
    assert not (folder / "none.csv").exists()


def test_no_file_is_written_over(folder, whole):
    for name, said in (("curve.npz", "exists already"), ("curve.txt", "written as .csv or .npz")):
        done = run("curve", folder / "law.toml", *ASKED, "-o", folder / name)
        assert isinstance(done.exception, FileError)
        assert said in str(done.exception)
