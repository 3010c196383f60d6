"""The 33120A and kin, transcribed from the manual: what is sent, what comes back."""

import pytest

from drivers.generators.base import Settings
from drivers.generators.scpi import Scpi
from drivers.transport import ScriptedTransport
from labnnum.errors import ConfigError, DeviceLostError, DeviceTimeoutError, ProtocolError, SafetyError

FINE = (b"SYST:ERR?\n", b'+0,"No error"\r\n')
OFF = [
    (b"APPL:DC DEF,DEF,0\n", b""),
    FINE,
    (b"FUNC:SHAP?\n", b"DC\r\n"),
    (b"VOLT:OFFS?\n", b"+0.00000000000000E+00\r\n"),
]
GREETING = [
    (b"SYST:REM\n", b""),
    (b"*CLS\n", b""),
    (b"*IDN?\n", b"HEWLETT-PACKARD,33120A,0,10.0-5.0-1.0\r\n"),
    *[(b"OUTP:LOAD INF\n", b""), FINE, (b"VOLT:UNIT VPP\n", b""), FINE],
]
LATER = [
    (b"SYST:REM\n", b""),
    (b"*CLS\n", b""),
    (b"*IDN?\n", b"Agilent Technologies,33220A,MY44000000,2.00-2.00-22-2\r\n"),
    *[(b"OUTP:LOAD INF\n", b""), FINE, (b"VOLT:UNIT VPP\n", b""), FINE],
    *[(b"OUTP OFF\n", b""), FINE, (b"OUTP?\n", b"0\r\n")],
]
LATER_OFF = [(b"OUTP OFF\n", b""), FINE, (b"OUTP?\n", b"0\r\n")]


def speak(script, action, **options):
    line = ScriptedTransport(script)
    try:
        with Scpi(line, pause=0.0, **options) as generator:
            action(generator)
    finally:
        line.finish()
        assert line.closed


def test_a_33120a_plays_a_sine_and_is_left_at_dc_of_0_volts():
    def action(generator):
        assert generator.identity == "HEWLETT-PACKARD 33120A"
        generator.set_waveform("sine")
        generator.set_frequency(100.0)
        generator.set_amplitude(0.5)
        generator.set_offset(0.0)
        generator.output(True)

    speak(
        [
            *GREETING,
            *OFF,
            (b"FUNC:SHAP?\n", b"DC\r\n"),
            (b"VOLT:OFFS?\n", b"+0.00000000000000E+00\r\n"),
            (b"APPL:SIN 100,1,0\n", b""),
            FINE,
            (b"FUNC:SHAP?\n", b"SIN\r\n"),
            (b"FREQ?\n", b"+1.00000000000000E+02\r\n"),
            (b"VOLT?\n", b"+1.00000000000000E+00\r\n"),
            (b"VOLT:OFFS?\n", b"+0.00000000000000E+00\r\n"),
            *OFF,
        ],
        action,
    )


def test_settings_of_a_33120a_that_plays_are_sent_at_once_and_read_back():
    def action(generator):
        generator.set_amplitude(0.5)
        generator.output(True)
        generator.set_frequency(36.5)
        generator.set_amplitude(0.25)

    speak(
        [
            *GREETING,
            *OFF,
            *[(b"FUNC:SHAP?\n", b"DC\r\n"), (b"VOLT:OFFS?\n", b"+0.0E+00\r\n")],
            *[(b"APPL:SIN 1000,1,0\n", b""), FINE, (b"FUNC:SHAP?\n", b"SIN\r\n"), (b"FREQ?\n", b"+1.0E+03\r\n")],
            *[(b"VOLT?\n", b"+1.0E+00\r\n"), (b"VOLT:OFFS?\n", b"+0.0E+00\r\n")],
            *[(b"FREQ 36.5\n", b""), FINE, (b"FREQ?\n", b"+3.65000000000000E+01\r\n")],
            *[(b"VOLT 0.5\n", b""), FINE, (b"VOLT?\n", b"+5.00000000000000E-01\r\n")],
            *OFF,
        ],
        action,
    )


def test_later_models_switch_their_output():
    def action(generator):
        generator.set_frequency(20.0)
        generator.output(True)
        assert generator.read_back() == Settings("sine", 20.0, 0.05, 0.0, True)

    asked = [
        *[(b"FUNC:SHAP?\n", b"SIN\r\n"), (b"FREQ?\n", b"+2.0E+01\r\n"), (b"VOLT?\n", b"+1.0E-01\r\n")],
        (b"VOLT:OFFS?\n", b"+0.0E+00\r\n"),
    ]
    speak(
        [
            *LATER,
            *[(b"FREQ 20\n", b""), FINE, (b"FREQ?\n", b"+2.00000000000000E+01\r\n")],
            *asked,
            (b"OUTP?\n", b"0\r\n"),
            *[(b"OUTP ON\n", b""), FINE, (b"OUTP?\n", b"1\r\n")],
            *asked,
            (b"OUTP?\n", b"1\r\n"),
            *LATER_OFF,
        ],
        action,
    )


def test_a_fault_in_the_queue_is_told_in_the_instruments_words():
    def action(generator):
        with pytest.raises(ProtocolError, match=r"'FREQ 20' it said 550 \"Commands not allowed in local\"; its output"):
            generator.set_frequency(20.0)

    refused = (b"SYST:ERR?\n", b'+550,"Commands not allowed in local"\r\n')
    speak([*LATER, (b"FREQ 20\n", b""), refused, (b"*CLS\n", b""), *LATER_OFF, *LATER_OFF], action)


def test_a_setting_that_does_not_take_switches_off():
    def action(generator):
        with pytest.raises(ProtocolError, match=r"amplitude was set to 2.0 V peak and reads back as 1.0 V peak; its"):
            generator.set_amplitude(2.0)

    speak([*LATER, (b"VOLT 4\n", b""), FINE, (b"VOLT?\n", b"+2.0E+00\r\n"), *LATER_OFF, *LATER_OFF], action)


def test_what_somebody_left_on_the_front_panel_is_held_against_max_volts():
    def action(generator):
        with pytest.raises(SafetyError, match="10 V peak would pass max_volts 1; its output is off"):
            generator.output(True)

    asked = [
        *[(b"FUNC:SHAP?\n", b"SIN\r\n"), (b"FREQ?\n", b"+2.0E+01\r\n"), (b"VOLT?\n", b"+2.0E+01\r\n")],
        *[(b"VOLT:OFFS?\n", b"+0.0E+00\r\n"), (b"OUTP?\n", b"0\r\n")],
    ]
    speak([*LATER, *asked, *LATER_OFF, *LATER_OFF], action, max_volts=1.0)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda g: g.set_frequency(2e7), r"frequency 2e\+07 Hz is outside 0.0001 to 1.5e\+07 Hz"),
        (lambda g: g.set_frequency(float("nan")), "frequency nan Hz is outside"),
        (lambda g: g.set_amplitude(0.01), "amplitude 0.01 V peak is outside 0.05 to 10 V"),
        (lambda g: g.set_offset(11.0), "offset 11 V is outside ±10 V"),
        (lambda g: g.set_waveform("sinus"), "waveform 'sinus' is not one of sine, square, triangle, noise"),
    ],
)
def test_what_the_instrument_cannot_do_is_not_sent(call, said):
    def action(generator):
        with pytest.raises(ConfigError, match=said):
            call(generator)

    speak([*LATER, *LATER_OFF], action)


def test_another_make_is_named():
    line = ScriptedTransport(
        [(b"SYST:REM\n", b""), (b"*CLS\n", b""), (b"*IDN?\n", b"hello\r\n"), (b"APPL:DC DEF,DEF,0\n", b"")]
    )
    with pytest.raises(ProtocolError, match=r"came 'hello'; is it an SCPI generator\?; it was told to switch off"):
        Scpi(line, pause=0.0).__enter__()
    line.finish()
    assert line.closed


@pytest.mark.parametrize(
    ("answer", "kind", "said"),
    [
        (None, DeviceTimeoutError, "no answer within 1 s; its output is off"),
        (b"\xff\xf1\xfe\r\n", ProtocolError, r"is the baud rate right\?; its output is off"),
        (b"hm\r\n", ProtocolError, "came 'hm', which is no number; its output is off"),
        (b"NAN\r\n", ProtocolError, "came 'NAN', which is no number; its output is off"),
    ],
)
def test_silence_and_rubbish_switch_off(answer, kind, said):
    def action(generator):
        with pytest.raises(kind, match=said):
            generator.set_frequency(20.0)

    speak([*LATER, (b"FREQ 20\n", b""), FINE, (b"FREQ?\n", answer), *LATER_OFF, *LATER_OFF], action)


def test_an_output_that_does_not_confirm_asks_for_a_hand():
    def action(generator):
        with pytest.raises(DeviceTimeoutError, match="its output may be on: switch it off by hand"):
            generator.set_frequency(20.0)

    deaf = [(b"OUTP OFF\n", b""), (b"SYST:ERR?\n", None), (b"APPL:DC DEF,DEF,0\n", b"")] * 3
    line = ScriptedTransport([*LATER, (b"FREQ 20\n", b""), (b"SYST:ERR?\n", None), *deaf, *deaf])
    generator = Scpi(line, pause=0.0)
    with pytest.raises(SafetyError, match="switch it off by hand"), generator:
        action(generator)
    line.finish()


def test_a_lost_line_is_told_with_the_state_of_the_output():
    def lost():
        return DeviceLostError("scripted line: the line is gone")

    gone = [(b"OUTP OFF\n", lost()), (b"APPL:DC DEF,DEF,0\n", lost())]
    blind = [(b"APPL:DC DEF,DEF,0\n", lost())] * 2
    line = ScriptedTransport([*LATER, (b"FREQ 20\n", lost()), *gone, *blind, *gone, *blind])
    with (
        pytest.raises(DeviceLostError, match="the line is gone; its output may be on: switch it off by hand"),
        Scpi(line, pause=0.0) as generator,
    ):
        generator.set_frequency(20.0)
    line.finish()
