"""labnnum train and labnnum update, as typed."""

import functools
import itertools
import json
import sys
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest

from labnnum.response import frf
from sessions import cli, updaters
from sessions.estimates import latest_estimate
from sessions.model import read_model
from sessions.report.content import gather
from sessions.report.page import verdict
from sessions.store import create_session, open_session
from sessions.updaters import load_updater

from .test_updaters import IN, LINES, MODEL, OUT

TRUTH = np.array([5400.0, 0.93])


@pytest.fixture
def type_in(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)

    def run(line, status=0):
        monkeypatch.setattr(sys, "argv", ["labnnum", *line.split()])
        with pytest.raises(SystemExit) as end:
            cli.main()
        shown = capsys.readouterr()
        assert (end.value.code or 0) == status, shown.err
        return shown

    return run


@pytest.fixture
def bench(tmp_path):
    """A model file and a session with a measured FRF."""
    from labnnum.frf import Frf

    (tmp_path / "model.toml").write_text(MODEL)
    structure = read_model(tmp_path / "model.toml").structure
    value = frf(structure, TRUTH, LINES, OUT, IN)
    rng = np.random.default_rng(0)
    scatter = 0.01 * np.abs(value)
    noise = scatter / np.sqrt(2) * (rng.standard_normal(value.shape) + 1j * rng.standard_normal(value.shape))
    measured = Frf(LINES, value + noise, OUT, IN, variance=scatter**2)
    with create_session(tmp_path / "run.h5") as session:
        session.add_frf(measured)
    return structure


def test_train_on_a_measurement_then_update_it(type_in, bench, tmp_path):
    said = json.loads(type_in("train model.toml --frf run.h5 --samples 64 -o u.h5 --json").out)
    assert set(said["validation"]) == {"k", "m"}
    shown = type_in("update run.h5 --updater u.h5 --json")
    found = json.loads(shown.out)
    for name, truth in zip(("k", "m"), TRUTH, strict=True):
        one = found["parameters"][name]
        assert abs(one["value"] - truth) < 4 * one["std"]
    assert found["method"] == "network + least squares"
    advised = json.loads(type_in("update run.h5 --updater u.h5 --advise --json").out)["advice"]
    assert all(min(one["std_ratio"].values()) < 1 for one in advised)
    assert "standard deviation of" in type_in("update run.h5 --updater u.h5 --advise").out or not advised
    assert 0.6 < found["chi2"] < 1.5
    with open_session(tmp_path / "run.h5") as session:
        stored = latest_estimate(session)
    assert stored.estimate["k"] == found["parameters"]["k"]["value"]
    assert stored.frf == "results/frf/0001"
    assert np.abs(stored.after - frf(bench, TRUTH, stored.frequency, OUT, IN)).max() < 0.1 * np.abs(stored.after).max()


@pytest.mark.parametrize(("method", "floor"), [("least-squares", 0.05), ("refined", 0.05), ("output-error", 0.0)])
def test_an_error_granted_to_the_model_is_kept_and_told(type_in, bench, tmp_path, method, floor):
    """The random error is 1 %: with 5 % granted, chi2 falls far below 1, and the page says to what that is due."""
    shown = type_in(f"update run.h5 --model model.toml --method {method} --floor 0.05")
    with open_session(tmp_path / "run.h5") as session:
        stored = latest_estimate(session)
    assert stored.floor == floor
    assert ("with a model error of 5 %" in " ".join(shown.out.split())) == bool(floor)
    assert (stored.estimate.chi2 < 0.1) == bool(floor)
    said = verdict(gather(tmp_path / "run.h5"))[0]
    assert ("a model error of 5 %" in said) == bool(floor)


@pytest.mark.parametrize("method", ["least-squares", "output-error", "filter", "penalty"])
def test_update_from_a_model_alone(type_in, bench, method):
    found = json.loads(type_in(f"update run.h5 --model model.toml --method {method} --json --no-keep").out)
    for name, truth in zip(("k", "m"), TRUTH, strict=True):
        assert found["parameters"][name]["value"] == pytest.approx(truth, rel=0.05)


def test_the_table_is_for_people_and_warnings_go_to_stderr(type_in, bench):
    shown = type_in("update run.h5 --model model.toml")
    assert "least squares" in shown.out
    assert "5000" in shown.out
    assert "warning" not in shown.out


def test_train_without_a_measurement(type_in, bench, tmp_path):
    shown = type_in(
        "train model.toml --response 2:x --drive 1:x --step 0.1 --samples 64 --features integrals -o plain.h5"
    )
    assert "plain.h5" in shown.out
    assert not list(tmp_path.glob("*.training"))


PLAIN = "train model.toml --response 2:x --drive 1:x --step 0.1 --samples 320"


@pytest.fixture
def interrupted(type_in, bench, monkeypatch, tmp_path):
    """A training that was interrupted once some of its samples were stored; the content of what it left."""
    clock = itertools.count(0.0, 20.0)

    def begin(line):
        with monkeypatch.context() as patch:
            patch.setattr(time, "monotonic", lambda: next(clock))
            patch.setattr(updaters, "save_training", functools.partial(kept, updaters.save_training))
            type_in(line, status=130)
        (left,) = tmp_path.glob("*.training")
        with h5py.File(left) as file:
            assert 0 < file.attrs["done"] < 320

    def kept(save, *given):
        save(*given)
        raise KeyboardInterrupt

    return begin


def test_an_interrupted_training_goes_on_to_the_same_updater(type_in, interrupted):
    interrupted(f"{PLAIN} -o u.h5")
    type_in(f"{PLAIN} -o u.h5")
    type_in(f"{PLAIN} -o whole.h5")
    assert np.array_equal(load_updater("u.h5").network.weights, load_updater("whole.h5").network.weights)


@pytest.mark.parametrize(
    ("change", "to"),
    [("--response 2:x", "--response 1:x"), ("--drive 1:x", "--drive 2:x"), ("-o u.h5", "--features sphere -o u.h5")],
)
def test_a_training_begun_for_something_else_is_not_continued(type_in, interrupted, change, to):
    interrupted(f"{PLAIN} -o u.h5")
    other = f"{PLAIN} -o u.h5".replace(change, to)
    type_in(other)
    type_in(other.replace("u.h5", "whole.h5"))
    assert np.array_equal(load_updater("u.h5").network.weights, load_updater("whole.h5").network.weights)


def test_a_training_begun_with_other_weights_of_the_bands_is_not_continued(type_in, interrupted, tmp_path):
    interrupted(f"{PLAIN} -o u.h5")
    (tmp_path / "model.toml").write_text(MODEL.replace("high = 8.0\n", "high = 8.0\nimag = 0.0\n"))
    type_in(f"{PLAIN} -o u.h5")
    type_in(f"{PLAIN} -o whole.h5")
    assert np.array_equal(load_updater("u.h5").network.weights, load_updater("whole.h5").network.weights)


def test_a_training_begun_with_another_random_error_is_not_continued(type_in, bench, interrupted, tmp_path):
    interrupted("train model.toml --frf run.h5 --samples 320 -o u.h5")
    with open_session(tmp_path / "run.h5") as session:
        before = session.frfs()[-1]
    noisier = replace(before, variance=4 * np.asarray(before.variance))
    (tmp_path / "run.h5").unlink()
    with create_session(tmp_path / "run.h5") as session:
        session.add_frf(noisier)
    for name in ("u.h5", "whole.h5"):
        type_in(f"train model.toml --frf run.h5 --samples 320 -o {name}")
    assert np.array_equal(load_updater("u.h5").network.weights, load_updater("whole.h5").network.weights)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("update run.h5", "give --updater, or --model"),
        ("update run.h5 --model model.toml --method magic", "--method 'magic': expected one of refined"),
        ("update run.h5 --model model.toml --method network", "--method network needs --updater"),
        ("update run.h5 --model model.toml --frf results/frf/0009", "has no FRF 'results/frf/0009'; there are"),
        ("update none.h5 --model model.toml", "none.h5: no such session"),
        ("update run.h5 --updater none.h5", "none.h5: no such updater"),
        ("train model.toml -o u.h5", "give --response, --drive and --step"),
        ("train model.toml -o run.h5 --frf run.h5", "run.h5: exists already"),
        ("train model.toml -o u.h5 --response 2 --drive 1:x --step 0.1", 'expected "node:direction"'),
        ("train model.toml -o u.h5 --response 7:x --drive 1:x --step 0.1", "no degree of freedom '7:x'"),
        ("train model.toml -o u.h5 --response 2:x --drive 1:x --step -1", "--step -1 Hz must be positive"),
        ("train model.toml -o u.h5 --frf run.h5 --features wavelet", "features 'wavelet' are not one of"),
        ("train model.toml -o u.h5 --frf run.h5 --workers 0", "--workers 0: give 1 or more"),
    ],
)
def test_bad_input_is_one_line_and_status_2(type_in, bench, line, message):
    shown = type_in(line, status=2)
    assert message in shown.err
    assert shown.err.count("\n") == 1
    assert not shown.out
