"""Duffing's oscillator near its primary resonance: multiple scales and harmonic balance, in either sweep direction.

u'' + 2 eps mu u' + omega0^2 u + eps alpha u^3 = eps F cos(Omega t), Atalla (1996), equation 5.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter, nominal

Sweep = Literal["forward", "backward"]

MU = Parameter("mu", 0.25, 0.175, 0.325, "1", 0.04)
ALPHA = Parameter("alpha", 1.5, 1.05, 1.95, "1", 0.25)

_SAMPLES = 64
_ROUNDS = 40
_TOLERANCE = 1e-12


@final
@dataclass(frozen=True, eq=False)
class Duffing:
    """The oscillator with the dissertation's constants; mu and alpha are the parameters, theta = (mu, alpha).

    It is no `Structure`: its response depends on the level and on the direction of the sweep. All methods accept
    several parameter sets at once, theta of shape (..., 2), and return that shape with the frequency axis last.

    Parameters
    ----------
    force : float
        F of equation 5.6.
    omega0 : float
        Natural frequency without damping and at small amplitude, rad/s.
    epsilon : float
        Scale of damping, cubic term and force.
    parameters : (Parameter, Parameter)
        mu > 0 and alpha; negative alpha softens.

    Examples
    --------
    >>> d = Duffing(epsilon=0.1)
    >>> up, down = (d.amplitude(d.nominal, [0.75], s)[0] for s in ("forward", "backward"))
    >>> round(float(up), 4), round(float(down), 4)
    (1.185, 0.4343)
    """

    force: float = 0.6
    omega0: float = 1.0
    epsilon: float = 1.0
    parameters: tuple[Parameter, Parameter] = (MU, ALPHA)

    def __post_init__(self) -> None:
        for name in ("force", "omega0", "epsilon"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"Duffing oscillator: {name} = {getattr(self, name)!r} must be positive")

    @property
    def nominal(self) -> NDArray[np.float64]:
        """Nominal mu and alpha."""
        return nominal(self.parameters)

    def amplitude(self, theta: ArrayLike, sigma: ArrayLike, sweep: Sweep = "forward") -> NDArray[np.float64]:
        """Amplitude a by multiple scales at detunings sigma = (Omega - omega0)/eps, shape (..., n) (eq. 5.8)."""
        mu, alpha = self._split(theta)
        detuning = np.asarray(sigma, float)
        bend = 3 * alpha / (8 * self.omega0)
        power = self.force**2 / (4 * self.omega0**2)
        return np.sqrt(_amplitude_squared(mu**2, detuning, bend, power, _upper(bend, sweep)))

    def components(self, theta: ArrayLike, sigma: ArrayLike, sweep: Sweep = "forward") -> NDArray[np.complex128]:
        """Real and imaginary component of equation 5.9, as one complex number, shape (..., n)."""
        mu, alpha = self._split(theta)
        a = self.amplitude(theta, sigma, sweep)
        return a * (3 * alpha / (8 * self.omega0) * a**2 - np.asarray(sigma, float)) + 1j * a * mu

    def harmonics(
        self, theta: ArrayLike, omega: ArrayLike, sweep: Sweep = "forward", count: int = 3
    ) -> NDArray[np.complex128]:
        """Steady state u = Re sum c_k exp(i k Omega t) over odd k by harmonic balance, shape (..., n, count).

        Parameters
        ----------
        theta : array_like, shape (..., 2)
        omega : array_like, shape (n,)
            Omega in rad/s, ascending; the sweep passes through these lines in its direction.
        sweep : {"forward", "backward"}
            At a line with several solutions, the one that a slow sweep in this direction arrives on.
        count : int
            Odd harmonics: 3 stands for 1, 3 and 5.

        Raises
        ------
        ModelError
            If no periodic solution is found at a line.

        References
        ----------
        Krack and Gross (2019), chapter 2.
        """
        line = np.asarray(omega, float)
        if line.ndim != 1 or not (line > 0).all() or not (np.diff(line) > 0).all():
            raise ModelError("a sweep needs ascending frequencies > 0")
        sets = np.asarray(theta, float)
        self._split(sets)
        flat = sets.reshape(-1, 2)
        balance = _Balance(self, count)
        found = balance.follow(flat, line, sweep)
        return found.reshape(*sets.shape[:-1], line.size, count)

    def response(
        self, theta: ArrayLike, omega: ArrayLike, sweep: Sweep = "forward", count: int = 3
    ) -> NDArray[np.complex128]:
        """First harmonic of u over the force amplitude eps F, the FRF that a swept sine measures, shape (..., n)."""
        return self.harmonics(theta, omega, sweep, count)[..., 0] / (self.epsilon * self.force)

    def sensitivity(
        self, theta: ArrayLike, omega: ArrayLike, sweep: Sweep = "forward", count: int = 3
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """`response` and its exact derivatives to mu and alpha along the branch, shape (2, ..., n)."""
        sets = np.asarray(theta, float)
        line = np.asarray(omega, float)
        balance = _Balance(self, count)
        c = self.harmonics(sets, line, sweep, count)
        slopes = balance.slopes(sets.reshape(-1, 2), line, c.reshape(-1, line.size, count))
        scale = self.epsilon * self.force
        return c[..., 0] / scale, slopes.reshape(2, *sets.shape[:-1], line.size) / scale

    def _split(self, theta: ArrayLike) -> tuple[NDArray, NDArray]:
        """Columns mu and alpha, each (..., 1)."""
        values = np.asarray(theta, float)
        if values.ndim == 0 or values.shape[-1] != 2 or not np.isfinite(values).all():
            raise ModelError("the Duffing oscillator has two parameters, mu and alpha, both finite")
        if not (values[..., 0] > 0).all():
            raise ModelError("the Duffing oscillator is unstable: mu must be positive")
        return values[..., :1], values[..., 1:]


def _upper(bend: NDArray, sweep: Sweep) -> NDArray[np.bool_]:
    """Whether the sweep arrives on the largest solution: forward with hardening, backward with softening."""
    if sweep not in ("forward", "backward"):
        raise ConfigError(f"sweep {sweep!r}: expected forward or backward")
    return (bend >= 0) == (sweep == "forward")


def _amplitude_squared(loss: ArrayLike, shift: NDArray, bend: NDArray, power: ArrayLike, upper: NDArray) -> NDArray:
    """Largest or smallest y > 0 with (loss + (shift - bend y)^2) y = power."""
    loss, shift, bend, power, upper = np.broadcast_arrays(loss, shift, bend, power, upper)
    y = np.asarray(power / (loss + shift**2), float).copy()
    curved = np.abs(bend) * y > 1e-12 * np.sqrt(loss + shift**2)
    b, s = bend[curved], shift[curved]
    y[curved] = _cubic(-2 * s / b, (loss[curved] + s**2) / b**2, -power[curved] / b**2, upper[curved])
    return y


def _cubic(c2: NDArray, c1: NDArray, c0: NDArray, upper: NDArray) -> NDArray[np.float64]:
    """Largest or smallest real root of y^3 + c2 y^2 + c1 y + c0 (Cardano, Viete), polished by Newton's rule."""
    p, q = c1 - c2**2 / 3, 2 * c2**3 / 27 - c2 * c1 / 3 + c0
    discriminant = q**2 / 4 + p**3 / 27
    root = np.sqrt(np.maximum(discriminant, 0.0))
    single = np.cbrt(-q / 2 + root) + np.cbrt(-q / 2 - root)
    radius = 2 * np.sqrt(np.maximum(-p, 0.0) / 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        angle = np.arccos(np.clip(-4 * q / radius**3, -1.0, 1.0)) / 3
    three = radius * np.cos(angle - np.where(upper, 0.0, 4 * np.pi / 3))
    y = np.where(discriminant > 0, single, three) - c2 / 3
    for _ in range(3):
        value, slope = ((y + c2) * y + c1) * y + c0, (3 * y + 2 * c2) * y + c1
        step = np.divide(value, slope, out=np.zeros_like(y), where=slope != 0)
        y = np.where(np.abs(step) < 0.01 * np.abs(y), y - step, y)
    return y


class _Balance:
    """Harmonic balance of many oscillators and lines at once; the cubic term by sampling a period."""

    def __init__(self, oscillator: Duffing, count: int) -> None:
        if count < 1:
            raise ConfigError(f"harmonic balance needs at least one harmonic, got {count}")
        self.o = oscillator
        self.k = 2 * np.arange(count) + 1
        samples = max(_SAMPLES, 8 * int(self.k[-1]))
        self.waves = np.exp(1j * np.outer(self.k, 2 * np.pi * np.arange(samples) / samples))
        self.back = 2 / samples * self.waves.conj().T

    def follow(self, theta: NDArray, omega: NDArray, sweep: Sweep) -> NDArray[np.complex128]:
        """Solutions along a sweep, (n_sets, n, count)."""
        mu, alpha = theta[:, :1], theta[:, 1:]
        upper = _upper(alpha, sweep)
        c, good = self._solve(theta, omega, self._start(mu, alpha, omega, upper))
        lost = np.flatnonzero(~good.all(axis=1))
        if lost.size:
            other, also = self._solve(theta[lost], omega, self._start(mu[lost], alpha[lost], omega, ~upper[lost]))
            c[lost] = np.where(good[lost][..., None], c[lost], other)
            good[lost] |= also
        if not good.all():
            at = omega[int(np.argwhere(~good)[0][1])]
            raise ModelError(f"harmonic balance found no periodic solution at {at:.6g} rad/s: use more harmonics")
        return self._carry_on(theta, omega, c, 1 if sweep == "forward" else -1)

    def _start(self, mu: NDArray, alpha: NDArray, omega: NDArray, upper: NDArray) -> NDArray[np.complex128]:
        """Solutions of one harmonic, in closed form."""
        e, w0 = self.o.epsilon, self.o.omega0
        bend, shift, loss = 0.75 * e * alpha, omega**2 - w0**2, 2 * e * mu * omega
        y = _amplitude_squared(loss**2, shift, bend, (e * self.o.force) ** 2, upper)
        out = np.zeros((*y.shape, self.k.size), complex)
        out[..., 0] = e * self.o.force / (bend * y - shift + 1j * loss)
        return out

    def _solve(self, theta: NDArray, omega: NDArray, c: NDArray) -> tuple[NDArray, NDArray]:
        """Newton's rule at every set and line; solutions and where it converged."""
        shape = c.shape
        flat, sets, lines = self._flat(theta, omega, c)
        active = np.arange(len(flat))
        for _ in range(_ROUNDS):
            residual, jacobian = self.residual(sets[active], lines[active], flat[active])
            step = _complex(np.linalg.solve(jacobian, _real(residual)[..., None])[..., 0])
            size, move = np.abs(flat[active, 0]), np.abs(step).max(axis=-1)
            flat[active] -= np.minimum(1.0, size / np.maximum(move, 1e-300))[:, None] * step
            active = active[move >= _TOLERANCE * size]
            if not active.size:
                break
        good = np.ones(len(flat), bool)
        good[active] = False
        return flat.reshape(shape), good.reshape(shape[:-1])

    def _flat(self, theta: NDArray, omega: NDArray, c: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Copies of c, theta and omega with one row for each set and line."""
        n_sets, n = c.shape[:2]
        return c.reshape(-1, c.shape[-1]).copy(), np.repeat(theta, n, axis=0), np.tile(omega, n_sets)

    def residual(self, theta: NDArray, omega: NDArray, c: NDArray) -> tuple[NDArray, NDArray]:
        """Out of balance, (m, count), and its real Jacobian, (m, 2 count, 2 count), of m sets each at its own line."""
        e = self.o.epsilon
        mu, alpha, w = theta[:, :1], theta[:, 1:], omega[:, None] * self.k
        linear = self.o.omega0**2 - w**2 + 2j * e * mu * w
        u = np.real(c @ self.waves)
        out = linear * c + e * alpha * (u * u * u @ self.back)
        out[:, 0] -= e * self.o.force
        n, slope = self.k.size, 3 * e * alpha * u * u
        jacobian = np.empty((len(c), 2 * n, 2 * n))
        for column, wave, unit in ((0, np.real(self.waves), 1.0), (n, -np.imag(self.waves), 1j)):
            pairs = (wave[:, :, None] * self.back[None]).swapaxes(0, 1).reshape(slope.shape[1], -1)
            whole = (slope @ pairs).reshape(-1, n, n).swapaxes(1, 2) + unit * linear[:, :, None] * np.eye(n)
            jacobian[:, :n, column : column + n] = np.real(whole)
            jacobian[:, n:, column : column + n] = np.imag(whole)
        return out, jacobian

    def _carry_on(self, theta: NDArray, omega: NDArray, c: NDArray, way: int) -> NDArray[np.complex128]:
        """Stay on a branch past the line where one harmonic leaves it, as long as the branch exists."""
        lines = range(1, omega.size) if way > 0 else range(omega.size - 2, -1, -1)
        for i in lines:
            left = np.abs(c[:, i, 0] - c[:, i - way, 0]) > 0.2 * np.abs(c[:, i - way, 0])
            sets = np.flatnonzero(left)
            if not sets.size:
                continue
            before = c[sets, i - way]
            tried, good = self._solve(theta[sets], omega[i : i + 1], before[:, None])
            near = np.abs(tried[:, 0, 0] - before[:, 0]) < 0.5 * np.abs(c[sets, i, 0] - before[:, 0])
            stay = good[:, 0] & near
            c[sets[stay], i] = tried[stay, 0]
        return c

    def slopes(self, theta: NDArray, omega: NDArray, c: NDArray) -> NDArray[np.complex128]:
        """Derivatives of the first harmonic to mu and alpha, (2, n_sets, n)."""
        e, shape = self.o.epsilon, c.shape[:-1]
        flat, sets, lines = self._flat(theta, omega, c)
        _, jacobian = self.residual(sets, lines, flat)
        by_mu = 2j * e * lines[:, None] * self.k * flat
        by_alpha = e * (np.real(flat @ self.waves) ** 3 @ self.back)
        x = -np.linalg.solve(jacobian, np.stack([_real(by_mu), _real(by_alpha)], axis=-1))
        first = x[:, 0] + 1j * x[:, self.k.size]
        return np.moveaxis(first, -1, 0).reshape(2, *shape)


def _real(c: NDArray) -> NDArray[np.float64]:
    return np.concatenate([np.real(c), np.imag(c)], axis=-1)


def _complex(x: NDArray) -> NDArray[np.complex128]:
    n = x.shape[-1] // 2
    return x[..., :n] + 1j * x[..., n:]
