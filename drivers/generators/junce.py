"""Junce (Juntek, Joy-IT) JDS6600 and its sisters over their USB serial line."""

from __future__ import annotations

import math
from typing import Any, final

from drivers.generators.base import Generator, Limits, Setting
from drivers.transport import SerialTransport
from labnnum.errors import ProtocolError

_REGISTERS = {"waveform": 21, "frequency": 23, "amplitude": 25, "offset": 27}
"""Of output 1; output 2 is one further. Register 20 switches both outputs."""
_SHAPES = {"sine": 0, "square": 1, "triangle": 3, "noise": 11}
_STEPS = (1e-2, 1e-2, 1e-2, 1e-5, 1e-8)
"""Hz per count for the multipliers shown as Hz, kHz, MHz, mHz and µHz; the first three differ in the display only."""
_FINE = ((4, 21.0), (3, 21e3))
"""Multipliers that resolve more than 0.01 Hz, and up to how many Hz their count stays within 31 bits."""


@final
class Junce(Generator):
    r"""JDS6600 (also sold as JDS2900, JDS8000, CJDS66): two outputs.

    Notes
    -----
    From the makers' protocol: 115200 baud; ``:wNN=data.`` sets register NN and is answered by ``:ok``, ``:rNN=0.``
    reads it and is answered by ``:rNN=data.``; every line ends in CR LF. A frequency is a count and one of five
    multipliers; the one with the finest step that can hold the frequency is used, and whatever multiplier comes back is
    understood. Amplitude counts mV peak to peak, offset counts 10 mV from 1000. Register 20 holds both outputs, so the
    other one is read and kept; only where that fails are both switched off.
    """

    channels = (1, 2)
    limits = Limits(frequency=(1e-6, 60e6), amplitude=(0.0005, 10.0), peak=10.0)
    waveforms = tuple(_SHAPES)

    @property
    def _silence(self) -> bytes:
        return b":w20=0,0.\r\n"

    def _identify(self) -> str:
        model, serial = self._ask(0), self._ask(1)
        if len(model) != 1 or len(serial) != 1:
            raise ProtocolError(f"{self.transport.name}: registers 0 and 1 hold {model} and {serial}; is it a JDS6600?")
        return f"JDS6600-{model[0]}M number {serial[0]}"

    def _write(self, setting: Setting, value: Any) -> None:
        if setting == "output":
            outputs = self._outputs()
            outputs[self.channel - 1] = int(value)
            self._tell(20, *outputs)
        else:
            self._tell(self._register(setting), *_spelt(setting, value))

    def _register(self, setting: Setting) -> int:
        return _REGISTERS[setting] + self.channel - 1

    def _outputs(self) -> list[int]:
        outputs = self._ask(20)
        if len(outputs) != 2 or not set(outputs) <= {0, 1}:
            raise ProtocolError(f"{self._name}: register 20 holds {outputs}, not two outputs on (1) or off (0)")
        return outputs

    def _read(self, setting: Setting) -> Any:
        if setting == "output":
            return self._outputs()[self.channel - 1] == 1
        data = self._ask(self._register(setting))
        if setting == "frequency":
            return self._hertz(data)
        if setting == "waveform":
            return next((n for n, i in _SHAPES.items() if [i] == data), f"number {data[0]}")
        return data[0] / 2e3 if setting == "amplitude" else (data[0] - 1000) / 100

    def _hertz(self, data: list[int]) -> float:
        if len(data) != 2 or not 0 <= data[1] < len(_STEPS):
            raise ProtocolError(
                f"{self._name}: register {self._register('frequency')} holds {data}, which is no frequency"
            )
        return data[0] * _STEPS[data[1]]

    def _tolerance(self, setting: Setting, value: float) -> float:
        """Half a count."""
        if setting == "frequency":
            return 0.51 * _STEPS[_multiplier(value)] + 1e-9 * value
        return 0.26e-3 if setting == "amplitude" else 5.1e-3

    def _tell(self, register: int, *data: int) -> None:
        command = f":w{register:02d}={','.join(map(str, data))}."
        answer = self._line(command)
        if answer != ":ok":
            raise ProtocolError(f"{self._name}: after {command!r} came {answer!r}, not ':ok'")

    def _ask(self, register: int) -> list[int]:
        command = f":r{register:02d}=0."
        answer = self._line(command)
        head, _, data = answer.partition("=")
        try:
            if head != f":r{register:02d}" or not data.endswith("."):
                raise ValueError
            return [int(x) for x in data[:-1].split(",")]
        except ValueError:
            raise ProtocolError(f"{self._name}: to {command!r} came {answer!r}") from None

    def _line(self, command: str) -> str:
        answer = self.transport.query(command.encode() + b"\r\n", b"\r\n", self.timeout)
        return answer[:-2].decode("ascii", "backslashreplace")


def _multiplier(hertz: float) -> int:
    return next((m for m, highest in _FINE if hertz <= highest), 0)


def _spelt(setting: Setting, value: Any) -> tuple[int, ...]:
    """The numbers that set `setting`."""
    if setting == "waveform":
        return (_SHAPES[value],)
    if setting == "frequency":
        multiplier = _multiplier(value)
        return round(value / _STEPS[multiplier]), multiplier
    return (round(value * 2e3),) if setting == "amplitude" else (round(value * 100) + 1000,)


def open_junce(port: str, channel: int = 1, max_volts: float = math.inf, baud: int = 115200) -> Junce:
    """A generator on a serial port; identify it (or enter it as a context) before anything else."""
    return Junce(SerialTransport(port, baud), channel, max_volts)
