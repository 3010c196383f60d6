import json
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from labnnum.control import decay, observer_feedback
from labnnum.structures.examples import truck
from sessions.cli import app
from sessions.reproduce import control, drift, flags, leakage
from sessions.reproduce.extras import EXTRAS, drift_figure, drift_table


def quiet(*_):
    pass


@pytest.fixture(scope="module")
def judged():
    return control.control(16, 0, quiet, samples=400)


def test_with_all_states_known_no_gain_is_unstable_and_the_exact_one_is_best(judged):
    for at in judged["ratios"]:
        for g in at["gains"].values():
            assert g["lqr_unstable"] == 0
            assert g["lqr_J_mean"] >= 1 - 1e-9
        assert at["gains"]["K0"]["lqr_J_mean"] > at["gains"]["Ke, refined"]["lqr_J_mean"]


def test_with_an_observer_the_nominal_gain_is_unstable_for_some_and_the_estimated_one_for_none(judged):
    cheap = judged["ratios"][1]["gains"]
    assert cheap["K0"]["lqg_unstable"] > 0
    assert cheap["Ke, refined"]["lqg_unstable"] == cheap["Ki"]["lqg_unstable"] == 0
    assert cheap["Ke, refined"]["lqg_J_mean"] < 1.001
    assert control.control_table(judged).count("R/Q") == 4


@pytest.fixture
def slow_clock(monkeypatch):
    monkeypatch.setattr(drift, "RATE", 400.0)


def test_the_loop_follows_a_truck_that_drifts(slow_clock):
    walk = drift.drift(12, 0, quiet, samples=450)
    assert all(b.adaptive[0] > 0 for b in walk)
    assert {len(b.latency) for b in walk} == {4}
    assert "following gain: unstable after 0 of 12" in drift_table(walk)
    assert drift_figure(walk).startswith("<svg")


def test_two_experiments_tell_the_wheel_from_the_actuator_while_the_loop_is_closed(monkeypatch, slow_clock):
    monkeypatch.setattr(drift, "SENSOR", 1e-12)
    updater = drift._updater(64, 0, quiet)
    plant, g = drift._Plant(1), control.gains(truck().nominal, control.weights(1e-2))
    theta = truck().nominal
    theta[2] *= 1.2
    halves = []
    for sign in (-1.0, 1.0, -1.0):
        for _ in range(2):
            last = plant.run(g, sign, lambda share: theta)
        halves.append(last)
    frf = drift._measured(updater, halves)
    true = control.CASES["truck-5-1frf"]().solver()
    assert decay(observer_feedback(control.system(theta), g.model, g.K, g.L)) > 0.5
    exact = type(true).of(updater.structure, updater.frequency, updater.outputs, updater.inputs).frf(theta)[0]
    assert np.abs(frf.value / exact - 1).max() < 0.01


def test_the_truth_drifts_on_without_a_step_from_period_to_period():
    seen = [drift._truth_in(3, period, 90, share) for period in range(4) for share in (0.0, 0.5, 1.0)]
    seen += [drift._truth_in(4, 0, 90, 0.0)]
    steps = np.diff(np.array(seen)[:, 2])  # k3 falls evenly
    assert (steps <= 0).all()
    assert np.allclose(steps[2::3], 0, atol=1e-9 * seen[0][2])


def test_flags_are_counted():
    made = flags.bench("truck", 200, quiet)
    rng = np.random.default_rng(0)
    rows = {kind: flags._counted(made, kind, 2, rng) for kind in ("sound", "missing", "polarity")}
    assert rows["missing"]["refused"] == rows["missing"]["flagged"] == 2
    assert rows["sound"]["flagged"] == 0
    assert rows["polarity"]["flagged"] == 2
    found = {"noise": 0.01, "sets": 2, "seed": 0, "structures": {"truck": rows}}
    assert flags.flags_table(found).count("%") == 3 * 3 + 1


@pytest.mark.parametrize("kind", flags.KINDS)
def test_what_is_spoilt_differs_from_what_is_sound(kind):
    e = flags.EXAMPLES["truck"]()
    made = flags.Bench("truck", e.structure, e, SimpleNamespace(frequency=np.linspace(1.5, 6, 20)))
    theta = e.structure.nominal
    one, truth = flags._SPOIL[kind](made, theta, np.random.default_rng(1))
    assert (len(one.outputs) == 2) == (kind == "missing")
    assert np.array_equal(truth, theta) == (not kind.startswith("range"))


def test_the_command_finds_the_extras(tmp_path, monkeypatch):
    def write(sets, seed, folder, say):
        (folder / "drift.json").write_text(json.dumps([sets, seed]))
        return "table"

    monkeypatch.setitem(EXTRAS, "drift", (write, 90))
    made = CliRunner().invoke(app, ["reproduce", "drift", "-o", str(tmp_path / "new"), "--json"])
    assert json.loads(made.stdout) == [90, 0]
    assert CliRunner().invoke(app, ["reproduce", "drift", "-o", str(tmp_path)]).stdout == "table\n"


def test_parameters_are_within_their_deviations_because_the_model_is_seen_through_the_window(monkeypatch):
    monkeypatch.setattr(leakage, "LENGTHS", (10.0,))
    found = leakage.leakage(4, 0, quiet)
    seen, exact = found["rows"]
    assert (seen["how"], exact["how"]) == (leakage.SEEN, leakage.EXACT)
    m3, k3, b3 = (found["names"].index(n) for n in ("m3", "k3", "b3"))
    assert seen["beyond_three"] == 0
    assert np.sqrt(np.mean(np.square(seen["rms_std"]))) < 1.5
    for j in (m3, k3, b3):
        assert exact["bias_percent"][j] > 5
        assert exact["rms_std"][j] > 3
        assert abs(seen["bias_percent"][j]) < 3
    table = leakage.leakage_table(found)
    assert table.count("through the window") == table.count("as it is") == 1
    assert leakage.leakage_figure(found).startswith("<svg")
