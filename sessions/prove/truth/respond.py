"""Exact linear response of the concealed truth: complex modes, low-rank added physics, and convolution in time.

A signal of finite length is answered exactly by the discrete Fourier transform if it is first multiplied by
exp(-sigma t): the transfer function is then taken at s = sigma + i omega and the answer multiplied back
(Kausel and Roesset, 1992). No time stepping, so no period error, and any law of frequency is allowed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Complex = NDArray[Any]
Law = Callable[[Complex], Complex]
WRAP = 16.0
"""Neper by which the echo of the periodic transform is pushed down."""


@dataclass(frozen=True, eq=False)
class Added:
    """Physics that is attached to a few rows of motion: force on the structure = -law(s) @ motion.

    Parameters
    ----------
    rows : ndarray, shape (r, n_active)
    law : callable
        s, shape (n_f,) -> dynamic stiffness, shape (n_f, r, r).
    inertial : bool
        True if it answers to absolute motion (a mass); False if to motion relative to the fixture or
        between points (a spring, a dashpot).
    """

    rows: NDArray[np.float64]
    law: Law
    inertial: bool = False


@dataclass(frozen=True, eq=False)
class Extra:
    """A mode that no bar has: residue vector over the outputs, natural frequency in rad/s, damping ratio."""

    residue: NDArray[np.float64]
    omega: float
    ratio: float


@dataclass(frozen=True, eq=False)
class Plant:
    """A linear structure in complex modes, with inputs, outputs and added physics.

    Parameters
    ----------
    square : ndarray, shape (n_modes,)
        Complex squared natural frequencies, rad^2/s^2.
    shape : ndarray, shape (n_active, n_modes)
        Modes with shape.T @ M @ shape = 1.
    viscous : ndarray, shape (n_modes,)
        Modal viscous damping 2 zeta omega, 1/s.
    outputs : ndarray, shape (n_out, n_active)
    load : ndarray, shape (n_active,)
        Load of a unit input (a force, or an acceleration of the base).
    carried : ndarray, shape (n_active,)
        Motion of the structure when it follows the base rigidly; zero under a force.
    carried_out : ndarray, shape (n_out,)
        The same at the outputs.
    orders : ndarray of int, shape (n_out,)
        Time derivatives that each output measures: 2 acceleration, 1 velocity, 0 displacement.
    """

    square: Complex
    shape: Complex
    viscous: NDArray[np.float64]
    outputs: NDArray[np.float64]
    load: NDArray[np.float64]
    carried: NDArray[np.float64]
    carried_out: NDArray[np.float64]
    orders: NDArray[np.int_]
    added: tuple[Added, ...] = ()
    extras: tuple[Extra, ...] = field(default=())

    @property
    def frequency(self) -> NDArray[np.float64]:
        """Natural frequencies without added physics, Hz, ascending."""
        return np.sqrt(np.maximum(np.real(self.square), 0)) / (2 * np.pi)


def complex_modes(M: NDArray, K: NDArray, D: NDArray) -> tuple[NDArray, NDArray]:
    """Squared natural frequencies and mass-normalised modes of (K + iD, M), sorted by frequency."""
    square, shape = (np.asarray(a) for a in scipy.linalg.eigh(K, M))
    if not np.any(D):
        return square.astype(complex), shape.astype(complex)
    reduced = np.diag(square) + 1j * (shape.T @ D @ shape)
    value, vector = np.linalg.eig(reduced)
    order = np.argsort(np.real(value))
    value, vector = value[order], vector[:, order]
    vector = vector / np.sqrt(np.sum(vector**2, axis=0))
    return value, shape @ vector


def transfer(plant: Plant, s: Complex) -> Complex:
    """Absolute motion that the outputs measure per unit input, at complex frequencies s, shape (n_out, n_f)."""
    rows = [a.rows for a in plant.added]
    watched = np.vstack([plant.outputs, *rows]) if rows else plant.outputs
    driven = np.vstack([plant.load[None, :], *rows]) if rows else plant.load[None, :]
    H = _receptance(plant, watched, driven, s)
    n_out = len(plant.outputs)
    motion = H[:, :n_out, 0]
    if rows:
        motion = motion - _reaction(plant, H, n_out, s)
    out = (s**2)[:, None] * motion + (plant.carried_out if np.any(plant.carried) else 0.0)
    for extra in plant.extras:
        out = out + (s**2 / (s**2 + 2 * extra.ratio * extra.omega * s + extra.omega**2))[:, None] * extra.residue
    return out.T * s ** (plant.orders[:, None] - 2)


def _reaction(plant: Plant, H: NDArray, n_out: int, s: NDArray) -> Complex:
    """Motion at the outputs that the added physics takes away, shape (n_f, n_out)."""
    size = sum(len(a.rows) for a in plant.added)
    law = np.zeros((s.size, size, size), complex)
    given = np.zeros((s.size, size), complex)
    at = 0
    for a in plant.added:
        stop = at + len(a.rows)
        law[:, at:stop, at:stop] = a.law(s)
        if a.inertial:
            given[:, at:stop] = (a.rows @ plant.carried) / (s**2)[:, None]
        at = stop
    inner = H[:, n_out:, 1:]
    free = H[:, n_out:, 0]
    matrix = np.eye(size) + inner @ law
    total = np.linalg.solve(matrix, (free + given)[..., None])
    return (H[:, :n_out, 1:] @ (law @ total))[..., 0]


def _receptance(plant: Plant, rows: NDArray, columns: NDArray, s: NDArray) -> Complex:
    """Receptance between rows and columns, shape (n_f, n_rows, n_columns); far modes by two terms of their series."""
    left, right = rows @ plant.shape, columns @ plant.shape
    pairs = (left[:, None, :] * right[None, :, :]).reshape(-1, plant.square.size)
    reach = 6 * np.max(np.abs(s))
    near = np.abs(plant.square) < reach**2
    far = ~near
    weight = 1.0 / (plant.square[near] + s[:, None] ** 2 + s[:, None] * plant.viscous[near])
    out = weight @ pairs[:, near].T
    flat = pairs[:, far] / plant.square[far]
    out += np.sum(flat, axis=1) - np.outer(s**2, np.sum(flat / plant.square[far], axis=1))
    return out.reshape(s.size, len(rows), len(columns))


def answer(plant: Plant, signal: NDArray, rate: float, band: tuple[float, float]) -> NDArray[np.float64]:
    """What every output measures, from rest, while the input is `signal`, shape (n_out, n_samples).

    Lines outside `band` (Hz) are not driven: the input must have nothing there that matters.
    """
    return answers(plant, [signal], rate, band)[0]


def answers(plant: Plant, signals: list[NDArray], rate: float, band: tuple[float, float]) -> list[NDArray[np.float64]]:
    """`answer` to several signals of one length, with the transfer function formed once."""
    n = signals[0].size
    padded = _good_length(2 * n)
    time = np.arange(padded) / rate
    sigma = WRAP / time[-1]
    frequency = np.fft.rfftfreq(padded, 1 / rate)
    lines = (frequency >= band[0]) & (frequency <= band[1])
    s = sigma + 2j * np.pi * frequency[lines]
    H = transfer(plant, s)
    out = []
    for signal in signals:
        spectrum = np.fft.rfft(signal * np.exp(-sigma * time[:n]), padded)
        full = np.zeros((len(H), frequency.size), complex)
        full[:, lines] = H * spectrum[lines]
        out.append(np.fft.irfft(full, padded, axis=1)[:, :n] * np.exp(sigma * time[:n]))
    return out


def steady(plant: Plant, period: NDArray, rate: float) -> NDArray[np.float64]:
    """One period of the steady outputs under a periodic input, shape (n_out, n_samples)."""
    spectrum = np.fft.rfft(period)
    lines = np.abs(spectrum) > 1e-9 * np.max(np.abs(spectrum))
    lines[0] = False
    s = 2j * np.pi * np.fft.rfftfreq(period.size, 1 / rate)[lines]
    full = np.zeros((len(plant.outputs), spectrum.size), complex)
    full[:, lines] = transfer(plant, s) * spectrum[lines]
    return np.fft.irfft(full, period.size, axis=1)


def _good_length(n: int) -> int:
    """Least even length >= n without a prime above 5, whose transform is quick."""
    size = n
    while True:
        size += size % 2
        rest = size
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return size
        size += 2
