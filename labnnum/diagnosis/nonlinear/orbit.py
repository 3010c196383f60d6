"""A steady state: what is held of it, and how its states are laid out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance

CLOSED = 3e-4
"""Relative gap of a period, or change from march to march, at which a steady state counts as found."""
SINGULAR = 1e-9
"""Singular value of the closing gap, of the largest, below which a motion is one that no force brings back."""


@dataclass(frozen=True, eq=False)
class Tie:
    """Motion (n, k, 2) at the laws' places that the measurement shows, and dashpots (k,) that tie a march to it while
    it begins; `tight`: how many of them do so from there on.
    """

    motion: NDArray[np.float64]
    dashpot: NDArray[np.float64]
    tight: float = 0.0


@dataclass(frozen=True, eq=False)
class Orbit:
    """A steady state: modal state (2, m), forces (k,) and memory (k, M) just before time 0, and over the period.

    `force` (k, n_lines) spectrum of the forces on the structure, `time` (n, k) the same in time, `motion` (n, k, 2).
    `closing` relative change of the state over the period; `bad` steps whose forces did not settle. `fed` the forces
    from which the correction of the march was taken, where those are others than `force`. `tie` of an open run what
    brings its march into step with the measured one.
    """

    x: NDArray
    f: NDArray
    memory: NDArray
    force: NDArray
    time: NDArray
    motion: NDArray
    closing: float = np.inf
    bad: int = 0
    floquet: NDArray | None = None
    inverse: NDArray | None = None
    fed: NDArray | None = None
    tie: Tie | None = None

    @property
    def source(self) -> NDArray:
        """Spectrum (k, n_lines) of the forces that the march is to be corrected by."""
        return self.force if self.fed is None else self.fed


@dataclass(frozen=True, eq=False)
class Marched:
    """What a march over a run gives: the state at its end, forces and motions, tangents' ends and those of the forces,
    and the number of steps whose forces did not settle.
    """

    state: NDArray
    time: NDArray
    motion: NDArray
    end: NDArray
    slopes: NDArray
    bad: int


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the force spectrum, (n, k, lines): to the base model's vector, then to the laws' parameters."""

    force: NDArray


def state_of(orbit: Orbit) -> NDArray[np.float64]:
    """What a period begins with, in one vector: modal state, forces, memory."""
    return np.concatenate([orbit.x.reshape(-1), orbit.f, orbit.memory.reshape(-1)])


def parts_of(state: NDArray, m: int, k: int) -> tuple[NDArray, NDArray, NDArray]:
    """Such a vector taken apart."""
    return (
        state[: 2 * m].reshape(2, m).copy(),
        state[2 * m : 2 * m + k].copy(),
        state[2 * m + k :].reshape(k, -1).copy(),
    )


def scaled(orbit: Orbit, factor: NDArray) -> Orbit:
    """The orbit where each place's motions, and what laws remember of them, are `factor` (k,) times as large, and its
    forces as many times smaller.
    """
    less = 1.0 / factor
    m, room = 2 * orbit.x.shape[1], orbit.memory.shape[1]
    size = np.concatenate([np.ones(m), less, np.repeat(factor, room)])
    turned = [
        None if a is None or a.shape[0] != size.size else size[:, None] * a / size
        for a in (orbit.floquet, orbit.inverse)
    ]
    motion = orbit.motion * factor[:, None] if orbit.motion.shape[1:] == (factor.size, 2) else orbit.motion
    return replace(
        orbit, f=orbit.f * less, memory=orbit.memory * factor[:, None], force=orbit.force * less[:, None],
        time=orbit.time * less, motion=motion, floquet=turned[0], inverse=turned[1],
        fed=None if orbit.fed is None else orbit.fed * less[:, None],
        tie=None if orbit.tie is None else replace(
            orbit.tie, motion=orbit.tie.motion * factor[:, None], dashpot=orbit.tie.dashpot * less**2
        ),
    )  # fmt: skip


def relative(change: NDArray, whole: NDArray) -> float:
    """Norm of a change over that of the whole; infinite where there is no whole to speak of."""
    part, size = float(np.linalg.norm(change)), float(np.linalg.norm(whole))
    if part == 0.0:
        return 0.0
    return part / size if size > 1e-12 * part else float("inf")


def closed(phi: NDArray) -> NDArray[np.float64]:
    """(I - phi)^-1: from the gap at the end of the period to the change of its start; what nothing holds stays."""
    gap = np.eye(phi.shape[0]) - phi
    if not np.isfinite(gap).all():
        return np.full(gap.shape, np.nan)
    even, (scale, _) = matrix_balance(gap, permute=False, separate=True)  # metres beside newtons
    return scale[:, None] * np.linalg.pinv(even, rcond=SINGULAR) / scale
