"""Real PortAudio over a sound server's null sinks: a plant process in the loop answers, the bench measures it."""

import os
import time

import numpy as np
import pytest

from drivers.simulated import Drive, Input
from drivers.simulated.audio_plant import AudioPlant, PlantProcess
from labnnum.errors import ConfigError
from labnnum.recording import Channel
from labnnum.response import frf
from labnnum.structures.chain import Chain, Link
from sessions.bench import measure
from sessions.rig import parse_rig
from sessions.store import open_session

from .rigs import AUDIO
from .rigs import AUDIO_RATE as RATE

CHAIN = Chain(masses={"1": 2.0, "2": 1.0}, links=(Link("1", "ground", 8e5, 60.0), Link("1", "2", 5e5, 40.0)))
FORCE = Channel("f", "force", "reference", "1", "x", sensitivity=0.01)
NEAR = Channel("a1", "acceleration", node="1", direction="x", sensitivity=0.01)
FAR = Channel("a2", "acceleration", node="2", direction="x", sensitivity=0.01)
SENSORS = tuple(Input(c, noise=noise, full_scale=10.0) for c, noise in ((FORCE, 0.02), (NEAR, 0.05), (FAR, 0.05)))

SHAKER = """
[generator]
kind = "audio"
full_scale = 10.0
max_volts = 8.0
start_volts = 0.5
[excitation]
kind = "multisine"
low = 20
high = 300
levels = [10.0]
control = "f"
tolerance = 0.02
settle = 1.4
period = 2048
periods = 12
drop_periods = 1
[safety]
ramp = 0.2
"""
HAMMER = """
[excitation]
kind = "hammer"
high = 300
[trigger]
channel = "f"
level = 10.0
duration = 1.0
[plan]
hits = 6
"""
STEPPED = """
[generator]
kind = "scpi"
port = "{port}"
max_volts = 4.0
start_volts = 0.1
gain = 10.0
[excitation]
kind = "stepped sine"
low = 60
high = 160
levels = [2.0]
control = "f"
lines = 2
settle = 1.0
cycles = 40
[safety]
ramp = 0.1
"""


def plant_of(**more):
    return AudioPlant(CHAIN, SENSORS, Drive(FORCE, gain=more.pop("gain", 10.0)), RATE, drive_volts=10.0, **more)


def excess(found, low, high):
    """Mean of |error|^2 over its predicted variance, of each output, and the largest relative error predicted."""
    lines = (found.frequency >= low) & (found.frequency <= high)
    exact = frf(CHAIN, CHAIN.nominal, found.frequency[lines], found.outputs, found.inputs)
    error = np.abs(found.value[..., lines] - exact) ** 2
    variance = found.variance[..., lines]
    return np.mean(error / variance, axis=(1, 2)), float(np.sqrt(np.max(variance / np.abs(exact) ** 2)))


def measured(sound, plant, text, folder):
    """The outcome of a rig's plan against a plant process; again if that, or this one's output, could not keep up."""
    for attempt in range(4):
        with PlantProcess(plant, sound.environment("answer", "drive")) as process:
            rig = parse_rig(text.replace("{port}", process.port), folder / "rig.toml")
            outcome = measure(rig, folder / f"{attempt}.h5")
        told = " ".join(outcome.messages)
        late = process.missing > 0 or "ran dry" in told
        if not late and ("level held" not in told or attempt == 3):
            assert outcome.complete, outcome
            return outcome
    pytest.skip("this computer is too busy to run the plant in real time")


def test_a_shaker_run_holds_its_level_and_finds_the_plants_frf(sound, tmp_path):
    outcome = measured(sound, plant_of(), AUDIO + SHAKER, tmp_path)
    (found,) = outcome.frfs.values()
    with open_session(outcome.path) as session:
        (hit,) = session.runs[0].hits
    assert hit.info["level"] == pytest.approx(10.0, rel=0.02)
    times, error = excess(found, 22, 298)
    assert np.all(times > 0.5)
    assert np.all(times < 2.0)
    assert error < 0.02


def test_a_hammer_session_finds_the_plants_frf(sound, tmp_path):
    hammer = {"tip": "rubber", "interval": 1.4, "peak": 100.0, "lead": 2.5}
    outcome = measured(sound, plant_of(exciter="hammer", gain=1.0, hammer=hammer, seed=3), AUDIO + HAMMER, tmp_path)
    (found,) = outcome.frfs.values()
    times, error = excess(found, 40, 220)
    assert np.all(times > 0.4)
    assert np.all(times < 2.5)
    assert error < 0.2


def test_a_generator_on_a_serial_line_is_held_at_its_level_through_the_measured_force(sound, tmp_path):
    outcome = measured(sound, plant_of(exciter="33120A", gain=10.0), AUDIO + STEPPED, tmp_path)
    (found,) = outcome.frfs.values()
    exact = frf(CHAIN, CHAIN.nominal, found.frequency, found.outputs, found.inputs)
    np.testing.assert_allclose(found.value, exact, rtol=0.02)
    with open_session(outcome.path) as session:
        assert all(abs(h.info["off"]) <= 0.05 for h in session.runs[0].hits)


def test_rigs_that_lack_something_are_told(tmp_path):
    def told(text):
        with pytest.raises(ConfigError) as error:
            measure(parse_rig(text, tmp_path / "rig.toml"), tmp_path / f"{time.monotonic_ns()}.h5")
        return str(error.value)

    assert "channel[1].full_scale is missing" in told(AUDIO.replace("full_scale = 10.0\n", "") + HAMMER)
    assert "generator.full_scale is missing" in told(AUDIO + SHAKER.replace("full_scale = 10.0\n", ""))
    assert "generator.port is missing" in told(AUDIO + STEPPED.replace('port = "{port}"\n', ""))
    assert "cannot play beside an audio interface" in told(AUDIO + SHAKER.replace('"audio"', '"simulated"'))
    assert "is not one of simulated, audio, scpi" in told(AUDIO + SHAKER.replace('"audio"', '"rigol"'))
    assert os.environ.get("PULSE_SINK", "") == ""
