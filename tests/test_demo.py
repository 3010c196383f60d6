"""The demo: true parameters within the stated errors, and output that scripts can read."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from sessions.cli import app
from sessions.demo import draw_truth, run_demo
from sessions.model import read_model
from sessions.store import open_session

NAMES = ["m_acc", "I_acc", "alpha", "beta"]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder in which the first demo has trained its updater."""
    folder = tmp_path_factory.mktemp("demo")
    run_demo(folder, seed=11, samples=100)
    return folder


def test_what_it_leaves_behind(place):
    folder = place / "seed-11"
    assert {p.name for p in folder.iterdir()} >= {"rig.toml", "model.toml", "beam.h5", "beam.html"}
    with open_session(folder / "beam.h5") as session:
        (run,), (frf,) = session.runs, session.frfs()
        (estimate,) = session.results("estimate")
    assert [c.role for c in run.channels] == ["base", "response"]
    assert [c.node for c in run.channels] == ["1", "3"]
    assert (frf.estimator, frf.settings["window"]) == ("H1", "hann")
    inside = [frf.lines(low, high).coherence for low, high in estimate.payload["bands"]]
    assert all(part is not None and part.mean() > 0.9 for part in inside)
    page = (folder / "beam.html").read_text(encoding="utf-8")
    assert "4 parameters updated" in page
    assert "truth" in page


def test_json_is_all_that_it_prints_and_the_truth_lies_within_three_std(place):
    errors = []
    for seed in (12, 13):
        done = CliRunner().invoke(app, ["demo", "--seed", str(seed), "--json", "-o", str(place)])
        assert done.exit_code == 0, done.output
        found = json.loads(done.stdout)
        assert list(found) == ["parameters"]
        assert list(found["parameters"]) == NAMES
        for entry in found["parameters"].values():
            assert list(entry) == ["true", "value", "std", "unit"]
            errors.append((entry["value"] - entry["true"]) / entry["std"])
    assert np.abs(errors).max() < 3.5
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_the_same_seed_gives_the_same_truth_and_another_another(place):
    model = read_model(place / "seed-11" / "model.toml")
    assert draw_truth(model, 5) == draw_truth(model, 5) != draw_truth(model, 6)
    for p in model.structure.parameters:
        assert all(p.lower <= draw_truth(model, seed)[p.name] <= p.upper for seed in range(30))


def test_a_second_demo_writes_nothing_over(place):
    before = (place / "seed-11" / "beam.h5").read_bytes()
    again = run_demo(place, seed=11)
    assert again.folder == place / "seed-11-2"
    assert (place / "seed-11" / "beam.h5").read_bytes() == before
    with open_session(place / "seed-11" / "beam.h5") as one, open_session(again.session) as other:
        np.testing.assert_array_equal(one.runs[0].read(), other.runs[0].read())
        np.testing.assert_array_equal(one.frfs()[0].value, other.frfs()[0].value)
