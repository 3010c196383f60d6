"""Simulated instruments: they speak the bytes of the real ones, quirks included."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from typing import final

from drivers.generators.base import Settings
from drivers.transport import Transport
from labnnum.errors import DeviceTimeoutError


class SimulatedInstrument(ABC):
    """Answers lines, and knows what its output would play."""

    @abstractmethod
    def answer(self, line: bytes) -> bytes:
        """What comes back to one line that ended in LF (handed over with its end); often nothing."""

    @property
    @abstractmethod
    def settings(self) -> Settings:
        """What its first output plays: open-circuit volts, amplitude as peak."""


@final
class SimulatedScpi(SimulatedInstrument):
    """A 33120A, or with `switch` a later model whose output can be switched off.

    Parameters
    ----------
    switch : bool
    """

    def __init__(self, switch: bool = False) -> None:
        self.model = "33220A" if switch else "33120A"
        self.switch = switch
        self.remote = False
        self.load = 50.0
        self.shape, self.frequency, self.vpp, self.offset, self.on = "SIN", 1000.0, 0.1, 0.0, not switch
        self.faults: deque[str] = deque(maxlen=20)

    @property
    def settings(self) -> Settings:
        """A 33120A is always on; DC at 0 V is its silence."""
        names = {"SIN": "sine", "SQU": "square", "TRI": "triangle", "NOIS": "noise", "DC": "dc"}
        gain = 1.0 if self.load > 1e6 else 2.0
        alternating = 0.0 if self.shape == "DC" else gain * self.vpp / 2
        sounds = self.on and not (self.shape == "DC" and self.offset == 0)
        return Settings(names[self.shape], self.frequency, alternating, gain * self.offset, sounds)

    def answer(self, line: bytes) -> bytes:
        """One command or question a line."""
        text = line.decode("ascii", "replace").strip().upper()
        head, _, data = text.partition(" ")
        if head == "SYST:REM":
            self.remote = True
        elif head == "*CLS":
            self.faults.clear()
        elif head.endswith("?"):
            value = self._value(head)
            return b"" if value is None else value.encode() + b"\r\n"
        elif not self.remote:
            self.faults.append('+550,"Commands not allowed in local"')
        else:
            self._command(head, data)
        return b""

    def _value(self, question: str) -> str | None:
        number = {"FREQ?": self.frequency, "VOLT?": self.vpp, "VOLT:OFFS?": self.offset}
        if question in number:
            return f"{number[question]:+.14E}"
        if question == "OUTP?" and self.switch:
            return "1" if self.on else "0"
        fixed = {"*IDN?": f"HEWLETT-PACKARD,{self.model},0,10.0-5.0-1.0", "FUNC:SHAP?": self.shape}
        if question in fixed:
            return fixed[question]
        if question == "SYST:ERR?":
            return self.faults.popleft() if self.faults else '+0,"No error"'
        self.faults.append('-113,"Undefined header"')
        return None

    def _command(self, head: str, data: str) -> None:
        if head.startswith("APPL:"):
            self._apply(head[5:], data)
        elif head == "OUTP" and self.switch:
            self.on = data in ("ON", "1")
        elif head == "OUTP:LOAD":
            self._load(50.0 if data == "50" else 9.9e37)
        elif head == "FUNC:SHAP":
            self.shape = data
        elif head in ("FREQ", "VOLT", "VOLT:OFFS"):
            self._number(head, data)
        elif head != "VOLT:UNIT":
            self.faults.append('-113,"Undefined header"')

    def _load(self, load: float) -> None:
        if (load > 1e6) != (self.load > 1e6):
            factor = 2.0 if load > 1e6 else 0.5
            self.vpp, self.offset = self.vpp * factor, self.offset * factor
        self.load = load

    def _apply(self, shape: str, data: str) -> None:
        values = [v.strip() for v in data.split(",")]
        self.shape = shape
        self.on = True
        if shape != "DC":
            self._number("FREQ", values[0])
            self._number("VOLT", values[1])
        self._number("VOLT:OFFS", values[2])

    def _number(self, head: str, data: str) -> None:
        try:
            value = float(data)
        except ValueError:
            self.faults.append('-128,"Numeric data not allowed"')
            return
        most = 20.0 if self.load > 1e6 else 10.0
        if head == "FREQ":
            low, high = 1e-4, 15e6
        else:
            low, high = (most / 200, most) if head == "VOLT" else (-most / 2, most / 2)
        if not low <= value <= high:
            self.faults.append('-222,"Data out of range"')
        value = min(max(value, low), high)
        if head == "FREQ":
            self.frequency = value
        elif head == "VOLT":
            self.vpp = float(f"{value:.3g}")
        else:
            self.offset = float(f"{value:.3g}")


@final
class SimulatedFeelTech(SimulatedInstrument):
    """An FY generator.

    Parameters
    ----------
    model : str
    point : bool
        Newer firmware: frequencies are sent in Hz with a point.
    wraps : bool
        The fraction of a frequency is read back modulo 65536 µHz.
    empty : int
        Every so many questions one is answered by an empty line; 0 for never.
    """

    def __init__(self, model: str = "FY6800-60M", point: bool = False, wraps: bool = True, empty: int = 0) -> None:
        self.model, self.point, self.wraps, self.empty = model, point, wraps, empty
        self.micro = {"M": 10_000_000_000, "F": 10_000_000_000}
        self.kept = {side: {"W": 0, "A": 50_000, "O": 0, "N": 1} for side in "MF"}
        self._asked = 0

    @property
    def settings(self) -> Settings:
        """The main output."""
        kept = self.kept["M"]
        offset = kept["O"] - 2**32 if kept["O"] >= 2**31 else kept["O"]
        shapes = {0: "sine", 1: "square", 5: "triangle", 7: "triangle", 30: "noise", 32: "noise"}
        shape = shapes.get(kept["W"], f"number {kept['W']}")
        return Settings(shape, self.micro["M"] / 1e6, kept["A"] / 2e4, offset / 1e3, kept["N"] != 0)

    def answer(self, line: bytes) -> bytes:
        """Set and say so, or read; a line with a CR is not understood and not answered."""
        text = line.decode("ascii", "replace").rstrip("\n")
        if "\r" in text:
            return b""
        if text.startswith("R") or text == "UMO":
            self._asked += 1
            if self.empty and self._asked % self.empty == 0:
                return b"\n"
            return (self.model if text == "UMO" else self._value(text[1], text[2])).encode() + b"\n"
        if text.startswith("W") and len(text) > 3:
            self._set(text[1], text[2], text[3:])
        return b"\n"

    def _value(self, side: str, code: str) -> str:
        if code == "N":
            return "255" if self.kept[side]["N"] else "0"
        if code != "F":
            return str(self.kept[side][code])
        whole, micro = divmod(self.micro[side], 1_000_000)
        return f"{whole:08d}.{micro % 65536 if self.wraps else micro:06d}"

    def _set(self, side: str, code: str, data: str) -> None:
        if code == "F":
            hertz = float(data) if self.point else int(data.replace(".", "")) / 1e6
            self.micro[side] = round(min(hertz, 60e6) * 1e6)
        elif code == "A":
            self.kept[side]["A"] = 10 * round(float(data) * 1e3)
        elif code == "O":
            self.kept[side]["O"] = round(float(data) * 1e3) % 2**32
        else:
            self.kept[side][code] = int(data)


@final
class SimulatedJunce(SimulatedInstrument):
    """A JDS6600: registers, and output 2 switched on by somebody else."""

    def __init__(self, megahertz: int = 60) -> None:
        self.registers = {
            **{0: [megahertz], 1: [1710301], 20: [1, 1], 21: [0], 22: [0], 23: [1_000_000, 0], 24: [1_000_000, 0]},
            **{25: [5000], 26: [5000], 27: [1000], 28: [1000]},
        }

    @property
    def settings(self) -> Settings:
        """The first output."""
        r = self.registers
        count, multiplier = r[23]
        hertz = count * (0.01, 0.01, 0.01, 1e-5, 1e-8)[multiplier]
        shape = {0: "sine", 1: "square", 3: "triangle", 11: "noise"}.get(r[21][0], f"number {r[21][0]}")
        return Settings(shape, hertz, r[25][0] / 2e3, (r[27][0] - 1000) / 100, r[20][0] == 1)

    def answer(self, line: bytes) -> bytes:
        """One register a line."""
        text = line.decode("ascii", "replace").strip()
        head, _, data = text.partition("=")
        if not head.startswith((":w", ":r")) or not head[2:].isdigit() or not data.endswith("."):
            return b""
        register = int(head[2:])
        if head[1] == "w":
            self.registers[register] = [int(x) for x in data[:-1].split(",")]
            return b":ok\r\n"
        held = ",".join(map(str, self.registers.get(register, [0])))
        return f":r{register:02d}={held}.\r\n".encode()


@final
class SimulatedLine(Transport):
    """A line straight to a simulated instrument, without an operating system in between; no time passes."""

    def __init__(self, instrument: SimulatedInstrument) -> None:
        self.instrument = instrument
        self._sent, self._waiting = b"", b""

    @property
    def name(self) -> str:
        """The line."""
        return "simulated line"

    def write(self, data: bytes) -> None:
        """Each whole line is answered."""
        *lines, self._sent = (self._sent + data).split(b"\n")
        for line in lines:
            self._waiting += self.instrument.answer(line + b"\n")

    def read_until(self, end: bytes = b"\n", timeout: float = 1.0) -> bytes:
        """An answer, or silence at once."""
        head, found, rest = self._waiting.partition(end)
        if not found:
            raise DeviceTimeoutError(f"{self.name}: no answer")
        self._waiting = rest
        return head + found

    def discard(self) -> None:
        """Throw away what waits."""
        self._waiting = b""
