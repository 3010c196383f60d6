"""What one more generator costs: this file's class and opener, one line in OPENERS, and the conversation below."""

import math

import pytest

from drivers.generators import OPENERS
from drivers.generators.base import Generator, Limits
from drivers.generators.exciter import GeneratorExciter
from drivers.transport import ScriptedTransport, SerialTransport
from labnnum.errors import ProtocolError
from sessions.rig import parse_rig

LETTERS = {"waveform": "W", "frequency": "F", "amplitude": "A", "offset": "D", "output": "O"}


class Acme(Generator):
    """Answers every command by the value that it took: "F=36.5" by "F=36.5"."""

    limits = Limits(frequency=(1.0, 1e4), amplitude=(0.01, 5.0), peak=5.0)
    waveforms = ("sine",)
    _silence = b"O=0\r"

    def _identify(self):
        return self._ask("ID?")

    def _write(self, setting, value):
        command = f"{LETTERS[setting]}={1 if value == 'sine' else f'{value:g}'}"
        if self._ask(command) != command:
            raise ProtocolError(f"{self._name}: {command} was not taken")

    def _read(self, setting):
        told = float(self._ask(f"{LETTERS[setting]}?"))
        return {"waveform": "sine", "output": told == 1}.get(setting, told)

    def _tolerance(self, setting, value):
        return 1e-3 * abs(value)

    def _ask(self, text):
        return self.transport.query(text.encode() + b"\r", b"\r", self.timeout).decode().strip()


def open_acme(port, channel=1, max_volts=math.inf):
    return Acme(SerialTransport(port, 9600), channel, max_volts)


def test_it_is_held_to_its_limits_read_back_and_left_off():
    off = [(b"O=0\r", b"O=0\r"), (b"O?\r", b"0\r")]
    line = ScriptedTransport(
        [
            (b"ID?\r", b"ACME 7\r"),
            *off,
            *[(b"W=1\r", b"W=1\r"), (b"W?\r", b"1\r"), (b"D=0\r", b"D=0\r"), (b"D?\r", b"0\r")],
            *[(b"F=36.5\r", b"F=36.5\r"), (b"F?\r", b"36.5\r")],
            *[(b"A=1\r", b"A=1\r"), (b"A?\r", b"1.0\r")],
            *[(b"W?\r", b"1\r"), (b"F?\r", b"36.5\r"), (b"A?\r", b"1\r"), (b"D?\r", b"0\r"), (b"O?\r", b"0\r")],
            *[(b"O=1\r", b"O=1\r"), (b"O?\r", b"1\r")],
            *off,
            *off,
        ]
    )
    with Acme(line, max_volts=2.0) as generator:
        exciter = GeneratorExciter(generator)
        exciter.tone(36.5)
        exciter.set_volts(1 / math.sqrt(2))
        exciter.off()
    line.finish()


def test_its_name_in_openers_is_its_name_in_rig_toml(monkeypatch):
    text = '[device]\nrate = 1000\n[[channel]]\nname = "a"\nsensitivity = 1.0\n[generator]\nkind = "acme"\n'
    with pytest.raises(ValueError, match="'acme' is not one of simulated, audio, scpi"):
        parse_rig(text)
    monkeypatch.setitem(OPENERS, "acme", open_acme)
    rig = parse_rig(text)
    assert rig.toml.generator is not None
    assert rig.toml.generator.kind == "acme"
