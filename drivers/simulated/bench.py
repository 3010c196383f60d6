"""The simulated bench as a digitiser: a plant, what plays into it, and converters with the faults of real ones."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from drivers.block import Block
from drivers.clock import Clock, drift_note
from drivers.digitiser import Digitiser
from drivers.simulated.filters import HALF, Decimator, Shaper
from drivers.simulated.inputs import Chain, Input
from drivers.simulated.sources import Source
from labnnum.errors import ChannelError, DeviceLostError, DeviceTimeoutError, DriverError
from labnnum.nonlinear import Element, NonlinearSimulation
from labnnum.simulation import Simulation
from labnnum.system import System


@dataclass(frozen=True)
class Faults:
    """What goes wrong with the simulated device.

    Parameters
    ----------
    drift_ppm : float
        Error of the device's clock: its true rate is that much higher than stated.
    dropouts : float
        Mean number of dropouts per s, at random moments.
    dropout_frames : int
        Frames that each one loses.
    silent : bool
        Dropouts are not reported: `lost` stays 0 and `overflow` is set instead, as some audio drivers do.
    vanish : float
        s after which the device is unplugged.
    """

    drift_ppm: float = 0.0
    dropouts: float = 0.0
    dropout_frames: int = 300
    silent: bool = False
    vanish: float = float("inf")


@final
class SimulatedBench(Digitiser):
    """A structure on a bench that does not exist, behind the interface of those that do.

    Parameters
    ----------
    plant : System
        From the sources to the sensors: see `drivers.simulated.plant.plant`.
    inputs : sequence of Input
        In the order of the plant's outputs.
    sources : sequence of Source
        In the order of the plant's inputs.
    rate : float
        Frames per s.
    block : int
        Frames a block.
    oversample : int
        Steps of the simulation a frame.
    seed : int
    faults : Faults
    real_time : bool
        Blocks come at the pace of the clock from a thread of their own and wait in a buffer that may overflow, as in
        a device. Otherwise each read computes its block at once, so that every run is the same.
    buffer : float
        s that the device's buffer holds.
    elements : sequence of Element
        Nonlinear forces that act on the structure besides.

    Examples
    --------
    >>> from labnnum.structures.chain import Chain, Link
    >>> from labnnum.recording import Channel
    >>> from drivers.simulated import Drive, Input, Player, plant
    >>> oscillator = Chain(masses={"1": 1.0}, links=(Link("1", "ground", 4e4, 4.0),))
    >>> force, tip = Channel("f", "force", "reference", "1", "x"), Channel("a", node="1", direction="x")
    >>> inputs = [Input(force), Input(tip, noise=0.01)]
    >>> player = Player()
    >>> bench = SimulatedBench(plant(oscillator, [], inputs, [Drive(force)]), inputs, [player], rate=500)
    >>> _ = player.play(np.random.default_rng(1).standard_normal(2000))
    >>> bench.start()
    >>> bench.read().data.shape
    (2, 1024)
    """

    def __init__(
        self,
        plant: System,
        inputs: Sequence[Input],
        sources: Sequence[Source],
        rate: float,
        *,
        block: int = 1024,
        oversample: int = 8,
        seed: int = 0,
        faults: Faults | None = None,
        real_time: bool = False,
        buffer: float = 2.0,
        elements: Sequence[Element] = (),
    ) -> None:
        if plant.n_outputs != len(inputs) or plant.n_inputs != len(sources):
            raise ChannelError(
                f"the plant has {plant.n_inputs} ways in and {plant.n_outputs} out, but there are"
                f" {len(sources)} sources and {len(inputs)} inputs"
            )
        self.inputs, self.sources = tuple(inputs), tuple(sources)
        self._rate, self._block, self._over = float(rate), int(block), int(oversample)
        self.faults = faults or Faults()
        self.true_rate = self._rate * (1 + 1e-6 * self.faults.drift_ppm)
        step = 1 / (self.true_rate * self._over)
        self._simulation = NonlinearSimulation(plant, elements, step) if elements else Simulation(plant, step)
        self._decimator = Decimator(self._over, np.array([i.delay * self._rate for i in inputs]))
        self._shaper = Shaper([i.factor for i in inputs], self.true_rate)
        self._chain = Chain(inputs, step, seed)
        self._seed = seed
        self._real_time, self._depth = real_time, max(2, int(buffer * rate / block))
        self._running = False
        self._clock = Clock(self._rate)
        self._pump: _Pump | None = None

    @property
    def n_channels(self) -> int:
        """Inputs."""
        return len(self.inputs)

    @property
    def rate(self) -> float:
        """Frames per s, as stated."""
        return self._rate

    @property
    def full_scale(self) -> NDArray[np.float64]:
        """Volts at the end of each range."""
        return self._chain.full_scale

    @property
    def paced(self) -> bool:
        """Only in real time."""
        return self._real_time

    @property
    def block(self) -> int:
        """Frames a block."""
        return self._block

    @property
    def notes(self) -> tuple[str, ...]:
        """A clock that drifts, as it is noticed with a real device: from when its frames came."""
        return drift_note("the simulated device", self._clock)

    @property
    def time(self) -> float:
        """How much of the run has been digitised, in s."""
        return self._frame / self.true_rate

    def open(self) -> None:
        """Nothing to claim."""
        return None

    def start(self) -> None:
        """Begin at rest; sources restart."""
        self.stop()
        self._simulation.reset()
        self._decimator.reset()
        self._shaper.reset()
        self._chain.reset()
        for source in self.sources:
            source.restart()
        self._frame = self._rendered = 0
        self._lost, self._overflow = 0, False
        self._clock = Clock(self._rate)
        self._ready = np.zeros((self.n_channels, 0))
        self._random = np.random.default_rng([self._seed, 1])
        self._running = True
        self._advance(HALF + self._shaper.latency - (-self._simulation.delay // self._over))
        self._began = time.time()
        if self._real_time:
            self._pump = _Pump(self._produce, self._block / self.true_rate, self._depth)

    def read(self, timeout: float = 5.0) -> Block:
        """The next block."""
        if not self._running:
            raise DriverError("the simulated bench is not running: start it first")
        return self._produce() if self._pump is None else self._pump.take(timeout)

    def stop(self) -> None:
        """End the run."""
        if self._pump is not None:
            self._pump.stop()
            self._pump = None
        self._running = False

    def _produce(self) -> Block:
        """The next block that the device delivers."""
        if self._drops():
            self._overflow = self.faults.silent
            self._lost += 0 if self.faults.silent else self.faults.dropout_frames
            self._skip(self.faults.dropout_frames)
        return self._digitise()

    def _drops(self) -> bool:
        return self.faults.dropouts > 0 and self._random.random() < self.faults.dropouts * self._block / self._rate

    def _skip(self, frames: int) -> None:
        """Let the structure go on while the device does not listen."""
        self._advance(frames)
        self._chain.convert(self._ready[:, :frames])
        self._ready = self._ready[:, frames:]
        self._frame += 0 if self.faults.silent else frames

    def _digitise(self) -> Block:
        if self._frame / self.true_rate >= self.faults.vanish:
            self._running = False
            raise DeviceLostError(f"the simulated device was unplugged after {self.faults.vanish:g} s")
        self._advance(self._block)
        volts, over = self._chain.convert(self._ready[:, : self._block])
        self._ready = self._ready[:, self._block :]
        out = Block(volts, self._frame, self._began + self.time, self._lost, self._overflow, over)
        self._frame += self._block
        if self._overflow:
            self._clock.restart()
        self._clock.add(self._frame, self.time)
        self._lost, self._overflow = 0, False
        return out

    def _advance(self, frames: int) -> None:
        """Let the sources play and the structure move for `frames`."""
        forces = [s.render(self._rendered, frames, self._over, self.true_rate) for s in self.sources]
        self._rendered += frames
        fine = self._chain.coupled(self._simulation.run(np.array(forces)))
        self._ready = np.hstack([self._ready, self._shaper.run(self._decimator.run(fine))])


class _Pump:
    """Takes blocks at the pace of the clock into a buffer; when nobody empties it, blocks are lost and counted.

    On a computer that cannot simulate as fast as time passes the device runs late, and its blocks' times say so.
    """

    def __init__(self, produce, period: float, depth: int) -> None:
        self._produce, self._period, self._depth = produce, period, depth
        self._queue: deque[Block] = deque()
        self._condition = threading.Condition()
        self._error: Exception | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="simulated-bench", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        due, lost = time.monotonic() + self._period, 0
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            due += self._period
            try:
                block = self._produce()
            except Exception as error:  # handed to the reader, whose call it fails
                with self._condition:
                    self._error = error
                    self._condition.notify()
                return
            late = time.monotonic() - due + self._period
            block = replace(block, time=block.time + max(late, 0.0))
            with self._condition:
                if len(self._queue) >= self._depth:
                    lost += block.n_frames + block.lost
                    continue
                if lost:
                    block = replace(block, lost=block.lost + lost, overflow=True)
                    lost = 0
                self._queue.append(block)
                self._condition.notify()

    def take(self, timeout: float) -> Block:
        """The oldest block."""
        with self._condition:
            self._condition.wait_for(lambda: self._queue or self._error, timeout)
            if self._queue:
                return self._queue.popleft()
            if self._error is not None:
                raise self._error
        raise DeviceTimeoutError(f"the simulated device gave no block within {timeout:g} s")

    def stop(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join()
