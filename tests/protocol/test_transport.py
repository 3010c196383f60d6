"""Lines: what a script demands, and what a real terminal does when it is silent, held or gone."""

import os
import time

import pytest

from drivers.generators.pseudo_terminal import PseudoTerminal
from drivers.generators.simulated import SimulatedFeelTech
from drivers.transport import ScriptedTransport, ScriptError, SerialTransport, ports
from labnnum.errors import DeviceLostError, DeviceNotFoundError, DeviceTimeoutError, ProtocolError

posix = pytest.mark.skipif(not hasattr(os, "openpty"), reason="this system has no pseudo-terminals")


@pytest.fixture
def line():
    with PseudoTerminal(SimulatedFeelTech()) as terminal:
        yield terminal


def test_a_script_fails_on_other_bytes_on_leftovers_and_on_more_than_it_has():
    script = ScriptedTransport([(b"A\n", b"a\n"), (b"B\n", b"b\nrest")])
    with pytest.raises(ScriptError, match=r"b'B\\n' was sent where the script has b'A\\n'"):
        script.write(b"B\n")
    with pytest.raises(ScriptError, match="never sent"):
        script.finish()
    assert script.query(b"A\n") == b"a\n"
    assert script.query(b"B\n") == b"b\n"
    with pytest.raises(ScriptError, match="never read: b'rest'"):
        script.finish()
    with pytest.raises(ScriptError, match="had not been read"):
        script.write(b"C\n")
    script.discard()
    script.finish()
    with pytest.raises(ScriptError, match="after the script's end"):
        script.write(b"C\n")


@posix
def test_questions_are_answered_over_a_terminal(line):
    with SerialTransport(line.port, 115200) as transport:
        assert transport.query(b"UMO\n") == b"FY6800-60M\n"
        transport.write(b"RMN\nRMW\n")
        assert transport.read_until() == b"255\n"
        assert transport.read_until() == b"0\n"


@posix
def test_silence_ends_in_a_timeout_that_shows_what_came(line):
    with SerialTransport(line.port) as transport:
        with pytest.raises(DeviceTimeoutError, match=r"/dev/.*: no answer within 0.05 s$"):
            transport.read_until(timeout=0.05)
        transport.write(b"UMO\n")
        with pytest.raises(DeviceTimeoutError, match=r"no answer within 0.3 s after b'FY6800-60M\\n'"):
            transport.read_until(b"\r\n", timeout=0.3)


@posix
def test_what_comes_too_late_is_not_taken_for_the_next_answer(line):
    line.delay = 0.15
    with SerialTransport(line.port) as transport:
        with pytest.raises(DeviceTimeoutError):
            transport.query(b"UMO\n", timeout=0.02)
        line.delay = 0.0
        transport.query(b"RMN\n")
        while line.answered < 2:  # the late answer and its own are both on the line before it is emptied
            time.sleep(0.001)
        transport.discard()
        assert transport.query(b"RMW\n") == b"0\n"


@posix
def test_an_endless_line_is_garbled(line):
    class Babble:
        def answer(self, _):
            return b"x" * 6000

    line.instrument = Babble()
    with SerialTransport(line.port) as transport, pytest.raises(ProtocolError, match="without an end; is the baud"):
        transport.query(b"UMO\n")


@posix
def test_an_unplugged_line_is_lost_and_comes_back(tmp_path):
    link = tmp_path / "generator"
    with PseudoTerminal(SimulatedFeelTech(), link) as line, SerialTransport(str(link)) as transport:
        line.unplug()
        with pytest.raises(DeviceLostError, match=r"generator: the line is gone .*; is it plugged in\?"):
            transport.query(b"UMO\n")
        with pytest.raises(DeviceNotFoundError, match="generator: "):
            transport.reopen()
        line.plug()
        transport.reopen()
        assert transport.query(b"UMO\n") == b"FY6800-60M\n"


@posix
def test_two_programs_cannot_hold_one_port(line):
    with SerialTransport(line.port), pytest.raises(DeviceNotFoundError, match=r"exclusively lock|temporarily"):
        SerialTransport(line.port)


def test_a_port_that_is_not_there_is_named_with_those_that_are():
    with pytest.raises(DeviceNotFoundError, match=r"/dev/tty-nowhere: .*; there (is|are)"):
        SerialTransport("/dev/tty-nowhere")
    assert isinstance(ports(), tuple)
