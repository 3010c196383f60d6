"""SCPI function generators over RS-232: HP and Agilent 33120A and kin."""

from __future__ import annotations

import math
from typing import Any, final

from drivers.generators.base import Generator, Limits, Setting
from drivers.transport import SerialTransport
from labnnum.errors import ProtocolError

_SHAPES = {"sine": "SIN", "square": "SQU", "triangle": "TRI", "noise": "NOIS", "dc": "DC"}
_QUERIES = {"waveform": "FUNC:SHAP?", "frequency": "FREQ?", "amplitude": "VOLT?", "offset": "VOLT:OFFS?"}
_LONG = {"SINUSOID": "SIN", "SQUARE": "SQU", "TRIANGLE": "TRI", "NOISE": "NOIS"}


@final
class Scpi(Generator):
    """HP and Agilent 33120A, 33250A and others that speak SCPI.

    Notes
    -----
    From the manual's remote interface reference: over RS-232 the instrument must be told ``SYST:REM`` first; frames
    have 8 data and 2 stop bits at 9600 baud; its DTR/DSR handshake is not needed here, because every command is
    followed by a question and so its input buffer never fills. Voltages are peak to peak into 50 ohm unless
    ``OUTP:LOAD INF`` and ``VOLT:UNIT VPP`` say otherwise. The 33120A has no switch in its output: off is a DC of 0 V,
    and what was set meanwhile is sent in one ``APPL`` when it goes on. Faults wait in a queue that ``SYST:ERR?`` reads
    one by one.
    """

    limits = Limits(frequency=(1e-4, 15e6), amplitude=(0.05, 10.0), peak=10.0)
    waveforms = ("sine", "square", "triangle", "noise")

    @property
    def _silence(self) -> bytes:
        return b"APPL:DC DEF,DEF,0\n"

    def _identify(self) -> str:
        self._tell("SYST:REM")
        self._tell("*CLS")
        answer = self._ask("*IDN?")
        fields = [f.strip() for f in answer.split(",")]
        if len(fields) < 4:
            raise ProtocolError(f"{self.transport.name}: to '*IDN?' came {answer!r}; is it an SCPI generator?")
        self._switch = fields[1] != "33120A"
        self._wanted: dict[Setting, Any] = {"waveform": "sine", "frequency": 1000.0, "amplitude": 0.05, "offset": 0.0}
        for command in ("OUTP:LOAD INF", "VOLT:UNIT VPP"):
            self._command(command)
        return f"{fields[0]} {fields[1]}"

    def _write(self, setting: Setting, value: Any) -> None:
        if setting == "output":
            self._command(self._output(value))
        elif self._switch or self._known.get("output"):
            self._command(_spelt(setting, value))
        else:
            self._wanted[setting] = value

    def _output(self, on: bool) -> str:
        if self._switch:
            return f"OUTP {'ON' if on else 'OFF'}"
        if not on:
            return "APPL:DC DEF,DEF,0"
        w = self._wanted
        return f"APPL:{_SHAPES[w['waveform']]} {w['frequency']:.10g},{2 * w['amplitude']:.4g},{w['offset']:.4g}"

    def _read(self, setting: Setting) -> Any:
        if setting == "output":
            return self._number("OUTP?") != 0 if self._switch else self._plays()
        if not self._switch and not self._known.get("output"):
            return self._wanted[setting]
        if setting == "waveform":
            return self._shape()
        number = self._number(_QUERIES[setting])
        number = number / 2 if setting == "amplitude" else number
        self._wanted[setting] = number
        return number

    def _plays(self) -> bool:
        """Whether a 33120A gives anything but 0 V; when it has just gone on, whether it plays what was wanted."""
        if self._shape() == "dc":
            return self._number("VOLT:OFFS?") != 0
        for setting in ("frequency", "amplitude", "offset"):
            back, wanted = self._number(_QUERIES[setting]), self._wanted[setting]
            back = back / 2 if setting == "amplitude" else back
            if abs(back - wanted) > self._tolerance(setting, wanted):
                raise ProtocolError(f"{self._name}: {setting} was set to {wanted:g} and reads back as {back:g}")
        return True

    def _shape(self) -> str:
        answer = self._ask("FUNC:SHAP?").upper()
        answer = _LONG.get(answer, answer)
        for name, spelt in _SHAPES.items():
            if spelt == answer:
                return name
        raise ProtocolError(f"{self._name}: to 'FUNC:SHAP?' came {answer!r}")

    def _tolerance(self, setting: Setting, value: float) -> float:
        """Frequencies to 7 digits; voltages are rounded to 3 digits of the range that they fall in."""
        if setting == "frequency":
            return 1e-6 * value
        return 0.005 * max(abs(value), self._wanted["amplitude"]) + 0.5e-3

    def _command(self, command: str) -> None:
        """Send, and make sure that no fault is queued."""
        self._tell(command)
        fault = self._ask("SYST:ERR?")
        number, _, words = fault.partition(",")
        try:
            code = int(number)
        except ValueError:
            raise ProtocolError(f"{self._name}: after {command!r}, to 'SYST:ERR?' came {fault!r}") from None
        if code:
            self._tell("*CLS")
            raise ProtocolError(f"{self._name}: to {command!r} it said {code} {words}")

    def _tell(self, command: str) -> None:
        self.transport.write(command.encode() + b"\n")

    def _ask(self, query: str) -> str:
        answer = self.transport.query(query.encode() + b"\n", b"\n", self.timeout)
        try:
            return answer.decode("ascii").strip()
        except UnicodeDecodeError:
            raise ProtocolError(
                f"{self.transport.name}: to {query!r} came {answer!r}; is the baud rate right?"
            ) from None

    def _number(self, query: str) -> float:
        answer = self._ask(query)
        try:
            number = float(answer)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ProtocolError(f"{self._name}: to {query!r} came {answer!r}, which is no number")
        return number


def _spelt(setting: Setting, value: Any) -> str:
    """The command that sets `setting`."""
    if setting == "waveform":
        return f"FUNC:SHAP {_SHAPES[value]}"
    if setting == "frequency":
        return f"FREQ {value:.10g}"
    return f"VOLT {2 * value:.4g}" if setting == "amplitude" else f"VOLT:OFFS {value:.4g}"


def open_scpi(port: str, channel: int = 1, max_volts: float = math.inf, baud: int = 9600) -> Scpi:
    """A generator on a serial port; identify it (or enter it as a context) before anything else."""
    return Scpi(SerialTransport(port, baud, stop_bits=2, handshake=True), channel, max_volts, timeout=2.0)
