"""Transport: bytes to and from an instrument, over a serial line or from a script."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self, final

from labnnum.errors import DeviceLostError, DeviceNotFoundError, DeviceTimeoutError, ProtocolError

if TYPE_CHECKING:
    import serial

LONGEST = 4096
"""Bytes of one answer at most; a line that goes on without an end is garbled."""


class Transport(ABC):
    """Carries bytes and knows no protocol; every failure is an error of labnnum that names the line."""

    @property
    @abstractmethod
    def name(self) -> str:
        """The line, as messages call it."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send all of `data`. DeviceLostError if the line is gone, DeviceTimeoutError if it takes nothing."""

    @abstractmethod
    def read_until(self, end: bytes = b"\n", timeout: float = 1.0) -> bytes:
        """What comes up to and with `end`.

        Raises
        ------
        DeviceTimeoutError
            `end` did not come within `timeout` seconds; the message shows what did.
        DeviceLostError
            The line is gone.
        ProtocolError
            Thousands of bytes came without `end`.
        """

    @abstractmethod
    def discard(self) -> None:
        """Throw away what waits to be read: rests of an answer that came too late."""

    def query(self, command: bytes, end: bytes = b"\n", timeout: float = 1.0) -> bytes:
        """Send `command` and return the answer up to and with `end`."""
        self.write(command)
        return self.read_until(end, timeout)

    def reopen(self) -> None:
        """Try to get a lost line back. DeviceNotFoundError if it stays away."""
        raise DeviceNotFoundError(f"{self.name}: the line cannot be opened again")

    def close(self) -> None:
        """Let the line go; harmless when it is closed."""
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@final
class SerialTransport(Transport):
    """A serial port.

    Parameters
    ----------
    port : str
        Such as "/dev/ttyUSB0" or "COM3".
    baud : int
    stop_bits : int
        1 or 2.
    handshake : bool
        DTR tells the instrument that somebody listens; one that waits for it sends nothing otherwise.
    write_timeout : float
        s that the line may take to accept a command.

    Raises
    ------
    DeviceNotFoundError
        There is no such port, or another program holds it; the message names the ports that there are.
    """

    def __init__(
        self, port: str, baud: int = 9600, stop_bits: int = 1, handshake: bool = False, write_timeout: float = 2.0
    ) -> None:
        self._port, self._baud, self._stop_bits = port, baud, stop_bits
        self._handshake, self._write_timeout = handshake, write_timeout
        self._waiting = bytearray()
        self._serial = self._open()

    @property
    def name(self) -> str:
        """The port."""
        return self._port

    def _open(self) -> serial.Serial:
        import serial

        try:
            return serial.Serial(
                self._port,
                self._baud,
                stopbits=self._stop_bits,
                dsrdtr=self._handshake,
                timeout=0,
                write_timeout=self._write_timeout,
                exclusive=True,
            )
        except (*_failures(), ValueError) as error:
            raise DeviceNotFoundError(f"{self._port}: {_reason(error)}; {_ports()}") from error

    def write(self, data: bytes) -> None:
        """Send all of it."""
        import serial

        try:
            self._serial.write(data)
            self._serial.flush()
        except serial.SerialTimeoutException as error:
            raise DeviceTimeoutError(
                f"{self._port}: the line took no bytes for {self._write_timeout:g} s; is the instrument switched on?"
            ) from error
        except _failures() as error:
            raise self._lost(error) from error

    def read_until(self, end: bytes = b"\n", timeout: float = 1.0) -> bytes:
        """An answer; what came after its end waits for the next one."""
        until = time.monotonic() + timeout
        while (at := self._waiting.find(end)) < 0:
            left = until - time.monotonic()
            if left <= 0:
                raise DeviceTimeoutError(f"{self._port}: no answer within {timeout:g} s{_shown(self._waiting)}")
            if len(self._waiting) > LONGEST:
                raise ProtocolError(
                    f"{self._port}: {len(self._waiting)} bytes came without an end; is the baud rate right?"
                )
            self._waiting += self._receive(left)
        answer = bytes(self._waiting[: at + len(end)])
        del self._waiting[: at + len(end)]
        return answer

    def _receive(self, timeout: float) -> bytes:
        """At least one byte, or none after `timeout` seconds."""
        try:
            self._serial.timeout = timeout
            return self._serial.read(max(1, self._serial.in_waiting))
        except _failures() as error:
            raise self._lost(error) from error

    def discard(self) -> None:
        """Throw away what waits."""
        self._waiting.clear()
        try:
            self._serial.reset_input_buffer()
        except _failures() as error:
            raise self._lost(error) from error

    def reopen(self) -> None:
        """Open the same port anew."""
        self.close()
        self._waiting.clear()
        self._serial = self._open()

    def close(self) -> None:
        """Let the port go."""
        self._serial.close()

    def _lost(self, error: Exception) -> DeviceLostError:
        return DeviceLostError(f"{self._port}: the line is gone ({_reason(error)}); is it plugged in?")


def ports() -> tuple[str, ...]:
    """Serial ports that the system knows, such as "/dev/ttyUSB0"."""
    from serial.tools import list_ports

    return tuple(sorted(p.device for p in list_ports.comports()))


def _ports() -> str:
    there = ports()
    return f"there are {', '.join(there)}" if there else "there is no serial port; is the adapter plugged in?"


def _failures() -> tuple[type[Exception], ...]:
    """What pyserial raises when a port fails; on POSIX also what its terminal calls raise past it."""
    import serial

    try:
        import termios
    except ImportError:
        return serial.SerialException, OSError, TypeError
    return serial.SerialException, OSError, TypeError, termios.error


def _reason(error: Exception) -> str:
    strerror = getattr(error, "strerror", None)
    return strerror or (str(error).splitlines() or [type(error).__name__])[0]


def _shown(data: bytes | bytearray) -> str:
    return f" after {bytes(data[-40:])!r}" if data else ""


class ScriptError(AssertionError):
    """A conversation went off its script; no error of a device, so that no driver takes it for one."""


@final
class ScriptedTransport(Transport):
    r"""Plays an instrument's part of a conversation, word for word, and fails on anything that is not written.

    Parameters
    ----------
    script : sequence of (bytes, bytes or Exception or None)
        What the driver must send, in this order, and what comes back: bytes, silence (None), or a failure of the line.
    name : str

    Examples
    --------
    >>> line = ScriptedTransport([(b"*IDN?\n", b"ACME,1,0,1.0\r\n")])
    >>> line.query(b"*IDN?\n")
    b'ACME,1,0,1.0\r\n'
    >>> line.finish()
    """

    def __init__(self, script: Sequence[tuple[bytes, bytes | Exception | None]], name: str = "scripted line") -> None:
        self._script = list(script)
        self._at = 0
        self._waiting = b""
        self._failure: Exception | None = None
        self._name = name
        self.closed = False

    @property
    def name(self) -> str:
        """The line."""
        return self._name

    def write(self, data: bytes) -> None:
        """The next line of the script, or ScriptError."""
        if self._waiting:
            raise ScriptError(f"{data!r} was sent while {self._waiting!r} had not been read")
        if self._at == len(self._script):
            raise ScriptError(f"{data!r} was sent after the script's end")
        expected, answer = self._script[self._at]
        if data != expected:
            raise ScriptError(f"{data!r} was sent where the script has {expected!r} (line {self._at + 1})")
        self._at += 1
        if isinstance(answer, DeviceLostError):
            raise answer
        self._failure = answer if isinstance(answer, Exception) else None
        self._waiting = answer if isinstance(answer, bytes) else b""

    def read_until(self, end: bytes = b"\n", timeout: float = 1.0) -> bytes:
        """The script's answer; no time passes."""
        if self._failure is not None:
            failure, self._failure = self._failure, None
            raise failure
        head, found, rest = self._waiting.partition(end)
        if not found:
            raise DeviceTimeoutError(f"{self._name}: no answer within {timeout:g} s{_shown(self._waiting)}")
        self._waiting = rest
        return head + found

    def discard(self) -> None:
        """Throw away what waits."""
        self._waiting = b""

    def close(self) -> None:
        """Closed; the script may go on only after `finish`."""
        self.closed = True

    def finish(self) -> None:
        """Every line was spoken and every byte read, or ScriptError."""
        if self._at < len(self._script):
            left = [sent for sent, _ in self._script[self._at :]]
            raise ScriptError(f"never sent: {left!r}")
        if self._waiting:
            raise ScriptError(f"never read: {self._waiting!r}")
