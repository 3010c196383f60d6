"""Inputs of the simulated digitiser, with the sensors on them and everything that real ones do to a signal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.filters import highpass
from labnnum.errors import ChannelError
from labnnum.recording import Channel


@dataclass(frozen=True)
class Input:
    """One simulated input: its sensor, its amplifier and its converter.

    Parameters
    ----------
    channel : Channel
        What and where; `sensitivity` in volts per SI unit (1 if None).
    gain : float
        True over stated sensitivity.
    noise : float
        Of the sensor, RMS in SI units over the band to half the rate.
    cross : mapping of direction to fraction
        What the sensor takes of the motion across its axis.
    mass : float
        Of the sensor, in kg, carried by its node in every direction that moves.
    full_scale : float
        Volts at the end of the range.
    bits : int
        Of the converter; 0 is without steps.
    input_noise : float
        Of the amplifier, RMS volts.
    highpass : float
        Corner of the input's AC coupling, in Hz; 0 is DC coupled.
    delay : float
        s by which the channel comes later than the others.
    factor : callable or None
        Any further transfer function of the channel: frequencies in Hz, shape (n_f,) -> complex, shape (n_f,).
    """

    channel: Channel
    gain: float = 1.0
    noise: float = 0.0
    cross: Mapping[str, float] = field(default_factory=dict)
    mass: float = 0.0
    full_scale: float = 10.0
    bits: int = 24
    input_noise: float = 0.0
    highpass: float = 0.0
    delay: float = 0.0
    factor: Callable[[NDArray], NDArray] | None = None

    def __post_init__(self) -> None:
        for name in ("noise", "mass", "input_noise", "highpass", "delay"):
            if not getattr(self, name) >= 0:
                raise ChannelError(f"channel {self.channel.name!r}: {name} must not be negative")
        if not self.full_scale > 0 or not 0 <= self.bits <= 32:
            raise ChannelError(f"channel {self.channel.name!r}: needs full_scale > 0 and bits in 0 ... 32")

    @property
    def volts_per_unit(self) -> float:
        """What the sensor really gives."""
        return self.gain * (1.0 if self.channel.sensitivity is None else self.channel.sensitivity)


class Chain:
    """From physical signals to volts: sensitivity, noise, high-pass, steps and rails. Streaming, seeded."""

    def __init__(self, inputs: Sequence[Input], step: float, seed: int) -> None:
        self.inputs = tuple(inputs)
        self._pole = 2 * np.pi * step * np.array([i.highpass for i in inputs])
        self._scale = np.array([[i.volts_per_unit] for i in inputs])
        self._sensor = np.array([i.noise * i.volts_per_unit for i in inputs])
        self._amplifier = np.array([i.input_noise for i in inputs])
        self.full_scale = np.array([i.full_scale for i in inputs])
        bits = np.array([i.bits for i in inputs])
        self._lsb = np.where(bits > 0, 2 * self.full_scale / 2.0**bits, 0.0)
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """Back to rest, with the noise from its beginning."""
        streams = np.random.SeedSequence(self._seed).spawn(len(self.inputs))
        self._random = [np.random.Generator(np.random.PCG64(s)) for s in streams]
        self._state = np.zeros((2, len(self.inputs)))

    def coupled(self, fine: NDArray) -> NDArray[np.float64]:
        """Physical fine samples after the inputs' high-pass, in place."""
        if self._pole.any():
            highpass(fine, self._pole, self._state)
        return fine

    def convert(self, physical: NDArray) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Volts, and which channels met the end of their range."""
        volts = physical * self._scale
        sigma = np.hypot(self._sensor, self._amplifier)
        for row, s, random in zip(volts, sigma, self._random, strict=True):
            if s > 0:
                row += s * random.standard_normal(row.size)
        for row, lsb in zip(volts, self._lsb, strict=True):
            if lsb > 0:
                np.round(row / lsb, out=row)
                row *= lsb
        top = (self.full_scale - self._lsb)[:, None]
        bottom = -self.full_scale[:, None]
        over = np.any((volts >= top) | (volts <= bottom), axis=1)
        np.clip(volts, bottom, top, out=volts)
        return volts, np.asarray(over)
