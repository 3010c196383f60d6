"""A structure at the far end of a sound card: a process that hears the drive and plays what the sensors answer."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Literal, Self, final

import numpy as np
from numpy.typing import NDArray

from drivers.audio import AudioDigitiser, find_device, portaudio
from drivers.simulated.bench import SimulatedBench
from drivers.simulated.filters import HALF, Interpolator
from drivers.simulated.inputs import Input
from drivers.simulated.plant import Drive, plant
from drivers.simulated.sources import FunctionWave, Operator, Source
from labnnum.errors import DeviceLostError, DriverError
from labnnum.structures.base import Structure

AHEAD = 4 * HALF
"""Frames by which a heard signal is late, so that it can be interpolated."""


@dataclass(frozen=True)
class AudioPlant:
    """What stands at the far end.

    Parameters
    ----------
    structure : Structure
        At its nominal parameters.
    inputs : sequence of Input
        Sensors, in the order of the sound card's channels; volts over their full scale are played.
    drive : Drive
    rate : int
    exciter : {"audio", "hammer", "33120A"}
        What drives: the first channel heard; somebody with a hammer; or a function generator at a serial line.
    drive_volts : float
        Volts that the largest number heard stands for.
    hammer : mapping
        Of `Operator`.
    channels : int
        Of the sound card.
    latency, reserve : float
        s that PortAudio gathers ahead, and s that wait besides: sound servers change their own delays while they run.
    """

    structure: Structure
    inputs: tuple[Input, ...]
    drive: Drive
    rate: int
    exciter: Literal["audio", "hammer", "33120A"] = "audio"
    drive_volts: float = 1.0
    hammer: Mapping[str, Any] = field(default_factory=dict)
    channels: int = 4
    block: int = 256
    oversample: int = 4
    latency: float = 0.25
    reserve: float = 0.4
    seed: int = 0


@final
class Heard(Source):
    """A signal that comes in piece after piece from elsewhere, band-limited between its samples."""

    def __init__(self) -> None:
        self._interpolator: Interpolator | None = None
        self.restart()

    def restart(self) -> None:
        """Silence."""
        self._samples = np.zeros(AHEAD + HALF)
        self._first = -HALF

    def feed(self, samples: NDArray) -> None:
        """What comes next."""
        self._samples = np.concatenate([self._samples, samples])

    def render(self, first: int, frames: int, oversample: int, rate: float) -> NDArray[np.float64]:
        """Volts."""
        if self._interpolator is None:
            self._interpolator = Interpolator(oversample)
        at = first - HALF + 1 - self._first
        part = self._samples[at : at + frames + 2 * HALF - 1]
        self._samples, self._first = self._samples[at:], self._first + at
        return self._interpolator.run(part)


@final
class PlantProcess:
    """Runs an `AudioPlant` in a process of its own; its context ends it.

    Parameters
    ----------
    plant : AudioPlant
    environment : mapping
        Variables that choose the sinks.

    Attributes
    ----------
    port : str
        Serial line of the function generator.
    missing : int
        Once it has ended: frames that it could not play in time, silence in their place.
    """

    def __init__(self, plant: AudioPlant, environment: Mapping[str, str]) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_run, args=(plant, dict(environment), theirs), daemon=True)
        self.port = ""
        self.missing = 0

    def __enter__(self) -> Self:
        self._process.start()
        if not self._pipe.poll(60.0):
            self._process.terminate()
            raise DeviceLostError("the plant's process did not start")
        answer = self._pipe.recv()
        if isinstance(answer, Exception):
            raise answer
        self.port = answer
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.missing = self._finish()
        self._pipe.close()
        self._process.join(5.0)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()

    def _finish(self) -> int:
        try:
            self._pipe.send("end")
            return self._pipe.recv() if self._pipe.poll(10.0) else -1
        except (EOFError, OSError):
            return -1


def _run(spec: AudioPlant, environment: Mapping[str, str], pipe: Connection) -> None:
    os.environ.update(environment)
    try:
        loop = _Loop(spec)
        loop.start()
    except Exception as error:
        pipe.send(error)
        return
    pipe.send(loop.port)
    while loop.step() and not _ended(pipe):
        pass
    loop.stop()
    pipe.send(loop.missing)


def _ended(pipe: Connection) -> bool:
    try:
        return pipe.poll() and pipe.recv() == "end"
    except EOFError:
        return True


class _Loop:
    """Hear, simulate, play."""

    def __init__(self, spec: AudioPlant) -> None:
        self.spec, self.port = spec, ""
        self._heard, self._wave = Heard(), FunctionWave(spec.seed)
        self._digitiser: AudioDigitiser | None = None
        source: Source = self._heard
        if spec.exciter == "hammer":
            source = Operator(**spec.hammer, seed=spec.seed)
        elif spec.exciter == "33120A":
            source = self._wave
            self._plug()
        else:
            volts = spec.drive_volts
            self._digitiser = AudioDigitiser(
                "pulse",
                spec.rate,
                [1],
                volts,
                block=spec.block,
                latency=spec.latency / 2,
                channels=spec.channels,
            )
        system = plant(spec.structure, spec.structure.nominal, spec.inputs, [spec.drive])
        self._bench = SimulatedBench(
            system, spec.inputs, [source], spec.rate, block=spec.block, oversample=spec.oversample, seed=spec.seed
        )
        self._ready: deque[NDArray[np.float32]] = deque()
        self._fetched = threading.Event()
        self._due = self.missing = 0
        self._rest = np.zeros((0, len(spec.inputs)), np.float32)

    def _plug(self) -> None:
        from drivers.generators.pseudo_terminal import PseudoTerminal
        from drivers.generators.simulated import SimulatedScpi

        self._instrument = SimulatedScpi()
        self._line = PseudoTerminal(self._instrument)
        self.port = self._line.port

    def start(self) -> None:
        """Begin with silence as long as latency and reserve."""
        spec = self.spec
        self._bench.start()
        self._heard.feed(np.zeros(spec.block))
        self._bench.read()  # compiles what the simulation needs
        self._bench.start()
        blocks = -(-round((spec.latency + spec.reserve) * spec.rate) // spec.block)
        self._ready.extend([np.zeros((spec.block, len(spec.inputs)), np.float32)] * blocks)
        self._stream = portaudio().OutputStream(
            samplerate=spec.rate,
            device=find_device("pulse", "output"),
            channels=spec.channels,
            dtype="float32",
            latency=spec.latency,
            callback=self._callback,
        )
        if self._digitiser is not None:
            self._digitiser.open()
            self._digitiser.start()
        self._stream.start()

    def step(self) -> bool:
        """One block more, as soon as it is heard or wanted; False when the sound server has gone."""
        spec = self.spec
        if self._digitiser is not None:
            if not self._hear(self._digitiser):
                return False
        elif len(self._ready) * spec.block < spec.latency * spec.rate:
            self._follow()
            self._answer()
        else:
            self._fetched.clear()
            self._fetched.wait(0.05)
        return bool(self._stream.active)

    def _hear(self, digitiser: AudioDigitiser) -> bool:
        """Feed what is heard, silence for what was lost; False when there is nothing to hear any more."""
        try:
            block = digitiser.read(5.0)
        except DriverError:
            return False
        self._heard.feed(np.concatenate([np.zeros(block.lost), block.data[0]]))
        self._due += block.lost + block.n_frames
        while self._due >= self.spec.block:
            self._due -= self.spec.block
            self._answer()
        return True

    def _answer(self) -> None:
        volts = self._bench.read().data
        scale = np.array([i.full_scale for i in self.spec.inputs])
        self._ready.append((volts / scale[:, None]).T.astype(np.float32))

    def _follow(self) -> None:
        """Let the wave be what the instrument is set to."""
        if self.port:
            now = self._instrument.settings
            self._wave.frequency, self._wave.amplitude = now.frequency, now.amplitude
            self._wave.on, self._wave.offset = now.output, now.offset

    def _callback(self, out: NDArray[np.float32], frames: int, timing: Any, status: Any) -> None:
        out[:] = 0
        done = 0
        while done < frames:
            if not len(self._rest):
                if not self._ready:
                    self.missing += frames - done
                    break
                self._rest = self._ready.popleft()
            n = min(frames - done, len(self._rest))
            out[done : done + n, : self._rest.shape[1]] = self._rest[:n]
            self._rest = self._rest[n:]
            done += n
        self._fetched.set()

    def stop(self) -> None:
        """End."""
        self._stream.abort(ignore_errors=True)
        self._stream.close(ignore_errors=True)
        if self._digitiser is not None:
            self._digitiser.close()
