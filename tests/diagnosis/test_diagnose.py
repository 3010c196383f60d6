"""Diagnosis of concealed cases as a user would run it: a sample of `labnnum prove linear`."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from labnnum.diagnosis import observe, observe_all
from labnnum.diagnosis.decide import _confidence
from labnnum.diagnosis.gates import clipped_channel
from labnnum.diagnosis.observe import is_hit, noise_from_smoothness
from labnnum.diagnosis.rails import clipping
from labnnum.errors import InputError
from labnnum.recording import Channel, Recording
from sessions.diagnose import diagnose_files
from sessions.exchange import load_recordings
from sessions.limits import read_limits, write_limits
from sessions.prove.answers import same_place
from sessions.prove.cases import make_case, write_case

KEYS = {
    "schema", "verdict", "place", "mechanism", "further", "alternatives", "located", "fit", "nonlinear",
    "next_experiment",
}  # fmt: skip


def diagnosed(tmp_path, *case, **options):
    made = make_case(*case, **options)
    paths = write_case(made, tmp_path / "case")
    content = diagnose_files(paths, tmp_path / "case" / "model.toml", tmp_path / "out")
    return made.truth, content


def test_a_sound_structure_raises_no_alarm(tmp_path):
    _, content = diagnosed(tmp_path, 1, "chain")
    assert content["verdict"] in ("consistent", "parameters")
    assert content["mechanism"] is None
    assert set(content) >= KEYS


@pytest.fixture(scope="module")
def heavier(tmp_path_factory):
    """A chain with a mass that its model lacks: folder, truth and answer."""
    folder = tmp_path_factory.mktemp("heavier")
    return folder, *diagnosed(folder, 2, "chain", "added-mass", 0.75)


def names(truth, content):
    """Asserts that an answer names the concealed fault at its place, with its parameter."""
    (concealed,) = truth["faults"]
    assert content["mechanism"]["id"] == concealed["mechanism"]
    assert content["place"]["id"] == concealed["place"]["id"]
    fit = content["fit"]
    assert fit["base"]["held_out"] > 3 * fit["extended"]["held_out"]
    (stated,) = content["mechanism"]["parameters"].values()
    (true,) = concealed["parameters"].values()
    assert abs(stated["value"] - true["value"]) < max(0.1 * abs(true["value"]), 4 * stated["std"])


def test_a_mass_is_named_where_it_is(heavier):
    _, truth, content = heavier
    assert content["verdict"] == "missing-physics"
    names(truth, content)


def test_a_delay_is_named_in_its_channel(tmp_path):
    truth, content = diagnosed(tmp_path, 2, "chain", "channel-delay", 0.8)
    assert content["verdict"] == "measurement-fault"
    names(truth, content)


def test_what_has_no_name_is_located_and_not_named(tmp_path):
    truth, content = diagnosed(tmp_path, 2, "chain", "misplaced-sensor", 0.9)
    (concealed,) = truth["faults"]
    assert content["verdict"] == "unexplained"
    assert content["mechanism"] is None
    assert same_place(content["place"], concealed)
    assert same_place(content["located"][0]["place"], concealed)


def test_a_spring_that_holds_a_free_body_is_named_alone(tmp_path):
    """The resonance that it makes of a rigid-body motion has no damping ratio of the structure's.

    Under the errors that the data support its fit must find its way again, or something else is named beside it.
    """
    truth, content = diagnosed(tmp_path, 3, "free-beam", "ground-stiffness", 0.8)
    (concealed,) = truth["faults"]
    assert content["mechanism"]["id"] == "ground-stiffness"
    assert same_place(content["place"], concealed)
    assert not content["further"]
    (stated,) = content["mechanism"]["parameters"].values()
    assert stated["value"] == pytest.approx(concealed["parameters"]["k"]["value"], rel=0.03)


def test_files_of_an_answer(heavier, tmp_path):
    folder, *_ = heavier
    out = folder / "out"
    assert json.loads((out / "diagnosis.json").read_text())["schema"] == 1
    page = (out / "diagnosis.html").read_text()
    assert "added-mass" in page
    assert "<svg" in page
    # the extended model is a model like any other, and with it the same data raise no alarm
    paths = sorted((folder / "case").glob("case_run*.npz"))
    again = diagnose_files(paths, out / "extended.toml", tmp_path / "again")
    assert again["verdict"] in ("consistent", "parameters")


def test_clipping_and_drift_are_judged_before_the_fit(tmp_path):
    clip = make_case(3, "chain", "channel-clipping", 0.9)
    found = [clipped_channel(o) for o in observe_all(load_recordings(write_case(clip, tmp_path / "clip")))]
    assert clip.truth["faults"][0]["place"]["id"] in found
    drift = make_case(3, "chain", "drift", 0.5)
    ratios = [o.drift for o in observe_all(load_recordings(write_case(drift, tmp_path / "drift")))]
    sound = [o.drift for o in observe_all(load_recordings(write_case(make_case(3, "chain"), tmp_path / "sound")))]
    assert np.median(ratios) > 2.0
    assert np.median(sound) < 1.2


def test_a_hit_is_told_from_noise():
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((2, 4000))
    channels = (Channel("f", "force", "reference", "1", "z"), Channel("a", "acceleration", "response", "2", "z"))
    assert not is_hit(Recording(channels, rows, 1000.0))
    rows[0] = 1e-3 * rows[0]
    rows[0, 100:110] += 50 * np.hanning(10)
    assert is_hit(Recording(channels, rows, 1000.0))


def test_periodic_noise_is_estimated_from_the_periods():
    rng = np.random.default_rng(1)
    n, periods = 512, 40
    t = np.arange(n)
    u = sum(np.cos(2 * np.pi * k * t / n + rng.uniform(0, 6)) for k in range(5, 60, 2))
    rows = np.stack([np.tile(u, periods), np.tile(np.roll(u, 3), periods) + 0.1 * rng.standard_normal(n * periods)])
    channels = (Channel("f", "force", "reference", "1", "z"), Channel("a", "acceleration", "response", "2", "z"))
    made = observe(Recording(channels, rows, 512.0, period=n))
    assert made.frf.frequency.size == 28
    expected = (0.1**2) * 4 / n / periods  # |2/n sum|^2 of white noise, over the periods
    assert made.frf.variance is not None
    np.testing.assert_allclose(np.mean(made.frf.variance), expected, rtol=0.25)


def test_noise_of_a_smooth_row_is_found():
    rng = np.random.default_rng(2)
    f = np.linspace(1, 100, 2000)
    noise = 0.01 * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    found = noise_from_smoothness(f, (1 / (1 + 0.02j * f) + noise)[None])
    np.testing.assert_allclose(np.median(found), 2e-4, rtol=0.3)


def test_clipping_needs_samples_at_the_rail():
    x = np.random.default_rng(3).standard_normal(50_000)
    assert clipping(x).score == 0
    assert clipping(np.clip(x, -1.5, 1.5)).score > 8


def test_limits_of_a_rig_are_kept_beside_it(tmp_path):
    from dataclasses import replace

    rig = tmp_path / "rig.toml"
    rig.write_text("")
    scatter, limits = read_limits(rig)
    write_limits(rig, replace(scatter, frequency=0.001), replace(limits, alarm=55.0), "test")
    again, higher = read_limits(rig)
    assert again.frequency == 0.001
    assert higher.alarm == 55.0
    (tmp_path / "rig.diagnosis.toml").write_text("[limits]\nalrm = 1\n")
    with pytest.raises(InputError, match="alrm"):
        read_limits(rig)


def test_a_sensor_the_model_lacks_is_named(tmp_path):
    case = make_case(1, "chain")
    paths = write_case(case, tmp_path)
    toml = tmp_path / "channels.toml"
    toml.write_text(toml.read_text().replace('role = "response"\nnode = "', 'role = "response"\nnode = "x', 1))
    with pytest.raises(InputError, match="x"):
        diagnose_files(paths, tmp_path / "model.toml", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_candidate_that_was_fitted_after_its_stage_has_a_share_too():
    def candidate(name, cost) -> Any:
        return SimpleNamespace(last=SimpleNamespace(mechanism=SimpleNamespace(id=name), place="1"), cost=cost)

    stage = [candidate("added-mass", 10.0), candidate("local-dashpot", 12.0)]
    assert _confidence(stage, stage[0]) == pytest.approx(1 / (1 + np.exp(-1)))
    assert _confidence(stage, candidate("joint-stiffness", 8.0)) == pytest.approx(1 / (1 + np.exp(-1) + np.exp(-2)))


def test_a_spring_that_lost_half_is_found_from_where_another_name_stood(tmp_path):
    """The base bends so far that an appendage comes first; the spring, second, explains all without it."""
    truth, content = diagnosed(tmp_path, 43, "chain", "joint-stiffness", 0.87, excitation="hammer")
    assert content["mechanism"]["id"] == "joint-stiffness"
    assert not content["further"]
    assert same_place(content["place"], truth["faults"][0])
    (stated,) = content["mechanism"]["parameters"].values()
    assert stated["value"] == pytest.approx(truth["faults"][0]["parameters"]["relative_change"]["value"], rel=0.02)


def test_two_faults_are_both_named(tmp_path):
    truth, content = diagnosed(tmp_path, 45, "frame", ("added-mass", "channel-gain"), (0.8, 0.8))
    names = {content["mechanism"]["id"], *(f["mechanism"]["id"] for f in content["further"])}
    assert names == {f["mechanism"] for f in truth["faults"]} == {"added-mass", "channel-gain"}
