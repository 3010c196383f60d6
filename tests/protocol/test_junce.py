"""The JDS6600, transcribed from the makers' protocol."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.generators.junce import Junce
from drivers.generators.simulated import SimulatedJunce, SimulatedLine
from drivers.transport import ScriptedTransport
from labnnum.errors import ConfigError, DeviceTimeoutError, ProtocolError

from .playing import played

OK = b":ok\r\n"
GREETING = [(b":r00=0.\r\n", b":r00=60.\r\n"), (b":r01=0.\r\n", b":r01=1710301.\r\n")]
OFF = [
    *[(b":r20=0.\r\n", b":r20=1,1.\r\n"), (b":w20=0,1.\r\n", OK)],
    (b":r20=0.\r\n", b":r20=0,1.\r\n"),
]


def speak(script, action, channel=1):
    line = ScriptedTransport(script)
    with Junce(line, channel, pause=0.0) as generator:
        action(generator)
    line.finish()


def test_a_sine_set_read_back_played_and_left_off_while_the_other_output_stays():
    def action(generator):
        assert generator.identity == "JDS6600-60M number 1710301"
        generator.set_waveform("sine")
        generator.set_frequency(257.86)
        generator.set_amplitude(1.25)
        generator.set_offset(-1.5)
        generator.output(True)

    asked = [
        *[(b":r21=0.\r\n", b":r21=0.\r\n"), (b":r23=0.\r\n", b":r23=25786000,3.\r\n")],
        *[(b":r25=0.\r\n", b":r25=2500.\r\n"), (b":r27=0.\r\n", b":r27=850.\r\n"), (b":r20=0.\r\n", b":r20=0,1.\r\n")],
    ]
    speak(
        [
            *GREETING,
            *OFF,
            *[(b":w21=0.\r\n", OK), (b":r21=0.\r\n", b":r21=0.\r\n")],
            *[(b":w23=25786000,3.\r\n", OK), (b":r23=0.\r\n", b":r23=25786000,3.\r\n")],
            *[(b":w25=2500.\r\n", OK), (b":r25=0.\r\n", b":r25=2500.\r\n")],
            *[(b":w27=850.\r\n", OK), (b":r27=0.\r\n", b":r27=850.\r\n")],
            *asked,
            *[(b":r20=0.\r\n", b":r20=0,1.\r\n"), (b":w20=1,1.\r\n", OK), (b":r20=0.\r\n", b":r20=1,1.\r\n")],
            *OFF,
        ],
        action,
    )


@pytest.mark.parametrize(
    ("hertz", "sent"),
    [
        (0.123456, b"12345600,4"),
        (20.0, b"2000000000,4"),
        (36.5, b"3650000,3"),
        (20_000.0, b"2000000000,3"),
        (50_000.0, b"5000000,0"),
    ],
)
def test_the_finest_multiplier_that_holds_the_frequency(hertz, sent):
    back = (b":r23=0.\r\n", b":r23=" + sent + b".\r\n")
    speak([*GREETING, *OFF, (b":w23=" + sent + b".\r\n", OK), back, *OFF], lambda g: g.set_frequency(hertz))


def test_another_multiplier_may_come_back():
    back = (b":r23=0.\r\n", b":r23=3650,1.\r\n")
    speak([*GREETING, *OFF, (b":w23=3650000,3.\r\n", OK), back, *OFF], lambda g: g.set_frequency(36.5))


def test_output_2_has_the_next_registers():
    off = [(b":r20=0.\r\n", b":r20=1,1.\r\n"), (b":w20=1,0.\r\n", OK), (b":r20=0.\r\n", b":r20=1,0.\r\n")]
    set_it = [(b":w26=1000.\r\n", OK), (b":r26=0.\r\n", b":r26=1000.\r\n")]
    speak([*GREETING, *off, *set_it, *off], lambda g: g.set_amplitude(0.5), channel=2)
    with pytest.raises(ConfigError, match="output 3 does not exist; there are 1, 2"):
        Junce(ScriptedTransport([]), channel=3)


@pytest.mark.parametrize(
    ("answer", "kind", "said"),
    [
        (None, DeviceTimeoutError, "no answer within 1 s; its output is off"),
        (b":no\r\n", ProtocolError, "after ':w25=1000.' came ':no', not ':ok'; its output is off"),
    ],
)
def test_a_command_that_is_not_acknowledged_switches_off(answer, kind, said):
    def action(generator):
        with pytest.raises(kind, match=said):
            generator.set_amplitude(0.5)

    speak([*GREETING, *OFF, (b":w25=1000.\r\n", answer), *OFF, *OFF], action)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b":r25=1000\r\n", "to ':r25=0.' came ':r25=1000'; its"),
        (b":r26=1000.\r\n", "came ':r26=1000.'; its"),
        (b":r25=1,x.\r\n", "came ':r25=1,x.'; its"),
        (b":r25=500.\r\n", "amplitude was set to 0.5 V peak and reads back as 0.25 V peak; its output is off"),
    ],
)
def test_an_answer_that_is_not_the_registers_switches_off(answer, said):
    def action(generator):
        with pytest.raises(ProtocolError, match=said):
            generator.set_amplitude(0.5)

    speak([*GREETING, *OFF, (b":w25=1000.\r\n", OK), (b":r25=0.\r\n", answer), *OFF, *OFF], action)


def test_where_the_other_output_cannot_be_read_both_go_off():
    deaf = [(b":r20=0.\r\n", None), (b":w20=0,0.\r\n", OK)] * 3
    line = ScriptedTransport([*GREETING, *OFF, (b":w25=1000.\r\n", None), *deaf, *deaf])
    with pytest.raises(DeviceTimeoutError, match="its output may be on"), Junce(line, pause=0.0) as generator:
        generator.set_amplitude(0.5)
    line.discard()
    line.finish()


def test_another_make_is_named():
    line = ScriptedTransport([(b":r00=0.\r\n", b"?\r\n"), (b":w20=0,0.\r\n", b"")])
    with pytest.raises(ProtocolError, match=r"to ':r00=0.' came '\?'; it was told to switch off"):
        Junce(line, pause=0.0).identify()
    line.finish()


@settings(max_examples=40, deadline=None)
@given(hertz=st.floats(1e-3, 6e7), volts=st.floats(0.001, 5), offset=st.floats(-5, 5))
def test_whatever_is_set_is_what_the_simulated_instrument_plays(hertz, volts, offset):
    instrument = SimulatedJunce()
    heard = played(Junce(SimulatedLine(instrument), pause=0.0), instrument, hertz, volts, offset)
    assert abs(heard.frequency - hertz) <= max(0.0051 if hertz > 21e3 else 0.51e-5, 1e-9 * hertz)
    assert abs(heard.amplitude - volts) <= 0.26e-3
    assert abs(heard.offset - offset) <= 5.1e-3
    assert instrument.registers[20] == [0, 1]
