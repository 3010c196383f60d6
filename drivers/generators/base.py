"""Generator: what every function generator on a line offers, checked by reading back, and never left on."""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal, Self, TypeVar

from drivers.transport import Transport
from labnnum.errors import (
    ConfigError,
    DeviceLostError,
    DeviceNotFoundError,
    DriverError,
    LabnnumError,
    ProtocolError,
    SafetyError,
)

Setting = Literal["waveform", "frequency", "amplitude", "offset", "output"]
SETTINGS: tuple[Setting, ...] = ("waveform", "frequency", "amplitude", "offset", "output")
UNITS = {"frequency": " Hz", "amplitude": " V peak", "offset": " V"}
T = TypeVar("T")
ATTEMPTS = 3
"""How often the output is switched off before a person is asked to do it."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What an instrument can play; voltages into an open circuit.

    Parameters
    ----------
    frequency : (float, float)
        Lowest and highest sine, in Hz.
    amplitude : (float, float)
        Smallest and largest peak of the alternating part, in V.
    peak : float
        Largest sum of amplitude and magnitude of the offset, in V.
    """

    frequency: tuple[float, float]
    amplitude: tuple[float, float]
    peak: float


@dataclass(frozen=True, slots=True)
class Settings:
    """A generator's channel: waveform by name, frequency in Hz, amplitude in V peak, offset in V, output on or off."""

    waveform: str
    frequency: float
    amplitude: float
    offset: float
    output: bool


class Generator(ABC):
    """A function generator on a line.

    Amplitudes are peak volts of the alternating part into an open circuit, whatever the instrument's own convention
    (most count peak to peak). Every setting is read back and compared within what the instrument rounds to; a
    setting that does not take, a line that fails, and any exit of the context leave the output off.

    Parameters
    ----------
    transport : Transport
    channel : int
        Output, from 1.
    max_volts : float
        Peak volts that will not be passed, offset included.
    timeout : float
        s that the instrument may take to answer.
    pause : float
        s between attempts to switch off a generator that does not obey.

    Notes
    -----
    An instrument says how each setting is spelt (`_write`), how it is read (`_read`), how exactly (`_tolerance`), who
    it is (`_identify`), what it can do (`limits`, `waveforms`) and which bytes silence it without an answer
    (`_silence`).
    """

    limits: Limits
    """What it can play."""
    waveforms: tuple[str, ...]
    """Names that `set_waveform` takes."""
    channels: tuple[int, ...] = (1,)
    """Outputs that it has."""

    def __init__(
        self,
        transport: Transport,
        channel: int = 1,
        max_volts: float = math.inf,
        timeout: float = 1.0,
        pause: float = 0.2,
    ) -> None:
        if channel not in self.channels:
            raise ConfigError(f"output {channel} does not exist; there are {', '.join(map(str, self.channels))}")
        self.transport, self.channel, self.max_volts = transport, channel, max_volts
        self.timeout, self.pause = timeout, pause
        self.identity = ""
        self._known: dict[Setting, Any] = {}
        self._lock = threading.RLock()
        self._told: BaseException | None = None

    @abstractmethod
    def _identify(self) -> str:
        """Greet the instrument; its name. ProtocolError if it is another make."""

    @abstractmethod
    def _write(self, setting: Setting, value: Any) -> None:
        """Tell the instrument."""

    @abstractmethod
    def _read(self, setting: Setting) -> Any:
        """Ask the instrument."""

    @abstractmethod
    def _tolerance(self, setting: Setting, value: float) -> float:
        """How far a number may read back from what was set."""

    @property
    @abstractmethod
    def _silence(self) -> bytes:
        """What switches the output off when no answer can be hoped for."""

    def identify(self) -> str:
        """Who answers, such as "HEWLETT-PACKARD 33120A"; its output is off afterwards."""
        with self._lock:
            try:
                self.transport.discard()
                self.identity = self._identify()
            except DriverError as error:
                self._told = type(error)(f"{error}; {self._blindly()}")
                raise self._told from error
            self.off()
            return self.identity

    def set_waveform(self, name: str) -> None:
        """Choose "sine" or another of `waveforms`."""
        if name not in self.waveforms:
            raise ConfigError(f"{self._name}: waveform {name!r} is not one of {', '.join(self.waveforms)}")
        self._apply("waveform", name)

    def set_frequency(self, hertz: float) -> None:
        """Set the frequency in Hz."""
        low, high = self.limits.frequency
        if not low <= hertz <= high:
            raise ConfigError(f"{self._name}: frequency {hertz:g} Hz is outside {low:g} to {high:g} Hz")
        self._apply("frequency", float(hertz))

    def set_amplitude(self, volts: float) -> None:
        """Set the peak of the alternating part in V, open circuit. SafetyError (and off) beyond `max_volts`."""
        low, high = self.limits.amplitude
        if not low <= volts <= high:
            raise ConfigError(f"{self._name}: amplitude {volts:g} V peak is outside {low:g} to {high:g} V")
        self._require_peak(volts, self._known.get("offset", 0.0))
        self._apply("amplitude", float(volts))

    def set_offset(self, volts: float) -> None:
        """Set the offset in V, open circuit. SafetyError (and off) beyond `max_volts`."""
        if not abs(volts) <= self.limits.peak:
            raise ConfigError(f"{self._name}: offset {volts:g} V is outside ±{self.limits.peak:g} V")
        self._require_peak(self._known.get("amplitude", 0.0), volts)
        self._apply("offset", float(volts))

    def output(self, on: bool) -> None:
        """Switch the output. Before it goes on, what the instrument is set to is read and held against `max_volts`."""
        if not on:
            return self.off()
        with self._lock:
            now = self._guarded(self._settings)
            self._require_peak(now.amplitude, now.offset)
            self._apply("output", True)

    def read_back(self) -> Settings:
        """What the instrument says it is set to."""
        with self._lock:
            return self._guarded(self._settings)

    def off(self) -> None:
        """Switch the output off and make sure of it; harmless at any time, from any thread.

        Raises
        ------
        SafetyError
            It did not confirm: the message asks a person to switch it off.
        """
        with self._lock:
            try:
                failure = self._try_off()
            except BaseException:  # an impatient second Ctrl-C
                self._blindly()
                raise
            if failure is not None:
                raise SafetyError(f"{self._name}: {failure}; its output may be on: switch it off by hand")

    def close(self) -> None:
        """Off, and let the line go."""
        try:
            self.off()
        finally:
            self.transport.close()

    def __enter__(self) -> Self:
        try:
            self.identify()
        except BaseException:
            self.transport.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except SafetyError as unsafe:
            if error is None:
                raise
            if error is not self._told:
                raise SafetyError(f"{unsafe} (after: {error})") from error

    @property
    def _name(self) -> str:
        return f"{self.identity or type(self).__name__} on {self.transport.name}"

    def _settings(self) -> Settings:
        for setting in SETTINGS:
            self._known[setting] = self._read(setting)
        return Settings(**self._known)

    def _require_peak(self, amplitude: float, offset: float) -> None:
        peak = amplitude + abs(offset)
        if peak > self.max_volts * (1 + 1e-9):
            error = SafetyError(f"{self._name}: {peak:g} V peak would pass max_volts {self.max_volts:g}")
            raise self._leave_off(error)
        if peak > self.limits.peak * (1 + 1e-9):
            raise ConfigError(f"{self._name}: amplitude and offset add up to {peak:g} V, above {self.limits.peak:g} V")

    def _apply(self, setting: Setting, value: Any) -> None:
        with self._lock:
            self._guarded(lambda: self._set(setting, value))

    def _set(self, setting: Setting, value: Any) -> None:
        self._write(setting, value)
        back = self._read(setting)
        if not self._agrees(setting, value, back):
            unit = UNITS.get(setting, "")
            raise ProtocolError(f"{self._name}: {setting} was set to {value}{unit} and reads back as {back}{unit}")
        self._known[setting] = value

    def _agrees(self, setting: Setting, value: Any, back: Any) -> bool:
        if isinstance(value, (str, bool)):
            return back == value
        return abs(back - value) <= self._tolerance(setting, value)

    def _guarded(self, action: Callable[[], T]) -> T:
        """What `action` returns; if it fails the output goes off and the error says whether that worked."""
        try:
            return action()
        except LabnnumError as error:
            raise self._leave_off(error) from error
        except BaseException:
            self._try_off()
            raise

    def _leave_off(self, error: LabnnumError) -> LabnnumError:
        failure = self._try_off()
        state = "its output is off" if failure is None else "its output may be on: switch it off by hand"
        self._told = type(error)(f"{error}; {state}")
        return self._told

    def _try_off(self) -> DriverError | None:
        """Switch off, read back, repeat; why it is not certain, or None."""
        failure: DriverError | None = None
        for attempt in range(ATTEMPTS):
            if attempt:
                time.sleep(self.pause)
            try:
                if isinstance(failure, (DeviceLostError, DeviceNotFoundError)):
                    self.transport.reopen()
                self.transport.discard()
                self._write("output", False)
                if self._read("output") is False:
                    self._known["output"] = False
                    return None
                failure = ProtocolError("it reads back as on")
            except DriverError as error:
                failure = error
            self._blindly()
        return failure

    def _blindly(self) -> str:
        """Tell it to be silent without waiting for an answer; what became of that."""
        try:
            self.transport.write(self._silence)
        except DriverError:
            return "nothing could be sent to it"
        return "it was told to switch off and did not confirm"
