"""The FY generators, transcribed from the makers' protocol, with what users met in their firmware."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.generators.base import Settings
from drivers.generators.feeltech import FeelTech, signed, wrapped
from drivers.generators.simulated import SimulatedFeelTech, SimulatedLine
from drivers.transport import ScriptedTransport
from labnnum.errors import DeviceTimeoutError, ProtocolError

from .playing import played

OFF = [(b"WMN0\n", b"\n"), (b"RMN\n", b"0\n")]
GREETING = [
    (b"UMO\n", b"FY6800-60M\n"),
    (b"WMN0\n", b"\n"),
    *[(b"WMF00000001000000\n", b"\n"), (b"RMF\n", b"00000001.000000\n")],
    *OFF,
]


def speak(script, action, channel=1):
    line = ScriptedTransport(script)
    with FeelTech(line, channel, pause=0.0) as generator:
        action(generator)
    line.finish()


def test_a_sine_set_read_back_played_and_left_off():
    def action(generator):
        assert generator.identity == "FY6800-60M"
        generator.set_waveform("sine")
        generator.set_frequency(36.5)
        generator.set_amplitude(1.25)
        generator.set_offset(-1.25)
        generator.output(True)

    asked = [
        *[(b"RMW\n", b"0\n"), (b"RMF\n", b"00000036.500000\n"), (b"RMA\n", b"25000\n")],
        *[(b"RMO\n", b"4294966046\n"), (b"RMN\n", b"0\n")],
    ]
    speak(
        [
            *GREETING,
            *[(b"WMW00\n", b"\n"), (b"RMW\n", b"0\n")],
            *[(b"WMF00000036500000\n", b"\n"), (b"RMF\n", b"00000036.500000\n")],
            *[(b"WMA2.5000\n", b"\n"), (b"RMA\n", b"25000\n")],
            *[(b"WMO-1.250\n", b"\n"), (b"RMO\n", b"4294966046\n")],
            *asked,
            *[(b"WMN1\n", b"\n"), (b"RMN\n", b"255\n")],
            *OFF,
        ],
        action,
    )


def test_newer_firmware_is_found_out_with_the_output_off_and_sent_hertz_with_a_point():
    def action(generator):
        generator.set_frequency(454.07)

    speak(
        [
            (b"UMO\n", b"FY6900-60M\n"),
            (b"WMN0\n", b"\n"),
            *[(b"WMF00000001000000\n", b"\n"), (b"RMF\n", b"01000000.000000\n")],
            *[(b"WMF00000001.000000\n", b"\n"), (b"RMF\n", b"00000001.000000\n")],
            *OFF,
            *[(b"WMF00000454.070000\n", b"\n"), (b"RMF\n", b"00000454.070000\n")],
            *OFF,
        ],
        action,
    )


def test_a_fraction_read_back_modulo_65536_passes_and_another_error_does_not():
    def action(generator):
        generator.set_frequency(454.07)
        with pytest.raises(
            ProtocolError, match=r"frequency was set to 454.07 Hz and reads back as 454.1 Hz; its output"
        ):
            generator.set_frequency(454.07)

    speak(
        [
            *GREETING,
            *[(b"WMF00000454070000\n", b"\n"), (b"RMF\n", b"00000454.004464\n")],
            *[(b"WMF00000454070000\n", b"\n"), (b"RMF\n", b"00000454.100000\n")],
            *OFF,
            *OFF,
        ],
        action,
    )


def test_the_auxiliary_output_has_its_own_commands_and_waveform_numbers():
    def action(generator):
        generator.set_waveform("triangle")

    greeting = [(a.replace(b"WM", b"WF").replace(b"RM", b"RF"), b) for a, b in GREETING]
    off = [(b"WFN0\n", b"\n"), (b"RFN\n", b"0\n")]
    speak([*greeting, (b"WFW04\n", b"\n"), (b"RFW\n", b"4\n"), *off], action, channel=2)


def test_an_empty_answer_is_asked_for_again():
    def action(generator):
        assert generator.read_back() == Settings("sine", 10000.0, 2.5, 0.0, False)

    asked = [
        *[(b"RMW\n", b"\n"), (b"RMW\n", b"0\n"), (b"RMF\n", b"00010000.000000\n")],
        *[(b"RMA\n", b"\n"), (b"RMA\n", b"\n"), (b"RMA\n", b"50000\n"), (b"RMO\n", b"0\n"), (b"RMN\n", b"0\n")],
    ]
    speak([*GREETING, *asked, *OFF], action)


@pytest.mark.parametrize(
    ("answer", "kind", "said"),
    [
        (None, DeviceTimeoutError, "no answer within 1 s; its output is off"),
        (b"\xfa\xfb\n", ProtocolError, "acknowledged by .* instead of an empty line; its output is off"),
    ],
)
def test_an_acknowledgement_that_is_none_switches_off(answer, kind, said):
    def action(generator):
        with pytest.raises(kind, match=said):
            generator.set_amplitude(1.0)

    speak([*GREETING, (b"WMA2.0000\n", answer), *OFF, *OFF], action)


def test_three_empty_answers_are_an_error():
    def action(generator):
        with pytest.raises(ProtocolError, match="'RMW' was answered by an empty line, 3 times; its output is off"):
            generator.set_waveform("square")

    speak([*GREETING, (b"WMW01\n", b"\n"), *[(b"RMW\n", b"\n")] * 3, *OFF, *OFF], action)


def test_another_make_is_named():
    line = ScriptedTransport([(b"UMO\n", b"MHS-5200A\n"), (b"WMN0\n", b"\n")])
    with pytest.raises(ProtocolError, match="to 'UMO' came 'MHS-5200A'; is it a FeelTech FY generator"):
        FeelTech(line, pause=0.0).identify()
    line.discard()
    line.finish()


@settings(max_examples=60, deadline=None)
@given(micro=st.integers(1, 60_000_000_000_000))
def test_wrapping_changes_less_than_a_hertz_and_only_the_fraction(micro):
    hertz = micro / 1e6
    back = round(wrapped(hertz) * 1e6)
    assert back // 1_000_000 == micro // 1_000_000
    assert (micro - back) % 65536 == 0


@settings(max_examples=60, deadline=None)
@given(millivolts=st.integers(-12000, 12000))
def test_offsets_survive_the_unsigned_detour(millivolts):
    assert signed(float(millivolts % 2**32)) == millivolts


@settings(max_examples=30, deadline=None)
@given(
    hertz=st.floats(0.01, 2e4),
    volts=st.floats(0.001, 5),
    offset=st.floats(-5, 5),
    point=st.booleans(),
    wraps=st.booleans(),
)
def test_whatever_is_set_is_what_the_simulated_instrument_plays(hertz, volts, offset, point, wraps):
    instrument = SimulatedFeelTech(point=point, wraps=wraps, empty=3)
    heard = played(FeelTech(SimulatedLine(instrument), pause=0.0), instrument, hertz, volts, offset)
    assert abs(heard.frequency - hertz) < 1e-6
    assert abs(heard.amplitude - volts) <= 0.3e-3
    assert abs(heard.offset - offset) <= 0.6e-3
