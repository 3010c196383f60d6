"""labnnum calibrate on a simulated bench and on a made-up interface: found, kept, applied, and refused when stale."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.block import Block
from drivers.digitiser import Digitiser
from labnnum.calibration import STANDARD_GRAVITY, InputResponse
from labnnum.errors import ChannelError, ConfigError, EstimationError, InputError, UnitError
from labnnum.frf import Frf
from labnnum.recording import Channel
from labnnum.response import frf
from sessions.bench import measure
from sessions.calibration import (
    Calibration,
    calibration_path,
    input_entries,
    read_calibration,
    run_info,
    without_inputs,
)
from sessions.cli import app
from sessions.model import read_model
from sessions.reprocess import FrfSettings, reprocess
from sessions.rig import read_rig
from sessions.store import open_session

RIG = """
[device]
kind = "simulated"
rate = 2048
[[channel]]
name = "force"
role = "reference"
unit = "N"
sensitivity = 0.01
node = "1"
direction = "x"
[[channel]]
name = "tip"
unit = "g"
sensitivity = 0.1
node = "1"
direction = "x"
[simulated]
input_noise = 1e-5
[simulated.channel.force]
gain = 0.93
[simulated.channel.tip]
gain = 1.04
noise = 0.005
delay = 1e-4
highpass = 0.5
"""


@pytest.fixture
def rig(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


def run(*words, fails=False):
    done = CliRunner().invoke(app, ["calibrate", *map(str, words)])
    if fails:
        assert done.exception is not None
        return done.exception
    assert done.exception is None, done.exception
    return done.stdout


def sensitivities(rig):
    return [s.channel.sensitivity for s in read_rig(rig).stored]


def test_a_sensor_then_a_force_channel_then_the_inputs(rig):
    assert sensitivities(rig) == pytest.approx([0.01, 0.1 / STANDARD_GRAVITY])
    said = run(rig, "tip", "--seconds", 4)
    assert re.search(r"tip: 0.0106\d+ ± \S+ V per m/s\^2, rig.toml says 0.0101972 \(tone of 159.2 Hz, 9.80665", said)
    assert sensitivities(rig)[1] == pytest.approx(1.04 * 0.1 / STANDARD_GRAVITY, rel=2e-4)
    told = json.loads(run(rig, "force", "--mass", 1.25, "--against", "tip", "--seconds", 8, "--json"))
    (entry,) = told["sensitivity"]
    assert entry["value"] == pytest.approx(0.0093, abs=5 * entry["error"] + 2e-6)
    assert entry["instead_of"] == 0.01
    assert sensitivities(rig)[0] == entry["value"]
    run(rig, "--inputs", "--seconds", 8)
    known = read_calibration(rig)
    assert known.responses["tip"].delay == pytest.approx(1e-4, rel=1e-3)
    assert known.responses["tip"].highpass == pytest.approx(0.5, rel=5e-3)
    assert [e.channel for e in known.entries] == ["tip", "force", "force", "tip"]
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d[+-]\d\d:\d\d", e.date) for e in known.entries)
    shown = run(rig, "--show")
    assert shown.count("\n") == 5
    assert "force: the reference, high-pass 0 Hz as stated (common signal, reference force" in shown
    assert "100.00 ± " in shown


def test_a_common_signal_suits_the_least_range(rig):
    rig.write_text(RIG.replace("sensitivity = 0.1\n", "sensitivity = 0.1\nfull_scale = 1.0\n"))
    run(rig, "--inputs", "--seconds", 8)
    assert read_calibration(rig).responses["tip"].delay == pytest.approx(1e-4, rel=5e-3)


def test_another_reference_takes_the_place_of_the_one_before(rig):
    run(rig, "--inputs", "--seconds", 8)
    run(rig, "--inputs", "--seconds", 8, "--reference", "tip", "--reference-highpass", 0.5)
    known = read_calibration(rig).responses
    assert known["force"].delay == pytest.approx(-1e-4, rel=1e-3)
    assert known["tip"] == InputResponse(highpass=0.5)


def test_the_last_calibration_holds_and_all_can_be_forgotten(rig):
    run(rig, "tip", "--seconds", 2)
    run(rig, "tip", "--seconds", 2, "--level", "10 m/s^2", "--peak", "--frequency", 80)
    known = read_calibration(rig)
    assert len(known.sensitivity) == 2
    assert "7.07107 m/s^2 RMS" in known.sensitivity[1].method
    assert sensitivities(rig)[1] == known.sensitivity[1].value
    assert "2 removed from" in run(rig, "tip", "--forget")
    assert sensitivities(rig)[1] == pytest.approx(0.1 / STANDARD_GRAVITY)
    assert "nothing was calibrated yet" in run(rig, "--show")


def test_another_sensor_in_rig_toml_asks_for_another_calibration(rig):
    run(rig, "tip", "--seconds", 2)
    rig.write_text(RIG.replace("sensitivity = 0.1\n", "sensitivity = 0.05\n"))
    with pytest.raises(
        ConfigError, match=r"channel\[2\]: channel 'tip' was calibrated when its sensitivity was given as"
    ):
        read_rig(rig)
    assert "rig.toml says 0.00509" in run(rig, "tip", "--seconds", 2)
    assert sensitivities(rig)[1] == pytest.approx(1.04 * 0.05 / STANDARD_GRAVITY, rel=2e-4)


def test_the_gain_of_a_conditioner_counts_and_a_calibration_holds_for_it(rig):
    rig.write_text(rig.read_text().replace("sensitivity = 0.1", "sensitivity = 0.1\ngain = 10"))
    found = read_rig(rig)
    row = found.index("tip")
    assert found.channels[row].sensitivity == pytest.approx(1.0 / STANDARD_GRAVITY)  # 1 V at the input for 1 g
    np.testing.assert_allclose(found.stored[row].to_si([1.0]), [STANDARD_GRAVITY])
    run(rig, "tip", "--seconds", 4)
    found = read_rig(rig)
    assert found.channels[row].sensitivity == pytest.approx(1.04 / STANDARD_GRAVITY, rel=2e-3)
    rig.write_text(rig.read_text().replace("gain = 10", "gain = 100"))
    with pytest.raises(ConfigError, match="was calibrated when its sensitivity was given as"):
        read_rig(rig)


def test_a_channel_without_a_sensitivity_gets_one(rig):
    rig.write_text(RIG.replace("sensitivity = 0.1\n", ""))
    with pytest.raises(ConfigError, match="channel 'tip' has no sensitivity"):
        read_rig(rig)
    run(rig, "tip", "--seconds", 2, "--level", "0.1 g")
    assert sensitivities(rig)[1] == pytest.approx(1.04, rel=2e-4)


@pytest.mark.parametrize(
    ("words", "kind", "said"),
    [
        (["tipp"], ChannelError, "there is no channel 'tipp'; there are force, tip"),
        (["tip", "--level", "loud"], UnitError, "--level 'loud' is not a number with its unit"),
        (["tip", "--level", "1 N"], UnitError, "--level: "),
        (["tip", "--frequency", "300", "--seconds", "0.01"], EstimationError, "fewer than 20 cycles"),
        (["tip", "--level", "200 g", "--seconds", "1"], EstimationError, "'tip' is overloaded: lower its gain"),
        (["force", "--mass", "1"], ConfigError, "--mass needs --against"),
        (["tip", "--mass", "1", "--against", "force"], ChannelError, "'tip' must measure force"),
        (["force", "--mass", "1", "--against", "tip", "--band", "300"], InputError, "not LOW:HIGH in Hz"),
        (["--inputs", "--reference-highpass", "-1"], ConfigError, "--reference-highpass -1: expected a corner in Hz"),
        (["force", "--sine", "1"], ConfigError, "only an audio interface has a full scale"),
        (["force", "--forget", "--seconds", "1"], None, "0 removed"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(rig, words, kind, said):
    if kind is None:
        assert said in run(rig, *words)
        return
    error = run(rig, *words, fails=True)
    assert isinstance(error, kind)
    assert said in str(error)
    assert "\n" not in str(error)
    assert not calibration_path(rig).exists()


class Interface(Digitiser):
    """Two inputs of which the second reads a sine 10/9.6 too large."""

    n_channels, rate = 2, 2048.0

    def __init__(self, lost=0):
        self._lost = lost

    def open(self):
        pass

    def start(self):
        self._at = 0

    def stop(self):
        pass

    def read(self, timeout=5.0):
        t = (self._at + np.arange(512)) / self.rate
        wave = 0.7 * np.sqrt(2) * np.sin(2 * np.pi * 200 * t) / 0.96
        self._at += 512
        return Block(np.stack([0 * wave, wave]), self._at - 512, 0.0, self._lost)


@pytest.fixture
def interface(rig, monkeypatch):
    rig.write_text(
        RIG.replace('"simulated"', '"audio"').replace("sensitivity = 0.1\n", "sensitivity = 0.1\nfull_scale = 5.0\n")
    )
    made = Interface()
    monkeypatch.setattr("sessions.audio.audio_digitiser", lambda rig, complete=True: made)
    return made


def test_a_sine_gives_the_full_scale_and_leaves_sensor_and_input_together_as_they_were(rig, interface):
    run(rig, "tip", "--level", "1 g", "--frequency", 200, "--seconds", 2)
    before = sensitivities(rig)[1]
    run(rig, "tip", "--sine", 0.7, "--frequency", 200, "--seconds", 2)
    after = read_rig(rig)
    assert after.toml.channel[1].full_scale == pytest.approx(4.8, rel=1e-6)
    assert after.stored[1].channel.sensitivity == pytest.approx(0.96 * before, rel=1e-6)
    assert "rescaled with its input" in read_calibration(rig).sensitivity[-1].method


def test_lost_frames_spoil_a_calibration(rig, interface):
    interface._lost = 64
    assert "frames were lost after 0.25 s: record again" in str(run(rig, "tip", "--frequency", 200, fails=True))


def test_runs_keep_what_is_known_of_their_inputs_and_frfs_are_corrected_by_it():
    found = {"a": InputResponse(1e-4, 0.5, 1.0, 1e-6, 0.01), "b": InputResponse(1e-8, 0.001, 1.0, 1e-6, 0.01)}

    known = Calibration(input=tuple(input_entries(found, "f", "test")))
    run = SimpleNamespace(info=run_info(known))
    assert run.info == {"inputs": {"a": {"delay": 1e-4, "highpass": 0.5}}}
    f = np.arange(1.0, 9.0)
    channels = (Channel("a"), Channel("b"))
    frf = Frf(f, np.ones((2, 1, 8)), channels, (Channel("f", "force", "reference"),))
    np.testing.assert_allclose(without_inputs(frf, [run]).value[0, 0], 1 / found["a"].at(f))
    assert without_inputs(frf, []) is frf


MODEL = """
[structure]
kind = "chain"
[[structure.mass]]
node = "1"
mass = 2.0
[[structure.link]]
between = ["1", "ground"]
stiffness = 2e5
damping = 60.0
"""
SHAKER = """
[generator]
max_volts = 8.0
[excitation]
kind = "multisine"
low = 4
high = 300
levels = [2.0]
control = "force"
settle = 0.5
period = 2048
periods = 4
drop_periods = 1
[safety]
ramp = 0.1
"""


def test_a_calibrated_bench_measures_the_models_frf_and_an_uncalibrated_one_does_not(rig):
    rig.write_text(RIG + SHAKER)
    (rig.parent / "model.toml").write_text(MODEL)
    structure = read_model(rig.parent / "model.toml").structure

    def error(session):
        (found,) = measure(read_rig(rig), rig.parent / session).frfs.values()
        found = found.lines(5.0, 290.0)
        exact = frf(structure, structure.nominal, found.frequency, found.outputs, found.inputs)
        return np.abs(found.value / exact - 1)

    assert error("before.h5").mean() > 0.1
    run(rig, "tip", "--seconds", 4)
    run(rig, "force", "--mass", 1.25, "--against", "tip", "--seconds", 8)
    run(rig, "--inputs", "--seconds", 8)
    left = error("after.h5")
    assert np.median(left) < 0.002
    assert left.mean() < 0.01
    (again,) = [f for _, f in reprocess(open_session(rig.parent / "after.h5", "a"), FrfSettings())]
    assert again.settings["inputs"]["tip"]["delay"] == pytest.approx(1e-4, rel=1e-2)


def test_two_inputs_with_a_high_pass_each_give_the_models_frf_below_their_corners_too(rig):
    changes = [
        ("gain = 0.93\n", "highpass = 1.6\n"),
        ("gain = 1.04\nnoise = 0.005\n", ""),
        ("highpass = 0.5", "highpass = 1.6"),
        ('unit = "g"\nsensitivity = 0.1\n', 'quantity = "displacement"\nsensitivity = 1e5\n'),
    ]
    text = RIG + SHAKER.replace("low = 4", "low = 1").replace("drop_periods = 1", "drop_periods = 2")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    rig.write_text(text)
    (rig.parent / "model.toml").write_text(MODEL)
    structure = read_model(rig.parent / "model.toml").structure
    run(rig, "--inputs", "--reference-highpass", 1.6, "--seconds", 20)
    (found,) = measure(read_rig(rig), rig.parent / "out.h5").frfs.values()
    low = found.lines(0.5, 4.5)
    exact = frf(structure, structure.nominal, low.frequency, low.outputs, low.inputs)
    assert low.frequency[0] == 1.0
    np.testing.assert_allclose(low.value / exact, 1.0, atol=0.01)
