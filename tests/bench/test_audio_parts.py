"""Parts of the audio drivers that need no sound system: ring, clock and player."""

import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.audio import AudioDigitiser, checked
from drivers.clock import Clock, drift_between
from drivers.generators.audio_output import AudioOutput, Goal, Player, Tone, Wave
from drivers.ring import Ring
from labnnum.errors import DeviceNotFoundError, LabnnumError, ProtocolError


def numbered(start, n):
    return np.arange(start, start + n, dtype=np.float32)[:, None].repeat(2, axis=1)


@settings(max_examples=60, deadline=None)
@given(
    size=st.integers(8, 64),
    block=st.integers(1, 40),
    deliveries=st.lists(st.tuples(st.integers(1, 12), st.integers(0, 3), st.booleans(), st.booleans()), max_size=60),
)
def test_every_frame_is_handed_over_or_counted_as_lost(size, block, deliveries):
    """Deliveries (frames, lost before, broken, the reader comes): numbers in the signal agree with the ring's count."""
    ring, sent, pieces, broken = Ring(size, 2), 0, [], 0
    for n, lost, gap, read in deliveries:
        sent += lost
        kept = ring.put(numbered(sent, n), 0.0, lost, gap)
        broken += gap and kept
        sent += n
        while read and (piece := ring.take(block)) is not None:
            pieces.append(piece)
    while (piece := ring.take(block, rest=True)) is not None:
        pieces.append(piece)
    expected = 0
    for piece in pieces:
        assert 1 <= len(piece.data) <= block
        assert piece.start == expected + piece.lost
        np.testing.assert_array_equal(piece.data[:, 0], piece.start + np.arange(len(piece.data)))
        expected = piece.start + len(piece.data)
    assert expected <= sent
    assert sum(p.broken for p in pieces) >= min(broken, 1)


def test_a_gap_ends_a_piece_early_so_that_it_lies_between_pieces():
    ring = Ring(100, 1)
    ring.put(np.ones((10, 1), np.float32), 0.0)
    ring.put(np.ones((10, 1), np.float32), 0.1, broken=True)
    first, second = ring.take(16), ring.take(16)
    assert (len(first.data), first.broken) == (10, False)
    assert second is None
    second = ring.take(16, rest=True)
    assert (len(second.data), second.broken, second.start) == (10, True, 10)


class Interrupted(Ring):
    """A ring into which a delivery comes while `take` is at work, just after it has looked at the marks."""

    then = None

    def _absorb(self):
        super()._absorb()
        put, self.then = self.then, None
        if put is not None:
            put()


def test_a_gap_that_comes_while_frames_are_taken_lies_between_pieces_too():
    ring = Interrupted(100, 2)
    ring.put(numbered(0, 10), 0.0)
    ring.then = lambda: ring.put(numbered(15, 10), 0.1, lost=5)
    pieces = [p for p in (ring.take(16), ring.take(16), ring.take(16, rest=True)) if p is not None]
    assert [(p.start, len(p.data), p.lost) for p in pieces] == [(0, 10, 0), (15, 10, 5)]
    for piece in pieces:
        np.testing.assert_array_equal(piece.data[:, 0], piece.start + np.arange(len(piece.data)))


def test_deliveries_are_told_once_whether_or_not_frames_were_taken_in_between():
    ring = Ring(100, 1)
    for k in range(3):
        ring.put(np.ones((10, 1), np.float32), float(k))
    assert [m.time for m in ring.marks()] == [0.0, 1.0, 2.0]
    ring.put(np.ones((10, 1), np.float32), 3.0)
    ring.take(15)
    assert [m.time for m in ring.marks()] == [3.0]
    assert ring.marks() == []


def test_writer_and_reader_in_two_threads_lose_nothing():
    ring, frames = Ring(5000, 2), 200_000
    turn = threading.Event()

    def write():
        sent = 0
        while sent < frames:
            if ring.put(numbered(sent, 100), 0.0):
                sent += 100
            else:
                ring._lost -= 100  # the test sends it again
                turn.wait(0.001)

    writer = threading.Thread(target=write)
    writer.start()
    seen = 0
    while seen < frames:
        piece = ring.take(256) or ring.take(256, rest=True)
        if piece is None:
            turn.wait(0.0005)
            continue
        np.testing.assert_array_equal(piece.data[:, 1], seen + np.arange(len(piece.data)))
        seen += len(piece.data)
    writer.join()


@settings(max_examples=25, deadline=None)
@given(ppm=st.floats(-300, 300), seconds=st.integers(20, 120), seed=st.integers(0, 1000))
def test_the_clock_sees_through_late_deliveries(ppm, seconds, seed):
    random = np.random.default_rng(seed)
    clock, rate = Clock(48000.0), 48000.0 * (1 + 1e-6 * ppm)
    for n in range(0, 48000 * seconds, 1024):
        clock.add(n, 5.0 + n / rate + random.exponential(0.003))
    assert clock.seconds > seconds - 2
    assert abs(clock.drift_ppm - ppm) < 6 * clock.error_ppm + 1
    assert clock.error_ppm < 60
    assert clock.rate == pytest.approx(rate, rel=1e-4)


def test_frames_and_times_are_each_others_inverse():
    clock = Clock(1000.0)
    assert math.isnan(clock.drift_ppm)
    assert clock.rate == 1000.0
    clock.add(1000, 11.0)
    assert clock.time_of(500) == pytest.approx(10.5)
    assert clock.frame_at(10.75) == 750
    clock.restart()
    assert math.isnan(clock.time_of(0))
    clock.add(2000, 15.0)
    assert clock.frame_at(15.0) == 2000


def test_two_devices_are_held_against_each_other():
    one, other = Clock(1000.0), Clock(1000.0)
    for n in range(0, 30000, 100):
        one.add(n, n / 1000.1)
        other.add(n, n / 999.95)
    drift, error = drift_between(one, other)
    assert drift == pytest.approx(150, abs=1)
    assert error < 1


def delivered(true_rate, seconds, broken_at=None):
    """A digitiser that promised 48 kHz and was handed frames at another rate."""
    digitiser = AudioDigitiser("fake", 48000, [1], block=4800, buffer=seconds + 1)
    digitiser._stream, digitiser._running = SimpleNamespace(active=True), True
    data = np.zeros((480, 1), np.float32)
    for k in range(round(seconds * true_rate / 480)):
        digitiser._ring.put(data, (k + 1) * 480 / true_rate, broken=k == broken_at)
    return digitiser


def test_a_device_that_runs_at_another_rate_is_told_the_rate_that_it_has():
    with pytest.raises(ProtocolError, match="'fake' delivers 44100 frames per second, not 48000: set the rate"):
        delivered(44100.0, 12.0).read()


@pytest.mark.parametrize("seed", range(5))
def test_a_computer_that_falls_behind_and_catches_up_is_no_wrong_rate(seed):
    """After the first second deliveries stall now and then, and come five percent too fast until they are in time."""
    random = np.random.default_rng(seed)
    clock, now = Clock(48000.0), 0.0
    for n in range(0, 48000 * 40, 480):
        due = n / 48000
        now = max(now + 0.0095, due)
        if due > 1 and random.random() < 3e-4:
            now += random.uniform(0.3, 1.5)
        clock.add(n, now)
        assert not clock.is_wrong(1e4), f"after {due:.1f} s"


def test_a_clock_that_drifts_is_noted_and_one_that_does_not_is_not():
    drifting = delivered(48000 * (1 + 180e-6), 30.0)
    drifting.read()
    (said,) = drifting.notes
    assert said.startswith("fake: its clock runs 180 ± 0 ppm fast against this computer's")
    steady = delivered(48000 * (1 + 20e-6), 30.0)
    steady.read()
    assert steady.notes == ()


def test_an_overflow_is_flagged_where_it_was_and_noted():
    digitiser = delivered(48000.0, 2.0, broken_at=105)
    blocks = [digitiser.read() for _ in range(12)]
    flagged = [b for b in blocks if b.overflow]
    assert [b.start for b in flagged] == [105 * 480]
    assert [b.start for b in blocks] == sorted(b.start for b in blocks)
    assert "an overflow after 1.1 s; frames are missing" in digitiser.notes[0]


def test_an_output_on_another_device_is_held_against_the_digitisers_clock():
    digitiser = Clock(48000.0)
    output = AudioOutput("other", 48000, other=lambda: digitiser)
    for n in range(0, 48000 * 20, 4800):
        digitiser.add(n, n / 48000)
        output.clock.add(n, n / (48000 * (1 - 120e-6)))
    assert output.notes == ("other: its clock runs 120 ± 0 ppm slow against the digitiser's",)


def test_switching_off_while_a_tone_begins_is_no_fault_of_the_device():
    output, failed = AudioOutput("fake", 48000), []
    output._stream = SimpleNamespace(active=True, abort=lambda ignore_errors: None)

    def begin():
        try:
            output.tone(100.0)
        except LabnnumError as error:
            failed.append(error)

    beginning = threading.Thread(target=begin)
    beginning.start()
    while not output._ready:
        threading.Event().wait(0.001)
    output.off()
    beginning.join(60)
    assert failed == []
    output.set_volts(0.5)
    assert output.volts == 0.0


def rendered(player, frames, column=0, fetch=37):
    parts = []
    while frames > 0:
        out = np.full((min(fetch, frames), 2), np.nan, np.float32)
        player.render(out, column)
        assert not out[:, 1 - column].any()
        parts.append(out[:, column].astype(float))
        frames -= len(out)
    return np.concatenate(parts)


def test_a_period_goes_round_and_a_single_wave_ends():
    wave = np.arange(1, 11, dtype=np.float32)
    player = Player()
    player.play(Wave(wave, repeat=True))
    player.goal = Goal(1.0, 0)
    np.testing.assert_array_equal(rendered(player, 95), np.resize(wave, 95))
    player.play(Wave(wave, repeat=False))
    np.testing.assert_array_equal(rendered(player, 95), np.r_[wave, np.zeros(85)])


@settings(max_examples=30, deadline=None)
@given(
    levels=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 300)), min_size=1, max_size=6), fetch=st.integers(1, 90)
)
def test_levels_move_straight_and_start_from_where_they_are(levels, fetch):
    player = Player()
    player.play(Wave(np.ones(8, np.float32), repeat=True))
    before = 0.0
    for level, ramp in levels:
        player.goal = Goal(level, ramp)
        x = rendered(player, 350, fetch=fetch)
        assert x[-1] == pytest.approx(level, abs=1e-6)
        if ramp:
            np.testing.assert_allclose(x[:ramp], before + (level - before) * np.arange(ramp) / ramp, atol=1e-6)
        before = level


def test_a_tone_changes_its_frequency_without_a_jump_in_its_phase():
    player = Player()
    player.goal = Goal(1.0, 0)
    player.play(Tone(0.01))
    first = rendered(player, 333)
    player.play(Tone(0.02))
    second = rendered(player, 300)
    np.testing.assert_allclose(first, np.sqrt(2) * np.sin(2 * np.pi * 0.01 * np.arange(333)), atol=1e-6)
    whole = np.r_[first, second]
    assert np.abs(np.diff(whole)).max() < np.sqrt(2) * 2 * np.pi * 0.02 * 1.001
    assert np.std(whole) == pytest.approx(1.0, rel=0.02)


def test_silence_while_nothing_is_to_be_played():
    player = Player()
    player.goal = Goal(1.0, 0)
    assert not rendered(player, 50).any()
    assert not player.begun.is_set()
    player.play(Tone(0.1))
    rendered(player, 10)
    assert player.begun.is_set()
    assert player.begin == 50


@pytest.mark.parametrize("direction", ["input", "output"])
def test_a_device_that_was_plugged_in_since_is_found_and_one_that_was_not_is_named(monkeypatch, direction):
    there, looked = [], []
    fake = SimpleNamespace(
        PortAudioError=OSError,
        query_devices=lambda number=None: there if number is None else there[number],
        query_hostapis=lambda: [{"name": "ALSA"}],
        _terminate=lambda: looked.append("again"),
        _initialize=lambda: there.append(
            {"name": "Scarlett", "hostapi": 0, "default_samplerate": 48e3}
            | {"max_input_channels": 2, "max_output_channels": 2}
        ),
        check_input_settings=lambda **_: None,
        check_output_settings=lambda **_: None,
    )
    monkeypatch.setattr("drivers.audio.portaudio", lambda: fake)
    monkeypatch.setattr("drivers.audio._OPEN", [])
    assert checked("scarlett", direction, 2, 48000.0) == 0
    assert looked == ["again"]
    monkeypatch.setattr("drivers.audio._OPEN", ["another device of this process"])  # which a new look would lose
    there.clear()
    with pytest.raises(DeviceNotFoundError, match="no audio device is called 'scarlett'"):
        checked("scarlett", direction, 2, 48000.0)
    assert looked == ["again"]
