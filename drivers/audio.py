"""Audio interfaces as digitisers, through PortAudio. Nothing of it is loaded until a device is opened."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.block import Block
from drivers.clock import Clock, drift_note
from drivers.digitiser import Digitiser
from drivers.ring import Mark, Piece, Ring
from labnnum.errors import (
    ConfigError,
    DeviceLostError,
    DeviceNotFoundError,
    DeviceTimeoutError,
    DriverError,
    ProtocolError,
)

CLIPPED = 1 - 2.0**-15
"""Share of the full scale from which a sample counts as overloaded: the highest code of 16 bits."""
WRONG = 0.01
"""Share by which the rate may be off before the device is not doing what it promised."""

Direction = Literal["input", "output"]


def portaudio() -> Any:
    """The sounddevice module. DeviceNotFoundError if PortAudio is not on this computer."""
    try:
        import sounddevice
    except (ImportError, OSError) as error:
        raise DeviceNotFoundError(
            f"PortAudio cannot be loaded ({error}); on Debian and kin: apt install libportaudio2"
        ) from error
    return sounddevice


_OPEN: list[Any] = []


def claimed(holder: Any) -> None:
    """A stream of this process is open."""
    _OPEN.append(holder)


def released(holder: Any) -> None:
    """It is closed."""
    _OPEN.remove(holder)


def refresh() -> None:
    """Look for devices again; does nothing while one of this process is open, for it would lose it."""
    if not _OPEN:
        sd = portaudio()
        sd._terminate()
        sd._initialize()


def devices(direction: Direction = "input") -> list[tuple[int, str, int, float]]:
    """Devices that have inputs (or outputs): number, "name (system)", channels, usual rate in Hz."""
    sd = portaudio()
    systems = [a["name"] for a in sd.query_hostapis()]
    return [
        (i, f"{d['name']} ({systems[d['hostapi']]})", d[f"max_{direction}_channels"], d["default_samplerate"])
        for i, d in enumerate(sd.query_devices())
        if d[f"max_{direction}_channels"] > 0
    ]


def find_device(name: str | int, direction: Direction = "input") -> int:
    """Number of the device with that number, name, or part of a name that no other has; "" is the system's default.

    Raises
    ------
    DeviceNotFoundError
        There is none, or several; the message lists those that there are.
    """
    there = devices(direction)
    listed = "; ".join(f"{i}: {n}, {c} {direction}s" for i, n, c, _ in there) or f"none with {direction}s"
    if name == "":
        name = portaudio().default.device[0 if direction == "input" else 1]
        if name == -1:
            raise DeviceNotFoundError(f"there is no default {direction} device; there are {listed}")
    if isinstance(name, int):
        if name not in [i for i, *_ in there]:
            raise DeviceNotFoundError(f"audio device {name} has no {direction}s or does not exist; there are {listed}")
        return name
    exact = [i for i, n, *_ in there if name in (n, n.rsplit(" (", 1)[0])]
    part = [i for i, n, *_ in there if name.casefold() in n.casefold()]
    found = exact[:1] or part
    if len(found) != 1:
        how = "several audio devices are" if found else "no audio device is"
        raise DeviceNotFoundError(f"{how} called {name!r}; there are {listed}")
    return found[0]


def checked(name: str | int, direction: Direction, channels: int, rate: float) -> int:
    """Number of a device that has so many channels and takes that rate; it may have been plugged in just now.

    Raises
    ------
    DeviceNotFoundError
        No such device, or it has fewer channels.
    ProtocolError
        It refuses the rate; the message names those usual rates that it takes.
    """
    try:
        return _checked(name, direction, channels, rate)
    except DeviceNotFoundError:
        refresh()
        return _checked(name, direction, channels, rate)


def _checked(name: str | int, direction: Direction, channels: int, rate: float) -> int:
    sd = portaudio()
    number = find_device(name, direction)
    info = sd.query_devices(number)
    most = info[f"max_{direction}_channels"]
    if channels > most:
        raise DeviceNotFoundError(
            f"audio device {info['name']!r} has {most} {direction}s, and number {channels} is asked for"
        )
    check = sd.check_input_settings if direction == "input" else sd.check_output_settings
    try:
        check(device=number, channels=channels, dtype="float32", samplerate=rate)
    except sd.PortAudioError as error:
        raise ProtocolError(
            f"audio device {info['name']!r} refuses {channels} {direction}s at {rate:g} Hz"
            f" ({_words(error)}){_taken(check, number, channels)}"
        ) from error
    return number


def _taken(check: Any, number: int, channels: int) -> str:
    good = []
    for rate in (8000, 11025, 16000, 22050, 32000, 44100, 48000, 51200, 88200, 96000, 192000):
        try:
            check(device=number, channels=channels, dtype="float32", samplerate=rate)
        except portaudio().PortAudioError:
            continue
        good.append(rate)
    return f"; it takes {', '.join(map(str, good))}" if good else ""


def _words(error: Exception) -> str:
    return str(error.args[0] if error.args else error).removeprefix("Error opening ")


@final
class AudioDigitiser(Digitiser):
    """An audio interface.

    Parameters
    ----------
    device : str or int
        Name, part of a name, or number as `devices` lists them; "" is the system's default.
    rate : float
        Frames per second; the device must take it.
    inputs : sequence of int
        Inputs of the device, from 1, in the order of the blocks' rows.
    full_scale : array_like, shape (n_inputs,)
        Volts at the inputs that the device turns into its largest number, gains of preamplifiers included.
    block : int
        Frames a block; where frames were lost a block ends early.
    buffer : float
        s of frames that wait for the reader at most.
    latency : float or str
        s that the system may gather before it delivers: "high" as the device asks for, "low" for less.
    channels : int
        Channels to open even if fewer are used, for sound servers that mix streams of another width.

    Notes
    -----
    The callback copies into a ring and does nothing else. Frames that came while the ring was full are counted and
    told as `lost`; where the device says that it lost some without saying how many, the block after them has
    `overflow`. The frames' times come from a line through the moments of delivery, so that they are even.
    """

    def __init__(
        self,
        device: str | int,
        rate: float,
        inputs: Sequence[int],
        full_scale: ArrayLike = 1.0,
        *,
        block: int = 1024,
        buffer: float = 4.0,
        latency: float | Literal["low", "high"] = "high",
        channels: int = 0,
    ) -> None:
        if not inputs or min(inputs) < 1 or len(set(inputs)) < len(inputs):
            raise ConfigError(f"audio inputs {list(inputs)} must be different numbers from 1 on")
        self.device, self._rate, self.inputs = device, float(rate), tuple(inputs)
        self._full = np.broadcast_to(np.asarray(full_scale, float), (len(self.inputs),)).copy()
        self._columns = np.array(self.inputs) - 1
        self._opened = max(channels, *self.inputs)
        self._block, self._buffer, self._latency = int(block), float(buffer), latency
        self._stream: Any = None
        self._ready = threading.Event()
        self.name = str(device)
        self.clock = Clock(self._rate)
        self._reset()

    def _reset(self) -> None:
        frames = max(round(self._buffer * self._rate), 4 * self._block)
        self._ring = Ring(frames, self._opened)
        self.clock = Clock(self._rate)
        self._counted = 0
        self._epoch = time.time() - time.perf_counter()
        self._failure: BaseException | None = None
        self._told: list[str] = []
        self._running = False

    @property
    def n_channels(self) -> int:
        """Inputs in use."""
        return len(self.inputs)

    @property
    def rate(self) -> float:
        """Frames per second as promised; `clock` knows what is delivered."""
        return self._rate

    @property
    def full_scale(self) -> NDArray[np.float64]:
        """Volts at the end of each range."""
        return self._full

    @property
    def notes(self) -> tuple[str, ...]:
        """What was noticed in this run: overflows, and a clock that drifts against this computer's."""
        return (*self._told, *drift_note(self.name, self.clock))

    def frame_at(self, moment: float, timeout: float = 3.0) -> int:
        """The frame that is digitised at a moment of `time.perf_counter`; waits until somebody has read a block."""
        until = time.monotonic() + timeout
        while math.isnan(self.clock.time_of(0)):
            if time.monotonic() > until:
                raise DeviceTimeoutError(f"audio device {self.name!r}: nobody read a block within {timeout:g} s")
            time.sleep(0.01)
        return self.clock.frame_at(moment)

    def open(self) -> None:
        """Claim the device: its name, its channels and its rate are checked."""
        sd = portaudio()
        if self._stream is not None:
            return
        number = checked(self.device, "input", self._opened, self._rate)
        self.name = sd.query_devices(number)["name"]
        try:
            self._stream = sd.InputStream(
                samplerate=self._rate,
                device=number,
                channels=self._opened,
                dtype="float32",
                latency=self._latency,
                callback=self._callback,
                finished_callback=self._ready.set,
            )
        except sd.PortAudioError as error:
            raise ProtocolError(f"audio device {self.name!r} cannot be opened: {_words(error)}") from error
        claimed(self)
        if abs(self._stream.samplerate / self._rate - 1) > 1e-4:
            got = self._stream.samplerate
            self.close()
            raise ProtocolError(f"audio device {self.name!r} runs at {got:g} Hz, not at {self._rate:g} Hz")

    def start(self) -> None:
        """Begin a run."""
        if self._stream is None:
            raise DriverError(f"audio device {self.name!r} is not open")
        self.stop()
        self._reset()
        self._ready.clear()
        self._running = True
        self._do(self._stream.start)

    def read(self, timeout: float = 5.0) -> Block:
        """The next block."""
        if not self._running:
            raise DriverError(f"audio device {self.name!r} is not running: start it first")
        until = time.monotonic() + timeout
        while True:
            self._ready.clear()
            alive = bool(self._stream.active)
            self._listen()
            piece = self._ring.take(self._block, rest=not alive)
            if piece is not None:
                return self._as_block(piece)
            if not alive:
                why = f" ({self._failure})" if self._failure else ""
                raise DeviceLostError(f"audio device {self.name!r} went away while it was recording{why}")
            left = until - time.monotonic()
            if left <= 0:
                raise DeviceTimeoutError(f"audio device {self.name!r} delivered nothing for {timeout:g} s")
            self._ready.wait(min(left, 0.25))

    def stop(self) -> None:
        """End the run."""
        if self._stream is not None and self._running:
            self._running = False
            self._do(self._stream.abort)

    def close(self) -> None:
        """Let the device go."""
        if self._stream is not None:
            stream, self._stream = self._stream, None
            stream.close(ignore_errors=True)
            released(self)

    def _callback(self, data: NDArray[np.float32], frames: int, timing: Any, status: Any) -> None:
        try:
            # zeros that were put in for missing input are no measurement either
            broken = bool(status.input_overflow or status.input_underflow)
            self._ring.put(data, time.perf_counter(), 0, broken)
        except BaseException as error:
            self._failure = error
            raise
        self._ready.set()

    def _do(self, action: Any) -> None:
        try:
            action()
        except portaudio().PortAudioError as error:
            raise DeviceLostError(f"audio device {self.name!r} does not obey: {_words(error)}") from error

    def _listen(self) -> None:
        """Learn from the deliveries since the last time: the clock, and what is to be told."""
        for mark in self._ring.marks():
            self._count(mark)
        if self.clock.is_wrong(1e6 * WRONG):
            raise ProtocolError(
                f"audio device {self.name!r} delivers {self.clock.rate:.0f} frames per second,"
                f" not {self._rate:g}: set the rate that it really has, or leave the computer less to do besides"
            )

    def _count(self, mark: Mark) -> None:
        self._counted += mark.lost + mark.frames
        if mark.broken:
            self.clock.restart()
            self._told.append(f"{self.name}: an overflow after {self._counted / self._rate:.1f} s; frames are missing")
        if mark.lost:
            self._told.append(f"{self.name}: {mark.lost} frames were not fetched in time and are lost")
        self.clock.add(self._counted, mark.time)

    def _as_block(self, piece: Piece) -> Block:
        share = piece.data[:, self._columns].T
        return Block(
            np.asarray(share, np.float64) * self._full[:, None],
            piece.start,
            self._epoch + self.clock.time_of(piece.start),
            piece.lost,
            piece.broken,
            np.abs(share).max(axis=1) >= CLIPPED,
        )
