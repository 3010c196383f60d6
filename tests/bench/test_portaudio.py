"""Real PortAudio over a sound server's null sinks: a plant process in the loop answers, the bench measures it."""

import os
import sys
import time
from itertools import pairwise

import numpy as np
import pytest

from drivers.audio import AudioDigitiser, devices, find_device, refresh
from drivers.generators.audio_output import AudioOutput
from drivers.simulated import Drive, Input
from drivers.simulated.audio_plant import AudioPlant, PlantProcess
from drivers.simulated.sound_server import SoundServer
from labnnum.errors import ConfigError, DeviceLostError, DeviceNotFoundError, ProtocolError, SafetyError
from labnnum.recording import Channel
from labnnum.response import frf
from labnnum.structures.chain import Chain, Link
from sessions.bench import measure
from sessions.rig import parse_rig
from sessions.store import open_session

LACKING = SoundServer.missing() if sys.platform == "linux" else "null sinks are PulseAudio's, on Linux"
pytestmark = pytest.mark.skipif(bool(LACKING), reason=LACKING)

RATE = 8000
CHAIN = Chain(masses={"1": 2.0, "2": 1.0}, links=(Link("1", "ground", 8e5, 60.0), Link("1", "2", 5e5, 40.0)))
FORCE = Channel("f", "force", "reference", "1", "x", sensitivity=0.01)
NEAR = Channel("a1", "acceleration", node="1", direction="x", sensitivity=0.01)
FAR = Channel("a2", "acceleration", node="2", direction="x", sensitivity=0.01)
SENSORS = tuple(Input(c, noise=noise, full_scale=10.0) for c, noise in ((FORCE, 0.02), (NEAR, 0.05), (FAR, 0.05)))

DEVICE = """
[device]
kind = "audio"
name = "pulse"
rate = 8000
block = 512
latency = 0.2
channels = 4
[[channel]]
name = "f"
role = "reference"
unit = "N"
sensitivity = 0.01
full_scale = 10.0
node = "1"
direction = "x"
[[channel]]
name = "a1"
unit = "m/s^2"
sensitivity = 0.01
full_scale = 10.0
node = "1"
direction = "x"
[[channel]]
name = "a2"
unit = "m/s^2"
sensitivity = 0.01
full_scale = 10.0
node = "2"
direction = "x"
"""
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


@pytest.fixture(scope="module")
def server():
    with SoundServer(rate=RATE) as running:
        yield running


@pytest.fixture
def sound(server, monkeypatch):
    """This process plays into the drive and records the answer."""
    for key, value in server.environment("drive", "answer").items():
        monkeypatch.setenv(key, value)
    return server


@pytest.fixture
def echo(server, monkeypatch):
    """This process records what it plays."""
    for key, value in server.environment("answer", "answer").items():
        monkeypatch.setenv(key, value)
    return server


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


def counter(n):
    """Every frame has its number: two channels hold its digits to base 4096, exact in 32-bit floats."""
    k = np.arange(n)
    return np.stack([(k % 4096) / 4096, (k // 4096 % 4096) / 4096], axis=1).astype(np.float32)


def play_counter(frames):
    """An output stream that counts on both front channels, and goes on counting."""
    sd = pytest.importorskip("sounddevice")
    at, numbers = [1], counter(frames)

    def fill(out, n, timing, status):
        out[:] = 0
        out[:, :2] = numbers[at[0] : at[0] + n]
        at[0] += n

    options = {"samplerate": RATE, "channels": 4, "dtype": "float32", "latency": 0.4}
    return sd.OutputStream(device=find_device("pulse", "output"), callback=fill, **options)


def numbers_in(data):
    return np.round(data[0] * 4096).astype(int) + 4096 * np.round(data[1] * 4096).astype(int)


def uninterrupted(listen):
    """Blocks of `listen()` and their numbers; again where the playing side ran dry, which is none of the inputs' doing.

    The count has no zero, so zeros after its first number are silence that the sound server put in for the player.
    """
    for _ in range(6):
        blocks = listen()
        numbers = [numbers_in(b.data) for b in blocks]
        row = np.concatenate(numbers)
        if row.any() and row[np.flatnonzero(row)[0] :].all():
            return blocks, numbers
    pytest.skip("this computer is too busy to play without a pause")


def test_every_frame_arrives_once_and_as_it_was_played(echo, monkeypatch):
    monkeypatch.setattr(time, "time", time.perf_counter)  # one clock for both, which nobody sets
    digitiser = AudioDigitiser("pulse", RATE, [1, 2], 1.0, block=500, latency=0.1, channels=4)
    read = []

    def listen():
        with digitiser, play_counter(60 * RATE) as stream:
            read[:] = [time.perf_counter()]
            digitiser.start()
            blocks = []
            while len(blocks) < 40 or not numbers_in(blocks[-20].data).any():
                blocks.append(digitiser.read())
                read.append(time.perf_counter())
            assert stream.active
        return blocks

    blocks, numbers = uninterrupted(listen)
    heard = np.concatenate(numbers)
    heard = heard[np.flatnonzero(heard)[0] :]
    assert heard.size > RATE
    np.testing.assert_array_equal(np.diff(heard), 1)
    assert [b.start for b in blocks] == [500 * k for k in range(len(blocks))]
    assert not any(b.lost or b.overflow or b.overload.any() for b in blocks)
    assert not any("lost" in note or "missing" in note for note in digitiser.notes)
    assert blocks[0].time > read[0] - 0.1  # the system may hand over what it had gathered before
    for block, after in zip(blocks, read[1:], strict=True):
        assert block.time + 500 / RATE < after + 1e-3  # nobody hears what is not yet there
    # the line through the deliveries is corrected by the earliest of them, never by one that came late
    assert np.diff([b.time for b in blocks]).max() < 500 / RATE + 1e-3


def test_what_the_reader_does_not_fetch_is_counted_to_the_frame(echo):
    digitiser = AudioDigitiser("pulse", RATE, [1, 2], 1.0, block=500, buffer=0.5, latency=0.1, channels=4)

    def listen():
        with digitiser, play_counter(60 * RATE):
            digitiser.start()
            first = [digitiser.read()]
            while not numbers_in(first[-1].data).all():
                first.append(digitiser.read())
            time.sleep(1.2)
            return first[-1:] + [digitiser.read() for _ in range(12)]

    blocks, numbers = uninterrupted(listen)
    lost = [b.lost for b in blocks if b.lost]
    assert max(lost) > 0.3 * RATE
    offset = numbers[0][0] - blocks[0].start
    for block, number in zip(blocks, numbers, strict=True):
        np.testing.assert_array_equal(number, block.start + offset + np.arange(block.n_frames))
    for before, after in pairwise(blocks):
        assert after.start == before.start + before.n_frames + after.lost
    for n in lost:
        assert any(f"{n} frames were not fetched in time and are lost" in note for note in digitiser.notes)


def read_until(digitiser, holds, most=200):
    """Blocks up to the first for which `holds`; that frame count is the limit, not this computer's time."""
    blocks = [digitiser.read()]
    while not holds(blocks[-1]) and len(blocks) < most:
        blocks.append(digitiser.read())
    assert holds(blocks[-1]), f"not within {most} blocks"
    return blocks


def silent(block):
    return not block.data.any()


def test_overloads_are_flagged_by_channel(echo):
    digitiser = AudioDigitiser("pulse", RATE, [2, 1], [5.0, 2.0], block=800, latency=0.1, channels=4)
    output = AudioOutput("pulse", RATE, 1, 2.0, 2.0, latency=0.1, channels=4)
    with digitiser, output:
        digitiser.start()
        output.arm(np.r_[np.ones(400), -np.ones(400)], repeat=True)
        output.set_volts(2.0)
        loud = read_until(digitiser, lambda b: b.overload.any())[-1]
        assert loud.overload.tolist() == [False, True]
        assert np.abs(loud.data).max(axis=1).tolist() == [0.0, 2.0]
        output.off()
        read_until(digitiser, silent)
        output.set_volts(1.0)
        assert not np.any([digitiser.read().data for _ in range(4)])
        output.arm([3.0, -3.0], repeat=True)
        with pytest.raises(SafetyError, match="would need 3 V peak"):
            output.set_volts(1.0)
        with pytest.raises(ConfigError, match="tone of 4000 Hz is not below half the rate"):
            output.tone(4000.0)


def test_a_waveform_begins_where_the_digitiser_counts_and_a_tone_goes_on_without_a_jump(echo):
    digitiser = AudioDigitiser("pulse", RATE, [1], 1.0, block=400, latency=0.1, channels=4)
    at = AudioOutput("pulse", RATE, 1, 1.0, 1.0, latency=0.1, channels=4, frame_at=digitiser.frame_at)
    period, off = 4000, []
    with digitiser, at:
        digitiser.start()
        for _ in range(20):
            digitiser.read()
        for _ in range(5):
            begin = at.arm(np.linspace(0, 1, period, endpoint=False), repeat=True)
            at.set_volts(0.9)
            blocks = [digitiser.read() for _ in range(25)]
            x = np.hstack([b.data[0] for b in blocks])
            wraps = blocks[0].start + np.flatnonzero(np.diff(x) < -0.5) + 1
            off.append((wraps[-1] - begin + period // 2) % period - period // 2)
        assert np.median(np.abs(off)) < 0.02 * RATE, off
        at.tone(100.0)
        at.set_volts(0.5)
        for _ in range(10):
            digitiser.read()
        at.tone(107.0)
        x = np.hstack([digitiser.read().data[0] for _ in range(20)])
        assert np.abs(np.diff(x)).max() < 0.5 * np.sqrt(2) * 2 * np.pi * 107 / RATE * 1.01
        assert np.std(x[-4000:]) == pytest.approx(0.5, rel=0.02)


def test_a_level_rises_within_its_ramp(echo):
    digitiser = AudioDigitiser("pulse", RATE, [1], 1.0, block=400, latency=0.1, channels=4)
    with digitiser, AudioOutput("pulse", RATE, 1, 1.0, 1.0, latency=0.1, channels=4) as output:
        digitiser.start()
        output.arm(np.ones(100), repeat=True)
        read_until(digitiser, silent)
        output.set_volts(0.8, ramp=0.25)
        x = np.hstack([b.data[0] for b in read_until(digitiser, lambda b: b.data.min() > 0.8 - 1e-6)])
    rising = x[(x > 0) & (x < 0.8 - 1e-6)]
    assert rising.size == pytest.approx(0.25 * RATE, abs=2)
    np.testing.assert_allclose(np.diff(rising), 0.8 / (0.25 * RATE), atol=1e-6)


def test_what_a_device_does_not_have_is_said(sound):
    assert any(name == "pulse (ALSA)" for _, name, _, _ in devices())
    assert find_device("PULSE") == find_device("pulse") == find_device(find_device("pulse"))
    with pytest.raises(DeviceNotFoundError, match=r"no audio device is called 'Scarlett'; there are 0: .* inputs"):
        AudioDigitiser("Scarlett", RATE, [1]).open()
    with pytest.raises(DeviceNotFoundError, match="audio device 99 has no inputs or does not exist"):
        AudioDigitiser(99, RATE, [1]).open()
    with pytest.raises(DeviceNotFoundError, match="'pulse' has 32 inputs, and number 40 is asked for"):
        AudioDigitiser("pulse", RATE, [40]).open()
    with pytest.raises(ProtocolError, match=r"refuses 1 inputs at 5e\+08 Hz .*; it takes 8000, .*48000"):
        AudioDigitiser("pulse", 5e8, [1]).open()
    with pytest.raises(ConfigError, match=r"audio inputs \[1, 1\] must be different"):
        AudioDigitiser("pulse", RATE, [1, 1])


def test_a_device_that_goes_away_is_told_and_can_come_back(monkeypatch):
    digitiser = AudioDigitiser("pulse", RATE, [1], 1.0, block=400, latency=0.1, channels=4)

    def listen(server, blocks):
        for key, value in server.environment("answer", "answer").items():
            monkeypatch.setenv(key, value)
        digitiser.open()
        digitiser.start()
        return [digitiser.read() for _ in range(blocks)]

    with SoundServer(rate=RATE) as first:
        assert len(listen(first, 5)) == 5
        first.stop()
        with pytest.raises(DeviceLostError, match="'pulse' went away while it was recording"):
            [digitiser.read(3.0) for _ in range(100)]
        digitiser.stop()
        digitiser.close()
    with SoundServer(rate=RATE) as second:
        refresh()
        assert len(listen(second, 5)) == 5
        digitiser.close()


def test_a_shaker_run_holds_its_level_and_finds_the_plants_frf(sound, tmp_path):
    outcome = measured(sound, plant_of(), DEVICE + SHAKER, tmp_path)
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
    outcome = measured(sound, plant_of(exciter="hammer", gain=1.0, hammer=hammer, seed=3), DEVICE + HAMMER, tmp_path)
    (found,) = outcome.frfs.values()
    times, error = excess(found, 40, 220)
    assert np.all(times > 0.4)
    assert np.all(times < 2.5)
    assert error < 0.2


def test_a_generator_on_a_serial_line_is_held_at_its_level_through_the_measured_force(sound, tmp_path):
    outcome = measured(sound, plant_of(exciter="33120A", gain=10.0), DEVICE + STEPPED, tmp_path)
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

    assert "channel[1].full_scale is missing" in told(DEVICE.replace("full_scale = 10.0\n", "") + HAMMER)
    assert "generator.full_scale is missing" in told(DEVICE + SHAKER.replace("full_scale = 10.0\n", ""))
    assert "generator.port is missing" in told(DEVICE + STEPPED.replace('port = "{port}"\n', ""))
    assert "cannot play beside an audio interface" in told(DEVICE + SHAKER.replace('"audio"', '"simulated"'))
    assert "is not one of simulated, audio, scpi" in told(DEVICE + SHAKER.replace('"audio"', '"rigol"'))
    assert os.environ.get("PULSE_SINK", "") == ""
