"""The audio interface's own output as a generator: it shares the clock of its inputs, so periods stay whole."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.audio import checked, claimed, portaudio, released
from drivers.clock import Clock, certain, drift_between
from drivers.exciter import Exciter
from labnnum.errors import ConfigError, DeviceLostError, DeviceTimeoutError, DriverError, ProtocolError

PATIENCE = 3.0
"""s that the device may take until it fetches the first samples of something new."""
PRIMING = 0.05
"""s in which the device fills what it gathers ahead."""


@dataclass(frozen=True, eq=False)
class Wave:
    """Samples to play once or round and round."""

    samples: NDArray[np.float32]
    repeat: bool


@dataclass(frozen=True, eq=False)
class Tone:
    """A sine of unit RMS, in cycles per frame."""

    cycles: float


@dataclass(frozen=True, eq=False)
class Goal:
    """A level, in parts of the full scale, to be reached within so many frames."""

    level: float
    frames: int


@final
class Player:
    """Fills the output's buffers; told what to do by whole objects, so that the callback never waits for anybody.

    Examples
    --------
    >>> player, out = Player(), np.zeros((4, 2), np.float32)
    >>> player.play(Wave(np.array([1.0, -1.0], np.float32), repeat=True))
    >>> player.goal = Goal(0.5, 0)
    >>> player.render(out, 1)
    >>> out[:, 1].tolist()
    [0.5, -0.5, 0.5, -0.5]
    """

    def __init__(self) -> None:
        self.goal = Goal(0.0, 0)
        self.frame = 0
        self.begun = threading.Event()
        self.begin = 0
        self._score: Wave | Tone | None = None
        self._playing: Wave | Tone | None = None
        self._phase = 0.0
        self._reached, self._from, self._since = self.goal, 0.0, 0

    def play(self, score: Wave | Tone | None) -> None:
        """From the next buffer on; `begun` is set then, and `begin` says with which frame."""
        self.begun.clear()
        self._score = score

    def render(self, out: NDArray[np.float32], column: int) -> None:
        """Fill a buffer (n_frames, n_outputs). Called by the device alone."""
        n = len(out)
        out[:] = 0
        self._turn()
        gain = self._gains(n)
        if self._playing is not None:
            out[:, column] = self._signal(self._playing, n) * gain
        self.frame += n

    def _turn(self) -> None:
        """Take up a new score and a new level."""
        score, goal = self._score, self.goal
        if score is not self._playing:
            self._playing, self.begin = score, self.frame
            self.begun.set()
        if goal is not self._reached:
            self._from = float(self._gains(1)[0])
            self._reached, self._since = goal, self.frame

    def _gains(self, n: int) -> NDArray[np.float64]:
        goal = self._reached
        passed = self.frame - self._since + np.arange(n)
        share = np.clip(passed / goal.frames, 0, 1) if goal.frames else np.ones(n)
        return self._from + (goal.level - self._from) * share

    def _signal(self, score: Wave | Tone, n: int) -> NDArray[Any]:
        if isinstance(score, Tone):
            turns = self._phase + score.cycles * np.arange(n + 1)
            self._phase = float(turns[-1] % 1.0)
            return np.sqrt(2) * np.sin(2 * np.pi * turns[:-1])
        at = self.frame - self.begin + np.arange(n)
        size = score.samples.size
        if score.repeat:
            return score.samples[at % size]
        return np.where(at < size, score.samples[np.minimum(at, size - 1)], 0.0)


@final
class AudioOutput(Exciter):
    """One output of an audio interface.

    Parameters
    ----------
    device : str or int
        As for `AudioDigitiser`.
    rate : float
        Frames per second; that of the digitiser, and its clock if it is the same interface.
    output : int
        Output of the device, from 1.
    full_scale : float
        Volts at the output for the largest number that the device takes.
    max_volts : float
        Peak volts that it will not pass.
    latency : float or str
        s that the system may gather ahead: what it takes for a change to sound.
    channels : int
        Channels to open even if fewer are used; the others are silent.
    frame_at : callable, optional
        The digitiser's frame at a moment of `time.perf_counter`, where the two share a clock.
    other : callable, optional
        The digitiser's clock, where they do not: a drift between the two is noted.

    Notes
    -----
    `off` throws away what the system has gathered, so silence does not wait for the latency. When a frame sounds is
    told from when the device fetches: it does so as soon as there is room in what it gathers, so the earliest fetch of
    each second, the latency and one fetch added, is when its last frame sounds.
    """

    def __init__(
        self,
        device: str | int,
        rate: float,
        output: int = 1,
        full_scale: float = 1.0,
        max_volts: float = 1.0,
        *,
        latency: float | Literal["low", "high"] = "high",
        channels: int = 2,
        frame_at: Callable[[float], int] | None = None,
        other: Callable[[], Clock] | None = None,
    ) -> None:
        if output < 1:
            raise ConfigError(f"audio output {output} does not exist; the first is 1")
        self.device, self._rate, self.output, self._latency = device, float(rate), output, latency
        self._full, self._max, self._frame_at = full_scale, max_volts, frame_at
        self._other = other
        self._opened = max(channels, output)
        self._stream: Any = None
        self._player = Player()
        self._crest = 1.0
        self._ready = False
        self._lock = threading.RLock()
        self._gaps = self._fetch = 0
        self.clock = Clock(self._rate)
        self.name = str(device)
        self.volts = 0.0

    @property
    def max_volts(self) -> float:
        """Peak volts that it will not pass."""
        return min(self._max, self._full)

    @property
    def notes(self) -> tuple[str, ...]:
        """Gaps in what was played, and a clock that drifts against the digitiser's."""
        dry = (f"{self.name}: the output ran dry {self._gaps} times",) if self._gaps else ()
        return (*dry, *self._drift())

    def _drift(self) -> tuple[str, ...]:
        if self._other is None:
            return ()
        drift, error = drift_between(self.clock, self._other())
        if not certain(drift, error):
            return ()
        way = "fast" if drift > 0 else "slow"
        return (f"{self.name}: its clock runs {abs(drift):.0f} ± {error:.0f} ppm {way} against the digitiser's",)

    def open(self) -> None:
        """Claim the output: its name, its channels and its rate are checked; it is silent."""
        sd = portaudio()
        number = checked(self.device, "output", self._opened, self._rate)
        self.name = sd.query_devices(number)["name"]
        try:
            self._stream = sd.OutputStream(
                samplerate=self._rate,
                device=number,
                channels=self._opened,
                dtype="float32",
                latency=self._latency,
                callback=self._callback,
            )
        except sd.PortAudioError as error:
            raise ProtocolError(f"audio output {self.name!r} cannot be opened: {error.args[0]}") from error
        claimed(self)

    def __enter__(self) -> AudioOutput:
        self.open()
        return self

    def arm(self, samples: ArrayLike, repeat: bool) -> int | None:
        """Begin to play, at level 0; the digitiser's frame at which the first sample sounds, as well as is known."""
        wave = np.ascontiguousarray(samples, np.float32)
        if wave.ndim != 1 or not wave.size or not np.isfinite(wave).all():
            raise ConfigError(f"the waveform to play must be finite samples in a row, not of shape {wave.shape}")
        self._crest = float(np.abs(wave).max())
        self._begin(Wave(wave, repeat), Goal(0.0, 0))
        if self._frame_at is None or not self._ready:
            return None
        time.sleep(PRIMING)
        return self._frame_at(self.clock.time_of(self._player.begin) + self._stream.latency + self._fetch / self._rate)

    def tone(self, frequency: float) -> None:
        """A sine from now on, without a jump in its phase; its level stays as it is."""
        if not 0 < frequency < self._rate / 2:
            raise ConfigError(f"a tone of {frequency:g} Hz is not below half the rate, {self._rate / 2:g} Hz")
        self._crest = np.sqrt(2)
        self._begin(Tone(frequency / self._rate), Goal(0.0, 0) if not self._ready else None)

    def _begin(self, score: Wave | Tone, goal: Goal | None) -> None:
        with self._lock:
            if self._stream is None:
                raise DriverError(f"audio output {self.name!r} is not open")
            if goal is not None:
                self._player.goal, self.volts = goal, 0.0
            self._player.play(score)
            self._ready = True
            if not self._stream.active:
                self._start()
        if not self._player.begun.wait(PATIENCE):
            self.off()
            raise DeviceTimeoutError(f"audio output {self.name!r} fetched nothing for {PATIENCE:g} s")

    def _start(self) -> None:
        try:
            self.clock = Clock(self._rate)
            self._player.frame = 0
            self._stream.stop()
            self._stream.start()
        except portaudio().PortAudioError as error:
            self._ready = False
            raise DeviceLostError(f"audio output {self.name!r} does not start: {error.args[0]}") from error

    def set_volts(self, rms: float, ramp: float = 0.0) -> None:
        """Reach `rms` volts within `ramp` seconds from the next buffer on; returns at once."""
        if not self._ready:
            return
        self.require_within(rms, self._crest)
        with self._lock:
            if not self._ready:
                return
            if not self._stream.active:
                self._ready = False
                raise DeviceLostError(f"audio output {self.name!r} went away while it was playing")
            self._player.goal = Goal(rms / self._full, round(ramp * self._rate))
            self.volts = rms

    def off(self) -> None:
        """Silence at once, what the system had gathered thrown away."""
        self._ready = False
        self._player.goal = Goal(0.0, 0)
        with self._lock:
            self._ready, self.volts = False, 0.0
            self._player.goal = Goal(0.0, 0)
            self._player.play(None)
            self._player.begun.set()  # whoever waits for a beginning need not wait any longer
            if self._stream is not None:
                self._stream.abort(ignore_errors=True)

    def close(self) -> None:
        """Off, and let the device go."""
        self.off()
        with self._lock:
            if self._stream is not None:
                stream, self._stream = self._stream, None
                stream.close(ignore_errors=True)
                released(self)

    def _callback(self, out: NDArray[np.float32], frames: int, timing: Any, status: Any) -> None:
        if status.output_underflow:
            self._gaps += 1
            self.clock.restart()
        self._fetch = frames
        self._player.render(out, self.output - 1)
        self.clock.add(self._player.frame, time.perf_counter())
