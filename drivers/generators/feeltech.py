"""FeelTech (FeelElec) FY6600, FY6800 and FY6900 over their USB serial line."""

from __future__ import annotations

import math
import time
from typing import Any, final

from drivers.generators.base import Generator, Limits, Setting
from drivers.transport import SerialTransport
from labnnum.errors import ProtocolError

_CODES = {"waveform": "W", "frequency": "F", "amplitude": "A", "offset": "O", "output": "N"}
_SHAPES = {
    ("FY6900", 1): {"sine": 0, "square": 1, "triangle": 7, "noise": 32},
    ("FY6900", 2): {"sine": 0, "square": 1, "triangle": 6, "noise": 31},
    ("", 1): {"sine": 0, "square": 1, "triangle": 5, "noise": 30},
    ("", 2): {"sine": 0, "square": 1, "triangle": 4, "noise": 29},
}
"""Numbers of the waveforms, by model and output; "" are the models before the FY6900."""
EMPTY = 3
"""How often a question is asked again that was answered by an empty line."""


@final
class FeelTech(Generator):
    """FY6600, FY6800, FY6900: two outputs, M (main) and F (auxiliary).

    Notes
    -----
    From the makers' protocol and what users met: 115200 baud; a command ends in LF alone, since a CR ahead of it is
    taken for data; each is answered by LF when it has been carried out; questions are sometimes answered by an empty
    line. Amplitudes are peak to peak, read in units of 0.1 mV; offsets read in mV as unsigned 32 bits; output reads 255
    for on. Frequencies are sent in micro-hertz (14 digits) or, to newer firmware, in hertz with a point: `identify`
    finds out which with the output off, for the wrong one would ask for a million times the frequency. The fraction of
    a hertz is read back modulo 65536 micro-hertz by some firmware: 454.07 comes back as 454.004464.
    """

    channels = (1, 2)
    limits = Limits(frequency=(1e-6, 60e6), amplitude=(0.0005, 10.0), peak=12.0)
    waveforms = ("sine", "square", "triangle", "noise")

    @property
    def _shapes(self) -> dict[str, int]:
        model = "FY6900" if self.identity.startswith("FY6900") else ""
        return _SHAPES[model, self.channel]

    @property
    def _side(self) -> str:
        return "MF"[self.channel - 1]

    @property
    def _silence(self) -> bytes:
        return f"W{self._side}N0\n".encode()

    def _identify(self) -> str:
        model = self._ask("UMO")
        if not model.startswith("FY"):
            raise ProtocolError(f"{self.transport.name}: to 'UMO' came {model!r}; is it a FeelTech FY generator?")
        self._tell(f"W{self._side}N0")
        self._point = False
        self._point = not self._takes_hertz(1.0) and self._takes_point()
        return model

    def _takes_hertz(self, hertz: float) -> bool:
        self._write("frequency", hertz)
        return self._read("frequency") == hertz

    def _takes_point(self) -> bool:
        self._point = True
        if not self._takes_hertz(1.0):
            raise ProtocolError(f"{self.transport.name}: 1 Hz could not be set, neither as µHz nor as Hz")
        return True

    def _write(self, setting: Setting, value: Any) -> None:
        self._tell(f"W{self._side}{_CODES[setting]}{self._spelt(setting, value)}")

    def _spelt(self, setting: Setting, value: Any) -> str:
        if setting == "waveform":
            return f"{self._shapes[value]:02d}"
        if setting == "output":
            return "1" if value else "0"
        if setting == "frequency":
            return f"{value:015.6f}" if self._point else f"{round(value * 1e6):014d}"
        return f"{2 * value:.4f}" if setting == "amplitude" else f"{value:.3f}"

    def _read(self, setting: Setting) -> Any:
        question = f"R{self._side}{_CODES[setting]}"
        answer = self._ask(question)
        try:
            number = float(answer)
        except ValueError:
            raise ProtocolError(f"{self._name}: to {question!r} came {answer!r}, which is no number") from None
        if setting == "waveform":
            return next((n for n, i in self._shapes.items() if i == number), f"number {number:g}")
        if setting == "output":
            return number != 0
        if setting == "frequency":
            return number
        return number / 2e4 if setting == "amplitude" else signed(number) / 1e3

    def _tolerance(self, setting: Setting, value: float) -> float:
        """Half of the last digit that the instrument keeps, and a little for its own rounding."""
        return {"frequency": 1.1e-6, "amplitude": 0.3e-3}.get(setting, 0.6e-3)

    def _agrees(self, setting: Setting, value: Any, back: Any) -> bool:
        if setting == "frequency" and abs(back - wrapped(value)) <= 1.1e-6:
            return True
        return super()._agrees(setting, value, back)

    def _tell(self, command: str) -> None:
        answer = self.transport.query(command.encode() + b"\n", b"\n", self.timeout)
        if answer.strip():
            raise ProtocolError(f"{self._name}: {command!r} was acknowledged by {answer!r} instead of an empty line")

    def _ask(self, question: str) -> str:
        for again in range(EMPTY):
            if again:
                time.sleep(self.pause)
            answer = self.transport.query(question.encode() + b"\n", b"\n", self.timeout).strip()
            if answer:
                return answer.decode("ascii", "backslashreplace")
        raise ProtocolError(f"{self._name}: {question!r} was answered by an empty line, {EMPTY} times")


def wrapped(hertz: float) -> float:
    """A frequency as firmware with 16 bits for its fraction reads it back, in Hz.

    Examples
    --------
    >>> wrapped(454.07)
    454.004464
    """
    whole, micro = divmod(round(hertz * 1e6), 1_000_000)
    return (whole * 1_000_000 + micro % 65536) / 1e6


def signed(number: float) -> float:
    """An unsigned 32-bit number as the signed one that was meant.

    Examples
    --------
    >>> signed(4294966046)
    -1250
    """
    return number - 2**32 if number >= 2**31 else number


def open_feeltech(port: str, channel: int = 1, max_volts: float = math.inf, baud: int = 115200) -> FeelTech:
    """A generator on a serial port; identify it (or enter it as a context) before anything else."""
    return FeelTech(SerialTransport(port, baud), channel, max_volts)
