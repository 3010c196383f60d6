"""Shaker: a level is reached through the measured channel, held, and recorded; noise, periods and stepped sines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError, EstimationError, SafetyError
from labnnum.estimators import Welch, h1
from labnnum.excitation import Drive, stepped_sine
from labnnum.frf import Frf
from labnnum.sine import tone
from sessions.desk import Desk
from sessions.items import control, waveform
from sessions.recorder import Stored
from sessions.snapshot import Curves, curves

STEP = 3.0
"""The generator is never raised by more than this factor at a time."""

TRIES = 14
"""Changes of the generator's level after which a level counts as out of reach."""

LATENCY = 0.15
"""s that are waited after each change besides the ramp: devices answer late."""

HEARD = 3.0
"""Standard errors that a tone at full volts must stand above, or its channel hears nothing of it."""

Blocks = Iterator[tuple[Stored, NDArray[np.float64]]]


class _Excited(ABC):
    """What runs with a generator share: waiting, measuring the controlled channel, lowering the level."""

    def __init__(self, desk: Desk) -> None:
        if desk.exciter is None:
            raise ConfigError(f"{desk.rig.path}: generator: excitation {desk.rig.toml.excitation.kind!r} needs one")
        self.desk, self.exciter = desk, desk.exciter
        self.excitation = desk.rig.toml.excitation
        channel = control(desk.rig)
        self.row, self.unit = desk.rig.index(channel.name), channel.unit
        self.target = desk.item.level
        self.stream: Blocks = desk.blocks()
        desk.status.target, desk.status.level_unit = self.target, self.unit

    def measure(self) -> None:
        """Measure one level, and leave the generator off; until then the person's "stop" silences it at once."""
        with self.desk.exciting():
            self._measure()

    @abstractmethod
    def _measure(self) -> None:
        """Reach the level, record what counts, lower the generator."""

    @property
    def rate(self) -> float:
        """Samples per second."""
        return self.desk.rig.rate

    def wait(self, samples: int) -> bool:
        """Let `samples` more be recorded, and keep them at hand; whether no gap lies among them."""
        self.desk.tail.keep(samples)
        begin = self.desk.position
        whole = True
        while self.desk.position < begin + samples:
            one = next(self.stream, None)
            if one is None:
                raise EstimationError(f"{self.desk.item.key}: the device ended before the run was complete")
            whole &= not one[0].broken or one[0].at <= begin
        return whole

    def wait_whole(self, samples: int) -> int:
        """Let samples be recorded until so many lie behind one another without a gap; their first.

        Raises
        ------
        EstimationError
            If none of many stretches is whole; output switched off.
        """
        for _ in range(TRIES):
            start = self.desk.position
            if self.wait(samples):
                return start
        self.desk.off()
        raise EstimationError(
            f"{self.desk.item.key}: the device lost frames in each of {TRIES} stretches of {samples / self.rate:.3g} s:"
            " raise device.block or device.buffer, or lower device.rate. Output switched off"
        )

    def volts(self, rms: float, ramp: float = 0.0) -> None:
        """Set the generator, and note it; not after the guard or the person has switched it off."""
        if self._silenced:
            return
        self.exciter.set_volts(rms, ramp)
        self.desk.status.volts = rms

    def tone(self, frequency: float) -> None:
        """Go on as a sine; not after the guard or the person has switched off."""
        if not self._silenced:
            self.exciter.tone(frequency)

    @property
    def _silenced(self) -> bool:
        return self.desk.guard.tripped or self.desk.halted

    def lower(self) -> None:
        """Ramp down, then off."""
        ramp = self.desk.rig.toml.safety.ramp
        self.volts(0.0, ramp)
        self.wait(round((ramp + LATENCY) * self.rate))
        self.exciter.off()

    def first_volts(self) -> float:
        """Where raising begins: half of what the stated gain asks for, or the generator's start."""
        g = self.desk.rig.toml.generator
        start = g.start_volts if g else 0.01
        return max(start, 0.5 * self.target / g.gain) if g and g.gain else start


@final
class ShakerRun(_Excited):
    """Measures one level and realisation of noise, bursts, periodic signals or chirps."""

    def _measure(self) -> None:
        """Reach the level, hold it, record the whole stretch, and lower the generator."""
        drive = waveform(self.excitation, self.rate, self.desk.item.realisation)
        begin = self.exciter.arm(drive.samples, repeat=True)
        if begin is None and drive.kind == "burst random" and not self._silenced:
            self.desk.off()
            raise ConfigError("burst random needs a generator in step with the digitiser, such as its own output")
        self.desk.status.state = f"raising to {self.target:g} {self.unit} RMS"
        reached = self._reach(drive)
        self._record(drive, begin, reached)
        self.lower()

    def _window(self, drive: Drive) -> int:
        """Samples over which the level is measured: whole periods, or noise enough for the tolerance."""
        if drive.period:
            return drive.period * max(1, round(self.excitation.settle * self.rate / drive.period))
        e = self.excitation
        width = (e.high or 0.4 * self.rate) - e.low
        seconds = max(e.settle, 2.25 / (width * e.tolerance**2))
        bursts = e.period if drive.kind == "burst random" else 1
        return -(-round(seconds * self.rate) // bursts) * bursts

    def _rms(self, window: int) -> float:
        self.wait(window)
        x = self.desk.tail.latest(window)[self.row]
        return float(np.std(x))

    def _reach(self, drive: Drive) -> float:
        """Raise the generator until the controlled channel has its level; the RMS at the end."""
        ramp, window = self.desk.rig.toml.safety.ramp, self._window(drive)
        idle = self._rms(window)
        volts = self.first_volts()
        for _ in range(TRIES):
            self.volts(volts, ramp)
            self.wait(round((ramp + LATENCY + self.excitation.settle) * self.rate))
            seen = self._rms(window)
            own = float(np.sqrt(max(seen**2 - idle**2, 0.0)))
            self.desk.status.level = own
            if abs(own / self.target - 1) <= self.excitation.tolerance:
                return own
            heard = own > 0.5 * idle and own > 0
            volts *= float(np.clip(self.target / own, 1 / STEP, STEP)) if heard else STEP
        self.desk.off()
        name = self.desk.rig.channels[self.row].name
        raise SafetyError(
            f"{self.desk.item.key}: channel {name!r} shows {self.desk.status.level:.3g} {self.unit} RMS and does not"
            f" settle at {self.target:g}: is the amplifier on, and the structure linear enough? Output switched off"
        )

    def _record(self, drive: Drive, begin: int | None, reached: float) -> None:
        e, desk = self.excitation, self.desk
        frames = (e.periods + e.drop_periods) * drive.period if drive.period else round(e.duration * self.rate)
        if drive.kind == "burst random" and begin is not None:
            frames = -(-frames // e.period) * e.period
            self._align(begin, e.period)
        start = desk.position
        welch, accumulator = self._live(drive), None
        if welch is not None:
            accumulator = welch.start(desk.item.channels, self.rate)
        desk.status.state = f"recording at {reached:.3g} {self.unit} RMS"
        desk.status.curves = lambda: _running(accumulator)
        while desk.position < start + frames:
            one = next(self.stream, None)
            if one is None:
                raise EstimationError(f"{desk.item.key}: the device ended before the run was complete")
            if accumulator is not None:
                if one[0].broken:
                    accumulator.gap()
                accumulator.add(one[1])
            desk.done(min(desk.position - start, frames), frames)
        self._keep(start, start + frames)

    def _keep(self, start: int, stop: int) -> None:
        """Store which stretch counts, and how well the level was held over it."""
        desk = self.desk
        held = float(np.std(desk.run.read(start, stop)[self.row]))
        off = held / self.target - 1
        reason = f"level held at {held:.4g} {self.unit} RMS ({off:+.1%})"
        if abs(off) > 2 * self.excitation.tolerance:
            desk.say(f"{reason}, asked were {self.target:g}")
        info = {"level": held, "volts": desk.status.volts}
        desk.run.add_hit(start, stop, True, reason, info=info)

    def _align(self, begin: int, period: int) -> None:
        """Wait for the beginning of a burst."""
        offset = (begin - self.desk.position - self.desk.recorder.lost) % period
        self._exact(offset)

    def _exact(self, samples: int) -> None:
        """A stretch may begin inside a block: position is moved to `samples` from here once they are recorded."""
        goal = self.desk.position + samples
        self.wait(samples)
        self.desk.position = goal

    def _live(self, drive: Drive) -> Welch | None:
        p = self.desk.rig.toml.processing
        if drive.period:
            return Welch(drive.period, "boxcar", 0.0)
        if drive.kind == "burst random":
            return Welch(self.excitation.period, "boxcar", 0.0)
        return Welch(p.segment, p.window, p.overlap)


def _running(accumulator) -> Curves | None:
    if accumulator is None or accumulator.n_segments < 1:
        return None
    return curves(h1(accumulator.spectra()))


@final
class SteppedRun(_Excited):
    """Measures one level by tones, one after the other, up and down."""

    def _measure(self) -> None:
        """Step through the plan; each tone is a stretch of the run with its frequency."""
        e = self.excitation
        high = e.high or 0.4 * self.rate
        law = "log" if e.spacing == "log" else "linear"
        plan = stepped_sine(self.rate, (e.low, high), e.lines, law=law, settle=e.settle, cycles=e.cycles)
        tones = [(f, d) for d in e.directions for f in (plan.frequency if d == "up" else plan.frequency[::-1])]
        volts, seen = self.first_volts(), []
        self.desk.status.curves = lambda: _points(seen, self.desk)
        for number, (frequency, direction) in enumerate(tones):
            self.desk.status.state = f"{frequency:.4g} Hz, {direction}"
            self.tone(float(frequency))
            volts, off = self._hold(float(frequency), volts)
            seen.append((float(frequency), self._keep(float(frequency), direction, off)))
            self.desk.done(number + 1, len(tones))
        self.lower()

    def _cycles(self, frequency: float, cycles: float) -> int:
        return max(round(cycles * self.rate / frequency), 8)

    def _level(self, frequency: float) -> tuple[float, float]:
        """RMS of the tone in the controlled channel, and its standard error."""
        n = self._cycles(frequency, max(4, self.excitation.cycles // 4))
        start = self.wait_whole(n)
        amplitude, variance = tone(self.desk.tail.cut(start, start + n)[[self.row]], self.rate, frequency)
        return float(np.abs(amplitude[0]) / np.sqrt(2)), float(np.sqrt(variance[0] / 2))

    def _hold(self, frequency: float, volts: float) -> tuple[float, float]:
        """Bring the tone to its level; the volts and the relative error that is left."""
        most = self.exciter.max_volts / np.sqrt(2)
        off = np.inf
        for _ in range(TRIES):
            volts = min(volts, most)
            self.volts(volts)
            self.wait(round((LATENCY + self.excitation.settle) * self.rate))
            own, error = self._level(frequency)
            self.desk.status.level = own
            if volts >= most and not own > HEARD * error and not self._silenced:
                self._deaf(frequency, own)
            off = own / self.target - 1
            if abs(off) <= self.excitation.tolerance or (off < 0 and volts >= most):
                break
            volts *= float(np.clip(self.target / own, 1 / STEP, STEP)) if own > 0 else STEP
        return volts, off

    def _deaf(self, frequency: float, own: float) -> None:
        """SafetyError: the loudest tone is not heard; output switched off."""
        self.desk.off()
        name, volts = self.desk.rig.channels[self.row].name, self.desk.status.volts
        raise SafetyError(
            f"{self.desk.item.key}: channel {name!r} hears nothing of {frequency:.4g} Hz at {volts:.3g} V RMS, the most"
            f" that generator.max_volts allows ({own:.3g} {self.unit} RMS): is the amplifier on, and the sensor"
            " connected? Output switched off"
        )

    def _keep(self, frequency: float, direction: str, off: float) -> NDArray[np.complex128]:
        n = self._cycles(frequency, self.excitation.cycles)
        start = self.wait_whole(n)
        held = abs(off) <= self.excitation.tolerance
        reason = f"level held ({off:+.1%})" if held else f"level not reached ({off:+.1%})"
        if not held:
            self.desk.say(f"{frequency:.4g} Hz: {reason}")
        info = {"frequency": frequency, "direction": direction, "volts": self.desk.status.volts, "off": off}
        self.desk.run.add_hit(start, start + n, True, reason, info=info)
        return tone(self.desk.tail.cut(start, start + n), self.rate, frequency)[0]


def _points(seen: list[tuple[float, NDArray]], desk: Desk) -> Curves | None:
    channels = desk.item.channels
    inputs = [i for i, c in enumerate(channels) if c.role in ("reference", "base")]
    outputs = [i for i, c in enumerate(channels) if c.role == "response"]
    lines: dict[float, NDArray] = dict(seen)  # the last pass over a line is shown
    if not lines or not inputs or not outputs:
        return None
    f = np.array(sorted(lines))
    a = np.array([lines[k] for k in f])
    value = np.asarray(a[:, outputs] / a[:, [inputs[0]]], np.complex128).T[:, None]
    return curves(Frf(f, value, tuple(channels[i] for i in outputs), (channels[inputs[0]],)))
