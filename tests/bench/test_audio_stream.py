"""What real PortAudio plays and records through a sound server: every frame, its number, and what a sine calibrates."""

import time
from itertools import pairwise

import numpy as np
import pytest
from typer.testing import CliRunner

from drivers.audio import AudioDigitiser, devices, find_device, refresh
from drivers.generators.audio_output import AudioOutput
from drivers.simulated.sound_server import SoundServer
from labnnum.errors import (
    ConfigError,
    DeviceLostError,
    DeviceNotFoundError,
    EstimationError,
    ProtocolError,
    SafetyError,
)
from sessions.audio import audio_digitiser
from sessions.cli import app
from sessions.rig import read_rig

from .rigs import AUDIO
from .rigs import AUDIO_RATE as RATE


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


def play_sine(frequency, amplitude, inputs):
    """An output stream that plays a sine on the first channels, and a tenth of it on the others."""
    at, size = [0], np.where(np.arange(4) < inputs, amplitude, 0.1 * amplitude)

    def fill(out, n, timing, status):
        wave = np.sin(2 * np.pi * frequency * (at[0] + np.arange(n)) / RATE)
        out[:] = wave[:, None] * size
        at[0] += n

    options = {"samplerate": RATE, "channels": 4, "dtype": "float32", "latency": 0.4}
    return pytest.importorskip("sounddevice").OutputStream(
        device=find_device("pulse", "output"), callback=fill, **options
    )


def calibrated(words):
    """What `labnnum calibrate` says while a sine sounds; again where the playing side ran dry, which it notices."""
    for _ in range(6):
        with play_sine(200.0, 0.25, 1):
            time.sleep(1.5)
            done = CliRunner().invoke(app, ["calibrate", *map(str, words)])
        if done.exception is None:
            return done.stdout
        assert isinstance(done.exception, EstimationError), done.exception
    pytest.skip("this computer is too busy to play without a pause")


def test_a_sine_that_a_meter_reads_gives_the_full_scale_of_an_input_and_of_no_other(echo, tmp_path):
    rig = tmp_path / "rig.toml"
    rig.write_text(
        AUDIO.replace("full_scale = 10.0\n", "", 1) + '[excitation]\nkind = "none"\n'
    )  # the force channel's is not known yet
    volts = 0.25 * 12.0 / np.sqrt(2)  # what a meter shows, if the largest number stands for 12 V
    for _ in range(2):  # with no full scale to begin with, and with the one that was found
        said = calibrated([rig, "f", "--sine", volts, "--frequency", 200, "--seconds", 3])
        assert "sine of 200 Hz" in said
        found = {table.name: table.full_scale for table in read_rig(rig).toml.channel}
        assert found["f"] == pytest.approx(12.0, rel=1e-5)
        assert (found["a1"], found["a2"]) == (10.0, 10.0)
    assert audio_digitiser(read_rig(rig)).full_scale[0] == pytest.approx(12.0, rel=1e-5)
    with play_sine(300.0, 0.25, 1):
        time.sleep(1.5)
        words = ["calibrate", str(rig), "f", "--sine", "2", "--frequency", "200", "--seconds", "2"]
        error = CliRunner().invoke(app, words).exception
    assert isinstance(error, EstimationError)
    assert read_rig(rig).toml.channel[0].full_scale == found["f"]


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


@pytest.mark.usefixtures("server")  # skips where there can be none
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
