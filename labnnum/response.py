"""Frequency response functions of structures, their exact sensitivities, modes and poles.

Source: Atalla (1996), equations 2.33 (dynamic stiffness), 2.45 and 4.35 (sensitivities), 5.10 (base excitation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.eigen import coupled_poles, couples, natural_modes, pencil_poles, sorted_poles
from labnnum.errors import ChannelError, ModelError
from labnnum.frf import MOTION_ORDER, Frf
from labnnum.recording import Channel
from labnnum.solvers import Solver, require_sound, solver
from labnnum.structures.base import Matrices, Structure

_CHUNK = 1_500_000


def frf(
    structure: Structure,
    theta: ArrayLike,
    frequency: ArrayLike,
    outputs: Sequence[Channel],
    inputs: Sequence[Channel],
) -> NDArray[np.complex128]:
    r"""Frequency response functions, complex, shape (n_out, n_in, n_f).

    Parameters
    ----------
    structure : Structure
    theta : array_like, shape (n_parameters,)
        Parameter values, in their units.
    frequency : array_like, shape (n_f,)
        Lines, in Hz.
    outputs : sequence of Channel
        Motions (displacement to acceleration, angles too), absolute; a channel of role "base" is the base's motion.
    inputs : sequence of Channel
        Forces or moments, or one base motion (role "base").

    Raises
    ------
    ModelError
        If a degree of freedom is missing, the structure is unstable, or the dynamic stiffness is singular at a line.
    ChannelError
        If a channel has no place, or measures what a structure neither does nor takes.

    Notes
    -----
    Forces: :math:`H = (i\omega)^q\, p\, Z^{-1} b`; base motion: :math:`H = (i\omega)^{q-r}(\omega^2 p Z^{-1} M \rho
    + 1)`, with :math:`Z = K + iD + i\omega C - \omega^2 M` (Atalla 1996, eq. 2.33, 5.10) and q, r the orders of
    differentiation that output and input measure.

    Examples
    --------
    >>> from labnnum.structures.chain import Chain, Link
    >>> oscillator = Chain(masses={"1": 2.0}, links=(Link("1", "ground", 8.0),))
    >>> tip, push = Channel("x", "displacement", node="1", direction="x"), Channel("f", "force", "reference", "1", "x")
    >>> float(frf(oscillator, [], [0.0], [tip], [push])[0, 0, 0].real)
    0.125
    """
    view = ChannelView(structure, theta, frequency, outputs, inputs)
    out = np.empty((len(view.outputs), len(view.inputs), view.omega.size), complex)
    for part in view.parts(min(len(view.outputs), len(view.inputs))):
        kernel = view.solver.transfer(view.omega[part], view.rows, view.loads)
        out[:, :, part] = view.assemble(np.moveaxis(kernel, 0, -1), part)
    return out


def model_frf(
    structure: Structure,
    theta: ArrayLike,
    frequency: ArrayLike,
    outputs: Sequence[Channel],
    inputs: Sequence[Channel],
) -> Frf:
    """The same as `frf`, as an Frf with estimator "model"."""
    value = frf(structure, theta, frequency, outputs, inputs)
    return Frf(np.asarray(frequency, float), value, tuple(outputs), tuple(inputs), estimator="model")


def frf_sensitivity(
    structure: Structure,
    theta: ArrayLike,
    frequency: ArrayLike,
    outputs: Sequence[Channel],
    inputs: Sequence[Channel],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    r"""FRFs and their exact derivatives to each parameter.

    Parameters are those of `frf`.

    Returns
    -------
    value : ndarray, shape (n_out, n_in, n_f)
    derivative : ndarray, shape (n_parameters, n_out, n_in, n_f)

    Notes
    -----
    .. math:: \partial(p Z^{-1} b) = \partial p\, x + y^T \partial b - y^T\, \partial Z\, x,
              \quad Z x = b,\; Z^T y = p^T

    Places that move with a parameter, the rigid-body vector and the measurement chain are differentiated too.

    References
    ----------
    Atalla (1996), equations 2.45 and 4.35.
    """
    view = ChannelView(structure, theta, frequency, outputs, inputs)
    tangent = _Tangent(view)
    n_out, n_in, n_par = len(view.outputs), len(view.inputs), len(structure.parameters)
    value = np.empty((n_out, n_in, view.omega.size), complex)
    derivative = np.empty((n_par, n_out, n_in, view.omega.size), complex)
    for part in view.parts(n_out + n_in):
        kernel, slope = tangent.at(view.omega[part])
        value[:, :, part] = view.assemble(kernel, part)
        derivative[..., part] = view.assemble_slope(slope, value[:, :, part], part)
    return value, derivative


@dataclass(frozen=True, eq=False)
class Modes:
    """Undamped modes of a structure with their damping ratios.

    Parameters
    ----------
    frequency : ndarray, shape (n_modes,)
        Hz, ascending.
    shape : ndarray, shape (n, n_modes)
        Columns with shape^T M shape = 1, in the structure's coordinates.
    damping_ratio : ndarray, shape (n_modes,)
        From the diagonals of shape^T C shape and shape^T D shape: exact where damping does not couple the modes.
    """

    frequency: NDArray[np.float64]
    shape: NDArray[np.float64]
    damping_ratio: NDArray[np.float64]

    def seen_at(self, structure: Structure, theta: ArrayLike, dofs: Sequence[str]) -> NDArray[np.float64]:
        """Mode shapes at degrees of freedom, shape (n_dofs, n_modes)."""
        return np.array([structure.participation(d, np.asarray(theta, float)) for d in dofs]) @ self.shape


def modes(structure: Structure, theta: ArrayLike, n: int | None = None) -> Modes:
    """The lowest `n` modes (all by default), with damping ratios.

    Raises
    ------
    ModelError
        If the structure is unstable or has no mass.

    Examples
    --------
    >>> from labnnum.structures.chain import Chain, Link
    >>> two = Chain(masses={"1": 1.0, "2": 1.0}, links=(Link("1", "ground", 1.0), Link("1", "2", 1.0)))
    >>> (modes(two, []).frequency * 2 * np.pi).round(4)
    array([0.618, 1.618])
    """
    m = structure.matrices(_values(structure, theta))
    require_sound(m)
    omega2, shape = natural_modes(m.M, m.K, n)
    omega = np.sqrt(omega2)
    safe = np.where(omega > 0, omega, np.inf)
    viscous = np.einsum("ij,ij->j", shape, m.C @ shape) / (2 * safe)
    structural = np.einsum("ij,ij->j", shape, m.D @ shape) / (2 * safe**2)
    return Modes(omega / (2 * np.pi), shape, viscous + structural)


def mode_sensitivity(structure: Structure, theta: ArrayLike, n: int) -> tuple[Modes, NDArray[np.float64]]:
    """The lowest `n` modes and the derivative of their frequencies, Hz per unit, shape (n_parameters, n).

    Simple modes only: df = phi^T (dK - omega^2 dM) phi / (8 pi^2 f), Fox and Kapoor (1968), equation 10.
    """
    found = modes(structure, theta, n)
    values = _values(structure, theta)
    omega2 = (2 * np.pi * found.frequency) ** 2
    rows = []
    for d in structure.derivatives(values):
        stiff = np.einsum("ij,ij->j", found.shape, d.K @ found.shape)
        inert = np.einsum("ij,ij->j", found.shape, d.M @ found.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            rows.append((stiff - omega2 * inert) / (8 * np.pi**2 * found.frequency))
    return found, np.array(rows).reshape(len(rows), found.frequency.size)


def poles(structure: Structure, theta: ArrayLike) -> NDArray[np.complex128]:
    """Poles in 1/s, ascending in magnitude, conjugates side by side (the one with positive imaginary part first).

    Where structural damping is present only oscillating poles have a meaning; those are returned.

    Raises
    ------
    ModelError
        If the structure is unstable.
    """
    m = structure.matrices(_values(structure, theta))
    require_sound(m)
    structural = bool(m.D.any())
    omega2, shape = natural_modes(m.M, m.K)
    if shape.shape[1] < m.M.shape[0] and (structural or m.C.any()):
        return sorted_poles(pencil_poles(m.M, m.C, m.K + 1j * m.D if structural else m.K), structural)
    damping, loss = shape.T @ m.C @ shape, shape.T @ m.D @ shape
    if couples(damping) or couples(loss):
        return sorted_poles(coupled_poles(omega2, damping, loss), structural)
    half = np.diag(damping) / 2
    root = np.sqrt(half**2 - omega2 - 1j * np.diag(loss) + 0j)
    return sorted_poles(np.concatenate([-half + root, -half - root]), structural)


class ChannelView:
    """Rows, loads, orders and signs of the channels on one structure at one theta: what every way of solving shares."""

    def __init__(
        self,
        structure: Structure,
        theta: ArrayLike,
        frequency: ArrayLike,
        outputs: Sequence[Channel],
        inputs: Sequence[Channel],
    ) -> None:
        self.structure, self.outputs, self.inputs = structure, tuple(outputs), tuple(inputs)
        self.theta = _values(structure, theta)
        self.frequency = np.atleast_1d(np.asarray(frequency, float))
        if self.frequency.ndim != 1 or not (np.isfinite(self.frequency).all() and (self.frequency >= 0).all()):
            raise ModelError("frequencies must be a list of finite values >= 0 Hz")
        self.omega = 2 * np.pi * self.frequency
        self.places = [_output_place(structure, c) for c in self.outputs]
        self.drives = [_input_place(structure, c) for c in self.inputs]
        self.matrices = structure.matrices(self.theta)
        n = self.matrices.M.shape[0]
        self.rows = np.array([self._row(p) for p in self.places], float).reshape(-1, n)
        self.loads = np.array([self._load(d) for d in self.drives], float).reshape(-1, n).T
        self.solver: Solver = solver(self.matrices, self.omega)
        self.power, self.carried = self._gains()

    def _row(self, place: _Place) -> NDArray:
        if place.is_base:
            return np.zeros(self.matrices.M.shape[0])
        return place.sign * self.structure.participation(place.dof, self.theta)

    def _load(self, place: _Place) -> NDArray:
        if place.is_base:
            return -place.sign * self.structure.base_load(self.theta)
        return place.sign * self.structure.participation(place.dof, self.theta)

    def _gains(self) -> tuple[NDArray, NDArray]:
        """Powers of i omega before the kernel, and the part that is carried by the base, both (n_out, n_in)."""
        power = np.zeros((len(self.places), len(self.drives)), int)
        carried = np.zeros(power.shape)
        for i, place in enumerate(self.places):
            for j, drive in enumerate(self.drives):
                power[i, j] = place.order + (2 - drive.order if drive.is_base else 0)
                if drive.is_base and (place.is_base or place.axis == self.structure.base):
                    carried[i, j] = place.sign * drive.sign
        if ((power < 2) & (carried != 0)).any() and (self.omega == 0).any():
            raise ModelError("a motion per higher derivative of the base's is infinite at 0 Hz: leave out that line")
        return power, carried

    def parts(self, columns: int) -> list[slice]:
        """Slices of the frequency axis that bound the memory of one solution."""
        step = max(1, _CHUNK // max(1, self.matrices.M.shape[0] * max(1, columns)))
        return [slice(a, min(a + step, self.omega.size)) for a in range(0, self.omega.size, step)]

    def assemble(self, kernel: NDArray, part: slice) -> NDArray[np.complex128]:
        """FRFs from rows Z^-1 loads, (n_out, n_in, n_f)."""
        s = 1j * self.omega[part]
        out = s ** self.power[:, :, None] * kernel
        held = self.carried != 0
        out[held] += self.carried[held][:, None] * s ** (self.power[held][:, None] - 2)
        return out * self._chains(part)

    def _chains(self, part: slice) -> NDArray[np.complex128]:
        f, th, chain = self.frequency[part], self.theta, self.structure.chain
        top = np.array([chain(c, f, th) for c in self.outputs]).reshape(len(self.outputs), 1, f.size)
        bottom = np.array([chain(c, f, th) for c in self.inputs]).reshape(1, len(self.inputs), f.size)
        return top / bottom

    def assemble_slope(self, slope: NDArray, value: NDArray, part: slice) -> NDArray[np.complex128]:
        """Derivatives of the FRFs from those of the kernel, (n_par, n_out, n_in, n_f)."""
        s = 1j * self.omega[part]
        out = s ** self.power[:, :, None] * slope * self._chains(part)
        return out + value * self._chain_slopes(part)

    def _chain_slopes(self, part: slice) -> NDArray[np.complex128]:
        """Logarithmic derivatives of output chain over input chain, (n_par, n_out, n_in, n_f)."""
        f, n_par = self.frequency[part], len(self.structure.parameters)

        def logarithmic(channels: tuple[Channel, ...]) -> NDArray:
            rows = [
                self.structure.chain_derivatives(c, f, self.theta) / self.structure.chain(c, f, self.theta)
                for c in channels
            ]
            return np.array(rows).reshape(len(channels), n_par, f.size).swapaxes(0, 1)

        return logarithmic(self.outputs)[:, :, None] - logarithmic(self.inputs)[:, None]


class _Tangent:
    """Derivatives of rows, loads and matrices, and of the kernel made of them."""

    def __init__(self, view: ChannelView) -> None:
        self.view = view
        structure, theta, m = view.structure, view.theta, view.matrices
        n_par, n = len(structure.parameters), m.M.shape[0]
        self.derivatives = structure.derivatives(theta)
        self.rows = np.zeros((n_par, len(view.places), n))
        self.loads = np.zeros((n_par, n, len(view.drives)))
        for i, place in enumerate(view.places):
            if not place.is_base:
                self.rows[:, i] = place.sign * structure.participation_derivatives(place.dof, theta)
        for j, drive in enumerate(view.drives):
            if drive.is_base:
                self.loads[:, :, j] = -drive.sign * structure.base_load_derivatives(theta)
            else:
                self.loads[:, :, j] = drive.sign * structure.participation_derivatives(drive.dof, theta)
        self.transposed = solver(Matrices(m.M.T, m.C.T, m.K.T, m.D.T), view.omega) if _skew(m) else None

    def at(self, omega: NDArray) -> tuple[NDArray, NDArray]:
        """Kernel (n_out, n_in, n_f) and its derivatives (n_par, n_out, n_in, n_f)."""
        x, y = self._solve(omega)
        kernel = np.moveaxis(self.view.rows @ x, 0, -1)
        slopes = [self._slope(k, d, omega, x, y) for k, d in enumerate(self.derivatives)]
        return kernel, np.array(slopes).reshape(len(slopes), *kernel.shape)

    def _solve(self, omega: NDArray) -> tuple[NDArray, NDArray]:
        """Responses x to the loads, (n_f, n, n_in), and adjoints y of the rows, (n_f, n_out, n)."""
        loads, rows = self.view.loads, self.view.rows
        if self.transposed is not None:
            return self.view.solver.solve(omega, loads), self.transposed.solve(omega, rows.T).swapaxes(1, 2)
        both = self.view.solver.solve(omega, np.hstack([loads, rows.T]))
        return both[:, :, : loads.shape[1]], both[:, :, loads.shape[1] :].swapaxes(1, 2)

    def _slope(self, k: int, d: Matrices, omega: NDArray, x: NDArray, y: NDArray) -> NDArray:
        out = np.zeros((omega.size, y.shape[1], x.shape[2]), complex)
        if self.loads[k].any():
            out += _times(y, self.loads[k])
        if self.rows[k].any():
            out += self.rows[k] @ x
        w = omega[:, None, None]
        parts = [(f, a) for f, a in ((-(w**2), d.M), (1j * w, d.C), (1.0, d.K), (1j, d.D)) if a.any()]
        if parts:  # on the rows and columns where any of them is not zero
            held = np.any([a != 0 for _, a in parts], axis=0)
            rows, columns = np.flatnonzero(held.any(axis=1)), np.flatnonzero(held.any(axis=0))
            near = np.ascontiguousarray(y[:, :, rows])
            left = sum(f * _times(near, a[np.ix_(rows, columns)]) for f, a in parts)
            out -= left @ (x if columns.size == x.shape[1] else x[:, columns])
        return np.moveaxis(out, 0, -1)


def _times(y: NDArray, a: NDArray) -> NDArray:
    """Products y a for every frequency, (n_f, o, n) with (n, m), as one of all."""
    return (y.reshape(-1, y.shape[2]) @ a).reshape(*y.shape[:2], a.shape[1])


class _Place(NamedTuple):
    """What a channel means to a structure: degree of freedom, axis, sign, order of differentiation."""

    dof: str
    axis: str
    sign: float
    order: int
    is_base: bool


def _output_place(structure: Structure, channel: Channel) -> _Place:
    if channel.quantity not in MOTION_ORDER:
        raise ChannelError(f"channel {channel.name!r} measures {channel.quantity}: a response of a model is a motion")
    if channel.role == "base":
        return _base_place(structure, channel)
    _require_place(channel, rotation=channel.quantity.startswith("ang"))
    axis = channel.direction.lstrip("+-")
    return _Place(channel.dof, axis, channel.sign, MOTION_ORDER[channel.quantity], False)


def _input_place(structure: Structure, channel: Channel) -> _Place:
    if channel.role == "base":
        return _base_place(structure, channel)
    if channel.quantity not in ("force", "moment"):
        raise ChannelError(
            f"channel {channel.name!r} measures {channel.quantity}: an input of a model is a force, a moment,"
            ' or a base motion (role "base")'
        )
    _require_place(channel, rotation=channel.quantity == "moment")
    return _Place(channel.dof, channel.direction.lstrip("+-"), channel.sign, 0, False)


def _base_place(structure: Structure, channel: Channel) -> _Place:
    if channel.quantity not in ("displacement", "velocity", "acceleration"):
        raise ChannelError(f"channel {channel.name!r} of role base measures {channel.quantity}: expected a motion")
    if not structure.base:
        raise ModelError(f'channel {channel.name!r} has role "base", but the model has no base excitation (key base)')
    axis = channel.direction.lstrip("+-")
    if axis and axis != structure.base:
        raise ModelError(f"channel {channel.name!r} points in {axis}, but the model's base moves in {structure.base}")
    return _Place("", structure.base, channel.sign, MOTION_ORDER[channel.quantity], True)


def _require_place(channel: Channel, rotation: bool) -> None:
    if not channel.dof:
        raise ChannelError(f"channel {channel.name!r} has no place: give its node and direction")
    if channel.direction.lstrip("+-").startswith("r") != rotation:
        wanted = "rx, ry or rz" if rotation else "x, y or z"
        raise ChannelError(f"channel {channel.name!r} measures {channel.quantity}: its direction must be {wanted}")


def _values(structure: Structure, theta: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(theta, float).reshape(-1)
    names = [p.name for p in structure.parameters]
    if values.size != len(names):
        raise ModelError(f"{values.size} parameter values were given, the model has {len(names)}: {', '.join(names)}")
    if not np.isfinite(values).all():
        name = names[int(np.flatnonzero(~np.isfinite(values))[0])]
        raise ModelError(f"the value of parameter {name!r} is not finite")
    return values


def _skew(m: Matrices) -> bool:
    """Whether a matrix is unsymmetric beyond rounding."""
    return any(np.abs(a - a.T).max(initial=0.0) > 1e-12 * np.abs(a).max(initial=0.0) for a in (m.M, m.C, m.K, m.D))
