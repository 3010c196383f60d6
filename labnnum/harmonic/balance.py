r"""Harmonic balance of a structure with nonlinear laws at places, condensed to the motions of these laws.

Of harmonic n the motion z of the laws and their opposing forces f obey

.. math:: z_n = L_n F - G_n f_n, \qquad f = law(z, \dot z),

with the dynamic flexibilities L and G of the linear structure, all its coordinates in them. Unknown are the harmonics
of the forces; the laws are evaluated in time (Cameron and Griffin 1989). Dry friction obeys the projection of Nacivet
et al. (2003), so that sticking needs no stiffness in its stead.

References
----------
T. M. Cameron, J. H. Griffin, "An alternating frequency/time domain method", J. Applied Mechanics 56, 1989.
S. Nacivet, C. Pierre, F. Thouverez, L. Jezequel, "A dynamic Lagrangian frequency-time method for the vibration of
dry-friction-damped systems", J. Sound and Vibration 265, 2003.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.errors import EstimationError, ModelError
from labnnum.harmonic.curve import Curve, Orbit
from labnnum.harmonic.dry import Dry
from labnnum.harmonic.follow import follow
from labnnum.harmonic.laws import force, stretches
from labnnum.harmonic.linear import Flexibility, real_blocks, unpacked
from labnnum.harmonic.stability import Stability
from labnnum.mechanisms.extended import ExtendedStructure
from labnnum.nonlinear import Element
from labnnum.recording import Channel
from labnnum.structures.base import Structure
from labnnum.system import system

SAMPLES = 1024
"""Samples of a period in which the forces of laws are taken, at least; 32 of the highest harmonic."""
CLOSE = 1e-9
"""Motion that the laws' forces leave unbalanced, of the motion, at which a balance is found;"""
FORCE = 1e-6
"""and force, of the law's."""


@dataclass(frozen=True, eq=False)
class Balance:
    """What an estimate of the forces x (g, m) at omega and a level of the drive leaves, and its slopes.

    Attributes
    ----------
    residual, jacobian : (g m,), (g m, g m)
    to_omega : (g m,)
    motion : (r, m)
        Harmonics of the rows' motion, and their slopes to x (r m, g m) and to omega (r m,).
    """

    residual: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    to_omega: NDArray[np.float64]
    motion: NDArray[np.float64]
    motion_to_x: NDArray[np.float64]
    motion_to_omega: NDArray[np.float64]
    time: NDArray[np.float64]
    small: bool


@final
class HarmonicBalance:
    """Periodic responses of a structure to a harmonic force or base motion, with its nonlinear laws.

    Parameters
    ----------
    structure : Structure
        Where it is an extended structure, its own laws act, those of the [[mechanism]] entries of a model file.
    drive : str
        "node:direction" of the force; "base" where the structure's supports move.
    force : float
        Amplitude in N (or N m) of force cos(omega t); in m/s^2 of the base's acceleration.
    outputs : sequence of str
        "node:direction" of the motions that are told, absolute ones; by default the driven one, or with a moving base
        all translations.
    elements : sequence of labnnum.nonlinear.Element
        Laws besides.
    theta : array_like, shape (n_parameters,)
        By default the nominal values.
    harmonics : int
        Highest harmonic of the drive. Smooth laws are content with 5 to 9; stops and friction want 15 or more:
        `Curve.missed` says what the others would add.

    Raises
    ------
    ModelError
        If the structure has no such place, is singular or unstable.
    EstimationError
        If the force or the number of harmonics is not positive.

    Examples
    --------
    A mass on a spring that hardens; its curve of responses folds, and a sweep jumps:

    >>> from labnnum.nonlinear import Element
    >>> from labnnum.structures.chain import Chain, Link
    >>> one = Chain({"1": 1.0}, (Link("1", "ground", 1.0, 0.05),))
    >>> balance = HarmonicBalance(one, "1:x", 0.1, elements=[Element("cubic", np.ones(1), (1.0,))], harmonics=5)
    >>> curve = balance.curve(0.1, 0.35)
    >>> len(curve.folds)
    2
    >>> up, down = (curve.swept([0.22], way)[0] for way in ("forward", "backward"))
    >>> bool(up > 5 * down)
    True
    """

    def __init__(
        self, structure: Structure, drive: str, force: float, outputs: Sequence[str] = (), *,
        elements: Sequence[Element] = (), theta: ArrayLike | None = None, harmonics: int = 15,
    ) -> None:  # fmt: skip
        if harmonics < 1:
            raise EstimationError(f"harmonic balance needs one harmonic or more, not {harmonics}")
        if not 0 < force < np.inf:
            raise EstimationError(f"the amplitude of the drive is {force:g}; a positive number was expected")
        own = structure.law_elements() if isinstance(structure, ExtendedStructure) else ()
        theta = np.asarray(structure.nominal if theta is None else theta, float)
        matrices = structure.matrices(theta)
        self.harmonics, self.drive, self.force = harmonics, drive, force
        self.laws = stretches((*own, *elements), len(matrices.M))
        load, carried = _load(structure, drive, theta)
        translations = tuple(d for d in structure.dofs if d.partition(":")[2] in ("x", "y", "z"))
        self.outputs = tuple(outputs) or (translations if carried else (drive,))
        taken = [np.asarray(structure.participation(d, theta), float) for d in self.outputs]
        columns = [s.column for s in self.laws]
        self._along = np.array([d.partition(":")[2] == carried for d in self.outputs], float)
        rows = np.array([*columns, *taken, load])
        self.flexibility = Flexibility(matrices, rows, np.array([*columns, load]).T, harmonics)
        self.stability = Stability(system(structure, theta, (), [_channel(drive)]), self.laws)
        dry = any(s.dry for s in self.laws)
        samples = 2 * SAMPLES if dry else SAMPLES
        while samples < (64 if dry else 32) * harmonics:
            samples *= 2
        turn = 2 * np.pi * np.arange(samples) / samples
        n = np.arange(1, harmonics + 1)
        cosine, sine = np.cos(np.outer(turn, n)), np.sin(np.outer(turn, n))
        self.shape = np.hstack([np.ones((samples, 1)), np.stack([cosine, sine], 2).reshape(samples, -1)])
        self.rate = np.hstack([np.zeros((samples, 1)), np.stack([-sine * n, cosine * n], 2).reshape(samples, -1)])
        self.back = self.shape.T * (2 / samples)
        self.back[0] *= 0.5
        index = [i for i, s in enumerate(self.laws) if s.dry]
        limits = np.array([self.laws[i].friction for i in index])
        self.dry = Dry(index, limits, harmonics, samples) if index else None

    @property
    def size(self) -> int:
        """Unknowns: mean, cosines and sines of each law's force."""
        return len(self.laws) * (2 * self.harmonics + 1)

    # ---------------------------------------------------------------- the equation

    def evaluate(self, x: NDArray, omega: float, level: float = 1.0) -> Balance:
        """What the forces x (g, m) leave at omega in rad/s, with `level` times the drive."""
        g, m = len(self.laws), 2 * self.harmonics + 1
        h = self.harmonics
        transfer, slope = self.flexibility.at(omega, 1, h if self.dry is None else self.dry.last)
        further = transfer[:, :g, :g], slope[:, :g, :g]
        transfer, slope = transfer[:h], slope[:h]
        gain = -real_blocks(transfer[:, :, :g], self.flexibility.static[:, :g])
        gain_slope = -real_blocks(slope[:, :, :g], np.zeros((len(gain), g)))
        flat = x.ravel()
        driven = np.zeros((len(gain), m))
        driven_slope = np.zeros_like(driven)
        for out, t in ((driven, transfer), (driven_slope, slope)):
            out[:, 1], out[:, 2] = self.force * t[0, :, g].real, -self.force * t[0, :, g].imag
        rows = len(gain)
        own = (gain.reshape(rows * m, g * m) @ flat).reshape(rows, m)
        motion = level * driven + own
        to_omega = level * driven_slope + (gain_slope.reshape(rows * m, g * m) @ flat).reshape(rows, m)
        z, z_omega = motion[:g], to_omega[:g]
        jacobian = np.eye(g * m)
        residual, by_omega = x.copy(), np.zeros((g, m))
        time = np.zeros((g, len(self.shape)))
        for i, s in enumerate(self.laws):
            part = slice(i * m, (i + 1) * m)
            at, speed = self.shape @ z[i], omega * (self.rate @ z[i])
            if s.dry:
                continue
            time[i], led, to_v = force(s, at, speed, self.shape, omega * self.rate)
            spread = self.back @ led
            residual[i] -= self.back @ time[i]
            by_omega[i] = -spread @ z_omega[i] - self.back @ (to_v * speed / omega)
            jacobian[part] -= spread @ gain[i].reshape(m, g * m)
        if self.dry is not None:
            at = self.dry.index
            out, slopes, time[at] = self.dry(x, z, gain[:g].reshape(g, m, g * m), z_omega, omega, *further)
            for j, i in enumerate(at):
                residual[i] -= out[j]
                jacobian[i * m : (i + 1) * m] -= slopes[j, :, :-1]
                by_omega[i] = -slopes[j, :, -1]
        left = (gain.reshape(rows * m, g * m) @ residual.ravel()).reshape(rows, m)
        size = np.linalg.norm(motion, axis=1) + np.linalg.norm(own, axis=1)
        forces = np.linalg.norm(x, axis=1)
        if g:  # a law that hardly acts is measured by the force that would make its motion
            own_gain = np.abs(np.diagonal(transfer[:, :g, :g], axis1=1, axis2=2)).max(axis=0)
            forces = np.maximum(forces, 1e-3 * np.maximum(forces.max(), size[:g] / own_gain))
        small = (np.linalg.norm(left, axis=1) <= CLOSE * size).all() and (
            np.linalg.norm(residual, axis=1) <= FORCE * forces
        ).all()
        return Balance(
            residual.ravel(), jacobian, by_omega.ravel(), motion,
            gain.reshape(rows * m, g * m), to_omega.ravel(), time, bool(small),
        )  # fmt: skip

    # ---------------------------------------------------------------- one frequency

    def solve(self, frequency: float, near: Orbit | None = None) -> Orbit:
        """The periodic response at `frequency` in Hz, from that of the linear structure or from `near`.

        Raises
        ------
        EstimationError
            If none is found.
        """
        _require_positive("frequency", frequency)
        return self._orbit(*self._found(2 * np.pi * frequency, None if near is None else near.unknowns))

    def _found(self, omega: float, x: NDArray | None = None) -> tuple[NDArray, float, Balance]:
        m = 2 * self.harmonics + 1
        start = np.zeros((len(self.laws), m)) if x is None else x
        found = self._newton(start, omega, 1.0) or self._raised(omega) or self._led(omega)
        if found is None:
            raise EstimationError(
                f"harmonic balance does not converge at {omega / (2 * np.pi):g} Hz: begin at another frequency, where"
                " the laws act less, or take another number of harmonics"
            )
        return found[0], omega, found[1]

    def _newton(self, x: NDArray, omega: float, level: float) -> tuple[NDArray, Balance] | None:
        b = self.evaluate(x, omega, level)
        for _ in range(40):
            if b.small:
                return x, b
            try:
                step = np.linalg.solve(b.jacobian, b.residual).reshape(x.shape)
            except np.linalg.LinAlgError:
                return None
            before = np.linalg.norm(b.residual)
            for part in (1.0, 0.5, 0.25, 0.1, 0.03):
                b = self.evaluate(x - part * step, omega, level)
                if np.linalg.norm(b.residual) < before or b.small:
                    break
            x = x - part * step
            if not np.isfinite(x).all():
                return None
        return (x, b) if b.small else None

    def _raised(self, omega: float) -> tuple[NDArray, Balance] | None:
        """With the drive raised from little to all of it."""
        level, step = 0.0, 0.1
        x = np.zeros((len(self.laws), 2 * self.harmonics + 1))
        last = x
        before = 0.0
        while level < 1.0:
            new = min(1.0, level + step)
            guess = x + (x - last) * ((new - level) / (level - before) if level > before else 0.0)
            found = self._newton(guess, omega, new) or self._newton(x, omega, new)
            if found is None:
                step /= 2
                if step < 2e-3:
                    return None
                continue
            last, before, (x, b), level, step = x, level, found, new, min(1.6 * step, 0.2)
        return x, b

    def _led(self, omega: float) -> tuple[NDArray, Balance] | None:
        """Along the curve from a lower frequency, where the laws act less."""
        for part in (0.7, 0.4, 0.15):
            begun = self._newton(np.zeros((len(self.laws), 2 * self.harmonics + 1)), part * omega, 1.0)
            begun = begun or self._raised(part * omega)
            if begun is None:
                continue
            try:
                *_, last = follow(self, (begun[0], part * omega, begun[1]), omega, 0.1, 1000)
            except EstimationError:
                continue
            found = self._newton(last[0], omega, 1.0)
            if found is not None:
                return found
        return None

    # ---------------------------------------------------------------- the curve

    def curve(
        self, low: float, high: float, *, step: float = 0.05, most: int = 5000,
        progress: Callable[[float, float], None] | None = None,
    ) -> Curve:  # fmt: skip
        """The curve of responses from `low` to `high` in Hz, followed by its arc length around folds.

        Parameters
        ----------
        step : float
            Longest step, relative to the motions and to the range of frequencies together.
        most : int
            Points at most.
        progress : callable
            Is told how far of which range, in Hz, the curve has come.

        Raises
        ------
        EstimationError
            If the curve does not begin, cannot be followed, or does not arrive within `most` points.
        """
        _require_positive("low end", low)
        if not low < high < np.inf:
            raise EstimationError(
                f"the curve would go from {low:g} to {high:g} Hz: the high end must lie above the low"
            )
        orbits = []
        for x, omega, balance in follow(self, self._found(2 * np.pi * low), 2 * np.pi * high, step, most):
            orbits.append(self._orbit(x, omega, balance))
            if progress is not None:
                progress(max(min(omega / (2 * np.pi), high) - low, 0.0), high - low)
        return Curve(tuple(orbits), self.outputs, tuple(s.name for s in self.laws))

    def _orbit(self, x: NDArray, omega: float, balance: Balance) -> Orbit:
        g = len(self.laws)
        motion = unpacked(balance.motion)
        outputs = motion[g:-1].copy()
        outputs[:, 1] -= self._along * self.force / omega**2
        multiplier = self.stability.multiplier(self.shape, self.rate, omega, balance.motion[:g], balance.time)
        return Orbit(
            omega / (2 * np.pi), outputs, motion[:g], unpacked(x), multiplier,
            self._missed(omega, balance), float(-np.pi * self.force * motion[-1, 1].imag), x,
        )  # fmt: skip

    def _missed(self, omega: float, balance: Balance) -> float:
        """Motion that the forces' harmonics beyond the last would make, up to twice that, of the laws' motion."""
        g, h = len(self.laws), self.harmonics
        if not g:
            return 0.0
        spectrum = np.fft.rfft(balance.time, axis=1)[:, h + 1 : 2 * h + 1] * (2 / balance.time.shape[1])
        transfer, _ = self.flexibility.at(omega, h + 1, 2 * h)
        more = (transfer[:, :g, :g] @ spectrum.T[:, :, None])[:, :, 0].T
        size = np.linalg.norm(balance.motion[:g], axis=1)
        return float(np.max(np.linalg.norm(more, axis=1) / np.where(size > 0, size, np.inf)))


def _load(structure: Structure, drive: str, theta: NDArray) -> tuple[NDArray[np.float64], str]:
    """What a unit of the drive loads, (n,); the direction in which a base moves, or nothing."""
    if drive != "base":
        return np.asarray(structure.participation(drive, theta), float), ""
    if not structure.base:
        raise ModelError('the structure has no moving base: give the driven place as "node:direction"')
    return -np.asarray(structure.base_load(theta), float), structure.base


def _channel(drive: str) -> Channel:
    node, _, direction = drive.partition(":")
    if drive == "base":
        return Channel("base", "acceleration", "base")
    return Channel("drive", "moment" if direction.startswith("r") else "force", "reference", node, direction)


def _require_positive(what: str, value: float) -> None:
    if not 0 < value < np.inf:
        raise EstimationError(f"the {what} is {value:g} Hz; a positive number was expected")
