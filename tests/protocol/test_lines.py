"""Every generator over a real pseudo-terminal: good lines, and unplugged, silent, garbled and slow ones."""

import math
import os
import threading
import time

import pytest

from drivers.generators import OPENERS
from drivers.generators.exciter import GeneratorExciter
from drivers.generators.pseudo_terminal import PseudoTerminal
from drivers.generators.simulated import SimulatedFeelTech, SimulatedJunce, SimulatedScpi
from drivers.transport import SerialTransport
from labnnum.errors import (
    ConfigError,
    DeviceLostError,
    DeviceTimeoutError,
    DriverError,
    ProtocolError,
    SafetyError,
)

pytestmark = pytest.mark.skipif(not hasattr(os, "openpty"), reason="this system has no pseudo-terminals")

KINDS = {
    "33120A": ("scpi", SimulatedScpi),
    "33220A": ("scpi", lambda: SimulatedScpi(switch=True)),
    "FY6800": ("feeltech", lambda: SimulatedFeelTech(empty=4)),
    "FY6900": ("feeltech", lambda: SimulatedFeelTech("FY6900-60M", point=True, wraps=False)),
    "JDS6600": ("junce", SimulatedJunce),
}


@pytest.fixture(params=list(KINDS))
def bench(request, tmp_path):
    """A line with a lasting name, and a generator on it that plays 36.5 Hz at 0.5 V peak."""
    kind, make = KINDS[request.param]
    with PseudoTerminal(make(), tmp_path / "tty") as line:
        generator = OPENERS[kind](line.port, max_volts=2.0)
        generator.timeout, generator.pause = 5.0, 0.01
        try:
            yield line, generator
        finally:
            generator.transport.close()


def again(generator):
    """Another generator on the same port."""
    made = type(generator)(SerialTransport(generator.transport.name), max_volts=2.0)
    made.timeout, made.pause = 5.0, 0.01
    return made


def play(generator):
    generator.set_waveform("sine")
    generator.set_frequency(36.5)
    generator.set_amplitude(0.5)
    generator.set_offset(0.0)
    generator.output(True)


def test_it_plays_what_was_asked_and_is_off_afterwards(bench):
    line, generator = bench
    with generator:
        play(generator)
        now = line.instrument.settings
        assert (now.waveform, now.output) == ("sine", True)
        assert now.frequency == pytest.approx(36.5, abs=1e-5)
        assert now.amplitude == pytest.approx(0.5, rel=0.005)
        assert generator.read_back().output
        generator.set_amplitude(1.5)
        assert line.instrument.settings.amplitude == pytest.approx(1.5, rel=0.005)
    assert not line.instrument.settings.output


def test_an_error_in_the_body_leaves_it_off(bench):
    line, generator = bench

    def body():
        with generator:
            play(generator)
            assert line.instrument.settings.output
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        body()
    assert not line.instrument.settings.output


def test_more_than_max_volts_switches_off(bench):
    line, generator = bench

    def body():
        with generator:
            play(generator)
            generator.set_amplitude(2.5)

    with pytest.raises(SafetyError, match=r"2.5 V peak would pass max_volts 2; its output is off"):
        body()
    assert not line.instrument.settings.output


def test_a_silent_instrument_obeys_and_a_person_is_asked_to_look(bench):
    line, generator = bench

    def body():
        with generator:
            play(generator)
            line.mute, generator.timeout = True, 0.1
            generator.set_frequency(40.0)

    with pytest.raises(
        DeviceTimeoutError, match=r"no answer within 0.1 s; its output may be on: switch it off by hand"
    ):
        body()
    assert not line.instrument.settings.output


def test_a_garbled_line_is_named_and_the_output_goes_off_all_the_same(bench):
    line, generator = bench

    def body():
        with generator:
            play(generator)
            line.garble, generator.timeout = True, 0.1
            generator.set_frequency(40.0)

    with pytest.raises((ProtocolError, DeviceTimeoutError), match="switch it off by hand"):
        body()
    assert not line.instrument.settings.output


def test_a_line_that_is_too_slow_for_a_moment_ends_in_a_timeout_and_certainly_off(bench):
    line, generator = bench

    def body():
        with generator:
            play(generator)
            line.delay, generator.timeout = 0.4, 0.15
            threading.Timer(0.2, setattr, (line, "delay", 0.0)).start()
            generator.pause = 0.5
            generator.set_frequency(40.0)

    with pytest.raises(DeviceTimeoutError, match=r"no answer within 0.15 s.*; its output is off"):
        body()
    assert not line.instrument.settings.output


def test_a_slow_line_within_the_timeout_is_only_slow(bench):
    line, generator = bench
    line.delay = 0.02
    with generator:
        generator.set_frequency(36.5)


def test_an_unplugged_line_is_named_and_a_person_is_asked(bench):
    line, generator = bench

    def body():
        with generator:
            play(generator)
            line.unplug()
            generator.set_frequency(40.0)

    with pytest.raises(DeviceLostError, match=r"the line is gone.*; its output may be on: switch it off by hand"):
        body()


def test_a_line_that_comes_back_is_used_to_switch_off(bench):
    line, generator = bench

    def body():
        with generator:
            play(generator)
            line.unplug()
            generator.pause = 0.2
            threading.Timer(0.1, line.plug).start()
            generator.set_frequency(40.0)

    with pytest.raises(DeviceLostError, match=r"the line is gone.*; its output is off"):
        body()
    assert not line.instrument.settings.output


def test_nobody_there_is_said_when_it_is_opened(bench):
    line, generator = bench
    line.mute, generator.timeout = True, 0.1
    with pytest.raises(
        DeviceTimeoutError, match=r"no answer within 0.1 s; it was told to switch off and did not confirm"
    ):
        generator.__enter__()


def test_levels_are_reached_in_steps_and_off_holds_against_whoever_is_raising_them(bench):
    line, generator = bench
    exciter = GeneratorExciter(generator)
    with exciter:
        generator.identify()
        exciter.tone(36.5)
        assert not line.instrument.settings.output
        exciter.set_volts(0.3, ramp=0.1)
        assert line.instrument.settings.output
        assert line.instrument.settings.amplitude == pytest.approx(0.3 * math.sqrt(2), rel=0.005)
        raising = threading.Thread(target=exciter.set_volts, args=(1.0, 20.0))
        raising.start()
        exciter.off()
        assert not line.instrument.settings.output
        raising.join(5.0)
        exciter.set_volts(0.5)
        assert not line.instrument.settings.output
        exciter.tone(40.0)
        exciter.set_volts(0.5)
        assert line.instrument.settings.output
        exciter.set_volts(0.0)
        assert not line.instrument.settings.output
        with pytest.raises(SafetyError, match=r"2.12 V peak"):
            exciter.set_volts(1.5)
        with pytest.raises(ConfigError, match="plays sines only"):
            exciter.arm([0.0, 1.0], True)
    assert not line.instrument.settings.output


def test_an_impatient_interruption_while_it_is_switched_off_finds_it_off(bench):
    line, generator = bench
    with generator:
        play(generator)
        read, asked = generator.transport.read_until, []

        def interrupted(end=b"\n", timeout=1.0):
            asked.append(end)
            if len(asked) == 1:
                raise KeyboardInterrupt
            return read(end, timeout)

        generator.transport.discard()
        write = generator.transport.write
        generator.transport.read_until = interrupted
        generator.transport.write = lambda data: None if not asked else write(data)  # it had not been sent yet
        with pytest.raises(KeyboardInterrupt):
            generator.off()
        patience = time.monotonic() + 5.0
        while line.instrument.settings.output and time.monotonic() < patience:
            time.sleep(0.01)
        assert not line.instrument.settings.output


def test_an_exciter_that_let_its_line_go_leaves_whoever_took_it_alone(bench):
    """A "stop" that comes late reaches the run before: the port is the next one's by now."""
    line, generator = bench
    exciter = GeneratorExciter(generator)
    with exciter:
        generator.identify()
    with again(generator) as following:
        play(following)
        exciter.off()
        exciter.close()
        following.set_frequency(40.0)
        assert line.instrument.settings.output
        assert line.instrument.settings.frequency == pytest.approx(40.0, abs=1e-5)
    assert not line.instrument.settings.output


def test_a_level_below_the_smallest_is_refused():
    with PseudoTerminal(SimulatedScpi()) as line:
        exciter = GeneratorExciter(OPENERS["scpi"](line.port, max_volts=2.0))
        with exciter:
            exciter.generator.identify()
            exciter.tone(36.5)
            with pytest.raises(ConfigError, match=r"0.01 V RMS is less than it can play, 0.0354 V"):
                exciter.set_volts(0.01)
            assert not line.instrument.settings.output


@pytest.mark.parametrize("first", [2, 9])
def test_a_line_lost_at_any_moment_ends_in_one_clear_error(bench, first):
    line, generator = bench
    answer, heard = line.instrument.answer, []

    def lose(text):
        heard.append(text)
        if len(heard) == first:
            line.mute, generator.timeout = True, 0.1
        return answer(text)

    line.instrument.answer = lose
    generator.timeout = 0.5

    def body():
        with generator:
            play(generator)
            for hertz in range(20, 60):
                generator.set_frequency(hertz)

    with pytest.raises(DriverError, match=r"no answer.*(switch it off by hand|did not confirm)"):
        body()
    if first > 2:  # before it was known who is there, nothing had been switched
        patience = time.monotonic() + 5.0
        while line.instrument.settings.output and time.monotonic() < patience:
            time.sleep(0.01)
        assert not line.instrument.settings.output
