"""System: a structure's equation of motion with what drives it and what is sensed, ready to march in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from labnnum.errors import ChannelError, ModelError
from labnnum.frf import MOTION_ORDER
from labnnum.recording import Channel
from labnnum.structures.base import Structure


@dataclass(frozen=True, eq=False)
class System:
    r"""Linear equation of motion :math:`M\ddot u + C\dot u + K u = B f` and the motions that are sensed.

    Parameters
    ----------
    M, C, K : ndarray, shape (n, n)
    load : ndarray, shape (n, n_in)
        B.
    displacement, velocity, acceleration : ndarray, shape (n_out, n)
        What each output takes of u and its derivatives.
    feed : ndarray, shape (n_out, n_in)
        What each output takes of the inputs themselves.
    """

    M: NDArray[np.float64]
    C: NDArray[np.float64]
    K: NDArray[np.float64]
    load: NDArray[np.float64]
    displacement: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    feed: NDArray[np.float64]

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return self.load.shape[1]

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return self.feed.shape[0]

    def frf(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Transfer from inputs to outputs at `frequency` in Hz, shape (n_out, n_in, n_f)."""
        omega = 2 * np.pi * np.asarray(frequency, float)
        w = omega[:, None, None]
        u = np.linalg.solve(self.K + 1j * w * self.C - w**2 * self.M, self.load.astype(complex))
        rows = self.displacement + 1j * w * self.velocity - w**2 * self.acceleration
        return np.moveaxis(rows @ u + self.feed, 0, -1)


def system(structure: Structure, theta: ArrayLike, outputs: Sequence[Channel], inputs: Sequence[Channel]) -> System:
    r"""The equation of motion of `structure` between `inputs` and `outputs`.

    Parameters
    ----------
    structure : Structure
    theta : array_like, shape (n_parameters,)
    outputs, inputs : sequence of Channel
        An input of role "base" is the acceleration of all supports; outputs are absolute motions, and an output
        of role "base" is the base itself.

    Raises
    ------
    ModelError
        If the structure lacks a degree of freedom, or its mass matrix is singular in a way that is not an
        internal massless coordinate.
    ChannelError
        If forces and a base motion are mixed, or a channel has no place.

    Notes
    -----
    Structural damping D exists in the frequency domain only. Here each mode gets the viscous damping that loses the
    same energy at its natural frequency, :math:`\phi_i^T D \phi_j / \sqrt{\omega_i \omega_j}`.
    """
    theta = np.asarray(theta, float)
    matrices = structure.matrices(theta)
    M, K = np.array(matrices.M, float), np.array(matrices.K, float)
    C = np.array(matrices.C, float) + _viscous(M, K, np.asarray(matrices.D, float))
    based = any(c.role == "base" for c in inputs)
    if based and (len(inputs) != 1 or inputs[0].quantity != "acceleration"):
        raise ChannelError("a base-driven structure takes one input: the acceleration of its base")
    if based:
        load = -np.asarray(structure.base_load(theta), float)[:, None] * inputs[0].sign
    else:
        load = np.stack([c.sign * _row(structure, c, theta) for c in inputs], axis=1)
    pu, pv, pa = np.moveaxis(
        np.array([_output_rows(structure, c, theta) for c in outputs]).reshape(-1, 3, len(M)), 1, 0
    )
    out = System(M, C, K, load, pu, pv, pa, np.zeros((len(outputs), len(inputs))))
    return _absolute(out, outputs, inputs[0].sign, structure.base) if based else out


def _row(structure: Structure, channel: Channel, theta: NDArray) -> NDArray[np.float64]:
    if not channel.dof:
        raise ChannelError(f"channel {channel.name!r} has no place: give it a node and a direction")
    return np.asarray(structure.participation(channel.dof, theta), float)


def _output_rows(structure: Structure, channel: Channel, theta: NDArray) -> list[NDArray[np.float64]]:
    """Rows on displacement, velocity and acceleration of one output."""
    if channel.quantity not in MOTION_ORDER:
        raise ChannelError(f"channel {channel.name!r} measures {channel.quantity}, which is not a motion")
    n = len(structure.matrices(theta).M)
    row = np.zeros(n) if channel.role == "base" else channel.sign * _row(structure, channel, theta)
    order = MOTION_ORDER[channel.quantity]
    return [row if order == k else np.zeros(n) for k in range(3)]


def _absolute(relative: System, outputs: Sequence[Channel], sign: float, direction: str) -> System:
    """Add the base's own motion to each output along it, at a clamped support too."""
    along = [c.role == "base" or c.direction.lstrip("+-") == direction for c in outputs]
    carried = np.where(along, [c.sign * sign for c in outputs], 0.0)
    lower = np.array([MOTION_ORDER[c.quantity] for c in outputs])
    feed = np.where(lower == 2, carried, 0.0)
    out = System(
        relative.M, relative.C, relative.K, relative.load,
        relative.displacement, relative.velocity, relative.acceleration, feed[:, None],
    )  # fmt: skip
    follows = np.where(lower < 2, carried, 0.0)
    return _with_base_coordinate(out, follows, lower) if follows.any() else out


def _with_base_coordinate(out: System, follows: NDArray, order: NDArray) -> System:
    """Append the base's displacement as a free coordinate of unit mass, for outputs below acceleration."""
    column = follows[:, None]
    return System(
        bordered(out.M, 1.0), bordered(out.C, 0.0), bordered(out.K, 0.0),
        np.vstack([out.load, [[1.0]]]),
        np.hstack([out.displacement, np.where(order[:, None] == 0, column, 0.0)]),
        np.hstack([out.velocity, np.where(order[:, None] == 1, column, 0.0)]),
        np.hstack([out.acceleration, np.zeros_like(column)]),
        out.feed,
    )  # fmt: skip


def bordered(matrix: NDArray, corner: float) -> NDArray[np.float64]:
    """`matrix` with one more row and column that hold `corner` where they meet."""
    out = np.zeros((len(matrix) + 1, len(matrix) + 1))
    out[:-1, :-1] = matrix
    out[-1, -1] = corner
    return out


def massless(M: NDArray) -> NDArray[np.bool_]:
    """Coordinates without mass, shape (n,)."""
    return ~np.any(M != 0, axis=1)


def _viscous(M: NDArray, K: NDArray, D: NDArray) -> NDArray[np.float64]:
    """Viscous damping matrix with the losses of D at each natural frequency."""
    if not D.any():
        return np.zeros_like(D)
    light = massless(M)
    heavy = ~light
    if D[light].any():
        raise ModelError("structural damping on a coordinate without mass cannot be simulated in time")
    stiffness = condense(K, heavy)
    mass = M[np.ix_(heavy, heavy)]
    values, shape = modal_basis(mass, stiffness)
    omega = np.sqrt(np.clip(values, 0, None))
    floor = 1e-6 * omega.max(initial=0.0)
    scale = np.where(omega > floor, 1 / np.sqrt(np.where(omega > floor, omega, 1.0)), 0.0)
    modal = scale[:, None] * (shape.T @ D[np.ix_(heavy, heavy)] @ shape) * scale
    back = mass @ shape
    out = np.zeros_like(D)
    out[np.ix_(heavy, heavy)] = back @ modal @ back.T
    return out


def condense(K: NDArray, keep: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Static condensation of K to the coordinates that are kept."""
    drop = ~keep
    if not drop.any():
        return K
    inner = K[np.ix_(drop, drop)]
    try:
        tie = np.linalg.solve(inner, K[np.ix_(drop, keep)])
    except np.linalg.LinAlgError:
        raise ModelError("a coordinate without mass is held by nothing; fix or remove it") from None
    return K[np.ix_(keep, keep)] - K[np.ix_(keep, drop)] @ tie


def modal_basis(M: NDArray, K: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Squared natural frequencies, ascending, and shapes with shape^T M shape = 1."""
    try:
        values, shape = eigh((K + K.T) / 2, (M + M.T) / 2)
    except np.linalg.LinAlgError:
        raise ModelError("the mass matrix is not positive definite, so the structure cannot be simulated") from None
    return values, shape
